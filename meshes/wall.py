"""A rigid wall against a surface: one layer of cells on copies of the surface's facets.

The layer shares no node with the body it faces. Its cells only carry the wall's name and
temperature: the caller makes it rigid by fixing all of its nodes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from skfem import Mesh, MeshHex, MeshHex2, MeshTet, MeshTet2

from meshes.faces import rows_in
from meshes.pairing import cyclic_order, facet_corners, outward_areas
from meshes.structure import Structure
from thermojoint.artefacts.errors import InputError

#: Depth of the layer over the mean edge of its facets.
DEPTH = 0.5


def face_of(wall: str) -> str:
    """Return the name of the wall's surface that faces its body."""
    return f"{wall}.face"


def with_wall(structure: Structure, name: str, faces: str) -> Structure:
    """Add a wall against a surface, as a separate body.

    Parameters
    ----------
    structure : Structure
        Structure of first-order hexahedra or tetrahedra.
    name : str
        Name of the wall's body, and of the surface with all its nodes; `face_of` gives the name of
        the surface that faces the structure.
    faces : str
        Surface that the wall faces.

    Raises
    ------
    InputError
        There is no such surface, the name is taken, or the mesh is of second order.
    """
    facets = structure.surface(faces, f"walls.{name}.faces")
    for taken in (structure.bodies, structure.surfaces):
        if name in taken or face_of(name) in taken:
            raise InputError(f"walls.{name}: the structure has that name already; take another")
    mesh = structure.mesh
    if isinstance(mesh, MeshHex2 | MeshTet2):
        raise InputError(
            f"walls.{name}: a wall needs a mesh of first order; export the mesh with straight edges"
        )
    layer = _layer(mesh, facets)
    whole = type(mesh)(np.hstack([mesh.p, layer.p]), np.hstack([mesh.t, layer.t + mesh.p.shape[1]]))
    corners = layer.facets[:, layer.boundary_facets()] + mesh.p.shape[1]
    centres = layer.p[:, layer.facets[:, layer.boundary_facets()]].mean(axis=1).T
    at = facet_corners(mesh, facets).mean(axis=1)
    size = float(np.ptp(mesh.p, axis=1).max())
    near = np.abs(centres[:, None] - at[None]).max(axis=2).min(axis=1) < 1e-9 * size
    nodes = {other: mesh.facets[:, old] for other, old in structure.surfaces.items()}
    nodes |= {name: corners, face_of(name): corners[:, near]}
    surfaces = {other: rows_in(whole.facets.T, own.T) for other, own in nodes.items()}
    cells = np.arange(mesh.nelements, whole.nelements)
    return replace(
        structure, mesh=whole, bodies=structure.bodies | {name: cells}, surfaces=surfaces
    )


def _layer(mesh: Mesh, facets: NDArray[np.int64]) -> Mesh:
    """Cells behind `facets`, one for each (hexahedra) or three (tetrahedra)."""
    nodes, place = np.unique(mesh.facets[:, facets], return_inverse=True)
    place = place.reshape(-1, len(facets))
    vectors = outward_areas(mesh, facets)
    normal = np.zeros((3, nodes.size))
    for row in place:
        np.add.at(normal.T, row, vectors)
    normal /= np.linalg.norm(normal, axis=0)
    edge = float(np.sqrt(np.linalg.norm(vectors, axis=1).mean()))
    points = np.hstack([mesh.p[:, nodes], mesh.p[:, nodes] + DEPTH * edge * normal])
    behind = place + nodes.size
    if len(place) == 3:
        # Facets list their nodes in ascending order: neighbouring prisms are cut alike.
        (a, b, c), (d, e, f) = place, behind
        return MeshTet(points, np.hstack([[a, b, c, f], [a, b, e, f], [a, d, e, f]]))
    corners = mesh.p[:, mesh.facets[:, facets]].transpose(2, 1, 0)
    around = np.take_along_axis(place, cyclic_order(corners).T, axis=0)
    # Corner number of the unit cell by its coordinates: around its face, then in depth.
    number = {tuple(corner): k for k, corner in enumerate(MeshHex.elem.refdom.p.T.astype(int))}
    cell = np.empty((8, len(facets)), dtype=np.int64)
    for k, (x, y) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        cell[number[x, y, 0]] = around[k]
        cell[number[x, y, 1]] = around[k] + nodes.size
    return MeshHex(points, cell)
