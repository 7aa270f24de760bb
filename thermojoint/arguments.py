"""What stands on a command line and what it means: files, standard streams, LEVEL=FILE pairs."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from artefacts.errors import InputError
from artefacts.files import whole_file


def shown(path: Path) -> str:
    """Return the name of an input for an error message."""
    return "standard input" if str(path) == "-" else str(path)


def check_writable(*paths: Path | None) -> None:
    """Refuse, before any work, a place where no file can be written."""
    for path in paths:
        if path is None or str(path) == "-":
            continue
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give a file name")
        above = next(folder for folder in path.absolute().parents if folder.exists())
        if not above.is_dir() or not os.access(above, os.W_OK):
            raise InputError(f"{path}: nothing can be written in {above}; choose another place")


def level_and_file(text: str) -> tuple[float, Path]:
    """Split ``0.5=r05.nc`` into the heat input and the file."""
    level, _, name = text.partition("=")
    if name:
        with suppress(ValueError):
            return float(level), Path(name)
    raise InputError(f"--input {text}: write LEVEL=RESPONSE, e.g. 0.5=step-0.5.nc")


@contextmanager
def opened(path: Path) -> Iterator[TextIO | None]:
    """Open a CSV, or standard input for ``-``; None for a response."""
    if str(path) == "-":
        yield sys.stdin
    elif path.suffix == ".nc":
        yield None
    elif not path.is_file():
        raise InputError(f"{path}: no such file; give a CSV of temperatures or a response (.nc)")
    else:
        with path.open(encoding="utf-8", errors="replace", newline="") as file:
            yield file


@contextmanager
def output(path: Path) -> Iterator[TextIO]:
    """Write a file whole or not at all, or to standard output for ``-``."""
    if str(path) == "-":
        yield sys.stdout
        return
    with whole_file(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        yield file
