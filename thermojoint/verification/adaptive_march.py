"""Adaptive steps, heat that comes and goes inside a step, and the choice of units.

A rod that is heated at one end from rest follows a Fourier series; in an adiabatic block a pulse
raises the temperature by its energy over the heat capacity, wherever the steps lie; growth rates of
Barber's rod are those of `thermojoint.verification.rod`; and a case with lengths, stresses and heat
in other units gives the same digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from fesim.case.history import Histories
from fesim.march.adaptive import march_adaptively
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine, State
from fesim.march.reduced import (
    ThermalModes,
    outputs_of,
    project_elasticity,
    project_heat,
    project_start,
    thermal_modes,
)
from fesim.march.step_control import Tolerance
from fesim.march.track import joined
from fesim.simulate import TOLERANCE_K, TOLERANCE_UM
from meshes.exchange import write_structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification import rod
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.loaded import PRELOAD, ROUGHNESS, column, column_case, joint
from thermojoint.verification.rods import Rods
from thermojoint.verification.structures import FOREVER, marched
from thermojoint.verification.thermal_bar import (
    CAPACITY,
    CONDUCTIVITY,
    DENSITY,
    EXPANSION,
    LENGTH,
    WIDTH,
    bar_case,
)

#: Openings of Barber's rod: with a growing mode near a stability limit, and two with decaying ones.
OPENINGS = (-1e-6, -4e-6, -8e-6)
#: Perturbation of the rod's end, K.
PERTURBED = 4e-3
#: Default tolerances of a case.
USUAL = Tolerance(1e-6 * TOLERANCE_UM, TOLERANCE_K)
RATE = Quantity("growth rate", "1/s", 1e-3, "characteristic equation")
#: Heat flux into the rod's end, W/m2; energy of the pulse, J.
FLUX, ENERGY = 1e5, 2000.0
#: Units of length, of stress and of heat.
UNITS = (1e-3, 1e6, 1e2)


def checks() -> Iterator[Check]:
    """Check all of them."""
    for opening in OPENINGS:
        yield growth_check(opening)
    with temporary_folder() as folder:
        yield from heated_checks(folder)
        yield from pulse_checks(folder)
        yield from unit_checks(folder)


def growth_check(opening: float) -> Check:
    """Compare the rate of the leading mode about a steady state at an opening (m)."""
    law = rod.joint_law()
    built, case = rod.Case(law, rod.BISTABLE).built(), rod.case_at(law, opening)
    root = rod.leading_root(case, opening)
    rate = rod.rate_of(root)
    on_rod = np.arange(built.x.size) < built.second
    mode = np.where(on_rod, (np.sinh(root * built.x / rod.LENGTH) / np.sinh(root)).real, 0.0)
    still, _ = _on_modes(built, mode, FOREVER)
    steady = rod.steady_near(still, case, opening)
    machine, modes = _on_modes(built, mode, 1.0)
    times = np.array([1.0, 3.0]) / abs(rate)
    drive = Histories(np.zeros(1), case.inputs[None])
    end = int(np.argmax(np.where(on_rod, built.x, -np.inf)))
    found = []
    # Both signs, since the rod is not linear.
    for size in (PERTURBED, -PERTURBED):
        perturbed = size * np.exp(-3.0 * max(np.sign(rate), 0.0)) * mode
        field = steady.temperature + project_start(built.heat, modes, perturbed)
        start: State = replace(steady, temperature=field, model=machine.thermal.model)
        tracks = march_adaptively(machine, modes.rates, drive, times, USUAL, start)
        temperature = joined([track for track, _ in tracks]).temperature
        first, last = (temperature - steady.temperature) @ modes.basis[end]
        found.append(float(np.log(last / first) / (times[1] - times[0])))
    name = f"adaptive steps, Barber's rod at {1e6 * opening:g} um"
    return RATE.check(name, rate, float(np.mean(found)))


def _on_modes(built: Rods, mode: Array, step: float) -> tuple[CondensedMachine, ThermalModes]:
    """Return Barber's rod on modes that include a perturbation's shape, and these modes."""
    outputs = outputs_of(built.elastic, csr_array((0, built.x.size)))
    modes = thermal_modes(built.heat, built.operators, outputs, 1.0, start=mode)
    thermal = project_heat(built.heat, built.operators, step, modes)
    elastic = project_elasticity(built.elastic, modes)
    return CondensedMachine(thermal, ContactProblem(elastic, [(built.law, 1)])), modes


def heated_checks(folder: Path) -> Iterator[Check]:
    """Compare the growth of a rod that is heated at its end with its Fourier series."""
    sides = {"x0": "x", "y0": "y", "y1": "y", "z0": "z", "z1": "z"}
    changes = {
        "sources": {"hot": {"surface": "x1", "reference_power_W": FLUX * WIDTH**2}},
        "held_temperatures": {"x0": {"rise_K": 0.0}},
        "heat_input": {"kind": "step", "level": 1.0},
        "supports": {"symmetry": sides},
        "march": {"step_s": 100.0, "duration_min": 400.0 / 60.0, "method": "adaptive"},
    }
    response = marched(folder, bar_case(folder, changes, (40, 1, 1)))
    waves = (np.arange(400) + 0.5) * np.pi / LENGTH
    parts = 2.0 * FLUX / (CONDUCTIVITY * LENGTH) * (-1.0) ** np.arange(400) / waves**3
    diffusivity = CONDUCTIVITY / (DENSITY * CAPACITY)
    for time in (100.0, 400.0):
        left = float((parts * np.exp(-diffusivity * waves**2 * time)).sum())
        grown = EXPANSION * (FLUX / CONDUCTIVITY * LENGTH**2 / 2.0 - left)
        moved = float(response["displacement"].sel(time=time, axis="x"))
        name = f"adaptive steps, heated rod after {time:g} s"
        yield Quantity("displacement", "m", 1e-3, "Fourier series").check(name, grown, moved)


def pulse_checks(folder: Path) -> Iterator[Check]:
    """Compare the temperature after a pulse with the pulse's energy over the heat capacity."""
    (folder / "pulse.csv").write_text("time_s,heat_input\n0,0\n65,0\n65.001,1\n85,1\n85.001,0\n")
    rise = ENERGY / (DENSITY * CAPACITY * LENGTH * WIDTH**2)
    for method in ("fixed", "adaptive"):
        changes: dict[str, Any] = {
            "sources": {"hot": {"body": "block", "reference_power_W": ENERGY / 20.0}},
            "heat_input": {"kind": "sampled", "file": "pulse.csv"},
            "march": {"step_s": 60.0, "duration_min": 4.0, "method": method},
        }
        response = marched(folder, bar_case(folder, changes, (2, 1, 1)))
        name = f"{method} steps, pulse of 20 s between knots of 60 s"
        warmed = float(response["temperature"][-1, 0])
        yield Quantity("temperature", "K", 1e-6, "energy").check(name, rise, warmed)


def unit_checks(folder: Path) -> Iterator[Check]:
    """Compare displacement and pressure of two heated bars with those in other units."""

    def ended(long: float, stiff: float, hot: float) -> tuple[float, float]:
        structure = column(True)
        mesh = replace(structure.mesh, doflocs=long * structure.mesh.doflocs)
        x, y, z = (long * place for place in structure.probes["top"].position)
        changes: dict[str, Any] = {
            "joints": {"joint": joint(preload_MPa=1e-6 * PRELOAD * stiff)},
            "sources": {"hot": {"surface": "top", "reference_power_W": 200.0 * hot}},
            "heat_input": {"kind": "step", "level": 1.0},
            "supports": {"symmetry": {"foot": "z", "back": "x", "side": "y", "top": "z"}},
        }
        data = column_case(folder, True, changes)
        data["joints"]["joint"]["hardness_GPa"] *= stiff
        data["joints"]["joint"]["roughness_um"] = 1e6 * ROUGHNESS * long
        iron = data["materials"]["iron"]
        iron["youngs_modulus_GPa"] *= stiff
        iron["conductivity_W_mK"] *= hot / long
        iron["density_kg_m3"] *= hot / long**3
        data["probes"]["P"]["position_mm"] = [10.0 * long, 10.0 * long, 100.0 * long]
        probes = {"top": replace(structure.probes["top"], position=(x, y, z))}
        write_structure(replace(structure, mesh=mesh, probes=probes), folder / "column1.vtu")
        response = marched(folder, data)
        pressed = float(response["pressure"][-1].mean()) / stiff
        return float(np.abs(response["displacement"][-1]).max()) / long, pressed

    plain, other = ended(1.0, 1.0, 1.0), ended(*UNITS)
    for quantity, unit, a, b in zip(
        ("displacement", "contact pressure"), ("m", "Pa"), plain, other, strict=True
    ):
        found = Quantity(quantity, unit, 1e-10, "the same case in SI")
        yield found.check("units, two bars 1e-3 as long, 1e6 as stiff", a, b)
