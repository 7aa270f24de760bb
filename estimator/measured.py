"""Measured temperatures as CSV, row by row.

A file has one of two layouts, told apart by their column names; the order is free, other columns
are ignored:

- ``time_s, delta_T_K, T1_K, T2_K``: ΔT = T_a - T_b, and T1, T2 above the current ambient;
- ``time_s, a_degC, b_degC, T1_degC, T2_degC, ambient_degC``: as thermometers read.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import TYPE_CHECKING

from thermojoint.artefacts.errors import InputError
from thermojoint.models.parameters import Model
from thermojoint.models.sensors import readings, roles_in

if TYPE_CHECKING:
    import xarray as xr

#: No temperature is further from zero, in K or °C; what an open thermocouple reads (9.9e37) is.
LARGEST = 5000.0
#: Time (s), ΔT (K) and the temperatures at the joint above the current ambient (K).
Sample = tuple[float, ...]


def read_samples(
    lines: Iterable[str],
    sensors: Sequence[str],
    where: str,
    on_first: Callable[[Mapping[str, float]], None] | None = None,
) -> Iterator[Sample]:
    """Yield the samples of a CSV as its lines come in.

    Parameters
    ----------
    lines : iterable of str
        An open file, or standard input.
    sensors : sequence of str
        Names of the sensors at the joint, e.g. T1 and T2.
    where : str
        Name of the file, for error messages.
    on_first : callable, optional
        Called with the first row as it was read: column to value.

    Yields
    ------
    tuple of float
        (time s, ΔT K, T1 K, T2 K, ...).

    Raises
    ------
    InputError
        The lines are no CSV, a column is missing, a value is no finite number or no temperature, or
        time does not increase.
    """
    rows = _rows(lines, where)
    header = [name.strip().lstrip("\ufeff") for name in next(rows, (0, []))[1]]
    above_ambient = ["time_s", "delta_T_K", *(f"{name}_K" for name in sensors)]
    as_read = ["time_s", "a_degC", "b_degC", *(f"{name}_degC" for name in sensors), "ambient_degC"]
    if set(above_ambient) <= set(header):
        wanted = above_ambient
    elif set(as_read) <= set(header):
        wanted = as_read
    else:
        raise InputError(
            f"{where}: columns {', '.join(header) or 'none'}; give {', '.join(above_ambient)} or "
            f"{', '.join(as_read)}"
        )
    at = [header.index(name) for name in wanted]
    last = -math.inf
    for number, row in rows:
        line = f"{where}, line {number}"
        if len(row) != len(header):
            raise InputError(f"{line}: {len(row)} values, expected {len(header)}; mend the row")
        values = [_number(row[k], name, line) for k, name in zip(at, wanted, strict=True)]
        if not values[0] > last:
            raise InputError(
                f"{line}: time {values[0]:g} s does not come after {last:g} s; drop or re-order it"
            )
        for value, name in zip(values[1:], wanted[1:], strict=True):
            if abs(value) > LARGEST:
                raise InputError(
                    f"{line}: {name} is {value:g}, no temperature; leave the row out, gaps are "
                    "allowed"
                )
        if on_first is not None and last == -math.inf:
            on_first(dict(zip(wanted, values, strict=True)))
        last = values[0]
        if wanted is above_ambient:
            yield tuple(values)
        else:
            time, hot, cold, *joint, ambient = values
            yield (time, hot - cold, *(value - ambient for value in joint))


def _rows(lines: Iterable[str], where: str) -> Iterator[tuple[int, list[str]]]:
    """Yield number and values of every line of a CSV that is not empty."""
    reader = csv.reader(lines)
    try:
        for row in reader:
            if row:
                yield reader.line_num, row
    except csv.Error as error:
        raise InputError(
            f"{where}, line {reader.line_num}: not readable as CSV ({error}); mend the file"
        ) from error


def response_samples(response: xr.Dataset, model: Model) -> Iterator[Sample]:
    """Yield the temperatures of a response as `read_samples` yields measured ones."""
    seen = readings(response, tuple(model.linear.direct), roles_in(response, model))
    for time, difference, joint in zip(seen.times, seen.delta_T, seen.temperatures, strict=True):
        yield (float(time), float(difference), *map(float, joint))


def nominal_interval(
    samples: Iterator[Sample], given: float | None, where: str
) -> tuple[float, Iterator[Sample]]:
    """Return the nominal sampling interval (s), and the samples from the first one on.

    Parameters
    ----------
    samples : iterator of tuple
        As `read_samples` yields them.
    given : float, optional
        Taken as it is; default the interval between the first two samples.
    where : str
        For error messages.

    Raises
    ------
    InputError
        `given` is not positive, or there are fewer than two samples to take it from.
    """
    if given is not None:
        if not 0.0 < given < math.inf:
            raise InputError(f"--interval-s {given:g}: give a positive number of seconds")
        return given, samples
    first = list(islice(samples, 2))
    if len(first) < 2:
        raise InputError(f"{where}: fewer than two samples; give more, or --interval-s")
    return first[1][0] - first[0][0], chain(first, samples)


def _number(text: str, name: str, line: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{line}: {name} is {text!r}, no number; mend the row") from None
    if not math.isfinite(value):
        raise InputError(f"{line}: {name} is not finite; leave the row out, gaps are allowed")
    return value
