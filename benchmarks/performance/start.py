"""How long a command takes to begin, against an interpreter that imports NumPy."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.performance.timing import Row, paired

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


def rows(repeats: int = REPEATS) -> Iterator[Row]:
    """Yield start-version, start-help and start-simulate."""
    with TemporaryDirectory() as name:
        for row, (arguments, what) in COMMANDS.items():
            command = partial(_run, ["-m", "thermojoint.cli", *arguments], Path(name))
            numpy = partial(_run, ["-c", "import numpy"], Path(name))
            command()  # its modules are compiled and in the page cache
            yield Row(
                row,
                *paired(command, numpy, repeats),
                "s",
                f"{what}; other: python -c 'import numpy'; median of {repeats}",
            )


def _run(arguments: list[str], folder: Path) -> None:
    subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, check=False)
