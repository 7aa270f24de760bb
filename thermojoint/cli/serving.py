"""The command of the service beside the control."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from thermojoint.artefacts.errors import InputError, ThermojointError
from thermojoint.artefacts.extras import require


class Role(StrEnum):
    """Rights of a user."""

    READS = "reads"
    WRITES = "writes"


def serve(
    service: Annotated[Path, typer.Argument(help="File of the service (TOML).")],
    add_user: Annotated[
        str | None,
        typer.Option(help="Add this OPC UA user and end; the password comes from standard input."),
    ] = None,
    role: Annotated[
        Role, typer.Option(help="What the user may do: reads, or also writes probe readings.")
    ] = Role.READS,
) -> None:
    """Run beside the control: readings in, displacement and offsets out, until it is stopped.

    Readings come from OPC UA, MQTT or lines of CSV; estimates go out by OPC UA, MQTT and HTTP. What
    was read is kept, so that after a stop of any kind it goes on as if it had never been stopped.
    SIGHUP makes it read its file again.

    Example: [bold]thermojoint serve service.toml[/bold]

    Example: [bold]thermojoint serve service.toml --add-user panel < password.txt[/bold]
    """
    from thermojoint.live.settings import Service, read_service

    given = read_service(service)
    if add_user is not None:
        server = given.given.opcua
        _add_user(server.users if server else None, add_user, role)
        return
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


def _add_user(users: Path | None, name: str, role: Role) -> None:
    """Add a user to the file that the service names; the password is never an argument."""
    import getpass
    import sys

    from thermojoint import console
    from thermojoint.live.users import add_user

    if users is None:
        raise InputError("--add-user: the service has no file of users; add users to [opcua]")
    asked = f"password of {name}: "
    password = getpass.getpass(asked) if sys.stdin.isatty() else sys.stdin.readline()
    add_user(users, name, role.value, password.rstrip("\r\n"))
    console.wrote(users)
