"""CalculiX's elements: types, order of nodes, faces (manual: "Element types")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skfem import CellBasis

from fesim.solid.spaces import make_spaces
from meshes.structure import Structure
from thermojoint.artefacts.errors import InputError

#: Corners of CalculiX's elements in reference coordinates from 0 to 1, in its order.
HEXAHEDRON = (
    (0, 0, 0),
    (1, 0, 0),
    (1, 1, 0),
    (0, 1, 0),
    (0, 0, 1),
    (1, 0, 1),
    (1, 1, 1),
    (0, 1, 1),
)
TETRAHEDRON = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
#: Edges whose middles are its further nodes, in its order, as pairs of corners.
HEXAHEDRON_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
TETRAHEDRON_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
#: Corners of its element faces S1, S2, ...
HEXAHEDRON_FACES = (
    *((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1)),
    *((1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
)
TETRAHEDRON_FACES = ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))
#: Element types by mesh: second-order displacements first.
ELEMENTS = {8: ("C3D20", "C3D20R", "C3D8I", "C3D8"), 4: ("C3D10", "C3D4")}


def element_of(structure: Structure, wanted: str) -> str:
    """Element type for a mesh: `wanted`, or the one with our displacements if that is empty."""
    known = ELEMENTS[structure.mesh.t.shape[0]]
    element = wanted or known[0]
    if element not in known:
        raise InputError(f"against_calculix: no element {element!r} here; use {', '.join(known)}")
    return element


def node_basis(structure: Structure, element: str) -> CellBasis:
    """Scalar space with the nodes of an element type."""
    spaces = make_spaces(structure.mesh)
    return spaces.elastic if element in ("C3D20", "C3D20R", "C3D10") else spaces.heat


def connectivity(basis: CellBasis) -> NDArray[np.int64]:
    """Unknowns of each cell in CalculiX's order, shape (cells, nodes)."""
    hexahedra = basis.mesh.t.shape[0] == 8
    corners = np.array(HEXAHEDRON if hexahedra else TETRAHEDRON, dtype=float)
    edges = np.array(HEXAHEDRON_EDGES if hexahedra else TETRAHEDRON_EDGES)
    points = np.vstack([corners, corners[edges].mean(axis=1)])[: basis.Nbfun]
    # CalculiX wants right-handed elements; a left-handed cell is read in a mirror.
    mirrored = points[:, [1, 0, 2]]
    local = np.array(basis.elem.doflocs)
    centre = np.full((3, 1), 0.25)
    handed = basis.mapping.detDF(centre)[:, 0] > 0.0
    orders = [
        [int(np.linalg.norm(local - point, axis=1).argmin()) for point in each]
        for each in (points, mirrored)
    ]
    return np.where(
        handed[:, None], basis.element_dofs[orders[0]].T, basis.element_dofs[orders[1]].T
    )


def faces(
    structure: Structure, basis: CellBasis, cells: NDArray[np.int64], surface: str
) -> list[tuple[int, int]]:
    """Return (element, face number) of a surface's facets; both count from 1.

    `structure`: mesh and names. `basis`: its nodes. `cells` (cells, nodes): `connectivity`.
    """
    mesh = structure.mesh
    numbered = HEXAHEDRON_FACES if mesh.t.shape[0] == 8 else TETRAHEDRON_FACES
    found = []
    for facet in structure.surface(surface):
        cell = int(mesh.f2t[0, facet])
        nodes = set(basis.nodal_dofs[0][mesh.facets[:, facet]])
        sides = [set(cells[cell, list(side)]) for side in numbered]
        found.append((cell + 1, sides.index(nodes) + 1))
    return found
