"""The paper's estimator and its linear part, calibrated from the steps of a log."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from benchmarks.thermal_error.methods.logs import (
    cold_ambient,
    held,
    moved_to_readings,
    responses,
    sensor_rises,
)
from benchmarks.thermal_error.scoring import NotApplicable
from calibrate.chain import calibrate_responses
from estimator.fchs.stream import Signals, run
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ThermojointError
from thermojoint.artefacts.log import Log
from thermojoint.models.assembly import Assembly, assemble
from thermojoint.models.sensors import HEAT_SENSORS, ROLES

#: From the fictitious sources, at the contact elements nearest to T1 and T2, to those sensors, m.
DISTANCES = ((0.0274, 0.2402), (0.2346, 0.0301))


@moved_to_readings
def linear(training: Log, test: Log) -> dict[str, Array]:
    """Eq. 8 alone."""
    assembly = _assembled(training)
    return _by_column(training, assembly, _followed(assembly, test, cold_ambient(training)).linear)


@moved_to_readings
def fchs(training: Log, test: Log) -> dict[str, Array]:
    """The paper's estimator: Eqs. 1 to 18."""
    assembly = _assembled(training)
    return _by_column(training, assembly, _followed(assembly, test, cold_ambient(training)).total)


@lru_cache(maxsize=1)
def _assembled(training: Log) -> Assembly:
    steps = {
        level: response.drop_vars("ambient")
        for level, response in responses(training, ROLES)
        if level is not None
    }
    if 1.0 not in steps or len(steps) < 3:
        raise NotApplicable("log: no steps from rest at three levels, one of them the reference")
    reference = steps.pop(1.0)
    try:
        model = calibrate_responses(reference, steps, DISTANCES).model
    except ThermojointError as error:
        raise NotApplicable(str(error)) from error
    times = reference["time"].to_numpy()
    return assemble(model, float(times[1] - times[0]), 8 * 3600.0)


def _followed(assembly: Assembly, test: Log, cold: float) -> Signals:
    # The calibration leaves a sensor at the joint out where both give no stable estimator.
    sensors = (*HEAT_SENSORS, *assembly.model.linear.direct)
    rises, room = sensor_rises(test, sensors, cold)
    above = held(rises) - room[:, None]
    signals, _ = run(assembly, test.times, above[:, 0] - above[:, 1], above[:, 2:])
    return signals


def _by_column(training: Log, assembly: Assembly, values: Array) -> dict[str, Array]:
    """Return values by the log's names; an axis that the calibration found still is zero."""
    known = {axis: np.asarray(values)[:, k] for k, axis in enumerate(assembly.axes)}
    nothing = np.zeros(len(values))
    return {
        column.name: known.get(column.base, nothing)
        for column in training.columns
        if column.quantity == "length"
    }
