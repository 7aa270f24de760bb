"""The command `optimise`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.cli import arguments, file_kinds

if TYPE_CHECKING:
    from fesim.batch.crew import Crew
    from fesim.batch.study import Study, Values
    from fesim.case.schema import Case, MarchSection
    from thermojoint.artefacts.arrays import Array
    from thermojoint.cli.batch_run import Recruit, Say
    from thermojoint.optimisation.settings import DesignFile

#: File in the folder of the results.
PICTURE = "optimisation.png"
#: Exit code if a limit does not hold, or the full march fails.
NOT_HELD = 1
#: Factor on the tolerances of adaptive steps in the march that checks the optimum.
_STRICTER = 0.1


def optimise(  # noqa: PLR0913 - options of a command
    question: Annotated[
        Path, typer.Argument(metavar="FILE", help="Values to choose, aim and limits (TOML).")
    ],
    out: Annotated[Path, typer.Option(help="Folder for all results; finished cases are kept.")],
    population: Annotated[int, typer.Option(min=5, help="Cases of a generation.")] = 12,
    generations: Annotated[int, typer.Option(min=1, help="At most.")] = 15,
    seed: Annotated[int, typer.Option(min=0, help="Of the search.")] = 1,
    workers: arguments.Workers = None,
    scheduler: arguments.Scheduler = None,
    json: arguments.Json = None,
) -> None:
    """Find the values of a case that serve a purpose best: a figure to minimise, limits to hold.

    The cases run as in a batch; after any interruption the same command goes on. The optimum is
    checked by a full march. Exit code 1 if a limit does not hold or that march fails.

    Example: [bold]thermojoint optimise question.toml --out design --json design.json[/bold]
    """
    import numpy as np

    from fesim.case.schema import read_case
    from thermojoint import console
    from thermojoint.artefacts.settings.read import read_settings
    from thermojoint.cli import batch_run
    from thermojoint.optimisation.results import entries_of, figures_in, history_of, measured
    from thermojoint.optimisation.search import Effort, search
    from thermojoint.optimisation.settings import DesignFile, check_names
    from thermojoint.pictures.figures import write_figure
    from thermojoint.pictures.search_figure import search_figure

    batch_run.check_workers(workers, scheduler)
    outputs = {
        "the picture": (out / PICTURE, file_kinds.PICTURE),
        "--json": (json, file_kinds.OPTIMISATION),
    }
    arguments.check_outputs(outputs, [question])
    given = read_settings(DesignFile, question, "question")
    case = read_case(given.case)
    check_names(given, case.axes, str(question))
    own = _own_values(given, case)
    every = _finished(given, out, str(question))
    refusals: dict[str, str] = {}
    with _one_crew(workers, scheduler) as recruit:

        def run(rows: list[Values]) -> Array:
            """Run cases in one study with all earlier ones, so that the tables contain them all."""
            every.extend(rows)
            study = _study(given, every, str(question), refusals)
            if not study.cases:
                return np.full((len(rows), len(given.names)), np.nan)
            summary = batch_run.completed(study, str(question), out, recruit)
            return figures_in(given, study, rows, summary)

        effort = Effort(population, generations, seed)
        done = search(given.ranges, run, partial(measured, given), effort, [own] if own else [])
    best = done.best()
    if best is None:
        raise InputError(f"{question}: no case within the ranges has a result{_why(refusals)}")
    with console.working("checking by a full march"):
        full, failed = _full_march(given, case, done.rows[best])
    entries = entries_of(given, done.figures[best], full, done.figures[0] if own else None)
    content = {
        "found": done.rows[best],
        "figures": entries,
        "cases": len(done.rows),
        "refused": refusals,
        "history": history_of(done),
    }
    _report(given, content, own, json)
    picture = search_figure(
        given.aim,
        done.figures[:, 0],
        np.all(done.measured[:, 1:] <= 0.0, axis=1),
        {span.path: np.array([row[span.path] for row in done.rows]) for span in given.ranges},
        best,
    )
    write_figure(picture, out / PICTURE)
    arguments.write_json(json, content)
    console.wrote(out / PICTURE, json)
    if failed:
        console.warn([f"{question}: the full march of what was found has no result: {failed}"])
        raise typer.Exit(NOT_HELD)
    broken = [entry["figure"] for entry in entries if not entry["holds"]]
    if broken:
        figures = ", ".join(broken)
        in_search = bool((done.measured[best, 1:] <= 0.0).all())
        console.say(
            f"what was found keeps {figures} within the limit, but its full march does not; take a "
            "limit with a margin"
            if in_search
            else f"no case was found that keeps {figures} within the limit"
        )
        raise typer.Exit(NOT_HELD)


def _own_values(given: DesignFile, case: Case) -> Values:
    """Return the values of the case as given; empty if one is not a number or out of its range."""
    from thermojoint.sensitivity.parameters import numbers_of

    own = numbers_of(case)
    inside = all(span.low <= own.get(span.path, math.nan) <= span.high for span in given.ranges)
    return {span.path: own[span.path] for span in given.ranges} if inside else {}


def _finished(given: DesignFile, out: Path, where: str) -> list[Values]:
    """Return the values of the cases that an earlier search of the question finished.

    They belong to the study from the first generation on, so that the dataset keeps them all.
    """
    import pandas as pd

    from fesim.batch.folder import read_records

    paths = [span.path for span in given.ranges]
    try:
        table = pd.read_parquet(out / "summary.parquet", columns=paths)
        rows = table.astype(float).to_dict("records")
    except (OSError, ValueError, ImportError):
        return []  # There is no table, or one of another question.
    study = _study(given, rows, where, {})
    records = read_records(out, study)
    return [case.values for case in study.cases if case.id in records]


@contextmanager
def _one_crew(workers: int | None, scheduler: str | None) -> Iterator[Callable[[Say], Recruit]]:
    """Give workers that start when they are first needed, and end with the block."""
    from thermojoint.cli.batch_run import crew_of

    with ExitStack() as stack:
        crews: list[Crew] = []

        def recruit(say: Say) -> Recruit:
            def once() -> AbstractContextManager[Crew]:
                if not crews:
                    crews.append(stack.enter_context(crew_of(workers, scheduler, say)()))
                return nullcontext(crews[0])

            return once

        yield recruit


def _study(given: DesignFile, rows: list[Values], where: str, refusals: dict[str, str]) -> Study:
    """Return the study of some cases, without those refused; `refusals` gets the reasons."""
    from fesim.batch.study import shown, study_of

    def refused(values: Values, reason: str) -> None:
        refusals[shown(values)] = reason

    paths = [span.path for span in given.ranges]
    return replace(study_of(given.case, rows, paths, where, refused), keep="displacement")


def _why(refusals: dict[str, str]) -> str:
    """Return the first reason for which cases were refused."""
    return f"; {len(refusals)} are refused: {next(iter(refusals.values()))}" if refusals else ""


def _checked_by(march: MarchSection, moving: bool) -> Values:
    """Return the values of the march that checks an optimum: better than that of the search.

    Fixed steps are marched with all thermal unknowns (with axes there are only modes), heat and
    contact iterated. Adaptive steps, which know only modes and need no iteration, are taken to a
    tenth of their tolerances: fixed ones of ``step_s``, the spacing of their response, would be
    worse.
    """
    from fesim.case.schema import TOLERANCE_K, TOLERANCE_UM

    if march.method == "adaptive":
        return {
            "march.tolerance_um": _STRICTER * (march.tolerance_um or TOLERANCE_UM),
            "march.tolerance_K": _STRICTER * (march.tolerance_K or TOLERANCE_K),
        }
    coupled: Values = {"march.coupling": "iterated"}
    return coupled if moving else coupled | {"march.thermal": "full"}


def _full_march(given: DesignFile, case: Case, values: Values) -> tuple[Array, str]:
    """Return figures of a case from the march that checks it; NaN and why if it fails."""
    from fesim.batch.paths import with_values
    from fesim.batch.summary import figures_of
    from fesim.case.schema import case_from_data
    from fesim.simulate import simulate
    from thermojoint.artefacts.settings import toml
    from thermojoint.optimisation.results import figures_by_name

    data = toml.parse(toml.read_text(given.case, "case"), str(given.case))
    checked = values | _checked_by(case.march, bool(case.axes))
    best = case_from_data(with_values(data, checked), str(given.case), given.case.parent)
    try:
        figures = figures_of(simulate(best, accuracy=False).response)
    except ConvergenceError as error:
        return figures_by_name(given.names, values, {}), str(error)
    return figures_by_name(given.names, values, figures), ""


def _report(given: DesignFile, content: dict[str, Any], own: Values, as_json: Path | None) -> None:
    """Print the values that were found, and the figures."""
    from thermojoint import console

    chosen = Table("value of the case", *console.numeric("now", "found", "low", "high"))
    for span in given.ranges:
        ends = (own.get(span.path), content["found"][span.path], span.low, span.high)
        chosen.add_row(span.path, *map(console.number, ends))
    title = f"found in {content['cases']} cases{_why(content['refused'])}"
    console.titled(console.out(as_json), title, chosen)
    figures = Table("figure", *console.numeric("at least", "at most", "now", "found", "full march"))
    for entry in content["figures"]:
        columns = ("at_least", "at_most", "now", "found", "full_march")
        figures.add_row(entry["figure"], *(console.number(entry[name]) for name in columns))
    console.titled(console.out(as_json), "displacements by their magnitude", figures)
