"""Residuals, reading minus prediction, of every sensor.

A sensor that lies shows here before and after it is left out; what all sensors show together is the
model's error.
"""

from __future__ import annotations

import numpy as np

from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.observer_state import unpacked
from thermojoint.artefacts.arrays import Array
from thermojoint.live.machine import Machine
from thermojoint.live.served import Served


def residuals(estimator: JointAware, state: Array, values: Array) -> Array:
    """Return reading minus model after a sample, K, shape (channels,); NaN for what is missing.

    Parameters
    ----------
    estimator : JointAware
        Of the state.
    state : ndarray
        After the sample.
    values : ndarray
        The sample, as `estimator.channels`.
    """
    thermal, _ = estimator.separated(values.tolist())
    linear = unpacked(state, estimator.parts).linear
    return np.asarray(thermal - estimator.observer.system.rows @ linear)


def residuals_of(served: Served, machine: Machine) -> dict[str, float | None] | None:
    """Return the residual of each reading of a machine, K; None before the first sample.

    Parameters
    ----------
    served : Served
        With a joint-aware estimator.
    machine : Machine
        Where it stands.
    """
    estimator, said = served.estimator, machine.usable
    if not isinstance(estimator, JointAware) or said.number == 0:
        return None
    values, _ = served.intake.convert(tuple(said.readings.tolist()), machine.cold)
    found = residuals(estimator, machine.state, np.array(values)).tolist()
    return {
        name: round(value, 4) if np.isfinite(value) else None
        for name, value in zip(served.layout.readings, found, strict=False)
    }
