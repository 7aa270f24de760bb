"""Requests to an external HTTP server: whole responses, and endless streams of parts."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing, asynccontextmanager
from email.message import Message
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import h11

from thermojoint.artefacts.errors import InputError
from thermojoint.live.ip_address import in_url

#: Timeout of a connection and of a response, s.
TIMEOUT_S = 10.0
#: Largest document, and largest header of a part, bytes.
_LARGEST, _LARGEST_HEADER = 16_000_000, 4096
_AT_ONCE = 65_536


class UnusableError(ValueError):
    """A response is unusable."""


#: Errors that end a connection.
LOST = (OSError, TimeoutError, h11.RemoteProtocolError, UnusableError)


class Address(NamedTuple):
    """Connection data of a server."""

    host: str
    port: int
    #: Prefix of the path of every request.
    path: str
    #: None: no TLS.
    context: ssl.SSLContext | None


class Response(NamedTuple):
    """A response whose body is still to be read."""

    status: int
    #: Headers with its Content-Type.
    kind: Message
    chunks: AsyncIterator[bytes]


def address_of(url: str, authority: Path | None, where: str) -> Address:
    """Parse the address in a URL.

    Raises
    ------
    InputError
        The authority's certificate cannot be used, or is given without TLS.
    """
    parts = urlsplit(url)
    context = None
    if parts.scheme == "https":
        try:
            context = ssl.create_default_context(cafile=authority)
        except (OSError, ssl.SSLError) as error:
            raise InputError(
                f"{where}.ca_file: {authority}: no certificate (PEM); give the authority's"
            ) from error
        context.minimum_version = ssl.TLSVersion.TLSv1_2
    elif authority is not None:
        raise InputError(f"{where}.ca_file: not used without TLS; remove it, or write https://")
    port = parts.port or (443 if context else 80)
    return Address(parts.hostname or "", port, parts.path.rstrip("/"), context)


@asynccontextmanager
async def requested(address: Address, target: str, silence: float) -> AsyncIterator[Response]:
    """Give the response to a GET; the connection is closed at the end.

    `target` is path and query, appended to the path of the address; `silence` is the longest
    silence of the server, s.
    """
    async with asyncio.timeout(TIMEOUT_S):
        reader, writer = await asyncio.open_connection(
            address.host, address.port, ssl=address.context
        )
    try:
        connection = h11.Connection(h11.CLIENT)
        headers = [
            ("Host", f"{in_url(address.host)}:{address.port}"),
            ("Accept", "text/xml, application/xml"),
            ("Connection", "close"),
        ]
        asked = h11.Request(method="GET", target=address.path + target, headers=headers)
        writer.write((connection.send(asked) or b"") + (connection.send(h11.EndOfMessage()) or b""))
        first = await _next(connection, reader, silence)
        while isinstance(first, h11.InformationalResponse):
            first = await _next(connection, reader, silence)
        if not isinstance(first, h11.Response):
            raise UnusableError("no response")
        kind = Message()
        kind["Content-Type"] = dict(first.headers).get(b"content-type", b"").decode("latin-1")
        async with aclosing(_chunks(connection, reader, silence)) as chunks:
            yield Response(first.status_code, kind, chunks)
    finally:
        writer.close()


async def _chunks(
    connection: h11.Connection, reader: asyncio.StreamReader, silence: float
) -> AsyncGenerator[bytes, None]:
    while isinstance(event := await _next(connection, reader, silence), h11.Data):
        yield bytes(event.data)


async def _next(
    connection: h11.Connection, reader: asyncio.StreamReader, silence: float
) -> h11.Event | type[h11.NEED_DATA] | type[h11.PAUSED]:
    while (event := connection.next_event()) is h11.NEED_DATA:
        async with asyncio.timeout(silence):
            connection.receive_data(await reader.read(_AT_ONCE))
    return event


async def whole(response: Response) -> bytes:
    """Return the body of a response.

    Raises
    ------
    UnusableError
        The body is too long.
    """
    body = b""
    async for chunk in response.chunks:
        body += chunk
        if len(body) > _LARGEST:
            raise UnusableError(f"a response of more than {_LARGEST} bytes")
    return body


async def parts_of(response: Response) -> AsyncIterator[bytes]:
    """Yield the parts of a response that replace each other (multipart/x-mixed-replace).

    Raises
    ------
    UnusableError
        The response has no boundary, or a part has no length or is too long.
    """
    boundary = (response.kind.get_boundary() or "").encode()
    if not boundary:
        raise UnusableError("parts without a boundary")
    buffer, length = bytearray(), -1
    async for chunk in response.chunks:
        buffer += chunk
        while True:
            if length < 0:
                end = buffer.find(b"\r\n\r\n")
                if end < 0:
                    if len(buffer) > _LARGEST_HEADER:
                        raise UnusableError("a part without a header")
                    break
                length = _length(bytes(buffer[:end]), boundary)
                del buffer[: end + 4]
            if len(buffer) < length:
                break
            yield bytes(buffer[:length])
            del buffer[:length]
            length = -1


def _length(header: bytes, boundary: bytes) -> int:
    """Return the length that the header of a part states."""
    mark, _, lines = header.lstrip(b"\r\n").partition(b"\r\n")
    if mark.rstrip() != b"--" + boundary:
        raise UnusableError("a part does not begin with the boundary")
    for line in lines.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length" and value.strip().isdigit():
            if (length := int(value)) > _LARGEST:
                raise UnusableError(f"a part of more than {_LARGEST} bytes")
            return length
    raise UnusableError("a part without its length")
