"""Data that come out the same on every processor: rounded where no value is near a border.

Computed values differ in their last digits between processors, and one that lies at the border of
two rounded ones would be rounded either way. So the borders of each column lie where the frozen
data leave the widest gap: `offset` puts them there, and is kept with the hash.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Unit at the end of a column's name to the grid that its values are rounded to.
GRIDS = {"s": 1.0, "rpm": 0.1, "degC": 0.01, "um": 0.01}


def grid_of(column: str) -> float:
    """Return the grid of a column by the unit that ends its name."""
    return GRIDS[column.rsplit("_", 1)[1]]


def widest_gap(values: Array, grid: float) -> tuple[float, float]:
    """Return where on a grid cell the values leave the widest gap, and half of its width.

    Parameters
    ----------
    values : ndarray, shape (k,)
        NaN is no value.
    grid : float
        Size of a cell.

    Returns
    -------
    middle, margin : float
        Within [0, grid): the middle of the gap, and how far the nearest value is from it.
    """
    inside = np.sort(np.mod(values[np.isfinite(values)], grid))
    if not inside.size:
        return 0.0, 0.5 * grid
    gaps = np.diff(np.append(inside, inside[0] + grid))
    widest = int(gaps.argmax())
    middle = (inside[widest] + 0.5 * gaps[widest]) % grid
    return float(middle), 0.5 * float(gaps[widest])


def rounded(values: Array, grid: float, border: float) -> Array:
    """Return values rounded to multiples of the grid, shape (k,); cells begin at the border."""
    return np.asarray(grid * np.floor((values - border) / grid + 0.0) + grid)


def as_csv(columns: Mapping[str, Array], borders: Mapping[str, float]) -> str:
    """Return a log as text; an empty cell is a reading that is missing."""
    cells = []
    for name, values in columns.items():
        grid = grid_of(name)
        digits = max(0, -int(np.floor(np.log10(grid))))
        on_grid = rounded(values, grid, borders[name])
        cells.append(["" if np.isnan(v) else f"{v:.{digits}f}" for v in on_grid])
    rows = (",".join(row) for row in zip(*cells, strict=True))
    return "\n".join([",".join(columns), *rows]) + "\n"


def digest(text: str) -> str:
    """Return the hash of a file."""
    return hashlib.sha256(text.encode()).hexdigest()
