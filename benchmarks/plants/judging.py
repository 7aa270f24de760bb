"""One plant: calibrated with what it answered, judged by what it has not shown."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from threadpoolctl import threadpool_limits

from benchmarks.plants.drawing import Plant
from benchmarks.plants.driving import STEPS, drives
from benchmarks.plants.estimating import BY_STEPS, ESTIMATORS, Calibrated, Errors, Known
from benchmarks.plants.responding import (
    DISPLACEMENT_NOISE,
    TEMPERATURE_NOISE,
    Answer,
    answers,
    measured,
)
from benchmarks.plants.structural import structural_answers
from estimator.rows import interval_score
from thermojoint.artefacts.errors import ThermojointError
from thermojoint.reduced.loosened import Loosening
from thermojoint.reduced.machine import ReducedMachine

#: Calibration to the runs that it has.
CALIBRATIONS = {
    "steps": tuple(f"step-{level}" for level in STEPS),
    "steps and cool-down": (*(f"step-{level}" for level in STEPS), "cool-down"),
}
#: Numbers of recorded days that a plant is calibrated with beside these.
DAYS = (1, 2, 5)
CASES = ("step-1.5", "step-3.0", "triangle", "triangle-noise", "day", "cool-down", "warm-start")
#: A warm start, this long after the start of the day, and when it is judged, s.
WARM, SETTLED = 4 * 3600.0, 1200.0


@dataclass(frozen=True, eq=False)
class Machines:
    """Common data of all plants of a study."""

    #: That the estimators know.
    model: ReducedMachine
    #: On a separate mesh, with the case's parameters.
    plant: ReducedMachine
    #: A response of it, of any length.
    places: xr.Dataset
    #: What the model may have beside its case.
    loosening: Loosening | None
    #: Of the plants' case, for a plant that is set up anew.
    data: dict[str, Any]


def calibrations(days: int) -> dict[str, tuple[str, ...]]:
    """Return every calibration with the runs that it has, of up to so many recorded days."""
    whole = CALIBRATIONS["steps and cool-down"]
    return CALIBRATIONS | {
        f"steps, cool-down, days: {count}": (*whole, *(f"day-{k + 1}" for k in range(count)))
        for count in DAYS
        if count <= days
    }


def with_sensors(machine: ReducedMachine, names: Sequence[str]) -> ReducedMachine:
    """Return a machine with some of its sensors."""
    return machine.with_sensors(names)


def exact_answers(machines: Machines, plant: Plant, days: int = 0) -> dict[str, Answer]:
    """Return the exact answers of a plant to all its runs, with so many recorded days."""
    runs = drives(machines.plant.step, plant.seed, days)
    if plant.unlike is None:
        return answers(machines.plant, plant, runs)
    return structural_answers(machines.data, machines.plant.sensor_names, plant, runs)


def shown(
    machines: Machines, plant: Plant, exact: Mapping[str, Answer], names: Sequence[str]
) -> dict[str, xr.Dataset]:
    """Return the runs that a plant is calibrated with, as they are measured."""
    noise, places = (TEMPERATURE_NOISE, DISPLACEMENT_NOISE), machines.places
    return {
        name: measured(exact[name], machines.plant, places, plant.offset, noise, plant.seed + k)
        for k, name in enumerate(names)
    }


@threadpool_limits.wrap(limits=1)
def judge_plant(
    machines: Machines, plant: Plant, wanted: tuple[str, ...], days: int
) -> dict[str, Any]:
    """Return all that a plant says: rows, calibrations and what it was drawn with."""
    names, exact = machines.plant.sensor_names, exact_answers(machines, plant, days)
    labels = calibrations(days)
    every = shown(machines, plant, exact, max(labels.values(), key=len))
    rows: list[dict[str, Any]] = []
    reports: list[dict[str, Any]] = []
    by_steps: dict[str, Calibrated] = {}
    for count, (label, named) in product(sorted({4, len(names)}), labels.items()):
        responses = {name: every[name] for name in named}
        for kind in wanted:
            begun = time.process_time()
            about = {"plant": plant.number, "calibration": label, "sensors": count}
            try:
                known = Known(with_sensors(machines.model, names[:count]), machines.loosening)
                calibrated = by_steps.get(kind) or ESTIMATORS[kind](known, responses)
                taken = time.process_time() - begun
                if kind in BY_STEPS:
                    by_steps[kind] = calibrated
                for case in CASES:
                    if case in named:
                        continue
                    run, settled = judged_run(machines, plant, exact, case)
                    for name, errors in calibrated.judge(run, case == "warm-start").items():
                        rows += [about | one for one in figures(case, name, errors, run, settled)]
            except ThermojointError as error:
                reports.append(about | {"estimator": kind, "failed": str(error)})
                continue
            reports.append(about | {"estimator": kind, "processor_s": taken} | calibrated.report)
    return {
        "plant": plant.number,
        "factors": plant.factors,
        "offset_K": plant.offset.tolist(),
        "rows": rows,
        "calibrations": reports,
    }


def judged_run(
    machines: Machines, plant: Plant, exact: Mapping[str, Answer], case: str
) -> tuple[xr.Dataset, float]:
    """Return a run as the sensors tell it, and from when on it is judged, s.

    All have noise but the triangle, which is judged both ways.
    """
    name = {"triangle-noise": "triangle", "warm-start": "day"}.get(case, case)
    noise = 0.0 if case == "triangle" else TEMPERATURE_NOISE
    seed = plant.seed + 100 + CASES.index(case)
    run = measured(exact[name], machines.plant, machines.places, plant.offset, (noise, 0.0), seed)
    if case != "warm-start":
        return run, 0.0
    return run.isel(time=run["time"].to_numpy() >= WARM), WARM + SETTLED


def figures(
    case: str, estimator: str, errors: Errors, run: xr.Dataset, settled: float
) -> list[dict[str, Any]]:
    """Return a row for every axis."""
    kept = run["time"].to_numpy() >= settled
    actual = run["displacement"].sel(axis=list(errors.axes)).to_numpy()[kept]
    size = np.abs(errors.error[kept])
    rows = []
    for k, axis in enumerate(errors.axes):
        band = None if errors.band is None else errors.band[kept, k]
        rows.append(
            {
                "case": case,
                "estimator": estimator,
                "axis": axis,
                "max_abs_error_um": 1e6 * float(size[:, k].max()),
                "rms_error_um": 1e6 * float(np.sqrt(np.mean(size[:, k] ** 2))),
                "peak_total_um": 1e6 * float(np.abs(actual[:, k]).max()),
                "band_cover": None if band is None else float(np.mean(size[:, k] <= band)),
                "mean_band_width_um": None if band is None else 2e6 * float(band.mean()),
                "largest_band_width_um": None if band is None else 2e6 * float(band.max()),
                "interval_score_um": None
                if band is None
                else 1e6 * float(interval_score(size[:, k], band)),
            }
        )
    return rows
