"""Histories of heat inputs, relative to the reference step, and of temperatures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.tables.columns import read_columns

History = Callable[[Array], Array]


def step_history(level: float) -> History:
    """Heat input `level` from time zero on."""
    return lambda time: np.full_like(np.asarray(time, dtype=float), level)


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
        raise InputError(f"{where}: sample {bad[0] + 1} is not finite; remove or mend it")
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if back.size:
        i = int(back[0]) + 1
        swapped = "; perhaps the columns are swapped" if (np.diff(values) > 0.0).all() else ""
        raise InputError(
            f"{where}: time {times[i]:g} s of sample {i + 1} does not come after "
            f"{times[i - 1]:g} s; times must increase strictly{swapped}"
        )
    return lambda time: np.interp(time, times, values)


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
        It is no CSV, a column is missing or a value is no number.
    """
    columns = read_columns(path, ("time_s", column), "history")
    return columns["time_s"], columns[column]
