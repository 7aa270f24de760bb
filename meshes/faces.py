"""Faces of a mesh as polygons, for pictures."""

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
