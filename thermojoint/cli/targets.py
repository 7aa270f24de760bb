"""Commands for controls that receive the service's offsets."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Annotated

import typer

from thermojoint.cli import arguments, file_kinds
from thermojoint.cli.accounts import ServiceFile


def linuxcnc(
    service: ServiceFile,
    ini: Annotated[Path, typer.Argument(help="The control's ini file.")],
    machine: Annotated[str, typer.Option(help="Name of the machine in the service.")],
    token: Annotated[
        Path, typer.Option(help="File with a token of the role operator, for the control's user.")
    ],
    url: Annotated[
        str | None, typer.Option(help="Of the service, where the control is another computer.")
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Write the files; without it they are only shown.")
    ] = False,
) -> None:
    """Make LinuxCNC drive its axes by the offsets of a machine.

    Installs a HAL component beside the ini file of the control, and a line in that file, which
    takes effect at the control's next start.

    Example: [bold]thermojoint linuxcnc service.toml mill.ini --machine mill --token cnc-token
    --write[/bold]
    """
    from thermojoint import console
    from thermojoint.artefacts.files import write_text
    from thermojoint.live.settings import read_service
    from thermojoint.live.targets.linuxcnc import COMPONENT, files_for

    for path, text in files_for(read_service(service), machine, ini, token, url).items():
        if write:
            write_text(path, text)
            path.chmod(path.stat().st_mode | (0o111 if path.name == COMPONENT else 0))
            console.wrote(path)
        else:
            shown = f"{text.count(chr(10))} lines" if path.name == COMPONENT else f"\n{text}"
            print(f"would write {path}: {shown}")


def target(
    target: Annotated[Path, typer.Argument(help="File of the target (TOML).")],
    out: Annotated[Path | None, typer.Option(help="File to write; default: printed.")] = None,
    offsets: Annotated[
        Path | None, typer.Option(help="Table of 'compensate': list the writes that it leads to.")
    ] = None,
) -> None:
    """Show the parameters of a control (Siemens, Beckhoff) and the values to be written into it.

    Without --offsets: the list of initial parameters of the compensation, for the control's
    commissioning. With --offsets: every write, in order, with node, value and unit.

    Example: [bold]thermojoint target sinumerik.toml --offsets offsets.csv --out writes.csv[/bold]
    """
    from thermojoint import console
    from thermojoint.artefacts.files import write_text
    from thermojoint.artefacts.tables import source
    from thermojoint.live.targets.dry_run import COLUMNS, writes
    from thermojoint.live.targets.settings import lines_of, read_target

    arguments.check_outputs({"--out": (out, file_kinds.TARGET)}, [target, offsets])
    given = read_target(target)
    if offsets is None:
        lines = list(lines_of(given))
    else:
        with source.lines_of(offsets, "table of offsets") as table:
            text = io.StringIO()
            # Names of axes and nodes may have a comma.
            writer = csv.writer(text, lineterminator="\n")
            writer.writerows((COLUMNS, *writes(given, table, str(offsets))))
            lines = text.getvalue().splitlines()
    if out is None:
        print("\n".join(lines))
    else:
        write_text(out, "\n".join(lines) + "\n")
        console.wrote(out)
