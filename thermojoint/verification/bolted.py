"""Bolts from case files: joint diagram, an expanding sleeve, balance with contact pressures.

Bars along z without lateral contraction are one-dimensional, and a bolt on the whole end face of a
bar loads it uniformly. A bolt of stiffness k_b clamps parts of stiffness k_c. A separating force F
at their ends changes the force of the bolt by F k_b/(k_b + k_c) (Roetscher's diagram). The force of
a bolt through a sleeve, both heated by T, is F0 + (alpha_s - alpha_b) L T / (1/k_b + 1/k_s).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.optimize import brentq

from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.loaded import AREA, HALF, MODULUS, column_case, joint, separation
from thermojoint.verification.structures import marched

#: Force after tightening and force that separates the joint, N; rise of the temperature, K.
FORCE, PARTING, RISE = 20e3, 6e3, 40.0
#: The bolt: diameter and length, m, modulus, Pa; expansions of bolt and sleeve, 1/K.
DIAMETER, LENGTH, BOLT_MODULUS = 0.016, 2.0 * HALF, 206e9
BOLT_EXPANSION, SLEEVE_EXPANSION = 12e-6, 23e-6
STIFFNESS = BOLT_MODULUS * 0.25 * np.pi * DIAMETER**2 / LENGTH
#: Stiffness of the column as a spring, N/m.
COLUMN = MODULUS * AREA / LENGTH
BY_DIAGRAM = Quantity("force", "N", source="joint diagram")

BOLT: dict[str, Any] = {
    "head": {"surface": "top"},
    "thread": {"surface": "foot"},
    "force_kN": 1e-3 * FORCE,
    "material": "steel",
    "diameter_mm": 1e3 * DIAMETER,
}


def checks() -> Iterator[Check]:
    """Check forces of bolts and contact pressures."""
    with temporary_folder() as folder:
        yield from _diagram_checks(folder)
        yield from _sleeve_checks(folder)


def bolted(folder: Path, split: bool, changes: dict[str, Any]) -> dict[str, Any]:
    """Return the data of a case: a column with a bolt of steel through it."""
    data = column_case(folder, split, {"bolts": {"bolt": BOLT}})
    steel = {"youngs_modulus_GPa": 1e-9 * BOLT_MODULUS, "expansion_1_K": BOLT_EXPANSION}
    data["materials"]["steel"] = data["materials"]["iron"] | steel
    return data | changes


def _diagram_checks(folder: Path) -> Iterator[Check]:
    """Two bars whose joint is pressed only by the bolt, and a force that separates them."""
    (folder / "parting.csv").write_text("time_s,factor\n0,0\n20,0\n60,1\n")
    force = {"surface": "top", "force_N": [0.0, 0.0, PARTING], "file": "parting.csv"}
    at = 1e-6 * FORCE / AREA
    pressed = joint(preload_MPa=0.0, initial_opening_um=0.0, reference_pressure_MPa=at)
    data = bolted(folder, True, {"joints": {"joint": pressed}, "loads": {"part": force}})
    response = marched(folder, data)
    rest, last = response.isel(time=0), response.isel(time=-1)
    equilibrium = replace(BY_DIAGRAM, source="equilibrium")
    yield equilibrium.check("bolts, joint, after tightening", FORCE, _contact(rest))
    # The joint is a nonlinear spring in series with the bars: its change of opening is known.
    free = separation(FORCE / AREA)

    def out_of_balance(pull: float) -> float:
        pressed_by = (pull - PARTING) / AREA
        grown = (PARTING - (pull - FORCE)) / COLUMN + separation(pressed_by) - free
        return pull - FORCE - STIFFNESS * grown

    pull = float(brentq(out_of_balance, PARTING + 1.0, FORCE + PARTING, xtol=1e-9))
    yield BY_DIAGRAM.check("bolts, bolt, parted by a force", pull, float(last["bolt_force"][0]))
    yield BY_DIAGRAM.check("bolts, joint, parted by a force", pull - PARTING, _contact(last))
    # Without the joint: a column in one piece.
    whole = bolted(folder, False, {"loads": {"part": force}})
    end = marched(folder, whole).isel(time=-1)
    share = STIFFNESS / (STIFFNESS + COLUMN)
    computed = float(end["bolt_force"][0]) - FORCE
    name = "bolts, bolt on one bar, change by a force"
    yield BY_DIAGRAM.check(name, PARTING * share, computed)


def _sleeve_checks(folder: Path) -> Iterator[Check]:
    """A bolt through a sleeve, both heated uniformly."""
    warm = {name: {"rise_K": RISE} for name in ("foot", "top", "back", "side")}
    data = bolted(folder, False, {"held_temperatures": warm})
    data["materials"]["iron"] |= {"expansion_1_K": SLEEVE_EXPANSION}
    data["march"] = {"step_s": 3600.0, "duration_min": 600.0, "thermal": "full"}
    last = marched(folder, data).isel(time=-1)
    grown = (SLEEVE_EXPANSION - BOLT_EXPANSION) * LENGTH * RISE
    reference = FORCE + grown / (1.0 / STIFFNESS + 1.0 / COLUMN)
    name = "bolts, bolt through a warm sleeve"
    yield Quantity("force", "N").check(name, reference, float(last["bolt_force"][0]))


def _contact(row: xr.Dataset) -> float:
    return float(row["pressure"] @ row["contact_area"])
