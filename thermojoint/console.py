"""Terminal output: results on standard output, progress and warnings on standard error.

The verbosity (-q, -v) belongs to the process, as its streams do.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from threading import Event, Thread
from time import monotonic

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.unfinished import cleared_at_stop

#: Called with (name of the task, done, total).
Report = Callable[[str, int, int], None]


class Verbosity(IntEnum):
    """Amount of output."""

    QUIET = 0
    NORMAL = 1
    VERBOSE = 2


_verbosity = Verbosity.NORMAL


def verbosity(quiet: bool, verbose: bool) -> Verbosity:
    """Return the verbosity that -q and -v select.

    Raises
    ------
    InputError
        Both are given.
    """
    if quiet and verbose:
        raise InputError("--quiet and --verbose: give one of them")
    return Verbosity.QUIET if quiet else Verbosity.VERBOSE if verbose else Verbosity.NORMAL


def set_verbosity(wanted: Verbosity) -> None:
    """Choose how much is printed from now on."""
    global _verbosity
    _verbosity = wanted


def out(as_json: Path | None = None) -> Console:
    """Return the console for results, as wide as the terminal, or 100 columns in a file.

    The console is silent if the results go to standard output as JSON (`as_json` is ``-``).
    """
    silent = _verbosity is Verbosity.QUIET or _is_stream(as_json)
    console = Console(highlight=False, markup=False, quiet=silent)
    if not console.is_terminal:
        console.width = 100
    return console


@contextmanager
def progress_bars() -> Iterator[Report]:
    """Give a function of (name, done, total) that shows progress as bars, or as lines in a file."""
    if _verbosity is Verbosity.QUIET:
        yield lambda name, done, total: None
        return
    with _bars() if sys.stderr.isatty() else progress_lines() as show:
        yield show if _verbosity is Verbosity.NORMAL else _timed(show)


@contextmanager
def working(what: str) -> Iterator[None]:
    """Report the block as a running task, without its progress."""
    with progress_bars() as report:
        report(what, 0, 1)
        yield
        report(what, 1, 1)


def bars_on(console: Console) -> Progress:
    """Return progress bars of tasks: name, done of total, time spent and left."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )


@contextmanager
def _bars() -> Iterator[Report]:
    bars = bars_on(Console(stderr=True))
    tasks: dict[str, TaskID] = {}

    def report(name: str, done: int, total: int) -> None:
        if name not in tasks:
            tasks[name] = bars.add_task(name, total=total)
        bars.update(tasks[name], completed=done, total=total)

    with bars, cleared_at_stop(_show_cursor):
        yield report


@contextmanager
def progress_lines(first_s: float = 2.0, every_s: float = 10.0) -> Iterator[Report]:
    """Give a progress function, as `progress_bars`, that writes lines on standard error.

    The first line appears after `first_s` seconds, further ones every `every_s` seconds.
    """
    begun, reached = monotonic(), dict[str, tuple[int, int]]()
    ended = Event()

    def report(name: str, done: int, total: int) -> None:
        reached[name] = done, total

    def print_lines() -> None:
        wait = first_s
        while not ended.wait(wait):
            wait = every_s
            for name, (done, total) in list(reached.items()):
                if done < total:
                    part = f" {done} of {total}," if total > 1 else ""
                    say(f"{name}:{part} {monotonic() - begun:.0f} s")

    printer = Thread(target=print_lines, daemon=True)
    printer.start()
    try:
        yield report
    finally:
        ended.set()
        printer.join()


def _timed(show: Report) -> Report:
    """Report how long each task took."""
    begun: dict[str, float] = {}

    def report(name: str, done: int, total: int) -> None:
        show(name, done, total)
        since = begun.setdefault(name, monotonic())
        if done >= total:
            say(f"{name}: {monotonic() - since:.1f} s")

    return report


def _show_cursor() -> None:
    """Show the cursor of a terminal again, which live output hides."""
    if sys.stderr.isatty():
        os.write(sys.stderr.fileno(), b"\x1b[?25h\n")


def say(text: str) -> None:
    """Print a line of information on standard error; not with -q."""
    if _verbosity is not Verbosity.QUIET:
        _print(text)


def warn(lines: Iterable[str]) -> None:
    """Print a line for each warning, on standard error."""
    for line in lines:
        _print(f"warning: {line}")


def _print(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def wrote(*paths: Path | None) -> None:
    """Report which files were written."""
    for path in paths:
        if path is not None and not _is_stream(path):
            say(f"wrote {path}")


def _is_stream(path: Path | None) -> bool:
    return str(path) == "-"


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as text for a table; a dash for None."""
    return "–" if value is None else f"{value:.{digits}g}"


def rounded(value: float) -> str:
    """Return a number with two significant digits, a whole number from 10 on; no exponent."""
    return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2g}"


def numeric(*names: str) -> list[Column]:
    """Return columns of a table for numbers, aligned to the right."""
    return [Column(name, justify="right") for name in names]


def titled(console: Console, title: str, table: Table) -> None:
    """Print a table below its title; a title inside would be wrapped to the table's width."""
    console.print()
    console.print(title, style="bold")
    console.print(table)
