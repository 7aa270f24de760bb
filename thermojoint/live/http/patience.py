"""uvicorn's protocol and server, with limits on time; only here are its parts changed.

What is relied on is in tests/project/test_private_parts.py; `pyproject.toml` bounds the version.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Iterator
from typing import Any

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

#: A request must be there so long after its first byte, a first request after the connection, s.
REQUEST_S = 10.0
#: A reader that takes nothing for this long is gone, s.
READER_S = 30.0
#: Connections of one client at the same time.
MOST_OF_ONE = 128
#: TLS must stand, or have ended, so long after it has begun, s; asyncio would wait for a minute.
TLS_S = 5.0


class LimitedSocket(socket.socket):
    """Listens, and closes at once what is one connection too many, also before TLS.

    Attributes
    ----------
    most : int
        Connections at the same time.
    """

    def __init__(self, listening: socket.socket, most: int) -> None:
        super().__init__(
            listening.family, listening.type, listening.proto, fileno=listening.detach()
        )
        self.most = most
        self.taken: list[tuple[str, socket.socket]] = []

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection.

        Raises
        ------
        ConnectionAbortedError
            It was one too many, of all or of its address; asyncio goes on with the next.
        """
        connection, address = super().accept()
        host = str(address[0])
        self.taken = [one for one in self.taken if one[1].fileno() >= 0]
        same = sum(one[0] == host for one in self.taken)
        if len(self.taken) >= self.most or same >= MOST_OF_ONE:
            connection.close()
            raise ConnectionAbortedError
        self.taken.append((host, connection))
        return connection, address


class PatientProtocol(H11Protocol):
    """HTTP of one connection that does not wait for ever, neither for a request nor a reader."""

    _deadline: asyncio.TimerHandle | None = None
    _unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin; the first request must come soon."""
        super().connection_made(transport)
        self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._stop()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take what came; a request that has begun must become whole soon."""
        super().data_received(data)
        if self.conn.their_state in (h11.IDLE, h11.SEND_BODY):
            self._await_request()
        elif self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP; where an answer has begun there is nothing to be said.

        Whatever is answering the request before it has nobody to talk to any more.
        """
        if self.cycle is not None:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        # An answer has begun, or the reader has ended TLS.
        try:
            super().send_400_response(msg)
        except (h11.LocalProtocolError, RuntimeError):
            self.transport.abort()

    def pause_writing(self) -> None:
        """Note that the reader takes nothing."""
        super().pause_writing()
        self._unread = self._unread or self.loop.call_later(READER_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Note that the reader goes on."""
        super().resume_writing()
        if self._unread is not None:
            self._unread.cancel()
            self._unread = None

    def _await_request(self) -> None:
        if self._deadline is None:
            self._deadline = self.loop.call_later(REQUEST_S, self.transport.abort)

    def _stop(self) -> None:
        # A timer keeps the connection and all its buffers in memory until it rings.
        self._unset_keepalive_if_required()
        for timer in (self._deadline, self._unread):
            if timer is not None:
                timer.cancel()
        self._deadline = self._unread = None


class Server(uvicorn.Server):
    """A server among other tasks: signals are for the service, sockets are given."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals alone."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen; TLS is not waited for as long as asyncio would."""
        config, loop = self.config, asyncio.get_running_loop()
        patience = TLS_S if config.ssl else None

        def protocol() -> PatientProtocol:
            return PatientProtocol(config, self.server_state, {})

        self.servers = [
            await loop.create_server(
                protocol,
                sock=socket,
                ssl=config.ssl,
                ssl_handshake_timeout=patience,
                ssl_shutdown_timeout=patience,
            )
            for socket in sockets or ()
        ]
        self.started = True
