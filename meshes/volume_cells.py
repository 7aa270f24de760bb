"""Volume cells and facets of a mesh file as a scikit-fem mesh, checked."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray
from skfem import Mesh
from skfem.io.meshio import from_meshio

from artefacts.errors import InputError

#: A structure larger than this (m) is taken for one in mm.
LARGEST_EXTENT = 50.0
#: A mid-edge node may lie off the middle of its edge by this fraction of the edge.
STRAIGHTNESS = 1e-6
#: A cell with less volume than this fraction of its own bounding cube has none.
FLATTEST_CELL = 1e-9

_TETRA_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
_HEX_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
_HEX_FACES = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))
#: Cell type -> (type of its straight cell, corners, and between which corners each further node
#: lies, in VTK's order).
_VOLUMES: dict[str, tuple[str, int, tuple[tuple[int, ...], ...]]] = {
    "tetra": ("tetra", 4, ()),
    "tetra10": ("tetra", 4, _TETRA_EDGES),
    "hexahedron": ("hexahedron", 8, ()),
    "hexahedron20": ("hexahedron", 8, _HEX_EDGES),
    "hexahedron27": ("hexahedron", 8, (*_HEX_EDGES, *_HEX_FACES, tuple(range(8)))),
}


def volume_mesh(raw: meshio.Mesh, path: Path) -> tuple[Mesh, NDArray[np.int64]]:
    """Return the mesh of first order, and the number in it of each of the file's nodes.

    Parameters
    ----------
    raw : meshio.Mesh
        What the file holds, coordinates in m.
    path : Path
        The file, for the error messages.

    Returns
    -------
    mesh : skfem.Mesh
        Hexahedra or tetrahedra, and no node without a cell.
    renumber : ndarray of int, shape (nodes of the file,)
        Number of each node in the mesh, -1 where it has none.

    Raises
    ------
    InputError
        Cells are of several types, curved, folded, flat or repeated, or the mesh is too large.
    """
    blocks = [block for block in raw.cells if block.dim == 3]
    types = sorted({block.type for block in blocks})
    if len(types) != 1 or types[0] not in _VOLUMES:
        found = " and ".join(types) or "no volume"
        raise InputError(
            f"{path}: {found} cells; mesh all bodies with hexahedra or all with tetrahedra"
        )
    straight, corners, between = _VOLUMES[types[0]]
    cells = np.concatenate([block.data for block in blocks]).astype(np.int64)
    points = np.asarray(raw.points, dtype=float)
    if cells.min() < 0 or cells.max() >= len(points):
        raise InputError(f"{path}: a cell names a node that is not there; write the mesh again")
    for node, ends in enumerate(between, start=corners):
        middle = points[cells[:, ends]].mean(axis=1)
        length = np.linalg.norm(points[cells[:, ends[0]]] - points[cells[:, ends[1]]], axis=1)
        off = np.linalg.norm(points[cells[:, node]] - middle, axis=1)
        bent = np.flatnonzero(~(off <= STRAIGHTNESS * length))
        if bent.size:
            raise InputError(
                f"{path}: cell {bent[0]} is curved or its mid nodes are not in the middle; mesh "
                "with cells of first order"
            )
    used = np.unique(cells[:, :corners])
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(used.size)
    extent = float(np.ptp(points[used], axis=0).max())
    if extent > LARGEST_EXTENT:
        raise InputError(
            f"{path}: the mesh is {extent:g} m long, perhaps in mm; scale its coordinates to m"
        )
    mesh = from_meshio(meshio.Mesh(points[used], [(straight, renumber[cells[:, :corners]])]))
    _check_cells(mesh, path)
    return mesh, renumber


def _check_cells(mesh: Mesh, path: Path) -> None:
    """Raise InputError if a cell has no volume, is folded or is there twice."""
    reference = mesh.elem.refdom.p
    centre = reference.mean(axis=1, keepdims=True)
    # Not detDF: it raises a bare Exception on a determinant of zero.
    gradient = mesh.mapping().DF(centre + (reference - centre) / np.sqrt(3.0))
    volume = np.linalg.det(np.moveaxis(gradient, (0, 1), (2, 3)))
    size = np.ptp(mesh.p[:, mesh.t], axis=1).max(axis=0)
    one_sign = np.abs(np.sign(volume).sum(axis=1)) == volume.shape[1]
    solid = np.abs(volume).min(axis=1) > FLATTEST_CELL * size**3
    bad = np.flatnonzero(~(one_sign & solid))
    if bad.size:
        raise InputError(f"{path}: cell {bad[0]} is folded or has no volume; mesh again")
    _, first = np.unique(np.sort(mesh.t, axis=0), axis=1, return_index=True)
    again = np.setdiff1d(np.arange(mesh.nelements), first)
    if again.size:
        raise InputError(
            f"{path}: cell {again[0]} is there twice; put each volume in one physical group only"
        )


def boundary_facets(mesh: Mesh, corners: NDArray[np.int64], where: str) -> NDArray[np.int64]:
    """Facets of the mesh with the given corners, shape (n, 3 or 4), in any order.

    Raises
    ------
    InputError
        A facet belongs to no cell or to two.
    """
    rows = np.vstack([np.sort(mesh.facets.T, axis=1), np.sort(corners, axis=1)])
    _, key = np.unique(rows, axis=0, return_inverse=True)
    key = key.ravel()
    facet_of = np.full(key.max() + 1, -1)
    facet_of[key[: mesh.nfacets]] = np.arange(mesh.nfacets)
    facets = np.unique(facet_of[key[mesh.nfacets :]])
    if facets.size and facets[0] < 0:
        raise InputError(f"{where} has facets that are no facets of the volume cells; mesh again")
    if not np.isin(facets, mesh.boundary_facets()).all():
        raise InputError(
            f"{where} has facets inside the mesh; sides of a joint must not share nodes"
        )
    return facets
