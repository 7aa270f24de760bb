"""Displacements that were read at several positions of an axis.

A displacement ``x_um@y_pos_mm`` has its position in a column of the log; columns ``x@0mm_um`` and
``x@400mm_um`` were read at fixed positions. In either case a table has pairs of columns, position
and displacement. Within an interval of the table, readings on either side of their mean position
are averaged separately, so that the slope of a fast pass along the axis is kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from calibrate.learning.rules import Cleaning, Moving, Thinning
from calibrate.learning.thinning import Table
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log, runs_in
from thermojoint.artefacts.quantities import Column, column_named, fixed_positions

_SIDES = (" low", " high")


@dataclass(frozen=True)
class Along:
    """A displacement along an axis."""

    #: The displacement and the position, with their units.
    name: str
    position: str
    #: Columns of a table with its readings.
    displacements: tuple[str, ...]
    #: Column of the position of each of them, or the position, m.
    positions: tuple[str | float, ...]
    #: Outermost positions that were read, m; NaN before they are known.
    stroke: tuple[float, float] = (np.nan, np.nan)

    @property
    def at_one_place(self) -> tuple[str, ...]:
        """The columns that were read at one position each."""
        columns = zip(self.displacements, self.positions, strict=True)
        return tuple(name for name, at in columns if not isinstance(at, str))

    @property
    def reference(self) -> float:
        """P0, the middle of the stroke, m."""
        return 0.5 * sum(self.stroke)

    @property
    def lever(self) -> float:
        """Half of the stroke, m."""
        return 0.5 * (self.stroke[1] - self.stroke[0])

    def read(self, table: Table) -> Array:
        """Return the position of every reading, m, shape (k, displacements); NaN without one."""
        names = table.names
        values = table.values[:, [names.index(name) for name in self.displacements]]
        at = [
            table.values[:, names.index(one)]
            if isinstance(one, str)
            else np.full(len(table.times), one)
            for one in self.positions
        ]
        return np.where(np.isfinite(values), np.stack(at, axis=1), np.nan)

    def levers(self, table: Table) -> Array:
        """Return the distance of every reading from P0 relative to `lever`, of the same shape."""
        return (self.read(table) - self.reference) / self.lever


def sorted_out(
    pieces: Iterable[Log], displacements: Sequence[str], rules: Thinning
) -> tuple[Iterator[Log], tuple[str, ...], tuple[Along, ...]]:
    """Return the log with added columns, the displacements at one place, and those along axes.

    Raises
    ------
    InputError
        A column is missing, or is no displacement or no position.
    """
    remaining = runs_in(pieces)
    first = next(remaining, None)
    if first is None:
        return iter(()), tuple(displacements), ()
    plain: list[str] = []
    moving: list[Along] = []
    for name in dict.fromkeys(displacements):
        own = _along(first, name)
        if own is None:
            plain.append(name)
        else:
            moving.append(own)
    return (
        (_apart(piece, moving, rules) for piece in chain([first], remaining)),
        (*plain,),
        (*moving,),
    )


def _along(log: Log, name: str) -> Along | None:
    if name in log.names:
        return None
    if "@" in name:
        measured, position = (
            log.columns[log.index(part)] for part in (part.strip() for part in name.split("@", 1))
        )
        for column in (measured, position):
            if column.quantity != "length":
                raise InputError(
                    f"{name}: {column.name} is no length; name a column in um, mm or m"
                )
        return Along(
            measured.name,
            position.name,
            tuple(_side(measured, side, position).name for side in _SIDES),
            tuple(_side(position, side, measured).name for side in _SIDES),
        )
    fixed = fixed_positions(log.columns, name)
    if not fixed:
        return None
    known = column_named(name)
    base = known.base if known else name
    return Along(
        f"{base}_{fixed[0][0].unit}",
        f"{base}_at_mm",
        tuple(column.name for column, _ in fixed),
        tuple(at for _, at in fixed),
    )


def _side(column: Column, side: str, other: Column) -> Column:
    name = f"{column.name} with {other.name}{side}"
    return Column(name, name, column.unit)


def _apart(piece: Log, moving: Sequence[Along], rules: Thinning) -> Log:
    """Return a piece with the readings below and above their mean position in an interval."""
    columns, values = list(piece.columns), [piece.values]
    for own in moving:
        if own.position not in piece.names:
            continue
        measured, position = (piece.columns[piece.index(n)] for n in (own.name, own.position))
        pair = np.stack([piece.at(measured.name), piece.at(position.name)], axis=1)
        there = np.isfinite(pair).all(axis=1)
        pair[~there] = np.nan
        bins = np.unique(np.floor(piece.times / rules.interval), return_inverse=True)[1]
        total = np.bincount(bins, np.where(there, pair[:, 1], 0.0))
        low = pair[:, 1] <= (total / np.maximum(np.bincount(bins, there), 1.0))[bins]
        for side, inside in zip(_SIDES, (low, ~low), strict=True):
            columns += [_side(measured, side, position), _side(position, side, measured)]
            values.append(np.where(inside[:, None], pair, np.nan))
    return replace(piece, columns=tuple(columns), values=np.hstack(values))


def checked(
    along: Along, table: Table, cleaning: Cleaning, rules: Moving
) -> tuple[Along, list[str]]:
    """Return a displacement with its stroke, and a warning if the log shows little of its slope.

    Raises
    ------
    InputError
        There are too few readings, or the axis moved too little for a slope.
    """
    where, read = f"{along.name} at {along.position}", along.read(table)
    rows = np.isfinite(read)
    if np.count_nonzero(rows) < cleaning.fewest:
        raise InputError(
            f"{where}: {np.count_nonzero(rows)} readings with a position; give "
            f"{cleaning.fewest} or more"
        )
    low, high = float(np.nanmin(read)), float(np.nanmax(read))
    if high - low < rules.shortest:
        raise InputError(
            f"{where}: read within {1e3 * (high - low):.3g} mm; for a slope, read it over "
            f"{1e3 * rules.shortest:g} mm or more, best at both ends of the stroke once an hour"
        )
    there = rows.any(axis=1)
    # Run by run: the same hour of two days counts twice.
    run = np.searchsorted(table.starts, np.flatnonzero(there), side="right")
    spans = np.column_stack((run, table.times[there] // 3600.0))
    hours = np.unique(spans, axis=0, return_inverse=True)[1].ravel()
    ends = np.array(
        [(np.nanmin(own), np.nanmax(own)) for own in (read[there][hours == k] for k in set(hours))]
    )
    shown = int(np.count_nonzero(np.ptp(ends, axis=1) >= rules.half * (high - low)))
    said = (
        f"{where}: read over half of its {1e3 * (high - low):.3g} mm in {shown} of {len(ends)} "
        "hours with readings"
    )
    found = replace(along, stroke=(low, high))
    remedy = "read both ends every hour"
    if shown < rules.hours:
        raise InputError(f"{said}; the slope needs {rules.hours} or more: {remedy}")
    if shown < rules.share * len(ends):
        return found, [f"{said}: the slope is little known between them; {remedy}"]
    return found, []
