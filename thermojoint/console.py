"""Terminal output: results on standard output, progress and warnings on standard error.

How much of it is asked for by -q and -v, and holds for the process, as its streams do.
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
from rich.table import Table

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.unfinished import cleared_at_stop

#: Called with (what is being worked on, done, in all).
Report = Callable[[str, int, int], None]


class Verbosity(IntEnum):
    """Amount of output."""

    QUIET = 0
    NORMAL = 1
    VERBOSE = 2


_verbosity = Verbosity.NORMAL


def verbosity(quiet: bool, verbose: bool) -> Verbosity:
    """Return what -q and -v ask for.

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

    It is silent if they go to standard output as JSON, for which `as_json` is ``-``.
    """
    silent = _verbosity is Verbosity.QUIET or _is_stream(as_json)
    console = Console(highlight=False, markup=False, quiet=silent)
    if not console.is_terminal:
        console.width = 100
    return console


@contextmanager
def progress_bars() -> Iterator[Report]:
    """Give a function that shows how far each thing named is: a bar, or lines without a terminal.

    Yields
    ------
    callable
        To be called with (name, done, in all).
    """
    if _verbosity is Verbosity.QUIET:
        yield lambda name, done, total: None
        return
    with _bars() if sys.stderr.isatty() else progress_lines() as show:
        yield show if _verbosity is Verbosity.NORMAL else _timed(show)


@contextmanager
def working(what: str) -> Iterator[None]:
    """Show that something is at work in the block, which does not say how far it is."""
    with progress_bars() as report:
        report(what, 0, 1)
        yield
        report(what, 1, 1)


@contextmanager
def _bars() -> Iterator[Report]:
    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    tasks: dict[str, TaskID] = {}

    def report(name: str, done: int, total: int) -> None:
        if name not in tasks:
            tasks[name] = bars.add_task(name, total=total)
        bars.update(tasks[name], completed=done, total=total)

    with bars, cleared_at_stop(_show_cursor):
        yield report


@contextmanager
def progress_lines(first_s: float = 2.0, every_s: float = 10.0) -> Iterator[Report]:
    """Give a function as `progress_bars`, for a log: a line on standard error now and then.

    Parameters
    ----------
    first_s, every_s : float
        When the first line comes, and the next ones after it, s.
    """
    begun, reached = monotonic(), dict[str, tuple[int, int]]()
    ended = Event()

    def report(name: str, done: int, total: int) -> None:
        reached[name] = done, total

    def tell() -> None:
        wait = first_s
        while not ended.wait(wait):
            wait = every_s
            for name, (done, total) in list(reached.items()):
                if done < total:
                    part = f" {done} of {total}," if total > 1 else ""
                    say(f"{name}:{part} {monotonic() - begun:.0f} s")

    teller = Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield report
    finally:
        ended.set()
        teller.join()


def _timed(show: Report) -> Report:
    """Say of each thing how long it took."""
    begun: dict[str, float] = {}

    def report(name: str, done: int, total: int) -> None:
        show(name, done, total)
        since = begun.setdefault(name, monotonic())
        if done >= total:
            say(f"{name}: {monotonic() - since:.1f} s")

    return report


def _show_cursor() -> None:
    """Give a terminal its cursor back, which live output hides."""
    if sys.stderr.isatty():
        os.write(sys.stderr.fileno(), b"\x1b[?25h\n")


def say(text: str) -> None:
    """Print one line about what was done, on standard error."""
    if _verbosity is not Verbosity.QUIET:
        _print(text)


def warn(lines: Iterable[str]) -> None:
    """Print a line for each warning, on standard error."""
    for line in lines:
        _print(f"warning: {line}")


def _print(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def wrote(*paths: Path | None) -> None:
    """Say which files were written."""
    for path in paths:
        if path is not None and not _is_stream(path):
            say(f"wrote {path}")


def _is_stream(path: Path | None) -> bool:
    return str(path) == "-"


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as a table shows it; a dash where there is none."""
    return "–" if value is None else f"{value:.{digits}g}"


def rounded(value: float) -> str:
    """Return a number with two digits that count, or as a whole number, never with an exponent."""
    return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:.2g}"


def titled(console: Console, title: str, table: Table) -> None:
    """Print a table under its title; a title inside would be broken to the table's width."""
    console.print()
    console.print(title, style="bold")
    console.print(table)
