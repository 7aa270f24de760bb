"""Runs CalculiX and reads what it printed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, InputError

PROGRAM = "ccx"


@dataclass(frozen=True)
class Run:
    """A finished run."""

    #: Shape (nodes, 3): at the end, m.
    displacement: Array
    #: Shape (nodes,): at the end, K.
    temperature: Array
    #: Shape (points,): at the contact points in contact at the end, Pa.
    contact_pressure: Array
    #: Of the whole joint, pressing positive, N.
    normal_force: float
    #: Wall time of the program.
    seconds: float
    #: Of all steps.
    increments: int
    iterations: int
    #: Of the program.
    version: str


def available() -> bool:
    """Say whether CalculiX is on the PATH."""
    return shutil.which(PROGRAM) is not None


def run_deck(text: str, folder: Path, name: str, timeout: float) -> Run:
    """Run a deck on one thread.

    `text`: the deck. `folder`: where its files go. `name`: their name without suffix. `timeout`:
    longest wall time, s. Raises `InputError`: there is no CalculiX, or it refuses the deck. Raises
    `ConvergenceError`: it did not come to the end, or not in time.
    """
    if not available():
        raise InputError(f"against_calculix: no {PROGRAM} on the PATH; install calculix-ccx")
    (folder / f"{name}.inp").write_text(text, encoding="ascii")
    threads = {"OMP_NUM_THREADS": "1", "CCX_NPROC_STIFFNESS": "1", "CCX_NPROC_RESULTS": "1"}
    start = time.perf_counter()
    try:
        done = subprocess.run(
            [PROGRAM, name],
            cwd=folder,
            env=os.environ | threads,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise ConvergenceError(f"{name}: CalculiX took more than {timeout:g} s") from error
    seconds = time.perf_counter() - start
    (folder / f"{name}.log").write_text(done.stdout, encoding="utf-8")
    if "ERROR reading" in done.stdout or "fatal" in done.stdout:
        line = next(line for line in done.stdout.splitlines() if "ERROR" in line)
        raise InputError(f"{name}: CalculiX refuses the deck: {line.strip()}")
    if "Job finished" not in done.stdout:
        raise ConvergenceError(f"{name}: CalculiX stopped; see {folder / f'{name}.log'}")
    found = re.search(r"Version (\S+?),", done.stdout)
    rows = [line.split() for line in (folder / f"{name}.sta").read_text().splitlines()[2:]]
    blocks = read_blocks((folder / f"{name}.dat").read_text(encoding="ascii"))
    displacement = blocks["displacements"]
    force = re.findall(r"normal force.*\n\s*\n\s*\S+\s+(\S+)", (folder / f"{name}.dat").read_text())
    return Run(
        displacement=displacement[np.argsort(displacement[:, 0]), 1:],
        temperature=blocks["temperatures"][np.argsort(blocks["temperatures"][:, 0]), 1],
        contact_pressure=blocks["contact stress"][:, 2],
        normal_force=-float(force[-1]),
        seconds=seconds,
        increments=len(rows),
        iterations=sum(int(row[3]) for row in rows),
        version=found.group(1) if found else "?",
    )


def read_blocks(text: str) -> dict[str, Array]:
    """Last block of rows under each heading of a .dat file; headings without their brackets."""
    blocks: dict[str, list[list[float]]] = {}
    rows: list[list[float]] | None = None
    for line in text.splitlines():
        if "time" in line:
            rows = []
            blocks[re.split(r"\(| for | and ", line.strip())[0].strip()] = rows
        elif rows is not None and line.strip():
            try:
                rows.append([_number(part) for part in line.split()])
            except ValueError:  # a heading within the block
                rows = None
    return {name: np.array(found) for name, found in blocks.items()}


def _number(text: str) -> float:
    """A number as Fortran prints it; three digits of exponent leave no room for the E."""
    return float(re.sub(r"(\d)([+-]\d{3})$", r"\1E\2", text))
