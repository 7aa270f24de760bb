"""A log of temperatures as CSV, row by row; a cell that is empty or NaN is a missing reading.

A file has one of two layouts, told apart by their column names; the order is free, other columns
are ignored:

- ``time_s, NAME_K, ..., ambient_K``: above the ambient at which the machine was cold; without the
  last column the ambient stays as it was;
- ``time_s, NAME_degC, ..., ambient_degC``: as thermometers read. The machine was cold at the first
  ambient temperature that the log has.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence

from thermojoint.artefacts.errors import InputError


def read_log(
    lines: Iterable[str], sensors: Sequence[str], where: str
) -> Iterator[tuple[float, ...]]:
    """Yield (time s, temperature of every sensor K, ambient K); NaN for a missing reading.

    Parameters
    ----------
    lines : iterable of str
        An open file, or standard input.
    sensors : sequence of str
        Names of the sensors.
    where : str
        Name of the file, for error messages.

    Raises
    ------
    InputError
        The lines are no CSV, a sensor has no column, a time is missing, or a cell is no number.
    """
    reader = csv.reader(lines)
    try:
        header = [name.strip().lstrip("\ufeff") for name in next(reader, [])]
        above = _columns(header, sensors, "K")
        read = _columns(header, sensors, "degC") if above is None else None
        if above is None and read is None:
            wanted = ", ".join(f"{name}_K" for name in sensors)
            absolute = ", ".join(f"{name}_degC" for name in (*sensors, "ambient"))
            raise InputError(
                f"{where}: columns {', '.join(header) or 'none'}; the model needs time_s, {wanted} "
                f"or time_s, {absolute}"
            )
        at, cold = above or read or [], 0.0 if above is not None else math.nan
        for row in reader:
            if not row:
                continue
            line = f"{where}, line {reader.line_num}"
            if len(row) != len(header):
                raise InputError(f"{line}: {len(row)} values, expected {len(header)}; mend the row")
            time, *values = [0.0 if k < 0 else _number(row[k], header[k], line) for k in at]
            if math.isnan(time):
                raise InputError(f"{line}: the time is missing; drop the row")
            if math.isnan(cold):
                cold = values[-1]
            yield (time, *(value - cold for value in values))
    except csv.Error as error:
        raise InputError(
            f"{where}, line {reader.line_num}: not readable as CSV ({error}); mend the file"
        ) from error


def _columns(header: Sequence[str], sensors: Sequence[str], unit: str) -> list[int] | None:
    """Where time, sensors and ambient stand, -1 for an ambient that is not recorded; or None."""
    wanted = ["time_s", *(f"{name}_{unit}" for name in sensors)]
    ambient = f"ambient_{unit}"
    if not set(wanted) <= set(header) or (unit == "degC" and ambient not in header):
        return None
    last = header.index(ambient) if ambient in header else -1
    return [*(header.index(name) for name in wanted), last]


def _number(text: str, name: str, line: str) -> float:
    if not text.strip():
        return math.nan
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{line}: {name} is {text!r}, no number; mend the row") from None
    return value if math.isfinite(value) else math.nan
