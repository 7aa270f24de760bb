"""Reading minus model for every sensor, used or excluded."""

from __future__ import annotations

import numpy as np

from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.observer_state import unpacked
from thermojoint.artefacts.arrays import Array


def residuals(estimator: JointAware, state: Array, values: Array) -> Array:
    """Return reading minus model after a sample, K, shape (channels,); NaN where missing.

    Parameters
    ----------
    estimator : JointAware
        Of the state.
    state : ndarray
        After the sample.
    values : ndarray
        The sample, as `estimator.channels`.
    """
    thermal = estimator.separated(values.tolist()).temperatures
    linear = unpacked(state, estimator.parts).linear
    return np.asarray(thermal - estimator.observer.system.rows @ linear)
