"""Hexahedral meshes of parts made of boxes: a tensor grid with the cells outside removed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from skfem import Mesh, MeshHex

from thermojoint.artefacts.errors import InputError

M = TypeVar("M", bound=Mesh)

#: A grid with more cells than this indicates a wrong unit: it would need some 100 GB.
LARGEST_GRID = 20_000_000


@dataclass(frozen=True)
class Box:
    """An axis-parallel box; corners in m."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def holds(self, points: NDArray[np.float64], slack: float = 0.0) -> NDArray[np.bool_]:
        """Return which of `points`, shape (3, n), lie in the box widened by `slack` (m)."""
        low = np.asarray(self.low)[:, None] - slack
        high = np.asarray(self.high)[:, None] + slack
        return np.asarray(((points >= low) & (points <= high)).all(axis=0))


@dataclass(frozen=True)
class Refinement:
    """A box in which elements are smaller; `size` in m."""

    box: Box
    size: float


def grid_lines(
    breaks: Iterable[float], size: float, finer: Iterable[tuple[float, float, float]] = ()
) -> NDArray[np.float64]:
    """Divide the intervals between `breaks` (m) uniformly into pieces of at most `size` (m).

    Parameters
    ----------
    breaks : iterable of float
        Coordinates that become grid lines, m.
    size : float
        Largest piece, m.
    finer : iterable of (float, float, float)
        Low end, high end and size of ranges with smaller pieces, m.

    Raises
    ------
    InputError
        There are more pieces than `LARGEST_GRID`.
    """
    ranges = list(finer)
    breaks = list(breaks)
    if (max(breaks) - min(breaks)) / min([size, *(fine for _, _, fine in ranges)]) > LARGEST_GRID:
        raise InputError(f"box mesh: elements of {size:g} m are too many to mesh; correct the unit")
    ends = [end for low, high, _ in ranges for end in (low, high)]
    stops = np.unique(np.round(np.asarray([*breaks, *ends], dtype=float), 9))
    pieces = []
    for left, right in pairwise(stops):
        middle = (left + right) / 2
        here = min([size, *(fine for low, high, fine in ranges if low < middle < high)])
        count = int(np.ceil((right - left) / here - 1e-9))
        pieces.append(np.linspace(left, right, count + 1)[:-1])
    return np.concatenate([*pieces, stops[-1:]])


def box_mesh(
    solids: Sequence[Box],
    cavities: Sequence[Box],
    breaks: tuple[Iterable[float], Iterable[float], Iterable[float]],
    size: float,
    refinements: Sequence[Refinement] = (),
) -> MeshHex:
    """Mesh the union of `solids` minus the `cavities` with box-shaped hexahedra.

    Parameters
    ----------
    solids, cavities : sequence of Box
        The part; every face of every box becomes a grid plane.
    breaks : three iterables of float
        Further grid planes along x, y and z, m.
    size : float
        Largest element edge, m.
    refinements : sequence of Refinement
        Boxes with smaller elements; their grid lines extend through the whole part.

    Raises
    ------
    InputError
        `size` is not positive, or so small that the grid has more cells than `LARGEST_GRID`.
    """
    for edge in (size, *(fine.size for fine in refinements)):
        if not edge > 0.0:
            raise InputError(f"box mesh: element size {edge} m; give a positive length")
    boxes = [*solids, *cavities]
    lines = [
        grid_lines(
            [*extra, *(b.low[i] for b in boxes), *(b.high[i] for b in boxes)],
            size,
            [(fine.box.low[i], fine.box.high[i], fine.size) for fine in refinements],
        )
        for i, extra in enumerate(breaks)
    ]
    count = math.prod(line.size - 1 for line in lines)
    if count > LARGEST_GRID:
        raise InputError(
            f"box mesh: a grid of {count:.1e} cells is too large; take larger elements"
        )
    grid = MeshHex.init_tensor(*lines)
    centres = grid.p[:, grid.t].mean(axis=1)
    inside = np.any([box.holds(centres) for box in solids], axis=0)
    if cavities:
        inside &= ~np.any([box.holds(centres) for box in cavities], axis=0)
    return grid.restrict(np.flatnonzero(inside))


def put_side_by_side(meshes: Sequence[M]) -> tuple[M, list[NDArray[np.int64]]]:
    """Join meshes of one type without merging nodes, so that a joint between them stays open.

    Returns
    -------
    mesh : skfem.Mesh
        All cells.
    cells : list of ndarray of int
        The cells of each input mesh in the result.
    """
    points = np.hstack([mesh.p for mesh in meshes])
    shifts = np.cumsum([0, *(mesh.p.shape[1] for mesh in meshes)])
    starts = np.cumsum([0, *(mesh.nelements for mesh in meshes)])
    corners = np.hstack([mesh.t + shift for mesh, shift in zip(meshes, shifts, strict=False)])
    cells = [np.arange(a, b) for a, b in pairwise(starts)]
    return type(meshes[0])(points, corners), cells
