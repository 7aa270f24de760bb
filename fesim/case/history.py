"""Histories of heat inputs, relative to the reference step, and of temperatures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.tables.columns import read_columns

#: Relative to the largest value, the distance below which knots are on a straight line; relative to
#: the end of a step, the one below which they are at that end.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class History:
    """A quantity as a function of time: linear between knots, constant before and after them."""

    #: Shape (n,): times of the knots, strictly increasing, s.
    times: Array
    #: Shape (n,): values at these times.
    values: Array

    def __call__(self, time: Array) -> Array:
        """Return the values at given times, s."""
        return np.asarray(np.interp(time, self.times, self.values))

    def integral(self, time: Array) -> Array:
        """Return the integral from the first knot to given times, s."""
        inside = np.clip(time, self.times[0], self.times[-1])
        at = np.searchsorted(self.times, inside, side="right") - 1
        whole = self._at_knots[at]
        part = 0.5 * (inside - self.times[at]) * (self.values[at] + self(inside))
        outside = (time - inside) * self(np.asarray(time))
        return np.asarray(whole + part + outside)

    @cached_property
    def _at_knots(self) -> Array:
        """The integral up to each knot."""
        pieces = 0.5 * np.diff(self.times) * (self.values[1:] + self.values[:-1])
        return np.concatenate([np.zeros(1), np.cumsum(pieces)])


@dataclass(frozen=True, eq=False)
class Histories:
    """Several functions of time: linear between common knots, constant after the last."""

    #: Shape (n,): times of the knots, strictly increasing, s; the first is zero.
    times: Array
    #: Shape (n, k): values at these times.
    values: Array

    def __call__(self, time: float | Array) -> Array:
        """Return the values (k,) at a time, s, or (t, k) at times (t,)."""
        at = np.searchsorted(self.times, time, side="right") - 1
        after = np.minimum(at + 1, len(self.times) - 1)
        span = np.where(after > at, self.times[after] - self.times[at], 1.0)
        share = ((time - self.times[at]) / span)[..., None]
        return np.asarray(self.values[at] + share * (self.values[after] - self.values[at]))


def common_knots(histories: Sequence[History]) -> Array:
    """Return time zero and every later time at which the slope of a history may change, s.

    Knots between equal values are left out.
    """
    knots = [np.zeros(1)]
    for history in histories:
        ends = np.concatenate([history.values[:1], history.values, history.values[-1:]])
        still = (ends[:-2] == ends[1:-1]) & (ends[1:-1] == ends[2:])
        knots.append(history.times[~still & (history.times > 0.0)])
    return np.unique(np.concatenate(knots))


@lru_cache(maxsize=64)
def bent_steps(history: History, step: float) -> NDArray[np.int64]:
    """Return the numbers of the steps within which a history is not linear, in ascending order.

    Step k ends at k times `step` (s); the values at its ends do not determine the history within.
    """
    knots, number = _within_steps(history.times[history.times > 0.0], step)
    if not knots.size:  # e.g. a step input, different in every case of a study
        return np.empty(0, dtype=np.int64)
    before, after = history((number - 1.0) * step), history(number * step)
    line = before + (after - before) * (knots / step - (number - 1.0))
    off = np.abs(history(knots) - line) > ROUNDING * float(np.abs(history.values).max())
    return np.unique(number[off]).astype(np.int64)


def mean_over_steps(history: History, step: float, ends: Array) -> Array:
    """Return the value of a history in each step: its mean if it is not linear within the step.

    In all other steps it is the value at the end, as in the implicit Euler method.

    Parameters
    ----------
    history : History
        Input of a march.
    step : float
        Length of a step, s.
    ends : ndarray, shape (n,)
        Ends of steps, multiples of `step`, s; zero is the start.

    Returns
    -------
    ndarray, shape (n,)
        Values in the unit of the history.
    """
    return _with_means(
        history, step, ends, np.isin(np.rint(ends / step), bent_steps(history, step))
    )


def entering_in_steps(history: History, step: float, ends: Array) -> Array:
    """Return the value of a history in each step such that the sum over all steps is exact.

    For a history that is not linear within some step, the mean is used in every step: if linear
    steps used the value at their end, their sum would be ahead by an amount that one of the others
    would have to correct. Arguments and result as for `mean_over_steps`.
    """
    bends = bent_steps(history, step).size > 0
    return _with_means(history, step, ends, (ends > 0.0) & bends)


def _with_means(history: History, step: float, ends: Array, where: NDArray[np.bool_]) -> Array:
    """Values at the ends of steps; means over the steps selected by `where` (n,)."""
    values, last = history(ends), ends[where]
    if last.size:
        values[where] = (history.integral(last) - history.integral(last - step)) / step
    return values


def reversals(
    histories: Sequence[History], step: float, ends: Array
) -> dict[int, NDArray[np.float64]]:
    """Return reversals of histories within a step, which the values at its ends do not show.

    From an index in `ends` to the times (k,) inside that step, s, in ascending order; `step` and
    `ends` as for `mean_over_steps`.
    """
    turning = [_turning(history) for history in histories]
    times, number = _within_steps(np.unique(np.concatenate([np.empty(0), *turning])), step)
    at = {int(one): k for k, one in enumerate(np.rint(ends / step))}
    steps = [int(one) for one in np.unique(number) if int(one) in at]
    return {at[one]: times[number == one] for one in steps}


def _within_steps(times: Array, step: float) -> tuple[Array, Array]:
    """Return the times that lie within steps, s, and the numbers of these steps."""
    places = times / step
    inside = np.abs(places - np.rint(places)) > ROUNDING * np.maximum(places, 1.0)
    return times[inside], np.ceil(places[inside])


def _turning(history: History) -> Array:
    """Times after zero at which a history stops rising or stops falling, s."""
    slopes = np.sign(np.concatenate([np.zeros(1), np.diff(history.values), np.zeros(1)]))
    turns = (slopes[1:] != slopes[:-1]) & (slopes[:-1] != 0.0)
    return np.asarray(history.times[turns & (history.times > 0.0)])


def step_history(level: float) -> History:
    """Heat input `level` from time zero on."""
    return History(np.zeros(1), np.array([level]))


def ramp_history(level: float, duration: float) -> History:
    """Rise from zero to `level` within `duration` (s), then hold."""
    return sampled_history(np.array([0.0, duration]), np.array([0.0, level]))


def triangle_history(peak: float, duration: float) -> History:
    """Rise to `peak` at half of `duration` (s), fall to zero at its end, and stay there."""
    return sampled_history(np.array([0.0, duration / 2, duration]), np.array([0.0, peak, 0.0]))


def sampled_history(times: Array, values: Array, where: str = "history") -> History:
    """Linear interpolation between samples, constant outside.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Strictly increasing, s.
    values : ndarray, shape (n,)
        Heat input relative to the reference step.
    where : str
        Source of the samples, for the error message.

    Raises
    ------
    InputError
        Times that do not increase, or values that are not finite.
    """
    if times.shape != values.shape or times.ndim != 1 or times.size == 0:
        raise InputError(f"{where}: needs as many times as values, one or more")
    bad = np.flatnonzero(~(np.isfinite(times) & np.isfinite(values)))
    if bad.size:
        raise InputError(f"{where}: sample {bad[0] + 1} is not finite; remove or correct it")
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if back.size:
        i = int(back[0]) + 1
        swapped = "; perhaps the columns are swapped" if (np.diff(values) > 0.0).all() else ""
        raise InputError(
            f"{where}: time {times[i]:g} s of sample {i + 1} does not come after "
            f"{times[i - 1]:g} s; times must increase strictly{swapped}"
        )
    return History(times, values)


def read_history(path: Path, column: str = "heat_input") -> History:
    """Read a history from a CSV file; see `read_samples` and `sampled_history`."""
    return sampled_history(*read_samples(path, column), str(path))


def read_samples(path: Path, column: str) -> tuple[Array, Array]:
    """Read times (s) and values from a CSV file with the columns ``time_s`` and `column`.

    Raises
    ------
    UnreadableError
        The file is missing or cannot be opened.
    InputError
        A column is missing, or a value is not a number.
    """
    columns = read_columns(path, ("time_s", column), "history")
    return columns["time_s"], columns[column]
