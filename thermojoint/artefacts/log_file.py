"""Logs as loggers write them, from files in any dialect of `thermojoint.artefacts.tables`.

A column's name ends in its unit (`thermojoint.artefacts.quantities`); other columns are renamed by
a mapping. Files are read in pieces, so that a year of samples needs no more memory than the results
that are stored.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.held_readings import without_repeats
from thermojoint.artefacts.log import Log, joined
from thermojoint.artefacts.log_sequence import HEAD, common_order, following, shared, telling
from thermojoint.artefacts.quantities import UNITS, column_named
from thermojoint.artefacts.settings.toml import parse, read_text
from thermojoint.artefacts.tables.pieces import ROWS, pieces_in
from thermojoint.artefacts.tables.source import lines_of


def read_mapping(path: Path) -> dict[str, str]:
    """Read new names of log columns from a TOML file: table ``[columns]`` with THEIRS = "OURS".

    Raises
    ------
    InputError
        The file is missing or has another content.
    """
    return mapping_from_data(parse(read_text(path, "mapping"), str(path)), path)


def mapping_from_data(content: dict[str, Any], path: Path | str) -> dict[str, str]:
    """Return new names of columns given as nested dictionaries; raises as `read_mapping`."""
    columns = content.get("columns")
    if set(content) != {"columns"} or not isinstance(columns, dict):
        raise InputError(f"{path}: give one table [columns] with lines like 'Temp 1' = 'T1_degC'")
    for theirs, ours in columns.items():
        if not isinstance(ours, str) or column_named(ours) is None:
            raise InputError(
                f"{path}: columns.{theirs}: {ours!r} ends in no unit known here; end it in one of "
                f"{', '.join(f'_{unit}' for unit in UNITS)}"
            )
    return {str(theirs): str(ours) for theirs, ours in columns.items()}


def read_log(
    paths: Path | str | Sequence[Path | str], renamed: Mapping[str, str] | None = None
) -> Log:
    """Read a log from a file or several.

    Parameters
    ----------
    paths : Path or str, or sequence of them
        CSV, .xlsx or Parquet with the same columns (docs/tables.md): a clock and readings whose
        names end in their units. Files whose clocks have dates are sorted by time.
    renamed : mapping, optional
        Name of a column to its new name, which ends in its unit (`read_mapping`).

    Raises
    ------
    InputError
        A file is missing or not a table, has no clock, has columns other than the first file, a
        row whose length differs from the header's, a cell that is neither a number nor a missing
        reading, a clock that goes back, rows that contradict each other, the hours or rows of
        another file, dates whose order is open, or values in °C that look like kelvin.
    """
    files = [paths] if isinstance(paths, Path | str) else paths
    return joined(log_pieces([Path(path) for path in files], renamed))


def log_pieces(paths: Sequence[Path], renamed: Mapping[str, str] | None = None) -> Iterator[Log]:
    """Yield the samples of files in pieces of at most `ROWS`; see `read_log`.

    Files with the same content are read once. A change of summer time in a file also holds in the
    later ones. A displacement that is only repeated is missing
    (`thermojoint.artefacts.held_readings`).
    """
    return without_repeats(_pieces(paths, renamed))


def _pieces(paths: Sequence[Path], renamed: Mapping[str, str] | None) -> Iterator[Log]:
    before: Log | None = None
    files = _in_order(paths, renamed)
    for file in files:
        others = [other for other in files if other is not file and other.head]
        pieces = _without_rows_of(others, file, renamed)
        for k, piece in enumerate(following(before, pieces)):
            before = piece
            notes = (file.note,) if file.note and not k else ()
            records = tuple(
                replace(record, notes=(*record.notes, *notes)) for record in piece.records
            )
            yield replace(piece, records=records)


class _File(NamedTuple):
    """A file of a log, in the order of time."""

    path: Path
    #: For the user; empty without one.
    note: str = ""
    #: Of the dates of all files; empty if the file itself shows it.
    order: str = ""
    #: Its first rows if they have no date, to find them in another file.
    head: Log | None = None


def _without_rows_of(
    others: Sequence[_File], file: _File, renamed: Mapping[str, str] | None
) -> Iterator[Log]:
    """Yield the pieces of a file.

    Raises
    ------
    InputError
        It has the first rows of another file, and the same ones at all times of both.
    """

    def choose(orders: Sequence[str]) -> str:
        return file.order or order_of_dates(file.path, renamed, orders)

    heads = [other.head for other in others if other.head]
    left = [len(head.times) for head in heads]
    for piece in _pieces_in_file(file.path, renamed, ROWS, choose):
        for k, head in enumerate(heads):
            rows = shared(piece, head)[1]
            left[k] -= rows
            if rows and not left[k] and _agree(file, others[k], renamed):
                raise InputError(
                    f"{others[k].path}: its first {len(head.times)} rows are in {file.path}, too; "
                    "the same hours would count twice: leave one file out, or drop the rows that "
                    "are in both"
                )
        yield piece


def _agree(file: _File, other: _File, renamed: Mapping[str, str] | None) -> bool:
    """Whether two files have the same readings at all their common times."""
    whole = joined(_pieces_in_file(other.path, renamed, ROWS))
    counts = [shared(piece, whole) for piece in _pieces_in_file(file.path, renamed, ROWS)]
    return all(times == rows for times, rows in counts)


def _pieces_in_file(
    path: Path,
    renamed: Mapping[str, str] | None,
    rows: int,
    choose: Callable[[Sequence[str]], str] | None = None,
) -> Iterator[Log]:
    with lines_of(Path(path), "log") as lines:
        yield from pieces_in(lines, str(path), renamed, rows, choose)


def _in_order(paths: Sequence[Path], renamed: Mapping[str, str] | None) -> list[_File]:
    """Return the files sorted by time, each content once."""
    if len(paths) < 2:
        return [_File(path) for path in paths]
    seen: dict[str, Path] = {}
    repeated: dict[Path, list[Path]] = {}
    kept: list[Path] = []
    for path in paths:
        with lines_of(path, "log"), path.open("rb") as file:
            known = seen.setdefault(hashlib.file_digest(file, "sha256").hexdigest(), path)
        if len(seen) > len(kept):
            kept.append(path)
        else:
            repeated.setdefault(known, []).append(path)
    begun = [_begun(path, renamed) for path in kept]
    of_dates = common_order(
        [*_readable(path, renamed, head.records[0].orders)]
        for path, head in zip(kept, begun, strict=True)
        if head
    )
    begins = [
        head.records[0].by_other_orders.get(of_dates, (head.records[0].first,))[0]
        if head and head.records[0].dated
        else None
        for head in begun
    ]
    order = list(range(len(kept)))
    if None not in begins:
        order.sort(key=lambda k: begins[k] or 0.0)
    files = []
    for place, k in enumerate(order):
        doubles = repeated.get(kept[k], [])
        note = [f"same content as {path}, which is left out" for path in doubles]
        if place != k:
            note.append(f"given as file {k + 1}, read as file {place + 1}, sorted by time")
        files.append(_File(kept[k], "; ".join(note), of_dates, telling(begun[k])))
    return files


def _begun(path: Path, renamed: Mapping[str, str] | None) -> Log | None:
    """Return the first rows of a file; None without rows."""
    return next(_pieces_in_file(path, renamed, HEAD), None)


def order_of_dates(path: Path, renamed: Mapping[str, str] | None, orders: Sequence[str]) -> str:
    """Return the first of some orders in which the dates of a file can be read to its end.

    Parameters
    ----------
    path : Path
        A table.
    renamed : mapping, optional
        As for `read_log`.
    orders : sequence of str
        Orders that fit its first rows, the usual one first.

    Returns
    -------
    order : str
        Empty if there is none: reading the file says why.
    """
    return next(_readable(path, renamed, orders), "")


def _readable(
    path: Path, renamed: Mapping[str, str] | None, orders: Sequence[str]
) -> Iterator[str]:
    """Yield those of some orders in which the dates of a file can be read to its end."""
    for order in orders:
        if len(orders) < 2 or _is_readable(path, renamed, order):
            yield order


def _is_readable(path: Path, renamed: Mapping[str, str] | None, order: str) -> bool:
    try:
        for _ in _pieces_in_file(path, renamed, ROWS, lambda _: order):
            pass
    except InputError:
        return False
    return True
