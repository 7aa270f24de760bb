"""The table of estimates, of every kind and command: written and read here and nowhere else.

Its columns are ``time_s``, what the estimator says of its own, ``NAME_um`` and ``NAME_band_um`` of
every axis (half of the width in which the displacement lies with 95 %; empty where none is known),
``status`` and ``quality``.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from estimator.intake import axis_name
from estimator.interface import Channel, Estimate, Estimator
from estimator.quality import quality_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MEGA, MICRO

_VALUE, _BAND = "_um", "_band_um"


class Row(NamedTuple):
    """One row of a table of estimates.

    Attributes
    ----------
    time : float
        s.
    displacement, band : ndarray, shape (axes,)
        m; NaN where the cell is empty.
    status : str
        In words.
    """

    time: float
    displacement: Array
    band: Array
    status: str


def header(estimator: Estimator) -> list[str]:
    """Return the columns; an axis that carries a unit, as a column of a log does, loses it."""
    axes = [axis_name(axis) for axis in estimator.axes]
    return [
        "time_s",
        *(_column(channel) for channel in estimator.details),
        *(f"{axis}{ending}" for ending in (_VALUE, _BAND) for axis in axes),
        "status",
        "quality",
    ]


def row(estimator: Estimator, estimate: Estimate) -> list[str]:
    """Return one estimate as text, in the order of `header`; empty where there is no band."""
    scales = (MEGA if channel.unit == "m" else 1.0 for channel in estimator.details)
    values = [
        *(scale * value for scale, value in zip(scales, estimate.details, strict=True)),
        *(MEGA * estimate.displacement),
        *(MEGA * estimate.band),
    ]
    texts = (f"{float(value):.9g}" if value == value else "" for value in values)
    quality = quality_of(estimate.words, estimate.displacement)
    # Fifteen digits: seconds since 1970 with their milliseconds.
    return [f"{estimate.time:.15g}", *texts, estimate.words, quality.word]


def read_estimate(lines: Iterable[str], where: str) -> tuple[tuple[str, ...], list[Row]]:
    """Return the axes and the rows of an estimate of any estimator.

    Parameters
    ----------
    lines : iterable of str
        A CSV with the columns ``time_s``, ``NAME_um`` and ``NAME_band_um`` of every axis, and
        ``status``; other columns are ignored.
    where : str
        Name of the file, for error messages.

    Raises
    ------
    InputError
        A column is missing, a value is no number, time does not increase, or there is no row.
    """
    reader = csv.reader(lines)
    try:
        table = [(reader.line_num, cells) for cells in reader if cells]
    except csv.Error as error:
        raise InputError(f"{where}: not readable as CSV ({error}); mend the file") from error
    names = [name.strip().lstrip("\ufeff") for name in table[0][1]] if table else []
    axes = tuple(
        name.removesuffix(_BAND)
        for name in names
        if name.endswith(_BAND) and name.removesuffix(_BAND) + _VALUE in names
    )
    if not axes or "time_s" not in names or "status" not in names:
        raise InputError(
            f"{where}: no estimate, columns {', '.join(names) or 'none'}; give what "
            "`thermojoint estimate` writes"
        )
    rows: list[Row] = []
    for number, cells in table[1:]:
        line = f"{where}, line {number}"
        if len(cells) != len(names):
            raise InputError(f"{line}: {len(cells)} values, expected {len(names)}; mend the row")
        at = dict(zip(names, cells, strict=True))
        time = _number(at["time_s"], line)
        last = rows[-1].time if rows else -math.inf
        if not last < time < math.inf:
            raise InputError(
                f"{line}: time {time:g} s does not come after {last:g} s; drop or re-order it"
            )
        values, bands = (
            MICRO * np.array([_number(at[f"{axis}{ending}"], line) for axis in axes])
            for ending in (_VALUE, _BAND)
        )
        rows.append(Row(time, values, bands, at["status"].strip()))
    if not rows:
        raise InputError(f"{where}: holds no row; give an estimate of some length")
    return axes, rows


def _column(channel: Channel) -> str:
    suffix = {"m": _VALUE, "1": ""}.get(channel.unit, f"_{channel.unit}")
    return f"{channel.name}{suffix}"


def _number(text: str, line: str) -> float:
    try:
        return float(text) if text.strip() else math.nan
    except ValueError:
        raise InputError(f"{line}: {text!r} is no number; mend the row") from None
