"""The command that takes an estimator to a control."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermojoint.cli import arguments, file_kinds, joint_aware

if TYPE_CHECKING:
    from estimator.export import c_source
    from estimator.export.c_source import Exported, Operations


class Target(StrEnum):
    """What an estimator is exported to."""

    C = "c"
    FMU = "fmu"
    FMI2 = "fmi2"


class Precision(StrEnum):
    """Of every number in the program; as `estimator.export.c_source.Precision`."""

    DOUBLE = "double"
    SINGLE = "single"


def export(
    model: Annotated[
        Path,
        typer.Argument(help="Model file, joint-aware model, or what 'assemble' wrote."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the program, or the FMU to write.")],
    to: Annotated[
        Target,
        typer.Option(
            help="c: C99; fmu: a unit for co-simulation, FMI 3.0; fmi2: the same, FMI 2.0."
        ),
    ] = Target.C,
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

    A joint-aware model is exported with what its usual samples need; its header says what is not.

    Example: [bold]thermojoint export model.h5 --to c --out machine_c --name machine[/bold]

    Example: [bold]thermojoint export estimator.json --to fmu --out spindle.fmu[/bold]
    """
    from artefacts.files import write_text
    from artefacts.folders import whole_folder
    from estimator.export import c_source
    from estimator.export.fmu import Standard, write_fmu
    from estimator.joint_aware.recognition import is_observer
    from thermojoint.cli import console

    if to is not Target.C:
        arguments.check_outputs({"--out": (out, file_kinds.FMU)}, [model, samples])
    else:
        arguments.check_whole_folder(out)
    dt = arguments.positive("--interval-s", interval)
    length = arguments.positive("--run-length-min", run_length)
    c_source.checked_name(name)
    numbers = c_source.Precision(precision.value)
    if is_observer(model):
        found = _joint_aware(model, numbers, name, samples)
    else:
        found = _fchs(model, numbers, name, samples, dt, 60.0 * length)
    if to is not Target.C:
        write_fmu(found, out, Standard.FMI2 if to is Target.FMI2 else Standard.FMI3)
        written = [out]
    else:
        with whole_folder(out) as folder:
            for file, text in found.files.items():
                write_text(folder / file, text)
        written = [out / file for file in found.files]
    _show(found)
    console.wrote(*written)


def _fchs(
    model: Path,
    precision: c_source.Precision,
    name: str,
    samples: Path | None,
    interval: float,
    run_length: float,
) -> Exported:
    from artefacts.response import read_response
    from estimator import measured
    from estimator.export.fchs import export_fchs
    from estimator.starting import started

    estimator, _ = started(model, interval, run_length)
    if samples is None:
        return export_fchs(estimator, precision, name)
    table = estimator.assembly.model
    with arguments.opened(samples) as source:
        if source is None:
            rows = measured.response_samples(read_response(samples), table)
        else:
            rows = measured.read_samples(source, list(table.linear.direct), str(samples))
        return export_fchs(estimator, precision, name, rows, samples.name)


def _joint_aware(
    model: Path, precision: c_source.Precision, name: str, samples: Path | None
) -> Exported:
    from artefacts.response import read_response
    from estimator.export.joint_aware import export_joint_aware
    from estimator.joint_aware.estimator import JointAware
    from estimator.joint_aware.model_file import read_observer

    estimator = JointAware(read_observer(model))
    if samples is None:
        return export_joint_aware(estimator, precision, name)
    with arguments.opened(samples) as source:
        response = read_response(samples) if source is None else None
        _, _, rows = joint_aware.opened(model, source, response, str(samples), joint_aware.Start())
        return export_joint_aware(estimator, precision, name, rows, samples.name)


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
