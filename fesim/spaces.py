"""Finite-element spaces: temperatures of first order, displacements of second order.

Second-order displacements do not lock in bending with one element through a wall, and a
temperature of one order less gives a thermal strain of the order that the elements can follow.
Displacements use the scalar space for each direction; unknown 3 i + c is direction c at node i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from skfem import (
    CellBasis,
    ElementHex1,
    ElementHex2,
    ElementHexS2,
    ElementTetP1,
    ElementTetP2,
    Mesh,
    MeshHex2,
    MeshTet2,
)
from skfem.element import Element

from artefacts.errors import InputError
from meshes.structure import Probe, Structure

#: A point may lie outside its cell by this much in the cell's own coordinates (0 to 1).
LOCATE_SLACK = 1e-4
_NEWTON_STEPS = 20


@dataclass(frozen=True)
class Spaces:
    """Bases of a structure.

    Attributes
    ----------
    heat : skfem.CellBasis
        Temperature.
    elastic : skfem.CellBasis
        One component of displacement, on the quadrature points of its own stiffness.
    heat_on_elastic : skfem.CellBasis
        Temperature on the quadrature points of `elastic`, for the thermal load.
    """

    heat: CellBasis
    elastic: CellBasis
    heat_on_elastic: CellBasis

    @property
    def displacement_size(self) -> int:
        """Number of displacement unknowns, supports included."""
        return 3 * int(self.elastic.N)


def make_spaces(mesh: Mesh) -> Spaces:
    """Return the spaces on a hexahedral or tetrahedral mesh.

    On curved cells the displacements have the functions of the geometry, so that a uniform strain
    stays exact, and the quadrature follows the curvature.
    """
    curved = isinstance(mesh, MeshHex2 | MeshTet2)
    low: Element
    high: Element
    if mesh.t.shape[0] == 8:
        low, high = ElementHex1(), ElementHex2() if curved else ElementHexS2()
        heat_order, elastic_order = (4, 6) if curved else (2, 5)
    else:
        low, high = ElementTetP1(), ElementTetP2()
        heat_order, elastic_order = (4, 4) if curved else (2, 2)
    heat = CellBasis(mesh, low, intorder=heat_order)
    elastic = CellBasis(mesh, high, intorder=elastic_order)
    return Spaces(heat, elastic, elastic.with_element(low))


def interpolation(
    basis: CellBasis,
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
    rows: NDArray[np.int64] | None = None,
    weights: NDArray[np.float64] | None = None,
    row_count: int | None = None,
) -> csr_array:
    """Matrix from scalar unknowns to weighted values at points, summed by row.

    Parameters
    ----------
    basis : skfem.CellBasis
        A scalar basis.
    points : ndarray, shape (3, n)
        Points, m.
    cells : ndarray of int, shape (n,)
        The cell each point lies in.
    rows : ndarray of int, shape (n,), optional
        Row that each point adds to; default one row each.
    weights : ndarray, shape (n,), optional
        Factor of each point; default one.
    row_count : int, optional
        Number of rows; default the largest row plus one.
    """
    count = points.shape[1]
    rows = np.arange(count) if rows is None else rows
    weights = np.ones(count) if weights is None else weights
    local = local_coordinates(basis.mesh, points, cells)[:, :, None]
    values = shape_values(basis.elem, basis, local, cells)
    dofs = basis.element_dofs[:, cells]
    shape = (int(rows.max()) + 1 if row_count is None else row_count, int(basis.N))
    entries = (values * weights).ravel()
    return csr_array((entries, (np.tile(rows, len(dofs)), dofs.ravel())), shape=shape)


def local_coordinates(
    mesh: Mesh, points: NDArray[np.float64], cells: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Reference coordinates (3, n) of points (3, n) in the cells (n,), also of points outside them.

    Newton's method, not kept inside the cell, as `locate` asks how far outside a point lies. Where
    it does not settle (a point far outside a distorted cell) the result is not finite.
    """
    mapping = mesh.mapping()
    local = np.full((3, points.shape[1], 1), 0.5)
    for _ in range(_NEWTON_STEPS):
        miss = points[:, :, None] - mapping.F(local, cells)
        move = np.einsum("ijkl,jkl->ikl", mapping.invDF(local, cells), miss)
        local = local + move
        settled = np.abs(move).max(axis=(0, 2)) < 1e-9
        if settled.all():
            break
    local[:, ~settled] = np.inf
    return local[:, :, 0]


def shape_values(
    element: Element, basis: CellBasis, local: NDArray[np.float64], cells: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Shape functions at local points (3, n, 1) of cells (n,), shape (functions, n)."""
    mapping = basis.mesh.mapping()
    return np.stack(
        [
            np.asarray(element.gbasis(mapping, local, i, tind=cells)[0]).reshape(-1)
            for i in range(basis.Nbfun)
        ]
    )


def locate(structure: Structure, name: str, probe: Probe) -> int:
    """Return the cell that a probe lies in.

    Raises
    ------
    InputError
        No cell (of the probe's body) holds the point.
    """
    mesh = structure.mesh
    cells = (
        np.arange(mesh.nelements)
        if probe.body is None
        else structure.body(probe.body, f"probe {name!r}")
    )
    centres = mesh.p[:, mesh.t[:, cells]].mean(axis=1).T
    position = np.asarray(probe.position)
    _, near = cKDTree(centres).query(position, k=min(32, len(cells)))
    candidates = cells[np.atleast_1d(near)]
    local = local_coordinates(mesh, np.tile(position[:, None], (1, len(candidates))), candidates)
    outside = np.maximum(-local, local - 1.0).max(axis=0)
    if mesh.t.shape[0] == 4:
        outside = np.maximum(outside, local.sum(axis=0) - 1.0)
    best = int(np.argmin(outside))
    if not outside[best] <= LOCATE_SLACK:
        of = f" of body {probe.body!r}" if probe.body else ""
        raise InputError(
            f"probe {name!r} at {probe.position} m lies in no cell{of}; move it into the structure"
        )
    return int(candidates[best])


def probe_rows(basis: CellBasis, structure: Structure, probes: dict[str, Probe]) -> csr_array:
    """Matrix from scalar unknowns to the values at `probes`, one row each."""
    cells = np.array([locate(structure, name, probe) for name, probe in probes.items()])
    points = np.array([probe.position for probe in probes.values()]).T
    return interpolation(basis, points, cells, row_count=len(probes))
