"""The whole chain, `thermojoint reproduce`, with nothing kept on the disk and with all of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.performance.cases import fresh_condensations
from benchmarks.performance.timing import Row, paired
from thermojoint.artefacts.errors import ConvergenceError

#: Time limit of `thermojoint reproduce`, s.
ALLOWED = 60.0


def rows() -> Iterator[Row]:
    """Yield reproduce-cold and reproduce-kept."""
    with TemporaryDirectory() as name:
        folder = Path(name)

        def reproduce() -> None:
            command = [sys.executable, "-m", "thermojoint", "reproduce"]
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
            kept, cold, ratio = paired(reproduce, from_nothing, 1)
    what = "thermojoint reproduce, interpreter started and files written; measured once;"
    yield Row(
        "reproduce-cold",
        cold,
        ALLOWED,
        ALLOWED / cold,
        "s",
        f"{what} with an empty folder for condensations; other: the limit",
    )
    yield Row(
        "reproduce-kept",
        kept,
        cold,
        ratio,
        "s",
        f"{what} with the condensation on the disk from an earlier run against an empty folder",
    )
