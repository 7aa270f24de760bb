"""Colour scale of a field: bands between round numbers over the whole range.

A machine is hot at its source and nearly cold elsewhere. On an even scale such a field would be a
spot on a single colour; the bands then follow the sequence 1, 2, 5, 10 instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from thermojoint.artefacts.arrays import Array

if TYPE_CHECKING:
    from matplotlib.colors import BoundaryNorm, Colormap


_COLOURS = "plasma"
#: Largest number of even bands.
_BANDS = 12
#: A field with half of its values below this fraction of the largest gets uneven bands.
_SKEWED = 0.15
#: The side of zero with values below this fraction of the largest one is a single band.
_LITTLE = 0.1
#: Decades below the largest value that uneven bands cover.
_DECADES = 2.7


@dataclass(frozen=True)
class ColourScale:
    """Bands of colour."""

    #: Quantity and unit.
    label: str
    #: Limits of the bands, increasing; two or more.
    levels: tuple[float, ...]
    #: Whether the bands are equally wide.
    even: bool

    @property
    def title(self) -> str:
        """The label, with a warning where the bands are not equally wide."""
        return self.label if self.even else f"{self.label}, uneven bands"

    @property
    def colours(self) -> Colormap:
        """One colour for each band, perceptually uniform."""
        from matplotlib import colormaps

        return colormaps[_COLOURS].resampled(len(self.levels) - 1)

    @property
    def norm(self) -> BoundaryNorm:
        """Mapping of values to bands."""
        from matplotlib.colors import BoundaryNorm

        return BoundaryNorm(self.levels, len(self.levels) - 1, clip=True)

    def position(self, values: Array) -> Array:
        """Position of values on the bar: k at the k-th limit, linear between the limits."""
        return np.interp(values, self.levels, np.arange(len(self.levels)))


def colour_scale(label: str, values: Sequence[Array]) -> ColourScale:
    """Return the scale that shows all finite `values` of the pictures that share it.

    The picture with the largest value determines the kind of bands.
    """
    every = np.concatenate([np.ravel(part) for part in values])
    low, high = float(every.min()), float(every.max())
    largest = max(abs(low), abs(high))
    if high - low <= 1e-9 * max(largest, 1e-300):
        return ColourScale(label, (low, low + (0.1 * abs(low) or 1.0)), even=True)
    fullest = max((np.abs(part) for part in values), key=np.max)
    if float(np.median(fullest)) < _SKEWED * largest:
        return ColourScale(label, _uneven(low, high), even=False)
    return ColourScale(label, _even(low, high), even=True)


def _even(low: float, high: float) -> tuple[float, ...]:
    """Multiples of a round step from at or below `low` to at or above `high`."""
    step = _round_up((high - low) / _BANDS)
    first, last = np.floor(low / step + 1e-9), np.ceil(high / step - 1e-9)
    return tuple(float(step * k) for k in np.arange(first, last + 1.0))


def _uneven(low: float, high: float) -> tuple[float, ...]:
    """1, 2, 5 times powers of ten on each side of zero with values; the ends have two digits.

    One band includes zero: it starts at zero if there is only one side, else it extends across.
    """
    largest = max(abs(low), abs(high))
    powers = np.arange(np.floor(np.log10(largest) - _DECADES), np.ceil(np.log10(largest)) + 1.0)
    steps = np.outer(10.0**powers, [1.0, 2.0, 5.0]).ravel()
    steps = steps[steps >= largest * 10.0**-_DECADES]
    below, above = (_up_to(end, steps, largest) for end in (-low, high))
    slight = next((end for end in (low, high) if 0.0 < abs(end) <= steps[0]), 0.0)
    edge = _outwards(slight) if abs(slight) > largest * 10.0**-_DECADES else 0.0
    around = [] if below and above else [edge]
    levels = [*(-value for value in reversed(below)), *around, *above]
    used = [k for k in range(len(levels) - 1) if levels[k + 1] > low and levels[k] < high]
    return tuple(levels[used[0] : used[-1] + 2])


def _up_to(end: float, steps: Array, largest: float) -> list[float]:
    """Limits from the first step to `end`; a single one if the values on this side are small."""
    if end <= steps[0]:
        return []
    between = steps[steps < 0.9 * end] if end > _LITTLE * largest else steps[:1]
    return [*between.tolist(), _outwards(end)]


def _outwards(value: float) -> float:
    """Two digits of a value, rounded away from zero."""
    unit = 10.0 ** (np.floor(np.log10(abs(value))) - 1.0)
    return float(np.sign(value) * unit * np.ceil(abs(value) / unit - 1e-9))


def _round_up(value: float) -> float:
    """The next of 1, 2, 2.5, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(k * power for k in (1.0, 2.0, 2.5, 5.0, 10.0) if k * power >= 0.999 * value))
