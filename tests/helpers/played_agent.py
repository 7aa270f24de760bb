"""An MTConnect agent that is played: documents and streams as Part 1 of the standard describes."""

import asyncio
import contextlib
import re
from datetime import UTC, datetime
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape, quoteattr

NONE = "UNAVAILABLE"
HEARTBEAT_S = 0.05


def stamp(seconds):
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


class Agent:
    """One device; its time is that of the last observation it was told of."""

    def __init__(self, port, units, version="1.4", size=1000, streams=True):
        self.port, self.units, self.version, self.size = port, dict(units), version, size
        self.streams = streams
        self.instance, self.now, self.server, self.writers = 100, 0.0, None, set()
        self.asked = []
        self.told = asyncio.Condition()
        self._forget()

    def _forget(self):
        self.buffer, self.sequence = [], 1
        self.newest = {}
        for item in self.units:
            self._add(item, NONE, self.now)

    def _add(self, item, value, time):
        self.newest[item] = (self.sequence, item, time, value)
        self.buffer.append(self.newest[item])
        self.sequence += 1
        del self.buffer[: -self.size]

    async def tell(self, now, values=(), times=()):
        """Take values that have changed; an agent drops those that have not."""
        async with self.told:
            self.now = now
            for item, value in dict(values).items():
                if self.newest[item][3] != value:
                    self._add(item, value, dict(times).get(item, now))
            self.told.notify_all()

    async def begin(self, context=None):
        self.server = await asyncio.start_server(self._serve, "127.0.0.1", self.port, ssl=context)
        return self

    async def end(self):
        self.server.close()
        for writer in list(self.writers):
            writer.transport.abort()

    async def restart(self, context=None):
        await self.end()
        self.instance += 1
        self._forget()
        await self.begin(context)

    def header(self):
        first = self.buffer[0][0]
        return (
            f'<Header creationTime="{stamp(self.now)}" sender="played" version="{self.version}.0.1"'
            f' instanceId="{self.instance}" bufferSize="{self.size}" firstSequence="{first}"'
            f' lastSequence="{self.sequence - 1}"'
        )

    def document(self, kind, inner):
        space = f"urn:mtconnect.org:MTConnect{kind}:{self.version}"
        return (
            f'<?xml version="1.0" encoding="UTF-8"?>\n<MTConnect{kind} xmlns:m="{space}" '
            f'xmlns="{space}" xmlns:x="urn:example.com:Vendor:1.0">{inner}</MTConnect{kind}>'
        ).encode()

    def probe(self):
        items = "".join(
            f'<DataItem category="SAMPLE" id="{item}" name="{item}_name" type="X" {units}/>'
            for item, units in self.units.items()
        )
        return self.document(
            "Devices",
            f'{self.header()}/><Devices><Device id="d" name="mill" uuid="M-1"><Components><Axes '
            f'id="a"><DataItems>{items}</DataItems></Axes></Components></Device></Devices>',
        )

    def observations(self, rows, following):
        told = "".join(
            f'<x:Sort dataItemId="{item}" timestamp="{stamp(time)}" sequence="{sequence}" '
            f"name={quoteattr(item)}>{escape(str(value))}</x:Sort>"
            for sequence, item, time, value in rows
        )
        return self.document(
            "Streams",
            f'{self.header()} nextSequence="{following}"/><Streams><DeviceStream name="mill" '
            f'uuid="M-1"><ComponentStream componentId="a"><Samples>{told}</Samples>'
            "</ComponentStream></DeviceStream></Streams>",
        )

    def sample(self, first, count, items):
        """The next document and where it ends; None for what the buffer no longer has."""
        if not self.buffer[0][0] <= first <= self.sequence:
            inner = '/><Errors><Error errorCode="OUT_OF_RANGE">from is gone</Error></Errors>'
            return self.document("Error", self.header() + inner), None
        rows = [one for one in self.buffer if one[0] >= first and one[1] in items]
        following = rows[count][0] if len(rows) > count else self.sequence
        return self.observations(rows[:count], following), following

    async def _serve(self, reader, writer):
        self.writers.add(writer)
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
            target = (await reader.readuntil(b"\r\n\r\n")).split()[1].decode()
            self.asked.append(target)
            await self._answer(writer, urlsplit(target))
        self.writers.discard(writer)
        writer.close()

    async def _answer(self, writer, target):
        given = {name: values[0] for name, values in parse_qs(target.query).items()}
        named = re.findall('@id="([^"]*)"', unquote(given.get("path", "")))
        items = set(named or self.units)
        if target.path.endswith("/probe"):
            await self._send(writer, self.probe())
        elif target.path.endswith("/current"):
            rows = [self.newest[item] for item in self.units if item in items]
            await self._send(writer, self.observations(rows, self.sequence))
        else:
            await self._sample(writer, given, items)

    async def _sample(self, writer, given, items):
        first, count = int(given["from"]), int(given["count"])
        content, following = self.sample(first, count, items)
        if following is None or not self.streams:
            await self._send(writer, content, "200 OK" if self.version < "2" else "404 Not Found")
            return
        writer.write(
            b"HTTP/1.1 200 OK\r\nConnection: close\r\nTransfer-Encoding: chunked\r\n"
            b"Content-Type: multipart/x-mixed-replace;boundary=a1b2\r\n\r\n"
        )
        while following is not None:
            part = (
                f"\r\n--a1b2\r\nContent-type: text/xml\r\nContent-length: {len(content)}\r\n\r\n"
            ).encode() + content
            # In pieces, as a network may deliver it.
            for piece in (part[:70], part[70:]):
                writer.write(f"{len(piece):x}\r\n".encode() + piece + b"\r\n")
                await writer.drain()
            if following == self.sequence:
                # Without anything new a document comes by the heartbeat all the same.
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(HEARTBEAT_S), self.told:
                        await self.told.wait()
            content, following = self.sample(following, count, items)

    async def _send(self, writer, content, status="200 OK"):
        writer.write(
            f"HTTP/1.1 {status}\r\nContent-Type: text/xml\r\nContent-Length: {len(content)}\r\n"
            "\r\n".encode()
            + content
        )
        await writer.drain()
