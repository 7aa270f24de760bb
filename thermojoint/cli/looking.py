"""The command `look`: contents of a log, a picture of it, and a suggested next command."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermojoint.cli import arguments, file_kinds
from thermojoint.cli.log_reading import ColumnOption, MappingOption, renamed_by

if TYPE_CHECKING:
    from thermojoint.artefacts.log import Log


def look(
    logs: Annotated[list[Path], typer.Argument(help="Logs: CSV, .xlsx or Parquet.")],
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    column: ColumnOption = None,
    mapping: MappingOption = None,
) -> None:
    """Show a log as every command reads it: columns, units, clock, pauses, missing readings.

    Example: [bold]thermojoint look log.csv[/bold]

    Example: [bold]thermojoint look monday.xlsx tuesday.xlsx --column 'Fühler 1=T1_degC' --out
    log.png[/bold]
    """
    from thermojoint import console
    from thermojoint.artefacts.log_file import read_log
    from thermojoint.artefacts.log_record import described

    if out:
        from thermojoint.pictures.figures import check_png

        check_png(out)
    arguments.check_outputs({"--out": (out, file_kinds.PICTURE)}, [*logs, mapping])
    with console.working("reading"):
        log = read_log(logs, renamed_by(column, mapping))
    for line in described(log.records):
        print(line)
    print(f"next: {suggested(log, logs, column or (), mapping)}")
    if out:
        from thermojoint.pictures.log import write_log_picture

        with console.working("drawing"):
            write_log_picture(log, out)
    console.wrote(out)


def suggested(log: Log, logs: Iterable[Path], column: Iterable[str], mapping: Path | None) -> str:
    """Return the suggested next command: learn if possible, else estimate, else rename columns."""
    files = [str(path) for path in logs]
    names = [part for text in column for part in ("--column", text)]
    names += ["--mapping", str(mapping)] if mapping else []
    positions = [column.name for column in log.columns if column.is_position]
    lengths = [column.name for column in log.columns if column.is_displacement]
    if lengths and (log.of("temperature") or log.of("speed") or log.of("power")):
        along = "".join(f"@{name}" for name in positions) if len(positions) == 1 else ""
        learned = [part for name in lengths for part in ("--displacement", name + along)]
        return shlex.join(["thermojoint", "learn", *files, *learned, *names, "--out", "model.json"])
    if log.of("temperature") and len(files) == 1:
        return shlex.join(["thermojoint", "estimate", "MODEL", *files, "--out", "estimate.csv"])
    return shlex.join(["thermojoint", "look", *files, "--column", "THEIRS=T1_degC"])
