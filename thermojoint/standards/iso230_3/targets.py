"""Where a response is read: where its axes stand, or at the two targets of the axis that moves."""

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

    While one axis moves, those at its two targets: the lowest and the highest position that its
    case asks about, each as if the axis stood there. Otherwise those of the response.

    Raises
    ------
    InputError
        Several axes move.
    """
    rotation = _values(response, "rotation")
    here = [Reading("", response["displacement"].to_numpy().astype(float), rotation)]
    if "axis_position" not in response:
        return here
    moving = np.flatnonzero(np.ptp(response["axis_position"].to_numpy(), axis=0))
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
    """Return what is 0 where nothing runs: heat input, heat of running friction, way of the axes.

    An axis that moves to and fro within a step ends it where it was; its friction is told then.
    """
    drive: Array = np.abs(response["heat_input"].to_numpy().astype(float))
    if "axis_position" not in response:
        return drive
    way = np.abs(np.diff(response["axis_position"].to_numpy(), axis=0)).sum(axis=1)
    return drive + response["running_heat"].to_numpy().sum(axis=1) + np.concatenate([[0.0], way])
