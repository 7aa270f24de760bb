"""Commands of the generalised models: calibrate, print, estimate, validate, the whole chain."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from artefacts.errors import InputError
from thermojoint import arguments, file_kinds

if TYPE_CHECKING:
    from thermojoint.measured import Sample

ModelFile = Annotated[Path, typer.Argument(help="Model file (JSON) written by 'calibrate'.")]


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
    from artefacts.response import read_response
    from calibrate.model_file import write_model
    from thermojoint import console, study
    from thermojoint.provenance import provenance_of
    from thermojoint.tables import printed_tables, tables_json

    pairs = [arguments.level_and_file(text) for text in given]
    inputs = [reference, *(path for _, path in pairs)]
    arguments.check_outputs({"--out": (out, file_kinds.MODEL)}, inputs)
    apart = arguments.distances(distances) if distances is not None else None
    base = read_response(reference)
    others = {level: read_response(path) for level, path in pairs}
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
    console.wrote(out)


def tables(
    model: ModelFile,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Print Tables 1-3 of a model with the paper's values beside them.

    Example: [bold]thermojoint tables model.json[/bold]

    Example: [bold]thermojoint tables model.json --json > tables.json[/bold]
    """
    from calibrate.model_file import read_model, read_provenance
    from thermojoint import console
    from thermojoint.tables import printed_tables, tables_json

    content = tables_json(read_model(model), read_provenance(model))
    if as_json:
        print(json.dumps(content, indent=2, allow_nan=False))
    else:
        console.show_tables(console.out(), printed_tables(content))


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
    from artefacts.response import read_response
    from calibrate.model_file import read_model
    from estimator.assembly import start
    from estimator.fchs import initial_state, stream
    from estimator.state_file import load_state, save_state
    from thermojoint import console, measured

    # Not with the state of --continue: it may be replaced by its successor.
    arguments.check_outputs(
        {
            "--out": (out, file_kinds.ESTIMATE),
            "--save-state": (save, file_kinds.ESTIMATOR_STATE),
        },
        [model, temperatures],
    )
    if not 0.0 < run_length < math.inf:
        raise InputError(f"--run-length-min {run_length:g}: give a positive number of minutes")
    table = read_model(model)
    sensors, where = list(table.linear.direct), arguments.shown(temperatures)
    live = str(out) == "-"
    with arguments.opened(temperatures) as source:
        samples: Iterator[Sample]
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
                if save and live:
                    save_state(machine, state, save)
    if save and not live:
        save_state(machine, state, save)
    console.wrote(None if live else out, save)


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
    from artefacts.files import write_text
    from artefacts.response import read_response
    from calibrate.model_file import read_model
    from thermojoint import console, measured, study
    from thermojoint.summary import compare_schemes

    arguments.check_outputs({"--out": (out, file_kinds.VALIDATION)}, [model, reference, *responses])
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
    console.wrote(out)


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
    from fesim.case import read_case
    from thermojoint import console
    from thermojoint.reproduce import reproduce as run_all

    arguments.check_whole_folder(out)
    with as_file(files("thermojoint") / "cases" / "reference.toml") as standard:
        given = read_case(case or standard)
    run_all(given, out)
    console.wrote(out)
