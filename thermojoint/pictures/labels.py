"""Placement of labels beside their points without overlaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array

#: Directions from the point to the label's centre, in the order of trial.
_DIRECTIONS = np.array(
    [(1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1), (0, 1), (0, -1)], dtype=float
)
#: Distances in the order of trial, in heights of a label.
_DISTANCES = np.arange(0.9, 12.0, 0.6)


def place_labels(points: Array, sizes: Array, window: Sequence[float]) -> Array:
    """Return the centre of every label, of width and height `sizes`, of points; both (n, 2).

    No two labels overlap, nor a label and a point, unless the neighbourhood is full; they stay
    inside the window (left, right, bottom, top) if there is room.
    """
    placed: list[tuple[Array, Array]] = []
    for point, size in zip(points, sizes, strict=True):
        reach = _DISTANCES[:, None, None] * size[1] * _DIRECTIONS
        # The centre of a wide label is farther from its point.
        middles = (point + reach + 0.5 * (size - size[1]) * [1.0, 0.0] * _DIRECTIONS).reshape(-1, 2)
        free = _inside(middles, size, window) & ~_covers(middles, size, points)
        for middle, other in placed:
            free &= (np.abs(middles - middle) >= 0.5 * (size + other)).any(axis=1)
        placed.append((middles[int(np.argmax(free))], size))
    return np.array([middle for middle, _ in placed]).reshape(-1, 2)


def _inside(middles: Array, size: Array, window: Sequence[float]) -> NDArray[np.bool_]:
    left, right, bottom, top = window
    low, high = middles - 0.5 * size, middles + 0.5 * size
    return np.asarray(
        (low[:, 0] >= left) & (high[:, 0] <= right) & (low[:, 1] >= bottom) & (high[:, 1] <= top)
    )


def _covers(middles: Array, size: Array, points: Array) -> NDArray[np.bool_]:
    apart = np.abs(middles[:, None, :] - points[None, :, :])
    return np.asarray(np.any(np.all(apart < 0.5 * size, axis=2), axis=1))
