"""How commands read logs: what their options call the columns, and what they say was read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from thermojoint.artefacts.errors import InputError

if TYPE_CHECKING:
    from thermojoint.artefacts.log import Log
    from thermojoint.artefacts.log_record import Record


def renamed_by(column: Sequence[str] | None, mapping: Path | None) -> dict[str, str]:
    """Return what --column and --mapping call the columns of a log."""
    from thermojoint.artefacts.log_file import read_mapping
    from thermojoint.artefacts.quantities import column_named

    found = read_mapping(mapping) if mapping else {}
    for text in column or ():
        theirs, _, ours = text.rpartition("=")
        if not theirs or column_named(ours) is None:
            raise InputError(
                f"--column {text}: write THEIRS=OURS with a unit at the end, e.g. 'Temp 1=T1_degC'"
            )
        found[theirs] = ours
    return found


def said(pieces: Iterable[Log]) -> Iterator[Log]:
    """Yield the pieces of a log, and say at its end what was read and what was ignored."""
    from thermojoint import console
    from thermojoint.artefacts.log_record import described, merged

    records: tuple[Record, ...] = ()
    for piece in pieces:
        records = merged((*records, *piece.records))
        yield piece
    for line in described(records):
        console.say(line)


def say_file(path: Path, renamed: Mapping[str, str] | None = None) -> None:
    """Say what a command has read of a log; of a stream, nothing.

    What cannot be read as a log the command has read in another way.
    """
    from thermojoint.artefacts.log_file import log_pieces

    if str(path) != "-" and path.suffix != ".nc":
        with suppress(InputError):
            for _ in said(log_pieces([path], renamed)):
                pass
