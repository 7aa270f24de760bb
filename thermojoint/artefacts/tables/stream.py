"""Rows of a log that arrive one by one, by the rules of `thermojoint.artefacts.tables.pieces`.

The layout is that of the first lines (`layout_of`). A mistake in a row concerns that row alone: the
stream continues.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import Place
from thermojoint.artefacts.tables.cells import is_error_value, is_missing, number_in
from thermojoint.artefacts.tables.clock import LATEST, Hands, moment, passed
from thermojoint.artefacts.tables.dialect import cells_of, values_of
from thermojoint.artefacts.tables.layout import Layout


class StreamedRow(NamedTuple):
    """Content of a row."""

    #: s; since 1970 if the clock has a date.
    time: float
    #: Requested columns in the requested units; NaN where missing.
    readings: list[float]
    #: State of the clock after the row.
    hands: Hands
    #: A shift of the clock, e.g. ``midnight passed``; usually empty.
    note: str


def row_of(
    line: str, layout: Layout, places: Sequence[Place | None], hands: Hands
) -> StreamedRow | None:
    """Return the content of a line; None for an empty line, a comment or a repeated header.

    Parameters
    ----------
    line : str
        A line of the table after its header.
    layout : Layout
        Layout of the table.
    places : sequence of Place or None
        Position of each reading in `Layout.columns`; None for one that the table lacks.
    hands : Hands
        State of the clock after the previous row.

    Raises
    ------
    OtherHeaderError
        The line is another header.
    InputError
        The number of cells differs from the header's, the time is missing, or a reading is neither
        a number nor missing.
    """
    cells = _cells(line, layout)
    if cells is None:
        return None
    decimal = layout.dialect.decimal
    clock = [cells[k] for k in layout.clock.columns]
    at = moment(layout.clock, clock, decimal)
    if at is None or not abs(at.first) <= LATEST:
        text = " ".join(clock).strip()
        raise InputError(f"{text!r} is not a time like that of the first row" if text else _NO_TIME)
    after, note = passed(layout.clock, hands, at)
    readings = [
        math.nan if place is None else _reading(layout, place, cells, decimal) for place in places
    ]
    return StreamedRow(after.last, readings, after, note)


def decimal_in(line: str, layout: Layout) -> str:
    """Return the decimal sign that a line shows; empty if it shows none.

    A file shows its sign in many rows, but the first row of a stream may be of a machine at rest.
    """
    try:
        return layout.decimal_in([_cells(line, layout) or []])
    except InputError:
        return ""


def _cells(line: str, layout: Layout) -> list[str] | None:
    (_, row), *_ = [*cells_of([line], layout.dialect.separator, layout.where), (0, [""])]
    return values_of(row, layout.dialect)


_NO_TIME = "the time is missing"


def _reading(layout: Layout, place: Place, cells: Sequence[str], decimal: str) -> float:
    text = cells[layout.kept[place.at]]
    value = number_in(text, decimal)
    if value is None:
        if not is_missing(text):
            raise InputError(f"{text.strip()!r} is not a number")
        return math.nan
    if not math.isfinite(value) or is_error_value(value, layout.columns[place.at].quantity):
        return math.nan
    return value if place.found is None else float(place.values(np.array(value)))
