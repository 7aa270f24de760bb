"""Errors of straight edges on round faces in linear outputs, from the shape derivative.

If the normals of neighbouring facets differ little, the face between their corners is taken as
round: its distance d from a facet follows from the normals at the corners. The material between
both changes an output by -(sigma : eps* + p div u*) d per area, with the stress of the solution,
the strain of its dual (the output's row as the load), and the pressure p on the face.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from skfem import Mesh, MeshHex2, MeshTet2

from fesim.solid.materials import Material, elastic_constants
from fesim.solid.spaces import Spaces
from fesim.solid.stress import COMPONENTS, stress_rows
from meshes.pairing import cyclic_order, outward_areas
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array

#: Cosine of the angle up to which neighbouring facets belong to one round face: 40 degrees.
ALIKE = float(np.cos(np.deg2rad(40.0)))
#: Distances below this fraction of a facet's size are rounding.
FLAT = 1e-9


def bulges(mesh: Mesh, facets: NDArray[np.int64]) -> Array:
    """Mean outward distance of the round face from each boundary facet, (f,), m; 0 if it is flat.

    Cells of second order follow round faces themselves.
    """
    if isinstance(mesh, MeshHex2 | MeshTet2):
        return np.zeros(len(facets))
    boundary = mesh.boundary_facets()
    area = outward_areas(mesh, boundary)
    normal = area / np.linalg.norm(area, axis=1)[:, None]
    nodes = mesh.facets[:, boundary].T
    if nodes.shape[1] == 4:
        nodes = np.take_along_axis(nodes, cyclic_order(mesh.p.T[nodes]), axis=1)
    ends, count = nodes.shape[1], len(boundary)
    at = csr_array(
        (np.ones(nodes.size), (nodes.ravel(), np.repeat(np.arange(count), ends))),
        shape=(mesh.nvertices, count),
    )
    own = np.searchsorted(boundary, facets)
    corner = np.repeat(own, ends)
    around = at[nodes[own].ravel()].tocoo()
    alike = np.einsum("pi,pi->p", normal[corner[around.row]], normal[around.col]) > ALIKE
    smooth = np.zeros((len(corner), 3))
    np.add.at(smooth, around.row[alike], area[around.col[alike]])
    smooth /= np.linalg.norm(smooth, axis=1)[:, None]
    slopes = smooth.reshape(len(own), ends, 3)
    edges = np.roll(mesh.p.T[nodes[own]], -1, axis=1) - mesh.p.T[nodes[own]]
    turned = np.einsum("fei,fei->fe", np.roll(slopes, -1, axis=1) - slopes, edges)
    # The middle of an arc is an eighth of this above its chord, and the mean over a facet is a
    # third of the sum over its edges.
    return np.asarray(turned.sum(axis=1) / 24.0)


def shape_error_rows(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    pressed: tuple[NDArray[np.int64], Array],
    duals: Array,
) -> tuple[Array, Array, Array]:
    """Return rows, as columns (n, k), (n_heat, k) and (l, k), that give the errors of outputs, m.

    Parameters
    ----------
    structure, spaces, materials
        As for `fesim.solid.recovery.stress_error_rows`.
    pressed : (ndarray of int, ndarray), shapes (f,) and (f, l)
        Facets without other traction than the pressure of each load at factor one, Pa.
    duals : ndarray, shape (n, k)
        Displacements with each output's row as forces, per N.
    """
    facets, pressure = pressed
    mesh = structure.mesh
    off = bulges(mesh, facets)
    size = np.linalg.norm(outward_areas(mesh, facets), axis=1)
    keep = np.abs(off) > FLAT * np.sqrt(size)
    if not keep.any():
        count = duals.shape[1]
        none = np.zeros((pressure.shape[1], count))
        return np.zeros_like(duals), np.zeros((int(spaces.heat.N), count)), none
    facets, pressure, swept = facets[keep], pressure[keep], (off * size)[keep]
    cells = mesh.f2t[0, facets]
    middle = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    moved, heated = stress_rows(structure, spaces, materials, middle, cells)
    stress = (moved @ duals).reshape(len(facets), 6, -1)
    lame, shear, _ = (each[cells] for each in elastic_constants(structure, materials))
    trace = stress[:, :3].sum(axis=1)
    normal = np.array([i == j for i, j in COMPONENTS])
    strain = stress / (2.0 * shear)[:, None, None]
    share = lame / (3.0 * lame + 2.0 * shear) / (2.0 * shear)
    strain[:, normal] -= (share[:, None] * trace)[:, None]
    # In sigma : eps, shears count twice.
    weights = -strain * swept[:, None, None] * np.where(normal, 1.0, 2.0)[:, None]
    flat = weights.reshape(-1, duals.shape[1])
    opened = strain[:, normal].sum(axis=1)
    return moved.T @ flat, heated.T @ flat, -(pressure * swept[:, None]).T @ opened
