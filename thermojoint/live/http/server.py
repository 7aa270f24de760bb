"""The server: TLS unless on the loopback and told otherwise, and patience that ends."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h11
import uvicorn
from starlette.applications import Starlette
from uvicorn.protocols.http.h11_impl import H11Protocol

from thermojoint.artefacts.errors import InputError
from thermojoint.live.http.access import access_by
from thermojoint.live.http.app import make_app
from thermojoint.live.http.certificate import own_certificate
from thermojoint.live.http.gate import LARGEST_HEAD
from thermojoint.live.http.sources import Sources
from thermojoint.live.secret import read_secret
from thermojoint.live.settings import HttpServer, is_loopback

#: A request must be there so long after its first byte, a first request after the connection, s.
REQUEST_S = 10.0
#: A reader that takes nothing for this long is gone, s.
READER_S = 30.0
#: Connections at the same time, beside one for each stream; and those of one client.
MOST_CONNECTIONS, MOST_OF_ONE = 256, 128
#: TLS must stand, or have ended, so long after it has begun, s; asyncio would wait for a minute.
TLS_S = 5.0


class PatientProtocol(H11Protocol):
    """HTTP of one connection that does not wait for ever, neither for a request nor a reader."""

    _deadline: asyncio.TimerHandle | None = None
    _unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin; the first request must come soon, and nobody takes all the places."""
        super().connection_made(transport)
        self._await_request()
        host = self.client and self.client[0]
        same = sum(
            isinstance(one, PatientProtocol) and one.client is not None and one.client[0] == host
            for one in self.connections
        )
        if same > MOST_OF_ONE:
            transport.abort()

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
                sock=one,
                ssl=config.ssl,
                ssl_handshake_timeout=patience,
                ssl_shutdown_timeout=patience,
            )
            for one in sockets or ()
        ]
        self.started = True


def make_server(app: Starlette, section: HttpServer, base: Path, folder: Path) -> Server:
    """Return a server that is ready to start.

    Parameters
    ----------
    app : Starlette
        What answers.
    section : HttpServer
        Where, and with which certificate.
    base : Path
        Where paths of the section begin.
    folder : Path
        Where the service keeps its own certificate.

    Raises
    ------
    InputError
        The certificate or its key cannot be used.
    """
    security: dict[str, Any] = {}
    if section.security == "tls":
        if section.certificate_file is not None and section.key_file is not None:
            certificate, key = base / section.certificate_file, base / section.key_file
        else:
            certificate, key = own_certificate(folder, section.address)
        security = {"ssl_certfile": certificate, "ssl_keyfile": key}
    config = uvicorn.Config(
        app,
        host=section.address,
        port=section.port,
        http=PatientProtocol,
        ws="none",
        lifespan="off",
        log_config=None,
        log_level="error",
        access_log=False,
        # Who sends the header of a proxy would be another client each time.
        proxy_headers=False,
        server_header=False,
        limit_concurrency=MOST_CONNECTIONS + section.most_streams,
        timeout_keep_alive=15,
        timeout_graceful_shutdown=2,
        h11_max_incomplete_event_size=LARGEST_HEAD,
        **security,
    )
    try:
        config.load()
    except OSError as error:  # ssl.SSLError is one
        raise InputError(
            f"http: certificate {security.get('ssl_certfile')} with key "
            f"{security.get('ssl_keyfile')} cannot be used ({error}); give PEM files that belong "
            "together"
        ) from error
    return Server(config)


@dataclass(frozen=True, eq=False)
class Opened:
    """A server that has its address and waits to be run.

    Attributes
    ----------
    server : Server
        What answers.
    socket : socket.socket
        Where it listens.
    """

    server: Server
    socket: socket.socket

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        host, port = self.socket.getsockname()[:2]
        scheme = "https" if self.server.config.is_ssl else "http"
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"


def open_http(section: HttpServer, sources: Sources, base: Path, folder: Path) -> Opened:
    """Read token and certificate and take the address.

    Parameters
    ----------
    section : HttpServer
        Settings.
    sources : Sources
        What is shown.
    base : Path
        Where paths of the section begin.
    folder : Path
        Where the service keeps its own certificate.

    Raises
    ------
    InputError
        Token or certificate cannot be used, or the address cannot be had.
    """
    secure = section.security == "tls"
    if not secure and not is_loopback(section.address):
        raise InputError(
            f'http: security = "none" at {section.address} would send the token unencrypted; use '
            "127.0.0.1, or TLS"
        )
    token = read_secret(section.token, base, "http.token")
    access = access_by(token, 3600.0 * section.session_hours, "http.token")
    app = make_app(sources, access, secure, section.requests_per_s, section.most_streams)
    server = make_server(app, section, base, folder)
    family = socket.AF_INET6 if ":" in section.address else socket.AF_INET
    try:
        taken = socket.create_server((section.address, section.port), family=family)
    except OSError as error:
        raise InputError(
            f"http: cannot listen at {section.address}:{section.port} ({error.strerror}); give "
            "an address of this computer and a port that is free"
        ) from error
    return Opened(server, taken)


async def serve_http(opened: Opened, stop: asyncio.Event) -> None:
    """Serve until told to stop."""

    async def stopped() -> None:
        await stop.wait()
        opened.server.should_exit = True

    waiting = asyncio.create_task(stopped())
    try:
        await opened.server.serve([opened.socket])
    finally:
        waiting.cancel()
        opened.socket.close()
