"""Maps of cells from reference coordinates to space, with each derivative evaluated once.

scikit-fem evaluates all functions of a cell again for each of the nine entries of a gradient, and
inverts it for each function of a basis; it searches for the points of a facet twice, and keeps
every gradient for the lifetime of the mesh. Here those of one set of points are evaluated together,
in the same order and bit-identical, and only the last ones are kept.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import numpy as np
from numpy.typing import NDArray
from skfem import Mesh
from skfem.mapping import Mapping, MappingIsoparametric

from thermojoint.artefacts.arrays import Array

#: Indices of the cells that a map is applied to.
Cells = NDArray[np.int64] | None

#: Last step of Newton's method towards a point of a cell, relative to the cell; the error after it
#: is far smaller. Thin cells far from the origin are rounded by more than scikit-fem's 1e-12.
LAST_STEP = 1e-9

_Method = Callable[[MappingIsoparametric, Array, Cells], Array]


def _last_kept(method: _Method) -> Callable[..., Array]:
    """Method that returns its last array again for the same points and cells."""
    place = f"_last_{method.__name__}"

    @wraps(method)
    def looked_up(self: MappingIsoparametric, points: Array, tind: Cells = None) -> Array:
        key = points.shape, points.tobytes(), None if tind is None else tind.tobytes()
        last: tuple[object, Array] = getattr(self, place, (None, np.empty(0)))
        if last[0] != key:
            last = key, method(self, points, tind)
            setattr(self, place, last)
        return last[1]

    return looked_up


class _Isoparametric(MappingIsoparametric):
    invDF = _last_kept(MappingIsoparametric.invDF)

    @_last_kept
    def invF(self, x: Array, tind: Cells = None) -> Array:
        """Return the points of cells at positions x, m."""
        return np.asarray(super().invF(x, tind, newton_tol=LAST_STEP))

    def J(self, i: int, j: int, X: Array, tind: Cells = None) -> Array:
        """Return entry (i, j) of the gradient at points X of the cells."""
        return np.asarray(self._gradient(X, tind)[i, j])

    @_last_kept
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
        """Return the positions (3, cells, points) of points X of the cells, m."""
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
