"""Elastic operators (stiffness, thermal load, supports), assembled piece by piece.

Bodies separated by a joint share no node, so the stiffness is block diagonal: its blocks are the
connected pieces of the mesh.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from fesim.solid.element_matrices import cell_gradients, places_of, reference_shapes
from fesim.solid.heat import convection_form, surface_basis
from fesim.solid.linear_solver import symmetric, upper_triangle
from fesim.solid.materials import Material, elastic_constants
from fesim.solid.spaces import Spaces
from meshes.inspection import pieces
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array

DIRECTIONS = ("x", "y", "z")


@dataclass(frozen=True)
class ElasticPiece:
    """Thermoelastic equilibrium K u = F T of a part that shares no node with the others."""

    #: Shape (p,): its unknowns in the numbering of the whole, in ascending order.
    unknowns: NDArray[np.int64]
    #: Shape (p / 3, 3): positions of its nodes, m; unknown 3 i + c is direction c at node i.
    points: Array
    #: Shape (p, p): upper triangle of K, N/m, supports not yet removed.
    stiffness: csr_array
    #: Shape (p, n_heat): F, N/K.
    thermal_load: csr_array
    #: Shape (p,): unknowns without support.
    free: NDArray[np.bool_]


@dataclass(frozen=True)
class ElasticOperators:
    """Thermoelastic equilibrium K u = F T of the whole, supports not yet removed."""

    #: Shape (n, n): K, N/m.
    stiffness: csr_array
    #: Shape (n, n_heat): F, N/K: nodal forces of a fully constrained temperature field.
    thermal_load: csr_array
    #: Unknowns without support.
    free: NDArray[np.int64]
    #: Shape (n / 3, 3): positions of the nodes, m.
    points: Array

    def pieces(self) -> Iterator[ElasticPiece]:
        """Yield the parts that are not connected by an entry of the stiffness."""
        nodes = len(self.points)
        at = self.stiffness.tocoo()
        links = coo_array((np.ones(at.nnz), (at.row // 3, at.col // 3)), (nodes, nodes))
        count, label = connected_components(links, directed=False)
        free = np.isin(np.arange(3 * nodes), self.free)
        for number in range(count):
            own = np.flatnonzero(label == number)
            unknowns = _of_nodes(own)
            yield ElasticPiece(
                unknowns,
                self.points[own],
                upper_triangle(self.stiffness[unknowns][:, unknowns]),
                csr_array(self.thermal_load[unknowns]),
                free[unknowns],
            )


def elastic_operators(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    fixed: list[str],
    symmetry: dict[str, str],
    springs: Mapping[str, tuple[float, float, float]] | None = None,
) -> ElasticOperators:
    """Assemble the elastic operators of the whole structure; as for `elastic_pieces`."""
    size = spaces.displacement_size
    stiffness, load = csr_array((size, size)), csr_array((size, int(spaces.heat.N)))
    for piece in elastic_pieces(structure, spaces, materials, fixed, symmetry, springs):
        at = symmetric(piece.stiffness).tocoo()
        index = (piece.unknowns[at.row], piece.unknowns[at.col])
        stiffness = stiffness + csr_array((at.data, index), shape=stiffness.shape)
        load = load + in_rows(piece.thermal_load, piece.unknowns, size)
    held = held_unknowns(structure, spaces, fixed, symmetry)
    return ElasticOperators(
        csr_array(stiffness),
        csr_array(load),
        np.setdiff1d(np.arange(size), held),
        np.ascontiguousarray(spaces.displacement.doflocs.T),
    )


def elastic_pieces(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    fixed: list[str],
    symmetry: dict[str, str],
    springs: Mapping[str, tuple[float, float, float]] | None = None,
) -> Iterator[ElasticPiece]:
    """Assemble one piece after the other; only one of them is in memory here.

    Parameters
    ----------
    structure : Structure
        Mesh and names.
    spaces : Spaces
        Displacement and temperature spaces.
    materials : dict
        Body name to its material.
    fixed : list of str
        Surfaces fixed in all directions.
    symmetry : dict
        Surface name to the constrained direction ("x", "y" or "z").
    springs : mapping, optional
        Surface name to the total stiffness in x, y and z of the springs under it, N/m, uniformly
        distributed.
    """
    free = np.ones(spaces.displacement_size, dtype=bool)
    free[held_unknowns(structure, spaces, fixed, symmetry)] = False
    beds = beds_under(structure, spaces, springs or {})
    constants = elastic_constants(structure, materials)

    def piece(cells: NDArray[np.int64]) -> ElasticPiece:
        nodes = np.unique(spaces.displacement.element_dofs[:, cells])
        unknowns = _of_nodes(nodes)
        stiffness, load = _assembled(spaces, cells, nodes, [values[cells] for values in constants])
        if springs:
            stiffness = csr_array(stiffness + upper_triangle(beds[unknowns][:, unknowns]))
        points = np.ascontiguousarray(spaces.displacement.doflocs[:, nodes].T)
        return ElasticPiece(unknowns, points, stiffness, load, free[unknowns])

    label = pieces(spaces.displacement.element_dofs)
    return (piece(np.flatnonzero(label == number)) for number in range(label.max() + 1))


def in_rows(block: csr_array, rows: NDArray[np.int64], count: int) -> csr_array:
    """Put the rows of a block (r, k) at `rows`, in ascending order, of a matrix (count, k)."""
    filled = np.zeros(count, dtype=np.int64)
    filled[rows] = np.diff(block.indptr)
    indptr = np.concatenate([[0], np.cumsum(filled)])
    return csr_array((block.data, block.indices, indptr), shape=(count, block.shape[1]))


def _assembled(
    spaces: Spaces, cells: NDArray[np.int64], nodes: NDArray[np.int64], moduli: list[Array]
) -> tuple[csr_array, csr_array]:
    """Upper triangle of K and F of some cells on the unknowns of their nodes."""
    basis, heat = spaces.displacement, spaces.heat
    lame, shear, bulk = moduli
    own = np.searchsorted(nodes, basis.element_dofs[:, cells])
    # With its functions in the order of their nodes, every cell has the same upper triangle.
    order = np.argsort(own, axis=0)
    own = np.take_along_axis(own, order, axis=0)
    pairs = np.triu_indices(len(own))
    temperatures = heat.element_dofs[:, cells]
    shapes, _ = reference_shapes(heat.elem, spaces.quadrature[0], len(temperatures))
    forces = np.empty((3, 3, len(pairs[0]), len(cells)))
    loads = np.empty((3, len(own), len(temperatures), len(cells)))
    for part, at in cell_gradients(basis.mesh, basis.elem, spaces.quadrature, cells, order):
        forces[..., part] = at.stiffness(lame[part], shear[part], pairs)
        loads[..., part] = at.expansion(bulk[part], shapes)
    places = places_of(own[pairs[0]], own[pairs[1]], (len(nodes), len(nodes)))
    blocks = np.empty((len(places.first), 3, 3))
    for i in range(3):
        for j in range(3):
            blocks[:, i, j] = places.sums(forces[i, j])
    del forces
    size = 3 * len(nodes)
    stiffness = bsr_array((blocks, places.indices, places.indptr), shape=(size, size)).tocsr()
    del blocks
    shape = (len(nodes), int(heat.N))
    places = places_of(
        np.broadcast_to(own[:, None], loads.shape[1:]),
        np.broadcast_to(temperatures, loads.shape[1:]),
        shape,
    )
    entries = np.stack([places.sums(load) for load in loads], axis=1)[:, :, None]
    load = bsr_array((entries, places.indices, places.indptr), shape=(size, shape[1])).tocsr()
    return upper_triangle(stiffness), csr_array(load)


def _of_nodes(nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Unknowns of nodes, direction by direction at each."""
    return (3 * nodes.astype(np.int64)[:, None] + np.arange(3)).ravel()


def beds_under(
    structure: Structure, spaces: Spaces, springs: Mapping[str, tuple[float, float, float]]
) -> csr_array:
    """Stiffness (n, n) of the springs under surfaces, N/m."""
    size = spaces.displacement_size
    springs_matrix = csr_array((size, size))
    for name, stiffness in springs.items():
        surface = surface_basis(structure, spaces.displacement, name)
        bed = coo_array(convection_form.assemble(surface))
        for i in range(3):
            index = (3 * bed.row.astype(np.int64) + i, 3 * bed.col.astype(np.int64) + i)
            values = stiffness[i] / bed.sum() * bed.data
            springs_matrix = springs_matrix + csr_array((values, index), shape=springs_matrix.shape)
    return csr_array(springs_matrix)


def held_unknowns(
    structure: Structure, spaces: Spaces, fixed: list[str], symmetry: dict[str, str]
) -> NDArray[np.int64]:
    """Constrained unknowns; as for `elastic_pieces`."""
    held = [np.empty(0, dtype=np.int64)]
    for name, directions in held_directions(fixed, symmetry):
        dofs = spaces.displacement.get_dofs(structure.surface(name, "supports")).all()
        held.extend(3 * dofs + i for i in directions)
    return np.unique(np.concatenate(held))


def held_directions(
    fixed: Sequence[str], symmetry: Mapping[str, str]
) -> list[tuple[str, tuple[int, ...]]]:
    """Return the supported surfaces with the indices of their constrained directions."""
    planes = [(name, (DIRECTIONS.index(direction),)) for name, direction in symmetry.items()]
    return [*((name, (0, 1, 2)) for name in fixed), *planes]
