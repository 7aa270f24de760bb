"""The joint-aware estimator: the nominal machine's physics, fitted to the runs of a log."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from benchmarks.thermal_error.methods.logs import responses, sensor_rises
from benchmarks.thermal_error.plants import AXES, model_case
from calibrate.joint_aware.calibration import calibrate_machine
from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware
from fesim.setup.machine import set_up
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.log import Log
from thermojoint.reduced.machine import ReducedMachine, along, reduce_machine

SENSORS = ("a", "b", "T1", "T2")


def joint_aware(training: Log, test: Log) -> dict[str, Array]:
    """The joint-aware estimator with the four sensors of the paper, and its band."""
    estimator = _fitted(training)
    rises, room = sensor_rises(test, SENSORS)
    samples = np.column_stack((test.times, rises, room)).tolist()
    found = [one for _, one in follow(estimator, samples, estimator.initial_state())]
    claims = np.array([one.displacement for one in found])
    bands = np.array([one.band for one in found])
    names = {column.base: column.name for column in training.columns}
    return {
        names[axis]: np.column_stack((claims[:, k], bands[:, k]))
        for k, axis in enumerate(estimator.axes)
    }


@lru_cache(maxsize=1)
def _machine() -> ReducedMachine:
    case = model_case()
    return along(reduce_machine(case, set_up(case), SENSORS), list(AXES))


@lru_cache(maxsize=1)
def _fitted(training: Log) -> JointAware:
    # Before the machine is set up: the log may have nothing of it.
    runs = {f"run {k}": one for k, (_, one) in enumerate(responses(training, SENSORS))}
    return JointAware(calibrate_machine(_machine(), runs).model)
