"""The command of the service beside the control."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thermojoint.artefacts.errors import ThermojointError
from thermojoint.artefacts.extras import require


def serve(
    service: Annotated[Path, typer.Argument(help="File of the service (TOML).")],
) -> None:
    """Run beside the control: readings in, displacement and offsets out, until it is stopped.

    Readings come from OPC UA, MQTT or lines of CSV; estimates go out by OPC UA, MQTT and HTTP. What
    was read is kept, so that after a stop of any kind it goes on as if it had never been stopped.
    SIGHUP makes it read its file again.

    Example: [bold]thermojoint serve service.toml[/bold]
    """
    from thermojoint.live.settings import Service, read_service

    given = read_service(service)
    # After the file: a mistake in it is told before the libraries are loaded.
    import asyncio
    import signal

    from thermojoint.live.log_lines import LOGGER, line_of, log_to
    from thermojoint.live.service import run

    async def until_stopped() -> None:
        settings, loop = given, asyncio.get_running_loop()
        ended = False
        while not ended:
            stop = asyncio.Event()
            following: list[Service] = []

            def reload(stop: asyncio.Event = stop, following: list[Service] = following) -> None:
                try:
                    following[:] = [read_service(service)]
                except ThermojointError as error:
                    # It goes on with the file that it has.
                    LOGGER.info("%s", line_of("reload-refused", str(error)))
                else:
                    stop.set()

            for number in (signal.SIGTERM, signal.SIGINT):
                loop.add_signal_handler(number, stop.set)
            loop.add_signal_handler(signal.SIGHUP, reload)
            await run(settings, stop)
            ended = not following
            settings = following[0] if following else settings

    require(
        "serve",
        "serve",
        *(
            "prometheus_client",
            "asyncua",
            "aiomqtt",
            "starlette",
            "uvicorn",
            "h11",
            "anyio",
            "plotly",
        ),
    )
    log_to()
    asyncio.run(until_stopped())
