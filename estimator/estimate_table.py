"""The table of estimates of all estimators and commands; the only module that reads or writes it.

Its columns are ``time_s``, the estimator's details, ``NAME_um`` and ``NAME_band_um`` for every axis
(half-width of the 95 % interval; empty if unknown), ``status`` and ``quality``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from estimator.intake import axis_name
from estimator.interface import Channel, Estimate, Estimator, NextReading
from estimator.lines import DETAILS, Lines, Stroke, as_lines, channels_of, places_in
from estimator.quality import quality_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.tables.cells import is_missing, number_in
from thermojoint.artefacts.tables.dialect import Dialect, cells_of, dialect_of, is_row, trimmed
from thermojoint.artefacts.tables.layout import HEAD
from thermojoint.artefacts.units import MEGA, MICRO

_VALUE, _BAND = "_um", "_band_um"
#: Units of details that are shown in millionths, and the ending of their columns.
_MICRO = {"m": _VALUE, "m/m": "_um_per_m"}


class Row(NamedTuple):
    """One row of a table of estimates."""

    #: s.
    time: float
    #: Shape (axes,): m; NaN where the cell is empty.
    displacement: Array
    band: Array
    #: In words.
    status: str
    #: Of the displacements along an axis.
    lines: Lines | None = None
    #: Displacements at positions of an axis by name (`estimator.lines.name_at`), m.
    places: Mapping[str, float] = MappingProxyType({})


def header(estimator: Estimator, more: Sequence[str] = ()) -> list[str]:
    """Return the columns, `more` of them before the status.

    An axis that carries a unit, like a log column, loses it.
    """
    axes = [axis_name(axis) for axis in estimator.axes]
    return [
        "time_s",
        *(detail_name(channel) for channel in estimator.details),
        *(f"{axis}{ending}" for ending in (_VALUE, _BAND) for axis in axes),
        *more,
        "status",
        "quality",
    ]


def row(estimator: Estimator, estimate: Estimate, more: Sequence[str] = ()) -> list[str]:
    """Return one estimate as text, in the order of `header`; empty where there is no band."""
    scales = map(detail_scale, estimator.details)
    values = [
        *(scale * value for scale, value in zip(scales, estimate.details, strict=True)),
        *(MEGA * estimate.displacement),
        *(MEGA * estimate.band),
    ]
    texts = (f"{float(value):.9g}" if value == value else "" for value in values)
    quality = quality_of(estimate.words, estimate.displacement)
    # Fifteen digits: seconds since 1970 with milliseconds.
    return [f"{estimate.time:.15g}", *texts, *more, estimate.words, quality.word]


#: Columns of the requested displacement reading; empty if there is none.
NEXT_READING = ("next_reading", "next_reading_in_min", "next_reading_narrows_um")


def next_reading_cells(asked: NextReading | None) -> list[str]:
    """Return the requested displacement reading as text, in the order of `NEXT_READING`."""
    if asked is None:
        return [""] * len(NEXT_READING)
    narrows = MEGA * (asked.band - asked.narrowed)
    return [axis_name(asked.axis), f"{asked.due / 60.0:g}", f"{narrows:.4g}"]


def read_estimate(lines: Iterable[str], where: str) -> tuple[tuple[str, ...], list[Row]]:
    """Return the axes and the rows of an estimate of any estimator.

    Parameters
    ----------
    lines : iterable of str
        A table in any dialect, with the columns ``time_s``, ``NAME_um`` and ``NAME_band_um`` of
        every axis, and ``status``; for displacements along an axis also those of their lines and at
        positions (`estimator.lines`). Other columns are ignored.
    where : str
        Name of the file, for error messages.

    Raises
    ------
    InputError
        A column is missing, a value is not a number, time does not increase, or there is no row.
    """
    table = list(lines)
    dialect = _dialect(table, where)
    names = list(dialect.names) if dialect else []
    along = _along(names)
    # A displacement at the present position of an axis is not an axis of its own.
    here = {f"{axis}_here{_BAND}" for axis in along}
    axes = tuple(
        name.removesuffix(_BAND)
        for name in names
        if name.endswith(_BAND) and name.removesuffix(_BAND) + _VALUE in names and name not in here
    )
    if dialect is None or not axes or not {"time_s", "status"} <= {*names}:
        raise InputError(
            f"{where}: no estimate, columns {', '.join(names) or 'none'}; give what "
            "`thermojoint estimate` writes"
        )
    moved = [name.removesuffix(_VALUE) for name in names if name.endswith(_VALUE)]
    places = places_in(axes, moved)
    rows: list[Row] = []
    body = table[dialect.first :]
    for number, row_cells in cells_of(body, dialect.separator, where, dialect.first):
        if not is_row(row_cells):
            continue
        line, cells = f"{where}, line {number}", trimmed(row_cells, len(names))
        if len(cells) != len(names):
            raise InputError(f"{line}: {len(cells)} values, expected {len(names)}; correct the row")
        at = dict(zip(names, cells, strict=True))
        time = _number(at["time_s"], dialect.decimal, line)
        last = rows[-1].time if rows else -math.inf
        if not last < time < math.inf:
            raise InputError(
                f"{line}: time {time:.15g} s does not come after {last:.15g} s; drop or re-order it"
            )
        values, bands = (
            MICRO
            * np.array([_number(at[f"{axis}{ending}"], dialect.decimal, line) for axis in axes])
            for ending in (_VALUE, _BAND)
        )
        own = _lines(axes, along, at, dialect.decimal, line) if along else None
        there = {name: MICRO * _number(at[name + _VALUE], dialect.decimal, line) for name in places}
        rows.append(Row(time, values, bands, at["status"].strip(), own, there))
    if not rows:
        raise InputError(f"{where}: holds no row; give an estimate of some length")
    return axes, rows


def strokes_of(axes: Sequence[str], rows: Sequence[Row]) -> dict[str, Stroke]:
    """Return the strokes of the displacements along an axis in a table, by axis."""
    found = {}
    for c, axis in enumerate(axes):
        own = [[part[c] for part in one.lines[2:]] for one in rows if one.lines]
        known = np.array([one for one in own if np.isfinite(one).all()])
        if len(known):
            reference, low, high = known.T
            found[axis] = Stroke(float(reference[0]), float(low.min()), float(high.max()))
    return found


def detail_name(channel: Channel) -> str:
    """Return the column of a detail: ``heat_spindle_W``, ``linear_x_um``, ``heat_input``."""
    suffix = {"1": "", **_MICRO}.get(channel.unit, f"_{channel.unit}")
    return f"{channel.name}{suffix}"


def detail_scale(channel: Channel) -> float:
    """Return the factor from a detail to its column: displacements and slopes are in millionths."""
    return MEGA if channel.unit in _MICRO else 1.0


def _along(names: Sequence[str]) -> dict[str, list[str]]:
    """Return the columns of the lines in a table, by axis."""
    found = {}
    for axis in (name.removesuffix(_BAND) for name in names if name.endswith(_BAND)):
        own = [detail_name(channel) for channel in channels_of(axis)]
        if {*own} <= {*names}:
            found[axis] = own
    return found


def _lines(
    axes: Sequence[str],
    along: Mapping[str, Sequence[str]],
    cells: Mapping[str, str],
    decimal: str,
    line: str,
) -> Lines | None:
    """Return the lines in a row."""
    values = np.full((len(DETAILS), len(axes)), np.nan)
    for c, axis in enumerate(axes):
        if axis in along:
            values[:, c] = [_number(cells[name], decimal, line) for name in along[axis]]
    values[:2] *= MICRO
    return as_lines(values)


def _dialect(table: Sequence[str], where: str) -> Dialect | None:
    """The dialect of the table; None without a header."""
    try:
        return dialect_of(table[:HEAD], where, whole=True)
    except InputError:
        return None


def _number(text: str, decimal: str, line: str) -> float:
    if is_missing(text):
        return math.nan
    value = number_in(text, decimal)
    if value is None:
        raise InputError(f"{line}: {text!r} is not a number; correct the row")
    return value
