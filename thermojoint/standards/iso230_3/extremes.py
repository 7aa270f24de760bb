"""Minimum and maximum of a signal within a period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Extremes:
    """Extremes of a signal."""

    #: Values in the signal's unit.
    low: float
    high: float
    #: Their times, s.
    low_at: float
    high_at: float

    @property
    def range(self) -> float:
        """Highest minus lowest value."""
        return self.high - self.low


def extremes(times: Array, values: Array, begin: float, end: float, name: str) -> Extremes:
    """Return the extremes of a signal within a period, including its ends.

    The signal is interpolated linearly, so that the ends of the period need not be samples.

    Parameters
    ----------
    times : ndarray, shape (n,)
        s, strictly increasing.
    values : ndarray, shape (n,)
        NaN for missing readings.
    begin, end : float
        s.
    name : str
        Name of the signal for the error message.

    Raises
    ------
    InputError
        There are fewer than two values, or they do not cover the period.
    """
    read = np.isfinite(values)
    t, v = times[read], values[read]
    if t.size < 2 or t[0] > begin or t[-1] < end:
        covered = f"{t[0]:g} to {t[-1]:g} s" if t.size else "nothing"
        raise InputError(
            f"{name}: read over {covered}, the test needs {begin:g} to {end:g} s; give a longer "
            "record or another period"
        )
    inside = (t > begin) & (t < end)
    t = np.concatenate(([begin], t[inside], [end]))
    v = np.concatenate(
        (
            [np.interp(begin, times[read], values[read])],
            v[inside],
            [np.interp(end, times[read], values[read])],
        )
    )
    low, high = int(v.argmin()), int(v.argmax())
    return Extremes(float(v[low]), float(v[high]), float(t[low]), float(t[high]))
