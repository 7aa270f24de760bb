"""State of a learned estimator: by name, and as the flat array that is stored."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from estimator.learned.unread import Unread
from thermojoint.artefacts.arrays import Array
from thermojoint.models.learned import LearnedModel

#: Entries of a filter's mean and of its covariance: (zero, drift, weights); where a displacement
#: has a slope, those of K0, then those of the slope.
ZERO, DRIFT, WEIGHTS = 0, 1, slice(2, None)


class State(NamedTuple):
    """State after a sample of c columns, n features and a displacements."""

    #: Time of the last sample and start of the run, s; NaN before any sample.
    time: float
    begun: float
    #: Shape (c,): last values of the columns, SI.
    values: Array
    #: Shape (n,): of the features.
    relaxations: Array
    #: Shape (a, m): zero, drift and weights of each displacement, m, and of its slope (`width_of`).
    mean: Array
    #: Shape (a,): innovation of the last refused reading of each displacement, m; 0 after an
    #: accepted one.
    refused: Array
    #: Shape (a, m, m): of `mean`, m2.
    covariance: Array
    #: Bounds on the errors of missing readings.
    unread: Unread

    @property
    def fresh(self) -> bool:
        """Whether there has been no sample yet."""
        return bool(np.isnan(self.time))


def width_of(model: LearnedModel) -> int:
    """Return the entries of one filter: 2 + n, twice as many where any displacement has a slope."""
    return (2 + len(model.features)) * (2 if model.positions else 1)


def cut(array: Array, ends: Iterable[int]) -> list[Array]:
    """Return the parts of an array up to each end, and the rest; `numpy.split` takes longer."""
    return [array[first:end] for first, end in pairwise((0, *ends, len(array)))]


def flat(state: State) -> Array:
    """Return a state as one array: each mean is followed by its refused innovation."""
    filters = np.column_stack((state.mean, state.refused))
    head = [state.time, state.begun], state.values, state.relaxations
    return np.concatenate((*head, filters.ravel(), state.covariance.ravel(), *state.unread))


def state_in(array: Array, model: LearnedModel) -> State:
    """Return the state of a model in an array of `flat`, without shared memory."""
    columns, features, axes = len(model.columns), len(model.features), len(model.channels)
    size = width_of(model)
    ends = np.cumsum([2, columns, features, axes * (size + 1), axes * size**2, features])
    clock, values, relaxations, filters, covariance, *unread = cut(array.copy(), ends)
    filters = filters.reshape(axes, size + 1)
    return State(
        float(clock[0]),
        float(clock[1]),
        values,
        relaxations,
        filters[:, :-1],
        filters[:, -1],
        covariance.reshape(axes, size, size),
        Unread(*unread),
    )
