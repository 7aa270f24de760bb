"""The command of the service beside the control."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def serve(
    service: Annotated[Path, typer.Argument(help="File of the service (TOML).")],
) -> None:
    """Run beside the control: readings in, displacement and offsets out, until it is stopped.

    Readings come from OPC UA, MQTT or lines of CSV; estimates go out by OPC UA, MQTT and HTTP. What
    was read is kept, so that after a stop of any kind it goes on as if it had never been stopped.

    Example: [bold]thermojoint serve service.toml[/bold]
    """
    from live.settings import read_service

    given = read_service(service)
    # After the file: a mistake in it is told before the libraries are loaded.
    import asyncio
    import signal

    from live.log_lines import log_to
    from live.service import run

    async def until_stopped() -> None:
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, stop.set)
        await run(given, stop)

    log_to()
    asyncio.run(until_stopped())
