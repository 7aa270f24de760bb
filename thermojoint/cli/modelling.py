"""The commands `calibrate`, `tables`, `estimate`, `assemble`, `validate` and `reproduce`."""

from __future__ import annotations

import csv
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds, joint_aware
from thermojoint.cli.log_reading import (
    ColumnOption,
    MappingOption,
    opened_log,
    over,
    renamed_by,
    reported,
    spikes_in,
)

if TYPE_CHECKING:
    from estimator.interface import Estimator, NextReading
    from estimator.kind import OpenedEstimator, Sample
    from thermojoint.artefacts.arrays import Array
    from thermojoint.artefacts.log import Log


ModelFile = Annotated[Path, typer.Argument(help="Model file written by 'calibrate' or 'learn'.")]
EstimatorFile = Annotated[
    Path, typer.Argument(metavar="MODEL", help="Model file, or an estimator that 'assemble' wrote.")
]


def calibrate(  # noqa: PLR0913 - the options of a command
    reference: Annotated[Path, typer.Option(help="Response to the reference step (NetCDF).")],
    out: Annotated[Path, typer.Option(help="Model file to write: JSON; joint-aware: HDF5.")],
    given: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            help="Another step: LEVEL=RESPONSE; give two or more. Optional for a joint-aware "
            "model, which takes runs of any heat input.",
        ),
    ] = None,
    distances: Annotated[
        str | None,
        typer.Option(
            "--distances-mm",
            help="r11,r12,r21,r22 from fictitious source i to sensor Tj; required for measured "
            "responses. Default: sources at the contact elements nearest to T1 and T2.",
        ),
    ] = None,
    baselines: Annotated[
        Path | None,
        typer.Option(help="Regressions on the same data to write (JSON), for 'validate'."),
    ] = None,
    kind: Annotated[
        Literal["fchs", "joint-aware"],
        typer.Option(help="fchs: the paper's models; joint-aware: the machine's own physics."),
    ] = "fchs",
    case: joint_aware.CaseOption = None,
    report_file: arguments.Json = None,
) -> None:
    """Calibrate an estimator: the generalised models of Tables 1-3, or the machine's physics.

    Example: [bold]thermojoint calibrate --reference r1.nc --input 0.5=r05.nc --input 2=r2.nc --out
    model.json[/bold]

    Example: [bold]thermojoint calibrate --reference measured-1.nc --input 0.5=measured-05.nc
    --input 2=measured-2.nc --distances-mm 50,125,110,60 --out model.json[/bold]

    Example: [bold]thermojoint calibrate --kind joint-aware --case machine.toml --reference r1.nc
    --input 0.5=r05.nc --input 2=r2.nc --input 0=cool-down.nc --out model.h5[/bold]
    """
    from calibrate import chain
    from calibrate.baselines import baselines_of
    from calibrate.provenance import provenance_of
    from thermojoint import console, plausibility
    from thermojoint.artefacts.response import read_response
    from thermojoint.models.baselines import write_baselines
    from thermojoint.models.model_file import write_model
    from thermojoint.paper import printing
    from thermojoint.paper.tables import printed_tables, tables_json

    pairs = [arguments.level_and_file(text) for text in given or []]
    inputs = [reference, *(path for _, path in pairs)]
    if kind == "joint-aware":
        arguments.only_for("--kind fchs", {"--distances-mm": distances, "--baselines": baselines})
        joint_aware.calibrate(case, inputs, out, report_file)
        return
    if any(level == 0.0 for level, _ in pairs):
        raise InputError(
            "--input 0=…: the paper's models need steps with a level other than 0; a cool-down is "
            "for --kind joint-aware"
        )
    if not pairs:
        raise InputError("--input: the paper's models need two steps beside the reference; give it")
    arguments.only_for("--kind joint-aware", {"--case": case, "--json": report_file})
    arguments.check_outputs(
        {"--out": (out, file_kinds.MODEL), "--baselines": (baselines, file_kinds.BASELINES)}, inputs
    )
    apart = arguments.distances(distances) if distances is not None else None
    base = read_response(reference)
    named = [(level, path, read_response(path)) for level, path in pairs]
    others = {level: response for level, _, response in named}
    if len(others) < len(pairs):
        raise InputError("--input: a heat input is given twice; give each once")
    for path, response in ((reference, base), *((path, response) for _, path, response in named)):
        console.warn(plausibility.of_response(response, str(path)))
    with console.working("calibrating"):
        calibrated = chain.calibrate_responses(base, others, apart)
    if calibrated.compromise:
        console.warn([calibrated.compromise])
    origin = str(base.attrs.get("case", reference.name))
    provenance = provenance_of(calibrated, origin)
    write_model(calibrated.model, out, provenance)
    if baselines:
        # Tables 2 and 3 need two sensors at the joint; a model with one is written nevertheless.
        write_baselines(baselines_of(calibrated, [base, *others.values()]), baselines)
    content = tables_json(calibrated.model, provenance)
    printing.show_tables(console.out(), printed_tables(content, provenance.at_bound))
    console.wrote(out)


def tables(model: ModelFile, as_json: arguments.Json = None) -> None:
    """Print Tables 1-3 of a model with the paper's values beside them.

    Example: [bold]thermojoint tables model.json[/bold]

    Example: [bold]thermojoint tables model.json --json tables.json[/bold]
    """
    from thermojoint import console
    from thermojoint.models.model_file import read_model, read_provenance
    from thermojoint.paper import printing
    from thermojoint.paper.tables import printed_tables, tables_json

    arguments.check_outputs({"--json": (as_json, file_kinds.TABLES)}, [model])
    provenance = read_provenance(model)
    content = tables_json(read_model(model), provenance)
    arguments.write_json(as_json, content)
    printing.show_tables(console.out(as_json), printed_tables(content, provenance.at_bound))
    console.wrote(as_json)


def estimate(  # noqa: PLR0913 - the options of a command
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
        float | None,
        typer.Option("--run-length-min", help="Length of a run, min; default: 120."),
    ] = None,
    save: Annotated[
        Path | None, typer.Option("--save-state", help="Write the estimator's state here (JSON).")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option("--continue", help="Go on from a saved state (JSON).")
    ] = None,
    warm: Annotated[
        bool, typer.Option("--warm", help="The machine's past is unknown (joint-aware).")
    ] = False,
    readings: Annotated[
        Path | None,
        typer.Option(help="Occasional displacement readings (CSV); joint-aware, learned models."),
    ] = None,
    reading_noise: Annotated[
        float | None,
        typer.Option("--reading-noise-um", help="Their standard deviation, um; default: 0.5."),
    ] = None,
    ageing: Annotated[
        str | None,
        typer.Option(help="Parameters learned online (joint-aware): preload,friction,film."),
    ] = None,
    regression: Annotated[
        str | None,
        typer.Option(help="Regression in a file of baselines: mlr, ridge, arx; default: ridge."),
    ] = None,
    ask_above: Annotated[
        float | None,
        typer.Option(
            "--ask-above-um",
            help="Ask for a displacement reading when the 95 % band passes this (joint-aware).",
        ),
    ] = None,
    column: ColumnOption = None,
    mapping: MappingOption = None,
) -> None:
    """Estimate heat and displacement from temperatures alone, row by row.

    The CSV has the columns time_s, delta_T_K, T1_K, T2_K (above the current ambient), or time_s,
    a_degC, b_degC, T1_degC, T2_degC, ambient_degC. Intervals may vary, rows may be missing. For a
    joint-aware model: time_s and NAME_K, ambient_K, or NAME_degC, ambient_degC, of its sensors;
    empty cells are missing readings. For a learned model: the columns it was learned from.

    Example: [bold]thermojoint estimate model.json measured.csv --out estimate.csv[/bold]

    Readings of a touch probe (columns time_s, x_um, y_um) correct a joint-aware estimate;
    --ask-above-um adds columns with the next reading: its axis, its time, how it narrows the band.

    Example: [bold]thermojoint estimate model.h5 log.csv --readings probe.csv --out e.csv[/bold]

    With --out -, the state is also saved if a bad row or a signal ends the run.

    Example: [bold]logger | thermojoint estimate model.json - --interval-s 1 --out -[/bold]
    """
    from estimator import measured
    from estimator.kind import Cold, Options, checked_limit
    from estimator.probe_readings import beside, read_probe_readings, with_probe_readings
    from estimator.registry import kind_of_file, resumed, save_state, started
    from estimator.states import read_state
    from thermojoint import console, plausibility
    from thermojoint.artefacts.response import read_response
    from thermojoint.artefacts.units import MICRO

    # The state of --continue is no input here: its successor may replace it.
    arguments.check_outputs(
        {"--out": (out, file_kinds.ESTIMATE), "--save-state": (save, file_kinds.ESTIMATOR_STATE)},
        [model, temperatures, readings, mapping],
    )
    length = arguments.positive("--run-length-min", 120.0 if run_length is None else run_length)
    if resume and warm:
        raise InputError("--warm: a saved state knows the past; leave out --warm or --continue")
    where = arguments.shown(temperatures)
    kind = kind_of_file(model)
    arguments.check_taken(
        kind.name,
        {
            "--warm": (warm, kind.warm_state is not None),
            "--readings": (readings, "reading_noise" in kind.options),
            "--reading-noise-um": (reading_noise, "reading_noise" in kind.options),
            "--ageing": (ageing, "ageing" in kind.options),
            "--regression": (regression, "regression" in kind.options),
            "--ask-above-um": (ask_above, kind.next_reading is not None),
        },
    )
    given = kind.read(model)
    arguments.check_pace(kind, given, {"--interval-s": interval, "--run-length-min": run_length})
    options = Options(
        run_length=60.0 * length,
        reading_noise=arguments.reading_noise(reading_noise, readings),
        # An empty text is one empty name, which is an error.
        ageing=() if ageing is None else tuple(name.strip() for name in ageing.split(",")),
        regression=regression,
    )
    renamed = over(kind.renamed(given), renamed_by(column, mapping))
    with (
        opened_log(temperatures, renamed) as pieces,
        arguments.at_work("estimating", temperatures, out),
    ):
        samples: Iterator[Sample]
        # A continued run keeps its own cold temperature.
        cold = Cold(read_state(resume).cold, continued=True) if resume else Cold()
        if pieces is None:
            arguments.only_for("a log", {"--column": column, "--mapping": mapping})
            response = read_response(temperatures)
            console.warn(plausibility.of_response(response, where))
            samples = kind.response(given, response)
        else:
            samples = kind.log(
                given,
                pieces if readings is None else beside(pieces, readings),
                where,
                partial(_warn_of_units, where=where),
                cold,
            )
        if kind.paced and not kind.assembled(given):
            # A continued run keeps its initial coefficients.
            alone = options.interval if resume else None
            nominal, samples = measured.nominal_interval(samples, interval, where, alone)
            options = replace(options, interval=nominal)
        if resume:
            estimator, state = resumed(kind, given, options, resume)
            arguments.check_same_pace(kind, estimator, interval, run_length)
            samples = measured.going_on(samples, float(state[0]), where, str(resume))
        else:
            estimator = started(kind, given, options)
            warm_state = kind.warm_state if warm else None
            state = warm_state(estimator) if warm_state else estimator.initial_state()
        asks, ask = None, kind.next_reading
        if ask_above is not None and ask is not None:
            limit = MICRO * arguments.positive("--ask-above-um", ask_above)
            checked_limit(kind, estimator, limit, "--ask-above-um")

            def asks(state: Array) -> NextReading | None:
                return ask(estimator, state, limit)

        if readings is not None:
            # For a learned model along an axis, each reading comes with its position.
            names = {channel.name for channel in estimator.channels}
            along = getattr(given, "positions", ())
            places = [name for name in along if f"reading {name}" in names]
            read = read_probe_readings(readings, (*estimator.axes, *places))
            samples = with_probe_readings(samples, *read, len(places), float(state[0]))

        def keep(state: Array) -> None:
            if save:
                save_state(estimator, state, save, cold.value)

        samples = measured.some(samples, where)
        refused = _write_estimates(estimator, state, samples, out, keep if save else None, asks)
    if refused:
        console.warn(
            [
                f"{readings}: refused at {refused} samples (reading-refused), of {len(read[0])} "
                "readings: they correct nothing; check their clock, zero, sign and unit"
            ]
        )
    console.wrote(out, save)


def _write_estimates(
    estimator: Estimator,
    state: Array,
    samples: Iterable[Sequence[float]],
    out: Path,
    save: Callable[[Array], None] | None,
    asks: Callable[[Array], NextReading | None] | None,
) -> int:
    """Write one row for each sample, with the reading that is asked for; save the last state.

    Return the number of samples of which a displacement reading was refused.
    """
    from estimator import estimate_table
    from estimator.interface import Status, follow
    from thermojoint.artefacts.unfinished import cleared_at_stop

    live, refused = str(out) == "-", 0

    def keep_state() -> None:
        if save and live:
            save(state)

    with arguments.output(out) as target, cleared_at_stop(keep_state):
        writer = csv.writer(target, lineterminator="\n")
        more = estimate_table.NEXT_READING if asks else ()
        writer.writerow(estimate_table.header(estimator, more))
        try:
            for reached, result in follow(estimator, samples, state):
                state = reached
                asked = estimate_table.next_reading_cells(asks(state)) if asks else ()
                writer.writerow(estimate_table.row(estimator, result, asked))
                target.flush()
                refused += Status.READING_REFUSED in result.status
        finally:
            # Rows on standard output are already delivered, even if the pipe breaks.
            keep_state()
    if save and not live:
        save(state)
    return refused


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
    """Assemble an estimator once, with a fingerprint, for identical results on every computer.

    'estimate' accepts the file in place of the model.

    Example: [bold]thermojoint assemble model.json --interval-s 1 --out estimator.json[/bold]
    """
    from thermojoint import console
    from thermojoint.models.assembly import TOLERANCE
    from thermojoint.models.assembly import assemble as assemble_model
    from thermojoint.models.assembly_file import write_assembly
    from thermojoint.models.model_file import read_model

    arguments.check_outputs({"--out": (out, file_kinds.ASSEMBLY)}, [model])
    dt = arguments.positive("--interval-s", interval)
    length = arguments.positive("--run-length-min", run_length)
    with console.working("assembling"):
        assembled = assemble_model(read_model(model), dt, 60.0 * length)
        write_assembly(assembled, out)
    if assembled.error > TOLERANCE:
        console.warn([f"{model}: inverse filters approximated within {assembled.error:.1e}"])
    console.wrote(out)


def validate(  # noqa: PLR0913 - the options of a command
    model: ModelFile,
    data: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESPONSES",
            help="Responses to validate against; logs (CSV) for a learned model.",
        ),
    ],
    reference: Annotated[
        Path | None,
        typer.Option(help="Response to the reference step, for the exact nonlinear part."),
    ] = None,
    noise_pp: Annotated[
        float | None,
        typer.Option("--noise-pp", help="Peak-to-peak noise added to every temperature, K."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the noise; default: 0.")] = None,
    baselines: Annotated[
        Path | None, typer.Option(help="Baselines to compare with ('calibrate --baselines').")
    ] = None,
    column: ColumnOption = None,
    mapping: MappingOption = None,
    picture: Annotated[
        Path | None,
        typer.Option("--out", help="For logs: picture of truth, estimate and band (PNG)."),
    ] = None,
    out: arguments.Json = None,
) -> None:
    """Validate an estimator: temperatures as input, displacement as reference.

    Example: [bold]thermojoint validate model.json step-3.nc --reference r1.nc[/bold]

    Example: [bold]thermojoint validate model.json triangle.nc --noise-pp 0.12 --seed 1[/bold]

    Example: [bold]thermojoint validate learned.json another_day.csv --out day.png[/bold]

    A joint-aware model takes responses or logs, which are measured from the start of each run.
    """
    from estimator.judging import Conditions
    from estimator.kind import Cold, Options
    from estimator.registry import kind_of_file, started
    from thermojoint import console, plausibility
    from thermojoint.artefacts.log import joined
    from thermojoint.artefacts.log_file import log_pieces
    from thermojoint.artefacts.response import read_response
    from thermojoint.models.baselines import read_baselines
    from thermojoint.paper import printing
    from thermojoint.paper.summary import compare_schemes

    inputs = [model, baselines, reference, mapping, *data]
    outputs = {"--json": (out, file_kinds.VALIDATION), "--out": (picture, file_kinds.PICTURE)}
    arguments.check_outputs(outputs, inputs)
    if picture:
        from thermojoint.pictures.figures import check_png

        check_png(picture)
    if noise_pp is None:
        arguments.only_for("--noise-pp", {"--seed": seed})
    named = {path.stem: path for path in data}
    if len(named) < len(data):
        raise InputError("validate: two files have the same name; rename one")
    kind = kind_of_file(model)
    given = kind.read(model)
    given_logs = kind.judge_logs is not None and all(path.suffix != ".nc" for path in data)
    if kind.judge is None or given_logs:
        beside = {"--reference": reference, "--noise-pp": noise_pp, "--baselines": baselines}
        what = kind.name if kind.judge is None else "a log"
        arguments.check_taken(what, {name: (value, False) for name, value in beside.items()})
        if kind.judge_logs is None:
            raise InputError(f"validate: {kind.name} cannot be judged; estimate with it instead")
        renamed = over(kind.renamed(given), renamed_by(column, mapping))
        with console.working("validating"):
            logs = {
                name: joined(reported(log_pieces([path], renamed))) for name, path in named.items()
            }
            for name, log in logs.items():
                warn = partial(_warn_of_units, where=name)
                next(kind.log(given, [log], name, warn, Cold()), None)
            figures = kind.judge_logs(given, logs)
            console.warn(_misread(logs, {str(row["axis"]) for row in figures["rows"]}))
            if picture:
                _draw_judged(started(kind, given, Options()), logs, picture)
    else:
        arguments.only_for("logs", {"--column": column, "--mapping": mapping, "--out": picture})
        responses = {name: read_response(path) for name, path in named.items()}
        for name, response in responses.items():
            console.warn(plausibility.of_response(response, name))
        conditions = Conditions(
            noise_pp,
            seed or 0,
            read_response(reference) if reference else None,
            read_baselines(baselines) if baselines else None,
        )
        with console.working("validating"):
            figures = kind.judge(kind, given, responses, conditions)
    arguments.write_json(out, figures)
    printer = console.out(out)
    printing.show_validation(printer, figures["rows"])
    if "as_printed" in figures:
        schemes = compare_schemes(figures["rows"], figures["as_printed"], figures["vectors"])
        printing.show_schemes(printer, schemes)
        printing.show_blocks(printer, figures["blocks"])
    console.wrote(out, picture)


def _warn_of_units(first: Mapping[str, float], where: str) -> None:
    """Warn of every temperature of a log's first row that probably has another unit."""
    from thermojoint import console, plausibility

    console.warn(plausibility.of_sample(first, where))


def _misread(logs: Mapping[str, Log], judged: Collection[str]) -> list[str]:
    """Return a warning about each displacement that has spikes in a log."""
    return [
        f"{name}: {column}: {count} spikes, as of misread displacements; the errors contain them"
        for name, log in logs.items()
        for column, count in spikes_in(log, judged).items()
    ]


def _draw_judged(estimator: OpenedEstimator, logs: Mapping[str, Log], path: Path) -> None:
    """Draw measured and estimated displacements, free-running, for every run of some logs."""
    from estimator.interface import follow
    from estimator.kind import Cold
    from estimator.lines import here
    from estimator.registry import kind_of
    from thermojoint.pictures.judged import Judged, write_judged

    kind, panels = kind_of(estimator), []
    judged = [
        (name, run, pairs)
        for name, log in logs.items()
        for whole, pairs in kind.judged_in(name, estimator, log)
        for run in whole.runs()
    ]
    for name, run, pairs in judged:
        samples = kind.log(estimator.model, [run], name, None, Cold())
        followed = follow(estimator, samples, estimator.initial_state())
        results = [result for _, result in followed]
        # Along an axis a reading is compared at its position.
        values, bands = here(estimator.axes, estimator.details, results)
        for axis, column in pairs:
            c = estimator.axes.index(axis)
            own = Judged(f"{name}: {column}", run.times, run.at(column), values[:, c], bands[:, c])
            panels.append(own)
    write_judged(panels, path)


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
    from fesim.case.schema import read_case
    from thermojoint import console, plausibility

    arguments.check_whole_folder(out)
    with as_file(files("thermojoint") / "cases" / "reference.toml") as standard:
        given = read_case(case or standard)
    # After the case, so that mistakes in it are reported before the libraries are loaded.
    from thermojoint.paper.reproduce import reproduce as run_all

    console.warn(plausibility.of_case(given, str(case or "reference machine")))
    run_all(given, out)
    console.wrote(out)
