"""Moving axes: where they are, what is asked about them, and what positions them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fesim.axes.guideway import Place
from fesim.axes.positioning import Drive, cold
from fesim.case.history import History
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True, eq=False)
class Axis:
    """An axis of a machine."""

    #: As in the case.
    name: str
    #: Its position, m.
    course: History
    #: Shape (k,): positions at which displacements are wanted, m.
    asked: Array
    #: P0 of the line through them, m.
    reference: float
    #: What positions it; None if the bodies stand where its control believes.
    drive: Drive | None
    #: Shape (3,): displacement that is recorded, per m that the bodies on the axis move along it.
    carried: Array


@dataclass(frozen=True, eq=False)
class Volume:
    """Combinations of positions of a axes that are asked about."""

    #: Shape (v, a): m.
    places: Array
    #: Shape (t,): after how many steps.
    steps: NDArray[np.int64]


def place_of(axes: Sequence[Axis], time: float) -> Place:
    """Return where axes are at a time (s), m."""
    return tuple(float(axis.course(np.array(time))) for axis in axes)


def gone_along(positions: Array) -> Array:
    """Return how far axes have gone since the first of positions (n, ...), m, at each of them."""
    way = np.cumsum(np.abs(np.diff(positions, axis=0)), axis=0)
    return np.concatenate([np.zeros_like(positions[:1]), way])


def gone(axis: Axis, times: Array) -> Array:
    """Return how far an axis has gone since time zero, there and back, at times (n,), s, in m."""
    turns = axis.course.times
    every = np.union1d(np.append(times, 0.0), turns[(turns > 0.0) & (turns < times.max())])
    return np.asarray(gone_along(axis.course(every))[np.searchsorted(every, times)])


def cold_drives(axes: Sequence[Axis]) -> Array:
    """Return the state (d,) of the drives of axes, one after the other, at the initial ambient."""
    return np.concatenate([np.zeros(0), *(cold(axis.drive) for axis in axes)])


def parts_of(axes: Sequence[Axis]) -> list[slice]:
    """Return which part of the state of all drives is that of each axis."""
    ends = np.cumsum([0, *(cold(axis.drive).size for axis in axes)]).tolist()
    return [slice(*part) for part in pairwise(ends)]
