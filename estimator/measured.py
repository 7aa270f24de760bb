"""Measured temperatures, row by row, from a table in any dialect.

A table has one of two layouts, distinguished by column names and units; the order is free, other
columns are ignored. Rows with a missing reading are skipped; gaps are allowed:

- ``time_s, delta_T_K, T1_K, T2_K``: ΔT = T_a - T_b, and T1, T2 above the current ambient;
- ``time_s, a_degC, b_degC, T1_degC, T2_degC, ambient_degC``: as thermometers read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import TYPE_CHECKING

from estimator.columns import Sample
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import UNITS, Column
from thermojoint.artefacts.tables.clock import tells_date
from thermojoint.models.parameters import Model
from thermojoint.models.sensors import readings, roles_in

if TYPE_CHECKING:
    import xarray as xr


def samples_in(
    pieces: Iterable[Log],
    sensors: Sequence[str],
    where: str,
    on_first: Callable[[Mapping[str, float]], None] | None = None,
) -> Iterator[Sample]:
    """Yield the samples of a log as its pieces arrive: (time s, ΔT K, T1 K, T2 K, ...).

    Parameters
    ----------
    pieces : iterable of Log
        In the order of time (`thermojoint.artefacts.tables.pieces`).
    sensors : sequence of str
        Names of the sensors at the joint, e.g. T1 and T2.
    where : str
        Name of the file, for error messages.
    on_first : callable, optional
        Called with the first complete row as read: column to value.

    Raises
    ------
    InputError
        A column is missing, a temperature has two columns, or time restarts.
    """
    last = -math.inf
    for piece in pieces:
        if not piece.times[0] > last:
            raise InputError(f"{where}: time restarts; estimate each run by itself")
        wanted, values = _wanted(piece, sensors, where)
        for time, row in zip(piece.times.tolist(), values.tolist(), strict=True):
            if not all(map(math.isfinite, row)):
                continue
            if on_first is not None and last == -math.inf:
                on_first(_shown(wanted, row))
            last = time
            if len(row) == 1 + len(sensors):
                yield (time, *row)
            else:
                hot, cold, *joint, ambient = row
                yield (time, hot - cold, *(value - ambient for value in joint))


def announced(
    pieces: Iterable[Log],
    sensors: Sequence[str],
    on_first: Callable[[Mapping[str, float]], None] | None,
) -> Iterator[Log]:
    """Yield the pieces of a log; the temperatures of sensors in its first row are shown as read."""
    for number, piece in enumerate(pieces):
        if number == 0 and on_first is not None:
            there = [
                k
                for k, column in enumerate(piece.columns)
                if column.base in sensors
                and column.quantity == "temperature"
                and math.isfinite(piece.values[0, k])
            ]
            on_first(_shown([piece.columns[k] for k in there], piece.values[0, there].tolist()))
        yield piece


def temperatures_in(log: Log, names: Container[str], above: bool, where: str) -> dict[str, int]:
    """Return the columns of some temperatures by name: those above the ambient, or those as read.

    Raises
    ------
    InputError
        A temperature has two columns, in different units.
    """
    columns = [column for column in log.columns if (column.unit == "K") == above]
    return {
        base: log.columns.index(column)
        for base, column in temperatures_among(columns, names, where).items()
    }


def temperatures_among(
    columns: Iterable[Column], names: Container[str], where: str
) -> dict[str, Column]:
    """Return the columns that are some temperatures, by the names of the temperatures.

    Raises
    ------
    InputError
        A temperature has two columns, in different units.
    """
    found: dict[str, Column] = {}
    for column in columns:
        if column.base not in names or column.quantity != "temperature":
            continue
        if (other := found.setdefault(column.base, column)) is not column:
            raise InputError(
                f"{where}: columns {other.name!r} and {column.name!r} are both the temperature "
                f"{column.base!r}; leave one out, or rename it with --column"
            )
    return found


def _wanted(log: Log, sensors: Sequence[str], where: str) -> tuple[list[Column], Array]:
    """Return the columns of one of the two layouts and their values, in SI."""
    above_ambient = ["delta_T", *sensors]
    as_read = ["a", "b", *sensors, "ambient"]
    for names, above in ((above_ambient, True), (as_read, False)):
        at = temperatures_in(log, names, above, where)
        if set(names) <= set(at):
            return [log.columns[at[name]] for name in names], log.values[:, [at[n] for n in names]]
    raise InputError(
        f"{where}: columns {', '.join(log.names) or 'none'}; give time_s, "
        f"{', '.join(f'{name}_K' for name in above_ambient)} or time_s, "
        f"{', '.join(f'{name}_degC' for name in as_read)}"
    )


def _shown(columns: Sequence[Column], values: Sequence[float]) -> dict[str, float]:
    """Return one row by column, temperatures in K above the ambient or in °C."""
    zero = UNITS["degC"].offset
    return {
        f"{column.base}_K" if column.unit == "K" else f"{column.base}_degC": value
        - (0.0 if column.unit == "K" else zero)
        for column, value in zip(columns, values, strict=True)
    }


def response_samples(response: xr.Dataset, model: Model) -> Iterator[Sample]:
    """Yield the temperatures of a response in the form of `samples_in`."""
    seen = readings(response, tuple(model.linear.direct), roles_in(response, model))
    for time, difference, joint in zip(seen.times, seen.delta_T, seen.temperatures, strict=True):
        yield (float(time), float(difference), *map(float, joint))


def nominal_interval(
    samples: Iterator[Sample], given: float | None, where: str, alone: float | None = None
) -> tuple[float, Iterator[Sample]]:
    """Return the nominal sampling interval (s), and all samples including those read for it.

    Parameters
    ----------
    samples : iterator of tuple
        As `samples_in` yields them.
    given : float, optional
        Used as it is; default the interval between the first two samples.
    where : str
        For error messages.
    alone : float, optional
        The interval of fewer than two samples, s; default none.

    Raises
    ------
    InputError
        `given` is not positive, or there are fewer than two samples and `alone` is not given.
    """
    if given is not None:
        if not 0.0 < given < math.inf:
            raise InputError(f"--interval-s {given:g}: give a positive number of seconds")
        return given, samples
    first = list(islice(samples, 2))
    if len(first) < 2 and alone is not None:
        return alone, iter(first)
    if len(first) < 2:
        raise InputError(f"{where}: fewer than two samples; give more, or --interval-s")
    return first[1][0] - first[0][0], chain(first, samples)


def going_on(samples: Iterator[Sample], last: float, where: str, state: str) -> Iterator[Sample]:
    """Yield samples that continue a run as they arrive.

    Parameters
    ----------
    samples : iterator of tuple
        As `samples_in` yields them.
    last : float
        Time of the last sample of the run, s; NaN for none.
    where, state : str
        Origin of the samples, and of the run.

    Raises
    ------
    InputError
        Only one of the clocks has a date, or the samples do not come after the run.
    """
    for first in islice(samples, 1):
        clocks = f"{where}: begins at {first[0]:.15g} s, and {state} ended at {last:.15g} s"
        if not math.isnan(last) and tells_date(first[0]) != tells_date(last):
            raise InputError(f"{clocks}: only one has a date; give both the same clock")
        if first[0] <= last:
            raise InputError(
                f"{clocks}; give what comes after it, with dates where a midnight is between them"
            )
        yield first
    yield from samples


def some(samples: Iterable[Sample], where: str) -> Iterator[Sample]:
    """Yield samples as they arrive.

    Raises
    ------
    InputError
        There was none; `where` is their origin.
    """
    sample = None
    for sample in samples:
        yield sample
    if sample is None:
        raise InputError(
            f"{where}: no samples; give rows below the header, with every reading of the model"
        )
