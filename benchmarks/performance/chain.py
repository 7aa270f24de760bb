"""The whole chain, `thermojoint reproduce`, with nothing kept on the disk and with all of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from artefacts.errors import ConvergenceError
from benchmarks.performance.cases import fresh_condensations
from benchmarks.performance.timing import Row, paired

REPEATS = 3


def rows(repeats: int = REPEATS) -> Iterator[Row]:
    """Yield reproduce-kept."""
    with TemporaryDirectory() as name:
        folder = Path(name)

        def reproduce() -> None:
            command = [sys.executable, "-m", "thermojoint.cli", "reproduce"]
            done = subprocess.run(
                [*command, "--out", str(folder / "results")],
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode:
                raise ConvergenceError(f"thermojoint reproduce: {done.stderr.strip()}")

        def from_nothing() -> None:
            with fresh_condensations():
                reproduce()

        with fresh_condensations():
            reproduce()
            times = paired(reproduce, from_nothing, repeats)
    yield Row(
        "reproduce-kept",
        *times,
        "s",
        "thermojoint reproduce with the condensation on the disk from an earlier run against an "
        f"empty folder, interpreter started and files written; median of {repeats}",
    )
