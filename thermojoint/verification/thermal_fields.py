"""Initial temperatures, heat and held temperatures that vary in space, from case files.

- A bar without convection that starts at A cos(pi x/L): the wave keeps its shape and decays by
  exp(-kappa (pi/L)^2 t).
- Two bars pressed together between walls start warm: a rise dT closes their joint until
  alpha L dT = (p - p0) L/E - g, and p follows from the surface model.
- Heat proportional to x, P in total, in a bar with a held end x = 0: T(L) = 2 P L/(3 A k).
- A square plate of side a whose edge y = a is held at sin(pi x/a) and the others at 0:
  T(a/2, a/2) = 1/(2 cosh(pi/2)).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import erfc

from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.loaded import (
    HALF,
    HARDNESS,
    MODULUS,
    PRELOAD,
    ROUGHNESS,
    column_case,
    joint,
    separation,
)
from thermojoint.verification.structures import marched
from thermojoint.verification.thermal_bar import (
    CAPACITY,
    CONDUCTIVITY,
    DENSITY,
    FOREVER,
    LENGTH,
    WIDTH,
    bar_case,
)

WAVE = 10.0
#: Expansion of the pressed bars, 1/K, and their initial rise, K.
EXPANSION, WARM = 11e-6, 20.0
POWER = 50.0
SIDE = 0.2


def pressed_pressure(rise: float) -> float:
    """Pressure (Pa) of a joint between two bars of `HALF` between walls, warmed by a rise (K)."""
    rest = separation(PRELOAD)

    def lack(opening: float) -> float:
        pressure = 0.5 * HARDNESS * erfc((rest + opening) / (np.sqrt(2.0) * ROUGHNESS))
        growth = 2.0 * HALF * EXPANSION * rise
        return float(growth + opening - 2.0 * HALF * (pressure - PRELOAD) / MODULUS)

    opening = brentq(lack, -rest, ROUGHNESS, xtol=1e-18, rtol=1e-14)
    return float(0.5 * HARDNESS * erfc((rest + opening) / (np.sqrt(2.0) * ROUGHNESS)))


def checks() -> Iterator[Check]:
    """Check all four problems."""
    with temporary_folder() as folder:
        yield from _decaying_wave(folder)
        yield from _warm_start(folder)
        yield _uneven_source(folder)
        yield _uneven_edge(folder)


def _decaying_wave(folder: Path) -> Iterator[Check]:
    rate = CONDUCTIVITY / (DENSITY * CAPACITY) * (np.pi / LENGTH) ** 2
    step, count = 0.001 / rate, 1000
    for thermal in ("full", "reduced"):
        changes: dict[str, Any] = {
            "initial_temperature": {"expression_K": f"{WAVE} * cos(pi * x_mm / {1e3 * LENGTH})"},
            "march": {"step_s": step, "duration_min": step * count / 60.0, "thermal": thermal},
        }
        response = marched(folder, bar_case(folder, changes, (40, 1, 1)))
        computed = response["temperature"].sel(probe="start").to_numpy()
        name = f"thermal fields, wave left alone, {thermal}"
        yield Quantity("temperature", "K", 1e-9).check(f"{name}: start", WAVE, computed[0])
        expected = WAVE * np.exp(-rate * float(response["time"][-1]))
        yield Quantity("temperature", "K", 2e-3).check(f"{name}: end", expected, computed[-1])


def _warm_start(folder: Path) -> Iterator[Check]:
    data = column_case(
        folder,
        True,
        {
            "joints": {"joint": joint(preload_MPa=1e-6 * PRELOAD)},
            "supports": {"symmetry": {"foot": "z", "top": "z", "back": "x", "side": "y"}},
            "initial_temperature": {"rise_K": WARM},
        },
    )
    for thermal in ("full", "reduced"):
        data["march"] |= {"thermal": thermal}
        pressure = marched(folder, data)["pressure"].to_numpy()
        expected = pressed_pressure(WARM)
        for name, row in (("start", 0), ("end", -1)):
            title = f"thermal fields, warm bars between walls, {thermal}: {name}"
            yield Quantity("pressure", "Pa", 1e-6).check(title, expected, pressure[row].mean())


def _uneven_source(folder: Path) -> Check:
    changes = {
        "sources": {
            "heat": {"body": "block", "reference_power_W": POWER, "profile": {"expression": "x_mm"}}
        },
        "heat_input": {"kind": "step", "level": 1.0},
        "held_temperatures": {"x0": {"rise_K": 0.0}},
    }
    computed = marched(folder, bar_case(folder, changes))["temperature"][-1].sel(probe="end").item()
    expected = 2.0 * POWER * LENGTH / (3.0 * WIDTH**2 * CONDUCTIVITY)
    compared = Quantity("temperature", "K", 1e-6)
    return compared.check("thermal fields, heat in proportion to x: end", expected, computed)


def _uneven_edge(folder: Path) -> Check:
    wave = {"expression": f"sin(pi * x_m / {SIDE})"}
    changes = {
        "held_temperatures": {
            **{name: {"rise_K": 0.0} for name in ("x0", "x1", "y0")},
            "y1": {"rise_K": 100.0, "profile": wave},
        },
        "march": {"step_s": FOREVER, "duration_min": FOREVER / 60.0, "thermal": "full"},
    }
    plate = bar_case(folder, changes, (32, 32, 1), (SIDE, SIDE, 0.01))
    computed = marched(folder, plate)["temperature"][-1].sel(probe="middle").item()
    expected = 100.0 / (2.0 * np.cosh(0.5 * np.pi))
    compared = Quantity("temperature", "K", 5e-3)
    return compared.check("thermal fields, edge held at a sine: middle", expected, computed)
