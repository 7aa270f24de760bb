"""Rows of pads and of the stations of their guide, separately."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, vstack
from skfem import CellBasis

from fesim.solid.joint_operators import JointOperators, directed, frames_of, side_means
from fesim.solid.spaces import Spaces, interpolation
from meshes.pairing import PairedJoint
from meshes.travel import Stations


@dataclass(frozen=True)
class GuidedOperators:
    """Joints, some of which move along a guide: m contact elements, n stations."""

    #: Both sides of the joints that do not move along a guide, only side a of the others.
    pads: JointOperators
    #: Shape (n, n_heat): mean temperature of each station.
    heat: csr_array
    #: Shape (3 n, n_displacement): mean displacement of each station along the normal and the
    #: tangents of a contact element.
    gap: csr_array
    #: Shape (k, m): of every axis: station of each contact element at each aligned position; -1 for
    #: none.
    place: tuple[NDArray[np.int64], ...]


def guided_operators(
    joints: Sequence[PairedJoint], stations: Stations, spaces: Spaces
) -> GuidedOperators:
    """Assemble the rows of pads and stations for all joints in their order."""
    gap = directed(_means(stations, spaces.displacement), frames_of(joints)[stations.element])
    gap.eliminate_zeros()
    return GuidedOperators(
        _pads(joints, places_at(stations.place, (0,) * len(stations.place)) >= 0, spaces),
        _means(stations, spaces.heat),
        gap,
        stations.place,
    )


def _pads(
    joints: Sequence[PairedJoint], riding: NDArray[np.bool_], spaces: Spaces
) -> JointOperators:
    facing = diags_array((~riding).astype(float))
    heat_a, heat_b, side_a, side_b = (
        csr_array(vstack([side_means(joint, basis)[side] for joint in joints], format="csr"))
        for basis in (spaces.heat, spaces.displacement)
        for side in (0, 1)
    )
    gap = directed(csr_array(facing @ side_b - side_a), frames_of(joints))
    gap.eliminate_zeros()  # rows without entries are not solved for
    return JointOperators(
        csr_array(heat_a - facing @ heat_b),
        gap,
        np.concatenate([joint.area for joint in joints]),
        csr_array(0.5 * (heat_a + facing @ heat_b)),
    )


def _means(stations: Stations, basis: CellBasis) -> csr_array:
    """Mean over each station as rows on scalar unknowns."""
    return interpolation(
        basis,
        stations.points,
        stations.cells,
        stations.station,
        stations.share,
        stations.element.size,
    )


def places_at(place: Sequence[NDArray[np.int64]], corner: Sequence[int]) -> NDArray[np.int64]:
    """Return the station (m,) of each contact element, -1 for none, at aligned positions.

    Parameters
    ----------
    place : sequence of ndarray of int, shape (k, m)
        As in `GuidedOperators`: a contact element rides on one axis at most.
    corner : sequence of int
        Index of the aligned position of each axis.
    """
    rows = [one[at] for one, at in zip(place, corner, strict=True)]
    return np.asarray(np.maximum.reduce(rows))


def coupled(
    places: Sequence[NDArray[np.int64]], corner: Sequence[int], stations: int, others: int
) -> csr_array:
    """Return the ties at aligned positions as combinations of the rows condensed apart.

    Parameters
    ----------
    places : sequence of ndarray of int, shape (k, m)
        As in `GuidedOperators`.
    corner : sequence of int
        Index of the aligned position of each axis.
    stations : int
        n.
    others : int
        Number of further rows, which remain unchanged.

    Returns
    -------
    scipy.sparse.csr_array, shape (3 m + others, 3 m + 3 n + others)
        Columns: the rows of the pads, those of the stations, then the others.
    """
    place = places_at(places, corner)
    count = place.size
    own = np.concatenate([np.arange(3 * count), 3 * count + np.arange(others)])
    columns = np.concatenate([np.arange(3 * count), 3 * (count + stations) + np.arange(others)])
    riding = np.flatnonzero(place >= 0)
    tied = np.concatenate([k * count + riding for k in range(3)])
    under = np.concatenate([3 * count + k * stations + place[riding] for k in range(3)])
    entries = np.ones(own.size + tied.size)
    shape = (3 * count + others, 3 * (count + stations) + others)
    return csr_array(
        (entries, (np.concatenate([own, tied]), np.concatenate([columns, under]))), shape=shape
    )
