"""Shape quality of cells: 1 is ideal, 0 is flat, negative is inverted."""

from __future__ import annotations

import numpy as np
from skfem import CellBasis, ElementHex0, ElementTetP0, Mesh

from thermojoint.artefacts.arrays import Array


def cell_quality(mesh: Mesh) -> Array:
    """Return the quality of every cell from its corners, shape (cells,).

    Hexahedra: scaled Jacobian, the smallest over the corners of the volume spanned by the three
    unit edges. Tetrahedra: three times the radius of the inscribed sphere over that of the
    circumscribed one.
    """
    corners = mesh.p[:, mesh.t].transpose(2, 1, 0)
    return _scaled_jacobian(corners, mesh) if mesh.t.shape[0] == 8 else _radius_ratio(corners)


def cell_volumes(mesh: Mesh) -> Array:
    """Return the volume of every cell, including curvature, shape (cells,), m3."""
    element = ElementHex0() if mesh.t.shape[0] == 8 else ElementTetP0()
    return np.asarray(CellBasis(mesh, element, intorder=6).dx.sum(axis=1))


def _scaled_jacobian(corners: Array, mesh: Mesh) -> Array:
    places = np.round(mesh.elem.refdom.p.T).astype(int)
    at = {tuple(place): i for i, place in enumerate(places)}
    volumes = []
    for i, place in enumerate(places):
        edges = []
        for axis in range(3):
            other = list(place)
            other[axis] = 1 - other[axis]
            edge = corners[:, at[tuple(other)]] - corners[:, i]
            edge = edge * (1.0 if place[axis] == 0 else -1.0)
            edges.append(edge / np.linalg.norm(edge, axis=1, keepdims=True))
        volumes.append(np.einsum("ci,ci->c", edges[0], np.cross(edges[1], edges[2])))
    jacobians = np.array(volumes)
    # The orientation of the corners is a convention: the sign of most corners is taken as valid.
    return np.asarray((jacobians * np.sign(jacobians.sum(axis=0))).min(axis=0))


def _radius_ratio(corners: Array) -> Array:
    a, b, c, d = corners.transpose(1, 0, 2)

    def length(edge: Array) -> Array:
        return np.asarray(np.linalg.norm(edge, axis=1))

    volume = np.abs(np.einsum("ci,ci->c", b - a, np.cross(c - a, d - a))) / 6.0
    faces = [(a, b, c), (a, b, d), (a, c, d), (b, c, d)]
    area = sum(0.5 * length(np.cross(q - p, r - p)) for p, q, r in faces)
    x, y, z = (
        length(b - a) * length(d - c),
        length(c - a) * length(d - b),
        length(d - a) * length(c - b),
    )
    product = (x + y + z) * (x + y - z) * (x - y + z) * (-x + y + z)
    around = np.sqrt(np.maximum(product, 0.0)) / (24.0 * volume)
    return np.asarray(3.0 * (3.0 * volume / area) / around)
