"""Reloading of a service's settings on request: checked first, then restarted."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from thermojoint.artefacts.errors import ThermojointError
from thermojoint.live.checking import checked, used_by_others
from thermojoint.live.log_lines import LOGGER, line_of
from thermojoint.live.running import Running
from thermojoint.live.service import run
from thermojoint.live.settings import Service, read_service


async def serve_file(
    path: Path,
    stop: asyncio.Event,
    reload: asyncio.Event,
    ready: Callable[[Running], None] = lambda running: None,
) -> None:
    """Run the service of a file (TOML) until `stop` is set or every source has ended.

    `reload` is set whenever file, models or certificates have changed. If they are invalid, the
    service continues with the present ones; if they cannot be started all the same, it starts again
    with the former ones. `ready` is called at every start, when all interfaces are open.

    Raises
    ------
    InputError
        The first start fails.
    """
    service: Service | None = read_service(path)
    former: Service | None = None
    while service is not None:
        ended, open_to_all = asyncio.Event(), asyncio.Event()

        def told(running: Running, begun: asyncio.Event = open_to_all) -> None:
            begun.set()
            ready(running)

        running = asyncio.create_task(run(service, ended, told, reload.set))
        fresh = asyncio.create_task(_reloaded(path, reload, service))
        stopped = asyncio.create_task(stop.wait())
        await asyncio.wait({running, fresh, stopped}, return_when=asyncio.FIRST_COMPLETED)
        ended.set()
        following = fresh.result() if fresh.done() and not stopped.done() else None
        for task in (fresh, stopped):
            task.cancel()
        with suppress(asyncio.CancelledError):
            await fresh
        try:
            await running
            former = service
        except (ThermojointError, OSError) as error:
            if former is None or open_to_all.is_set():
                raise
            _refuse(str(error).splitlines())
            following, former = None if stop.is_set() else former, None
        service = following


async def _reloaded(path: Path, reload: asyncio.Event, present: Service) -> Service:
    """Return the service of the file once a reload is requested and the file passes its check."""
    while True:
        await reload.wait()
        reload.clear()
        try:
            service = read_service(path)
            refused = (await asyncio.to_thread(checked, service)).refused
            refused += await asyncio.to_thread(used_by_others, service, present)
        except (ThermojointError, OSError) as error:
            refused = str(error).splitlines()
        if not refused:
            return service
        _refuse(refused)


def _refuse(lines: Iterable[str]) -> None:
    for line in lines:
        LOGGER.log(logging.INFO, "%s", line_of("reload-refused", line))
