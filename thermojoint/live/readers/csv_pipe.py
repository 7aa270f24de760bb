"""Lines of a growing file, a FIFO or standard input, resumed after the last stored sample.

They are read by the rules for all tables (docs/tables.md), one row at a time: the first lines give
the separator, the columns of the time and the readings, and their units. A malformed row is noted
and skipped. The position in a file is stored, so that nothing is lost or read twice whenever the
service ends; a pipe has no position.
"""

from __future__ import annotations

import asyncio
import math
import os
import stat
import sys
import time as clock
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from zlib import crc32

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log_record import Record, begun
from thermojoint.artefacts.quantities import Place, place_of
from thermojoint.artefacts.tables.clock import Hands
from thermojoint.artefacts.tables.layout import HEAD, Layout, layout_of
from thermojoint.artefacts.tables.source import OR_CP1252, encoding_of
from thermojoint.artefacts.tables.stream import decimal_in, row_of
from thermojoint.live.arrivals import NEVER, Arrival, Note

#: Name of the clock.
CLOCK = "time_s"
#: Longest line, bytes.
LONGEST_LINE = 65_536
#: Interval at which a file is checked for new lines, s.
_LOOK_S = 0.1
_BLOCK = 1 << 16
#: Number of rows passed on at once.
_ROWS = 256
#: Number of malformed lines tolerated before the first row.
_PATIENCE = 8


@dataclass(frozen=True)
class Pipe:
    """Source of the lines of one machine."""

    machine: str
    #: ``-`` for standard input.
    path: Path
    #: Readings with their units, in the estimator's order, to their names in the header; ``time_s``
    #: for the clock, if the header gives it another name.
    names: Mapping[str, str]
    #: Number of readings, the first ones, that must be in the header.
    wanted: int
    #: Added to the times of a clock without a date, s.
    starts: float
    #: Whether to wait for more lines at the end of the file.
    follow: bool

    @property
    def readings(self) -> tuple[str, ...]:
        """Readings with their units, in the estimator's order."""
        return tuple(name for name in self.names if name != CLOCK)

    @property
    def machines(self) -> Sequence[str]:
        """The machine whose lines they are."""
        return (self.machine,)

    async def read(self, positions: Mapping[str, Any]) -> AsyncIterator[list[Arrival | Note]]:
        """Yield the rows in blocks, from the stored position on.

        Raises
        ------
        InputError
            The header lacks the required columns.
        """
        if str(self.path) == "-" or _is_pipe(self.path):
            blocks = _stream(self)
        else:
            blocks = _file(self, positions.get(self.machine))
        async for block in blocks:
            yield block


@dataclass(frozen=True)
class Header:
    """Layout of the lines, and the column of each reading; None for a missing one.

    The dialect in the layout contains the number of lines before the first row.
    """

    layout: Layout
    places: tuple[Place | None, ...]


def header_of(lines: Sequence[str], pipe: Pipe) -> Header:
    """Return the header of a table of which no more lines can be awaited.

    Raises
    ------
    InputError
        There is no header, no clock, or a reading is missing.
    """
    layout = _layout(lines, pipe, whole=True)
    assert layout is not None
    return _header(layout, pipe)


def _layout(lines: Sequence[str], pipe: Pipe, whole: bool) -> Layout | None:
    others = {theirs: ours for ours, theirs in pipe.names.items() if theirs not in (ours, NEVER)}
    later = pipe.readings[pipe.wanted :]
    renamed = {theirs: ours for theirs, ours in others.items() if ours not in later}
    layout = layout_of(lines, str(pipe.path), renamed, whole)
    there = (
        {} if layout is None else {name: others[name] for name in layout.names if name in others}
    )
    return layout_of(lines, str(pipe.path), renamed | there, whole) if there else layout


def _header(layout: Layout, pipe: Pipe) -> Header:
    columns = [column.name for column in layout.columns]
    places = tuple(
        None if pipe.names[reading] == NEVER else place_of(reading, columns)
        for reading in pipe.readings
    )
    lacking = [
        name
        for name, place in zip(pipe.readings[: pipe.wanted], places, strict=False)
        if place is None
    ]
    if lacking:
        raise InputError(
            f"{pipe.path}: columns {', '.join(layout.dialect.given)[:200]}; no "
            f"{', '.join(lacking)}; add it, or name it under columns"
        )
    return Header(layout, places)


class _Beginning(NamedTuple):
    """The first lines of a table, up to the detection of its header."""

    #: Lines; malformed ones are replaced by empty ones.
    lines: tuple[str, ...] = ()
    #: Number of malformed lines.
    refused: int = 0


def _with_line(
    before: _Beginning, line: bytes, pipe: Pipe
) -> tuple[_Beginning, Header | Note | None]:
    """Return the beginning with one more line, and the header or a note if available."""
    if not before.lines and encoding_of(line) != _ENCODING:
        raise InputError(f"{pipe.path}: text in UTF-16; write it as UTF-8 where it is streamed")
    lines = (*before.lines, _text(line))
    try:
        layout = _layout(lines, pipe, len(lines) >= HEAD)
    except InputError as error:
        if before.refused + 1 >= _PATIENCE:
            raise
        left = _Beginning((*before.lines, "\n"), before.refused + 1)
        return left, Note("malformed", str(error), pipe.machine)
    return before._replace(lines=lines), None if layout is None else _header(layout, pipe)


_ENCODING = encoding_of(b"")


def _text(line: bytes) -> str:
    return line.decode(_ENCODING, OR_CP1252)


def _read_note(pipe: Pipe, header: Header) -> Note:
    """Return a note of how a stream is read, in the words of all commands."""
    layout = header.layout
    record = Record(str(pipe.path), layout.form, layout.columns, layout.ignored, notes=layout.notes)
    return Note("source-read", "; ".join(line.strip() for line in begun(record)), pipe.machine)


async def _file(pipe: Pipe, position: Any) -> AsyncIterator[list[Arrival | Note]]:  # noqa: ANN401
    missing_noted = False
    while True:
        try:
            file = pipe.path.open("rb")
        except OSError as error:
            if not pipe.follow:
                raise InputError(f"{pipe.path}: cannot be read; give a CSV") from error
            if not missing_noted:
                missing_noted = True
                yield [Note("source-missing", f"{pipe.path}: {error.strerror}", pipe.machine)]
            await asyncio.sleep(_LOOK_S)
            continue
        missing_noted = False
        with file:
            try:
                async for block in _whole_lines(pipe, file, position):
                    yield block
            except InputError as error:
                # The header is wrong: this machine waits for another file, the others continue.
                yield [Note("source-refused", str(error), pipe.machine)]
                if not pipe.follow:
                    raise
                size = os.fstat(file.fileno()).st_size
                while not _replaced(pipe.path, file, size):
                    await asyncio.sleep(_LOOK_S)
        if not pipe.follow:
            return
        # The file was replaced by another one.
        position = None


async def _whole_lines(
    pipe: Pipe,
    file: BinaryIO,
    position: Any,  # noqa: ANN401
) -> AsyncIterator[list[Arrival | Note]]:
    """Yield the rows of a file until it ends, or until another file takes its name."""
    header: Header | None = None
    async for begun_with in _begun(pipe, file):
        if isinstance(begun_with, Note):
            yield [begun_with]
        else:
            header = begun_with
    if header is None:
        return
    yield [_read_note(pipe, header)]
    file.seek(0)
    first = b"".join(file.readline(LONGEST_LINE) for _ in range(header.layout.dialect.first))
    at, hands = len(first), Hands()
    if _goes_on(position, first, file):
        at, hands = int(position["offset"]), _hands_of(position)
        header = _in_decimal(header, header.layout.dialect.decimal or position.get("decimal", ""))
    file.seek(at)
    mark = {"sum": crc32(first)}
    rest, dropping = b"", False
    while True:
        block = file.read(_BLOCK)
        if not block:
            if not pipe.follow:
                if rest and not dropping:
                    header = _learned(header, rest)
                    items, hands = items_in(pipe, header, rest, hands)
                    yield _placed(items, mark | _after(rest, at + len(rest)), header, hands)
                return
            if _replaced(pipe.path, file, at + len(rest)):
                yield [Note("source-replaced", f"{pipe.path}: another file", pipe.machine)]
                return
            await asyncio.sleep(_LOOK_S)
            continue
        lines = (rest + block).split(b"\n")
        rest = lines.pop()
        arrivals: list[Arrival | Note] = []
        for line in lines:
            at += len(line) + 1
            if dropping:
                dropping = False
            else:
                header = _learned(header, line)
                items, hands = items_in(pipe, header, line, hands)
                arrivals += _placed(items, mark | _after(line + b"\n", at), header, hands)
        if len(rest) > LONGEST_LINE:
            at += len(rest)
            rest = b""
            if not dropping:
                arrivals.append(_too_long(pipe))
            dropping = True
        for k in range(0, len(arrivals), _ROWS):
            yield arrivals[k : k + _ROWS]
        await asyncio.sleep(0)


def _placed(
    items: list[Arrival | Note], position: dict[str, Any], header: Header, hands: Hands
) -> list[Arrival | Note]:
    """Return the content of a line with the position after it and the state of its clock."""
    if header.layout.dialect.decimal:
        position = position | {"decimal": header.layout.dialect.decimal}
    if header.layout.clock.form not in ("number", "excel"):
        position = position | {"clock": [hand if math.isfinite(hand) else None for hand in hands]}
    return [
        replace(item, position=position) if isinstance(item, Arrival) else item for item in items
    ]


def _hands_of(position: Mapping[str, Any]) -> Hands:
    """Return the state of the clock in a position, which may lack it if the clock needs none."""
    usual = Hands()
    kept = position.get("clock", usual)
    return Hands(*(old if hand is None else hand for hand, old in zip(kept, usual, strict=True)))


def _learned(header: Header, line: bytes) -> Header:
    """Return the header with the decimal sign shown by a line, unless it is known already."""
    if header.layout.dialect.decimal:
        return header
    return _in_decimal(header, decimal_in(_text(line), header.layout))


def _in_decimal(header: Header, decimal: str) -> Header:
    return replace(header, layout=header.layout.with_decimal(decimal))


def _after(line: bytes, offset: int) -> dict[str, int]:
    """Return the position after a line, which identifies the file among ones with its header."""
    return {"offset": offset, "last": len(line), "crc": crc32(line)}


def _goes_on(position: Any, first: bytes, file: BinaryIO) -> bool:  # noqa: ANN401
    """Return whether a stored position belongs to a file."""
    if not isinstance(position, dict) or position.get("sum") != crc32(first):
        return False
    offset, last = int(position["offset"]), int(position["last"])
    if not len(first) + last <= offset <= os.fstat(file.fileno()).st_size:
        return False
    file.seek(offset - last)
    return crc32(file.read(last)) == position["crc"]


async def _begun(pipe: Pipe, file: BinaryIO) -> AsyncIterator[Header | Note]:
    """Yield the header of a file as soon as its first lines give it, and notes of malformed lines.

    The generator ends without a header if the file has none, or if another file takes its name
    before.
    """
    beginning = _Beginning()
    while True:
        at = file.tell()
        line = file.readline(LONGEST_LINE)
        if len(line) >= LONGEST_LINE and not line.endswith(b"\n"):
            raise InputError(f"{pipe.path}: the first line is not a header; give a CSV")
        if line.endswith(b"\n") or (line and not pipe.follow):
            beginning, header_or_note = _with_line(beginning, line, pipe)
            if header_or_note is not None:
                yield header_or_note
            if isinstance(header_or_note, Header):
                return
            continue
        file.seek(at)
        if not pipe.follow:
            if beginning.lines:
                yield header_of(beginning.lines, pipe)
            return
        if _replaced(pipe.path, file, at):
            return
        await asyncio.sleep(_LOOK_S)


def _replaced(path: Path, file: BinaryIO, read: int) -> bool:
    """Return whether another file has the name, or the file is shorter than the part read."""
    held = os.fstat(file.fileno())
    if held.st_size < read:
        return True
    try:
        now = path.stat()
    except OSError:
        return False
    return (now.st_ino, now.st_dev) != (held.st_ino, held.st_dev)


def _is_pipe(path: Path) -> bool:
    try:
        return stat.S_ISFIFO(path.stat().st_mode)
    except OSError:
        return False


async def _stream(pipe: Pipe) -> AsyncIterator[list[Arrival | Note]]:
    """Yield the rows of a pipe until it ends; a FIFO is opened again for its next writer."""
    loop = asyncio.get_running_loop()
    while True:
        if str(pipe.path) == "-":
            source = os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0)
        else:
            # Opened without waiting for a writer; the event loop waits instead.
            handle = os.open(pipe.path, os.O_RDONLY | os.O_NONBLOCK)
            source = os.fdopen(handle, "rb", buffering=0)
        lines = asyncio.StreamReader(limit=2 * LONGEST_LINE, loop=loop)
        transport, _ = await loop.connect_read_pipe(
            lambda lines=lines: asyncio.StreamReaderProtocol(lines),  # type: ignore[misc]
            source,
        )
        header: Header | None = None
        beginning, hands = _Beginning(), Hands()
        try:
            while True:
                line = await _line_of(lines)
                if line == b"":
                    break
                if line is None:
                    yield [_too_long(pipe)]
                elif header is not None:
                    header = _learned(header, line)
                    items, hands = items_in(pipe, header, line, hands)
                    yield items
                else:
                    beginning, header_or_note = _with_line(beginning, line, pipe)
                    if isinstance(header_or_note, Note):
                        yield [header_or_note]
                    elif header_or_note is not None:
                        header = header_or_note
                        yield [_read_note(pipe, header)]
                        for row in beginning.lines[header.layout.dialect.first :]:
                            items, hands = items_in(pipe, header, row.encode(), hands)
                            yield items
        finally:
            transport.close()
        if str(pipe.path) == "-" or not pipe.follow:
            return
        await asyncio.sleep(_LOOK_S)


async def _line_of(lines: asyncio.StreamReader) -> bytes | None:
    """Return the next line; None for a line that is too long, which is skipped."""
    try:
        return await lines.readuntil(b"\n")
    except asyncio.IncompleteReadError as error:
        return error.partial
    except asyncio.LimitOverrunError as error:
        await lines.readexactly(error.consumed)
        while True:
            try:
                await lines.readuntil(b"\n")
            except asyncio.LimitOverrunError as more:
                await lines.readexactly(more.consumed)
                continue
            except asyncio.IncompleteReadError:
                pass
            return None


def items_in(
    pipe: Pipe, header: Header, line: bytes, hands: Hands
) -> tuple[list[Arrival | Note], Hands]:
    """Return the content of a line, and the state of its clock."""
    try:
        row = row_of(_text(line).rstrip("\r\n"), header.layout, header.places, hands)
    except (InputError, ValueError, OverflowError) as error:
        text = f"{pipe.path}: a line is not a row: {error}"
        return [Note("malformed", text, pipe.machine)], hands
    if row is None:
        return [], hands
    readings: Sequence[float | None] = [
        None if k >= pipe.wanted and math.isnan(reading) else reading
        for k, reading in enumerate(row.readings)
    ]
    time = row.time + (0.0 if header.layout.clock.dated else pipe.starts)
    arrival = Arrival(pipe.machine, time, readings, clock.time())
    if not row.note:
        return [arrival], row.hands
    return [Note("clock", f"{pipe.path}: {row.note}", pipe.machine), arrival], row.hands


def _too_long(pipe: Pipe) -> Note:
    return Note(
        "malformed", f"{pipe.path}: a line is longer than {LONGEST_LINE} bytes", pipe.machine
    )
