"""The command `batch` at the terminal: workers, live progress, handling of Ctrl-C."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, TypeAlias

import typer
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from fesim.batch.study import Study, StudyCase, brief, shown
from thermojoint import console as terminal
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.extras import require
from thermojoint.artefacts.process_start import let_dask_load
from thermojoint.plausibility import of_cases

if TYPE_CHECKING:
    import pandas as pd

    from fesim.batch import run
    from fesim.batch.crew import Crew

Watch: TypeAlias = "Callable[[run.Progress], None]"
Tell = Callable[[StudyCase, str], None]
Say = Callable[[str], None]
#: Starts the workers of a batch.
Recruit: TypeAlias = "Callable[[], AbstractContextManager[Crew]]"

_STOPPED = "stopped; the same command continues from here"
#: Largest number of workers that are listed.
SHOWN_WORKERS = 8


def run_cases(
    study: Study, where: str, out: Path, recruit: Callable[[Say], Recruit]
) -> run.Finished:
    """Run a study and show its progress.

    `where` is the name of its file in warnings; `recruit` starts workers, given a print function.
    """
    require("batch", "batch", "zarr", "pyarrow")
    terminal.warn(of_cases((case.case for case in study.cases), where))
    # Here, not above: mistakes in a study are reported before Zarr and Arrow are loaded.
    from fesim.batch import run

    with stop_request() as stopped, display(study, stopped) as (watch, tell, say):
        crew = recruit(say)
        return run.run_batch(study, out, crew, watch=watch, tell=tell, stopped=stopped)


def completed(
    study: Study, where: str, out: Path, recruit: Callable[[Say], Recruit]
) -> pd.DataFrame:
    """Run a study as `run_cases`, and return its table; end the command if it was stopped."""
    finished = run_cases(study, where, out, recruit)
    if finished.stopped:
        terminal.say(_STOPPED)
        raise typer.Exit(worst(finished))
    return finished.summary


def crew_of(workers: int | None, scheduler: str | None, say: Say) -> Recruit:
    """Return a function that starts the workers: those of a Dask cluster, or local processes.

    Without a number there is one local process for each core.
    """
    if scheduler is None:
        from fesim.batch.local import local_crew

        return lambda: local_crew(workers or os.cpu_count() or 1)
    let_dask_load()
    # Here, not above: Dask is an extra.
    from fesim.batch.cluster import dask_crew

    return lambda: dask_crew(scheduler, say)


@contextmanager
def stop_request() -> Iterator[Callable[[], bool]]:
    """Give a function that returns whether Ctrl-C was pressed; a second one ends at once."""
    pressed = False

    def press(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        if pressed and callable(before):
            before(number, frame)
        pressed = True

    before = signal.signal(signal.SIGINT, press)
    try:
        yield lambda: pressed
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def display(study: Study, stopped: Callable[[], bool]) -> Iterator[tuple[Watch, Tell, Say]]:
    """Give functions that print progress, events of a case, and other lines on standard error.

    Without a terminal only failures are printed.
    """
    console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
    values = {case.id: brief(case.values) for case in study.cases}
    bar = terminal.bars_on(console)
    task = bar.add_task("cases", total=len(study.cases))

    def tell(case: StudyCase, text: str) -> None:
        say(f"case {case.id} ({shown(case.values)}): {text}")

    def say(text: str) -> None:
        console.print(text)

    def watch(progress: run.Progress) -> None:
        if not console.is_terminal:
            return
        bar.update(task, completed=sum(progress.counts.values()))
        below = "\n".join(lines(progress, values, stopped()))
        live.update(Group(bar, Text(below, no_wrap=True, overflow="ellipsis")))

    live = Live(bar, console=console)
    with live if console.is_terminal else nullcontext():
        yield watch, tell, say


def lines(progress: run.Progress, values: dict[str, str], stopping: bool) -> list[str]:
    """Return the lines below the progress bar: counts, and the case of each worker."""
    counts = [f"{count} {status}" for status, count in progress.counts.items()]
    if progress.found:
        counts.append(f"{progress.found} of them found finished")
    shown_lines = [", ".join([*counts, f"{progress.workers} workers"])]
    if not progress.workers:
        shown_lines.append("waiting for workers")
    if stopping:
        shown_lines.append("stopping after the running cases; Ctrl-C again ends at once")
    running = list(progress.working.items())
    shown_lines += [f"  {worker}: {values[case]}" for worker, case in running[:SHOWN_WORKERS]]
    return shown_lines


def worst(finished: run.Finished) -> int:
    """Return the exit code: 130 if stopped, 1 if a case has no result, else 0."""
    if finished.stopped:
        return 130
    return int(bool((finished.summary["status"] != "done").any()))


def closing_lines(finished: run.Finished, out: Path) -> list[str]:
    """Return the lines printed at the end."""
    counts = finished.summary["status"].value_counts()
    closing = [
        f"{len(finished.summary)} cases: "
        + ", ".join(f"{count} {status}" for status, count in counts.items())
        + f"; {finished.found} found finished, {finished.ran} run now"
    ]
    if finished.stopped:
        closing.append(_STOPPED)
    return [*closing, f"wrote {out / 'dataset.zarr'}, {out / 'summary.csv'}, summary.parquet"]


def check_workers(workers: int | None, scheduler: str | None) -> None:
    """Refuse options that contradict each other."""
    if workers is not None and scheduler is not None:
        raise InputError("--workers goes with local processes, not with --scheduler; give one")
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}: give 1 or more")
