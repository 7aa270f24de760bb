"""Maps of cells from their own coordinates to space, with each derivative evaluated once.

scikit-fem evaluates all functions of a cell anew for each of the nine entries of a gradient, and
keeps every gradient for as long as the mesh lives. Here those of one set of points are evaluated
together, in the same order and to the same bit, and only the last ones are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skfem import Mesh
from skfem.mapping import Mapping, MappingIsoparametric

from thermojoint.artefacts.arrays import Array

#: Cells whose numbers a map takes.
Cells = NDArray[np.int64] | None


class _Isoparametric(MappingIsoparametric):
    _last: tuple[object, Array] = (None, np.empty(0))

    def J(self, i: int, j: int, X: Array, tind: Cells = None) -> Array:
        """Return entry (i, j) of the gradient at points X of the cells."""
        key = X.shape, X.tobytes(), None if tind is None else tind.tobytes()
        if self._last[0] != key:
            self._last = key, self._gradient(X, tind)
        return self._last[1][i, j]

    def _gradient(self, points: Array, cells: Cells) -> Array:
        nodes = self.mesh.dofs.element_dofs
        nodes = nodes if cells is None else nodes[:, cells]
        gradient = np.zeros((3, 3, nodes.shape[1], points.shape[-1]))
        for k, own in enumerate(nodes):
            slope = np.broadcast_to(self.elem.lbasis(points, k)[1], points.shape)
            by_cell = slope if slope.ndim == 3 else slope[:, None]
            gradient += self.mesh.doflocs[:, own][:, None, :, None] * by_cell
        return gradient

    def F(self, X: Array, tind: Cells = None) -> Array:
        """Return the places (3, cells, points) of points X of the cells, m."""
        nodes = self.mesh.dofs.element_dofs
        nodes = nodes if tind is None else nodes[:, tind]
        places = np.zeros((3, nodes.shape[1], X.shape[-1]))
        for k, own in enumerate(nodes):
            places += self.mesh.doflocs[:, own][:, :, None] * self.elem.lbasis(X, k)[0]
        return places


def cell_maps(mesh: Mesh) -> Mapping:
    """Return the maps of a mesh's cells; affine ones are scikit-fem's own."""
    maps = mesh.mapping()
    if not isinstance(maps, MappingIsoparametric):
        return maps
    return _Isoparametric(mesh, maps.elem, maps.bndelem)
