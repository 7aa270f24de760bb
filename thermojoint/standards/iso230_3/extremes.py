"""Minimum and maximum of a signal within a period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Extremes:
    """Extremes of a signal.

    Attributes
    ----------
    low, high : float
        In the signal's unit.
    low_at, high_at : float
        When, s.
    """

    low: float
    high: float
    low_at: float
    high_at: float

    @property
    def range(self) -> float:
        """Highest minus lowest value."""
        return self.high - self.low


def extremes(times: Array, values: Array, begin: float, end: float, name: str) -> Extremes:
    """Return the extremes of a signal within a period, its ends included.

    Samples are joined by straight lines, so that the ends of the period need not be samples.

    Parameters
    ----------
    times : ndarray, shape (n,)
        s, strictly increasing.
    values : ndarray, shape (n,)
        NaN where nothing was read.
    begin, end : float
        s.
    name : str
        Of the signal, for the error message.

    Raises
    ------
    InputError
        Fewer than two values were read, or none near an end of the period: what was read does not
        cover it.
    """
    read = np.isfinite(values)
    t, v = times[read], values[read]
    if t.size < 2 or t[0] > begin or t[-1] < end:
        covered = f"{t[0]:g} to {t[-1]:g} s" if t.size else "nothing"
        raise InputError(
            f"{name}: read over {covered}, the test asks for {begin:g} to {end:g} s; give a longer "
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
