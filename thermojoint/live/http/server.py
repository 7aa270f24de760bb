"""HTTP server with TLS, optional on the loopback."""

from __future__ import annotations

import asyncio
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette

from thermojoint.artefacts.errors import InputError
from thermojoint.live.accounts import Accounts
from thermojoint.live.certificates import Identity, http_identity
from thermojoint.live.http.access import BURST_S, LARGEST_HEAD, AccessControl
from thermojoint.live.http.app import make_app
from thermojoint.live.http.backend import Backend
from thermojoint.live.http.hosts import hosts_of
from thermojoint.live.http.timeouts import PatientProtocol, Server
from thermojoint.live.http.token_buckets import RateLimit
from thermojoint.live.ip_address import in_url
from thermojoint.live.limited_socket import listening
from thermojoint.live.settings import HttpServer, check_protected

#: Simultaneous connections besides one per stream; more where one address may have more.
MOST_CONNECTIONS = 256


def make_server(app: Starlette, section: HttpServer, own: Identity | None) -> Server:
    """Return a server that is ready to start; without TLS, `own` is None.

    Raises
    ------
    InputError
        The certificate or its key cannot be used.
    """
    security: dict[str, Any] = {}
    if own is not None:
        security = {"ssl_certfile": own.certificate, "ssl_keyfile": own.key}
    config = uvicorn.Config(
        app,
        http=PatientProtocol,
        ws="none",
        lifespan="off",
        log_config=None,
        log_level="error",
        access_log=False,
        # With proxy headers a client could pretend to be another one at each request.
        proxy_headers=False,
        server_header=False,
        limit_concurrency=_most_connections(section),
        timeout_keep_alive=15,
        timeout_graceful_shutdown=2,
        h11_max_incomplete_event_size=LARGEST_HEAD,
        **security,
    )
    try:
        config.load()
    except OSError as error:  # includes ssl.SSLError
        raise InputError(
            f"http: certificate {security.get('ssl_certfile')} with key "
            f"{security.get('ssl_keyfile')} cannot be used ({error}); give PEM files that belong "
            "together"
        ) from error
    return Server(config)


@dataclass(frozen=True, eq=False)
class BoundServer:
    """A server with a bound address, ready to run."""

    server: Server
    socket: socket.socket

    @property
    def url(self) -> str:
        """URL for a browser."""
        host, port = self.socket.getsockname()[:2]
        scheme = "https" if self.server.config.is_ssl else "http"
        return f"{scheme}://{in_url(host)}:{port}"


def open_http(
    section: HttpServer, backend: Backend, accounts: Accounts, folder: Path
) -> BoundServer:
    """Read the certificate, the service's own one from `folder`, and bind the address.

    Raises
    ------
    InputError
        Nobody could log in, or others without TLS, the certificate cannot be used, or the address
        cannot be bound.
    """
    secure = section.security == "tls"
    check_protected("http", section)
    accounts.check_log_in()
    own = http_identity(section, folder) if secure else None
    access = AccessControl(
        accounts,
        hosts_of(section, own.certificate if own else None),
        secure,
        3600.0 * section.session_hours,
        RateLimit(section.requests_per_s, max(1.0, BURST_S * section.requests_per_s)),
    )
    app = make_app(backend, access, section.most_streams)
    server = make_server(app, section, own)
    most = _most_connections(section)
    bound_socket = listening("http", section.address, section.port, most, section.most_per_address)
    return BoundServer(server, bound_socket)


def _most_connections(section: HttpServer) -> int:
    return max(MOST_CONNECTIONS, section.most_per_address) + section.most_streams


async def serve_http(bound: BoundServer, stop: asyncio.Event) -> None:
    """Serve until `stop` is set or the task is cancelled."""

    async def stopped() -> None:
        await stop.wait()
        bound.server.should_exit = True

    waiting = asyncio.create_task(stopped())
    try:
        await bound.server.serve([bound.socket])
    finally:
        waiting.cancel()
        if bound.server.started:
            # A cancelled server leaves its socket to the event loop: at a reload the next server
            # gets the same descriptor, and no client would be answered.
            await bound.server.shutdown([bound.socket])
        bound.socket.close()
