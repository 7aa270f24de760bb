"""The simulated machines: the reference, two of other parameters, two of another structure."""

from __future__ import annotations

import tempfile
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.plants import driving
from benchmarks.plants.drawing import draw_unlike
from benchmarks.plants.structural import structural_answers
from benchmarks.thermal_error.drives import AMBIENT_DEGC, INTERVAL, Drive, heat_input
from fesim.batch.paths import with_values
from fesim.case.schema import Case, case_from_data
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate
from thermojoint.artefacts.arrays import Array

#: mm: on the source, below it, in the strips, on the table, at the column's foot.
PLACES = {
    "a": ("column", (575.0, 650.0, 100.0)),
    "b": ("column", (550.0, 450.0, 125.0)),
    "T1": ("column", (625.0, 450.0, 87.5)),
    "T2": ("column", (625.0, 700.0, 87.5)),
    "table": ("table", (850.0, 725.0, 125.0)),
    "foot": ("column", (575.0, 100.0, 125.0)),
}
AXES = ("x", "y")
#: Of a plant and of the model of it that a method may have: never the same mesh.
PLANT_MM, MODEL_MM = (40.0, 20.0), (50.0, 25.0)
#: Rms of a thermometer's noise, K, and of a displacement sensor's, m.
NOISE_K, NOISE_M = 0.02, 50e-9

#: Case path to value: ten factors drawn once, evenly from the ranges of the drawn machines by which
#: the estimators are judged (friction 0.2 to 0.8, film 4 to 10, ...), and frozen here.
PLANTS: dict[str, dict[str, float]] = {
    "reference": {},
    "drawn-1": {
        "joints.knee.friction_coefficient": 0.507,
        "joints.knee.preload_MPa": 5.2,
        "joints.knee.roughness_um": 1.11,
        "joints.knee.tangential_stiffness_ratio": 0.965,
        "materials.cast_iron.conductivity_W_mK": 46.4,
        "materials.cast_iron.heat_capacity_J_kgK": 516.0,
        "materials.cast_iron.youngs_modulus_GPa": 103.0,
        "materials.cast_iron.expansion_1_K": 1.38e-05,
        "materials.screw.conductivity_W_mK": 46.4,
        "materials.screw.heat_capacity_J_kgK": 516.0,
        "materials.screw.youngs_modulus_GPa": 2910.0,
        "materials.screw.expansion_1_K": 1.38e-05,
        "convection_W_m2K.exterior": 4.86,
        "sources.bearings.reference_power_W": 267.0,
    },
    "drawn-2": {
        "joints.knee.friction_coefficient": 0.399,
        "joints.knee.preload_MPa": 3.8,
        "joints.knee.roughness_um": 1.48,
        "joints.knee.tangential_stiffness_ratio": 0.728,
        "materials.cast_iron.conductivity_W_mK": 43.4,
        "materials.cast_iron.heat_capacity_J_kgK": 479.0,
        "materials.cast_iron.youngs_modulus_GPa": 103.0,
        "materials.cast_iron.expansion_1_K": 1.42e-05,
        "materials.screw.conductivity_W_mK": 43.4,
        "materials.screw.heat_capacity_J_kgK": 479.0,
        "materials.screw.youngs_modulus_GPa": 2920.0,
        "materials.screw.expansion_1_K": 1.42e-05,
        "convection_W_m2K.exterior": 7.05,
        "sources.bearings.reference_power_W": 314.0,
    },
}

#: Plants of the structural family of `benchmarks.plants`, by number. The seed is this benchmark's.
STRUCTURAL = {"structural-1": 0, "structural-2": 1}
STRUCTURAL_SEED = 2026
NAMES = (*PLANTS, *STRUCTURAL)


def machine_data(
    sizes_mm: tuple[float, float], changed: Mapping[str, float], thermal: str = "full"
) -> dict[str, Any]:
    """Return the reference case on a mesh, with the sensors of the benchmark and values changed."""
    text = files("thermojoint").joinpath("cases/reference.toml").read_text("utf-8")
    data = tomllib.loads(text)
    data["structure"] |= {"element_size_mm": sizes_mm[0], "joint_element_size_mm": sizes_mm[1]}
    data["candidates"] = []
    data["probes"] = {
        name: {"body": body, "position_mm": list(place)} for name, (body, place) in PLACES.items()
    }
    # The reduced model is chosen to a tolerance: its last digits may differ between processors.
    data["march"] = {"step_s": INTERVAL, "duration_min": 35.0, "thermal": thermal}
    return with_values(data, changed)


def model_case() -> Case:
    """Return the machine as a method may know it: nominal values, another mesh than a plant's."""
    return case_from_data(machine_data(MODEL_MM, {}, "reduced"), "nominal machine", Path())


def set_up_plant(plant: str, sizes_mm: tuple[float, float] = PLANT_MM) -> tuple[dict, Setup]:
    """Return a plant's case as data and its structure, condensed once for all runs."""
    data = machine_data(sizes_mm, PLANTS[plant])
    return data, set_up(case_from_data(data, plant, Path()))


def driven(data: dict[str, Any], setup: Setup, drive: Drive, seed: int) -> dict[str, Array]:
    """Return what a logger would have read: column to values, in the unit of its name.

    Parameters
    ----------
    data, setup
        From `set_up_plant`.
    drive : Drive
        Of the run.
    seed : int
        Of the noise.
    """
    with tempfile.TemporaryDirectory() as name:
        case = _case(data, drive, Path(name))
        response = simulate(case, setup=setup, accuracy=False).response
    moved = response["displacement"].sel(axis=list(AXES)).to_numpy()
    return logged(drive, response["temperature"].to_numpy(), moved, seed)


def driven_unlike(name: str, drives: Mapping[str, Drive], seed: int) -> dict[str, dict[str, Array]]:
    """Return name of a run to what a logger would have read, as `driven`, of `STRUCTURAL[name]`.

    Parameters
    ----------
    name : str
        Of the plant.
    drives : dict of str to Drive
        Name to inputs.
    seed : int
        Of the noise of the first run; the others follow.
    """
    sensors = tuple(PLACES)
    plant = draw_unlike(model_case(), sensors, STRUCTURAL_SEED, STRUCTURAL[name])
    data = machine_data(PLANT_MM, {}, "reduced")
    inputs = {
        run: driving.Drive(heat_input(drive.rpm)[1:], drive.ambient[1:] - AMBIENT_DEGC)
        for run, drive in drives.items()
    }
    answers = structural_answers(data, sensors, plant, inputs)
    return {
        run: logged(drives[run], one.temperature + plant.offset, one.displacement, seed + k)
        for k, (run, one) in enumerate(answers.items())
    }


def logged(drive: Drive, rises: Array, moved: Array, seed: int) -> dict[str, Array]:
    """Return the columns of rises above the first ambient, K, and displacements, m, with noise."""
    rng = np.random.default_rng(seed)
    read = rises + NOISE_K * rng.standard_normal(rises.shape)
    moved = moved + NOISE_M * rng.standard_normal(moved.shape)
    columns = {"time_s": drive.times, "spindle_rpm": drive.rpm, "ambient_degC": drive.ambient}
    columns |= {f"{name}_degC": AMBIENT_DEGC + read[:, k] for k, name in enumerate(PLACES)}
    return columns | {f"{axis}_um": 1e6 * moved[:, k] for k, axis in enumerate(AXES)}


def _case(data: dict[str, Any], drive: Drive, folder: Path) -> Case:
    histories = {"heat_input": _held(drive), "ambient_degC": (drive.times, drive.ambient)}
    for column, (times, values) in histories.items():
        rows = (f"{float(t)!r},{float(v)!r}\n" for t, v in zip(times, values, strict=True))
        (folder / f"{column}.csv").write_text(f"time_s,{column}\n" + "".join(rows))
    march = data["march"] | {"duration_min": float(drive.times[-1]) / 60.0}
    run = {
        "heat_input": {"kind": "sampled", "file": "heat_input.csv"},
        "ambient": {"file": "ambient_degC.csv"},
        "march": march,
    }
    return case_from_data(data | run, "run of the benchmark", folder)


def _held(drive: Drive) -> tuple[Array, Array]:
    """Return the heat input at the ends of the steps; the march takes it there."""
    heat = heat_input(drive.rpm)
    heat[0] = heat[1]
    return drive.times, heat
