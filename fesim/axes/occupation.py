"""Time shares of the aligned positions of an axis, and its travel in a step.

A position between two aligned ones has the weights of linear interpolation. A step needs the means
over time of these weights and of their products. Both are exact while the axis moves uniformly,
stands or reverses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fesim.case.history import History
from thermojoint.artefacts.arrays import Array

#: A position nearer to an aligned one than this fraction of their spacing is that position.
STILL = 1e-9


@dataclass(frozen=True)
class Shares:
    """Means over a step of the weights w of k aligned positions, at most two nonzero at a time."""

    #: Shape (k,): of w_i; they add up to one.
    mean: Array
    #: Shape (k,): of w_i^2.
    square: Array
    #: Shape (k - 1,): of w_i w_(i+1).
    product: Array


def weights_at(positions: Array, at: float) -> Array:
    """Return the weights (k,) of evenly spaced positions (k,), m, at a position, m.

    At an aligned position, its weight is one.
    """
    return even(positions, at, at).mean


def even(positions: Array, start: float, end: float) -> Shares:
    """Return the shares of positions (k,), m, of an axis that moves uniformly between two, m."""
    places = np.array([place_of(positions, start), place_of(positions, end)])
    return _shares(len(positions), places, np.ones(1))


def shares_of(positions: Array, course: History, start: float, end: float) -> Shares:
    """Return the shares of positions while an axis moves from `start` to `end`, s.

    Parameters
    ----------
    positions : ndarray, shape (k,)
        Aligned positions, evenly spaced, ascending, m.
    course : History
        Position of the axis, m.
    start, end : float
        Times, s.
    """
    times, at = stretches(course, start, end)
    places = np.array([place_of(positions, place) for place in at])
    return _shares(len(positions), places, np.diff(times) / (end - start))


def place_of(positions: Array, at: float) -> float:
    """Return a position in units of the spacing; an integer if it is aligned.

    Compiled as well, by `fesim.axes.compiled_occupation`.
    """
    last = positions.size - 1
    place = (at - positions[0]) / (positions[last] - positions[0]) * last
    nearest = float(round(place))
    if abs(place - nearest) <= STILL:
        place = nearest
    return float(min(max(place, 0.0), float(last)))


def _shares(count: int, places: Array, lengths: Array) -> Shares:
    """Shares of `count` positions in a motion through places (n,) in parts (n - 1,) of the time."""
    mean, square, product = np.zeros(count), np.zeros(count), np.zeros(count - 1)
    for first, second, length in zip(places, places[1:], lengths, strict=False):
        low, high = min(first, second), max(first, second)
        inner = np.arange(np.floor(low) + 1.0, np.ceil(high))
        ends = np.concatenate([[low], inner, [high]])
        part = np.diff(ends) / (high - low) if high > low else np.ones(1)
        below = np.clip(np.floor(ends[:-1]).astype(np.int64), 0, count - 2)
        a, b = ends[:-1] - below, ends[1:] - below
        once, twice = length * part * (a + b) / 2.0, length * part * (a * a + a * b + b * b) / 3.0
        whole = length * part
        # No index occurs twice: each piece lies between another pair of positions.
        mean[below] += whole - once
        mean[below + 1] += once
        square[below] += whole - 2.0 * once + twice
        square[below + 1] += twice
        product[below] += once - twice
    return Shares(mean, square, product)


def distance(course: History, start: float, end: float) -> float:
    """Return the travel from `start` to `end` (s), to and fro, m."""
    return float(np.abs(np.diff(stretches(course, start, end)[1])).sum())


def stretches(course: History, start: float, end: float) -> tuple[Array, Array]:
    """Return times, s, and positions, m, (k,) each, between which an axis moves uniformly."""
    knots = course.times[(course.times > start) & (course.times < end)]
    times = np.concatenate([[start], knots, [end]])
    return times, course(times)
