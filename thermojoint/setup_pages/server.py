"""Server of the pages of a folder on this computer, until the command is stopped."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

from thermojoint.artefacts.errors import InputError
from thermojoint.live.http.hosts import hosts_of
from thermojoint.live.http.server import BoundServer, make_server, serve_http
from thermojoint.live.limited_socket import listening
from thermojoint.live.settings import HttpServer
from thermojoint.setup_pages.app import make_app
from thermojoint.setup_pages.gate import Key
from thermojoint.setup_pages.jobs import Jobs
from thermojoint.setup_pages.place import Place

_MOST_CONNECTIONS = 64


def serve_pages(folder: Path, port: int) -> None:
    """Serve the pages of a folder at 127.0.0.1 until SIGINT or SIGTERM.

    Parameters
    ----------
    folder : Path
    port : int
        0: any free port.

    Raises
    ------
    InputError
        The path is not a folder, or the port cannot be used.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; make it first")
    asyncio.run(_served(folder.absolute(), port))


async def _served(folder: Path, port: int) -> None:
    section = HttpServer(port=port, security="none")
    socket = listening("--port", section.address, port, _MOST_CONNECTIONS, _MOST_CONNECTIONS)
    key = Key(hosts_of(section, None), socket.getsockname()[1])
    place = Place(folder, Jobs(folder))
    opened = BoundServer(make_server(make_app(place, key), section, None), socket)
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    print(f"open {key.link}", flush=True)
    try:
        await serve_http(opened, stop)
    finally:
        await asyncio.to_thread(place.jobs.close)
        service = place.jobs.detached
        if service is not None and service.poll() is None:
            print(f"the service goes on; it ends with: kill {service.pid}", flush=True)
