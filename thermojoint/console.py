"""What the user sees: results on standard output, progress and warnings on the other one."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

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

from thermojoint.artefacts.unfinished import cleared_at_stop

#: Called with (what is being worked on, done, in all).
Report = Callable[[str, int, int], None]


def out() -> Console:
    """Return the console for results, as wide as the terminal, or 100 columns in a file."""
    console = Console(highlight=False, markup=False)
    return console if console.is_terminal else Console(highlight=False, markup=False, width=100)


@contextmanager
def progress_bars() -> Iterator[Report]:
    """Give a function that shows one bar for each thing named; silent where there is no terminal.

    Yields
    ------
    callable
        To be called with (name, done, in all).
    """
    console = Console(stderr=True)
    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    )
    tasks: dict[str, TaskID] = {}

    def report(name: str, done: int, total: int) -> None:
        if name not in tasks:
            tasks[name] = bars.add_task(name, total=total)
        bars.update(tasks[name], completed=done, total=total)

    with bars, cleared_at_stop(_show_cursor):
        yield report


def _show_cursor() -> None:
    """Give a terminal its cursor back, which live output hides."""
    if sys.stderr.isatty():
        os.write(sys.stderr.fileno(), b"\x1b[?25h\n")


def say(text: str) -> None:
    """Print one line about what was done, on standard error."""
    print(text, file=sys.stderr, flush=True)


def warn(lines: Iterable[str]) -> None:
    """Print a line for each warning, on standard error."""
    for line in lines:
        say(f"warning: {line}")


def wrote(*paths: Path | None) -> None:
    """Say which files were written."""
    for path in paths:
        if path is not None:
            say(f"wrote {path}")


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
