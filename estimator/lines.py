"""Displacements along an axis, which estimators give beside the displacement: line and table.

δ(P) = K0 + slope (P - P0), with the displacement itself as K0. An estimator with such displacements
has the details of `DETAILS` for each of them, and those of `HERE` for the present position. One
that models the deviation from the line also has the displacement at some positions, `channels_at`:
a control that interpolates between them has the displacement at every position.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.intake import axis_name
from estimator.interface import Channel, Estimate
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MILLI

#: Suffixes and units of the details, in the order of `Lines`.
DETAILS = (
    ("slope", "m/m"),
    ("slope_band", "m/m"),
    ("P0", "mm"),
    ("stroke_from", "mm"),
    ("stroke_to", "mm"),
)
#: Suffixes and units of the details of the displacement at the present position, and its band.
HERE = (("here", "m"), ("here_band", "m"))
#: Names and units for each line along one of several moving axes, before the name of the axis.
ALONG = (("K0", "m"), ("slope", "m/m"))
#: A displacement at a position, mm, as `name_at` names it.
_PLACE = re.compile(r"(.+)_at_(-?\d+(?:\.\d+)?(?:e[+-]\d+)?)")


class Stroke(NamedTuple):
    """Positions at which a displacement was read, m."""

    #: P0.
    reference: float
    #: Smallest and largest position.
    low: float
    high: float


def lever(reference: float, low: float, high: float) -> float:
    """Return the largest distance from a reference on a stroke, m."""
    return max(abs(end - reference) for end in (low, high))


class Lines(NamedTuple):
    """Lines of the displacements of an estimate; NaN for those known at one position only."""

    #: Shape (axes,): slope and half-width of its 95 % interval, m/m.
    slope: Array
    band: Array
    #: Shape (axes,): P0 and the ends of the stroke, m.
    reference: Array
    low: Array
    high: Array


def channels_of(axis: str) -> tuple[Channel, ...]:
    """Return the details of the line of an axis."""
    return tuple(Channel(f"{axis}_{name}", unit) for name, unit in DETAILS)


def channels_here(axis: str) -> tuple[Channel, ...]:
    """Return the details of a displacement at the present position."""
    return tuple(Channel(f"{axis}_{name}", unit) for name, unit in HERE)


def name_at(axis: str, position_mm: float) -> str:
    """Return the name of a displacement at a position, mm: ``x_at_-100``."""
    return f"{axis}_at_{position_mm:.9g}"


def channels_at(axis: str, positions: Array) -> tuple[Channel, ...]:
    """Return the details of a displacement at positions (m) of its moving axis."""
    return tuple(Channel(name_at(axis, at), "m") for at in (positions / MILLI).tolist())


def axis_of(axes: Sequence[str], name: str) -> str:
    """Return the axis of a displacement: of an axis, or at a position of one (`name_at`).

    Parameters
    ----------
    axes : sequence of str
        Of the displacement, without units.
    name : str
        One of them, or of a displacement at a position.
    """
    place = _PLACE.fullmatch(name)
    return name if name in axes or place is None else place[1]


def places_in(axes: Sequence[str], names: Sequence[str]) -> dict[str, int]:
    """Return the indices of the names that are displacements at positions, by name.

    Parameters
    ----------
    axes : sequence of str
        Of the displacement, without units.
    names : sequence of str
        Of details.
    """
    found = ((name, k, _PLACE.fullmatch(name)) for k, name in enumerate(names))
    return {name: k for name, k, place in found if place is not None and place[1] in axes}


def here(
    axes: Sequence[str], channels: Sequence[Channel], estimates: Sequence[Estimate]
) -> tuple[Array, Array]:
    """Return displacements at the present position, and their half-bands, m, (n, axes) each.

    Along an axis they differ from the displacement of the estimate, which is K0 at P0.

    Parameters
    ----------
    axes : sequence of str
        Of the displacement, with or without units.
    channels : sequence of Channel
        Details of the estimator.
    estimates : sequence of Estimate
    """
    moved = np.array([estimate.displacement for estimate in estimates])
    band = np.array([estimate.band for estimate in estimates])
    at = {channel: k for k, channel in enumerate(channels)}
    for c, axis in enumerate(axes):
        own = channels_here(axis_name(axis))
        if own[0] in at:
            there = np.array([estimate.details[[at[one] for one in own]] for estimate in estimates])
            moved[:, c], band[:, c] = there.T
    return moved, band


def lines_of(axes: Sequence[str], channels: Sequence[Channel], details: Array) -> Lines | None:
    """Return the lines among the details of an estimate; None if there are none.

    Parameters
    ----------
    axes : sequence of str
        Of the displacement, without units.
    channels : sequence of Channel
    details : ndarray, shape (channels,)
    """
    at = {channel: k for k, channel in enumerate(channels)}
    values = np.full((len(DETAILS), len(axes)), np.nan)
    for c, axis in enumerate(axes):
        own = channels_of(axis)
        if own[0] in at:
            values[:, c] = details[[at[channel] for channel in own]]
    return as_lines(values)


def as_lines(values: Array) -> Lines | None:
    """Return lines from values in the units of `DETAILS`, shape (5, axes); None if all are NaN."""
    if np.isnan(values[2]).all():
        return None
    return Lines(*values[:2], *(MILLI * values[2:]))
