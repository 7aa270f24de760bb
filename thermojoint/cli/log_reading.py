"""Reading of logs by commands: options that rename columns, and a report of what was read."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments

if TYPE_CHECKING:
    from thermojoint.artefacts.log import Log
    from thermojoint.artefacts.log_record import Record

#: Two options of every command that reads a log; see `renamed_by`.
ColumnOption = Annotated[
    list[str] | None,
    typer.Option("--column", help="THEIRS=OURS: name a column of the log, its unit at the end."),
]
MappingOption = Annotated[
    Path | None,
    typer.Option("--mapping", help="Many names in TOML: \\[columns], 'Temp 1' = 'T1_degC'."),
]


def renamed_by(column: Sequence[str] | None, mapping: Path | None) -> dict[str, str]:
    """Return the new names of columns from --column and --mapping."""
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
    """Return new names of columns from a model, overridden by those of the options."""
    kept = {theirs: ours for theirs, ours in known.items() if ours not in renamed.values()}
    return kept | dict(renamed)


@contextmanager
def opened_log(path: Path, renamed: Mapping[str, str]) -> Iterator[Iterator[Log] | None]:
    """Open a log, or standard input for ``-``, and report what is read; None for a response.

    Rows of a stream are yielded one by one as they arrive.
    """
    from thermojoint.artefacts.log_file import order_of_dates
    from thermojoint.artefacts.tables.pieces import ROWS, pieces_in

    with arguments.opened(path) as source:
        if source is None:
            yield None
        elif str(path) == "-":
            yield reported_live(pieces_in(source, arguments.shown(path), renamed, 1))
        else:
            order = partial(order_of_dates, path, renamed)
            yield reported(pieces_in(source, str(path), renamed, ROWS, order))


def reported(pieces: Iterable[Log]) -> Iterator[Log]:
    """Yield the pieces of a log, and print the report on it at its end."""
    from thermojoint.artefacts.log_record import merged

    records: tuple[Record, ...] = ()
    for piece in pieces:
        records = merged((*records, *piece.records))
        yield piece
    say(records)


def reported_live(pieces: Iterable[Log]) -> Iterator[Log]:
    """Yield the rows of a stream, and print its layout and new findings as they occur.

    Pauses are reported at their end, each kind of missing reading at its first occurrence, the
    duration and the counts at the end of the stream.
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
    """Print the report on the logs of a command."""
    from thermojoint import console
    from thermojoint.artefacts.log_record import described

    for line in described(records):
        console.say(line)


def spikes_in(log: Log, judged: Collection[str]) -> dict[str, int]:
    """Return the number of spikes of each judged column of a log that has some.

    In a log with the positions of an axis, displacements change as it moves, and have none.
    """
    from calibrate.learning.thinning import spikes_of

    moving = any(one.is_position for one in log.columns)
    counts = spikes_of(log, () if moving else judged)[1]
    return {column: count for column, count in counts.items() if column in judged}
