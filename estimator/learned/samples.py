"""A log as samples of a learned estimator, with displacements that were read now and then."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from artefacts.arrays import Array
from artefacts.errors import InputError
from artefacts.log import Log
from estimator.learned.estimator import Learned
from models.learned import LearnedModel

Sample = tuple[float, ...]


def samples_of(model: LearnedModel, pieces: Iterable[Log]) -> Iterator[Sample]:
    """Yield (time, columns in SI, NaN for each reading) of a log.

    Parameters
    ----------
    model : LearnedModel
        Says which columns.
    pieces : iterable of Log
        In the order of time.

    Raises
    ------
    InputError
        A column is missing, or the clock begins anew.
    """
    nothing = (np.nan,) * len(model.channels)
    last = -np.inf
    for piece in pieces:
        if not piece.times[0] > last:
            raise InputError("log: the clock begins anew; estimate each run by itself")
        last = float(piece.times[-1])
        at = [piece.index(name) for name in model.columns]
        for time, values in zip(piece.times.tolist(), piece.values[:, at].tolist(), strict=True):
            yield (time, *values, *nothing)


def with_readings(samples: Iterable[Sample], times: Array, readings: Array) -> Iterator[Sample]:
    """Yield samples with each reading in the first sample that is not before it.

    Parameters
    ----------
    samples : iterable of tuple
        As `samples_of` yields them.
    times : ndarray, shape (r,)
        Of the readings, s, increasing.
    readings : ndarray, shape (r, axes)
        m; NaN where a displacement was not read.
    """
    count = readings.shape[1]
    due = 0
    for sample in samples:
        told = np.full(count, np.nan)
        while due < len(times) and times[due] <= sample[0]:
            told = np.where(np.isnan(readings[due]), told, readings[due])
            due += 1
        yield (*sample[: len(sample) - count], *told.tolist())


def readings_in(estimator: Learned, log: Log) -> tuple[Array, Array]:
    """Return times and displacements (r, axes) of a log of readings, m; NaN for what is missing.

    Raises
    ------
    InputError
        None of the model's displacements has a column.
    """
    found = [name for name in estimator.axes if name in log.names]
    if not found:
        raise InputError(
            f"readings: no column of {', '.join(estimator.axes)}; give one or more, and time_s"
        )
    values = np.full((len(log.times), len(estimator.axes)), np.nan)
    for c, name in enumerate(estimator.axes):
        if name in found:
            values[:, c] = log.at(name)
    return log.times, values
