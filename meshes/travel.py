"""Pads that move along a guide: positions of their contact elements on its surface.

The contact elements of a joint on an axis belong to its side a, the pads. At a position of the axis
each one covers a station of side b, the guide's surface. Contact elements that cover the same place
at different positions share a station, also those of different joints on one guide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from skfem import Mesh

from meshes.covered import area_by_facet, area_of_both, areas_of_joints
from meshes.pairing import Covered, Movable, PairedJoint, movable_joint
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

#: Largest angle between the pads' surface and the axis, rad.
PARALLEL = 1e-3
#: Places that differ by less than this fraction of the size of a contact element are equal.
SAME = 1e-5


@dataclass(frozen=True)
class Stations:
    """Places on guides covered by contact elements: n stations, quadrature points on them."""

    #: Shape (3, nq): quadrature points, m.
    points: Array
    #: Shape (nq,): cell of the guide behind each point.
    cells: NDArray[np.int64]
    #: Shape (nq,): station of each point.
    station: NDArray[np.int64]
    #: Shape (nq,): area weights; they add up to one at every station.
    share: Array
    #: Shape (n,): a contact element that covers the station, with its normal and tangents.
    element: NDArray[np.int64]
    #: Shape (k, m): for every axis: station of each of m contact elements at each of its k
    #: positions; -1 if it rides on another axis, or on none.
    place: tuple[NDArray[np.int64], ...]


@dataclass(frozen=True)
class Travel:
    """Motion along an axis."""

    #: Name of the axis.
    axis: str
    #: Moving bodies, including those carried along.
    bodies: Sequence[str]
    #: From joints on the axis to `along` and `across` of `pair_joint`.
    divided: dict[str, tuple[int | None, int | None]]
    #: Shape (k, 3): displacements from the positions in the mesh, m.
    shifts: Array


def sliding(joint: PairedJoint, direction: Array) -> PairedJoint:
    """Return a joint whose sides move freely along a direction: its first tangent is zero.

    Parameters
    ----------
    joint : PairedJoint
        Joint whose side a are the pads.
    direction : ndarray, shape (3,)
        Unit vector.

    Raises
    ------
    InputError
        The surface of the joint is not parallel to the direction.
    """
    across = np.cross(joint.normal, direction)
    if float(np.abs(joint.normal @ direction).max()) > PARALLEL:
        raise InputError(
            f"joints.{joint.name}: its surface is not parallel to the direction of its axis; "
            "correct the direction, or make the end face a joint of its own"
        )
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return replace(joint, tangents=np.stack([np.zeros_like(across), across], axis=1))


def stations_of(
    structure: Structure, joints: Sequence[PairedJoint], travels: Sequence[Travel]
) -> Stations:
    """Find the stations covered by contact elements at some positions of each axis.

    They depend only on the axis of the contact element: the other axes move both of its sides, or
    neither.

    Parameters
    ----------
    structure : Structure
        Structure as meshed.
    joints : sequence of PairedJoint
        All joints as meshed, in the order of the contact elements.
    travels : sequence of Travel
        Motion along each axis.

    Raises
    ------
    InputError
        Pads leave the guide, or cover what another joint that stands there covers; side a of a
        joint does not move or its side b does; or an axis moves one side of a joint that is not on
        it.
    """
    starts = np.cumsum([0, *(joint.area.size for joint in joints)])
    unit = SAME * min(float(np.sqrt(joint.area.min())) for joint in joints)
    known: dict[tuple[object, ...], int] = {}
    found: list[Covered] = []
    elements: list[int] = []
    places = []
    mesh, riders = structure.mesh, {name for travel in travels for name in travel.divided}
    standing = areas_of_joints(mesh, (joint for joint in joints if joint.name not in riders))
    for travel in travels:
        moving = np.concatenate([structure.body(name, "axes") for name in travel.bodies])
        _check_apart(structure, moving, travel)
        for joint in joints:
            _check_sides(joint, moving, travel)
        riding = [
            _Riding(
                joint,
                movable_joint(structure, joint, *travel.divided[joint.name]),
                int(start),
                (travel.axis, structure.joints[joint.name][1]),
            )
            for joint, start in zip(joints, starts, strict=False)
            if joint.name in travel.divided
        ]
        place = np.full((len(travel.shifts), starts[-1]), -1)
        places.append(place)
        for row, shift in zip(place, travel.shifts, strict=True):
            for rides in riding:
                for e, key in enumerate(rides.keys(shift, unit)):
                    # Known stations were found at another position, or by another element.
                    row[rides.start + e] = known.setdefault(key, len(known))
                    if row[rides.start + e] == len(found):
                        found.append(_covered(rides, e, shift))
                        elements.append(rides.start + e)
                under = row[rides.start : rides.start + rides.joint.area.size]
                _check_free(mesh, rides.joint, [found[k] for k in under], standing, shift)
    return Stations(
        np.hstack([one.points for one in found]),
        mesh.f2t[0, np.concatenate([one.facets for one in found])],
        np.repeat(np.arange(len(found)), [one.weights.size for one in found]),
        np.concatenate([one.weights / one.weights.sum() for one in found]),
        np.array(elements),
        tuple(places),
    )


@dataclass(frozen=True, eq=False)
class _Riding:
    """A joint on an axis."""

    #: Joint as meshed.
    joint: PairedJoint
    #: The same joint, to be moved.
    movable: Movable
    #: Index of its first contact element.
    start: int
    #: Its axis and the surface of its guide.
    guide: tuple[str, str]

    @cached_property
    def marks(self) -> Array:
        """Centroid, lowest and highest coordinates (m, 9) of each contact element, as meshed, m."""
        low = np.full(self.joint.centre.shape, np.inf)
        high = -low
        for piece, e in zip(self.joint.pieces, self.joint.piece_element, strict=True):
            low[e] = np.minimum(low[e], piece.min(axis=0))
            high[e] = np.maximum(high[e], piece.max(axis=0))
        return np.hstack([self.joint.centre, low, high])

    @cached_property
    def size(self) -> float:
        """Size of the smallest contact element, m."""
        return float(np.sqrt(self.joint.area.min()))

    def keys(self, shift: Array, unit: float) -> list[tuple[object, ...]]:
        """Return keys that distinguish the places of its contact elements.

        They are moved by a shift (3,), m; places that differ by less than `unit`, m, are equal.
        """
        marks = np.round((self.marks + np.tile(shift, 3)) / unit)
        normals = np.round(self.joint.normal, 4)
        return [(*self.guide, *one) for one in np.hstack([marks, normals]).tolist()]


def _covered(rides: _Riding, e: int, shift: Array) -> Covered:
    """Part covered by a contact element with moved pads, of the same extent as in the mesh."""
    joint, now = rides.joint, rides.movable.covered(e, shift)
    if now is None:
        raise _left(joint, shift)
    off = np.abs(now.centre - joint.centre[e] - shift).max() / rides.size
    if max(off, abs(now.weights.sum() / joint.area[e] - 1.0)) > SAME:
        raise _left(joint, shift)
    return now


def _left(joint: PairedJoint, shift: Array) -> InputError:
    return InputError(
        f"axes: the pads of joint {joint.name!r} leave the guide "
        f"{1e3 * float(np.linalg.norm(shift)):.6g} mm from where the mesh shows them; shorten "
        "stroke_mm, or correct mesh_position_mm or the guide"
    )


def _check_free(
    mesh: Mesh,
    joint: PairedJoint,
    under: Sequence[Covered],
    standing: Mapping[str, Array],
    shift: Array,
) -> None:
    """Refuse pads that cover, at a position, what a joint that stands on their guide covers."""
    if not standing:
        return
    facets = np.concatenate([one.facets for one in under])
    own = area_by_facet(mesh, facets, np.concatenate([one.weights for one in under]))
    for name, area in standing.items():
        if (both := area_of_both(mesh, own, area)) > 0.0:
            raise InputError(
                f"axes: {1e3 * float(np.linalg.norm(shift)):.6g} mm from where the mesh shows "
                f"them, the pads of joint {joint.name!r} cover {1e4 * both:.4g} cm2 of joint "
                f"{name!r}, where both would count; shorten stroke_mm, or correct the joints"
            )


def _check_apart(structure: Structure, moving: NDArray[np.int64], travel: Travel) -> None:
    mesh = structure.mesh
    nodes = mesh.dofs.element_dofs if mesh.doflocs.shape[1] > mesh.p.shape[1] else mesh.t
    if np.isin(np.delete(nodes, moving, axis=1), nodes[:, moving]).any():
        raise InputError(
            f"axes: bodies {', '.join(map(repr, travel.bodies))} share nodes with others; separate "
            "them by a joint, or let them move together"
        )


def _check_sides(joint: PairedJoint, moving: NDArray[np.int64], travel: Travel) -> None:
    rides = joint.name in travel.divided
    pads, guide = (np.isin(cells, moving) for cells in (joint.cells_a, joint.cells_b))
    if rides and (not pads.all() or guide.any()):
        raise InputError(
            f"joints.{joint.name}: its side a must be the pads, on bodies that move, and its side "
            "b the guide, on bodies that do not; exchange side_a and side_b, or correct "
            "axes.bodies"
        )
    if not rides and (pads != guide).any():
        raise InputError(
            f"joints.{joint.name}: axis {travel.axis!r} moves one of its sides and not the other; "
            f"let it ride on the axis, or add what is carried to axes.{travel.axis}.bodies"
        )
