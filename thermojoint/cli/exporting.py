"""The command that takes an estimator to a control."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermojoint.cli import arguments

if TYPE_CHECKING:
    from estimator.export.c_source import Exported, Operations
    from estimator.measured import Sample
    from models.parameters import Model


class Target(StrEnum):
    """What an estimator is exported to."""

    C = "c"


class Precision(StrEnum):
    """Of every number in the program; as `estimator.export.c_source.Precision`."""

    DOUBLE = "double"
    SINGLE = "single"


def export(
    model: Annotated[
        Path, typer.Argument(help="Model file, or an estimator that 'assemble' wrote.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the program.")],
    to: Annotated[Target, typer.Option(help="c: C99.")] = Target.C,
    precision: Annotated[
        Precision, typer.Option(help="Of every number in the program.")
    ] = Precision.DOUBLE,
    name: Annotated[
        str, typer.Option(help="Begins the names of its files and symbols.")
    ] = "thermojoint",
    samples: Annotated[
        Path | None,
        typer.Option(help="Log (CSV) or response (.nc) for the self-test; default: a duty cycle."),
    ] = None,
    interval: Annotated[
        float, typer.Option("--interval-s", help="Nominal sampling interval of a model file, s.")
    ] = 2.0,
    run_length: Annotated[
        float, typer.Option("--run-length-min", help="Length of a run of a model file, min.")
    ] = 120.0,
) -> None:
    """Export an estimator as a program for a control, with its self-test.

    Example: [bold]thermojoint export estimator.json --to c --out spindle_c --name spindle[/bold]

    Example: [bold]thermojoint export model.json --to c --precision single --samples measured.csv
    --out spindle_c[/bold]
    """
    from artefacts.errors import InputError
    from artefacts.files import write_text
    from artefacts.folders import whole_folder
    from estimator.export import c_source
    from estimator.export.fchs import export_fchs
    from estimator.joint_aware.recognition import is_observer
    from estimator.starting import started
    from thermojoint.cli import console

    arguments.check_whole_folder(out)
    dt = arguments.positive("--interval-s", interval)
    length = arguments.positive("--run-length-min", run_length)
    c_source.checked_name(name)
    if is_observer(model):
        raise InputError(
            f"{model}: a joint-aware model has no export yet; export a model of 'calibrate --kind "
            "fchs', or run it with 'thermojoint estimate'"
        )
    estimator, _ = started(model, dt, 60.0 * length)
    recorded = _recorded(samples, estimator.assembly.model) if samples else None
    origin = samples.name if samples else "a day of a duty cycle"
    found = export_fchs(estimator, c_source.Precision(precision.value), name, recorded, origin)
    with whole_folder(out) as folder:
        for file, text in found.files.items():
            write_text(folder / file, text)
    _show(found)
    console.wrote(*(out / file for file in found.files))


def _recorded(path: Path, model: Model) -> Iterator[Sample]:
    """Yield the samples of a log or of a response."""
    from artefacts.response import read_response
    from estimator import measured

    with arguments.opened(path) as source:
        if source is None:
            yield from measured.response_samples(read_response(path), model)
        else:
            yield from measured.read_samples(source, list(model.linear.direct), str(path))


def _show(found: Exported) -> None:
    """Print sizes and costs."""
    from thermojoint.cli import console

    out = console.out()
    out.print(f"constants  {found.constants} bytes")
    out.print(f"state      {found.state} bytes")
    out.print(f"self-test  {found.samples} samples")
    for label, one in zip(found.labels, (found.usual, found.worst), strict=True):
        out.print(f"{label}: {_counted(one)}")


def _counted(one: Operations) -> str:
    text = (
        f"{one.multiplications} multiplications, {one.additions} additions, "
        f"{one.divisions} divisions"
    )
    return text + (f", {one.functions} of exp, sin, cos" if one.functions else "")
