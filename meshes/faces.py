"""Faces of a mesh: as polygons, for pictures, and by their nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skfem import Mesh


def boundary_faces(mesh: Mesh, facets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Vertices of boundary `facets` in order around each, shape (m, 3 or 4)."""
    cells = mesh.f2t[0, facets]
    local = np.argmax(mesh.t2f[:, cells] == facets, axis=0)
    corners = np.array(mesh.elem.refdom.facets)
    return np.asarray(mesh.t[corners[local].T, cells].T, dtype=np.int64)


def triangles_of(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles that fan out from the first corner of every face, shape (m (c - 2), 3).

    Parameters
    ----------
    faces : ndarray of int, shape (m, c)
        Corners in order around each face, which is convex.
    """
    fans = [faces[:, [0, k, k + 1]] for k in range(1, faces.shape[1] - 1)]
    return np.stack(fans, axis=1).reshape(-1, 3)


def rows_in(table: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Index in `table` of each of `rows`, with numbers in any order; -1 if it is missing."""
    both = np.vstack([np.sort(table, axis=1), np.sort(rows, axis=1)])
    _, key = np.unique(both, axis=0, return_inverse=True)
    key = key.ravel()
    place = np.full(key.max() + 1, -1)
    place[key[: len(table)]] = np.arange(len(table))
    return place[key[len(table) :]]
