"""Logs as loggers write them: CSV with any columns, read piece by piece.

Comma, semicolon or tab between the cells, and a decimal comma where semicolons divide. A column's
name ends in its unit (`thermojoint.artefacts.quantities`); a mapping gives other columns such
names. Samples may lie any distance apart; an empty cell or NaN is a reading that is missing. Files
are read in pieces, so that a year of samples takes no more memory than what is kept of it.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TextIO

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.log import Log, joined
from thermojoint.artefacts.quantities import UNITS, Column, column_named
from thermojoint.artefacts.settings.toml import parse, read_text

if TYPE_CHECKING:
    import pandas as pd

#: Rows read at a time.
ROWS = 1 << 15
#: A clock as text, in ISO 8601.
_STAMPS = ("time", "timestamp", "datetime", "date")
#: No machine tool is so hot on the whole, °C; what a room is in kelvin.
_KELVIN = (223.0, 400.0)
#: No thermal displacement is larger, m.
_LARGEST_LENGTH = 0.05


def read_mapping(path: Path) -> dict[str, str]:
    """Return what a TOML file calls the columns of a log: ``[columns]``, theirs = ours.

    Raises
    ------
    InputError
        It is no such file.
    """
    content = parse(read_text(path, "mapping"), str(path))
    found = content.get("columns")
    if set(content) != {"columns"} or not isinstance(found, dict):
        raise InputError(f"{path}: give one table [columns] with lines like 'Temp 1' = 'T1_degC'")
    for theirs, ours in found.items():
        if not isinstance(ours, str) or column_named(ours) is None:
            raise InputError(
                f"{path}: columns.{theirs}: {ours!r} ends in no unit known here; end it in one of "
                f"{', '.join(f'_{unit}' for unit in UNITS)}"
            )
    return {str(theirs): str(ours) for theirs, ours in found.items()}


def read_log(paths: Sequence[Path], renamed: Mapping[str, str] | None = None) -> Log:
    """Read a log from files in the order of time.

    Parameters
    ----------
    paths : sequence of Path
        CSV files with the same columns; NAME_s is the clock, or ``timestamp`` in ISO 8601.
    renamed : mapping, optional
        Name of a column to the one it is given, which ends in its unit (`read_mapping`).

    Raises
    ------
    InputError
        A file is missing or no CSV, has no clock, other columns than the first, a row that is
        too short, a cell that is no number, a clock that does not go forward, or what looks like
        kelvin in a column of °C.
    """
    return joined(piece for path in paths for piece in log_pieces(path, renamed))


class _Layout(NamedTuple):
    """How a file is to be read: all its cells, which of them are the clock and which are kept."""

    where: str
    divider: str
    names: list[str]
    clock: int
    kept: list[int]
    columns: tuple[Column, ...]

    @property
    def scale(self) -> float:
        """Unit of the clock, s; 0 for one that tells the date."""
        column = column_named(self.names[self.clock])
        return UNITS[column.unit].scale if column else 0.0


def log_pieces(
    path: Path, renamed: Mapping[str, str] | None = None, rows: int = ROWS
) -> Iterator[Log]:
    """Yield a file's samples piece by piece; see `read_log`.

    Parameters
    ----------
    path : Path
        CSV.
    renamed : mapping, optional
        Name of a column to the one it is given.
    rows : int
        Samples in a piece.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file; give a log as CSV")
    with Path(path).open(encoding="utf-8-sig", errors="replace", newline=None) as file:
        yield from pieces_in(file, str(path), renamed, rows)


def pieces_in(
    lines: TextIO, where: str, renamed: Mapping[str, str] | None = None, rows: int = ROWS
) -> Iterator[Log]:
    """Yield the samples of a CSV as its lines come in; see `log_pieces`."""
    layout = _layout(lines.readline(), where, renamed or {})
    last, number = -np.inf, 2
    while text := list(islice(lines, rows)):
        table = _cells(layout, text, number)
        times = _clock(layout, table, text, number)
        stuck = np.flatnonzero(~(np.diff(times, prepend=last) > 0.0))
        if stuck.size:
            raise InputError(
                f"{where}, line {number + _line_of(text, stuck[0])}: the clock does not go "
                "forward; drop the row, or put the rows in order"
            )
        values = table.iloc[:, layout.kept].to_numpy(dtype=float)
        number += len(text)
        if not len(times):
            continue
        last = float(times[-1])
        values = np.where(np.isfinite(values), values, np.nan)
        _check_units(layout, values)
        turned = [one.to_si(column) for one, column in zip(layout.columns, values.T, strict=True)]
        yield Log(times, layout.columns, np.stack(turned, axis=1))


def _layout(header: str, where: str, renamed: Mapping[str, str]) -> _Layout:
    divider = max(",;\t", key=header.count)
    theirs = [name.strip().strip('"') for name in header.strip("\r\n").split(divider)]
    for name, ours in renamed.items():
        if name not in theirs and ours not in theirs:
            raise unknown_name("column", name, theirs, where)
    names = [renamed.get(name, name) for name in theirs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{where}: two columns are called {twice[0]!r}; rename one")
    known = [column_named(name) for name in names]
    clocks = [
        k
        for k, (name, column) in enumerate(zip(names, known, strict=True))
        if (
            column is not None
            and column.quantity == "time"
            and column.base.lower() in ("time", "t")
        )
        or name.lower() in _STAMPS
    ]
    if not clocks:
        raise InputError(
            f"{where}: no clock among the columns {', '.join(theirs)[:200]}; rename one time_s, "
            "e.g. --column 'NAME=time_s'"
        )
    kept = [k for k, one in enumerate(known) if one is not None and one.quantity != "time"]
    if not kept:
        raise InputError(
            f"{where}: no column's name ends in a unit, as T1_degC or x_um does; rename them with "
            "--column 'NAME=T1_degC'"
        )
    columns = tuple(one for one in known if one is not None and one.quantity != "time")
    return _Layout(where, divider, names, clocks[0], kept, columns)


def _cells(layout: _Layout, text: Sequence[str], number: int) -> pd.DataFrame:
    """Return the cells of some lines: numbers in the columns that are kept.

    Raises
    ------
    InputError
        A row has another number of cells than the header, or a cell is no number.
    """
    import pandas as pd

    expected = len(layout.names)
    for k, line in enumerate(text):
        found = line.count(layout.divider) + 1
        if found != expected and line.strip() and '"' not in line:
            raise InputError(
                f"{layout.where}, line {number + k}: {found} cells, expected {expected}; mend or "
                "drop the row"
            )
    numeric = [*layout.kept, *([layout.clock] if layout.scale else [])]
    options = {
        "sep": layout.divider,
        "decimal": "," if layout.divider == ";" and "," in "".join(text[:50]) else ".",
        "header": None,
        "names": layout.names,
        "usecols": sorted({*layout.kept, layout.clock}),
        "skipinitialspace": True,
    }
    try:
        wanted: dict[str, type] = {layout.names[k]: float for k in numeric}
        if not layout.scale:
            wanted[layout.names[layout.clock]] = str
        found = pd.read_csv(io.StringIO("".join(text)), dtype=wanted, **options)
    except ValueError as error:
        raise _no_number(layout, text, number, options, numeric) from error
    return found.reindex(columns=layout.names)


def _no_number(
    layout: _Layout,
    text: Sequence[str],
    number: int,
    options: Mapping[str, object],
    numeric: Sequence[int],
) -> InputError:
    """Return the error that names the first cell that is no number."""
    import pandas as pd

    try:
        table = pd.read_csv(io.StringIO("".join(text)), dtype=str, **options)
    except ValueError as error:
        return InputError(f"{layout.where}: not readable as CSV ({error}); mend the file")
    for name in (layout.names[k] for k in numeric):
        cells = table[name].dropna().str.replace(",", ".", regex=False)
        bad = cells[pd.to_numeric(cells, errors="coerce").isna()]
        if len(bad):
            line = number + _line_of(text, int(bad.index[0]))
            return InputError(
                f"{layout.where}, line {line}: {name} is {bad.iloc[0]!r}, no number; leave the "
                "cell empty if the reading is missing"
            )
    return InputError(f"{layout.where}, near line {number}: not readable as CSV; mend the file")


def _line_of(text: Sequence[str], row: int) -> int:
    """Return in which of some lines a row stands; empty lines are no rows."""
    full = [k for k, line in enumerate(text) if line.strip()]
    return full[row]


def _clock(layout: _Layout, table: pd.DataFrame, text: Sequence[str], number: int) -> Array:
    import pandas as pd

    cells = table.iloc[:, layout.clock]
    if layout.scale:
        times = np.asarray(layout.scale * cells.to_numpy(dtype=float))
    else:
        stamps = pd.to_datetime(cells, errors="coerce", utc=True, format="ISO8601")
        times = (stamps - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy(dtype=float)
    missing = np.flatnonzero(~np.isfinite(times))
    if missing.size:
        line = number + _line_of(text, int(missing[0]))
        raise InputError(f"{layout.where}, line {line}: the time is missing or unreadable; drop it")
    return times


def _check_units(layout: _Layout, values: Array) -> None:
    """Refuse what is hardly meant: kelvin in a column of °C, micrometres in one of metres."""
    for column, cells in zip(layout.columns, values.T, strict=True):
        there = cells[np.isfinite(cells)]
        if not there.size:
            continue
        middle = float(np.median(there))
        if column.unit == "degC" and _KELVIN[0] < middle < _KELVIN[1]:
            raise InputError(
                f"{layout.where}: {column.name} is about {middle:.0f}, kelvin and not °C; rename "
                f"it: --column '{column.name}={column.base}_K'"
            )
        if column.quantity == "length" and abs(float(column.to_si(np.array(middle)))) > (
            _LARGEST_LENGTH
        ):
            raise InputError(
                f"{layout.where}: {column.name} is about {middle:g}: more than "
                f"{1e3 * _LARGEST_LENGTH:.0f} mm is no thermal displacement; rename it with "
                "its unit"
            )
