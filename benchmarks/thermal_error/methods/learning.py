"""A model learned from the log alone, with four sensors, free-running with its band."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from benchmarks.thermal_error.methods.logs import readings
from benchmarks.thermal_error.scoring import NotApplicable
from calibrate.learning.learn import learn
from estimator.columns import samples_of
from estimator.interface import follow
from estimator.learned.estimator import Learned
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log


def learned(training: Log, test: Log) -> dict[str, Array]:
    """The learned model with at most four sensors."""
    estimator = _learned(training)
    columns = np.array(list(samples_of(estimator.model.columns, [test])))
    samples = np.hstack((columns, readings(test, estimator.axes))).tolist()
    found = [one for _, one in follow(estimator, samples, estimator.initial_state())]
    claims = np.array([one.displacement for one in found])
    bands = np.array([one.band for one in found])
    return {
        name: np.column_stack((claims[:, k], bands[:, k])) for k, name in enumerate(estimator.axes)
    }


@lru_cache(maxsize=1)
def _learned(training: Log) -> Learned:
    try:
        return Learned(learn(training.runs(), training.of("length")))
    except InputError as error:
        raise NotApplicable(str(error)) from error
