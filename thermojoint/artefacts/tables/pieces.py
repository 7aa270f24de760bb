"""Rows of a log as they arrive, in SI, in pieces, with a report on what was read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.date_orders import WEEK, shorter_order, two_orders
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.log_record import Record, with_times
from thermojoint.artefacts.quantities import Column
from thermojoint.artefacts.tables.cells import numbers, without_error_values
from thermojoint.artefacts.tables.clock import (
    FORMS,
    LATEST,
    Hands,
    by_other_orders,
    in_order,
    moment,
    passed,
)
from thermojoint.artefacts.tables.dialect import Row, rows_of
from thermojoint.artefacts.tables.layout import HEAD, Layout, layout_of

#: Rows in a piece.
ROWS = 1 << 15
#: A median in this range is a temperature in K, not in °C.
_KELVIN = (223.0, 400.0)
#: Limit on thermal displacements, m.
_LARGEST_LENGTH = 0.05
_YEAR = 3.156e7  # s
#: A clock that returns to its start has restarted if at least this many rows precede.
_FEWEST = 3


class _At(NamedTuple):
    """Progress within a run: first time, number of rows so far, previous row."""

    hands: Hands = Hands()
    first: float = np.inf
    rows: int = 0
    before: Row = Row(0, [])


class _Part(NamedTuple):
    """Consecutive rows of one run, their times (s), the time before them, and notes."""

    rows: list[Row]
    times: list[float]
    last: float
    notes: list[str]
    twice: int


def pieces_in(
    lines: Iterable[str],
    where: str,
    renamed: Mapping[str, str] | None = None,
    rows: int = ROWS,
    choose: Callable[[Sequence[str]], str] | None = None,
) -> Iterator[Log]:
    """Yield the samples of a table as its lines arrive; each piece belongs to one run.

    Parameters
    ----------
    lines : iterable of str
        An open file, standard input, or a sheet's rows.
    where : str
        Name of the file, for error messages.
    renamed : mapping, optional
        Name of a column to its new name, which ends in its unit.
    rows : int
        Largest number of samples in a piece; 1 for a stream, whose rows must not wait.
    choose : callable, optional
        Returns one of the orders of dates (`thermojoint.artefacts.date_orders.ORDERS`) that fit the
        first rows, if there are several; default the first of them.

    Raises
    ------
    InputError
        There is no clock or no reading, the length of a row differs from the header's, a cell is
        neither a number nor a missing reading, a clock goes back, two rows contradict each other,
        or values in °C look like kelvin.
    """
    source = iter(lines)
    layout, head = _begun(source, where, renamed or {}, HEAD if rows > 1 else 1)
    clock = layout.clock
    if choose is not None and clock.other_orders:
        clock = in_order(clock, choose((clock.order, *clock.other_orders)))
        layout = replace(layout, clock=clock)
    record = Record(
        where,
        layout.form,
        layout.columns,
        layout.ignored,
        clock.dated,
        local=clock.local,
        order=clock.order,
    )
    notes, at, twice = layout.notes, _At(), 0
    body = rows_of(chain(head[layout.dialect.first :], source), layout.dialect, where)
    while part := list(islice(body, rows)):
        if not layout.dialect.decimal:
            layout = layout.with_decimal(layout.decimal_in(row.cells for row in part))
        for section, after in _parts(layout, part, at):
            at, twice = after, twice + section.twice
            notes = (*notes, *section.notes)
            if section.times:
                shift = after.hands.shift if clock.dated else 0.0
                here = replace(record, notes=notes, twice=twice, shift=shift)
                piece = _piece(layout, here, section)
                yield piece
                record = replace(record, interval=piece.records[0].interval)
                notes, twice = (), 0


def _begun(
    source: Iterator[str], where: str, renamed: Mapping[str, str], lines: int
) -> tuple[Layout, list[str]]:
    """Return the layout of a table and the lines read to detect it."""
    head = list(islice(source, lines))
    layout = layout_of(head, where, renamed, whole=len(head) < lines or lines > 1)
    while layout is None:
        more = next(source, None)
        head += [] if more is None else [more]
        layout = layout_of(head, where, renamed, whole=more is None or len(head) >= HEAD)
    return layout, head


def _parts(layout: Layout, rows: Sequence[Row], at: _At) -> Iterator[tuple[_Part, _At]]:
    """Yield the rows of each run with their times, and the progress after them."""
    clock, where = layout.clock, layout.where
    times = _counted(layout, rows, at)
    if times is not None:
        step = times[-1] - (times[-2] if len(times) > 1 else at.hands.last)
        hands = Hands(times[-1], 0.0, step if step < np.inf else at.hands.step)
        after = _At(hands, min(at.first, times[0]), at.rows + len(rows), rows[-1])
        yield _Part(list(rows), times, at.hands.last, [], 0), after
        return
    part = _Part([], [], at.hands.last, [], 0)
    for row in rows:
        cells = [row.cells[k] for k in clock.columns]
        read = moment(clock, cells, layout.dialect.decimal)
        if read is None:
            raise _no_time(layout, row, " ".join(cells).strip())
        hands, note = passed(clock, at.hands, read)
        if note:
            part.notes.append(f"line {row.line}: {note}")
        if clock.other_orders and at.rows:
            _check_order(layout, at, row, hands.last)
        if hands.last == at.hands.last:
            _check_twice(layout, at.before, row)
            part = part._replace(twice=part.twice + 1)
            continue
        if hands.last < at.hands.last:
            if clock.dated or at.rows < _FEWEST or hands.last > at.first + at.hands.step:
                raise InputError(
                    f"{where}, line {row.line}: the clock does not go forward (line "
                    f"{at.before.line} is later); drop the row, or put the rows in order"
                )
            yield part, at
            notes = [f"line {row.line}: time restarts: a new run"]
            part, hands = _Part([], [], -np.inf, notes, 0), Hands(read.first)
            at = _At()
        at = _At(hands, min(at.first, hands.last), at.rows + 1, row)
        part.rows.append(row)
        part.times.append(hands.last)
    yield part, at


def _counted(layout: Layout, rows: Sequence[Row], at: _At) -> list[float] | None:
    """Return the times of rows by a numeric, increasing clock; None for any other."""
    if layout.clock.form != "number":
        return None
    (k,) = layout.clock.columns
    read = numbers([row.cells[k] for row in rows], layout.dialect.decimal)
    times = read.values * layout.clock.factor / layout.clock.divisor
    if read.unreadable is None and (np.diff(times, prepend=at.hands.last) > 0.0).all():
        return list(times.tolist())
    return None


def _check_twice(layout: Layout, row: Row, other: Row) -> None:
    """Refuse two rows with the same time but different readings."""
    for k in layout.kept:
        first, second = row.cells[k].strip(), other.cells[k].strip()
        if first != second:
            raise InputError(
                f"{layout.where}, lines {row.line} and {other.line}: two rows of one time "
                f"contradict each other ({layout.names[k]}: {first!r} and {second!r}), the clock "
                "does not go forward; drop one"
            )


def _check_order(layout: Layout, at: _At, row: Row, time: float) -> None:
    """Refuse a row at `time` (s), weeks after the row before it only by the order of its date."""
    step = time - at.hands.last
    if 0.0 < step <= WEEK:
        return
    clock, decimal = layout.clock, layout.dialect.decimal
    cells = [[one.cells[k] for k in clock.columns] for one in (at.before, row)]
    order, other = shorter_order(step, *(by_other_orders(clock, one, decimal) for one in cells))
    if order:
        before, after = (repr(" ".join(one).strip()) for one in cells)
        raise InputError(
            f"{layout.where}, line {row.line}: from {before} to {after} "
            f"{two_orders((clock.order, step), (order, other))}"
        )


def _no_time(layout: Layout, row: Row, text: str) -> InputError:
    clock = " + ".join(layout.names[k] for k in layout.clock.columns)
    if not text:
        return InputError(f"{layout.where}, line {row.line}: the time is missing; drop the row")
    # The order of the dates was taken from the first rows.
    read = f" ({layout.clock.shown})" if layout.clock.order else ""
    return InputError(
        f"{layout.where}, line {row.line}: {clock} is {text!r}, no time like those before it"
        f"{read}; write one of {FORMS}"
    )


def _piece(layout: Layout, record: Record, part: _Part) -> Log:
    missing = Counter[tuple[str, str]]()
    values = np.empty((len(part.rows), len(layout.kept)))
    cells_by_column = list(zip(*(row.cells for row in part.rows), strict=True))
    for j, (k, column) in enumerate(zip(layout.kept, layout.columns, strict=True)):
        read = numbers(cells_by_column[k], layout.dialect.decimal)
        if read.unreadable is not None:
            row = part.rows[read.unreadable]
            raise InputError(
                f"{layout.where}, line {row.line}: {column.name} is {row.cells[k].strip()!r}, "
                "not a number; write it like 20.5 or 20,5, and leave the cell empty if the "
                "reading is missing"
            )
        good, wrong = without_error_values(read.values, column.quantity)
        for token, count in (read.missing + wrong).items():
            missing[column.name, token] += count
        if len(good) > 1 or not np.isfinite(part.last):
            _check_unit(layout.where, column, good)
        values[:, j] = column.to_si(good)
    times = np.array(part.times)
    _check_clock(layout, part.rows, times)
    record = with_times(replace(record, missing=missing), times, part.last)
    if layout.clock.other_orders:
        record = replace(record, by_other_orders=_ends_by_other_orders(layout, part.rows))
    return Log(times, layout.columns, values, records=(record,))


def _ends_by_other_orders(layout: Layout, rows: Sequence[Row]) -> dict[str, tuple[float, float]]:
    """Return the times of the first and the last row, s, by each other order of their dates."""
    first, last = (
        by_other_orders(
            layout.clock, [row.cells[k] for k in layout.clock.columns], layout.dialect.decimal
        )
        for row in (rows[0], rows[-1])
    )
    return {order: (first[order], last[order]) for order in first.keys() & last.keys()}


def _check_clock(layout: Layout, rows: Sequence[Row], times: Array) -> None:
    """Refuse damaged times, and those in another unit than the name of their column says."""
    for k in np.flatnonzero(np.abs(times) > LATEST)[:1].tolist():
        names = " + ".join(layout.names[c] for c in layout.clock.columns)
        text = " ".join(rows[k].cells[c] for c in layout.clock.columns).strip()
        raise InputError(
            f"{layout.where}, line {rows[k].line}: {names} is {text!r}, which would be "
            f"{times[k] / _YEAR:.3g} years; correct it, or rename the clock with its unit, as "
            "time if it counts ms or µs since 1970"
        )


def _check_unit(where: str, column: Column, values: Array) -> None:
    """Refuse values in the wrong unit: kelvin in a column of °C, micrometres in one of metres."""
    there = values[np.isfinite(values)]
    if not there.size:
        return
    middle = float(np.median(there))
    if column.unit == "degC" and _KELVIN[0] < middle < _KELVIN[1]:
        raise InputError(
            f"{where}: {column.name} is about {middle:.0f}, kelvin and not °C; rename "
            f"it: --column '{column.name}={column.base}_K'"
        )
    far = abs(float(column.to_si(np.array(middle)))) > _LARGEST_LENGTH
    if far and column.is_displacement:
        raise InputError(
            f"{where}: {column.name} is about {middle:g}: more than "
            f"{1e3 * _LARGEST_LENGTH:.0f} mm is not a thermal displacement; rename it with its "
            "unit, a position like y_pos_mm, and an odometer like y_way_mm"
        )
