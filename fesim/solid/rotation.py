"""Rotation of a body at a point: that of the rigid motion that best fits the nodes around it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from fesim.solid.spaces import Spaces, cells_around
from meshes.structure import Probe, Structure
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MILLI

#: Smallest over largest moment of inertia below which nodes are on a line and miss a rotation.
ON_A_LINE = 1e-6
#: Nodes farther than the radius by this fraction of it are at the radius, but for rounding.
ROUNDING = 1e-9


def rotation_rows(structure: Structure, spaces: Spaces, name: str, radius: float) -> csr_array:
    """Return rows (3, n) of the rotation about x, y and z at a probe, rad per m.

    From u_i = a + w x r_i, with r_i from the nodes' centre, least squares give
    w = J^-1 sum r_i x u_i, J = sum (r_i . r_i I - r_i r_i^T).

    Parameters
    ----------
    structure : Structure
        Structure with the probe.
    spaces : Spaces
        Its displacement space.
    name : str
        Name of the probe.
    radius : float
        Distance within which nodes of the probe's body are used, m.

    Raises
    ------
    InputError
        The nodes within this distance lie on a line.
    """
    probe = structure.probes[name]
    at, basis = np.array(probe.position), spaces.displacement
    nodes = np.unique(basis.element_dofs[:, _own_cells(structure, probe)])
    reach = (1.0 + ROUNDING) * radius
    near = nodes[np.linalg.norm(basis.doflocs[:, nodes].T - at, axis=1) <= reach]
    arms = basis.doflocs[:, near].T - basis.doflocs[:, near].mean(axis=1)
    inertia = (arms**2).sum() * np.eye(3) - arms.T @ arms
    sizes = np.linalg.eigvalsh(inertia)
    if near.size < 3 or sizes[0] <= ON_A_LINE * sizes[-1]:
        raise InputError(
            f"rotation at {name!r}: {near.size} nodes within {radius / MILLI:g} mm of it lie on a "
            "line and show none; take a larger radius"
        )
    # r x u as a matrix on u.
    zero = np.zeros(near.size)
    x, y, z = arms.T
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]])
    values = np.einsum("ij,jkn->ikn", np.linalg.inv(inertia), cross)
    columns = np.broadcast_to(3 * near.astype(np.int64) + np.arange(3)[:, None], values.shape)
    rows = np.broadcast_to(np.arange(3)[:, None, None], values.shape)
    shape = (3, spaces.displacement_size)
    return csr_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


def _own_cells(structure: Structure, probe: Probe) -> np.ndarray:
    """Cells of the body of a probe."""
    if probe.body is not None:
        return structure.bodies[probe.body]
    around = cells_around(structure, probe)
    own = [cells for cells in structure.bodies.values() if np.isin(around, cells).any()]
    return np.concatenate(own)
