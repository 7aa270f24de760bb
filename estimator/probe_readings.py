"""Occasional displacement readings, e.g. by a touch probe, merged with samples."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from estimator.intake import axis_name
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.log_file import read_log
from thermojoint.artefacts.log_sequence import check_orders, check_zones
from thermojoint.artefacts.quantities import column_named
from thermojoint.artefacts.tables.clock import tells_date


def read_probe_readings(path: Path, axes: Sequence[str]) -> tuple[Array, Array]:
    """Read a CSV with the columns ``time_s`` and ``AXIS_um`` of the measured axes.

    An axis with its unit, like a log column, is a column name itself, in this unit or another.

    Returns
    -------
    times : ndarray, shape (k,)
        s.
    values : ndarray, shape (k, axes)
        m; NaN where nothing was read.

    Raises
    ------
    InputError
        The file is unusable, its time restarts, or it has no column of an axis.
    """
    log = read_log([path])
    if len(log.starts) > 1:
        raise InputError(f"{path}: time restarts; give the readings of one run")
    known = {name: k for k, column in enumerate(log.columns) for name in (column.base, column.name)}
    places = [known.get(axis, known.get(axis_name(axis))) for axis in axes]
    if all(place is None for place in places):
        wanted = ", ".join(axis if column_named(axis) else f"{axis}_um" for axis in axes)
        raise InputError(f"{path}: no reading of a displacement; name its columns {wanted}")
    values = np.full((len(log.times), len(axes)), np.nan)
    for k, (axis, place) in enumerate(zip(axes, places, strict=True)):
        if place is not None:
            column = log.columns[place]
            if column.quantity != "length":
                raise InputError(
                    f"{path}: {column.name} is a {column.quantity}; name the column {axis}_um"
                )
            values[:, k] = log.values[:, place]
    return log.times, values


def beside(pieces: Iterable[Log], readings: Path) -> Iterator[Log]:
    """Yield the pieces of a log that is estimated with a CSV of readings.

    Raises
    ------
    InputError
        Only one of the clocks has a time zone, or their dates are read in two orders.
    """
    for number, piece in enumerate(pieces):
        if number == 0:
            record = read_log([readings]).records[0]
            check_zones(record, piece.records[0])
            check_orders(record, piece.records[0])
        yield piece


def with_probe_readings(
    samples: Iterable[Sequence[float]],
    times: Array,
    values: Array,
    places: int = 0,
    after: float = math.nan,
) -> Iterator[tuple[float, ...]]:
    """Yield every sample with the readings since the previous one, NaN for none.

    At the end, a warning if a run that is not continued had none.

    Parameters
    ----------
    samples : iterable of sequences
        Time (s) and values.
    times : ndarray, shape (k,)
        Of the readings, s, increasing. Readings before the first sample are ignored.
    values : ndarray, shape (k, axes + places)
        m.
    places : int
        Number of columns at the end with the positions where the others were read.
    after : float
        Time of the sample before the first one, s, since which readings count; NaN for none.

    Raises
    ------
    InputError
        Only one of the clocks has a date.
    """
    remaining = iter(samples)
    first = next(remaining, None)
    if first is None:
        return
    if len(times) and tells_date(first[0]) != tells_date(float(times[0])):
        raise InputError(
            f"readings: their clock begins at {times[0]:.15g} s, that of the samples at "
            f"{first[0]:.15g} s: only one has a date; give both the same clock"
        )
    if math.isnan(after):
        at = int(np.searchsorted(times, first[0], "left"))
    else:
        at = int(np.searchsorted(times, after, "right"))
    begun, time = at, first[0]
    for time, *rest in chain([first], remaining):
        end = int(np.searchsorted(times, time, "right"))
        latest = np.full(values.shape[1], np.nan)
        for row in values[at:end]:
            latest = _with_row(latest, row, values.shape[1] - places)
        at = max(at, end)
        yield (time, *rest, *map(float, latest))
    if math.isnan(after) and len(times) and at == begun:
        warnings.warn(
            f"readings: none, from {times[0]:.15g} s to {times[-1]:.15g} s, is between the first "
            f"sample, at {first[0]:.15g} s, and the last, at {time:.15g} s, and none corrects the "
            "estimate; give both the same clock",
            stacklevel=2,
        )


def _with_row(latest: Array, row: Array, axes: int) -> Array:
    """Return the latest readings after a further row; those from another place are dropped."""
    if not np.isfinite(row[:axes]).any():
        return latest
    moved = np.isfinite(row[axes:]) & np.isfinite(latest[axes:]) & (row[axes:] != latest[axes:])
    return row if moved.any() else np.where(np.isfinite(row), row, latest)
