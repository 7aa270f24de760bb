"""Preparation of a log for several methods: temperatures without gaps, runs as responses."""

from __future__ import annotations

from collections.abc import Iterator
from functools import wraps

import numpy as np
import xarray as xr

from benchmarks.thermal_error.drives import heat_input
from benchmarks.thermal_error.plants import PLACES
from benchmarks.thermal_error.scoring import Method, NotApplicable, Predictions
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.response import make_response

AMBIENT = "ambient"
#: Heat of each source at the reference step, W.
REFERENCE_POWER_W = 295.0
#: A reading of the log is at its level within this part of it.
_STEADY = 1e-6
_RPM = 30.0 / np.pi


def held(values: Array) -> Array:
    """Return columns with the last reading in place of one that is missing, shape (k, p).

    Values missing at the start stay missing, as a causal method cannot know them.
    """
    there = np.isfinite(values)
    rows = np.where(there, np.arange(len(values))[:, None], 0)
    last = np.maximum.accumulate(rows, axis=0)
    return np.asarray(np.take_along_axis(values, last, axis=0))


def temperatures(log: Log) -> Array:
    """Return every temperature of a log, K, without holes, shape (k, p)."""
    return held(np.stack([log.at(name) for name in log.of("temperature")], axis=1))


def displacements(log: Log) -> tuple[tuple[str, ...], Array]:
    """Return the columns of displacement and their values, m, shape (k, c)."""
    names = log.of("length")
    return names, np.stack([log.at(name) for name in names], axis=1)


def levels(log: Log) -> Array:
    """Return the heat input of every sample, by the benchmark's law of the speed, shape (k,)."""
    speeds = log.of("speed")
    if len(speeds) != 1 or log.columns[log.index(speeds[0])].base != "spindle":
        raise NotApplicable("log: no spindle's speed of which the heat is known")
    return heat_input(_RPM * log.at(speeds[0]))


def moved_to_readings(method: Method) -> Method:
    """Return a method that knows no readings, moved by the error at the last one from there on."""

    @wraps(method)
    def moved(training: Log, test: Log) -> Predictions:
        claims = dict(method(training, test))
        for name in test.of("length"):
            error = held((test.at(name) - claims[name])[:, None])[:, 0]
            claims[name] = claims[name] + np.nan_to_num(error)
        return claims

    return moved


def readings(test: Log, columns: tuple[str, ...]) -> Array:
    """Return the readings of a test log, m, NaN where there is none; shape (k, 0) for no task."""
    names = columns if test.of("length") else ()
    return np.stack([np.zeros(len(test.times))] + [test.at(name) for name in names], axis=1)[:, 1:]


def sensor_rises(
    log: Log, sensors: tuple[str, ...], cold: float | None = None
) -> tuple[Array, Array]:
    """Return rises of sensors above the ambient of the cold machine, and of the ambient, K.

    Parameters
    ----------
    log : Log
        Of one run.
    sensors : tuple of str
        Their names.
    cold : float, optional
        That ambient, K; the first of the log if it is not given.

    Raises
    ------
    NotApplicable
        The log has no such sensors.
    """
    bases = {column.base for column in log.columns}
    missing = {*sensors, AMBIENT} - bases
    if missing:
        raise NotApplicable(f"log: no sensor {', '.join(sorted(missing))}")
    room = log.at(AMBIENT)
    read = np.stack([log.at(name) for name in sensors], axis=1)
    cold = float(room[0]) if cold is None else cold
    return read - cold, room - cold


def cold_ambient(training: Log) -> float:
    """Return the ambient at which the machine was cold, K: the first of the training."""
    return float(training.at(AMBIENT)[0])


def responses(log: Log, sensors: tuple[str, ...]) -> Iterator[tuple[float | None, xr.Dataset]]:
    """Yield every run of a log as a response, with its level if it is a step in a still room."""
    for run in log.runs():
        rises, room = sensor_rises(run, sensors)
        heat = levels(run)
        names, moved = displacements(run)
        level = float(np.round(heat[-1], 3))
        is_step = level > 0.0 and not room.any()
        is_step = is_step and bool((np.abs(heat[1:] - heat[-1]) < _STEADY).all())
        if is_step:
            heat = np.where(run.times > 0.0, level, 0.0)
        values = {
            "heat_input": heat,
            "temperature": held(rises),
            "displacement": moved,
            "ambient": room,
            "probe_position": 1e-3 * np.array([PLACES[name][1] for name in sensors]),
        }
        bases = [run.columns[run.index(name)].base for name in names]
        coords: dict[str, np.ndarray | list[str]]
        coords = {"time": run.times, "probe": list(sensors), "axis": bases, "space": list("xyz")}
        power = {"reference_power_W": REFERENCE_POWER_W}
        yield level if is_step else None, make_response(values, coords, power)
