"""Reading of logs by commands: options that rename columns, and a report of what was read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments

if TYPE_CHECKING:
    from thermojoint.artefacts.log import Log
    from thermojoint.artefacts.log_record import Record

#: The two options of every command that reads a log; `renamed_by` takes their values.
ColumnOption = Annotated[
    list[str] | None,
    typer.Option("--column", help="THEIRS=OURS: name a column of the log, its unit at the end."),
]
MappingOption = Annotated[
    Path | None,
    typer.Option("--mapping", help="For many, TOML: \\[columns], 'Temp 1' = 'T1_degC'."),
]


def renamed_by(column: Sequence[str] | None, mapping: Path | None) -> dict[str, str]:
    """Return what --column and --mapping call the columns of a log."""
    from thermojoint.artefacts.log_file import read_mapping
    from thermojoint.artefacts.quantities import column_named

    renamed = read_mapping(mapping) if mapping else {}
    for text in column or ():
        theirs, _, ours = text.rpartition("=")
        if not theirs or column_named(ours) is None:
            raise InputError(
                f"--column {text}: write THEIRS=OURS with a unit at the end, e.g. 'Temp 1=T1_degC'"
            )
        renamed[theirs] = ours
    return renamed


def over(known: Mapping[str, str], renamed: Mapping[str, str]) -> dict[str, str]:
    """Return what a model calls the columns of a log, and over it what the options call them."""
    kept = {theirs: ours for theirs, ours in known.items() if ours not in renamed.values()}
    return kept | dict(renamed)


@contextmanager
def opened_log(path: Path, renamed: Mapping[str, str]) -> Iterator[Iterator[Log] | None]:
    """Open a log, or standard input for ``-``, and say what is read of it; None for a response.

    Parameters
    ----------
    path : Path
        Of the log.
    renamed : mapping
        Name of a column to the one it is given.

    Yields
    ------
    iterator of Log or None
        Its pieces; of a stream every row as it comes.
    """
    from thermojoint.artefacts.tables.pieces import ROWS, pieces_in

    with arguments.opened(path) as source:
        if source is None:
            yield None
        elif str(path) == "-":
            yield said_live(pieces_in(source, arguments.shown(path), renamed, 1))
        else:
            yield said(pieces_in(source, str(path), renamed, ROWS))


def said(pieces: Iterable[Log]) -> Iterator[Log]:
    """Yield the pieces of a log, and say at its end what was read and what was ignored."""
    from thermojoint.artefacts.log_record import merged

    records: tuple[Record, ...] = ()
    for piece in pieces:
        records = merged((*records, *piece.records))
        yield piece
    say(records)


def said_live(pieces: Iterable[Log]) -> Iterator[Log]:
    """Yield the rows of a stream, and say at once how they are read, and what is new in them.

    A pause is said when it is over, a kind of missing reading when it comes for the first time;
    how long the stream was, and how many readings were missing, at its end.
    """
    from thermojoint import console
    from thermojoint.artefacts.log_record import begun, ended, merged, noticed

    records: tuple[Record, ...] = ()
    for piece in pieces:
        for new in piece.records:
            if not records:
                console.say("\n".join(begun(new)))
            for line in noticed(new, *records) if records else ():
                console.say(line)
        records = merged((*records, *piece.records))
        yield piece
    for line in (line for record in records for line in ended(record)):
        console.say(line)


def say(records: Sequence[Record]) -> None:
    """Say what a command has read of its logs."""
    from thermojoint import console
    from thermojoint.artefacts.log_record import described

    for line in described(records):
        console.say(line)
