"""Detection of a table's dialect: header, separator, decimal sign and column names."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import Column, column_assumed, column_named, unit_named
from thermojoint.artefacts.tables.cells import (
    decimal_shown,
    is_missing,
    may_be_grouped,
    number_in,
)
from thermojoint.artefacts.tables.clock import clock_word

#: Possible separators, in order of preference; at the end two or more blanks, one or more blanks.
SEPARATORS = (";", "\t", ",", "|", "  ", " ")
_BLANKS = {"  ": re.compile(r"\s{2,}|\t"), " ": re.compile(r"\s+")}
_SHOWN = {";": "semicolon", "\t": "tab", ",": "comma", "|": "bar", "  ": "blanks", " ": "blanks"}
_SEP_LINE = re.compile(r'^"?sep=(.)"?\s*$', re.IGNORECASE)
#: A date or a time of day at the start of a cell.
_MOMENT = re.compile(r"^\d{1,4}[-./:]\d{1,2}[-./:T ]?")
#: First characters common in a row of values; rows with others are examined.
_DIGITS = frozenset("0123456789")
#: A comment, as opposed to a spreadsheet's error value.
_COMMENT = re.compile(r"^\s*#(?!N/A|NA|DIV|VALUE|WERT|REF|BEZUG|NUM|ZAHL|NAME)", re.IGNORECASE)


class OtherHeaderError(InputError):
    """A line is another header for as many columns: the rows below it look like those above."""


@dataclass(frozen=True)
class Dialect:
    """Dialect of a table."""

    #: One of `SEPARATORS`.
    separator: str
    #: ``.`` or ``,``; empty if it is undetermined.
    decimal: str
    #: Names of the columns, with a unit from the row of units in brackets.
    names: tuple[str, ...]
    #: Names as in the header, and the row of units below it, which may be empty.
    given: tuple[str, ...]
    units: tuple[str, ...]
    #: Number of lines before the first row.
    first: int
    #: Number of those lines that are neither header nor units.
    skipped: int

    @property
    def shown(self) -> str:
        """Description for reports."""
        comma = ", decimal comma" if self.decimal == "," else ""
        return f"{_SHOWN[self.separator]} between cells{comma}"


def cells_of(
    lines: Iterable[str], separator: str, where: str, before: int = 0
) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of every row; a quoted cell may span several lines.

    `before` is the number of lines of the file before the given ones.

    Raises
    ------
    InputError
        The lines cannot be parsed, or a cell over several lines does not end with its quote: a
        single quotation mark would make one cell of all rows up to the next one, or to the end.
    """
    blanks = _BLANKS.get(separator)
    if blanks:
        for number, line in enumerate(lines, before + 1):
            yield number, blanks.split(line.strip()) if line.strip() else []
        return
    own: list[str] = []
    reader = csv.reader(_kept(lines, own), delimiter=separator, skipinitialspace=True)
    try:
        for row in reader:
            if len(own) > 1 and not _ends_quoted(own, separator):
                raise InputError(
                    f"{where}, line {before + reader.line_num - len(own) + 1}: a cell begins with "
                    "a quotation mark and does not end with one; correct or drop the mark"
                )
            own.clear()
            yield before + reader.line_num, row
    except csv.Error as error:
        first = before + reader.line_num - len(own) + 1
        raise InputError(
            f"{where}, line {first}: not readable as CSV ({error}); correct the file"
        ) from error


def _kept(lines: Iterable[str], kept: list[str]) -> Iterator[str]:
    """Yield lines and append them to a list."""
    for line in lines:
        kept.append(line)
        yield line


def _ends_quoted(lines: Sequence[str], separator: str) -> bool:
    """Whether every quoted cell of a row ends with its quote, before a separator or the end."""
    try:
        list(csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True))
    except csv.Error:
        return False
    return True


def is_row(cells: Sequence[str]) -> bool:
    """Whether cells are a row: neither empty nor a comment."""
    return bool(cells) and any(map(str.strip, cells)) and not _COMMENT.match(cells[0])


def trimmed(cells: list[str], count: int) -> list[str]:
    """Return cells without empty ones beyond a count, since a line may end in a separator."""
    while len(cells) > count and not cells[-1].strip():
        cells = cells[:-1]
    return cells


class Row(NamedTuple):
    """One row of values and the number of its last line."""

    line: int
    cells: list[str]


def rows_of(lines: Iterable[str], dialect: Dialect, where: str) -> Iterator[Row]:
    """Yield the rows of values; repeated headers and units are skipped.

    Raises
    ------
    InputError
        The length of a row differs from the header's.
    """
    for line, row in cells_of(lines, dialect.separator, where, dialect.first):
        try:
            cells = values_of(row, dialect)
        except InputError as error:
            raise InputError(f"{where}, line {line}: {error}") from None
        if cells is not None:
            yield Row(line, cells)


def check_named_once(names: Iterable[str], among: Sequence[str], where: str) -> None:
    """Refuse columns of some names that are there twice, so that either could be meant.

    Raises
    ------
    InputError
        One is.
    """
    twice = sorted({name for name in names if name and among.count(name) > 1})
    if twice:
        raise InputError(f"{where}: two columns are called {twice[0]!r}; rename one")


def values_of(row: list[str], dialect: Dialect) -> list[str] | None:
    """Return the cells of a row of values; None for an empty row, a comment or a repeated header.

    Raises
    ------
    OtherHeaderError
        They are another header.
    InputError
        Their number differs from the header's.
    """
    count = len(dialect.given)
    if len(row) == count and row[0][:1] in _DIGITS:
        return row
    if not is_row(row):
        return None
    cells = trimmed(row, count)
    if tuple(map(str.strip, cells)) in (dialect.given, dialect.units):
        return None
    if any(map(clock_word, cells)) and not is_data(cells):
        # Without it the rows below would be read by the names of the first one.
        kind = OtherHeaderError if len(cells) == count else InputError
        raise kind(
            "a header with other columns than the first; put it and the rows below it into a file "
            "of their own"
        )
    if len(cells) != count:
        raise InputError(f"{len(cells)} cells, expected {count}; correct or drop the row")
    return cells


def dialect_of(lines: Sequence[str], where: str, whole: bool) -> Dialect | None:
    """Detect the dialect of a table from its first lines; None if more are needed.

    `whole` means that more lines would not help: the table ends here, or there are enough lines.

    Raises
    ------
    InputError
        There is no header, or a length may have decimals or thousands.
    """
    stated = next((_SEP_LINE.match(line) for line in lines[:1]), None)
    candidates = (stated[1],) if stated else SEPARATORS
    tables = [
        tried for sep in candidates if (tried := _tried(lines, sep)) and len(tried.header) > 1
    ]
    rows = [table for table in tables if any(map(is_data, table.rows))]
    if not rows and not whole:
        return None
    rows = rows or [table for table in tables if table.rows]
    if not tables:
        raise InputError(
            f"{where}: no header; give a first line that names the columns, e.g. "
            "time_s,T1_degC,x_um"
        )
    best = max(
        rows or tables,
        key=lambda table: (table.fits, table.separator not in _BLANKS, len(table.header)),
    )
    count = len(best.header)
    given = tuple(name.strip() for name in best.header)
    units = best.units or [""] * count
    names = tuple(
        f"{name} [{unit.strip().strip('[]()').strip()}]"
        if unit_named(unit) and column_named(name) is None
        else name
        for name, unit in zip(given, units, strict=True)
    )
    values = [cell for row in best.rows for cell in row if cell.strip()]
    named = [column_named(name) or column_assumed(name) for name in names]
    decimal = decimal_shown(
        values, [cell for row in best.rows for cell in temperatures_in(row, named)]
    )
    if not decimal and best.separator == ",":
        _check_decimals(best.rows, named, where)
    lines_used = 1 + bool(best.units)
    return Dialect(
        best.separator,
        decimal or ("." if best.separator == "," else ""),
        names,
        given,
        tuple(unit.strip() for unit in best.units or ()),
        best.first,
        best.first - lines_used,
    )


def _check_decimals(
    rows: Sequence[Sequence[str]], columns: Sequence[Column | None], where: str
) -> None:
    """Refuse lengths like ``"20,125"`` throughout, where no other cell shows the decimal sign."""
    for k, column in enumerate(columns):
        if column is None or column.quantity != "length":
            continue
        cells = [row[k].strip() for row in rows if k < len(row) and row[k].strip()]
        if cells and all("," in cell and may_be_grouped(cell) for cell in cells):
            as_decimals, as_thousands = (cells[0].replace(",", sign) for sign in (".", ""))
            raise InputError(
                f"{where}: {column.name} is {cells[0]!r}, which may be {as_decimals} or "
                f"{as_thousands}; write it with a point, or without a comma"
            )


def temperatures_in(row: Sequence[str], columns: Sequence[Column | None]) -> list[str]:
    """Return the cells of a row that are temperatures, by its columns; None for other ones."""
    return [
        cell
        for cell, column in zip(row, columns, strict=False)
        if column is not None and column.quantity == "temperature"
    ]


@dataclass(frozen=True)
class _Try:
    """First lines of a table split by one separator; `fits` is the share of rows that fit."""

    separator: str
    header: list[str]
    units: list[str] | None
    rows: list[list[str]]
    first: int
    fits: float


def _tried(lines: Sequence[str], separator: str) -> _Try | None:
    table: list[tuple[int, list[str]]] = []
    # A line that cannot be parsed is refused, with its number, when the rows are read.
    with suppress(InputError):
        for cells in cells_of(lines, separator, ""):
            table.append(cells)
    full = [(number, row) for number, row in table if is_row(row) and not _SEP_LINE.match(row[0])]
    data = [is_data(row) for _, row in full]
    at = _header_at([row for _, row in full], data)
    if at is not None:
        number, header = full[at]
    elif full and data[0] and (named := _in_comment(table, full[0][0], len(full[0][1]))):
        (number, header), at = named, -1
    else:
        return None
    header = trimmed(list(header), 1)
    below = full[at + 1 :]
    units = None
    if below and not data[at + 1] and _are_units(below[0][1]):
        number, units = below[0]
        units = (units + [""] * len(header))[: len(header)]
        below = below[1:]
    rows = [trimmed(row, len(header)) for _, row in below]
    fits = sum(len(row) == len(header) for row in rows) / len(rows) if rows else 0.0
    return _Try(separator, header, units, rows, number, fits)


def _header_at(full: Sequence[Sequence[str]], data: Sequence[bool]) -> int | None:
    """Return the index of the header: words above values, preferably with a clock or a unit.

    Earlier lines may also contain a name and a value, e.g. a logger's serial number or start time.
    """
    words = [k for k, known in enumerate(data) if not known]
    above = [k for k in words if any(data[k + 1 : k + 3]) and len(full[k]) > 1]
    possible = above if any(data) else words
    named = (
        k
        for k in possible
        if any(clock_word(cell) or column_named(cell.strip()) for cell in full[k])
        or (k + 1 < len(full) and not data[k + 1] and _are_units(full[k + 1]))
    )
    return next(named, next(iter(possible), None))


def _in_comment(
    table: Sequence[tuple[int, list[str]]], before: int, count: int
) -> tuple[int, list[str]] | None:
    """Return the last comment before the rows if it has the same number of columns."""
    for (number, row), (following, _) in pairwise(table):
        if row and _COMMENT.match(row[0]) and following == before:
            header = [row[0].strip().lstrip("#").strip(), *row[1:]]
            header = header if header[0] else header[1:]
            return (number, header) if len(header) == count else None
    return None


def is_data(row: Sequence[str]) -> bool:
    """Whether a row contains values: numbers or times, at least half as many as words."""
    kinds = Counter(
        "empty"
        if not cell.strip()
        else "value"
        if number_in(cell, "") is not None or _MOMENT.match(cell.strip())
        else "missing"
        if is_missing(cell)
        else "word"
        for cell in row
    )
    return len(row) > 1 and kinds["value"] > 0 and 2 * kinds["value"] >= kinds["word"]


def _are_units(row: Sequence[str]) -> bool:
    """Whether a row contains units: at least one known unit, and short cells only."""
    there = [cell.strip() for cell in row if cell.strip()]
    return any(map(unit_named, there)) and all(len(cell) <= 12 for cell in there)
