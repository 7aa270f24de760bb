"""The command line: reads what it is given, calls the packages, prints and writes."""

from __future__ import annotations

import csv
import json
import math
import os
import signal
from collections.abc import Iterator
from enum import StrEnum
from importlib.metadata import version
from importlib.resources import as_file, files
from pathlib import Path
from types import FrameType
from typing import Annotated

import numpy as np
import typer

from artefacts.errors import InputError, ThermojointError
from artefacts.files import write_text
from artefacts.response import read_response, write_response
from calibrate.model_file import read_model, read_provenance, write_model
from estimator.assembly import start
from estimator.fchs import initial_state, stream
from estimator.state_file import load_state, save_state
from fesim import state_file
from fesim.case import read_case
from fesim.setup import UNITS, build_structure, check_names, set_up
from fesim.simulate import simulate as run_case
from fesim.snapshots import snapshot_writer
from meshes.cad import mesh_cad, read_names
from meshes.exchange import read_structure
from meshes.inspection import inspect as look_over
from thermojoint import (
    arguments,
    console,
    inspection_report,
    measured,
    study,
    verification_run,
)
from thermojoint.pictures import check_png, write_pictures
from thermojoint.provenance import provenance_of
from thermojoint.reproduce import reproduce as run_all
from thermojoint.summary import compare_schemes, convergence
from thermojoint.tables import printed_tables, tables_json
from thermojoint.view import Show, bare_structure, draw

#: Exit code of everything the user can mend.
BAD_INPUT = 2
#: Exit code of `verify` if a check is out of tolerance.
OUT_OF_TOLERANCE = 1

app = typer.Typer(
    help="Nonlinear thermoelastic machine tools: simulate the joints, calibrate the generalised "
    "models, estimate the displacement in real time from temperatures.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)


class Unit(StrEnum):
    """Units of a mesh file."""

    m = "m"
    cm = "cm"
    mm = "mm"
    inch = "in"


ModelFile = Annotated[Path, typer.Argument(help="Model file (JSON) written by 'calibrate'.")]


def main() -> None:
    """Run the command line; errors a user can mend are one line on standard error, exit code 2."""
    signal.signal(signal.SIGTERM, _stop)
    # What overflows does not converge or is not finite, and is refused there, in one line.
    np.seterr(over="ignore", invalid="ignore", divide="ignore")
    try:
        app()
    except ThermojointError as error:
        _fail(str(error))
    except MemoryError as error:
        _fail(f"not enough memory ({error}); take larger elements or a shorter run")
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror or error}; choose another place")


def _stop(number: int, frame: FrameType | None) -> None:
    """End as after Ctrl-C, so that no half-written file stays behind."""
    raise SystemExit(128 + number)


def _fail(message: str) -> None:
    console.say("thermojoint: " + " ".join(message.split()))
    raise SystemExit(BAD_INPUT)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"thermojoint {version('thermojoint')}")
        raise typer.Exit


@app.callback()
def _every_command(
    show_version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version and end.", callback=_show_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Options before the command."""


@app.command()
def simulate(
    case: Annotated[Path, typer.Argument(help="Case file (TOML).")],
    out: Annotated[Path, typer.Option(help="Response file to write (NetCDF).")],
    save: Annotated[
        Path | None, typer.Option("--save-state", help="Write the state at the end here (NPZ).")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option("--continue", help="Go on from a saved state (NPZ).")
    ] = None,
    snapshots: Annotated[
        Path | None,
        typer.Option(
            help="Folder for field snapshots (VTU/PVD) at the case's output.snapshots_s, or at "
            "the end if it names none."
        ),
    ] = None,
) -> None:
    """Simulate a case: heat, contact and displacement in time.

    Example: [bold]thermojoint simulate machine.toml --out machine.nc[/bold]

    Example: [bold]thermojoint simulate longer.toml --continue half.npz --out rest.nc[/bold]
    """
    arguments.check_writable(out, save)
    given = read_case(case)
    times = given.output.snapshots_s
    folder = snapshots or (out.with_name(f"{out.stem}-snapshots") if times else None)
    if folder:
        arguments.check_folder(folder)
    begin = state_file.load_state(resume, given) if resume else None
    with console.progress_bars() as report:
        report("setting up", 0, 1)
        setup = set_up(given)
        report("setting up", 1, 1)
        finished = run_case(
            given,
            setup=setup,
            start=begin,
            on_step=snapshot_writer(setup, folder, times or [60.0 * given.march.duration_min])
            if folder
            else None,
            progress=lambda done, total: report("marching", done, total),
        )
    write_response(finished.response, out)
    if save:
        state_file.save_state(finished.state, given, save)
    console.show_convergence(console.out(), {out.name: convergence(finished.response)})
    _wrote(out, save, folder)


@app.command()
def calibrate(
    reference: Annotated[Path, typer.Option(help="Response to the reference step (NetCDF).")],
    given: Annotated[
        list[str],
        typer.Option("--input", help="Another step: LEVEL=RESPONSE; give two or more."),
    ],
    out: Annotated[Path, typer.Option(help="Model file to write (JSON).")],
    distances: Annotated[
        str | None,
        typer.Option(
            "--distances-mm",
            help="r11,r12,r21,r22 from fictitious source i to sensor Tj; measured responses need "
            "them. Default: the sources lie at the contact elements nearest to T1 and T2.",
        ),
    ] = None,
) -> None:
    """Calibrate the generalised models: Tables 1-3.

    Example: [bold]thermojoint calibrate --reference r1.nc --input 0.5=r05.nc --input 2=r2.nc --out
    model.json[/bold]

    Example: [bold]thermojoint calibrate --reference measured-1.nc --input 0.5=measured-05.nc
    --input 2=measured-2.nc --distances-mm 50,125,110,60 --out model.json[/bold]
    """
    arguments.check_writable(out)
    apart = arguments.distances(distances) if distances is not None else None
    base = read_response(reference)
    others = {level: read_response(path) for level, path in map(arguments.level_and_file, given)}
    if len(others) < len(given):
        raise InputError("--input: a heat input is given twice; give each once")
    with console.progress_bars() as report:
        report("calibrating", 0, 1)
        calibrated = study.calibrate_responses(base, others, apart)
        report("calibrating", 1, 1)
    case = str(base.attrs.get("case", reference.name))
    provenance = provenance_of(calibrated, case)
    write_model(calibrated.model, out, provenance)
    console.show_tables(console.out(), printed_tables(tables_json(calibrated.model, provenance)))
    _wrote(out)


@app.command()
def tables(
    model: ModelFile,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Print Tables 1-3 of a model with the paper's values beside them.

    Example: [bold]thermojoint tables model.json[/bold]

    Example: [bold]thermojoint tables model.json --json > tables.json[/bold]
    """
    content = tables_json(read_model(model), read_provenance(model))
    if as_json:
        print(json.dumps(content, indent=2, allow_nan=False))
    else:
        console.show_tables(console.out(), printed_tables(content))


@app.command()
def estimate(
    model: ModelFile,
    temperatures: Annotated[
        Path,
        typer.Argument(
            metavar="MEASURED",
            help="CSV of measured temperatures, '-' for standard input, or a response (.nc).",
            allow_dash=True,
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="CSV to write, '-' for standard output.", allow_dash=True)
    ],
    interval: Annotated[
        float | None,
        typer.Option("--interval-s", help="Nominal sampling interval, s; default: the first one."),
    ] = None,
    run_length: Annotated[
        float, typer.Option("--run-length-min", help="Length of a run, min.")
    ] = 120.0,
    save: Annotated[
        Path | None, typer.Option("--save-state", help="Write the estimator's state here (JSON).")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option("--continue", help="Go on from a saved state (JSON).")
    ] = None,
) -> None:
    """Estimate heat and displacement from temperatures alone, row by row.

    The CSV has the columns time_s, delta_T_K, T1_K, T2_K (above the current ambient), or time_s,
    a_degC, b_degC, T1_degC, T2_degC, ambient_degC. Intervals may vary, rows may be missing.

    Example: [bold]thermojoint estimate model.json measured.csv --out estimate.csv[/bold]

    With --out -, the state is saved also where a bad row or a signal ends the run.

    Example: [bold]logger | thermojoint estimate model.json - --interval-s 1 --out -[/bold]
    """
    arguments.check_writable(out, save)
    if not 0.0 < run_length < math.inf:
        raise InputError(f"--run-length-min {run_length:g}: give a positive number of minutes")
    table = read_model(model)
    sensors, where = list(table.linear.direct), arguments.shown(temperatures)
    with arguments.opened(temperatures) as source:
        samples: Iterator[measured.Sample]
        if source is None:
            samples = measured.response_samples(read_response(temperatures), table)
        else:
            samples = measured.read_samples(source, sensors, where)
        nominal, samples = measured.nominal_interval(samples, interval, where)
        machine = start(table, nominal, 60.0 * run_length)
        state = load_state(machine, resume) if resume else initial_state(machine)
        with arguments.output(out) as target:
            writer = csv.writer(target, lineterminator="\n")
            writer.writerow(measured.estimate_header(machine.axes, sensors))
            try:
                for reached, result in stream(machine, samples, state):
                    state = reached
                    writer.writerow(measured.estimate_row(result))
                    target.flush()
            finally:
                # What stands on standard output is out, however a logger's pipe comes to its end.
                if save and str(out) == "-":
                    save_state(machine, state, save)
    if save and str(out) != "-":
        save_state(machine, state, save)
    _wrote(None if str(out) == "-" else out, save)


@app.command()
def validate(
    model: ModelFile,
    responses: Annotated[list[Path], typer.Argument(help="Responses to validate against.")],
    reference: Annotated[
        Path | None,
        typer.Option(help="Response to the reference step: makes the nonlinear part exact."),
    ] = None,
    noise_pp: Annotated[
        float | None,
        typer.Option("--noise-pp", help="Peak-to-peak noise put on every temperature, K."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise.")] = 0,
    out: Annotated[Path | None, typer.Option(help="JSON to write.")] = None,
) -> None:
    """Judge the estimator: it sees the temperatures, the displacement is the judge.

    Example: [bold]thermojoint validate model.json step-3.nc --reference r1.nc[/bold]

    Example: [bold]thermojoint validate model.json triangle.nc --noise-pp 0.12 --seed 1[/bold]
    """
    arguments.check_writable(out)
    table = read_model(model)
    base = read_response(reference) if reference else None
    given = {path.stem: read_response(path) for path in responses}
    if len(given) < len(responses):
        raise InputError("validate: two responses have the same name; rename one")
    if noise_pp is not None:
        # Not "-noise": that is the paper's own case, with its noise on T1 and T2 alone.
        given = {
            f"{name}, {noise_pp:g} K noise": measured.with_noise(response, table, noise_pp, seed)
            for name, response in given.items()
        }
    found = study.validate_model(table, base, given)
    if out:
        write_text(out, json.dumps(found.figures(), indent=2) + "\n")
    console.show_validation(console.out(), found.rows)
    schemes = compare_schemes(found.rows, found.as_printed, found.vectors)
    console.show_schemes(console.out(), schemes)
    console.show_blocks(console.out(), found.blocks)
    _wrote(out)


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for all results.")] = Path("results"),
    case: Annotated[
        Path | None, typer.Option(help="Another case file; default: the reference machine.")
    ] = None,
) -> None:
    """Run the whole chain: simulate, calibrate, Tables 1-3, validate, figures, report.

    Example: [bold]thermojoint reproduce --out results[/bold]

    Example: [bold]thermojoint reproduce --case my_machine.toml --out my_results[/bold]
    """
    arguments.check_folder(out)
    with as_file(files("thermojoint") / "cases" / "reference.toml") as standard:
        given = read_case(case or standard)
    run_all(given, out)
    _wrote(out)


@app.command()
def view(
    source: Annotated[Path, typer.Argument(help="Case file (TOML) or response (NetCDF).")],
    out: Annotated[Path, typer.Option(help="Picture to write (PNG; curves also SVG, PDF).")],
    show: Annotated[
        Show | None,
        typer.Option(help="What to show; default: the structure of a case, a response's curves."),
    ] = None,
) -> None:
    """Draw a structure, its curves, or its fields at the end of the run.

    Temperature, deformation and pressure simulate the case, or the case inside the response.

    Example: [bold]thermojoint view machine.toml --out machine.png[/bold]

    Example: [bold]thermojoint view machine.nc --show deformation --out deformed.png[/bold]
    """
    arguments.check_writable(out)
    with console.progress_bars() as report:
        draw(source, show, out, report)
    _wrote(out)


@app.command()
def verify(
    out: Annotated[Path | None, typer.Option(help="JSON to write.")] = None,
    markdown: Annotated[
        Path | None, typer.Option(help="Page to write (Markdown), as in the docs.")
    ] = None,
) -> None:
    """Verify the simulator: known results against computed ones; exit code 1 if any is off.

    Example: [bold]thermojoint verify[/bold]

    Example: [bold]thermojoint verify --out verify.json[/bold]
    """
    arguments.check_writable(out, markdown)
    with console.progress_bars() as report:
        results = verification_run.run_all(report)
    verification_run.show(console.out(), results)
    verification_run.write(results, out, markdown)
    _wrote(out, markdown)
    if not all(result.passed for result in results):
        raise typer.Exit(OUT_OF_TOLERANCE)


@app.command()
def mesh(
    part: Annotated[Path, typer.Argument(help="CAD file: STEP, IGES or BREP.")],
    out: Annotated[Path, typer.Option(help="Mesh file to write (MSH, in m).")],
    size: Annotated[float, typer.Option("--size-mm", help="Largest element edge, mm.")],
    order: Annotated[int, typer.Option(min=1, max=2, help="1, or 2 for curved cells.")] = 1,
    names: Annotated[
        Path | None,
        typer.Option(help="TOML: [surfaces_mm] with NAME = [[x, y, z], ...], points on faces."),
    ] = None,
) -> None:
    """Mesh a CAD part with its names; needs Gmsh, the extra 'gmsh'.

    Solids become bodies, faces of two solids that lie on each other the sides of a joint, faces
    without a name BODY_outer.

    Example: [bold]thermojoint mesh part.step --size-mm 10 --out part.msh[/bold]
    """
    arguments.check_writable(out)
    if not 0.0 < size < math.inf:
        raise InputError(f"--size-mm {size:g}: give a positive length")
    mesh_cad(part, out, 1e-3 * size, order, read_names(names) if names else None)
    found = look_over(read_structure(out))
    inspection_report.show(console.out(), str(out), found)
    _wrote(out)


@app.command()
def inspect(
    source: Annotated[Path, typer.Argument(help="Mesh file, or case file (TOML).")],
    unit: Annotated[
        Unit, typer.Option(help="Unit of a mesh file's coordinates; a case says its own.")
    ] = Unit.m,
    out: Annotated[Path | None, typer.Option(help="Picture to write (PNG).")] = None,
    as_json: Annotated[Path | None, typer.Option("--json", help="JSON to write.")] = None,
    skeleton: Annotated[
        Path | None, typer.Option("--case", help="Case file to start from, to write (TOML).")
    ] = None,
) -> None:
    """Look a mesh over before simulating it: names, volumes, quality, joints, what looks wrong.

    Example: [bold]thermojoint inspect part.msh[/bold]

    Example: [bold]thermojoint inspect part.msh --unit mm --out part.png --case part.toml[/bold]
    """
    arguments.check_writable(out, as_json, skeleton)
    if out:
        check_png(out)
    if source.suffix == ".toml":
        if skeleton:
            raise InputError(f"--case {skeleton}: {source} is a case already; give its mesh file")
        case = read_case(source)
        structure = build_structure(case)
        check_names(case, structure)
    else:
        structure = read_structure(source, UNITS[unit.value])
    found = look_over(structure)
    inspection_report.show(console.out(), str(source), found)
    if as_json:
        write_text(as_json, inspection_report.as_json(found))
    if skeleton:
        write_text(skeleton, inspection_report.case_skeleton(source, skeleton, unit.value, found))
    if out:
        write_pictures({out: bare_structure(structure)})
    _wrote(as_json, skeleton, out)


@app.command()
def batch(
    given: Annotated[Path, typer.Argument(metavar="STUDY", help="Study file (TOML).")],
    out: Annotated[Path, typer.Option(help="Folder for all results; goes on with what is there.")],
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine; default: one for each core.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Use this Dask cluster instead, e.g. tcp://10.0.0.1:8786."),
    ] = None,
) -> None:
    """Simulate many cases: grids, lists and Latin hypercubes over the values of a case.

    Responses, one dataset of all of them and a summary table go into the folder. Interrupted in
    any way, the same command goes on from there. Exit code 1 if a case failed.

    Example: [bold]thermojoint batch study.toml --out results[/bold]

    Example: [bold]thermojoint batch study.toml --out results --scheduler tcp://10.0.0.1:8786[/bold]
    """
    # Here, not above: the other commands need neither Zarr nor Arrow.
    from thermojoint import batch_run

    batch_run.check_workers(workers, scheduler)
    finished = batch_run.run_study(given, out, workers or os.cpu_count() or 1, scheduler)
    for line in batch_run.closing_lines(finished, out):
        console.say(line)
    if code := batch_run.worst(finished):
        raise typer.Exit(code)


def _wrote(*paths: Path | None) -> None:
    for path in paths:
        if path is not None:
            console.say(f"wrote {path}")


if __name__ == "__main__":
    main()
