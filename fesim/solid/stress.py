"""Stress at points, from displacement and temperature: sigma = C (strain - alpha T)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skfem import CellBasis

from artefacts.arrays import Array
from fesim.solid.heat import by_cell
from fesim.solid.materials import Material
from fesim.solid.spaces import Spaces, local_coordinates, shape_values
from meshes.structure import Structure


def stress_at(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    displacement: Array,
    temperature: Array,
    points: Array,
    cells: NDArray[np.int64],
) -> Array:
    """Stress at points, with no smoothing: on a cell's boundary it is that of the named cell.

    sigma = lambda tr(e) I + 2 mu e - (3 lambda + 2 mu) alpha T I, with the strain e = sym grad u.

    Parameters
    ----------
    structure : Structure
        Mesh and bodies.
    spaces : Spaces
        Its spaces.
    materials : dict
        Body name to its material.
    displacement : ndarray, shape (3 n,)
        Unknown 3 i + c is direction c at node i, m (`fesim.solid.condensation.DisplacementField`).
    temperature : ndarray, shape (n_heat,)
        Above the temperature without thermal strain, K.
    points : ndarray, shape (3, k)
        Points, m.
    cells : ndarray of int, shape (k,)
        The cell each point lies in (`fesim.solid.spaces.probe_cells`).

    Returns
    -------
    ndarray, shape (k, 3, 3)
        Pa, tension positive.
    """
    local = local_coordinates(structure.mesh, points, cells)[:, :, None]
    elastic, heat = spaces.elastic, spaces.heat
    nodal = displacement.reshape(-1, 3)[elastic.element_dofs[:, cells]]
    gradient = np.einsum("fki,fjk->kij", nodal, _shape_gradients(elastic, local, cells))
    strain = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    rise = np.einsum(
        "fk,fk->k",
        temperature[heat.element_dofs[:, cells]],
        shape_values(heat.elem, heat, local, cells),
    )
    lam, mu, alpha = (
        by_cell(structure, values)[cells]
        for values in (
            {name: m.lame[0] for name, m in materials.items()},
            {name: m.lame[1] for name, m in materials.items()},
            {name: m.expansion for name, m in materials.items()},
        )
    )
    trace = np.trace(strain, axis1=1, axis2=2)
    even = lam * trace - (3.0 * lam + 2.0 * mu) * alpha * rise
    return 2.0 * mu[:, None, None] * strain + even[:, None, None] * np.eye(3)


def _shape_gradients(basis: CellBasis, local: Array, cells: NDArray[np.int64]) -> Array:
    """Gradients of the shape functions at local points (3, k, 1), shape (functions, 3, k)."""
    mapping = basis.mesh.mapping()
    return np.stack(
        [
            basis.elem.gbasis(mapping, local, i, tind=cells)[0].grad[:, :, 0]
            for i in range(basis.Nbfun)
        ]
    )
