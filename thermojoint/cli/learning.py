"""The command `learn`, and what `estimate` and `validate` do where the model was learned."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO, cast

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds, joint_aware

if TYPE_CHECKING:
    from estimator.learned.estimator import Learned
    from estimator.learned.samples import Sample
    from thermojoint.artefacts.arrays import Array
    from thermojoint.models.learned import LearnedModel


class LearnedKind(StrEnum):
    """Kinds of models that can be learned from a log."""

    LEARNED = "learned"
    LINEAR = "linear"
    RIDGE = "ridge"
    ARX = "arx"
    JOINT_AWARE = "joint-aware"


def learn(
    logs: Annotated[list[Path], typer.Argument(help="Logs (CSV), in the order of time.")],
    displacement: Annotated[
        list[str], typer.Option(help="A column to learn, e.g. x_um; give one or more.")
    ],
    out: Annotated[Path, typer.Option(help="Model file to write (JSON).")],
    max_sensors: Annotated[int, typer.Option(help="How many temperatures the model may use.")] = 4,
    kind: Annotated[
        LearnedKind,
        typer.Option(help="learned; a baseline on all temperatures; or the physics of --case."),
    ] = LearnedKind.LEARNED,
    case: Annotated[
        Path | None, typer.Option(help="Case file of the machine, for --kind joint-aware.")
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(help="THEIRS=OURS: what a column of the log is called, with its unit."),
    ] = None,
    mapping: Annotated[
        Path | None, typer.Option(help="For many, TOML: \\[columns], 'Temp 1' = 'T1_degC'.")
    ] = None,
    ignore: Annotated[
        list[str] | None, typer.Option(help="A column to leave aside; may be repeated.")
    ] = None,
) -> None:
    """Learn an estimator from a machine's log: temperatures, speed and displacement.

    Names of columns end in their units: time_s, spindle_rpm, T1_degC, x_um. Sensors that are
    stuck or were moved are named and left out.

    Example: [bold]thermojoint learn log.csv --displacement disp1_um --displacement disp2_um
    --max-sensors 4 --out model.json[/bold]

    Example: [bold]thermojoint learn monday.csv tuesday.csv --displacement z_um --column
    'Zeit=time_s' --out model.json[/bold]

    Where there is a mesh, its physics learns from the same log: temperatures named after the
    probes, the heat as heat_W, every run from rest.

    Example: [bold]thermojoint learn log.csv --displacement x_um --kind joint-aware
    --case machine.toml --out model.h5[/bold]
    """
    from calibrate.learning.learn import Kind
    from calibrate.learning.learn import learn as learned
    from thermojoint import console
    from thermojoint.artefacts.log_file import log_pieces
    from thermojoint.models.learned import write_learned

    renamed = _renamed(column, mapping)
    if kind is LearnedKind.JOINT_AWARE:
        joint_aware.learn(case, logs, displacement, renamed, out)
        return
    arguments.only_for("--kind joint-aware", {"--case": case})
    arguments.check_outputs({"--out": (out, file_kinds.LEARNED)}, [*logs, mapping])
    pieces = log_pieces(logs, renamed)
    files = [path.name for path in logs]
    wanted = cast("Kind", kind.value)
    with console.working("learning"):
        model = learned(pieces, displacement, max_sensors, wanted, ignore or (), files, renamed)
    write_learned(model, out)
    _show(model)
    console.wrote(out)


def _renamed(column: Sequence[str] | None, mapping: Path | None) -> dict[str, str]:
    from thermojoint.artefacts.log_file import read_mapping
    from thermojoint.artefacts.quantities import column_named

    found = read_mapping(mapping) if mapping else {}
    for text in column or ():
        theirs, _, ours = text.rpartition("=")
        if not theirs or column_named(ours) is None:
            raise InputError(
                f"--column {text}: write THEIRS=OURS with a unit at the end, e.g. 'Temp 1=T1_degC'"
            )
        found[theirs] = ours
    return found


def _show(model: LearnedModel) -> None:
    """Print what was found, what was chosen, and how its error compares."""
    from rich.table import Table

    from thermojoint import console

    told = model.learned_from
    for fault in told.faults:
        console.warn([fault])
    for warning in told.warnings:
        console.warn([warning])
    printer = console.out()
    heats = [name for name in model.columns if name not in model.sensors]
    printer.print(
        f"{model.kind}: {', '.join(model.sensors) or 'no sensor'}"
        + (f"; heat from {', '.join(heats)}" if heats else "")
    )
    table = Table(title="rms error on blocks of time held out, um")
    table.add_column("kind")
    for one in model.channels:
        table.add_column(one.name, justify="right")
    for kind, errors in told.errors_um.items():
        table.add_row(kind, *(f"{value:.2f}" for value in errors))
    printer.print(table)
    own = told.errors_um[model.kind]
    for kind, errors in told.errors_um.items():
        better = [
            one.name for one, a, b in zip(model.channels, errors, own, strict=True) if a < 0.9 * b
        ]
        if better:
            printer.print(
                f"{kind}, on all sensors, is better here on {', '.join(better)}: --kind {kind}"
            )


def opened(
    model: Path,
    source: TextIO | None,
    where: str,
    resume: Path | None,
    readings: Path | None,
    reading_noise_um: float | None,
) -> tuple[Learned, Array, Iterable[Sample]]:
    """Return the estimator, the state to go on from, and the samples of a log."""
    from estimator.learned.samples import samples_of
    from estimator.learned.starting import started
    from estimator.touches import read_touches, with_touches
    from thermojoint.artefacts.tables.pieces import ROWS, pieces_in

    if source is None:
        raise InputError(f"{where}: a response; a learned model takes a log (CSV)")
    noise = arguments.reading_noise(reading_noise_um, readings)
    estimator, state = started(model, resume, noise)
    # What comes in live is told at once.
    rows = 1 if where == "standard input" else ROWS
    known = estimator.model
    renamed = known.renamed_in(known.columns)
    samples = samples_of(known, pieces_in(source, where, renamed, rows))
    if readings is not None:
        samples = with_touches(samples, *read_touches(readings, estimator.axes))
    return estimator, state, samples


def estimate(opened: tuple[Learned, Array, Iterable[Sample]], out: Path, save: Path | None) -> None:
    """Write one row for each sample: displacements as the log names them, bands, status."""
    from estimator.interface import follow
    from estimator.learned.saved_state import save_state
    from thermojoint.artefacts.quantities import column_named
    from thermojoint.artefacts.unfinished import cleared_at_stop

    estimator, state, samples = opened
    columns = [one for name in estimator.axes if (one := column_named(name))]
    live = str(out) == "-"

    def keep_state() -> None:
        if save and live:
            save_state(estimator, state, save)

    with arguments.output(out) as target, cleared_at_stop(keep_state):
        writer = csv.writer(target, lineterminator="\n")
        bands = (f"band_{name}" for name in estimator.axes)
        writer.writerow(["time_s", *estimator.axes, *bands, "status"])
        try:
            for reached, result in follow(estimator, samples, state):
                state = reached
                values = [
                    one.from_si(value)
                    for part in (result.displacement, result.band)
                    for one, value in zip(columns, part, strict=True)
                ]
                numbers = (f"{float(value):.9g}" for value in values)
                writer.writerow([f"{result.time:.12g}", *numbers, result.status.words])
                if live:
                    target.flush()
        finally:
            keep_state()
    if save and not live:
        save_state(estimator, state, save)


def validate(model: Path, logs: Sequence[Path], out: Path | None) -> None:
    """Judge a learned model by logs that it has not seen."""
    from estimator.learned.judging import judge
    from estimator.learned.starting import started
    from thermojoint import console
    from thermojoint.artefacts.files import write_text
    from thermojoint.artefacts.log_file import read_log

    estimator, _ = started(model)
    if len({path.stem for path in logs}) < len(logs):
        raise InputError("validate: two logs have the same name; rename one")
    rows = []
    renamed = estimator.model.renamed_in(estimator.model.columns)
    with console.working("validating"):
        for path in logs:
            rows += judge(path.stem, estimator, read_log([path], renamed))
    if out:
        write_text(out, json.dumps({"rows": rows}, indent=2, allow_nan=False) + "\n")
    _show_rows(rows)
    console.wrote(out)


def _show_rows(rows: Sequence[Mapping[str, str | float]]) -> None:
    from rich.table import Table

    from thermojoint import console

    table = Table(title="errors from temperatures, speed and load alone, um")
    columns = {
        "rms error": "rms_error_um",
        "uncompensated": "rms_uncompensated_um",
        "zeroed at the start": "rms_error_zeroed_um",
        "uncompensated, zeroed": "rms_uncompensated_zeroed_um",
        "largest": "max_abs_error_um",
    }
    for name in ("case", "estimator", "axis"):
        table.add_column(name, no_wrap=True)
    for name in (*columns, "in the band"):
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(
            *(str(row[name]) for name in ("case", "estimator", "axis")),
            *(f"{float(row[name]):.2f}" for name in columns.values()),
            f"{100.0 * float(row['within_band']):.0f} %",
        )
    console.out().print(table)
