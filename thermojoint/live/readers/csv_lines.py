"""Lines of a growing file, a FIFO or standard input, resumed after the last stored sample.

They are read by the rules for all tables (docs/tables.md), one row at a time: the first lines give
the separator, the columns of the time and the readings, and their units. A malformed row is noted
and skipped; another header ends the file, since the rows below it have other columns. The position
in a file is stored, so that nothing is lost or read twice whenever the service ends; a pipe has no
position.
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
from thermojoint.artefacts.tables.clock import Clock, Hands
from thermojoint.artefacts.tables.dialect import OtherHeaderError
from thermojoint.artefacts.tables.layout import HEAD, Layout, layout_of
from thermojoint.artefacts.tables.source import OR_CP1252, encoding_of
from thermojoint.artefacts.tables.stream import decimal_in, row_of
from thermojoint.live.arrivals import ABSENT, Arrival, Note

#: Name of the clock.
CLOCK = "time_s"
#: Longest line, bytes.
LONGEST_LINE = 65_536
#: Interval at which a file is checked for new lines, s.
_POLL_S = 0.1
_BLOCK = 1 << 16
#: Number of rows passed on at once.
_BLOCK_ROWS = 256
#: Number of malformed lines tolerated before the first row.
_MOST_MALFORMED = 8


@dataclass(frozen=True)
class CsvReader:
    """Reader of the lines of one machine."""

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
            blocks = _read_stream(self)
        else:
            blocks = _read_file(self, positions.get(self.machine))
        async for block in blocks:
            yield block


@dataclass(frozen=True)
class Header:
    """Layout of the lines, and the column of each reading; None for a missing one.

    The dialect in the layout contains the number of lines before the first row.
    """

    layout: Layout
    places: tuple[Place | None, ...]


def header_of(lines: Sequence[str], reader: CsvReader) -> Header:
    """Return the header of a table of which no more lines can be awaited.

    Raises
    ------
    InputError
        There is no header, no clock, or a reading is missing.
    """
    layout = _layout(lines, reader, whole=True)
    assert layout is not None
    return _header(layout, reader)


def _layout(lines: Sequence[str], reader: CsvReader, whole: bool) -> Layout | None:
    others = {theirs: ours for ours, theirs in reader.names.items() if theirs not in (ours, ABSENT)}
    later = reader.readings[reader.wanted :]
    renamed = {theirs: ours for theirs, ours in others.items() if ours not in later}
    layout = layout_of(lines, str(reader.path), renamed, whole)
    there = (
        {} if layout is None else {name: others[name] for name in layout.names if name in others}
    )
    return layout_of(lines, str(reader.path), renamed | there, whole) if there else layout


def _header(layout: Layout, reader: CsvReader) -> Header:
    columns = [column.name for column in layout.columns]
    places = tuple(
        None if reader.names[reading] == ABSENT else place_of(reading, columns)
        for reading in reader.readings
    )
    lacking = [
        name
        for name, place in zip(reader.readings[: reader.wanted], places, strict=False)
        if place is None
    ]
    if lacking:
        raise InputError(
            f"{reader.path}: columns {', '.join(layout.dialect.given)[:200]}; no "
            f"{', '.join(lacking)}; add it, or name it under columns"
        )
    return Header(layout, places)


class _FirstLines(NamedTuple):
    """The first lines of a table, up to the detection of its header."""

    #: Lines; malformed ones are replaced by empty ones.
    lines: tuple[str, ...] = ()
    #: Number of malformed lines.
    malformed: int = 0


def _with_line(
    before: _FirstLines, line: bytes, reader: CsvReader
) -> tuple[_FirstLines, Header | Note | None]:
    """Return the beginning with one more line, and the header or a note if available."""
    if not before.lines and encoding_of(line) != _ENCODING:
        raise InputError(f"{reader.path}: text in UTF-16; write it as UTF-8 where it is streamed")
    lines = (*before.lines, _text(line))
    try:
        layout = _layout(lines, reader, len(lines) >= HEAD)
    except InputError as error:
        if before.malformed + 1 >= _MOST_MALFORMED:
            raise
        left = _FirstLines((*before.lines, "\n"), before.malformed + 1)
        return left, Note("malformed", str(error), reader.machine)
    return before._replace(lines=lines), None if layout is None else _header(layout, reader)


_ENCODING = encoding_of(b"")


def _text(line: bytes) -> str:
    return line.decode(_ENCODING, OR_CP1252)


def _read_note(reader: CsvReader, header: Header) -> Note:
    """Return a note of how a stream is read, in the words of all commands."""
    layout = header.layout
    record = Record(
        str(reader.path), layout.form, layout.columns, layout.ignored, notes=layout.notes
    )
    return Note("source-read", "; ".join(line.strip() for line in begun(record)), reader.machine)


async def _read_file(reader: CsvReader, position: Any) -> AsyncIterator[list[Arrival | Note]]:  # noqa: ANN401
    missing_noted = False
    while True:
        try:
            file = reader.path.open("rb")
        except OSError as error:
            if not reader.follow:
                raise InputError(f"{reader.path}: cannot be read; give a CSV") from error
            if not missing_noted:
                missing_noted = True
                yield [Note("source-missing", f"{reader.path}: {error.strerror}", reader.machine)]
            await asyncio.sleep(_POLL_S)
            continue
        missing_noted = False
        with file:
            try:
                async for block in _read_rows(reader, file, position):
                    yield block
                    read = [item.position for item in block if isinstance(item, Arrival)]
                    position = read[-1] if read else position
            except InputError as error:
                # The header is wrong: this machine waits for another file, the others continue.
                yield [Note("source-refused", str(error), reader.machine)]
                if not reader.follow:
                    raise
                size = os.fstat(file.fileno()).st_size
                while not _replaced(reader.path, file, size):
                    await asyncio.sleep(_POLL_S)
        if not reader.follow:
            return
        # The file was replaced by another one: only its clock goes on.
        position = {key: (position or {}).get(key) for key in ("clock", "form")}


async def _read_rows(
    reader: CsvReader,
    file: BinaryIO,
    position: Any,  # noqa: ANN401
) -> AsyncIterator[list[Arrival | Note]]:
    """Yield the rows of a file until it ends, or until another file takes its name."""
    header: Header | None = None
    async for header_or_note in _read_header(reader, file):
        if isinstance(header_or_note, Note):
            yield [header_or_note]
        else:
            header = header_or_note
    if header is None:
        return
    yield [_read_note(reader, header)]
    file.seek(0)
    first = b"".join(file.readline(LONGEST_LINE) for _ in range(header.layout.dialect.first))
    at, hands = len(first), _clock_state_of(position, header.layout.clock)
    if _continues(position, first, file):
        at = int(position["offset"])
        header = _in_decimal(header, header.layout.dialect.decimal or position.get("decimal", ""))
    elif isinstance(position, dict) and position.get("starts", reader.starts) != reader.starts:
        # The settings now say when this file starts: after the midnights of the one before.
        hands = Hands()
    file.seek(at)
    mark: dict[str, Any] = {"sum": crc32(first), "starts": reader.starts}
    rest, skipping = b"", False
    while True:
        block = file.read(_BLOCK)
        if not block:
            if not reader.follow:
                if rest and not skipping:
                    header = _with_decimal_of(header, rest)
                    items, hands = items_in(reader, header, rest, hands)
                    yield _positioned(items, mark | _position(rest, at + len(rest)), header, hands)
                return
            if _replaced(reader.path, file, at + len(rest)):
                yield [Note("source-replaced", f"{reader.path}: another file", reader.machine)]
                return
            await asyncio.sleep(_POLL_S)
            continue
        lines = (rest + block).split(b"\n")
        rest = lines.pop()
        arrivals: list[Arrival | Note] = []
        other: OtherHeaderError | None = None
        for line in lines:
            at += len(line) + 1
            if skipping:
                skipping = False
                continue
            header = _with_decimal_of(header, line)
            try:
                items, hands = items_in(reader, header, line, hands)
            except OtherHeaderError as error:
                other = error
                break
            arrivals += _positioned(items, mark | _position(line + b"\n", at), header, hands)
        if len(rest) > LONGEST_LINE:
            at += len(rest)
            rest = b""
            if not skipping:
                arrivals.append(_too_long_note(reader))
            skipping = True
        for k in range(0, len(arrivals), _BLOCK_ROWS):
            yield arrivals[k : k + _BLOCK_ROWS]
        if other is not None:
            raise other
        await asyncio.sleep(0)


def _positioned(
    items: list[Arrival | Note], position: dict[str, Any], header: Header, hands: Hands
) -> list[Arrival | Note]:
    """Return the content of a line with the position after it and the state of its clock."""
    if header.layout.dialect.decimal:
        position = position | {"decimal": header.layout.dialect.decimal}
    if header.layout.clock.form not in ("number", "excel"):
        clock_state = [hand if math.isfinite(hand) else None for hand in hands]
        position = position | {"clock": clock_state, "form": _form_of(header.layout.clock)}
    return [
        replace(item, position=position) if isinstance(item, Arrival) else item for item in items
    ]


def _clock_state_of(position: Any, clock: Clock) -> Hands:  # noqa: ANN401
    """Return the state of a clock in a position; a new one for another clock, or without it.

    It goes on in another file, as a logger begins one every day: midnights that have passed and
    changes of summer time still hold there.
    """
    usual = Hands()
    if not isinstance(position, dict) or position.get("form") not in (None, _form_of(clock)):
        return usual
    stored = position.get("clock") or usual
    return Hands(*(old if hand is None else hand for hand, old in zip(stored, usual, strict=True)))


def _form_of(clock: Clock) -> str:
    """Return what two clocks have in common whose times continue each other."""
    return f"{clock.form} {'local' if clock.local else clock.zone}"


def _with_decimal_of(header: Header, line: bytes) -> Header:
    """Return the header with the decimal sign shown by a line, unless it is known already."""
    if header.layout.dialect.decimal:
        return header
    return _in_decimal(header, decimal_in(_text(line), header.layout))


def _in_decimal(header: Header, decimal: str) -> Header:
    return replace(header, layout=header.layout.with_decimal(decimal))


def _position(line: bytes, offset: int) -> dict[str, int]:
    """Return the position after a line, which identifies the file among ones with its header."""
    return {"offset": offset, "last": len(line), "crc": crc32(line)}


def _continues(position: Any, first: bytes, file: BinaryIO) -> bool:  # noqa: ANN401
    """Return whether a stored position belongs to a file."""
    if not isinstance(position, dict) or position.get("sum") != crc32(first):
        return False
    offset, last = int(position["offset"]), int(position["last"])
    if not len(first) + last <= offset <= os.fstat(file.fileno()).st_size:
        return False
    file.seek(offset - last)
    return crc32(file.read(last)) == position["crc"]


async def _read_header(reader: CsvReader, file: BinaryIO) -> AsyncIterator[Header | Note]:
    """Yield the header of a file as soon as its first lines give it, and notes of malformed lines.

    The generator ends without a header if the file has none, or if another file takes its name
    before.
    """
    beginning = _FirstLines()
    while True:
        at = file.tell()
        line = file.readline(LONGEST_LINE)
        if len(line) >= LONGEST_LINE and not line.endswith(b"\n"):
            raise InputError(f"{reader.path}: the first line is not a header; give a CSV")
        if line.endswith(b"\n") or (line and not reader.follow):
            beginning, header_or_note = _with_line(beginning, line, reader)
            if header_or_note is not None:
                yield header_or_note
            if isinstance(header_or_note, Header):
                return
            continue
        file.seek(at)
        if not reader.follow:
            if beginning.lines:
                yield header_of(beginning.lines, reader)
            return
        if _replaced(reader.path, file, at):
            return
        await asyncio.sleep(_POLL_S)


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


async def _read_stream(reader: CsvReader) -> AsyncIterator[list[Arrival | Note]]:
    """Yield the rows of a pipe until it ends; a FIFO is opened again for its next writer."""
    loop = asyncio.get_running_loop()
    hands, form = Hands(), ""
    while True:
        if str(reader.path) == "-":
            source = os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0)
        else:
            # Opened without waiting for a writer; the event loop waits instead.
            handle = os.open(reader.path, os.O_RDONLY | os.O_NONBLOCK)
            source = os.fdopen(handle, "rb", buffering=0)
        lines = asyncio.StreamReader(limit=2 * LONGEST_LINE, loop=loop)
        transport, _ = await loop.connect_read_pipe(
            lambda lines=lines: asyncio.StreamReaderProtocol(lines),  # type: ignore[misc]
            source,
        )
        header: Header | None = None
        beginning = _FirstLines()
        try:
            while True:
                line = await _line_of(lines)
                if line == b"":
                    break
                if line is None:
                    yield [_too_long_note(reader)]
                elif header is not None:
                    header = _with_decimal_of(header, line)
                    items, hands = items_in(reader, header, line, hands)
                    yield items
                else:
                    beginning, header_or_note = _with_line(beginning, line, reader)
                    if isinstance(header_or_note, Note):
                        yield [header_or_note]
                    elif header_or_note is not None:
                        header = header_or_note
                        if form != _form_of(header.layout.clock):
                            hands, form = Hands(), _form_of(header.layout.clock)
                        yield [_read_note(reader, header)]
                        for row in beginning.lines[header.layout.dialect.first :]:
                            items, hands = items_in(reader, header, row.encode(), hands)
                            yield items
        finally:
            transport.close()
        if str(reader.path) == "-" or not reader.follow:
            return
        await asyncio.sleep(_POLL_S)


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
    reader: CsvReader, header: Header, line: bytes, hands: Hands
) -> tuple[list[Arrival | Note], Hands]:
    """Return the content of a line, and the state of its clock.

    Raises
    ------
    OtherHeaderError
        The line is another header.
    """
    try:
        row = row_of(_text(line).rstrip("\r\n"), header.layout, header.places, hands)
    except OtherHeaderError as error:
        raise OtherHeaderError(f"{reader.path}: {error}") from error
    except (InputError, ValueError, OverflowError) as error:
        text = f"{reader.path}: a line is not a row: {error}"
        return [Note("malformed", text, reader.machine)], hands
    if row is None:
        return [], hands
    readings: Sequence[float | None] = [
        None if k >= reader.wanted and math.isnan(reading) else reading
        for k, reading in enumerate(row.readings)
    ]
    time = row.time + (0.0 if header.layout.clock.dated else reader.starts)
    arrival = Arrival(reader.machine, time, readings, clock.time())
    if not row.note:
        return [arrival], row.hands
    return [Note("clock", f"{reader.path}: {row.note}", reader.machine), arrival], row.hands


def _too_long_note(reader: CsvReader) -> Note:
    return Note(
        "malformed", f"{reader.path}: a line is longer than {LONGEST_LINE} bytes", reader.machine
    )
