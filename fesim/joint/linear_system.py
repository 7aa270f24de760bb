"""Solution of a dense linear system in JIT-compiled code, by LAPACK as Numba links it.

``np.linalg.solve`` does the same in compiled code. Its checks take longer to compile than most of a
march, and its copies a sixth of the time where 50 equations are solved. LAPACK's name in Numba is
private: it is used here alone, and `tests/project/test_private_parts.py` says what is relied on.
"""

from __future__ import annotations

import numpy as np
from numba import types
from numba.np.linalg import _LAPACK
from numpy.typing import NDArray

from fesim.jit import compiled_part
from thermojoint.artefacts.arrays import Array

_gesv = _LAPACK().numba_xgesv(types.float64)
#: Numba's letter for double precision.
_DOUBLE = ord("d")


@compiled_part
def solve(matrix: Array, right_side: Array) -> NDArray[np.floating]:
    """Solve a system (n, n) for a right side (n,).

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular, or something is not finite.
    """
    size = right_side.size
    columns, found = np.empty((size, size)), right_side.copy()
    # LAPACK counts along columns.
    for i in range(size):
        for j in range(size):
            columns[j, i] = matrix[i, j]
    solve_columns(columns, found)
    return found


@compiled_part
def solve_columns(columns: Array, found: Array) -> None:
    """Solve a system given column after column (n, n) for a right side (n,).

    The solution takes the place of the right side, factors that of the columns.

    Raises
    ------
    numpy.linalg.LinAlgError
        As `solve`.
    """
    factorise_columns(columns, np.empty(found.size, np.int32), found)


@compiled_part
def factorise_columns(columns: Array, pivots: NDArray[np.int32], found: Array) -> None:
    """As `solve_columns`, with the pivots (n,) that `solve_again` takes beside the factors."""
    size = found.size
    if size == 0:
        return
    failed = _gesv(_DOUBLE, size, 1, columns.ctypes, size, pivots.ctypes, found.ctypes, size)
    finite = failed == 0
    for i in range(size):
        finite = finite and np.isfinite(found[i])
    # To name the arrays here keeps them until LAPACK is done with them.
    if not finite or columns.size + pivots.size < 0:
        raise np.linalg.LinAlgError("the matrix is singular, or something is not finite")


@compiled_part
def solve_again(columns: Array, pivots: NDArray[np.int32], found: Array) -> None:
    """Solve for another right side (n,), in place, by the factors of `factorise_columns`."""
    size = found.size
    for i in range(size):
        other = pivots[i] - 1
        found[i], found[other] = found[other], found[i]
    for j in range(size):
        column, own = columns[j], found[j]
        for i in range(j + 1, size):
            found[i] -= column[i] * own
    for j in range(size - 1, -1, -1):
        column = columns[j]
        found[j] /= column[j]
        own = found[j]
        for i in range(j):
            found[i] -= column[i] * own
