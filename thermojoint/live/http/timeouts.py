"""uvicorn's protocol and server with time limits; only this module changes parts of uvicorn.

tests/project/test_private_parts.py lists the parts used; `pyproject.toml` bounds the version.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Iterator

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

#: Time for a whole request after its first byte, and for the first after the connection, s.
REQUEST_S = 10.0
#: A reader that accepts no data for this long is disconnected, s.
READER_S = 30.0
#: Timeout of the TLS handshake and shutdown, s; asyncio would wait for a minute.
TLS_S = 5.0


class PatientProtocol(H11Protocol):
    """HTTP of one connection with time limits for requests and readers."""

    _deadline: asyncio.TimerHandle | None = None
    _unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin, and start the timer for the first request."""
        super().connection_made(transport)
        self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._stop()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Receive data; the timer for the rest of a request runs."""
        super().data_received(data)
        if self.conn.their_state in (h11.IDLE, h11.SEND_BODY):
            self._await_request()
        elif self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def send_400_response(self, msg: str) -> None:
        """Refuse data that are not HTTP; the handler of the previous request is stopped."""
        if self.cycle is not None:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        # This fails if a response has begun, or the reader has ended TLS.
        try:
            super().send_400_response(msg)
        except (h11.LocalProtocolError, RuntimeError):
            self.transport.abort()

    def pause_writing(self) -> None:
        """Note that the reader accepts no data."""
        super().pause_writing()
        self._unread = self._unread or self.loop.call_later(READER_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Note that the reader accepts data again."""
        super().resume_writing()
        if self._unread is not None:
            self._unread.cancel()
            self._unread = None

    def _await_request(self) -> None:
        if self._deadline is None:
            self._deadline = self.loop.call_later(REQUEST_S, self.transport.abort)

    def _stop(self) -> None:
        # A timer keeps the connection and its buffers in memory until it expires.
        self._unset_keepalive_if_required()
        for timer in (self._deadline, self._unread):
            if timer is not None:
                timer.cancel()
        self._deadline = self._unread = None


class Server(uvicorn.Server):
    """A server among other tasks: it leaves signals and sockets to the service."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals alone."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen, with shorter TLS timeouts than those of asyncio."""
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
