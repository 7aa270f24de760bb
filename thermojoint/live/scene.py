"""The machine in 3-D for the dashboard: its shape once, then the fields of the newest state."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.interface import Estimator
from estimator.joint_aware.estimator import JointAware
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MEGA
from thermojoint.live.surface import Surface, pressures, read_surface, temperatures

#: Viewpoint in sizes of the machine; for a joint its distance in front, and its height above.
EYE = np.array([1.5, 1.5, 0.9])
FRONT, ABOVE = 2.0, 0.5


class Scene(NamedTuple):
    """A machine in 3-D."""

    #: Points, triangles and contact elements, ready for JSON.
    shape: dict[str, Any]
    #: Returns temperatures and pressures of the newest state, ready for JSON; None without any.
    fields: Callable[[], dict[str, Any] | None]


def scene_of(path: Path, estimator: Estimator, state: Callable[[], Array]) -> Scene:
    """Return the scene of a joint-aware estimator, whose newest state `state` returns.

    The path is that of the surface of its model, written by 'thermojoint scene'.

    Raises
    ------
    InputError
        The file is unusable or of another model, or the estimator is of another kind.
    """
    if not isinstance(estimator, JointAware):
        raise InputError(
            f"{path}: a scene is of a joint-aware model, this one is {estimator.kind}; leave it out"
        )
    surface = read_surface(path, estimator.model)

    def fields() -> dict[str, Any] | None:
        now = state()
        if not np.isfinite(now[0]):
            return None
        return {
            "time_s": float(now[0]),
            "temperature_K": np.round(temperatures(surface, estimator, now), 3).tolist(),
            "pressure_MPa": np.round(pressures(surface, estimator, now) / MEGA, 4).tolist(),
        }

    return Scene(shape_of(surface), fields)


def shape_of(surface: Surface) -> dict[str, Any]:
    """Return the constant part of a scene, rotated so that z is up, as in the browser."""
    turn = upright(surface.up)
    contacts = surface.contact_points @ turn.T
    return {
        "surface": _mesh(surface.points @ turn.T, surface.triangles, "vertex", EYE),
        "joints": _mesh(
            contacts,
            surface.contact_triangles,
            "cell",
            front_of(contacts, surface.contact_triangles),
        ),
    }


def front_of(points: Array, triangles: NDArray[np.int64]) -> Array:
    """Return the viewpoint from which most of some triangles are visible, shape (3,), or `EYE`."""
    first, second, third = (points[triangles[:, k]] for k in range(3))
    areas = np.cross(second - first, third - first)
    normal = areas.sum(axis=0)
    size, whole = float(np.linalg.norm(normal)), float(np.linalg.norm(areas, axis=1).sum())
    if not size > 0.5 * whole:
        return EYE
    return FRONT * normal / size + np.array([0.0, 0.0, ABOVE])


def upright(up: Array) -> Array:
    """Return the rotation by right angles, shape (3, 3), that makes an axis `up` the third one."""
    axis = int(np.argmax(np.abs(up)))
    turn = np.roll(np.eye(3), -(axis + 1), axis=0)
    # Upside down: the first two axes are swapped to keep a proper rotation.
    return turn if up[axis] > 0.0 else np.array([turn[1], turn[0], -turn[2]])


def _mesh(points: Array, triangles: NDArray[np.int64], per: str, eye: Array) -> dict[str, Any]:
    return {
        "eye": dict(zip("xyz", np.round(eye, 3).tolist(), strict=True)),
        "points_m": np.round(points.T, 5).tolist(),
        "triangles": triangles.T.tolist(),
        "per": per,
    }
