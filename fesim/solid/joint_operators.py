"""Integral operators of the joints: mean temperature jump B and mean relative displacement G.

Both are averages over contact elements, so the meshes of the two sides need not match.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack
from skfem import CellBasis

from fesim.solid.spaces import Spaces, interpolation
from meshes.pairing import PairedJoint


@dataclass(frozen=True)
class JointOperators:
    """All contact elements of all joints, m in number, one after another."""

    #: Shape (m, n_heat): B: mean temperature of side a minus that of side b.
    jump: csr_array
    #: Shape (3 m, n): G: mean displacement of side b minus that of side a: m openings, then m
    #: relative displacements along the first tangent, then along the second.
    gap: csr_array
    #: Shape (m,): area of each contact element, m2.
    area: NDArray[np.float64]
    #: Shape (m, n_heat): mean temperature of both sides.
    mean: csr_array


def joint_operators(joints: Sequence[PairedJoint], spaces: Spaces) -> JointOperators:
    """Assemble B and G for the paired `joints`."""
    if not joints:
        nothing = csr_array((0, spaces.heat.N))
        none_moves = csr_array((0, spaces.displacement_size))
        return JointOperators(nothing, none_moves, np.empty(0), nothing)
    area = np.concatenate([joint.area for joint in joints])
    sides = [side_means(joint, spaces.heat) for joint in joints]
    mean = vstack([0.5 * (side_a + side_b) for side_a, side_b in sides], format="csr")
    gap = directed(-jumps(joints, spaces.displacement), frames_of(joints))
    return JointOperators(jumps(joints, spaces.heat), gap, area, csr_array(mean))


def jumps(joints: Sequence[PairedJoint], basis: CellBasis) -> csr_array:
    """Return rows (m, n) of the mean of a scalar on side a of each element minus that on side b."""
    if not joints:
        return csr_array((0, basis.N))
    sides = [side_means(joint, basis) for joint in joints]
    return csr_array(vstack([side_a - side_b for side_a, side_b in sides], format="csr"))


def frames_of(joints: Sequence[PairedJoint]) -> NDArray[np.float64]:
    """Return normal and tangents of all contact elements, shape (m, 3, 3)."""
    return np.concatenate([np.hstack([j.normal[:, None], j.tangents]) for j in joints])


def directed(means: csr_array, frames: NDArray[np.float64]) -> csr_array:
    """Return the components of m mean displacements, shape (3 m, n).

    Parameters
    ----------
    means : scipy.sparse.csr_array, shape (m, n / 3)
        Rows of the means on the unknowns of one displacement component.
    frames : ndarray, shape (m, 3, 3)
        Normal and tangents as rows.

    Returns
    -------
    scipy.sparse.csr_array
        m normal components, then m along the first tangent, then along the second.
    """
    rows = [_along(means, frames[:, k]) for k in range(3)]
    return csr_array(vstack(rows, format="csr"))


def side_means(joint: PairedJoint, basis: CellBasis) -> tuple[csr_array, csr_array]:
    """Return rows of the means over each contact element on side a and on side b."""
    weights = joint.weights / joint.area[joint.element]
    count = len(joint.area)
    side_a = interpolation(basis, joint.points_a, joint.cells_a, joint.element, weights, count)
    side_b = interpolation(basis, joint.points_b, joint.cells_b, joint.element, weights, count)
    return side_a, side_b


def _along(scalar_rows: csr_array, direction: NDArray[np.float64]) -> csr_array:
    """Rows on interleaved displacement unknowns: the component along each row's `direction`."""
    rows = scalar_rows.tocoo()
    columns = np.concatenate([3 * rows.col.astype(np.int64) + i for i in range(3)])
    values = np.concatenate([rows.data * component for component in direction[rows.row].T])
    shape = (rows.shape[0], 3 * rows.shape[1])
    return csr_array((values, (np.tile(rows.row, 3), columns)), shape=shape)
