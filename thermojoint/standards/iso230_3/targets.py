"""Places where a response is read: its axis positions, or the two targets of a moving axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

if TYPE_CHECKING:
    import xarray as xr


class Reading(NamedTuple):
    """Displacement and rotation at one place."""

    #: Suffix of its channels: nothing, ``P1`` or ``P2``.
    mark: str
    #: Shape (n, axes): m.
    displacement: Array
    #: Shape (n, axes): rad; None if the response has none.
    rotation: Array | None


def read_at(response: xr.Dataset) -> list[Reading]:
    """Return the readings of a response.

    If one axis moves, these are the readings at its two targets: the lowest and the highest
    requested position of its case, each as if the axis stood there. Otherwise they are the
    displacements of the response.

    Raises
    ------
    InputError
        Several axes move.
    """
    rotation = _values(response, "rotation")
    here = [Reading("", response["displacement"].to_numpy().astype(float), rotation)]
    if "axis_position" not in response:
        return here
    # A whole cycle within every step leaves the position at its samples where it was.
    moving = np.flatnonzero(np.ptp(response["axis_way"].to_numpy(), axis=0))
    if moving.size > 1:
        names = ", ".join(str(response["moving_axis"].to_numpy()[k]) for k in moving)
        raise InputError(f"response: {names} move; a test moves one axis, let the others stand")
    if not moving.size:
        return here
    asked = response["asked_position"].to_numpy()[moving[0]]
    turned = _values(response, "asked_rotation")
    return [
        Reading(
            mark,
            response["asked_displacement"].to_numpy()[:, moving[0], at],
            None if turned is None else turned[:, moving[0], at],
        )
        for mark, at in (("P1", asked.argmin()), ("P2", asked.argmax()))
    ]


def _values(response: xr.Dataset, name: str) -> Array | None:
    return response[name].to_numpy().astype(float) if name in response else None


def driven(response: xr.Dataset) -> Array:
    """Return a signal that is 0 at standstill: sum of heat input and travel of the axes."""
    drive: Array = np.abs(response["heat_input"].to_numpy().astype(float))
    if "axis_position" not in response:
        return drive
    way = np.diff(response["axis_way"].to_numpy(), axis=0).sum(axis=1)
    return drive + np.concatenate([[0.0], way])
