"""Commands of the generalised models: calibrate, print, estimate, validate, the whole chain."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

import typer
import xarray as xr

from artefacts.arrays import Array
from artefacts.errors import InputError
from artefacts.files import write_text
from artefacts.response import read_response
from calibrate import chain
from calibrate.provenance import provenance_of
from estimator import estimate_table, judge, measured, noise
from estimator.interface import Estimator, follow
from estimator.joint_aware.calibration import calibrate_joint_aware
from estimator.joint_aware.calibration import report as physics_report
from estimator.joint_aware.judging import judge as judge_joint_aware
from estimator.joint_aware.log import read_log
from estimator.joint_aware.model_file import is_observer, write_observer
from estimator.joint_aware.readings import samples_in
from estimator.joint_aware.saved_state import save_state as save_joint_aware
from estimator.saved_state import save_state
from estimator.starting import model_in, started, started_joint_aware
from fesim.case import read_case
from models.assembly import assemble as assemble_model
from models.assembly_file import write_assembly
from models.model_file import read_model, read_provenance, write_model
from thermojoint import arguments, console
from thermojoint.reproduce import reproduce as run_all
from thermojoint.summary import compare_schemes
from thermojoint.tables import printed_tables, tables_json


class Kind(StrEnum):
    """Kinds of estimators that can be calibrated."""

    FCHS = "fchs"
    JOINT_AWARE = "joint-aware"


ModelFile = Annotated[Path, typer.Argument(help="Model file (JSON) written by 'calibrate'.")]
EstimatorFile = Annotated[
    Path, typer.Argument(metavar="MODEL", help="Model file, or an estimator that 'assemble' wrote.")
]


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
    kind: Annotated[
        Kind, typer.Option(help="fchs: the paper's models; joint-aware: the machine's own physics.")
    ] = Kind.FCHS,
    case: Annotated[
        Path | None, typer.Option(help="Case file of the machine, for --kind joint-aware.")
    ] = None,
) -> None:
    """Calibrate an estimator: the generalised models of Tables 1-3, or the machine's physics.

    Example: [bold]thermojoint calibrate --reference r1.nc --input 0.5=r05.nc --input 2=r2.nc --out
    model.json[/bold]

    Example: [bold]thermojoint calibrate --reference measured-1.nc --input 0.5=measured-05.nc
    --input 2=measured-2.nc --distances-mm 50,125,110,60 --out model.json[/bold]

    Example: [bold]thermojoint calibrate --kind joint-aware --case machine.toml --reference r1.nc
    --input 0.5=r05.nc --input 2=r2.nc --out model.h5[/bold]
    """
    arguments.check_writable(out)
    if kind is Kind.JOINT_AWARE:
        _calibrate_joint_aware(case, reference, given, out)
        return
    if case is not None:
        raise InputError("--case: goes with --kind joint-aware; leave it out")
    apart = arguments.distances(distances) if distances is not None else None
    base = read_response(reference)
    others = {level: read_response(path) for level, path in map(arguments.level_and_file, given)}
    if len(others) < len(given):
        raise InputError("--input: a heat input is given twice; give each once")
    with console.progress_bars() as report:
        report("calibrating", 0, 1)
        calibrated = chain.calibrate_responses(base, others, apart)
        report("calibrating", 1, 1)
    origin = str(base.attrs.get("case", reference.name))
    provenance = provenance_of(calibrated, origin)
    write_model(calibrated.model, out, provenance)
    console.show_tables(console.out(), printed_tables(tables_json(calibrated.model, provenance)))
    console.wrote(out)


def _calibrate_joint_aware(case: Path | None, reference: Path, given: list[str], out: Path) -> None:
    if case is None:
        raise InputError("--kind joint-aware: needs the machine; add --case MACHINE.toml")
    machine = read_case(case)
    responses = {str(reference): read_response(reference)}
    responses |= {
        str(path): read_response(path) for _, path in map(arguments.level_and_file, given)
    }
    if len(responses) <= len(given):
        raise InputError("--input: a response is given twice; give each once")
    with console.progress_bars() as report:
        report("calibrating", 0, 1)
        calibrated = calibrate_joint_aware(machine, responses)
        report("calibrating", 1, 1)
    write_observer(calibrated.model, out)
    console.show_physics(console.out(), physics_report(calibrated.fit))
    console.wrote(out)


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


def estimate(
    model: EstimatorFile,
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
    For a joint-aware model: time_s and NAME_K, ambient_K or NAME_degC, ambient_degC of its sensors;
    empty cells are missing readings.

    Example: [bold]thermojoint estimate model.json measured.csv --out estimate.csv[/bold]

    With --out -, the state is saved also where a bad row or a signal ends the run.

    Example: [bold]logger | thermojoint estimate model.json - --interval-s 1 --out -[/bold]
    """
    arguments.check_writable(out, save)
    length = arguments.positive("--run-length-min", run_length)
    where = arguments.shown(temperatures)
    with arguments.opened(temperatures) as source:
        if is_observer(model):
            observer, state = started_joint_aware(model, resume)
            names = observer.model.sensors
            _write_estimates(
                observer,
                state,
                samples_in(read_response(temperatures), names)
                if source is None
                else read_log(source, names, where),
                out,
                None if save is None else partial(save_joint_aware, observer, path=save),
            )
        else:
            table = model_in(model)
            samples: Iterator[measured.Sample]
            if source is None:
                samples = measured.response_samples(read_response(temperatures), table)
            else:
                samples = measured.read_samples(source, list(table.linear.direct), where)
            nominal, samples = measured.nominal_interval(samples, interval, where)
            estimator, state = started(model, nominal, 60.0 * length, resume)
            _write_estimates(
                estimator,
                state,
                samples,
                out,
                None if save is None else partial(save_state, estimator, path=save),
            )
    console.wrote(None if str(out) == "-" else out, save)


def _write_estimates(
    estimator: Estimator,
    state: Array,
    samples: Iterable[Sequence[float]],
    out: Path,
    save: Callable[[Array], None] | None,
) -> None:
    """Write one row for each sample, and save the state at the end."""
    live = str(out) == "-"
    with arguments.output(out) as target:
        writer = csv.writer(target, lineterminator="\n")
        writer.writerow(estimate_table.header(estimator))
        try:
            for reached, result in follow(estimator, samples, state):
                state = reached
                writer.writerow(estimate_table.row(estimator, result))
                target.flush()
        finally:
            # What stands on standard output is out, however a logger's pipe comes to its end.
            if save and live:
                save(state)
    if save and not live:
        save(state)


def assemble(
    model: ModelFile,
    out: Annotated[Path, typer.Option(help="Assembled estimator to write (JSON).")],
    interval: Annotated[
        float, typer.Option("--interval-s", help="Nominal sampling interval, s.")
    ] = 2.0,
    run_length: Annotated[
        float, typer.Option("--run-length-min", help="Length of a run, min.")
    ] = 120.0,
) -> None:
    """Assemble an estimator once: everything fitted, fingerprinted, the same on every machine.

    'estimate' takes the file in place of the model.

    Example: [bold]thermojoint assemble model.json --interval-s 1 --out estimator.json[/bold]
    """
    arguments.check_writable(out)
    dt = arguments.positive("--interval-s", interval)
    length = arguments.positive("--run-length-min", run_length)
    write_assembly(assemble_model(read_model(model), dt, 60.0 * length), out)
    console.wrote(out)


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
    given = {path.stem: read_response(path) for path in responses}
    if len(given) < len(responses):
        raise InputError("validate: two responses have the same name; rename one")
    if is_observer(model):
        _validate_joint_aware(model, given, noise_pp, seed, out)
        return
    table = read_model(model)
    base = read_response(reference) if reference else None
    if noise_pp is not None:
        # Not "-noise": that is the paper's own case, with its noise on T1 and T2 alone.
        given = {
            f"{name}, {noise_pp:g} K noise": noise.with_noise(response, table, noise_pp, seed)
            for name, response in given.items()
        }
    found = judge.validate_model(table, base, given)
    if out:
        write_text(out, json.dumps(found.figures(), indent=2) + "\n")
    console.show_validation(console.out(), found.rows)
    schemes = compare_schemes(found.rows, found.as_printed, found.vectors)
    console.show_schemes(console.out(), schemes)
    console.show_blocks(console.out(), found.blocks)
    console.wrote(out)


def _validate_joint_aware(
    model: Path,
    given: Mapping[str, xr.Dataset],
    noise_pp: float | None,
    seed: int,
    out: Path | None,
) -> None:
    estimator, _ = started_joint_aware(model)
    rows = []
    for name, response in given.items():
        added, case = None, name
        if noise_pp is not None:
            case = f"{name}, {noise_pp:g} K noise"
            times = response["time"].to_numpy()
            added = noise.sensor_noise(times, noise_pp, seed, len(estimator.model.sensors))
        rows += judge_joint_aware(case, response, estimator, added)[0]
    if out:
        write_text(out, json.dumps({"rows": rows}, indent=2) + "\n")
    console.show_bands(console.out(), rows)
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
    arguments.check_folder(out)
    with as_file(files("thermojoint") / "cases" / "reference.toml") as standard:
        given = read_case(case or standard)
    run_all(given, out)
    console.wrote(out)
