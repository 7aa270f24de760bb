"""Finite-element spaces: temperatures of first order, displacements of second order.

Second-order displacements do not lock in bending with one element across a wall, and a temperature
of one order less gives a thermal strain of the order that the elements can represent.
Displacements use the scalar space for each direction; unknown 3 i + c is direction c at node i.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

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
from skfem.mapping import Mapping as CellMaps
from skfem.quadrature import get_quadrature

from fesim.solid.cell_maps import cell_maps
from meshes.structure import Probe, Structure
from thermojoint.artefacts.errors import InputError, shown_point

#: A point may lie outside its cell by this much in reference coordinates (0 to 1).
LOCATE_SLACK = 1e-4
#: A curved cell may extend beyond the box of its corners by this fraction of its size.
_BULGE = 0.2
#: Number of cells, those with the nearest centres, that are tried first for a point.
_NEAREST = 32
#: Number of points located together; a larger one only needs more memory.
_AT_ONCE = 1_000
_NEWTON_STEPS = 20


@dataclass(frozen=True)
class Spaces:
    """Bases of a structure."""

    #: Temperature.
    heat: CellBasis
    #: One component of displacement: its numbering, places and surfaces. It has one quadrature
    #: point per cell and is not used for integrals over cells: `elastic` is.
    displacement: CellBasis
    #: Order of the quadrature of the stiffness.
    order: int

    @cached_property
    def elastic(self) -> CellBasis:
        """One component of displacement on the quadrature points of its own stiffness.

        Created on demand: it takes gigabytes for a fine mesh.
        """
        displacement = self.displacement
        return CellBasis(
            displacement.mesh,
            displacement.elem,
            displacement.mapping,
            intorder=self.order,
            dofs=displacement.dofs,
        )

    @property
    def quadrature(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points (3, q) and weights (q,) of the stiffness on the reference cell."""
        points, weights = get_quadrature(self.displacement.mesh.refdom, self.order)
        return np.asarray(points), np.asarray(weights)

    @property
    def displacement_size(self) -> int:
        """Number of displacement unknowns, supports included."""
        return 3 * int(self.displacement.N)


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
    maps = cell_maps(mesh)
    heat = CellBasis(mesh, low, maps, intorder=heat_order)
    # Not of order one, which would be eight points for a hexahedron.
    centre = low.refdom.p.mean(axis=1, keepdims=True), np.ones(1)
    return Spaces(heat, CellBasis(mesh, high, maps, quadrature=centre), elastic_order)


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
        Cell of each point.
    rows : ndarray of int, shape (n,), optional
        Row to which each point adds; default one row each.
    weights : ndarray, shape (n,), optional
        Factor of each point; default one.
    row_count : int, optional
        Number of rows; default the largest row plus one.
    """
    count = points.shape[1]
    rows = np.arange(count) if rows is None else rows
    weights = np.ones(count) if weights is None else weights
    local = local_coordinates(basis.mesh, points, cells)[:, :, None]
    values = shape_values(basis, local)
    dofs = basis.element_dofs[:, cells]
    shape = (int(rows.max()) + 1 if row_count is None else row_count, int(basis.N))
    entries = (values * weights).ravel()
    return csr_array((entries, (np.tile(rows, len(dofs)), dofs.ravel())), shape=shape)


def local_coordinates(
    mesh: Mesh, points: NDArray[np.float64], cells: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Reference coordinates (3, n) of points (3, n) in the cells (n,), also of points outside them.

    Newton's method, not restricted to the cell, as `cells_at` needs the distance of outside points.
    If it does not converge (a point far outside a distorted cell), the result is not finite.
    """
    mapping = cell_maps(mesh)
    local = np.full((3, points.shape[1], 1), 0.5)
    moving = np.arange(points.shape[1])
    for _ in range(_NEWTON_STEPS):
        at, own = local[:, moving], cells[moving]
        miss = points[:, moving, None] - mapping.F(at, own)
        move = np.einsum("ijkl,jkl->ikl", _inverse_gradient(mapping, at, own), miss)
        local[:, moving] += move
        moving = moving[~(np.abs(move).max(axis=(0, 2)) < 1e-9)]
        if moving.size == 0:
            break
    local[:, moving] = np.inf
    return local[:, :, 0]


def _inverse_gradient(
    mapping: CellMaps, local: NDArray[np.float64], cells: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Inverse gradient of the cells' maps, shape (3, 3, n, 1); NaN if a cell is flat."""
    try:
        return np.asarray(mapping.invDF(local, cells))
    except Exception:  # bare: raised by skfem if a determinant is zero
        gradient = np.moveaxis(mapping.DF(local, cells), (0, 1), (2, 3)).copy()
        gradient[np.linalg.det(gradient) == 0.0] = np.nan
        return np.moveaxis(np.linalg.inv(gradient), (2, 3), (0, 1))


def shape_values(basis: CellBasis, local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shape functions at local points (3, n, 1), shape (functions, n)."""
    each = [basis.elem.lbasis(local, i)[0] for i in range(basis.Nbfun)]
    return np.stack([np.broadcast_to(value, local.shape[1:]).reshape(-1) for value in each])


def cells_at(
    mesh: Mesh, points: NDArray[np.float64], cells: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return which of some cells contains each point, -1 if none does.

    Parameters
    ----------
    mesh : skfem.Mesh
        Any mesh.
    points : ndarray, shape (n, 3)
        Points, m.
    cells : ndarray of int, shape (k,)
        The cells to search.

    Returns
    -------
    ndarray of int, shape (n,)
        On a face between cells, one of them.
    """
    corners = mesh.p[:, mesh.t[:, cells]]
    count = min(_NEAREST, len(cells))
    _, near = cKDTree(corners.mean(axis=1).T).query(points, k=count)
    containing = np.concatenate(
        [
            _holding(mesh, points[part], cells[near.reshape(-1, count)[part]])
            for part in np.array_split(np.arange(len(points)), 1 + len(points) // _AT_ONCE)
        ]
    )
    low, high = corners.min(axis=1), corners.max(axis=1)
    slack = _BULGE * (high - low).max(axis=0)
    for lost in np.flatnonzero(containing < 0):
        # Among small cells the centre of a large one is not near, although it contains the point.
        x = points[lost][:, None]
        around = ((x >= low - slack) & (x <= high + slack)).all(axis=0)
        if around.any():
            containing[lost] = _holding(mesh, points[[lost]], cells[around][None])[0]
    return containing


def _holding(
    mesh: Mesh, points: NDArray[np.float64], candidates: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Which of the candidates (n, c) contains each point (n, 3), or -1, shape (n,)."""
    each = np.repeat(points, candidates.shape[1], axis=0).T
    outside = _outside(mesh, each, candidates.ravel()).reshape(candidates.shape)
    best = outside.argmin(axis=1)
    rows = np.arange(len(points))
    return np.where(outside[rows, best] <= LOCATE_SLACK, candidates[rows, best], -1)


def _outside(
    mesh: Mesh, points: NDArray[np.float64], cells: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Distance of points (3, n) outside cells (n,), in units of the cells, shape (n,)."""
    local = local_coordinates(mesh, points, cells)
    outside = np.maximum(-local, local - 1.0).max(axis=0)
    if mesh.t.shape[0] == 4:
        outside = np.maximum(outside, local.sum(axis=0) - 1.0)
    return np.asarray(outside)


def cells_around(structure: Structure, probe: Probe) -> NDArray[np.int64]:
    """Return every cell (of its body) that contains a probe: several if it lies between them."""
    mesh = structure.mesh
    cells = np.arange(mesh.nelements) if probe.body is None else structure.bodies[probe.body]
    x, corners = np.array(probe.position)[:, None], mesh.p[:, mesh.t[:, cells]]
    low, high = corners.min(axis=1), corners.max(axis=1)
    slack = _BULGE * (high - low).max(axis=0)
    near = cells[((x >= low - slack) & (x <= high + slack)).all(axis=0)]
    points = np.tile(x, (1, len(near)))
    return np.asarray(near[_outside(mesh, points, near) <= LOCATE_SLACK])


def probe_cells(structure: Structure, probes: Mapping[str, Probe]) -> NDArray[np.int64]:
    """Return the cell of each probe, shape (probes,).

    Raises
    ------
    InputError
        No cell (of the probe's body) contains the point; or it specifies no body and lies in two
        that share no node there, so that it is ambiguous.
    """
    names = list(probes)
    containing = np.full(len(names), -1)
    for body in dict.fromkeys(probe.body for probe in probes.values()):
        of = [i for i, name in enumerate(names) if probes[name].body == body]
        cells = (
            np.arange(structure.mesh.nelements)
            if body is None
            else structure.body(body, f"probe {names[of[0]]!r}")
        )
        points = np.array([probes[names[i]].position for i in of])
        containing[of] = cells_at(structure.mesh, points, cells)
        if body is None:
            _check_one_body(structure, [names[i] for i in of], points)
    for name, cell in zip(names, containing, strict=True):
        if cell < 0:
            probe = probes[name]
            where = f" of body {probe.body!r}" if probe.body else ""
            raise InputError(
                f"probe {name!r} at {shown_point(probe.position)} m lies in no cell{where}; "
                "move it into the structure"
            )
    return containing


def _check_one_body(structure: Structure, names: list[str], points: NDArray[np.float64]) -> None:
    """Refuse points (n, 3) that lie in two bodies that may move apart."""
    at = {body: cells_at(structure.mesh, points, cells) for body, cells in structure.bodies.items()}
    for i, name in enumerate(names):
        held = {body: structure.mesh.t[:, cells[i]] for body, cells in at.items() if cells[i] >= 0}
        for (first, a), (other, b) in combinations(held.items(), 2):
            if not np.intersect1d(a, b).size:
                raise InputError(
                    f"probe {name!r} at {shown_point(points[i])} m lies in {first!r} and in "
                    f"{other!r}, which a joint separates; say which is meant: body = {first!r}"
                )


def probe_rows(basis: CellBasis, structure: Structure, probes: Mapping[str, Probe]) -> csr_array:
    """Matrix from scalar unknowns to the values at `probes`, one row each."""
    points = np.array([probe.position for probe in probes.values()]).T
    return interpolation(basis, points, probe_cells(structure, probes), row_count=len(probes))
