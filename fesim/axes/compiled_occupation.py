"""JIT-compiled time shares of aligned positions, as in `fesim.axes.occupation`."""

from __future__ import annotations

import math

from fesim.axes.occupation import place_of as plain_place_of
from fesim.jit import compiled_part
from thermojoint.artefacts.arrays import Array

place_of = compiled_part(plain_place_of)


@compiled_part
def add_shares(
    positions: Array,
    ends: tuple[float, float],
    time: float,
    mean: Array,
    square: Array,
    both: Array,
) -> None:
    """Add the shares of a uniform motion between two positions (m) that takes a part of the time.

    Parameters
    ----------
    positions : ndarray, shape (k,)
        As for `fesim.axes.occupation.even`.
    ends : tuple of float
        Positions between which the axis moves, m.
    time : float
        Part of the time.
    mean, square, both : ndarray, shapes (k,), (k,) and (k - 1,) or longer
        The attributes of `fesim.axes.occupation.Shares`, in place.
    """
    first, second = place_of(positions, ends[0]), place_of(positions, ends[1])
    low, high, most = min(first, second), max(first, second), positions.size - 2
    begin = low
    while True:
        stop = min(math.floor(begin) + 1.0, high)
        part = time * ((stop - begin) / (high - low) if high > low else 1.0)
        below = min(math.floor(begin), most)
        a, b = begin - below, stop - below
        once, twice = part * (a + b) / 2.0, part * (a * a + a * b + b * b) / 3.0
        mean[below] += part - once
        mean[below + 1] += once
        square[below] += part - 2.0 * once + twice
        square[below + 1] += twice
        both[below] += once - twice
        begin = stop
        if begin >= high:
            break
