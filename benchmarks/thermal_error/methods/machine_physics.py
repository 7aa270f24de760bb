"""The joint-aware estimator: the nominal machine's physics, fitted to the runs of a log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial

import numpy as np
import xarray as xr

from benchmarks.thermal_error.methods.logs import (
    cold_ambient,
    readings,
    responses,
    sensor_rises,
)
from benchmarks.thermal_error.plants import AXES, model_case
from calibrate.joint_aware.calibration import JointAwareCalibration, calibrate_machine
from calibrate.joint_aware.linear_joint import calibrate_linear_joint
from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware
from fesim.setup.machine import set_up
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.log import Log
from thermojoint.reduced.loosened import Loosening, loosening_of
from thermojoint.reduced.machine import ReducedMachine, along, reduce_machine

SENSORS = ("a", "b", "T1", "T2")


def joint_aware(training: Log, test: Log) -> dict[str, Array]:
    """The joint-aware estimator with the four sensors of the paper, and its band."""
    return _followed(_fitted(training, _calibrated), training, test)


def kalman_linear(training: Log, test: Log) -> dict[str, Array]:
    """The same on the machine with a linear joint: a Kalman filter."""
    return _followed(_fitted(training, _calibrated_linear), training, test)


def _followed(estimator: JointAware, training: Log, test: Log) -> dict[str, Array]:
    rises, room = sensor_rises(test, SENSORS, cold_ambient(training))
    names = {column.base: column.name for column in training.columns}
    read = readings(test, tuple(names[axis] for axis in estimator.axes))
    samples = np.column_stack((test.times, rises, room, read)).tolist()
    # The clock counts from when the machine was cold.
    warm = test.times[0] > 0.0
    state = estimator.warm_state() if warm else estimator.initial_state()
    found = [one for _, one in follow(estimator, samples, state)]
    claims = np.array([one.displacement for one in found])
    bands = np.array([one.band for one in found])
    return {
        names[axis]: np.column_stack((claims[:, k], bands[:, k]))
        for k, axis in enumerate(estimator.axes)
    }


@lru_cache(maxsize=1)
def _machine() -> tuple[ReducedMachine, Callable[[], Loosening | None]]:
    case = model_case()
    setup = set_up(case)
    machine = along(reduce_machine(case, setup, SENSORS), list(AXES))
    return machine, partial(loosening_of, case, setup)


def _calibrated(runs: Mapping[str, xr.Dataset]) -> JointAwareCalibration:
    machine, loosening = _machine()
    return calibrate_machine(machine, runs, loosening=loosening)


def _calibrated_linear(runs: Mapping[str, xr.Dataset]) -> JointAwareCalibration:
    return calibrate_linear_joint(_machine()[0], runs)


@lru_cache(maxsize=2)
def _fitted(
    training: Log, calibrate: Callable[[Mapping[str, xr.Dataset]], JointAwareCalibration]
) -> JointAware:
    # Before the machine is set up: the log may have nothing of it.
    runs = {f"run {k}": one for k, (_, one) in enumerate(responses(training, SENSORS))}
    return JointAware(calibrate(runs).model)
