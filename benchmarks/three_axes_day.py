"""A joint-aware model of a machine with three axes and their drives: a day, on another mesh.

    python -m benchmarks.three_axes_day --out three-axes-day.json [--first 0] [--count 1] [--seed 3]

The plant is the shipped machine with three axes, two of them on ball screws that heat it and stand
on it, one with a scale that follows it; the model has elements and contact elements of twice the
size. From plant 1 on films, friction of the screws, expansion of the scale, conductivity and power
differ from the case. Noise of 0.12 K peak to peak on four thermometers; every axis moves at random
for two fifths of the time. Calibrated from steps of 0.5 and 1 for an hour and two hours with a
cool-down; judged, free-running, in a day of 8 h with random heat. Beside it, a model whose drives
stay as their case says, and one without drives. Tables in docs/moving-axes.md.
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np
import xarray as xr

from benchmarks.moving_axis import course, errors_of, estimates_of, read_by
from benchmarks.study import case_data, case_file, options_of, write_json
from calibrate.joint_aware.calibration import calibrate_joint_aware, machine_of
from calibrate.joint_aware.random_heat import random_levels
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.lines import here
from fesim.case.schema import Case, case_from_data, read_case
from meshes.exchange import write_structure
from meshes.three_axes import three_axis_machine
from thermojoint.artefacts.response import columns_of
from thermojoint.reduced.parameters import OF_DRIVE, active

SENSORS = ("ram", "column_top", "bed_left", "bed_front")
#: Steps of model and plant, s; elements of the model, m.
STEP, SIZE = 30.0, 0.1
#: Minutes, and the heat input in them, of each run.
RUNS = {"0.5": (60.0, 0.5), "1": (60.0, 1.0), "cool-down": (120.0, 1.0), "day": (480.0, None)}
#: For how many minutes of a cool-down the source is on.
HEATED = 30.0
#: Beginnings of the names of parameters of drives.
DRIVES = tuple(OF_DRIVE)


def model_case(folder: Path) -> Case:
    """Return the case of the model."""
    data = case_data("three_axes")
    write_structure(three_axis_machine(SIZE), folder / "coarse.vtu")
    data["structure"]["file"] = str(folder / "coarse.vtu")
    del data["volume"]
    for joint in data["joints"].values():
        joint |= {"along": 2, "across": 2}
    for axis in data["axes"].values():
        del axis["file"]
        axis |= {"position_mm": 0.0, "station_mm": 1e3 * SIZE}
        axis.pop("rotation_within_mm", None)
    data["march"]["step_s"] = STEP
    return case_from_data(data, "three_axes.toml", folder)


def plant_of(rng: np.random.Generator, number: int) -> Case:
    """Return a plant: from number 1 on with other parameters than its case."""
    plant = read_case(case_file("three_axes")).replace(volume=None, march={"step_s": STEP})
    if number == 0:
        return plant
    screws = {
        name: {
            key: rng.uniform(0.5, 1.7) * getattr(axis.ball_screw, key)
            for key in ("nut_torque_Nm", "bearing_torque_Nm", "film_W_m2K")
        }
        for name, axis in plant.axes.items()
        if axis.ball_screw is not None
    }
    axes: dict[str, Any] = {name: {"ball_screw": values} for name, values in screws.items()}
    axes["z"] = {"scale": {"expansion_1_K": rng.uniform(7e-6, 9e-6)}}
    iron, spindle = plant.materials["cast_iron"], plant.sources["spindle"]
    conductivity = float(iron.conductivity_W_mK)
    return plant.replace(
        axes=axes,
        convection_W_m2K={"exterior": rng.uniform(5.0, 12.0)},
        materials={"cast_iron": {"conductivity_W_mK": conductivity * rng.uniform(0.92, 1.08)}},
        sources={
            "spindle": {"reference_power_W": spindle.reference_power_W * rng.uniform(0.9, 1.1)}
        },
    )


def response_of(plant: Case, rng: np.random.Generator, run: str, folder: Path) -> xr.Dataset:
    """Return the noisy response of a plant to a run."""
    minutes, level = RUNS[run]
    times = STEP * np.arange(60.0 * minutes / STEP)
    if level is None:
        values = random_levels(rng, 60.0 * minutes, STEP, 1.2, 1)[:, 0]
    else:
        on = times < 60.0 * HEATED if run == "cool-down" else times >= 0.0
        values = np.where(on, level, 0.0)
    rows = [f"{at:g},{value:.4f}" for at, value in zip(times, values, strict=True)]
    (folder / f"{run}.csv").write_text("\n".join(["time_s,heat_input", *rows]) + "\n")
    axes = {}
    for name, axis in plant.axes.items():
        moves = folder / f"{run}-{name}.csv"
        moves.write_text(course(rng, minutes, axis.stroke_mm, STEP))
        axes[name] = {"file": str(moves)}
    heat = {"kind": "sampled", "file": str(folder / f"{run}.csv")}
    given = plant.replace(axes=axes, heat_input=heat, march={"duration_min": minutes})
    return read_by(given, rng)


def figures(estimator: JointAware, response: xr.Dataset) -> dict[str, Any]:
    """Return errors where the axes stand."""
    samples = list(KIND.response(estimator.model, response))
    actual = columns_of(response, "displacement", estimator.axes)
    began = process_time()
    made = estimates_of(estimator, samples)
    spent = process_time() - began
    errors = errors_of(*here(estimator.axes, estimator.details, made), actual)
    return {"axes": estimator.axes, "sample_ms": round(1e3 * spent / len(made), 1)} | errors


def rows_of(rng: np.random.Generator, number: int, folder: Path) -> list[dict[str, Any]]:
    """Return the rows of a plant."""
    case, plant = model_case(folder), plant_of(rng, number)
    responses = {run: response_of(plant, rng, run, folder) for run in RUNS}
    day = responses.pop("day")
    own = [one.name for one in active(machine_of(case, SENSORS)) if not one.name.startswith(DRIVES)]
    nothing = {axis: {"ball_screw": None, "scale": None} for axis in case.axes}
    rows = []
    for model, described, fitted, given in (
        ("drives fitted", case, None, responses),
        ("drives as in the case", case, own, responses),
        ("no drives", case.replace(axes=nothing), None, undriven(responses)),
    ):
        began = process_time()
        found = calibrate_joint_aware(described, given, SENSORS, fitted=fitted)
        row = {"plant": number, "model": model, "calibration_s": round(process_time() - began, 1)}
        rows.append(row | {"doubt": found.fit.doubt} | figures(JointAware(found.model), day))
        print(json.dumps(rows[-1]), flush=True)
    return rows


def undriven(responses: dict[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Return responses as the log of a machine whose drives nobody knows."""
    names = ("positioning_error", "asked_positioning_error")
    return {run: one.drop_vars(names) for run, one in responses.items()}


def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its rows."""
    parser = options_of(__doc__, "three-axes-day.json")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--seed", type=int, default=3)
    options = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    for number in range(options.first, options.first + options.count):
        with TemporaryDirectory() as folder:
            rng = np.random.default_rng((options.seed, number))
            rows += rows_of(rng, number, Path(folder))
        write_json(options.out, rows)


if __name__ == "__main__":
    main()
