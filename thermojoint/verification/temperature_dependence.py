"""Temperature-dependent conductivity, convection, radiation, expansion and modulus, from cases.

Closed forms for the steady state of a bar along x:

- Between ends held at 0 and T1, theta(T) = integral of the conductivity's factor is linear in x
  (Kirchhoff). With f = 1 + b T: T(L/2) = (sqrt(1 + b (T1 + b T1^2/2)) - 1)/b.
- Heat q from x0 leaves at x1 by radiation: eps sigma (T^4 - T_a^4) = q; or by convection:
  h (1 + b T) T = q.
- A bar heated uniformly by T grows by alpha L (T + b T^2/2).

A short bar of uniform temperature cools by convection h (1 + b T) T: with r = h A/C,
T/(1 + b T) = T0/(1 + b T0) exp(-r t).

With a modulus E0 (1 + b T) and temperatures linear from 0 to T1 between fixed ends, the stress is
s = -alpha E0 b T1^2/(2 ln(1 + b T1)), and the middle moves by
s L ln(1 + b T1/2)/(b E0 T1) + alpha T1 L/8. A free bar at T under a force F grows by
alpha T L + F L/(A E0 (1 + b T)). One that presses on a joint with p = (a - g/c)^2, a^2 the preload,
has p - a^2 = E0 (1 + b T) (alpha T + g/L).

A bar that loses no heat warms by E = C (T + b T^2/2).

Two bars between ends held at 0 and T1 face each other across enclosed air: the heat flux is
T1/(L1/k + 1/h + 1/h + L2/k), and the air has the mean temperature of both faces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.constants import Stefan_Boltzmann, zero_Celsius
from scipy.optimize import brentq

from meshes.box_grid import put_side_by_side
from meshes.exchange import write_structure
from meshes.structure import Probe, Structure
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.structures import box_grid, marched
from thermojoint.verification.thermal_bar import (
    CAPACITY,
    CONDUCTIVITY,
    DENSITY,
    EXPANSION,
    LENGTH,
    METAL,
    WIDTH,
    bar_case,
)

#: Slope of the factors, 1/K, and their last temperature, K: a change by one half.
SLOPE, HOT = 5e-3, 100.0
RISING = {"rise_K": [0.0, HOT], "factor": [1.0, 1.0 + SLOPE * HOT]}
FALLING = {"rise_K": [0.0, HOT], "factor": [1.0, 1.0 - SLOPE * HOT]}
EMISSIVITY, AMBIENT = 0.8, 20.0
#: Heat supplied, W, and convection coefficient, W/(m2 K).
POWER, FILM = 2.0, 40.0
#: Length of the bar that cools uniformly, m.
SHORT = 0.001
TEMPERATURE = Quantity("temperature", "K", 1e-6)


def checks() -> Iterator[Check]:
    """Yield all checks."""
    with temporary_folder() as folder:
        yield from _conducting(folder)
        yield from _radiating(folder)
        yield from _growing(folder)
        yield from _softening(folder)
        yield from _cooling(folder)
        yield from _storing(folder)
        yield from _enclosing(folder)


def _conducting(folder: Path) -> Iterator[Check]:
    held = {"held_temperatures": {"x0": {"rise_K": 0.0}, "x1": {"rise_K": HOT}}}
    for name, factor, slope in (("rising", RISING, SLOPE), ("falling", FALLING, -SLOPE)):
        response = marched(folder, bar_case(folder, held, metal={"conductivity_factor": factor}))
        middle = response["temperature"][-1].sel(probe="middle").item()
        half = 0.5 * (HOT + 0.5 * slope * HOT**2)
        expected = (np.sqrt(1.0 + 2.0 * slope * half) - 1.0) / slope
        title = f"temperature dependence, {name} conductivity: middle"
        yield TEMPERATURE.check(title, expected, middle)
        yield _settled(f"{name} conductivity", response)


def _radiating(folder: Path) -> Iterator[Check]:
    flux = POWER / WIDTH**2
    driven: dict[str, Any] = {
        "sources": {"heat": {"surface": "x0", "reference_power_W": POWER}},
        "heat_input": {"kind": "step", "level": 1.0},
    }
    absolute = zero_Celsius + AMBIENT
    hot = (absolute**4 + flux / (EMISSIVITY * Stefan_Boltzmann)) ** 0.25 - absolute
    black = {"radiation": {"x1": {"emissivity": EMISSIVITY, "ambient_degC": AMBIENT}}}
    film = {"convection_W_m2K": {"x1": FILM}, "convection_factor": {"x1": RISING}}
    warm = (np.sqrt(1.0 + 4.0 * SLOPE * flux / FILM) - 1.0) / (2.0 * SLOPE)
    for name, lost, expected in (("radiation", black, hot), ("film", film, warm)):
        response = marched(folder, bar_case(folder, driven | lost))
        end = response["temperature"][-1].sel(probe="end").item()
        yield TEMPERATURE.check(f"temperature dependence, {name}: surface", expected, end)
        yield _settled(name, response)


def _growing(folder: Path) -> Iterator[Check]:
    warm: dict[str, Any] = {
        "initial_temperature": {"rise_K": 60.0},
        "march": {"step_s": 1.0, "duration_min": 0.1, "thermal": "full"},
    }
    response = marched(folder, bar_case(folder, warm, metal={"expansion_factor": RISING}))
    expected = EXPANSION * LENGTH * (60.0 + 0.5 * SLOPE * 60.0**2)
    for name, row in (("start", 0), ("end", -1)):
        computed = response["displacement"][row].sel(axis="x").item()
        title = f"temperature dependence, expansion, {name}: growth"
        yield Quantity("displacement", "m", 1e-6).check(title, expected, computed)


def _softening(folder: Path) -> Iterator[Check]:
    modulus, moved = 1e9 * METAL["youngs_modulus_GPa"], Quantity("displacement", "m", 1e-6)
    for name, factor, slope in (("rising", RISING, SLOPE), ("falling", FALLING, -SLOPE)):
        metal = {"youngs_modulus_factor": factor}
        held = {
            "held_temperatures": {"x0": {"rise_K": 0.0}, "x1": {"rise_K": HOT}},
            # Held all around, a bar without lateral contraction is one-dimensional.
            "supports": {"symmetry": {f"{axis}{end}": axis for axis in "xyz" for end in "01"}},
            "displacement": {"point": "middle"},
        }
        response = marched(folder, bar_case(folder, held, metal=metal))
        whole, half = np.log1p(slope * HOT), np.log1p(0.5 * slope * HOT)
        # The stress times L/(E0 b T1).
        pressed = -0.5 * EXPANSION * HOT * LENGTH / whole
        expected = pressed * half + EXPANSION * HOT * LENGTH / 8.0
        computed = response["displacement"][-1].sel(axis="x").item()
        title = f"temperature dependence, {name} modulus between fixed ends: middle"
        yield moved.check(title, expected, computed)
        pulled = {
            "initial_temperature": {"rise_K": 60.0},
            "loads": {"pull": {"surface": "x1", "force_N": [4e4, 0.0, 0.0]}},
            "march": {"step_s": 1.0, "duration_min": 0.05, "thermal": "full"},
        }
        response = marched(folder, bar_case(folder, pulled, metal=metal))
        soft = modulus * (1.0 + 60.0 * slope)
        expected = LENGTH * (60.0 * EXPANSION + 4e4 / (WIDTH**2 * soft))
        for when, row in (("start", 0), ("end", -1)):
            computed = response["displacement"][row].sel(axis="x").item()
            title = f"temperature dependence, {name} modulus under a force, {when}: growth"
            yield moved.check(title, expected, computed)
        yield _pressing(folder, f"{name} modulus on a joint", metal, soft)


def _pressing(folder: Path, name: str, metal: dict[str, Any], soft: float) -> Check:
    """Pressure of a warm bar with a modulus in Pa, held by a wall through a joint."""
    coefficient, preload = 2e-9, 1e6
    pressing: dict[str, Any] = {
        "initial_temperature": {"rise_K": 60.0},
        "walls": {"wall": {"faces": "x1"}},
        "probes": {"end": {"position_mm": [1e3 * LENGTH, 0.0, 0.0], "body": "block"}},
        "bodies": {"block": "metal", "wall": "metal"},
        "joints": {
            "joint": {
                "side_a": "x1",
                "side_b": "wall",
                "preload_MPa": 1e-6 * preload,
                "along": 2,
                "across": 2,
                "normal_law": "back-burdekin",
                "back_burdekin": {"coefficient_um": 1e9 * coefficient, "exponent": 0.5},
                "roughness_um": 1.0,
                "asperity_slope": 0.1,
                "hardness_GPa": 2.0,
                "friction_coefficient": 0.0,
            }
        },
        "march": {"step_s": 1.0, "duration_min": 0.05, "thermal": "full"},
    }
    response = marched(folder, bar_case(folder, pressing, metal=metal))

    def left(gap: float) -> float:
        pressure = (np.sqrt(preload) - gap / coefficient) ** 2
        return float(pressure - preload - soft * (60.0 * EXPANSION + gap / LENGTH))

    gap = brentq(left, -60.0 * EXPANSION * LENGTH, 0.0, xtol=1e-18)
    expected = preload + soft * (60.0 * EXPANSION + gap / LENGTH)
    computed = response["pressure"][-1].mean().item()
    title = f"temperature dependence, {name}"
    return Quantity("pressure", "Pa", 1e-6).check(title, expected, computed)


def _cooling(folder: Path) -> Iterator[Check]:
    rate = FILM / (DENSITY * CAPACITY * SHORT)
    step, count = 1e-3 / rate, 1000
    changes = {
        "initial_temperature": {"rise_K": HOT},
        "convection_W_m2K": {"x1": FILM},
        "convection_factor": {"x1": RISING},
        "march": {"step_s": step, "duration_min": step * count / 60.0, "thermal": "full"},
    }
    size = SHORT, WIDTH, WIDTH
    response = marched(folder, bar_case(folder, changes, (1, 1, 1), size))
    computed = response["temperature"][-1].sel(probe="end").item()
    left = HOT / (1.0 + SLOPE * HOT) * np.exp(-rate * float(response["time"][-1]))
    expected = left / (1.0 - SLOPE * left)
    compared = replace(TEMPERATURE, tolerance=2e-3)
    yield compared.check("temperature dependence, film of a cooling plate: end", expected, computed)


def _storing(folder: Path) -> Iterator[Check]:
    heated = {
        "sources": {"heat": {"body": "block", "reference_power_W": 30.0 * POWER}},
        "heat_input": {"kind": "step", "level": 1.0},
        "march": {"step_s": 5.0, "duration_min": 2.0, "thermal": "full"},
    }
    rise = 30.0 * POWER * 120.0 / (DENSITY * CAPACITY * LENGTH * WIDTH**2)
    for name, factor, slope in (("rising", RISING, SLOPE), ("falling", FALLING, -SLOPE)):
        response = marched(folder, bar_case(folder, heated, metal={"heat_capacity_factor": factor}))
        expected = (np.sqrt(1.0 + 2.0 * slope * rise) - 1.0) / slope
        title = f"temperature dependence, {name} heat capacity: end"
        yield TEMPERATURE.check(
            title, expected, response["temperature"][-1].sel(probe="end").item()
        )
        yield _settled(f"{name} heat capacity", response)


def facing_bars() -> Structure:
    """Return two bars along x, `LENGTH` and half of it, with 1 mm of air between them."""
    gap = 1e-3
    halves = [
        box_grid("hexahedra", (5, 1, 1), (length, WIDTH, WIDTH), (start, 0.0, 0.0))
        for start, length in ((0.0, LENGTH), (LENGTH + gap, 0.5 * LENGTH))
    ]
    mesh, (left, right) = put_side_by_side(halves)
    facets = mesh.boundary_facets()
    x = mesh.p[0, mesh.facets[:, facets]].mean(axis=0)
    return Structure(
        mesh=mesh,
        bodies={"left": left, "right": right},
        surfaces={
            "left_end": facets[x < 1e-9],
            "walls": facets[np.abs(x - LENGTH - 0.5 * gap) < 0.5 * gap + 1e-9],
            "right_end": facets[x > 1.5 * LENGTH + gap - 1e-9],
        },
        probes={"end": Probe((LENGTH, 0.5 * WIDTH, 0.5 * WIDTH), "left")},
    )


def _enclosing(folder: Path) -> Iterator[Check]:
    write_structure(facing_bars(), folder / "facing.vtu")
    data = bar_case(
        folder,
        {
            "structure": {"kind": "mesh", "file": "facing.vtu"},
            "bodies": {"left": "metal", "right": "metal"},
            "supports": {"fixed": ["left_end", "right_end"]},
            "held_temperatures": {"left_end": {"rise_K": 0.0}, "right_end": {"rise_K": HOT}},
            "cavities": {"air": {"surfaces": ["walls"], "film_W_m2K": FILM}},
        },
    )
    data["probes"] = {"left": {"position_mm": [1e3 * LENGTH, 10.0, 10.0], "body": "left"}}
    response = marched(folder, data)
    flux = HOT / (1.5 * LENGTH / CONDUCTIVITY + 2.0 / FILM)
    computed = response["temperature"][-1, 0].item()
    expected = flux * LENGTH / CONDUCTIVITY
    title = "temperature dependence, enclosed air: cold face"
    yield TEMPERATURE.check(title, expected, computed)
    yield _settled("enclosed air", response)


def _settled(name: str, response: xr.Dataset) -> Check:
    """Last change of the secant iteration relative to the converged temperatures."""
    largest = float(np.abs(response["temperature"]).max())
    residual = Quantity("temperature", "K", 1e-8, "none left")
    title = f"temperature dependence, {name}: last secant step"
    return residual.check(title, 0.0, float(response["secant_residual"].max()), largest)
