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
_gesv_single = _LAPACK().numba_xgesv(types.float32)
#: Numba's letters for double and single precision.
_DOUBLE, _SINGLE = ord("d"), ord("s")


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
    factorise_columns(columns, np.empty(size, np.int32), found)
    return found


@compiled_part
def factorise_columns(columns: Array, pivots: NDArray[np.int32], found: Array) -> None:
    """Solve a system given column after column (n, n) for a right side (n,).

    The solution takes the place of the right side, factors that of the columns, with reciprocals on
    the diagonal; `solve_again` takes them and the pivots (n,).

    Raises
    ------
    numpy.linalg.LinAlgError
        As `solve`.
    """
    size = found.size
    if size:
        failed = _gesv(_DOUBLE, size, 1, columns.ctypes, size, pivots.ctypes, found.ctypes, size)
        _check(failed, columns, pivots, found)


@compiled_part
def factorise_single(
    columns: NDArray[np.float32], pivots: NDArray[np.int32], found: NDArray[np.float32]
) -> None:
    """`factorise_columns` in single precision."""
    size = found.size
    if size:
        failed = _gesv_single(
            _SINGLE, size, 1, columns.ctypes, size, pivots.ctypes, found.ctypes, size
        )
        _check(failed, columns, pivots, found)


@compiled_part
def _check(
    failed: int,
    columns: NDArray[np.floating],
    pivots: NDArray[np.int32],
    found: NDArray[np.floating],
) -> None:
    finite = failed == 0
    for k in range(found.size):
        finite = finite and np.isfinite(found[k])
        # `solve_again` divides by it.
        columns[k, k] = 1.0 / columns[k, k]
    # To name the arrays here keeps them until LAPACK is done with them.
    if not finite or columns.size + pivots.size < 0:
        raise np.linalg.LinAlgError("the matrix is singular, or something is not finite")


@compiled_part
def solve_again(
    columns: NDArray[np.floating], pivots: NDArray[np.int32], found: NDArray[np.floating]
) -> None:
    """Solve for another right side (n,), in place, by factors of either precision.

    Four columns at a time: the right side is read and written once for them.
    """
    size, fours = found.size, found.size - found.size % 4
    for i in range(size):
        other = pivots[i] - 1
        found[i], found[other] = found[other], found[i]
    for j in range(0, fours, 4):
        a, b, c, d = columns[j], columns[j + 1], columns[j + 2], columns[j + 3]
        p = found[j]
        q = found[j + 1] - a[j + 1] * p
        r = found[j + 2] - a[j + 2] * p - b[j + 2] * q
        s = found[j + 3] - a[j + 3] * p - b[j + 3] * q - c[j + 3] * r
        found[j + 1], found[j + 2], found[j + 3] = q, r, s
        for i in range(j + 4, size):
            found[i] -= p * a[i] + q * b[i] + r * c[i] + s * d[i]
    for j in range(fours, size):
        for i in range(j + 1, size):
            found[i] -= columns[j, i] * found[j]
    for j in range(size - 1, fours - 1, -1):
        found[j] *= columns[j, j]
        for i in range(j):
            found[i] -= columns[j, i] * found[j]
    for j in range(fours - 4, -1, -4):
        a, b, c, d = columns[j], columns[j + 1], columns[j + 2], columns[j + 3]
        s = found[j + 3] * d[j + 3]
        r = (found[j + 2] - d[j + 2] * s) * c[j + 2]
        q = (found[j + 1] - d[j + 1] * s - c[j + 1] * r) * b[j + 1]
        p = (found[j] - d[j] * s - c[j] * r - b[j] * q) * a[j]
        found[j], found[j + 1], found[j + 2], found[j + 3] = p, q, r, s
        for i in range(j):
            found[i] -= p * a[i] + q * b[i] + r * c[i] + s * d[i]
