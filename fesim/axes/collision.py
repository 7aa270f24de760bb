"""Pads of two axes on one guide, which must not cover the same place at one time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from fesim.case.history import History, common_knots
from fesim.case.schema import Case, step_count
from fesim.setup.parts import Parts, unit_direction
from meshes.pairing import FACING, PairedJoint
from meshes.travel import PARALLEL
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MILLI

#: Contact elements that cover each other by less than this fraction of their size are neighbours.
SLACK = 1e-3


def check_collisions(case: Case, parts: Parts, courses: Sequence[History]) -> None:
    """Refuse parallel axes whose pads cover the same part of a guide at one time of the march.

    Parameters
    ----------
    case, parts
        The case and its parts.
    courses : sequence of History
        Position of each axis, m.

    Raises
    ------
    InputError
        Pads of two axes are at one place at one time.
    """
    surfaces, joints = parts.structure.surfaces, parts.structure.joints
    end = case.march.step_s * step_count(case.march)
    course_of = dict(zip(case.axes, courses, strict=True))
    riding = [(joint, axis) for joint in parts.joints if (axis := case.joints[joint.name].axis)]
    for (one, axis), (other, another) in combinations(riding, 2):
        along, also = (unit_direction(case.axes[name]) for name in (axis, another))
        guide, also_guide = (surfaces[joints[joint.name][1]] for joint in (one, other))
        apart = not np.isin(guide, also_guide).any()
        if axis == another or apart or np.linalg.norm(np.cross(along, also)) > PARALLEL:
            continue
        knots = common_knots([course_of[axis], course_of[another]])
        times = np.append(knots[knots < end], end)
        first, second = (
            course_of[name](times) - MILLI * case.axes[name].mesh_position_mm
            for name in (axis, another)
        )
        # From knot to knot every value between is taken.
        moved = first - float(also @ along) * second
        low, high = np.minimum.accumulate(moved), np.maximum.accumulate(moved)
        met = np.zeros(len(times), dtype=bool)
        for least, most in _covering(one, other, along):
            met |= (low < most) & (high > least)
        if met.any():
            raise InputError(
                f"axes: by {times[np.argmax(met)]:.6g} s, the pads of joints {one.name!r} and "
                f"{other.name!r} cover the same part of their guide, where both would count; "
                f"correct the positions of axes {axis!r} and {another!r}"
            )


def _covering(one: PairedJoint, other: PairedJoint, along: Array) -> Array:
    """Return intervals (n, 2) of the displacement of `one`, m, at which it covers `other`.

    Each is that of two contact elements, taken as rectangles.
    """
    found = [np.empty((0, 2))]
    for e, normal in enumerate(one.normal):
        frame = np.stack([along, np.cross(normal, along), normal])
        (low, high), (lows, highs) = (_extent(joint, frame) for joint in (one, other))
        slack = SLACK * float(np.sqrt(one.area[e]))
        least, most = lows - high[e], highs - low[e]
        beside = (least[:, 1] < -slack) & (most[:, 1] > slack)
        level = (least[:, 2] < slack) & (most[:, 2] > -slack)
        alike = other.normal @ normal > np.cos(FACING)
        both = np.stack([least[:, 0] + slack, most[:, 0] - slack], axis=1)
        found.append(both[beside & level & alike])
    return np.unique(np.concatenate(found), axis=0)


def _extent(joint: PairedJoint, frame: Array) -> tuple[Array, Array]:
    """Lowest and highest coordinates (m, 3) of the contact elements of a joint in a frame, m."""
    places = np.concatenate(joint.pieces) @ frame.T
    counts = np.bincount(joint.piece_element, [len(piece) for piece in joint.pieces])
    starts = np.cumsum([0, *counts[:-1]]).astype(np.int64)
    return np.minimum.reduceat(places, starts), np.maximum.reduceat(places, starts)
