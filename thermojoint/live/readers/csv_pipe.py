"""Lines of CSV: a file that grows, a FIFO, or standard input; read on from the last kept sample.

The first line names the columns: a time (``time_s``, or ``timestamp`` in ISO 8601) and readings. An
empty cell, ``---``, ``OL`` and the like are missing readings, as in every table. Of a file the
position is kept, so nothing is lost or read twice whenever the service ends; of a pipe it cannot
be.
"""

from __future__ import annotations

import asyncio
import csv
import math
import os
import stat
import sys
import time as clock
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.tables.cells import is_missing, number_in
from thermojoint.live.arrivals import Arrival, Note
from thermojoint.live.times import seconds_of

#: A line that is longer is none.
LONGEST_LINE = 65_536
#: How often the end of a file is looked at, s.
_LOOK_S = 0.1
_BLOCK = 1 << 16
#: Rows handed on at once.
_ROWS = 256


@dataclass(frozen=True)
class Pipe:
    """Where the lines of one machine come from.

    Attributes
    ----------
    machine : str
    path : Path
        ``-`` for standard input.
    names : tuple of str
        Readings, as the header calls them.
    wanted : int
        The first so many must be in the header.
    starts : float
        Added to ``time_s``, s.
    follow : bool
        The end of the file is not the end: more will come.
    """

    machine: str
    path: Path
    names: tuple[str, ...]
    wanted: int
    starts: float
    follow: bool


@dataclass(frozen=True)
class Header:
    """Where time and readings stand in a line."""

    time: int
    iso: bool
    at: tuple[int, ...]
    width: int


def header_of(line: str, pipe: Pipe) -> Header:
    """Read the first line.

    Raises
    ------
    InputError
        A column is missing.
    """
    columns = [one.strip() for one in next(csv.reader([line.lstrip("\ufeff")]), [])]
    iso = "timestamp" in columns
    lacking = [one for one in pipe.names[: pipe.wanted] if one not in columns]
    if "time_s" not in columns and not iso:
        lacking.insert(0, "time_s")
    if lacking:
        raise InputError(
            f"{pipe.path}: columns {', '.join(columns)[:200] or 'none'}; no {', '.join(lacking)}; "
            "add it, or name it under columns"
        )
    return Header(
        columns.index("timestamp" if iso else "time_s"),
        iso,
        tuple(columns.index(one) if one in columns else -1 for one in pipe.names),
        len(columns),
    )


def row_of(line: str, header: Header, starts: float) -> tuple[float, list[float]]:
    """Read one line: its time, s since 1970, and its readings, NaN for an empty cell.

    Raises
    ------
    ValueError
        It is no such line.
    """
    cells = line.split(",") if '"' not in line else next(csv.reader([line]), [])
    if len(cells) != header.width:
        raise ValueError(f"{len(cells)} values, expected {header.width}")
    text = cells[header.time]
    time = seconds_of(text.strip()) if header.iso else starts + _number(text)
    if not math.isfinite(time):
        raise ValueError("the time is missing")
    return time, [_number(cells[k]) if k >= 0 else math.nan for k in header.at]


def _number(cell: str) -> float:
    if not cell or cell.isspace():
        return math.nan
    value = number_in(cell, ".")
    if value is None:
        if not is_missing(cell):
            raise ValueError(f"{cell.strip()!r} is no number")
        return math.nan
    return value if math.isfinite(value) else math.nan


async def read_pipe(pipe: Pipe, position: Any) -> AsyncIterator[list[Arrival | Note]]:  # noqa: ANN401
    """Yield what the lines say, some at a time, from a kept position on.

    Raises
    ------
    InputError
        The first line names no such columns.
    """
    if str(pipe.path) == "-" or _is_pipe(pipe.path):
        async for found in _stream(pipe):
            yield found
        return
    async for found in _file(pipe, position):
        yield found


async def _file(pipe: Pipe, position: Any) -> AsyncIterator[list[Arrival | Note]]:  # noqa: ANN401
    told_missing = False
    while True:
        try:
            file = pipe.path.open("rb")
        except OSError as error:
            if not pipe.follow:
                raise InputError(f"{pipe.path}: cannot be read; give a CSV") from error
            if not told_missing:
                told_missing = True
                yield [Note("source-missing", f"{pipe.path}: {error.strerror}", pipe.machine)]
            await asyncio.sleep(_LOOK_S)
            continue
        told_missing = False
        with file:
            async for found in _whole_lines(pipe, file, position):
                yield found
        if not pipe.follow:
            return
        # It was replaced by another one.
        position = None


async def _whole_lines(
    pipe: Pipe,
    file: BinaryIO,
    position: Any,  # noqa: ANN401
) -> AsyncIterator[list[Arrival | Note]]:
    """Yield what a file says until it ends, or until another one has its name."""
    first = await _first_line(pipe, file)
    if first is None:
        return
    header = header_of(first.decode("utf-8", "replace"), pipe)
    at = file.tell()
    if _goes_on(position, first, os.fstat(file.fileno()).st_size):
        at = int(position["offset"])
        file.seek(at)
    mark = {"first": len(first), "sum": _sum(first)}
    rest, dropping = b"", False
    while True:
        block = file.read(_BLOCK)
        if not block:
            if not pipe.follow:
                if rest and not dropping:
                    yield [_told(pipe, header, rest, mark | {"offset": at + len(rest)})]
                return
            if _replaced(pipe.path, file, at + len(rest)):
                yield [Note("source-replaced", f"{pipe.path}: another file", pipe.machine)]
                return
            await asyncio.sleep(_LOOK_S)
            continue
        lines = (rest + block).split(b"\n")
        rest = lines.pop()
        found: list[Arrival | Note] = []
        for line in lines:
            at += len(line) + 1
            if dropping:
                dropping = False
            elif line.strip():
                found.append(_told(pipe, header, line, mark | {"offset": at}))
        if len(rest) > LONGEST_LINE:
            at += len(rest)
            rest = b""
            if not dropping:
                found.append(_too_long(pipe))
            dropping = True
        for k in range(0, len(found), _ROWS):
            yield found[k : k + _ROWS]
        await asyncio.sleep(0)


def _sum(first: bytes) -> int:
    return sum((k + 1) * one for k, one in enumerate(first)) % 1_000_003


def _goes_on(position: Any, first: bytes, size: int) -> bool:  # noqa: ANN401
    """Whether a file is the one that a position was kept of."""
    return (
        isinstance(position, dict)
        and position.get("first") == len(first)
        and position.get("sum") == _sum(first)
        and len(first) <= int(position.get("offset", 0)) <= size
    )


async def _first_line(pipe: Pipe, file: BinaryIO) -> bytes | None:
    """The first line, as soon as it is whole; None if it never is."""
    while True:
        file.seek(0)
        line = file.readline(LONGEST_LINE)
        if line.endswith(b"\n") or (line and not pipe.follow):
            return line
        if len(line) >= LONGEST_LINE:
            raise InputError(f"{pipe.path}: the first line is no header; give a CSV")
        if not pipe.follow:
            return None
        await asyncio.sleep(_LOOK_S)


def _replaced(path: Path, file: BinaryIO, read: int) -> bool:
    """Whether the name leads to another file, or the file became shorter than what was read."""
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
    """Yield what a pipe says, until it ends; a FIFO is opened again for its next writer."""
    loop = asyncio.get_running_loop()
    while True:
        if str(pipe.path) == "-":
            source = os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0)
        else:
            # Opened without waiting for a writer: the loop waits.
            handle = os.open(pipe.path, os.O_RDONLY | os.O_NONBLOCK)
            source = os.fdopen(handle, "rb", buffering=0)
        lines = asyncio.StreamReader(limit=2 * LONGEST_LINE, loop=loop)
        transport, _ = await loop.connect_read_pipe(
            lambda lines=lines: asyncio.StreamReaderProtocol(lines),  # type: ignore[misc]
            source,
        )
        header: Header | None = None
        try:
            while True:
                line = await _line_of(lines)
                if line == b"":
                    break
                if line is None:
                    yield [_too_long(pipe)]
                elif header is None:
                    header = header_of(line.decode("utf-8", "replace"), pipe)
                elif line.strip():
                    yield [_told(pipe, header, line, None)]
        finally:
            transport.close()
        if str(pipe.path) == "-" or not pipe.follow:
            return
        await asyncio.sleep(_LOOK_S)


async def _line_of(lines: asyncio.StreamReader) -> bytes | None:
    """The next line; None for one that is too long, which is left out."""
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


def _told(pipe: Pipe, header: Header, line: bytes, position: Any) -> Arrival | Note:  # noqa: ANN401
    try:
        text = line.decode("utf-8").rstrip("\r\n")
        time, readings = row_of(text, header, pipe.starts)
    except (ValueError, csv.Error, OverflowError) as error:
        return Note("malformed", f"{pipe.path}: a line is no row: {error}", pipe.machine)
    told: Sequence[float | None] = [
        None if k >= pipe.wanted and math.isnan(one) else one for k, one in enumerate(readings)
    ]
    return Arrival(pipe.machine, time, told, clock.time(), position)


def _too_long(pipe: Pipe) -> Note:
    return Note(
        "malformed", f"{pipe.path}: a line is longer than {LONGEST_LINE} bytes", pipe.machine
    )
