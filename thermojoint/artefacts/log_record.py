"""Report on a log that was read: columns, clock, pauses, missing and ignored data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.quantities import Column

#: A pause is longer than this number of intervals, and than this time, s.
PAUSE, SHORTEST_PAUSE = 5.0, 60.0
#: Largest number of pauses that are listed.
_SHOWN = 3
_NAMES_SHOWN = 12


@dataclass(frozen=True)
class Record:
    """Report on one file."""

    #: Name of the file.
    where: str
    #: Encoding, separator and clock in words.
    form: str = ""
    #: The readings.
    columns: tuple[Column, ...] = ()
    #: Columns whose names do not end in a unit, and further clocks.
    ignored: tuple[str, ...] = ()
    #: Whether times are s since 1970.
    dated: bool = False
    #: Whether times are local, in an unknown zone.
    local: bool = False
    #: Order in which dates were read, a key of `thermojoint.artefacts.date_orders.ORDERS`.
    order: str = ""
    #: Each other order that fits the first dates to the time of the first and of the last row, s.
    by_other_orders: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: Shift of the last row by changes of summer time, s.
    shift: float = 0.0
    #: Number of rows used.
    rows: int = 0
    #: Time of the first and of the last row, s.
    first: float = float("nan")
    last: float = float("nan")
    #: Median of the steps in the first rows, s; NaN for a single row.
    interval: float = float("nan")
    #: Start and end of each pause: a time without rows much longer than the interval, s.
    pauses: tuple[tuple[float, float], ...] = ()
    #: (column, text in place of a reading) to the number of occurrences.
    missing: Mapping[tuple[str, str], int] = field(default_factory=dict)
    #: Number of repeated rows, which were dropped.
    twice: int = 0
    #: Further assumptions and ignored data.
    notes: tuple[str, ...] = ()

    @property
    def orders(self) -> tuple[str, ...]:
        """Orders that fit the first dates, that in which they were read first; none without one."""
        return (self.order, *self.by_other_orders) if self.order else ()


def with_times(record: Record, times: Array, last: float) -> Record:
    """Return a record with the times of its rows.

    Parameters
    ----------
    record : Record
        For consecutive rows of a run.
    times : ndarray, shape (k,)
        Of the rows, s, one or more.
    last : float
        Time of the previous row, s; -inf for none.
    """
    before = np.concatenate(([last], times[:-1]))
    steps = (times - before)[np.isfinite(before)]
    interval = record.interval
    if not interval > 0.0 and len(steps):
        interval = float(np.median(steps))
    long = are_pauses(times - before, interval)
    pauses = [
        (float(begin), float(end))
        for begin, end in zip(before[long], times[long], strict=True)
        if np.isfinite(begin)
    ]
    return replace(
        record,
        rows=len(times),
        first=float(times[0]),
        last=float(times[-1]),
        interval=interval,
        pauses=tuple(pauses),
    )


def are_pauses(steps: Array, interval: float) -> Flags:
    """Return which steps between rows (k,), s, are pauses: much longer than the usual interval.

    Parameters
    ----------
    steps : ndarray, shape (k,)
        s.
    interval : float
        Usual step, s.
    """
    return np.asarray(steps > max(PAUSE * interval, SHORTEST_PAUSE))


def moved(record: Record, seconds: float) -> Record:
    """Return a record of rows that are later by a number of seconds."""
    return replace(
        record,
        shift=record.shift + seconds,
        first=record.first + seconds,
        last=record.last + seconds,
        pauses=tuple((begin + seconds, end + seconds) for begin, end in record.pauses),
    )


def merged(records: Iterable[Record]) -> tuple[Record, ...]:
    """Return one record for each file from the records of its parts, in the order of reading."""
    records_by_file: dict[str, Record] = {}
    for record in records:
        known = records_by_file.get(record.where)
        records_by_file[record.where] = record if known is None else _both(known, record)
    return tuple(records_by_file.values())


def _both(record: Record, more: Record) -> Record:
    return replace(
        record,
        rows=record.rows + more.rows,
        first=record.first if record.rows else more.first,
        last=more.last if more.rows else record.last,
        shift=more.shift if more.rows else record.shift,
        interval=record.interval if record.interval > 0.0 else more.interval,
        pauses=record.pauses + more.pauses,
        missing=Counter(record.missing) + Counter(more.missing),
        twice=record.twice + more.twice,
        notes=tuple(dict.fromkeys((*record.notes, *more.notes))),
    )


def described(records: Sequence[Record]) -> list[str]:
    """Return the report of every command on its logs, line by line."""
    return [
        line
        for record in records
        for line in (
            f"{record.where}: {record.rows} rows, {_span(record)}; {record.form}",
            *_columns(record),
            *_found(record),
            *_notes(record),
        )
    ]


def begun(record: Record) -> list[str]:
    """Return the report at the first row of a stream, line by line: its columns and clock."""
    return [f"{record.where}: {record.form}", *_columns(record), *_notes(record)]


def ended(record: Record) -> list[str]:
    """Return the report at the end of a stream, line by line: length, pauses, missing readings."""
    return [f"{record.where}: {record.rows} rows, {_span(record)}", *_found(record)]


def noticed(record: Record, before: Record) -> list[str]:
    """Return the new findings in the latest rows of a stream since those `before`, line by line."""
    fresh = {key: count for key, count in record.missing.items() if key not in before.missing}
    return [*_found(replace(record, missing=fresh, twice=0)), *_notes(record)]


def _notes(record: Record) -> list[str]:
    return [f"  {note}" for note in record.notes]


def _columns(record: Record) -> list[str]:
    columns = ", ".join(
        f"{c.name} ({c.quantity}{'' if c.name.endswith(c.unit) else f', {c.unit}'})"
        for c in record.columns[:_NAMES_SHOWN]
    )
    more = len(record.columns) - _NAMES_SHOWN
    lines = [f"  columns: {columns}{f' and {more} more' if more > 0 else ''}"]
    if record.ignored:
        lines.append(
            f"  ignored, no unit in the name: {', '.join(record.ignored)[:200]} "
            "(--column 'NAME=NAME_degC' names one)"
        )
    return lines


def _found(record: Record) -> list[str]:
    lines = [f"  {_pauses(record)}"] if record.pauses else []
    missing: dict[str, list[str]] = {}
    for (name, token), count in record.missing.items():
        missing.setdefault(name, []).append(f"{count} x {token}")
    for name, tokens in list(missing.items())[:_NAMES_SHOWN]:
        lines.append(f"  {name}: readings missing: {', '.join(tokens[:6])}")
    if record.twice:
        lines.append(f"  repeated rows, dropped: {record.twice}")
    return lines


def _span(record: Record) -> str:
    if not record.rows:
        return "none"
    interval = f", every {_length(record.interval)}" if record.interval > 0.0 else ""
    begin, end = (moment_text(record, time) for time in (record.first, record.last))
    return f"{begin} to {end}{interval}"


def moment_text(record: Record, time: float) -> str:
    """Return a time of a log as text: a date, or the time since the clock's zero."""
    if not record.dated:
        return _length(time)
    at = datetime.fromtimestamp(time, UTC)
    return at.strftime("%Y-%m-%d %H:%M:%S")


def _pauses(record: Record) -> str:
    longest = sorted(record.pauses, key=lambda pause: pause[0] - pause[1])[:_SHOWN]
    listed = ", ".join(
        f"{_length(end - begin)} from {moment_text(record, begin)}" for begin, end in longest
    )
    days = ""
    if record.dated:
        changed = sum(int(begin // 86_400) != int(end // 86_400) for begin, end in record.pauses)
        days = f", over a change of the day: {changed}" if changed else ""
    count = len(record.pauses)
    kind = "pause" if count == 1 else "pauses"
    longest_of = "" if count <= _SHOWN else "; the longest"
    return f"{count + 1} runs, {count} {kind}{days}{longest_of}: {listed}"


def _length(seconds: float) -> str:
    for unit, size in (("d", 86_400.0), ("h", 3600.0), ("min", 60.0)):
        if abs(seconds) >= 2.0 * size:
            return f"{seconds / size:.4g} {unit}"
    return f"{seconds:.4g} s"
