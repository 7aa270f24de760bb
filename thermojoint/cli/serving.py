"""The commands of the service beside the control: run, check, go back to a former model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thermojoint.artefacts.errors import InputErrors, unknown_name
from thermojoint.artefacts.extras import require
from thermojoint.cli import arguments, file_kinds
from thermojoint.cli.accounts import ServiceFile, audited

#: Packages of the extra `serve`.
_LIBRARIES = (
    "prometheus_client",
    "asyncua",
    "aiomqtt",
    "starlette",
    "uvicorn",
    "h11",
    "anyio",
    "plotly",
)


def serve(
    service: ServiceFile,
    check: Annotated[
        bool, typer.Option("--check", help="Say what a start would refuse, and end.")
    ] = False,
) -> None:
    """Run as a service beside the control: readings in, displacement and offsets out.

    Readings come from OPC UA, MQTT or lines of CSV; estimates go out by OPC UA, MQTT and HTTP. All
    samples are stored, so that after any stop the service continues as if uninterrupted.
    SIGHUP makes it read its file, models and certificates again.

    Example: [bold]thermojoint serve service.toml --check[/bold]
    """
    from thermojoint.live.settings import read_service

    # The file first: a mistake in it is reported before the libraries are loaded.
    given = read_service(service)
    require("serve", "serve", *_LIBRARIES)
    if check:
        from thermojoint import console
        from thermojoint.live.checking import checked, used_by_others

        findings = checked(given)
        refused = findings.refused + used_by_others(given)
        console.warn(findings.warnings)
        if refused:
            raise InputErrors("\n".join(refused))
        print(f"{service}: {len(given.machines)} machines; a start would succeed")
        return
    import asyncio
    import signal

    from thermojoint.live.descriptors import raise_limit
    from thermojoint.live.log_lines import log_to_stderr
    from thermojoint.live.reloading import serve_file

    async def until_stopped() -> None:
        loop, stop, reload = asyncio.get_running_loop(), asyncio.Event(), asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, stop.set)
        loop.add_signal_handler(signal.SIGHUP, reload.set)
        await serve_file(service, stop, reload)

    log_to_stderr()
    raise_limit()
    asyncio.run(until_stopped())


def setup(
    folder: Annotated[
        Path, typer.Argument(help="Folder that everything is read from and written into.")
    ] = Path(),
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Of 127.0.0.1; 0: one that is free.")
    ] = 0,
) -> None:
    """Set up in the browser: from a log or a CAD part to a running compensation.

    Prints a link that is good for one browser on this computer. The pages run the commands of this
    program in the folder and write the files that you would write.

    Example: [bold]thermojoint setup mill[/bold]
    """
    require("setup", "serve", *_LIBRARIES)
    from thermojoint.setup_pages.server import serve_pages

    serve_pages(folder, port)


def rollback(
    service: ServiceFile,
    machine: Annotated[str, typer.Argument(help="Name of the machine.")],
    to: Annotated[
        str | None,
        typer.Option(help="Beginning of the model's fingerprint; default: the last one."),
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="List the models that are kept.")] = False,
) -> None:
    """Go back to a model that a machine ran with before; a running service follows at once.

    The rollback holds until the model file of the settings changes again.

    Example: [bold]thermojoint rollback service.toml mill[/bold]
    """
    from thermojoint.live.former_models import SHOWN, read_record, roll_back
    from thermojoint.live.publication import iso_time
    from thermojoint.live.settings import read_service
    from thermojoint.live.store import send_sighup

    given = read_service(service)
    if show:
        arguments.only_for("a rollback", {"--to": to})
        if machine not in given.machines:
            raise unknown_name("machine", machine, given.machines, "rollback")
        for one in read_record(given.folder).deployments.get(machine, []):
            print(f"{one.fingerprint[:SHOWN]}  {one.file}  since {iso_time(one.since)}")
        return
    target = roll_back(given, machine, to)
    what = f"rollback to model {target.file} {target.fingerprint[:SHOWN]}"
    audited(given, what, machine)
    follows = "reloads now" if send_sighup(given.folder) else "follows at its next start"
    print(f"{machine}: {what}; the service {follows}")


def backup(
    service: ServiceFile,
    out: Annotated[Path, typer.Option(help="The backup (.tar.gz).")] = Path("backup.tar.gz"),
) -> None:
    """Back up settings, models, users, states and history of a service, which may be running.

    The backup is readable by its owner only. Secrets and keys that the settings name are left out.

    Example: [bold]thermojoint backup service.toml --out backup.tar.gz[/bold]
    """
    from thermojoint import console
    from thermojoint.live.backup import back_up
    from thermojoint.live.settings import read_service

    arguments.check_outputs({"--out": (out, file_kinds.BACKUP)}, [service])
    audited(read_service(service), f"backup to {out}")
    console.warn(f"left out: {secret}" for secret in back_up(service, out))
    console.wrote(out)


def restore(
    backup: Annotated[Path, typer.Argument(help="A backup (.tar.gz).")],
    out: Annotated[Path, typer.Option(help="Folder to restore into; it must be empty.")],
) -> None:
    """Restore a backup into an empty folder; nothing is overwritten.

    Example: [bold]thermojoint restore backup.tar.gz --out restored[/bold]
    """
    from thermojoint.live.backup import restore as restore_backup
    from thermojoint.live.settings import read_service

    file = restore_backup(backup, out)
    audited(read_service(file), f"restored from {backup}")
    print(f"{file}: restored; put the secrets back, then: thermojoint serve {file} --check")
