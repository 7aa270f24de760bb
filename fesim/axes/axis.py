"""Moving axes: their positions, requested results and drives."""

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

    #: Name in the case.
    name: str
    #: Its position over time, m.
    course: History
    #: Shape (k,): positions at which displacements are wanted, m.
    asked: Array
    #: Reference position P0 of the line fitted to them, m.
    reference: float
    #: Its drive; None if the bodies are exactly at the commanded position.
    drive: Drive | None
    #: Shape (3,): recorded displacement per m of motion along the axis.
    carried: Array


@dataclass(frozen=True, eq=False)
class Volume:
    """Combinations of positions of a axes at which results are requested."""

    #: Shape (v, a): positions, m.
    places: Array
    #: Shape (t,): numbers of steps after which they are requested.
    steps: NDArray[np.int64]


def place_of(axes: Sequence[Axis], time: float) -> Place:
    """Return the positions of axes at a time (s), m."""
    return tuple(float(axis.course(np.array(time))) for axis in axes)


def gone_along(positions: Array) -> Array:
    """Return the distance travelled since the first of positions (n, ...), m, at each of them."""
    way = np.cumsum(np.abs(np.diff(positions, axis=0)), axis=0)
    return np.concatenate([np.zeros_like(positions[:1]), way])


def gone(axis: Axis, times: Array) -> Array:
    """Return the travel of an axis, to and fro, from time zero to times (n,), s, in m."""
    # From knot to knot, whatever the times are: a continued march has the same bits.
    knots = np.append(0.0, axis.course.times[axis.course.times > 0.0])
    last = np.searchsorted(knots, times, side="right") - 1
    stands = axis.course(knots)
    return np.asarray(gone_along(stands)[last] + np.abs(axis.course(times) - stands[last]))


def cold_drives(axes: Sequence[Axis]) -> Array:
    """Return the state (d,) of the drives of axes, in their order, at the initial ambient."""
    return np.concatenate([np.zeros(0), *(cold(axis.drive) for axis in axes)])


def parts_of(axes: Sequence[Axis]) -> list[slice]:
    """Return the slice of each axis in the state of all drives."""
    ends = np.cumsum([0, *(cold(axis.drive).size for axis in axes)]).tolist()
    return [slice(*part) for part in pairwise(ends)]
