"""Averaging of a log over equal intervals to a bounded size, without spikes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calibrate.learning.rules import Thinning
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log, runs_in
from thermojoint.artefacts.quantities import Column

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
    pieces: Iterable[Log], names: Sequence[str] = (), rules: Thinning | None = None
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
    spikes = missing = np.zeros(0)
    for piece in runs_in(pieces):
        at = [piece.index(name) for name in names] if names else list(range(len(piece.columns)))
        here = tuple(piece.columns[k] for k in at)
        if not columns:
            columns, spikes, missing = here, np.zeros(len(at)), np.zeros(len(at))
        if here != columns:
            raise InputError("log: a file has other columns than the first; rename them")
        if not piece.times[0] > last:
            starts.append(len(rows))
        last = float(piece.times[-1])
        samples += len(piece.times)
        values = piece.values[:, at]
        missing += np.isnan(values).sum(axis=0)
        step = float(np.median(np.diff(piece.times))) if len(piece.times) > 1 else 0.0
        slower = replace(rules, least_spike=rules.least_spike * max(1.0, step / rules.interval))
        values, counts = without_spikes(values, [column.quantity for column in here], slower)
        spikes += counts
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
    )


def _usual_step(times: Array, interval: float, uneven: float) -> float:
    steps = np.diff(times)
    steps = steps[steps > 0.0]
    slower = float(np.median(steps)) if steps.size else 0.0
    # Mean times of uneven samples vary around the interval.
    return slower if slower > uneven * interval else interval


def without_spikes(
    values: Array, quantities: Sequence[str], rules: Thinning
) -> tuple[Array, Array]:
    """Return values with NaN for spikes of temperatures, and the number of spikes of each."""
    import pandas as pd

    kept, count = values.copy(), np.zeros(values.shape[1])
    for k, quantity in enumerate(quantities):
        if quantity != "temperature":
            continue
        column = pd.Series(values[:, k])
        before = column.rolling(rules.neighbours, min_periods=2).median().shift(1)
        after = column[::-1].rolling(rules.neighbours, min_periods=2).median().shift(1)[::-1]
        over, under = column - before.fillna(after), column - after.fillna(before)
        usual = over.abs().rolling(20 * rules.neighbours, center=True, min_periods=3).median()
        limit = np.maximum(rules.spike * usual, rules.least_spike)
        # A corner or a ramp lies above one side and below the other, or near one of them.
        spike = ((over > limit) & (under > limit)) | ((over < -limit) & (under < -limit))
        kept[spike.to_numpy(), k] = np.nan
        count[k] = spike.sum()
    return kept, count


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
