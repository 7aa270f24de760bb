"""Rows of a log that come in one by one, by the rules of `thermojoint.artefacts.tables.pieces`.

The layout is that of the first lines (`layout_of`). What is wrong with a row is said of that row
alone: a stream goes on behind it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import Place
from thermojoint.artefacts.tables.cells import is_error_value, is_missing, number_in
from thermojoint.artefacts.tables.clock import Hands, moment, passed
from thermojoint.artefacts.tables.dialect import cells_of, values_of
from thermojoint.artefacts.tables.layout import Layout


class Told(NamedTuple):
    """Content of a row.

    Attributes
    ----------
    time : float
        s; since 1970 where the clock tells the date.
    readings : list of float
        Of the columns that were asked for, in the units that were; NaN where one is missing.
    hands : Hands
        Where the clock stands after it.
    note : str
        What the clock did: ``midnight passed``; empty mostly.
    """

    time: float
    readings: list[float]
    hands: Hands
    note: str


def told_by(line: str, layout: Layout, places: Sequence[Place | None], hands: Hands) -> Told | None:
    """Return what a line says; None for an empty line, a comment, or a header that stands again.

    Parameters
    ----------
    line : str
        Of the table, behind its header.
    layout : Layout
        How to read it.
    places : sequence of Place or None
        Of each reading among `Layout.columns`; None for one that the table does not have.
    hands : Hands
        Where the clock stood after the row before.

    Raises
    ------
    InputError
        It has another number of cells than the header, no time, or a cell of a reading that is
        neither a number nor a missing one.
    """
    (_, row), *_ = [*cells_of([line], layout.dialect.separator, layout.where), (0, [""])]
    cells = values_of(row, layout.dialect)
    if cells is None:
        return None
    decimal = layout.dialect.decimal
    clock = [cells[k] for k in layout.clock.columns]
    at = moment(layout.clock, clock, decimal)
    if at is None or not math.isfinite(at.first):
        text = " ".join(clock).strip()
        raise InputError(f"{text!r} is not a time like that of the first row" if text else _NO_TIME)
    after, note = passed(layout.clock, hands, at)
    readings = [
        math.nan if place is None else _reading(layout, place, cells, decimal) for place in places
    ]
    return Told(after.last, readings, after, note)


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
