"""Tables of position: a CSV with some of the columns ``x_mm, y_mm, z_mm`` and one of values."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from thermojoint.artefacts.arrays import Array, OfPosition
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.tables.columns import read_columns

COLUMNS = ("x_mm", "y_mm", "z_mm")


def read_position_table(path: Path, column: str) -> OfPosition:
    """Read a table whose rows are the points of a grid, in any order.

    A table is interpolated linearly along each axis and constant beyond its ends. It does not
    depend on a coordinate without a column or with a single value.

    Parameters
    ----------
    path : Path
        CSV with one or more of `COLUMNS`, mm, and `column`.
    column : str
        Name of the values.

    Raises
    ------
    UnreadableError
        The file is missing or cannot be opened.
    InputError
        A column is missing, a value is not finite, or the points are not a grid.
    """
    columns = read_columns(path, (column,), "table", COLUMNS)
    axes = [(number, name) for number, name in enumerate(COLUMNS) if name in columns]
    values = columns[column]
    if not axes or not values.size:
        raise InputError(f"{path}: needs rows, and one or more of the columns {', '.join(COLUMNS)}")
    if not np.isfinite(list(columns.values())).all():
        raise InputError(f"{path}: a value is not finite; remove or correct it")
    lines, at = zip(
        *(np.unique(columns[name], return_inverse=True) for _, name in axes), strict=True
    )
    shape = tuple(len(line) for line in lines)
    flat = np.ravel_multi_index(at, shape)
    if len(flat) != np.prod(shape) or len(np.unique(flat)) != len(flat):
        named = ", ".join(name for _, name in axes)
        raise InputError(
            f"{path}: {len(flat)} rows are not a grid of {' x '.join(map(str, shape))} values of "
            f"{named}; give every combination once"
        )
    grid = np.empty(shape)
    grid.flat[flat] = values
    varying = [k for k, line in enumerate(lines) if len(line) > 1]
    if not varying:
        return lambda points: np.full(points.shape[1:], values[0])
    from scipy.interpolate import RegularGridInterpolator  # it loads scipy.optimize

    table = RegularGridInterpolator([1e-3 * lines[k] for k in varying], grid.squeeze())
    numbers = [axes[k][0] for k in varying]

    def at_points(points: Array) -> Array:
        inside = [
            np.clip(points[number], line[0], line[-1])
            for number, line in zip(numbers, table.grid, strict=True)
        ]
        return np.asarray(table(np.stack(inside, axis=-1)))

    return at_points
