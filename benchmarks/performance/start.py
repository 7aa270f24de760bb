"""How long a command takes to begin, against an import of NumPy, and what a short run takes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from benchmarks.performance.cases import fresh_condensations
from benchmarks.performance.timing import Row, paired
from benchmarks.study import ROOT

REPEATS = 9
COMMANDS = {
    "start-version": (["--version"], "thermojoint --version"),
    "start-help": (["--help"], "thermojoint --help"),
    "start-simulate": (
        ["simulate", "nowhere.toml", "--out", "nowhere.nc"],
        "thermojoint simulate of a case that is not there: its imports and its one line; xarray "
        "and the compiler are loaded when a response and a joint ask for them",
    ),
}


#: A short case; processor time, s, and memory, MB, that its whole process may take.
SHORT, LIMIT_S, LIMIT_MB = ROOT / "examples" / "two_rods" / "case.toml", 1.0, 200.0


def rows(repeats: int = REPEATS) -> Iterator[Row]:
    """Yield start-version, -help, -simulate, -marched and -memory."""
    with TemporaryDirectory() as name:
        for row, (arguments, what) in COMMANDS.items():
            command = partial(_run, ["-m", "thermojoint", *arguments], Path(name))
            numpy = partial(_run, ["-c", "import numpy"], Path(name))
            command()  # its modules are compiled and in the page cache
            yield Row(
                row,
                *paired(command, numpy, repeats),
                "s",
                f"{what}; other: python -c 'import numpy'; median of {repeats}",
            )
        yield from marched_rows(Path(name), repeats)


def marched_rows(folder: Path, repeats: int) -> Iterator[Row]:
    """Yield start-marched and start-memory: a whole process that simulates a short case."""
    words = ["-m", "thermojoint", "simulate", str(SHORT), "--out", "short.nc"]
    note = (
        "thermojoint simulate of examples/two_rods whole, machine code and condensation kept; "
        f"other: the target; median of {repeats}"
    )
    with fresh_condensations():
        _spent(words, folder)
        times, memories = zip(*(_spent(words, folder) for _ in range(repeats)), strict=True)
    time, memory = median(times), median(memories)
    yield Row("start-marched", time, LIMIT_S, LIMIT_S / time, "s", f"processor time of {note}")
    yield Row("start-memory", memory, LIMIT_MB, LIMIT_MB / memory, "MB", f"peak memory of {note}")


#: Runs a command from a small process: peak memory counts from the fork, not from the start.
_WATCHED = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)
"""


def _spent(arguments: list[str], folder: Path) -> tuple[float, float]:
    """Run a process to its end; return its processor time (s) and its peak memory (MB)."""
    command = [sys.executable, "-c", _WATCHED, sys.executable, *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    time, memory = map(float, done.stdout.split())
    return time, memory


def _run(arguments: list[str], folder: Path) -> None:
    subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, check=False)
