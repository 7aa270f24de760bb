"""Reader of named numeric columns of the CSV files of a case."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, UnreadableError


def read_columns(
    path: Path, wanted: Sequence[str], kind: str, optional: Sequence[str] = ()
) -> dict[str, Array]:
    """Read columns of numbers.

    Parameters
    ----------
    path : Path
        A CSV file with a header; lines that begin with ``#`` are left out.
    wanted : sequence of str
        Columns that must be there.
    kind : str
        Kind of file for the error message, e.g. "history".
    optional : sequence of str
        Columns that are read if present.

    Returns
    -------
    dict of str to ndarray, shape (rows,)

    Raises
    ------
    UnreadableError
        The file is missing or cannot be opened.
    InputError
        It is no CSV, a column is missing or a value is no number.
    """
    path = Path(path)
    names = ",".join(wanted)
    if not path.is_file():
        raise UnreadableError(f"{path}: no such {kind} file; give a CSV with {names}")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            rows = [(reader.line_num, row) for row in reader if row and row[0][:1] != "#"]
    except OSError as error:
        raise UnreadableError(f"{path}: cannot be read; check its permissions") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a readable CSV; give one with {names}") from error
    header = [name.strip() for name in rows[0][1]] if rows else []
    for name in wanted:
        if name not in header:
            present = ", ".join(header) or "nothing"
            raise InputError(f"{path}: column {name!r} is missing; found {present}")
    for line, row in rows[1:]:
        if len(row) != len(header):
            raise InputError(
                f"{path}: line {line} has {len(row)} values for {len(header)} columns; mend it"
            )
    return {
        name: np.array(
            [_number(row[header.index(name)], f"{path}: line {line}") for line, row in rows[1:]]
        )
        for name in [*wanted, *(name for name in optional if name in header)]
    }


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise InputError(f"{where}: {text!r} is no number; mend it") from error
