"""Logs as loggers write them, from files in any dialect of `thermojoint.artefacts.tables`.

A column's name ends in its unit (`thermojoint.artefacts.quantities`); other columns are renamed by
a mapping. Files are read in pieces, so that a year of samples needs no more memory than the results
that are stored.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log, joined
from thermojoint.artefacts.log_record import (
    Record,
    check_dates,
    check_follows,
    check_orders,
    check_zones,
    common_order,
    moment_text,
    moved,
    with_times,
)
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


def read_log(paths: Sequence[Path], renamed: Mapping[str, str] | None = None) -> Log:
    """Read a log from files.

    Parameters
    ----------
    paths : sequence of Path
        CSV, .xlsx or Parquet with the same columns (docs/tables.md): a clock and readings whose
        names end in their units. Files whose clocks have dates are sorted by time.
    renamed : mapping, optional
        Name of a column to its new name, which ends in its unit (`read_mapping`).

    Raises
    ------
    InputError
        A file is missing or not a table, has no clock, has columns other than the first file, a
        row whose length differs from the header's, a cell that is neither a number nor a missing
        reading, a clock that goes back, rows that contradict each other, the hours of another file,
        or values in °C that look like kelvin.
    """
    return joined(log_pieces(paths, renamed))


def log_pieces(paths: Sequence[Path], renamed: Mapping[str, str] | None = None) -> Iterator[Log]:
    """Yield the samples of files in pieces of at most `ROWS`; see `read_log`.

    Files with the same content are read once. A change of summer time in a file also holds in the
    later ones.
    """
    before: Log | None = None
    for path, note, order in _in_order(paths, renamed):
        for k, piece in enumerate(_after(before, _pieces_in_file(path, renamed, ROWS, order))):
            before = piece
            notes = (note,) if note and not k else ()
            records = tuple(
                replace(record, notes=(*record.notes, *notes)) for record in piece.records
            )
            yield replace(piece, records=records)


def _after(before: Log | None, pieces: Iterable[Log]) -> Iterator[Log]:
    """Yield the pieces of a file after the last piece of the file before it, if there is one."""
    for k, given in enumerate(pieces):
        piece = given.with_order(before.columns) if before else given
        (record,) = piece.records
        if before:
            check_dates(record, before.records[0])
            check_zones(record, before.records[0])
            check_orders(record, before.records[0])
            if not k:
                check_follows(record, before.records[0])
        if before is None or not record.dated:
            yield piece
            continue
        shift = before.records[0].shift
        later = replace(piece, times=piece.times + shift, records=(moved(record, shift),))
        if k or later.times[0] > before.times[-1]:
            yield later
        else:
            yield from _without_repeated(before, later)


def _without_repeated(before: Log, piece: Log) -> Iterator[Log]:
    """Yield the first piece of a file without its first row, which ended the file before it.

    Raises
    ------
    InputError
        It begins with another row, so that the hours of both files would count twice.
    """
    (record,), (other,) = piece.records, before.records
    same = np.array_equal(piece.values[0], before.values[-1], equal_nan=True)
    if piece.times[0] != before.times[-1] or not same:
        begin, end = (moment_text(record, time) for time in (record.first, other.last))
        raise InputError(
            f"{record.where}: begins at {begin}, before {other.where} ends at {end}; the same "
            "hours would count twice: leave one file out, or drop the rows that are in both"
        )
    if len(piece.times) > 1:
        times = piece.times[1:]
        record = with_times(replace(record, twice=record.twice + 1), times, -np.inf)
        yield replace(piece.part(slice(1, None)), records=(record,))


def _pieces_in_file(
    path: Path, renamed: Mapping[str, str] | None, rows: int, order: str = ""
) -> Iterator[Log]:
    with lines_of(Path(path), "log") as lines:
        yield from pieces_in(lines, str(path), renamed, rows, order)


def _in_order(
    paths: Sequence[Path], renamed: Mapping[str, str] | None
) -> list[tuple[Path, str, str]]:
    """Return the files sorted by time, each with a note, and the order of its dates.

    Both may be empty: there is nothing to note, and the file itself shows the order.
    """
    if len(paths) < 2:
        orders = [_orders_of(path, _begun(path, renamed), renamed) for path in paths]
        return [(path, "", common_order(orders)) for path in paths]
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
        _orders_of(path, record, renamed) for path, record in zip(kept, begun, strict=True)
    )
    begins = [
        record and record.by_other_orders.get(of_dates, (record.first,))[0] for record in begun
    ]
    order = list(range(len(kept)))
    if None not in begins:
        order.sort(key=lambda k: begins[k] or 0.0)
    notes = []
    for place, k in enumerate(order):
        doubles = repeated.get(kept[k], [])
        note = [f"same content as {path}, which is left out" for path in doubles]
        if place != k:
            note.append(f"given as file {k + 1}, read as file {place + 1}, sorted by time")
        notes.append((kept[k], "; ".join(note), of_dates))
    return notes


def _begun(path: Path, renamed: Mapping[str, str] | None) -> Record | None:
    """Return the record of the first rows of a file; None without rows or a date."""
    piece = next(_pieces_in_file(path, renamed, 2), None)
    return piece.records[0] if piece is not None and piece.records[0].dated else None


def _orders_of(
    path: Path, record: Record | None, renamed: Mapping[str, str] | None
) -> tuple[str, ...]:
    """Return the orders in which the dates of a file can be read to its end, the usual one first.

    Its first rows leave the order open if `record`, theirs, has others.
    """
    if record is None or not record.order:
        return ()
    if not record.by_other_orders:
        return (record.order,)
    return tuple(
        order
        for order in (record.order, *record.by_other_orders)
        if _is_readable(path, renamed, order)
    )


def _is_readable(path: Path, renamed: Mapping[str, str] | None, order: str) -> bool:
    try:
        for _ in _pieces_in_file(path, renamed, ROWS, order):
            pass
    except InputError:
        return False
    return True
