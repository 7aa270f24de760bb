"""Stress at points, from displacement and temperature: sigma = C (strain - alpha T)."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from skfem import CellBasis

from fesim.solid.element_matrices import reference_shapes
from fesim.solid.materials import Material, elastic_constants
from fesim.solid.spaces import Spaces, local_coordinates, shape_values
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array

#: The stresses of a point in the order of their rows, as pairs of directions.
COMPONENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


def stress_at(rows: tuple[csr_array, csr_array], displacement: Array, temperature: Array) -> Array:
    """Stress at k points.

    Parameters
    ----------
    rows : tuple of scipy.sparse.csr_array
        Rows of the points, from `stress_rows`.
    displacement : ndarray, shape (3 n,)
        Unknown 3 i + c is direction c at node i, m (`fesim.solid.condensation.DisplacementField`).
    temperature : ndarray, shape (n_heat,)
        Temperatures above that without thermal strain, K.

    Returns
    -------
    ndarray, shape (k, 3, 3)
        Stresses, Pa, tension positive.
    """
    moved, heated = rows
    return stress_tensors((moved @ displacement + heated @ temperature).reshape(-1, 6))


def stress_rows(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    points: Array,
    cells: NDArray[np.int64],
) -> tuple[csr_array, csr_array]:
    """Rows of stresses without smoothing: on a cell boundary, those of the given cell.

    sigma = lambda tr(e) I + 2 mu e - (3 lambda + 2 mu) alpha T I, with the strain e = sym grad u.

    Parameters
    ----------
    structure : Structure
        Mesh and bodies.
    spaces : Spaces
        Its spaces.
    materials : dict
        Body name to its material.
    points : ndarray, shape (3, k)
        Points, m.
    cells : ndarray of int, shape (k,)
        Cell of each point (`fesim.solid.spaces.probe_cells`).

    Returns
    -------
    tuple of scipy.sparse.csr_array, shapes (6 k, 3 n) and (6 k, n_heat)
        Pa/m on displacements and Pa/K on temperatures; `COMPONENTS` point by point.
    """
    local = local_coordinates(structure.mesh, points, cells)[:, :, None]
    elastic, heat = spaces.displacement, spaces.heat
    lam, mu, bulk = (each[cells] for each in elastic_constants(structure, materials))
    slopes = _shape_gradients(elastic, local, cells)
    count, points_count = slopes.shape[0], len(cells)
    moved = np.zeros((points_count, 6, count, 3))
    heated = np.zeros((points_count, 6, heat.element_dofs.shape[0]))
    shapes = shape_values(heat, local)
    for row, (i, j) in enumerate(COMPONENTS):
        moved[:, row, :, i] += (mu * slopes[:, j]).T
        moved[:, row, :, j] += (mu * slopes[:, i]).T
        if i == j:
            moved[:, row] += (lam * slopes).transpose(2, 0, 1)
            heated[:, row] = -(bulk * shapes).T
    unknowns = 3 * elastic.element_dofs[:, cells].T[:, :, None] + np.arange(3)
    return (
        _rows(moved.reshape(points_count, 6, -1), unknowns, spaces.displacement_size),
        _rows(heated, heat.element_dofs[:, cells].T, int(heat.N)),
    )


def _rows(values: Array, unknowns: NDArray[np.int64], size: int) -> csr_array:
    """Rows (6 k, size) of values (k, 6, u) at unknowns (k, u)."""
    at = np.broadcast_to(unknowns.reshape(len(values), 1, -1), values.shape)
    row = np.broadcast_to(np.arange(6 * len(values)).reshape(-1, 6, 1), values.shape)
    shape = (6 * len(values), size)
    return csr_array((values.ravel(), (row.ravel(), at.ravel())), shape=shape)


def corner_stresses(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    displacement: Array,
    temperature: Array,
) -> Array:
    """Stress at the corners of every cell, extrapolated from its most accurate points.

    Strains of second-order displacements are one order more accurate at the Gauss points of a
    first-order element (Barlow 1976). They are extrapolated to its corners by its shape functions.

    Parameters
    ----------
    structure, spaces, materials, displacement, temperature
        As for `stress_at`.

    Returns
    -------
    ndarray, shape (corners, cells, 6)
        `COMPONENTS`, Pa.
    """
    best = best_points(structure.mesh.t.shape[0])
    inside = np.stack(
        [
            _stress_in(structure, spaces, materials, displacement, temperature, point)
            for point in best.T
        ]
    )
    shapes, _ = reference_shapes(spaces.heat.elem, best, best.shape[1])
    # Values at the points are shapes^T times those at the corners.
    return np.asarray(np.einsum("pc,pnk->cnk", np.linalg.inv(shapes), inside))


def best_points(corners: int) -> Array:
    """Return the Gauss points of a first-order element, shape (3, corners)."""
    if corners == 8:
        low, high = 0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)
        return np.array(list(product((low, high), repeat=3))).T
    near, far = (5.0 - np.sqrt(5.0)) / 20.0, (5.0 + 3.0 * np.sqrt(5.0)) / 20.0
    return np.full((3, 4), near) + np.eye(3, 4) * (far - near)


def _stress_in(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    displacement: Array,
    temperature: Array,
    point: Array,
) -> Array:
    """Stress (cells, 6) at one reference point (3,) of every cell."""
    cells = np.arange(structure.mesh.nelements)
    local = np.tile(point[:, None, None], (1, len(cells), 1))
    slopes = _shape_gradients(spaces.displacement, local, cells)
    own = displacement.reshape(-1, 3)[spaces.displacement.element_dofs[:, cells]]
    gradient = np.einsum("fki,fjk->kij", own, slopes)
    heated = temperature[spaces.heat.element_dofs[:, cells]]
    rise = (shape_values(spaces.heat, local) * heated).sum(axis=0)
    lam, mu, bulk = elastic_constants(structure, materials)
    pressed = lam * np.trace(gradient, axis1=1, axis2=2) - bulk * rise
    return np.stack(
        [
            mu * (gradient[:, i, j] + gradient[:, j, i]) + (pressed if i == j else 0.0)
            for i, j in COMPONENTS
        ],
        axis=1,
    )


def stress_tensors(components: Array) -> Array:
    """Return tensors (..., 3, 3) from `COMPONENTS` (..., 6)."""
    number = {pair: row for row, pair in enumerate(COMPONENTS)}
    order = [[number.get((i, j), number.get((j, i), 0)) for j in range(3)] for i in range(3)]
    return np.asarray(components[..., order])


def von_mises(components: Array) -> Array:
    """Return the equivalent stress (...,) of `COMPONENTS` (..., 6): sqrt(3/2 s:s), s deviatoric."""
    normal, shear = components[..., :3], components[..., 3:]
    apart = normal - np.roll(normal, 1, axis=-1)
    equivalent = np.sqrt(0.5 * (apart**2).sum(axis=-1) + 3.0 * (shear**2).sum(axis=-1))
    return np.asarray(equivalent)


def principal(components: Array) -> Array:
    """Return the principal stresses (..., 3) of `COMPONENTS` (..., 6), the largest first."""
    return np.asarray(np.linalg.eigvalsh(stress_tensors(components))[..., ::-1])


def _shape_gradients(basis: CellBasis, local: Array, cells: NDArray[np.int64]) -> Array:
    """Gradients of the shape functions at reference points (3, k, 1), shape (functions, 3, k)."""
    return np.stack(
        [
            basis.elem.gbasis(basis.mapping, local, i, tind=cells)[0].grad[:, :, 0]
            for i in range(basis.Nbfun)
        ]
    )
