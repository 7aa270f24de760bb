"""Pads of two axes on one guide, which must not cover the same place at one time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fesim.case.history import History, common_knots
from fesim.case.schema import Case, step_count
from fesim.setup.parts import Parts, unit_direction
from meshes.pairing import FACING, PairedJoint
from meshes.travel import PARALLEL
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MILLI

#: Contact elements that cover each other by less than this fraction of their size are neighbours.
SLACK = 1e-3


@dataclass(frozen=True, eq=False)
class Wanted:
    """Where axes are to be: during the march, and where results are requested besides."""

    #: Position of each axis in the march, m.
    courses: Sequence[History]
    #: Shape (k,) each: positions of each axis at which displacements are requested, m.
    asked: Sequence[Array]
    #: Shape (v, a): combinations of positions at which results are requested, m.
    volume: Array


@dataclass(frozen=True, eq=False)
class _Pair:
    """Joints of two parallel axes on one guide."""

    joints: tuple[str, str]
    #: Indices of the axes; positions in the mesh, m; whether both count in one direction.
    axes: tuple[int, int]
    zeros: tuple[float, float]
    side: float
    #: Shape (n, 2): intervals of `between` in which the pads of the joints cover each other, m.
    covering: Array

    def between(self, first: Array, second: Array) -> Array:
        """Displacement of the first axis from the second at their positions, m."""
        return first - self.zeros[0] - self.side * (second - self.zeros[1])

    def met(self, low: Array, high: Array) -> Flags:
        """Whether the pads cover each other somewhere between displacements, (k,) each, m."""
        found = np.zeros(low.shape, dtype=np.bool_)
        for least, most in self.covering:
            found |= (low < most) & (high > least)
        return found


def check_collisions(case: Case, parts: Parts, wanted: Wanted) -> None:
    """Refuse parallel axes whose pads cover the same part of a guide at one time.

    Results at a position of an axis are those with the others wherever they are in the march.

    Raises
    ------
    InputError
        Pads of two axes are at one place at one time, or would be where results are requested.
    """
    end = case.march.step_s * step_count(case.march)
    names = list(case.axes)
    for pair in _pairs(case, parts):
        both = "the pads of joints {!r} and {!r} cover the same part of their guide".format(
            *pair.joints
        )
        courses = [wanted.courses[at] for at in pair.axes]
        knots = common_knots(courses)
        times = np.append(knots[knots < end], end)
        first, second = (course(times) for course in courses)
        # From knot to knot every value between is taken.
        moved = pair.between(first, second)
        met = pair.met(np.minimum.accumulate(moved), np.maximum.accumulate(moved))
        if met.any():
            raise InputError(
                f"axes: by {times[np.argmax(met)]:.6g} s, {both}, where both would count; correct "
                f"the positions of axes {names[pair.axes[0]]!r} and {names[pair.axes[1]]!r}"
            )
        for k, (at, there) in enumerate(zip(pair.axes, (second, first), strict=True)):
            asked, ends = wanted.asked[at], np.array([there.min(), there.max()])
            places = (asked[:, None], ends)[:: 1 - 2 * k]
            moved = np.sort(pair.between(*places), axis=1)
            met = pair.met(*moved.T)
            if met.any():
                raise InputError(
                    f"axes.{names[at]}.asked_mm: at {asked[np.argmax(met)] / MILLI:g} mm, {both} "
                    "in the march; ask for positions that the other axis leaves free"
                )
        moved = pair.between(*wanted.volume[:, pair.axes].T)
        if (met := pair.met(moved, moved)).any():
            point = wanted.volume[np.argmax(met)] / MILLI
            shown = ", ".join(f"{name} = {x:g}" for name, x in zip(names, point, strict=True))
            raise InputError(f"volume: at {shown} mm, {both}; leave this point out")


def _pairs(case: Case, parts: Parts) -> Iterator[_Pair]:
    """Yield the joints of parallel axes on one guide, whose pads may meet."""
    surfaces, joints, names = parts.structure.surfaces, parts.structure.joints, list(case.axes)
    riding = [(joint, axis) for joint in parts.joints if (axis := case.joints[joint.name].axis)]
    for (one, axis), (other, another) in combinations(riding, 2):
        along, also = (unit_direction(case.axes[name]) for name in (axis, another))
        guide, also_guide = (surfaces[joints[joint.name][1]] for joint in (one, other))
        apart = not np.isin(guide, also_guide).any()
        if axis == another or apart or np.linalg.norm(np.cross(along, also)) > PARALLEL:
            continue
        first, second = (MILLI * case.axes[name].mesh_position_mm for name in (axis, another))
        yield _Pair(
            (one.name, other.name),
            (names.index(axis), names.index(another)),
            (first, second),
            float(also @ along),
            _covering(one, other, along),
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
