"""The command `export`: an estimator as a program for a control."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds
from thermojoint.cli.log_reading import ColumnOption, MappingOption, opened_log, over, renamed_by

if TYPE_CHECKING:
    from estimator.export.program import Operations, Program
    from estimator.kind import Kind, OpenedEstimator, Options


#: Target of an export.
Target = Literal["c", "st", "fmu", "fmi2"]


def export(  # noqa: PLR0913 - the options of a command
    model: Annotated[
        Path,
        typer.Argument(help="Model file, learned or joint-aware model, or what 'assemble' wrote."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the program, or the FMU to write.")],
    to: Annotated[
        Target,
        typer.Option(
            help="c: C99; st: IEC 61131-3 Structured Text; fmu: a unit for co-simulation, FMI "
            "3.0; fmi2: the same, FMI 2.0."
        ),
    ] = "c",
    precision: Annotated[
        Literal["double", "single"], typer.Option(help="Precision of every number in the program.")
    ] = "double",
    name: Annotated[
        str, typer.Option(help="Prefix of the names of files and symbols.")
    ] = "thermojoint",
    samples: Annotated[
        Path | None,
        typer.Option(help="Log (CSV) or response (.nc) for the self-test; default: a duty cycle."),
    ] = None,
    interval: Annotated[
        float | None,
        typer.Option(
            "--interval-s",
            help="Nominal sampling interval of a model file or learned model, s; default: 2.",
        ),
    ] = None,
    run_length: Annotated[
        float | None,
        typer.Option(
            "--run-length-min", help="Length of a run of a model file, min; default: 120."
        ),
    ] = None,
    column: ColumnOption = None,
    mapping: MappingOption = None,
) -> None:
    """Export an estimator as a program for a control, with its self-test.

    Example: [bold]thermojoint export estimator.json --to c --out spindle_c --name spindle[/bold]

    Example: [bold]thermojoint export model.json --to c --precision single --samples measured.csv
    --out spindle_c[/bold]

    A joint-aware model is exported for usual samples; its header lists what is not included.

    Example: [bold]thermojoint export model.h5 --to c --out machine_c --name machine[/bold]

    Example: [bold]thermojoint export estimator.json --to st --out spindle_st --name spindle[/bold]

    Example: [bold]thermojoint export estimator.json --to fmu --out spindle.fmu[/bold]
    """
    from estimator.export.program import checked_name
    from estimator.exporting import export_program
    from estimator.kind import Options
    from estimator.registry import kind_of_file
    from thermojoint import console

    one_file = to in ("fmu", "fmi2")
    if one_file:
        arguments.check_outputs({"--out": (out, file_kinds.FMU)}, [model, samples, mapping])
    else:
        arguments.check_whole_folder(out)
    dt = arguments.positive("--interval-s", 2.0 if interval is None else interval)
    length = arguments.positive("--run-length-min", 120.0 if run_length is None else run_length)
    kind = kind_of_file(model)
    given = kind.read(model)
    arguments.check_pace(kind, given, {"--run-length-min": run_length})
    checked_name(name)
    origin = samples.name if samples else ""
    if samples is None or samples.suffix == ".nc":
        logged = "--samples" if samples is None else "a log"
        arguments.only_for(logged, {"--column": column, "--mapping": mapping})
    renamed = renamed_by(column, mapping)
    with (
        console.working("exporting"),
        _opened(kind, given, samples, renamed, Options(dt, 60.0 * length)) as (estimator, rows),
    ):
        program = export_program(estimator, precision, name, rows, origin, dt)
        own = program.interface.interval
        if interval is not None and not math.isclose(interval, own):
            raise InputError(
                f"--interval-s {interval:g}: {model} is made for {own:g} s; leave it out, and call "
                "the program at that interval"
            )
        files = _written(program, to, out)
    _show(program)
    console.wrote(*files)


def _written(program: Program, to: Target, out: Path) -> list[Path]:
    from estimator.export.c_source import write_c
    from estimator.export.fmu import Standard, write_fmu
    from estimator.export.structured_text import write_structured_text

    if to == "c":
        return write_c(program, out)
    if to == "st":
        return write_structured_text(program, out)
    write_fmu(program, out, Standard.FMI2 if to == "fmi2" else Standard.FMI3)
    return [out]


@contextmanager
def _opened(
    kind: Kind[Any, Any],
    given: Any,  # noqa: ANN401
    samples: Path | None,
    renamed: Mapping[str, str],
    options: Options,
) -> Iterator[tuple[OpenedEstimator, Iterable[Sequence[float]] | None]]:
    """Give the estimator, and the samples of a log or response if there is one."""
    from estimator.kind import Cold
    from estimator.registry import started
    from thermojoint.artefacts.response import read_response

    estimator = started(kind, given, options)
    if samples is None:
        yield estimator, None
        return
    with opened_log(samples, over(kind.renamed(given), renamed)) as pieces:
        if pieces is None:
            yield estimator, kind.response(given, read_response(samples))
        else:
            yield estimator, kind.log(given, pieces, str(samples), None, Cold())


def _show(program: Program) -> None:
    """Print sizes and costs."""
    from thermojoint import console

    out = console.out()
    out.print(f"constants  {program.constants} bytes")
    out.print(f"state      {program.state} bytes")
    out.print(f"self-test  {program.samples} samples")
    for label, operations in zip(program.labels, (program.usual, program.worst), strict=True):
        out.print(f"{label}: {_counted(operations)}")


def _counted(operations: Operations) -> str:
    text = (
        f"{operations.multiplications} multiplications, {operations.additions} additions, "
        f"{operations.divisions} divisions"
    )
    return text + (
        f", {operations.functions} functions such as exp" if operations.functions else ""
    )
