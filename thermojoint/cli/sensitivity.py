"""The command `sensitivity`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer
from rich.table import Table

from thermojoint.artefacts.errors import InputError
from thermojoint.cli import arguments, file_kinds
from thermojoint.sensitivity.measures import MEASURES, Method

if TYPE_CHECKING:
    from fesim.batch.study import Study, Values
    from thermojoint.artefacts.arrays import Array

Run: TypeAlias = "Callable[[Study, list[Values]], tuple[list[str], Array]]"

#: Rows of a table at the terminal, and panels of the picture.
SHOWN, PANELS = 8, 4
#: Change to which the effects of a case refer.
PER = "per 1 % (coordinates and dimensions: per 1 mm)"
#: Files in the folder of the results.
TABLE, PICTURE = "sensitivity.csv", "sensitivity.png"


def sensitivity(  # noqa: PLR0913 - options of a command
    given: Annotated[
        Path, typer.Argument(metavar="FILE", help="Case, or ranges of its values (TOML).")
    ],
    out: Annotated[Path, typer.Option(help="Folder for all results; finished cases are kept.")],
    parameter: Annotated[
        list[str] | None,
        typer.Option(help="Paths in the case, with * and ?; default: every number of it."),
    ] = None,
    figure: Annotated[
        list[str] | None, typer.Option(help="Columns of summary.csv to judge; default: all.")
    ] = None,
    method: Annotated[
        Method | None, typer.Option(help="Indices of a file of ranges; default: morris.")
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            help="Trajectories of morris; base samples of sobol, a power of 2; default: 16."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of the samples and of the intervals; default: 1.")
    ] = None,
    workers: arguments.Workers = None,
    scheduler: arguments.Scheduler = None,
    json: arguments.Json = None,
) -> None:
    """Show which values of a case its displacement, temperatures and pressures depend on.

    Of a case: the effect of one percent of each number (of 1 mm of a coordinate or dimension), by
    central differences of two sizes. Of a file of ranges: Morris screening or Sobol indices over
    all of them. The cases run as in a batch; after any interruption the same command goes on.

    Example: [bold]thermojoint sensitivity machine.toml --out effects --parameter "joints.*"[/bold]

    Example: [bold]thermojoint sensitivity ranges.toml --method sobol --samples 64 --out s[/bold]
    """
    from thermojoint import console
    from thermojoint.artefacts.settings import toml
    from thermojoint.cli import batch_run
    from thermojoint.sensitivity.results import (
        check_figures,
        chosen_figures,
        figures_of_rows,
        physical,
    )

    batch_run.check_workers(workers, scheduler)
    outputs = {
        "the table": (out / TABLE, file_kinds.SENSITIVITY_TABLE),
        "the picture": (out / PICTURE, file_kinds.PICTURE),
        "--json": (json, file_kinds.SENSITIVITY),
    }
    arguments.check_outputs(outputs, [given])

    def run(study: Study, rows: list[Values]) -> tuple[list[str], Array]:
        """Run the cases; return the names of the figures, and their values for each row."""
        check_figures(figure or [], physical(study.columns), "--figure")
        recruit = partial(batch_run.crew_of, workers, scheduler)
        summary = batch_run.completed(study, str(given), out, recruit)
        names = chosen_figures(summary, figure or [])
        return names, figures_of_rows(study, rows, summary, names)

    if "ranges" in toml.parse(toml.read_text(given, "case"), str(given)):
        arguments.only_for("a case", {"--parameter": parameter})
        sampling = (
            method or "morris",
            16 if samples is None else samples,
            1 if seed is None else seed,
        )
        content = _screened(given, sampling, run)
    else:
        sampled = {"--method": method, "--samples": samples, "--seed": seed}
        arguments.only_for("a file of ranges", sampled)
        content = _local(given, tuple(parameter or ["*"]), run)
    _report(content, out, json)
    arguments.write_json(json, content)
    console.wrote(out / TABLE, out / PICTURE, json)


def _local(given: Path, patterns: tuple[str, ...], run: Run) -> dict[str, Any]:
    """Vary each matching number of a case."""
    from fesim.batch.study import study_of
    from fesim.case.schema import read_case
    from thermojoint.sensitivity import local, results
    from thermojoint.sensitivity.parameters import parameters_of

    case = read_case(given)
    for pattern in patterns:
        if not parameters_of(case, (pattern,)):
            raise InputError(
                f"--parameter {pattern}: no number of {given} that can be varied has such a path; "
                "whole numbers, zeros, and those of march, mesh and output take a batch"
            )
    parameters = parameters_of(case, patterns)
    rows = local.rows_of(parameters)
    reasons: dict[str, str] = {}

    def refused(values: Values, reason: str) -> None:
        reasons[local.varied_in(values, parameters)] = reason

    paths = [each.path for each in parameters]
    study = replace(study_of(given, rows, paths, str(given), refused), keep="displacement")
    if not study.cases:
        path, reason = next(iter(reasons.items()))
        raise InputError(f"{given}: every change is refused; of {path}: {reason}")
    names, figures = run(study, rows)
    effects = local.effects_of(parameters, figures)
    if not effects:
        raise InputError(f"{given}: no value has all of its cases; summary.csv has the reasons")
    done = {effect.parameter.path for effect in effects}
    missing = [path for path in paths if path not in done]
    left_out = {path: reasons.get(path, "a case of it has no result") for path in missing}
    entries = results.local_results(effects, names)
    return {"method": "local", "cases": len(study.cases), "left_out": left_out, "entries": entries}


def _screened(given: Path, sampling: tuple[Method, int, int], run: Run) -> dict[str, Any]:
    """Vary all ranges of a file together."""
    from fesim.batch.study import study_of
    from thermojoint.artefacts.extras import require
    from thermojoint.artefacts.settings.read import read_settings
    from thermojoint.sensitivity import results, screening
    from thermojoint.sensitivity.settings import RangesFile

    require("screening", "sensitivity", "SALib")
    ranges = read_settings(RangesFile, given, "ranges")
    design = screening.design_of(ranges.ranges, *sampling)
    paths = [span.path for span in ranges.ranges]
    study = replace(study_of(ranges.case, design.rows, paths, str(given)), keep="displacement")
    names, figures = run(study, design.rows)
    entries, convergence = results.screening_results(design, figures, names)
    return {
        "method": design.method,
        "cases": len(study.cases),
        "seed": design.seed,
        "convergence": convergence,
        "entries": entries,
    }


def _report(content: dict[str, Any], out: Path, as_json: Path | None) -> None:
    """Print the largest effects; write the table and the picture."""
    import pandas as pd

    from thermojoint import console
    from thermojoint.artefacts.files import write_text
    from thermojoint.pictures.figures import write_figure
    from thermojoint.pictures.tornado import Panel, tornado_figure

    first, spread = MEASURES[content["method"]]
    table = pd.DataFrame(content["entries"])
    write_text(out / TABLE, table.to_csv(index=False))
    panels = []
    for name, rows in table.groupby("figure", sort=False):
        per = f" {PER}" if content["method"] == "local" else ""
        panels.append(
            Panel(str(name), f"{first}{per}", rows["path"].tolist(), rows[first], rows[spread])
        )
        shown = Table("value of the case", *console.numeric(first, spread))
        for row in rows.head(SHOWN).itertuples():
            shown.add_row(
                row.path,
                console.number(getattr(row, first), 3),
                console.number(getattr(row, spread), 2),
            )
        console.titled(console.out(as_json), f"{name}{per}", shown)
    write_figure(tornado_figure(panels[:PANELS]), out / PICTURE)
    for path, reason in content.get("left_out", {}).items():
        console.say(f"{path} is left out: {reason}")
