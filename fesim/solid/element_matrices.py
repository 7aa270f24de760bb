"""Element matrices of isotropic thermoelasticity, computed in batches, and their assembly.

Every cell has the same functions at the same reference points: with their gradients side by side in
one array, the element matrices are one batched product. They are summed at positions that are
sorted once, so that no entry is stored twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skfem import Mesh
from skfem.element import Element

from thermojoint.artefacts.arrays import Array

#: Cells per batch of element matrices; a larger batch only needs more memory.
AT_ONCE = 1024


@dataclass(frozen=True)
class Places:
    """Positions of element-matrix entries in a CSR matrix."""

    #: Shape (e,): order of the entries by their places.
    order: NDArray[np.int64]
    #: Shape (p,): index of the first one, in that order, at each place.
    first: NDArray[np.int64]
    #: Shapes (p,) and (rows + 1,): column of each place, and the first place of each row.
    indices: NDArray[np.int32]
    indptr: NDArray[np.integer]

    def sums(self, entries: Array) -> Array:
        """Add up entries, any shape of size e, at their places, shape (p,)."""
        return np.asarray(np.add.reduceat(entries.reshape(-1)[self.order], self.first))


def places_of(
    rows: NDArray[np.int64], columns: NDArray[np.int64], shape: tuple[int, int]
) -> Places:
    """Sort the positions of entries.

    Parameters
    ----------
    rows, columns : ndarray of int, any equal shape
        Row and column of each entry; there is one or more.
    shape : (int, int)
        Shape of the matrix.
    """
    place = (rows.astype(np.int64) * shape[1] + columns).reshape(-1)
    order = np.argsort(place)
    place = place[order]
    first = np.flatnonzero(np.concatenate([[True], place[1:] != place[:-1]]))
    row, column = np.divmod(place[first], shape[1])
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=shape[0]))])
    # If one index array of a matrix has 64 bits, all have.
    if first.size <= np.iinfo(np.int32).max:
        indptr = indptr.astype(np.int32)
    return Places(order, first, column.astype(np.int32), indptr)


@dataclass(frozen=True)
class CellGradients:
    """Gradients on the quadrature points of some cells."""

    #: Shape (cells, functions, 3, points): gradient of each shape function, 1/m.
    gradient: Array
    #: Shape (cells, points): weight of each point, m3.
    volume: Array

    def stiffness(
        self, lame: Array, shear: Array, pairs: tuple[NDArray[np.intp], NDArray[np.intp]]
    ) -> Array:
        """Return entries (3, 3, pairs, cells) of (sigma(u), eps(v)), N/m.

        Entry (i, j) of a pair (a, b) is the force along i at a due to a displacement along j at b.

        Parameters
        ----------
        lame, shear : ndarray, shape (cells,)
            Lamé's parameters, Pa.
        pairs : (ndarray of int, ndarray of int), shape (pairs,)
            Functions a and b.
        """
        cells, functions, _, points = self.gradient.shape
        flat = self.gradient.reshape(cells, 3 * functions, points)
        weighted = flat * self.volume[:, None]
        products = (weighted @ flat.transpose(0, 2, 1)).reshape(cells, functions, 3, functions, 3)
        both = products[:, pairs[0], :, pairs[1], :].transpose(2, 3, 0, 1)
        entries = lame * both + shear * both.transpose(1, 0, 2, 3)
        trace = shear * (both[0, 0] + both[1, 1] + both[2, 2])
        for i in range(3):
            entries[i, i] += trace
        return np.asarray(entries)

    def expansion(self, bulk: Array, shapes: Array) -> Array:
        """Return entries (3, functions, heat functions, cells) of (bulk T, div v), N/K.

        Parameters
        ----------
        bulk : ndarray, shape (cells,)
            (3 lambda + 2 mu) alpha, Pa/K.
        shapes : ndarray, shape (heat functions, points)
            Shape functions of the temperature.
        """
        weighted = self.gradient * (bulk[:, None] * self.volume)[:, None, None]
        return np.asarray((weighted @ shapes.T).transpose(2, 1, 3, 0))


def reference_shapes(element: Element, points: Array, count: int) -> tuple[Array, Array]:
    """Values (count, q) and gradients (count, 3, q) of element functions at reference points."""
    each = [element.lbasis(points, i) for i in range(count)]
    values = np.array([np.broadcast_to(value, points.shape[1:]) for value, _ in each])
    slopes = np.array([np.broadcast_to(slope, points.shape) for _, slope in each])
    return values, slopes


def cell_gradients(
    mesh: Mesh,
    element: Element,
    quadrature: tuple[Array, Array],
    cells: NDArray[np.int64],
    order: NDArray[np.int64] | None = None,
) -> Iterator[tuple[slice, CellGradients]]:
    """Yield the gradients of `AT_ONCE` cells at a time, and the slice of these cells.

    Parameters
    ----------
    mesh : skfem.Mesh
        Any mesh; curved cells use the map of their own geometry.
    element : skfem.Element
        A scalar element.
    quadrature : (ndarray, ndarray), shapes (3, q) and (q,)
        Points and weights of the reference cell.
    cells : ndarray of int, shape (c,)
        The cells.
    order : ndarray of int, shape (functions, c), optional
        Order of each cell's functions in the result; default that of the element.
    """
    points, weights = quadrature
    corners = mesh.dofs.element_dofs
    _, geometry = reference_shapes(mesh.elem(), points, len(corners))
    _, slopes = reference_shapes(element, points, len(element.doflocs))
    for start in range(0, len(cells), AT_ONCE):
        part = slice(start, min(start + AT_ONCE, len(cells)))
        places = mesh.doflocs[:, corners[:, cells[part]]]
        # Column j of the map's gradient: (3, cells, points) each.
        first, second, third = np.einsum("ivc,vjq->jicq", places, geometry, optimize=True)
        rows = np.array(
            [
                np.cross(second, third, axis=0),
                np.cross(third, first, axis=0),
                np.cross(first, second, axis=0),
            ]
        )
        volume = (first * rows[0]).sum(axis=0)
        inverse = rows / volume
        gradient = np.einsum("fjq,jicq->cfiq", slopes, inverse, optimize=True)
        if order is not None:
            gradient = np.take_along_axis(gradient, order[:, part].T[:, :, None, None], axis=1)
        yield part, CellGradients(np.ascontiguousarray(gradient), np.abs(volume) * weights)
