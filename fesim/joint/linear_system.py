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
    size = found.size
    if size == 0:
        return
    pivots = np.empty(size, np.int32)
    failed = _gesv(_DOUBLE, size, 1, columns.ctypes, size, pivots.ctypes, found.ctypes, size)
    finite = failed == 0
    for i in range(size):
        finite = finite and np.isfinite(found[i])
    # To name the arrays here keeps them until LAPACK is done with them.
    if not finite or columns.size + pivots.size < 0:
        raise np.linalg.LinAlgError("the matrix is singular, or something is not finite")
