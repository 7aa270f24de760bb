"""Volume cells and facets of a mesh file as a validated scikit-fem mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray
from skfem import Mesh, MeshHex, MeshHex2, MeshTet, MeshTet2
from skfem.io.meshio import from_meshio

from meshes.faces import rows_in
from thermojoint.artefacts.errors import InputError

#: A structure larger than this (m) is assumed to be in mm.
LARGEST_EXTENT = 50.0
#: A cell is straight if no mid node deviates from the middle by more than this fraction of the
#: cell's size.
STRAIGHTNESS = 1e-6
#: A cell whose volume is below this fraction of its bounding cube is flat.
FLATTEST_CELL = 1e-9

_TETRA_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
_HEX_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
_HEX_FACES = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))
#: Cell type -> (type of its straight cell, corners, and the corners between which each further node
#: lies, in VTK's order).
_VOLUMES: dict[str, tuple[str, int, tuple[tuple[int, ...], ...]]] = {
    "tetra": ("tetra", 4, ()),
    "tetra10": ("tetra", 4, _TETRA_EDGES),
    "hexahedron": ("hexahedron", 8, ()),
    "hexahedron20": ("hexahedron", 8, _HEX_EDGES),
    "hexahedron27": ("hexahedron", 8, (*_HEX_EDGES, *_HEX_FACES, tuple(range(8)))),
}


def volume_mesh(raw: meshio.Mesh, path: Path) -> tuple[Mesh, NDArray[np.int64]]:
    """Return the mesh, and the index in it of each corner node of the file.

    Second-order cells keep their curved geometry; if all of them are straight, the mesh becomes one
    of first order, which has the same shape and is cheaper.

    Returns
    -------
    mesh : skfem.Mesh
        Hexahedra or tetrahedra, corners first, without nodes that belong to no cell.
    renumber : ndarray of int, shape (nodes of the file,)
        Index of each node in the mesh, -1 if it is not in it.

    Raises
    ------
    InputError
        Cells are of several types, folded, flat, collapsed or repeated, or the mesh is too large.
    """
    blocks = [block for block in raw.cells if block.dim == 3 and len(block.data)]
    types = sorted({block.type for block in blocks})
    if len(types) != 1 or types[0] not in _VOLUMES:
        present = " and ".join(types) or "no volume"
        raise InputError(
            f"{path}: {present} cells; mesh all bodies with hexahedra or all with tetrahedra, of "
            "one order"
        )
    straight, corners, between = _VOLUMES[types[0]]
    cells = np.concatenate([block.data for block in blocks]).astype(np.int64)
    points = np.asarray(raw.points, dtype=float)
    # Facets and vertices, too: they define surfaces and probes.
    for nodes in [block.data for block in raw.cells if len(block.data)]:
        if nodes.min() < 0 or nodes.max() >= len(points):
            raise InputError(f"{path}: a cell refers to a missing node; export the mesh again")
    used = np.unique(cells[:, :corners])
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(used.size)
    extent = float(np.ptp(points[used], axis=0).max())
    if extent > LARGEST_EXTENT:
        raise InputError(
            f'{path}: the mesh is {extent:g} m long; if it is in mm, say unit = "mm" in '
            "[structure], or --unit mm without a case"
        )
    mesh = from_meshio(meshio.Mesh(points[used], [(straight, renumber[cells[:, :corners]])]))
    # Before its edges and faces are used, which are meaningless in a damaged mesh.
    _check_cells(mesh, path)
    if between and _is_curved(points, cells, corners, between):
        mesh = _curved(mesh, points, cells, renumber[cells[:, :corners]], between)
        _check_cells(mesh, path)
    return mesh, renumber


def _is_curved(
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
    corners: int,
    between: tuple[tuple[int, ...], ...],
) -> bool:
    size = np.ptp(points[cells[:, :corners]], axis=1).max(axis=1)
    off = [
        np.linalg.norm(points[cells[:, node]] - points[cells[:, ends]].mean(axis=1), axis=1)
        for node, ends in enumerate(between, start=corners)
    ]
    return not bool((np.array(off) <= STRAIGHTNESS * size).all())


def _curved(
    mesh: Mesh,
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
    corner: NDArray[np.int64],
    between: tuple[tuple[int, ...], ...],
) -> Mesh:
    """Return the second-order mesh with the mid nodes of the file."""
    curved = (MeshTet2 if corner.shape[1] == 4 else MeshHex2).from_mesh(mesh)
    places = curved.doflocs.copy()
    at = [points[cells[:, node]] for node in range(corner.shape[1], cells.shape[1])]
    if cells.shape[1] == 20:
        at += _serendipity_middles(points, cells)
        between = (*between, *_HEX_FACES, tuple(range(8)))
    groups = {2: (mesh.edges, curved.dofs.edge_dofs), 4: (mesh.facets, curved.dofs.facet_dofs)}
    for ends, position in zip(between, at, strict=True):
        if len(ends) == 8:
            places[:, curved.dofs.interior_dofs[0]] = position.T
        else:
            table, numbers = groups[len(ends)]
            places[:, numbers[0, rows_in(table.T, corner[:, ends])]] = position.T
    return replace(curved, doflocs=places)


def _serendipity_middles(
    points: NDArray[np.float64], cells: NDArray[np.int64]
) -> list[NDArray[np.float64]]:
    """Centres of the six faces and of the body of 20-node hexahedra, from their own map."""
    corner, edge = points[cells[:, :8]], points[cells[:, 8:]]
    faces = [
        0.5
        * edge[:, [i for i, ends in enumerate(_HEX_EDGES) if set(ends) <= set(face)]].sum(axis=1)
        - 0.25 * corner[:, face].sum(axis=1)
        for face in _HEX_FACES
    ]
    return [*faces, 0.25 * (edge.sum(axis=1) - corner.sum(axis=1))]


def _check_cells(mesh: Mesh, path: Path) -> None:
    """Raise InputError if a cell is folded, has no volume or a node twice, or occurs twice."""
    reference = mesh.elem.refdom.p
    centre = reference.mean(axis=1, keepdims=True)
    # Not detDF, which raises a bare Exception for a determinant of zero.
    gradient = mesh.mapping().DF(centre + (reference - centre) / np.sqrt(3.0))
    volume = np.linalg.det(np.moveaxis(gradient, (0, 1), (2, 3)))
    size = np.ptp(mesh.p[:, mesh.t], axis=1).max(axis=0)
    one_sign = np.abs(np.sign(volume).sum(axis=1)) == volume.shape[1]
    solid = np.abs(volume).min(axis=1) > FLATTEST_CELL * size**3
    bad = np.flatnonzero(~(one_sign & solid))
    if bad.size:
        raise InputError(f"{path}: cell {bad[0]} is folded or has no volume; mesh again")
    corners = np.sort(mesh.t, axis=0)
    collapsed = np.flatnonzero((np.diff(corners, axis=0) == 0).any(axis=0))
    if collapsed.size:
        raise InputError(
            f"{path}: cell {collapsed[0]} has the same node at two corners, as wedges written as "
            "hexahedra do; mesh all bodies with hexahedra or all with tetrahedra"
        )
    _, first = np.unique(corners, axis=1, return_index=True)
    again = np.setdiff1d(np.arange(mesh.nelements), first)
    if again.size:
        raise InputError(
            f"{path}: cell {again[0]} is there twice; put each volume in one physical group only"
        )


def corner_mesh(mesh: Mesh) -> Mesh:
    """Return the same cells with straight edges and without mid nodes."""
    first_order = MeshTet if mesh.t.shape[0] == 4 else MeshHex
    return first_order(mesh.p[:, : mesh.nvertices], mesh.t)


def boundary_facets(mesh: Mesh, corners: NDArray[np.int64], where: str) -> NDArray[np.int64]:
    """Facets of the mesh with the given corners, shape (n, 3 or 4), in any order.

    Raises
    ------
    InputError
        A facet belongs to no cell or to two.
    """
    facets = np.unique(rows_in(mesh.facets.T, corners))
    if facets.size and facets[0] < 0:
        raise InputError(f"{where} has facets that do not belong to the volume cells; mesh again")
    if not np.isin(facets, mesh.boundary_facets()).all():
        raise InputError(
            f"{where} has facets inside the mesh; sides of a joint must not share nodes"
        )
    return facets
