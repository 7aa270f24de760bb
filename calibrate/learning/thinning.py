"""Averaging of a log over equal intervals to a bounded size, without spikes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from calibrate.learning.rules import Thinning
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log, runs_in
from thermojoint.artefacts.quantities import Column

if TYPE_CHECKING:
    import pandas as pd

#: Quantities that drive heat: by their magnitude, whatever their sign.
DRIVES = frozenset({"speed", "feed", "power", "current", "torque", "load"})


@dataclass(frozen=True, eq=False)
class Table:
    """Means of a log over intervals."""

    #: Shape (k,): mean time of the samples in each interval, s.
    times: Array
    #: As in the log.
    columns: tuple[Column, ...]
    #: Shape (k, columns): SI; NaN where nothing was read. For `DRIVES` the mean magnitude, with the
    #: sign of the mean.
    values: Array
    #: First row of each run.
    starts: tuple[int, ...]
    #: Usual step between rows, s: that of the logger where it is slower than the means.
    interval: float
    #: Of the log.
    samples: int
    #: Shape (columns,): removed samples, and missing ones.
    spikes: Array
    missing: Array
    #: Shape (columns,): smallest change from one sample to the next, SI: one step of a display.
    steps: Array
    #: Index of the run that was given last.
    last: int = -1

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return [column.name for column in self.columns]

    def runs(self) -> list[slice]:
        """Return the rows of each run."""
        return [slice(*ends) for ends in pairwise([*self.starts, len(self.times)])]


def in_one_order(table: Table) -> Table:
    """Return a table with its runs sorted by length and content, in whatever order they were given.

    Blocks of time that are held out are blocks of its rows: without this, they and the model would
    depend on the order of the runs.
    """

    def content(k: int) -> tuple[int, bytes, bytes]:
        times, values = table.times[runs[k]], table.values[runs[k]]
        return len(times), times.tobytes(), values.tobytes()

    runs = table.runs()
    order = sorted(range(len(runs)), key=content)
    rows = np.concatenate([np.arange(len(table.times))[runs[k]] for k in order])
    ends = np.cumsum([runs[k].stop - runs[k].start for k in order])
    return replace(
        table,
        times=table.times[rows],
        values=table.values[rows],
        starts=(0, *ends[:-1].tolist()),
        last=order.index(range(len(runs))[table.last]),
    )


def thinned(
    pieces: Iterable[Log],
    names: Sequence[str] = (),
    rules: Thinning | None = None,
    still: Sequence[str] = (),
) -> Table:
    """Return the table of a log that is read in pieces; memory is bounded by that of the table.

    Parameters
    ----------
    pieces : iterable of Log
        In the order of time (`thermojoint.artefacts.log_file.log_pieces`).
    names : sequence of str
        Columns to keep, with their units; none for all.
    rules : Thinning, optional
        Intervals, rows, and definition of a spike.
    still : sequence of str, optional
        Displacements read at one place: their spikes are removed, too, as those of temperatures and
        speeds are.

    Raises
    ------
    InputError
        There is no sample, or a column is missing.
    """
    rules = rules or Thinning()
    interval = rules.interval
    rows: list[tuple[float, Array]] = []
    starts: list[int] = []
    columns: tuple[Column, ...] = ()
    samples, last = 0, np.inf
    spikes = missing = steps = np.zeros(0)
    for piece in runs_in(pieces):
        at = [piece.index(name) for name in names] if names else list(range(len(piece.columns)))
        here = tuple(piece.columns[k] for k in at)
        if not columns:
            columns, spikes, missing = here, np.zeros(len(at)), np.zeros(len(at))
            steps = np.full(len(at), np.inf)
        if here != columns:
            raise InputError("log: a file has other columns than the first; rename them")
        if not piece.times[0] > last:
            starts.append(len(rows))
        last = float(piece.times[-1])
        samples += len(piece.times)
        values = piece.values[:, at]
        missing += np.isnan(values).sum(axis=0)
        still_here = {piece.columns[piece.index(name)].name for name in still}
        values, counts = without_spikes(piece.times, values, here, still_here, rules)
        spikes += counts
        steps = np.minimum(steps, _smallest_changes(values))
        driving = np.array([column.quantity in DRIVES for column in here])
        rows.extend(_means(piece.times, values, interval, driving))
        while len(rows) > rules.most_rows:
            interval *= 2.0
            rows, starts = _coarser(rows, starts, interval, driving)
    if not rows:
        raise InputError("log: no samples; give a file with a header and rows")
    times = np.array([time for time, _ in rows])
    return Table(
        times,
        columns,
        np.array([values for _, values in rows]),
        tuple(dict.fromkeys(starts or [0])),
        _usual_step(times, interval, rules.uneven),
        samples,
        spikes,
        missing,
        steps,
    )


def _smallest_changes(values: Array) -> Array:
    """Return the smallest change between successive values (k, columns) that is not zero."""
    changes = np.abs(np.diff(values, axis=0))
    return np.asarray(np.where(changes > 0.0, changes, np.inf).min(axis=0, initial=np.inf))


def _usual_step(times: Array, interval: float, uneven: float) -> float:
    steps = np.diff(times)
    steps = steps[steps > 0.0]
    slower = float(np.median(steps)) if steps.size else 0.0
    # Mean times of uneven samples vary around the interval.
    return slower if slower > uneven * interval else interval


def without_spikes(
    times: Array, values: Array, columns: Sequence[Column], still: Collection[str], rules: Thinning
) -> tuple[Array, Array]:
    """Return values with NaN for spikes, and the number of spikes of each column.

    Parameters
    ----------
    times : ndarray, shape (k,)
        s.
    values : ndarray, shape (k, columns)
        SI.
    columns : sequence of Column
        Temperatures and speeds have spikes.
    still : collection of str
        Displacements that have spikes, too; where a drive changes, only those far outside the range
        of the others.
    rules : Thinning
        What a spike is.
    """
    spikes = np.zeros(values.shape, dtype=bool)
    # A value may flicker by one step of its display.
    shown = np.minimum(_smallest_changes(values), rules.coarsest_display)
    for k, column in enumerate(columns):
        if column.quantity == "temperature":
            least = rules.least_spike + float(shown[k])
            spikes[:, k] = _beyond_neighbours(times, values[:, k], least, rules)
        elif column.quantity == "speed":
            spikes[:, k] = _never_held(values[:, k], rules)
        elif column.name in still:
            there = np.isfinite(values[:, k])
            least = rules.least_spike_length
            spikes[there, k] = _beyond_neighbours(times[there], values[there, k], least, rules)
    kept = np.where(spikes, np.nan, values)
    driving = [k for k, column in enumerate(columns) if column.quantity in DRIVES]
    # The heat and the forces of a change may move the machine at once.
    changing = _changing(kept[:, driving], rules)
    for k, column in enumerate(columns):
        if column.name in still:
            spikes[:, k] &= ~changing | _far_outside(values[:, k], kept[:, k])
    return np.where(spikes, np.nan, values), spikes.sum(axis=0).astype(float)


def spikes_of(log: Log, still: Collection[str]) -> tuple[Log, dict[str, int]]:
    """Return a log with NaN for spikes (`without_spikes`), and the columns that have some.

    Parameters
    ----------
    log : Log
        Of one or more runs.
    still : collection of str
        Names of displacements read at one place.

    Returns
    -------
    log : Log
    counts : dict
        Name of a column to the number of its spikes, one or more.
    """
    runs = [
        without_spikes(run.times, run.values, run.columns, still, Thinning()) for run in log.runs()
    ]
    counts = np.sum([found for _, found in runs], axis=0).astype(int).tolist()
    return (
        replace(log, values=np.concatenate([values for values, _ in runs])),
        {name: count for name, count in zip(log.names, counts, strict=True) if count},
    )


def _beyond_neighbours(times: Array, values: Array, least: float, rules: Thinning) -> Flags:
    """Return which values are above, or below, both those before and after them."""
    import pandas as pd

    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    column = pd.Series(values)
    before, after = _sides(column, rules)
    over, under = column - before.fillna(after), column - after.fillna(before)
    usual = over.abs().rolling(20 * rules.neighbours, center=True, min_periods=3).median()
    # At the end of a run there is one side only, and the first readings of a warm-up are steep.
    moves, count = column.diff().abs(), rules.neighbours - 1
    steep = moves[::-1].rolling(count, min_periods=1).max()[::-1].shift(-2).where(before.isna())
    steep = steep.fillna(moves.rolling(count, min_periods=1).max().shift(1).where(after.isna()))
    usual = np.maximum(usual, steep.fillna(0.0))
    limit = np.maximum(rules.spike * usual, least * max(1.0, step / rules.interval))
    # A corner or a ramp lies above one side and below the other, or near one of them.
    spike = ((over > limit) & (under > limit)) | ((over < -limit) & (under < -limit))
    return np.asarray(spike.to_numpy())


def _sides(column: pd.Series, rules: Thinning) -> tuple[pd.Series, pd.Series]:
    """Return the medians of the values before and after each one."""
    before = column.rolling(rules.neighbours, min_periods=2).median().shift(1)
    after = column[::-1].rolling(rules.neighbours, min_periods=2).median().shift(1)[::-1]
    return before, after


def _far_outside(values: Array, kept: Array) -> Flags:
    """Return which values are further outside the range of those kept than this is wide."""
    there = kept[np.isfinite(kept)]
    if not there.size:
        return np.zeros(values.shape, dtype=bool)
    low, high = float(there.min()), float(there.max())
    return np.asarray(np.abs(values - 0.5 * (low + high)) > 1.5 * (high - low))


def _never_held(speeds: Array, rules: Thinning) -> Flags:
    """Return which speeds are far above every one that was held; none if these are many."""
    import pandas as pd

    sizes = pd.Series(np.abs(speeds)).dropna()
    held = float(sizes.rolling(rules.held, center=True).median().max())
    far = np.abs(speeds) > rules.beyond_held * held
    return far if held > 0.0 and far.mean() <= rules.seldom else np.zeros_like(far)


def _changing(drives: Array, rules: Thinning) -> Flags:
    """Return at which rows a drive (k, drives) differs from its values before or after, (k,)."""
    import pandas as pd

    changing = np.zeros(len(drives), dtype=bool)
    for sizes in np.abs(drives).T:
        largest = float(np.nanmax(sizes, initial=0.0))
        for side in _sides(pd.Series(sizes), rules):
            changing |= np.abs(sizes - side.to_numpy()) > rules.changed * largest
    return changing


def _means(
    times: Array, values: Array, interval: float, driving: Flags
) -> list[tuple[float, Array]]:
    bins = np.floor(times / interval)
    edges = np.flatnonzero(np.diff(bins, prepend=np.nan) != 0.0)
    there = ~np.isnan(values)
    kept = np.where(there, values, 0.0)
    sums = np.add.reduceat(kept, edges, axis=0)
    # An axis that goes to and fro, or a motor that brakes, heats as well.
    sizes = np.add.reduceat(np.abs(kept), edges, axis=0)
    sums = np.where(driving, np.copysign(sizes, sums), sums)
    counts = np.add.reduceat(there.astype(float), edges, axis=0)
    means = np.where(counts > 0.0, sums / np.maximum(counts, 1.0), np.nan)
    middles = np.add.reduceat(times, edges) / np.diff(np.append(edges, len(times)))
    return list(zip(middles.tolist(), means, strict=True))


def _coarser(
    rows: list[tuple[float, Array]], starts: list[int], interval: float, driving: Flags
) -> tuple[list[tuple[float, Array]], list[int]]:
    """Return rows over intervals twice as long, run by run."""
    means: list[tuple[float, Array]] = []
    begins: list[int] = []
    for first, end in pairwise([*starts, len(rows)]):
        begins.append(len(means))
        times = np.array([time for time, _ in rows[first:end]])
        values = np.array([own for _, own in rows[first:end]])
        means += _means(times, values, interval, driving)
    return means, begins
