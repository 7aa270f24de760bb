"""Pads that move along a guide: where their contact elements lie on its surface.

The contact elements of a joint on an axis belong to its side a, the pads. At a position of the
axis each one covers a station of side b, the guide's surface. Contact elements that cover the same
place at different positions share a station.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from meshes.pairing import PairedJoint, pair_joint
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

#: Normals of the pads may turn towards the axis by this, rad.
PARALLEL = 1e-3
#: Contact elements that differ by less than this share of their size at two positions are equal.
SAME = 1e-5


@dataclass(frozen=True)
class Stations:
    """Places on guides that contact elements cover: n stations, quadrature points on them."""

    #: Shape (3, nq): m.
    points: Array
    #: Shape (nq,): the cell of the guide behind each point.
    cells: NDArray[np.int64]
    #: Shape (nq,): of each point.
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
    """What moves along an axis."""

    #: Its name.
    axis: str
    #: The bodies that move, those included that are carried along.
    bodies: Sequence[str]
    #: Joints that ride on the axis to `along` and `across` of `pair_joint`.
    divided: dict[str, tuple[int | None, int | None]]
    #: Shape (k, 3): from where the mesh shows the bodies, m.
    shifts: Array


def sliding(joint: PairedJoint, direction: Array) -> PairedJoint:
    """Return a joint whose sides move freely along a direction: its first tangent is zero.

    Parameters
    ----------
    joint : PairedJoint
        Its side a are the pads.
    direction : ndarray, shape (3,)
        Unit vector.

    Raises
    ------
    InputError
        Its surface is not parallel to the direction.
    """
    across = np.cross(joint.normal, direction)
    if float(np.abs(joint.normal @ direction).max()) > PARALLEL:
        raise InputError(
            f"joints.{joint.name}: its surface is not parallel to the direction of its axis; "
            "correct the direction, or make the end face a joint of its own"
        )
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return replace(joint, tangents=np.stack([np.zeros_like(across), across], axis=1))


def shifted(structure: Structure, bodies: Sequence[str], shift: Array) -> Structure:
    """Return a structure with some bodies moved by `shift` (3,), m; without probes.

    Raises
    ------
    InputError
        A body shares nodes with one that does not move.
    """
    mesh = structure.mesh
    moving = np.concatenate([structure.body(name, "axes") for name in bodies])
    nodes = mesh.dofs.element_dofs if mesh.doflocs.shape[1] > mesh.p.shape[1] else mesh.t
    moved = np.unique(nodes[:, moving])
    if np.isin(np.delete(nodes, moving, axis=1), moved).any():
        raise InputError(
            f"axes: bodies {', '.join(map(repr, bodies))} share nodes with others; separate them "
            "by a joint, or let them move together"
        )
    points = mesh.doflocs.copy()
    points[:, moved] += shift[:, None]
    return replace(structure, mesh=replace(mesh, doflocs=points), probes={})


def stations_of(
    structure: Structure, joints: Sequence[PairedJoint], travels: Sequence[Travel]
) -> Stations:
    """Find the stations that contact elements cover at some positions of each axis.

    What a contact element covers depends on its own axis alone: the other axes move both of its
    sides, or none.

    Parameters
    ----------
    structure : Structure
        As meshed.
    joints : sequence of PairedJoint
        All joints as meshed, in the order of the contact elements.
    travels : sequence of Travel
        Of each axis.

    Raises
    ------
    InputError
        Pads leave the guide; side a of a joint does not move or its side b does; or an axis moves
        one side of a joint that does not ride on it.
    """
    starts = np.cumsum([0, *(joint.area.size for joint in joints)])
    known: dict[tuple[object, ...], int] = {}
    points, cells, stations, shares = [], [], [], []
    elements: list[int] = []
    places = []
    for travel in travels:
        moving = np.concatenate([structure.body(name, "axes") for name in travel.bodies])
        for joint in joints:
            _check_sides(joint, moving, travel)
        place = np.full((len(travel.shifts), starts[-1]), -1)
        places.append(place)
        for row, shift in zip(place, travel.shifts, strict=True):
            there = shifted(structure, travel.bodies, shift)
            for joint, start in zip(joints, starts, strict=False):
                if joint.name not in travel.divided:
                    continue
                now = _same_elements(there, joint, travel.divided[joint.name], shift)
                low, high = _extent(now)
                size = np.sqrt(now.area.min())
                for e in range(now.area.size):
                    ends = np.concatenate([low[e], high[e]])
                    key = (joint.name, *np.round(ends / (SAME * size)), *np.round(now.normal[e], 4))
                    row[start + e] = known.setdefault(key, len(known))
                    if row[start + e] == len(elements):
                        own = now.element == e
                        points.append(now.points_b[:, own])
                        cells.append(now.cells_b[own])
                        stations.append(np.full(int(own.sum()), len(elements)))
                        shares.append(now.weights[own] / now.area[e])
                        elements.append(start + e)
    return Stations(
        np.hstack(points),
        np.concatenate(cells),
        np.concatenate(stations),
        np.concatenate(shares),
        np.array(elements),
        tuple(places),
    )


def _same_elements(
    there: Structure, joint: PairedJoint, divided: tuple[int | None, int | None], shift: Array
) -> PairedJoint:
    """The joint where the bodies have moved by `shift`, with the same contact elements."""
    try:
        now = pair_joint(there, joint.name, *divided)
    except InputError as error:
        raise _left(joint, shift) from error
    size = float(np.sqrt(joint.area.min()))
    if now.area.size != joint.area.size:
        raise _left(joint, shift)
    off = np.abs(now.centre - joint.centre - shift).max() / size
    if max(off, float(np.abs(now.area / joint.area - 1.0).max())) > SAME:
        raise _left(joint, shift)
    return now


def _left(joint: PairedJoint, shift: Array) -> InputError:
    return InputError(
        f"axes: the pads of joint {joint.name!r} leave the guide "
        f"{1e3 * float(np.linalg.norm(shift)):.6g} mm from where the mesh shows them; shorten "
        "stroke_mm, or correct mesh_position_mm or the guide"
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


def _extent(joint: PairedJoint) -> tuple[Array, Array]:
    """Lowest and highest coordinates (m, 3) of each contact element."""
    low, high = np.full(joint.centre.shape, np.inf), np.full(joint.centre.shape, -np.inf)
    for piece, e in zip(joint.pieces, joint.piece_element, strict=True):
        low[e] = np.minimum(low[e], piece.min(axis=0))
        high[e] = np.maximum(high[e], piece.max(axis=0))
    return low, high
