"""Named columns of a small table: a history, a grid of positions, conductances over pressure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import column_named, place_of
from thermojoint.artefacts.tables.cells import numbers, without_error_values
from thermojoint.artefacts.tables.clock import (
    FORMS,
    Clock,
    Hands,
    clock_of,
    moment,
    passed,
    tells_date,
)
from thermojoint.artefacts.tables.dialect import (
    Dialect,
    Row,
    check_named_once,
    dialect_of,
    rows_of,
)
from thermojoint.artefacts.tables.layout import HEAD
from thermojoint.artefacts.tables.source import lines_of

_CLOCK = "time_s"


def read_columns(
    path: Path, wanted: Sequence[str], kind: str, optional: Sequence[str] = ()
) -> dict[str, Array]:
    """Read columns of numbers from a table in any dialect (docs/tables.md).

    Parameters
    ----------
    path : Path
        CSV, .xlsx or Parquet with a header; lines that start with ``#`` are ignored.
    wanted : sequence of str
        Required columns, by these names or with another unit of the same quantity. ``time_s`` may
        be any clock; one with a date, or of the time of day, counts from the first row.
    kind : str
        Kind of file for messages, e.g. "history".
    optional : sequence of str
        Columns that are read if present.

    Returns
    -------
    dict of str to ndarray, shape (rows,)
        In the requested units; NaN where a value is missing.

    Raises
    ------
    UnreadableError
        The file is missing or cannot be opened.
    InputError
        It is not a table, a column is missing, or a value is not a number.
    """
    path = Path(path)
    with lines_of(path, kind) as source:
        lines = list(source)
    dialect = dialect_of(lines, str(path), whole=True)
    assert dialect is not None
    check_named_once((*wanted, *optional), dialect.names, str(path))
    rows = list(rows_of(lines[dialect.first :], dialect, str(path)))
    columns: dict[str, Array] = {}
    for name in (*wanted, *optional):
        clock, bad = None, ""
        if name == _CLOCK and name not in dialect.names:
            clock, bad = clock_of(dialect.names, [row.cells for row in rows], dialect.decimal)
        if clock is not None:
            columns[name] = _times(clock, dialect, rows, str(path))
        elif (values := _column(name, dialect, rows, str(path))) is not None:
            since_1970 = name == _CLOCK and values.size > 0 and tells_date(float(values[0]))
            columns[name] = values - values[0] if since_1970 else values
        elif name in wanted:
            given = ", ".join(dialect.given)
            raise InputError(
                f"{path}: column {name!r} is missing; found {given}{f'; {bad}' if bad else ''}"
            )
    return columns


def beginning(path: Path, kind: str) -> tuple[str, float] | None:
    """Return when the first row of a table was written; None if its clock counts from a start.

    Parameters
    ----------
    path, kind
        As in `read_columns`.

    Returns
    -------
    (str, float) or None
        Form of the clock, and s since 1970, or since midnight for a time of day.

    Raises
    ------
    InputError
        As in `read_columns`.
    """
    with lines_of(Path(path), kind) as source:
        lines = list(islice(source, HEAD))
    dialect = dialect_of(lines, str(path), whole=True)
    assert dialect is not None
    rows = list(rows_of(lines[dialect.first :], dialect, str(path)))
    clock, _ = clock_of(dialect.names, [row.cells for row in rows], dialect.decimal)
    if clock is None or not rows or not (clock.dated or clock.form == "time of day"):
        return None
    read = moment(clock, [rows[0].cells[k] for k in clock.columns], dialect.decimal)
    if read is None:
        return None
    return "date" if clock.dated else clock.form, passed(clock, Hands(), read)[0].last


def _column(name: str, dialect: Dialect, rows: Sequence[Row], where: str) -> Array | None:
    place = place_of(name, dialect.names)
    if place is None:
        return None
    read = numbers([row.cells[place.at] for row in rows], dialect.decimal)
    if read.unreadable is not None:
        row = rows[read.unreadable]
        raise InputError(
            f"{where}: line {row.line}: {row.cells[place.at].strip()!r} is not a number; write it "
            "like 20.5 or 20,5"
        )
    values = place.values(read.values)
    column = column_named(name)
    # A rise in K is typed by a person, not recorded by a logger.
    if column is not None and column.quantity == "temperature" and column.unit != "K":
        values, _ = without_error_values(values, column.quantity)
    return values


def _times(clock: Clock, dialect: Dialect, rows: Sequence[Row], where: str) -> Array:
    """Return the times of rows, s; since the first row unless the clock has a start of its own."""
    times, hands = [], Hands()
    for row in rows:
        cells = [row.cells[k] for k in clock.columns]
        read = moment(clock, cells, dialect.decimal)
        if read is None:
            raise InputError(
                f"{where}: line {row.line}: {' '.join(cells).strip()!r} is not a time; "
                f"write {FORMS}"
            )
        hands, _ = passed(clock, hands, read)
        times.append(hands.last)
    since_first = clock.dated or clock.form == "time of day"
    return np.array(times) - (times[0] if times and since_first else 0.0)
