"""Regressions from all temperatures of a log, and nothing at all."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from scipy.signal import lfilter

from benchmarks.thermal_error.methods.logs import displacements, moved_to_readings, temperatures
from calibrate.baselines import fit_autoregression
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.log import Log
from thermojoint.models.baselines import Autoregression

Predictions = dict[str, Array]

#: Time constants of the low-passes that a ridge regression may have, s: one of these rows.
LOW_PASSES: tuple[tuple[float, ...], ...] = ((), (900.0, 3600.0), (300.0, 900.0, 3600.0, 10800.0))
#: Penalties to choose from, and blocks of time for the cross-validation.
PENALTIES = tuple(np.logspace(-2.0, 6.0, 17))
BLOCKS = 5


def nothing(training: Log, test: Log) -> Predictions:
    """No compensation: zero."""
    return {name: np.zeros(len(test.times)) for name in training.of("length")}


@moved_to_readings
def multiple_linear(training: Log, test: Log) -> Predictions:
    """Multiple linear regression on the temperatures of the moment."""
    names, model = _least_squares(training)
    return _by_name(names, model.predict(temperatures(test)))


@moved_to_readings
def ridge(training: Log, test: Log) -> Predictions:
    """Ridge on temperatures and their low-passes, chosen with the penalty by blocks of time."""
    return {
        name: 1e-6 * model.predict(_filtered(test, constants))
        for name, (constants, model) in _shrunk(training).items()
    }


@moved_to_readings
def autoregression(training: Log, test: Log) -> Predictions:
    """ARX on its own past estimates, from the steady state of the first temperatures."""
    names, models, mean = _arx(training)
    rises = temperatures(test) - mean
    return {name: _run(models[name], rises) for name in names}


@lru_cache(maxsize=1)
def _least_squares(training: Log) -> tuple[tuple[str, ...], Any]:
    from sklearn.linear_model import LinearRegression

    names, moved = displacements(training)
    return names, LinearRegression().fit(temperatures(training), moved)


@lru_cache(maxsize=1)
def _shrunk(training: Log) -> dict[str, tuple[tuple[float, ...], Any]]:
    """Return channel to its low-passes and its regression, in µm."""
    from sklearn.linear_model import RidgeCV
    from sklearn.model_selection import GroupKFold
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    names, moved = displacements(training)
    groups = np.arange(len(moved)) * BLOCKS // len(moved)
    blocks = list(GroupKFold(BLOCKS).split(moved, groups=groups))
    tables = {
        constants: np.concatenate([_filtered(run, constants) for run in training.runs()])
        for constants in LOW_PASSES
    }
    chosen = {}
    for k, name in enumerate(names):
        tried = [
            (constants, make_pipeline(StandardScaler(), RidgeCV(PENALTIES, cv=blocks)))
            for constants in LOW_PASSES
        ]
        for constants, model in tried:
            model.fit(tables[constants], 1e6 * moved[:, k])
        chosen[name] = max(tried, key=lambda one: float(one[1][-1].best_score_))
    return chosen


@lru_cache(maxsize=1)
def _arx(training: Log) -> tuple[tuple[str, ...], dict[str, Autoregression], Array]:
    names, moved = displacements(training)
    every = temperatures(training)
    mean = every[0]
    inputs = [temperatures(run) - mean for run in training.runs()]
    ends = [*training.starts[1:], len(training.times)]
    interval = float(np.median(np.diff(training.times)))
    length = max(float(run.times[-1] - run.times[0]) for run in training.runs())
    models = {}
    for k, name in enumerate(names):
        outputs = [moved[first:end, k] for first, end in zip(training.starts, ends, strict=True)]
        models[name] = fit_autoregression(inputs, outputs, interval, 2.0 / length)
    return names, models, mean


def _run(model: Autoregression, rises: Array) -> Array:
    """Return the free run of an autoregression that has stood at its first inputs for long."""
    denominator = np.concatenate(([1.0], -np.asarray(model.past)))
    driven = np.zeros(len(rises))
    for lag, weights in enumerate(model.inputs):
        late = rises[np.maximum(np.arange(len(rises)) - lag, 0)]
        driven += late @ np.asarray(weights)
    steady = driven[0] / denominator.sum()
    start = driven - driven[0]
    return np.asarray(steady + lfilter([1.0], denominator, start))


def _filtered(run: Log, constants: tuple[float, ...]) -> Array:
    """Return temperatures and their low-passes, settled at the first sample, shape (k, ...)."""
    now = temperatures(run)
    interval = float(np.median(np.diff(run.times)))
    columns = [now]
    for constant in constants:
        keep = np.exp(-interval / constant)
        low, _ = lfilter([1.0 - keep], [1.0, -keep], now, axis=0, zi=keep * now[:1])
        columns.append(low)
    return np.hstack(columns)


def _by_name(names: tuple[str, ...], values: Array) -> Predictions:
    # Of one channel scikit-learn gives a plain array.
    columns = np.reshape(values, (len(values), len(names))).T
    return dict(zip(names, columns, strict=True))
