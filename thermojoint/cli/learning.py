"""The command `learn`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from thermojoint.cli import arguments, file_kinds, joint_aware
from thermojoint.cli.log_reading import ColumnOption, MappingOption, renamed_by

if TYPE_CHECKING:
    from calibrate.learning.learn import HeldOut
    from thermojoint.models.learned import LearnedModel


def learn(  # noqa: PLR0913 - the options of a command
    logs: Annotated[list[Path], typer.Argument(help="Logs (CSV), in the order of time.")],
    displacement: Annotated[
        list[str],
        typer.Option(
            help="A column to learn, e.g. x_um, or x_um@y_pos_mm if read along an axis; give one "
            "or more."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Model file to write: JSON; joint-aware: HDF5.")],
    max_sensors: Annotated[
        int | None, typer.Option(help="Largest number of temperatures used; default: 4.")
    ] = None,
    kind: Annotated[
        Literal["learned", "linear", "ridge", "arx", "joint-aware"],
        typer.Option(
            metavar="KIND",
            help="learned; linear, ridge or arx: a baseline on all temperatures; joint-aware: the "
            "physics of --case.",
        ),
    ] = "learned",
    case: joint_aware.CaseOption = None,
    column: ColumnOption = None,
    mapping: MappingOption = None,
    ignore: Annotated[
        list[str] | None, typer.Option(help="A column to ignore; may be repeated.")
    ] = None,
    like: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="MODEL",
            help="Model of a machine like this one, or of it before it aged: few readings of the "
            "displacement are enough; may be repeated.",
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(help="Picture of measured and estimated displacement on held-out time."),
    ] = None,
) -> None:
    """Learn an estimator from a machine's log: temperatures, speed and displacement.

    Names of columns end in their units: time_s, spindle_rpm, T1_degC, x_um. Sensors that are
    stuck or were moved are reported and not used.

    Example: [bold]thermojoint learn log.csv --displacement disp1_um --displacement disp2_um
    --max-sensors 4 --out model.json --figure held-out.png[/bold]

    Example: [bold]thermojoint learn monday.csv tuesday.csv --displacement z_um --column
    'Zeit=time_s' --out model.json[/bold]

    Read along an axis, a displacement is learned as K0 and slope: its position is another column,
    or in the names of its columns (x@0mm_um, x@400mm_um; --displacement x).

    Example: [bold]thermojoint learn log.csv --displacement x_um@y_pos_mm --out model.json[/bold]

    Few readings are enough with the model of a similar machine, learned from a log; leave the
    displacement empty where it was not read.

    Example: [bold]thermojoint learn readings.csv --displacement x_um --like sister.json
    --out model.json[/bold]

    With a mesh, a joint-aware model learns from the same log: temperatures named after the
    probes, the heat as heat_W, every run from rest.

    Example: [bold]thermojoint learn log.csv --displacement x_um --kind joint-aware
    --case machine.toml --out model.h5[/bold]
    """
    from calibrate.learning.learn import learn_and_judge, with_origin
    from calibrate.learning.transfer import learn_like
    from thermojoint import console
    from thermojoint.artefacts.log_file import log_pieces
    from thermojoint.cli.log_reading import reported
    from thermojoint.models.learned import read_learned, write_learned
    from thermojoint.pictures.figures import check_format

    renamed = renamed_by(column, mapping)
    own: dict[str, object]
    chosen: dict[str, object] = {"--ignore": ignore, "--max-sensors": max_sensors}
    if kind == "joint-aware":
        own = {"--figure": figure, "--like": like}
        arguments.only_for("a model learned without --case", own | chosen)
        joint_aware.learn(case, logs, displacement, renamed, out)
        return
    arguments.only_for("--kind joint-aware", {"--case": case})
    if like:
        other = None if kind == "learned" else kind
        own = {"--kind": other, "--figure": figure}
        arguments.only_for("a model learned without --like", own | chosen)
    outputs = {"--out": (out, file_kinds.LEARNED)}
    if figure is not None:
        check_format(figure)
        outputs["--figure"] = (figure, file_kinds.PICTURE)
    arguments.check_outputs(outputs, [*logs, *(like or ()), mapping])
    sisters = [read_learned(path) for path in like or ()]
    pieces = reported(log_pieces(logs, renamed))
    files = [path.name for path in logs]
    with console.working("learning"):
        if sisters:
            model = learn_like(pieces, displacement, sisters)
        else:
            most = 4 if max_sensors is None else max_sensors
            model, held_out = learn_and_judge(pieces, displacement, most, kind, ignore or ())
        model = with_origin(model, files, renamed)
    write_learned(model, out)
    if figure is not None:
        _draw(model, held_out, figure)
    _show(model)
    console.wrote(out, figure)


def _draw(model: LearnedModel, held_out: HeldOut, path: Path) -> None:
    """Draw every displacement with its estimates on the quarters of the log held out."""
    import numpy as np

    from thermojoint.pictures.judged import Judged, write_judged

    panels = []
    for k, channel in enumerate(model.channels):
        # Displacements that are read apart have rows of their own.
        read = np.isfinite(held_out.truth[:, k])
        own = (values[read, k] for values in held_out[1:])
        title = f"{channel.name}: each quarter by a model of the others"
        panels.append(Judged(title, held_out.times[read], *own))
    write_judged(panels, path)


def _show(model: LearnedModel) -> None:
    """Print faults of sensors, the chosen sensors, and the errors beside those of other kinds."""
    from rich.table import Table

    from thermojoint import console

    origin = model.learned_from
    console.warn([*origin.faults, *origin.warnings])
    printer = console.out()
    heats = [name for name in model.columns if name not in model.sensors]
    printer.print(
        f"{model.kind}: {', '.join(model.sensors) or 'no sensor'}"
        + (f"; heat from {', '.join(heats)}" if heats else "")
    )
    for channel in model.channels:
        if channel.slope:
            low, high = (1e3 * end for end in channel.slope.stroke)
            printer.print(
                f"{channel.name}: K0 at {channel.slope.position} {1e3 * channel.slope.reference:g}"
                f" and a slope, read from {low:g} to {high:g} mm"
            )
    columns = console.numeric(*(channel.name for channel in model.channels))
    table = Table("kind", *columns, title="rms error on blocks of time held out, um")
    for kind, errors in origin.errors_um.items():
        table.add_row(kind, *(f"{value:.2f}" for value in errors))
    printer.print(table)
    best = origin.best(model.kind)
    worst = ", ".join(
        f"{channel.name} {value:.2f} um"
        for channel, value in zip(model.channels, origin.worst_um[best], strict=True)
    )
    printer.print(
        f"verdict by the worst block held out: {best} ({worst})"
        + ("" if best == model.kind else f"; learn it with --kind {best}")
    )
