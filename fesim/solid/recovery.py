"""Mesh errors of linear outputs, from recovered stresses (Zienkiewicz & Zhu 1987).

A recovered stress, its mean at each node over the cells of the same material, is compared with that
of the solution. It has no traction at a free surface, which also detects walls with a single
element across. The error of an output is the inner product of these differences of the solution and
of its dual, the solution with the output's own row as the load (Becker & Rannacher 2001). It is
linear in the solution, so it is computed as a row.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array
from skfem import CellBasis, Mesh
from skfem.quadrature import get_quadrature

from fesim.solid.element_matrices import CellGradients, cell_gradients, reference_shapes
from fesim.solid.materials import Material, by_cell, elastic_constants
from fesim.solid.spaces import Spaces
from fesim.solid.stress import best_points
from meshes.pairing import outward_areas
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array

#: Order of the quadrature of the differences.
ORDER = 4
#: Facets at a node are one surface if the mean square variation of their normals is below this.
SMOOTH = 0.1


def stress_error_rows(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    free: NDArray[np.int64],
    duals: Array,
) -> tuple[Array, Array]:
    """Return rows, as columns (n, k) and (n_heat, k), that give the errors of outputs, m.

    Stresses are recovered from the Gauss points of a first-order element, where those of
    second-order displacements are one order more accurate (Barlow 1976).

    Parameters
    ----------
    structure, spaces, materials
        Mesh, its spaces, and the material of every body.
    free : ndarray of int, shape (f,)
        Boundary facets without traction.
    duals : ndarray, shape (n, k)
        Displacements with each output's row as forces, per N.
    """
    basis, heat, count = spaces.displacement, spaces.heat, duals.shape[1]
    elastic = _Elastic(*elastic_constants(structure, materials))
    recovery = _recovery(structure, spaces, materials, free)
    best = best_points(structure.mesh.t.shape[0])
    outwards = np.linalg.inv(reference_shapes(heat.elem, best, best.shape[1])[0])
    gauss = best, np.ones(best.shape[1])
    own = duals.reshape(-1, 3, count)[basis.element_dofs]
    moved = np.zeros((int(basis.N), 3, count))
    heated = np.zeros((int(heat.N), count))
    taken = np.zeros((*heat.element_dofs.shape, count, 3, 3))

    def put(part: slice, at: CellGradients, weights: Array, shapes: Array) -> None:
        """Add the sum of stresses with weights (c, k, 3, 3, q) to the rows."""
        given, pressed = elastic.transposed(part, weights)
        shares = np.einsum("cfjq,ckijq->fcik", at.gradient, given, optimize=True)
        np.add.at(moved, basis.element_dofs[:, part], shares)
        warm = np.einsum("nq,ckq->nck", shapes, pressed)
        np.add.at(heated, heat.element_dofs[:, part], warm)

    for part, at in _batches(basis, gauss):
        stress = elastic.stress(part, at, own[:, part])
        taken[:, part] = np.einsum("qn,ckijq->nckij", outwards, stress)
    smooth, back = recovery.smoothed(taken), np.zeros_like(taken)
    for part, at in _batches(basis, recovery.quadrature):
        off = np.einsum("nq,nckij->ckijq", recovery.shapes, smooth[:, part])
        off -= elastic.stress(part, at, own[:, part])
        strain = elastic.strain(part, off) * at.volume[:, None, None, None]
        back[:, part] = np.einsum("nq,ckijq->nckij", recovery.shapes, strain)
        put(part, at, -strain, recovery.shapes)
    back, shapes = recovery.smoothed(back), reference_shapes(heat.elem, best, best.shape[1])[0]
    for part, at in _batches(basis, gauss):
        put(part, at, np.einsum("qn,nckij->ckijq", outwards, back[:, part]), shapes)
    return moved.reshape(duals.shape), heated


@dataclass(frozen=True)
class _Recovery:
    """Nodal means of values at the corners of cells, and the points of their comparison."""

    #: From corners, in the order of the cells for each, to the mean at their node: symmetric.
    mean: csr_array
    #: Shapes (3, q) and (q,): points and weights of the reference cell.
    quadrature: tuple[Array, Array]
    #: Shape (corners, q): functions of the corners at these points.
    shapes: Array
    #: Shape (corners, cells, 3, 3): projection on the directions in which a section through the
    #: node of a corner may have traction.
    inwards: Array

    def smoothed(self, stress: Array) -> Array:
        """Means of stresses (corners, cells, k, 3, 3) at the node of each corner: symmetric."""
        flat = stress.reshape(self.mean.shape[0], -1)
        mean = np.asarray(self.mean @ flat).reshape(stress.shape)
        return np.asarray(np.einsum("ncia,nckab,ncbj->nckij", self.inwards, mean, self.inwards))


def _recovery(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    free: NDArray[np.int64],
) -> _Recovery:
    mesh = structure.mesh
    kinds = list(dict.fromkeys(materials.values()))
    kind = by_cell(structure, {name: kinds.index(m) for name, m in materials.items()})
    _, node = np.unique(mesh.t + mesh.nvertices * kind, return_inverse=True)
    node = node.ravel()
    at = csr_array((np.ones(len(node)), (node, np.arange(len(node)))))
    mean = csr_array(at.T @ diags_array(1.0 / np.bincount(node)) @ at)
    points, weights = get_quadrature(mesh.refdom, ORDER)
    shapes, _ = reference_shapes(spaces.heat.elem, points, len(mesh.t))
    return _Recovery(mean, (points, weights), shapes, _inwards(mesh, free)[mesh.t])


def _inwards(mesh: Mesh, free: NDArray[np.int64]) -> Array:
    """Projection (nodes, 3, 3) perpendicular to all free facets at each node.

    It is the identity at re-entrant edges and where other boundary facets begin: stresses may be
    singular there. Facets that meet at less than about 40 degrees are one surface.
    """
    area = outward_areas(mesh, free)
    size = np.linalg.norm(area, axis=1)
    corners = mesh.facets[:, free]
    spread = np.zeros((mesh.nvertices, 3, 3))
    np.add.at(spread, corners, np.einsum("fi,fj->fij", area, area) / size[:, None, None])
    whole = np.einsum("nii->n", spread)
    values, vectors = np.linalg.eigh(spread / np.where(whole > 0.0, whole, 1.0)[:, None, None])
    kept = vectors * (values < SMOOTH)[:, None, :]
    inwards = np.einsum("nik,njk->nij", kept, kept)
    # Convex if all cells around a node lie behind each free facet there.
    cells = csr_array(
        (np.ones(mesh.t.size), (mesh.t.ravel(), np.tile(np.arange(mesh.nelements), len(mesh.t)))),
        shape=(mesh.nvertices, mesh.nelements),
    )
    node, facet = corners.ravel(), np.tile(np.arange(len(free)), len(corners))
    pairs = cells[node].tocoo()
    centre = mesh.p[:, mesh.t].mean(axis=1).T
    away = centre[pairs.col] - mesh.p[:, node[pairs.row]].T
    ahead = (away * area[facet[pairs.row]]).sum(axis=1) > 0.1 * size[facet[pairs.row]] * (
        np.linalg.norm(away, axis=1)
    )
    inwards[np.unique(node[pairs.row[ahead]])] = np.eye(3)
    others = np.setdiff1d(mesh.boundary_facets(), free)
    inwards[mesh.facets[:, others]] = np.eye(3)
    return np.asarray(inwards)


@dataclass(frozen=True)
class _Elastic:
    """Lame's constants (c,), Pa, and (3 lambda + 2 mu) alpha, Pa/K, of the cells."""

    lame: Array
    shear: Array
    bulk: Array

    def stress(self, part: slice, at: CellGradients, own: Array) -> Array:
        """Stress (c, k, 3, 3, q) from displacements (functions, c, 3, k) without thermal strain."""
        slope = np.einsum("cfjq,fcik->ckijq", at.gradient, own, optimize=True)
        return self._stressed(part, slope)

    def transposed(self, part: slice, weights: Array) -> tuple[Array, Array]:
        """Weights of the displacement gradient and, (c, k, q), of the temperature."""
        pressed = np.einsum("ckiiq->ckq", weights)
        return self._stressed(part, weights), -self.bulk[part, None, None] * pressed

    def strain(self, part: slice, stress: Array) -> Array:
        """Elastic strain (c, k, 3, 3, q) due to stresses."""
        lame, shear = (x[part, None, None] for x in (self.lame, self.shear))
        pressed = np.einsum("ckiiq->ckq", stress) * lame / (3.0 * lame + 2.0 * shear)
        strain = stress.copy()
        for i in range(3):
            strain[:, :, i, i] -= pressed
        return np.asarray(strain / (2.0 * shear[..., None, None]))

    def _stressed(self, part: slice, slope: Array) -> Array:
        shear = self.shear[part, None, None, None, None]
        stress = shear * (slope + slope.swapaxes(2, 3))
        pressed = self.lame[part, None, None] * np.einsum("ckiiq->ckq", slope)
        for i in range(3):
            stress[:, :, i, i] += pressed
        return np.asarray(stress)


def _batches(
    basis: CellBasis, quadrature: tuple[Array, Array]
) -> Iterator[tuple[slice, CellGradients]]:
    """Gradients of all cells at some points, with functions in the order of the basis."""
    return cell_gradients(basis.mesh, basis.elem, quadrature, np.arange(basis.nelems))
