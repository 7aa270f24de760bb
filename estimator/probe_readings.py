"""Occasional displacement readings, e.g. by a touch probe, merged with samples."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log_file import read_log
from thermojoint.artefacts.quantities import column_named


def read_probe_readings(path: Path, axes: Sequence[str]) -> tuple[Array, Array]:
    """Read a CSV with the columns ``time_s`` and ``AXIS_um`` of the measured axes.

    An axis with its unit, like a log column, is a column name itself.

    Returns
    -------
    times : ndarray, shape (k,)
        s.
    values : ndarray, shape (k, axes)
        m; NaN where nothing was read.

    Raises
    ------
    InputError
        The file is unusable, or has no column of an axis.
    """
    log = read_log([path])
    known = {name: k for k, column in enumerate(log.columns) for name in (column.base, column.name)}
    if not known.keys() & set(axes):
        wanted = ", ".join(axis if column_named(axis) else f"{axis}_um" for axis in axes)
        raise InputError(f"{path}: no reading of a displacement; name its columns {wanted}")
    values = np.full((len(log.times), len(axes)), np.nan)
    for k, axis in enumerate(axes):
        if axis in known:
            column = log.columns[known[axis]]
            if column.quantity != "length":
                raise InputError(
                    f"{path}: {column.name} is a {column.quantity}; name the column {axis}_um"
                )
            values[:, k] = log.values[:, known[axis]]
    return log.times, values


def with_probe_readings(
    samples: Iterable[Sequence[float]], times: Array, values: Array
) -> Iterator[tuple[float, ...]]:
    """Yield every sample with the readings since the previous one, NaN for none.

    Parameters
    ----------
    samples : iterable of sequences
        Time (s) and values.
    times : ndarray, shape (k,)
        Of the readings, s, increasing. Readings before the first sample are ignored.
    values : ndarray, shape (k, axes)
        m.
    """
    at = None
    for time, *rest in samples:
        if at is None:
            at = int(np.searchsorted(times, time, "left"))
        end = int(np.searchsorted(times, time, "right"))
        latest = np.full(values.shape[1], np.nan)
        for row in values[at:end]:
            latest = np.where(np.isfinite(row), row, latest)
        at = max(at, end)
        yield (time, *rest, *map(float, latest))
