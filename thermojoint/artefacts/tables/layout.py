"""Meaning of a log's columns: its clock, its readings, and ignored ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.quantities import Column, column_assumed, column_named
from thermojoint.artefacts.tables.cells import decimal_shown
from thermojoint.artefacts.tables.clock import Clock, clock_of
from thermojoint.artefacts.tables.dialect import (
    Dialect,
    cells_of,
    check_named_once,
    dialect_of,
    is_data,
    is_row,
    temperatures_in,
    trimmed,
)

#: Number of lines from which a file's layout is detected; a stream's by its first row.
HEAD = 256


@dataclass(frozen=True)
class Layout:
    """Layout of a log."""

    #: Name of the file.
    where: str
    #: Dialect of its lines.
    dialect: Dialect
    #: All columns, renamed and with their units.
    names: tuple[str, ...]
    #: Columns and form of the clock.
    clock: Clock
    #: Indices of the readings.
    kept: tuple[int, ...]
    #: The readings.
    columns: tuple[Column, ...]
    #: Assumptions.
    notes: tuple[str, ...]

    @property
    def ignored(self) -> tuple[str, ...]:
        """Names of the columns that are neither clock nor readings."""
        used = {*self.kept, *self.clock.columns}
        return tuple(name for k, name in enumerate(self.names) if k not in used and name)

    @property
    def form(self) -> str:
        """Description for reports."""
        clock = " + ".join(self.names[k] for k in self.clock.columns)
        return f"{self.dialect.shown}; clock {clock}, {self.clock.shown}"

    def decimal_in(self, rows: Iterable[Sequence[str]]) -> str:
        """Return the decimal sign that the cells of some rows show; empty if they show none."""
        columns = dict(zip(self.kept, self.columns, strict=True))
        named = [columns.get(k) for k in range(len(self.names))]
        every = list(rows)
        temperatures = chain.from_iterable(temperatures_in(row, named) for row in every)
        return decimal_shown([*chain.from_iterable(every)], [*temperatures])

    def with_decimal(self, decimal: str) -> Layout:
        """Return the layout with a decimal sign."""
        return replace(self, dialect=replace(self.dialect, decimal=decimal))


def layout_of(
    lines: Sequence[str], where: str, renamed: Mapping[str, str], whole: bool
) -> Layout | None:
    """Detect the layout of a log from its first lines; None if more are needed.

    `renamed` maps names of columns, with or without unit, to new names; `whole` means that more
    lines would not help.

    Raises
    ------
    InputError
        There is no header, no clock or no reading, a column in `renamed` is missing, or two
        columns have the same name.
    """
    dialect = dialect_of(lines, where, whole)
    if dialect is None:
        return None
    names = _renamed(dialect, where, renamed)
    rows = [
        trimmed(row, len(names))
        for number, row in cells_of(lines, dialect.separator, where)
        if number > dialect.first and is_row(row)
    ]
    rows = list(filter(is_data, rows)) or rows
    chosen = [
        k
        for k, (given, name) in enumerate(zip(dialect.names, names, strict=True))
        if name != given and (column := column_named(name)) and column.quantity == "time"
    ]
    clock, bad = clock_of(names, rows, dialect.decimal, chosen)
    if clock is None:
        raise InputError(
            f"{where}, line {dialect.first + 1}: {bad}"
            if bad
            else f"{where}: no clock among the columns {', '.join(dialect.given)[:200]}; rename "
            "one time_s, e.g. --column 'NAME=time_s'"
        )
    known = [None if k in clock.columns else column_named(name) for k, name in enumerate(names)]
    assumed = [
        None if column else column_assumed(name) for column, name in zip(known, names, strict=True)
    ]
    columns_at = {
        k: column
        for k, pair in enumerate(zip(known, assumed, strict=True))
        if (column := pair[0] or pair[1]) and column.quantity != "time"
    }
    if not columns_at:
        raise InputError(
            f"{where}: no column's name ends in a unit, as T1_degC or x_um does; rename them with "
            "--column 'NAME=T1_degC'"
        )
    notes = [
        f"{column.name}: no unit in the name, taken as {column.unit}"
        for column in assumed
        if column
    ]
    if dialect.skipped:
        notes.append(f"lines before the header, not read: {dialect.skipped}")
    columns = tuple(columns_at.values())
    return Layout(where, dialect, names, clock, tuple(columns_at), columns, tuple(notes))


def _renamed(dialect: Dialect, where: str, renamed: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the columns after renaming by the user."""
    there = {*dialect.names, *dialect.given}
    for name, ours in renamed.items():
        if name not in there and ours not in there:
            raise unknown_name("column", name, dialect.given, where)
    names = tuple(
        renamed.get(given, renamed.get(name, name))
        for given, name in zip(dialect.given, dialect.names, strict=True)
    )
    check_named_once(names, names, where)
    return names
