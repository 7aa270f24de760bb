"""SHDR adapter: the service's own values for an MTConnect agent.

A line is ``time|item|value|item|value``; the items of a machine begin with ``NAME:``, the agent's
device. The agent sends ``* PING`` and receives ``* PONG`` with the heartbeat in ms.
"""

from __future__ import annotations

import asyncio
import math
import re
import socket
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime

from estimator.quality import Quality
from thermojoint.artefacts.arrays import Array
from thermojoint.live.cancelling import cancelled
from thermojoint.live.publication import Publication
from thermojoint.live.publisher import Publisher

#: A reader that accepts no data for this long is disconnected, s.
READER_S = 30.0
#: Number of heartbeats without a ping after which an agent that has sent one counts as gone.
_MISSED = 3.0
#: Longest line of an agent, bytes; largest buffer of unsent data per reader, bytes.
_LONGEST, _WAITING = 1024, 65_536
_MILLI = 1e3
_LEVELS = {Quality.GOOD: "NORMAL", Quality.UNCERTAIN: "WARNING", Quality.BAD: "FAULT"}
_NONE = "UNAVAILABLE"


def lines_of(latest: Publication) -> Iterator[str]:
    """Yield the lines of a publication: displacement and band, offsets, condition.

    Lengths are in mm, as in MTConnect. Bad values are unavailable; an offset is always the one that
    the control should apply, and its mode shows whether an estimate supports it.
    """
    layout, machine, now = latest.layout, latest.machine, _stamp(latest.published)
    bad = latest.quality is Quality.BAD
    values = [
        (f"{machine}:{axis}_{name}", _NONE if bad else _millimetres(array, k))
        for name, array in (("displacement", latest.displacement), ("band", latest.band))
        for k, axis in enumerate(layout.axes)
    ]
    # A value becomes bad at the present time, not at the time of its sample.
    yield _line(now if bad or not math.isfinite(latest.time) else _stamp(latest.time), values)
    if layout.controls:
        offsets = [
            (f"{machine}:{axis}_offset", _millimetres(latest.offsets, k))
            for k, axis in enumerate(layout.controls)
        ]
        for k, line in enumerate(layout.lines):
            slope, reference = _MILLI * latest.slopes[k], _MILLI * line.reference
            offsets += [
                (f"{machine}:{line.axis}_slope", f"{slope:.7f}"),
                (f"{machine}:{line.axis}_reference", f"{reference:.7f}"),
            ]
        mode = latest.offset_mode.upper() or _NONE
        yield _line(now, [*offsets, (f"{machine}:offset_mode", mode)])
    level = _LEVELS[latest.quality] if latest.number else _NONE
    text = "" if level in ("NORMAL", _NONE) else re.sub(r"[|\r\n]+", " ", latest.status)
    # Without a native code: each native code would be a condition of its own.
    yield f"{now}|{machine}:thermal_displacement|{level}||||{text}\n"


def _line(stamp: str, values: list[tuple[str, str]]) -> str:
    return "|".join((stamp, *(cell for pair in values for cell in pair))) + "\n"


def _stamp(seconds: float) -> str:
    moment = datetime.fromtimestamp(seconds, UTC)
    return moment.isoformat(timespec="microseconds")[:-6] + "Z"


def _millimetres(array: Array, k: int) -> str:
    value = _MILLI * float(array[k])
    return f"{value:.7f}" if math.isfinite(value) else _NONE


async def serve_agents(publisher: Publisher, listening: socket.socket, heartbeat: float) -> None:
    """Serve agents until the task is cancelled; the socket limits the connections.

    An agent must send the next ping within `heartbeat`, s.
    """
    connected: dict[asyncio.Task[None], asyncio.StreamWriter] = {}

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.set_write_buffer_limits(_WAITING)
        task = asyncio.current_task()
        assert task is not None
        connected[task] = writer
        telling = asyncio.create_task(_tell(publisher, writer))
        asking = asyncio.create_task(_answer(reader, writer, heartbeat))
        try:
            await asyncio.wait((telling, asking), return_when=asyncio.FIRST_COMPLETED)
        finally:
            await cancelled(telling, asking)
            writer.transport.abort()
            del connected[task]

    server = await asyncio.start_server(serve, sock=listening, limit=_LONGEST)
    try:
        await server.serve_forever()
    finally:
        server.close()
        for writer in connected.values():
            writer.transport.abort()
        await asyncio.gather(*connected, return_exceptions=True)


async def _tell(publisher: Publisher, writer: asyncio.StreamWriter) -> None:
    """Send all values, then changed ones, as long as the agent accepts them."""
    with publisher.subscribe() as subscription:
        while True:
            for machine in await subscription.wait():
                writer.write("".join(lines_of(publisher.newest[machine])).encode())
                async with asyncio.timeout(READER_S):
                    await writer.drain()


async def _answer(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, heartbeat: float
) -> None:
    """Answer an agent until it disconnects, or stops sending pings after its first one."""
    patience = None
    with suppress(ValueError, TimeoutError):  # a line that is too long
        while True:
            async with asyncio.timeout(patience):
                line = await reader.readline()
            if not line:
                return
            if line.strip() == b"* PING":
                patience = _MISSED * heartbeat
                writer.write(f"* PONG {round(_MILLI * heartbeat)}\n".encode())
                async with asyncio.timeout(READER_S):
                    await writer.drain()
