"""Solution of dense linear systems in JIT-compiled code: by elimination; large ones by LAPACK.

All systems here are the unit matrix plus contributions of joints, and nearly all can be solved
without exchanging rows. For few equations LAPACK takes twice as long as elimination that only
searches for another row if a pivot is small.

``np.linalg.solve`` does the same in compiled code, but its checks take longer to compile than most
of a march. LAPACK's name in Numba is private: it is used only here, and
`tests/project/test_private_parts.py` lists the assumptions.
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
#: Largest number of equations for our own elimination.
FEW = 128
#: Smallest pivot accepted without searching for a larger one.
LEAST = 1e-3


@compiled_part
def solve(matrix: Array, right_side: Array) -> NDArray[np.floating]:
    """Solve a system (n, n) for a right side (n,).

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular, or a value is not finite.
    """
    size = right_side.size
    columns, found = np.empty((size, size)), right_side.copy()
    # LAPACK uses column order.
    for i in range(size):
        for j in range(size):
            columns[j, i] = matrix[i, j]
    factorise_columns(columns, np.empty(size, np.int32), found)
    return found


@compiled_part
def factorise_columns(columns: Array, pivots: NDArray[np.int32], found: Array) -> None:
    """Solve a system given in column order (n, n) for a right side (n,).

    The solution replaces the right side, and the factors replace the columns, with reciprocals on
    the diagonal; `solve_again` uses them and the pivots (n,).

    Raises
    ------
    numpy.linalg.LinAlgError
        As `solve`.
    """
    size = found.size
    if size <= FEW:
        _solve_few(columns, pivots, found)
    else:
        failed = _gesv(_DOUBLE, size, 1, columns.ctypes, size, pivots.ctypes, found.ctypes, size)
        _check(failed, columns, pivots, found)


@compiled_part
def _solve_few(
    columns: NDArray[np.floating], pivots: NDArray[np.int32], found: NDArray[np.floating]
) -> None:
    """`factorise_columns` by elimination."""
    _eliminate(columns, pivots, _eliminate_fours(columns))
    solve_again(columns, pivots, found)
    _check_finite(found, True)


@compiled_part
def _eliminate_fours(columns: NDArray[np.floating]) -> int:
    """Factorise four columns at a time without pivoting up to a small pivot; return how many.

    The remaining columns are updated two at a time, so that the four are read half as often; slices
    that begin at zero allow vectorised loops.
    """
    size = columns.shape[0]
    for k in range(0, size - 3, 4):
        a, b, c, d = columns[k], columns[k + 1], columns[k + 2], columns[k + 3]
        # The square of the four: reciprocal pivots p, q, r, s.
        p = 1.0 / a[k]
        a1, a2, a3 = p * a[k + 1], p * a[k + 2], p * a[k + 3]
        b0, b1 = b[k], b[k + 1] - a1 * b[k]
        q = 1.0 / b1
        b2, b3 = q * (b[k + 2] - a2 * b0), q * (b[k + 3] - a3 * b0)
        c0, c1 = c[k], c[k + 1] - a1 * c[k]
        c2 = c[k + 2] - a2 * c0 - b2 * c1
        r = 1.0 / c2
        c3 = r * (c[k + 3] - a3 * c0 - b3 * c1)
        d0, d1 = d[k], d[k + 1] - a1 * d[k]
        d2 = d[k + 2] - a2 * d0 - b2 * d1
        s = 1.0 / (d[k + 3] - a3 * d0 - b3 * d1 - c3 * d2)
        if not max(max(abs(p), abs(q)), max(abs(r), abs(s))) * LEAST < 1.0:
            return k
        a[k], a[k + 1], a[k + 2], a[k + 3] = p, a1, a2, a3
        b[k + 1], b[k + 2], b[k + 3] = q, b2, b3
        c[k + 1], c[k + 2], c[k + 3] = c1, r, c3
        d[k + 1], d[k + 2], d[k + 3] = d1, d2, s
        a, b, c, d = a[k + 4 :], b[k + 4 :], c[k + 4 :], d[k + 4 :]
        for i in range(a.size):
            a[i] = p * a[i]
            b[i] = q * (b[i] - b0 * a[i])
            c[i] = r * (c[i] - c0 * a[i] - c1 * b[i])
            d[i] = s * (d[i] - d0 * a[i] - d1 * b[i] - d2 * c[i])
        for j in range(k + 4, size - 1, 2):
            t, u, v, w = _lower(columns, k, j)
            e, f, g, h = _lower(columns, k, j + 1)
            x, y = columns[j, k + 4 :], columns[j + 1, k + 4 :]
            for i in range(x.size):
                first, second, third, fourth = a[i], b[i], c[i], d[i]
                x[i] -= t * first + u * second + v * third + w * fourth
                y[i] -= e * first + f * second + g * third + h * fourth
        if (size - k) % 2 == 1:
            t, u, v, w = _lower(columns, k, size - 1)
            x = columns[size - 1, k + 4 :]
            for i in range(x.size):
                x[i] -= t * a[i] + u * b[i] + v * c[i] + w * d[i]
    return size - size % 4


@compiled_part
def _lower(columns: NDArray[np.floating], k: int, j: int) -> tuple[float, float, float, float]:
    """Four entries of column j after elimination with the four columns from k on."""
    a, b, c, x = columns[k], columns[k + 1], columns[k + 2], columns[j]
    t = x[k]
    u = x[k + 1] - t * a[k + 1]
    v = x[k + 2] - t * a[k + 2] - u * b[k + 2]
    w = x[k + 3] - t * a[k + 3] - u * b[k + 3] - v * c[k + 3]
    x[k + 1], x[k + 2], x[k + 3] = u, v, w
    return t, u, v, w


@compiled_part
def _eliminate(columns: NDArray[np.floating], pivots: NDArray[np.int32], done: int) -> None:
    """Factorise the columns after the first `done`, with partial pivoting."""
    size = columns.shape[0]
    for k in range(done):
        pivots[k] = k + 1
    for k in range(done, size):
        best = k
        for i in range(k + 1, size):
            if abs(columns[k, i]) > abs(columns[k, best]):
                best = i
        pivots[k] = best + 1
        if best > k:
            for j in range(size):
                columns[j, k], columns[j, best] = columns[j, best], columns[j, k]
        columns[k, k] = 1.0 / columns[k, k]
        for i in range(k + 1, size):
            columns[k, i] *= columns[k, k]
        for j in range(k + 1, size):
            for i in range(k + 1, size):
                columns[j, i] -= columns[j, k] * columns[k, i]


@compiled_part
def factorise_single(
    columns: NDArray[np.float32], pivots: NDArray[np.int32], found: NDArray[np.float32]
) -> None:
    """`factorise_columns` in single precision."""
    size = found.size
    if size <= FEW:
        _solve_few(columns, pivots, found)
    else:
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
    for k in range(found.size):
        # `solve_again` divides by it.
        columns[k, k] = 1.0 / columns[k, k]
    # Naming the arrays here keeps them alive until LAPACK has finished.
    _check_finite(found, failed == 0 and columns.size + pivots.size > 0)


@compiled_part
def _check_finite(found: NDArray[np.floating], solved: bool) -> None:
    for k in range(found.size):
        solved = solved and np.isfinite(found[k])
    if not solved:
        raise np.linalg.LinAlgError("the matrix is singular, or something is not finite")


@compiled_part
def solve_again(
    columns: NDArray[np.floating], pivots: NDArray[np.int32], found: NDArray[np.floating]
) -> None:
    """Solve for another right side (n,), in place, with factors of either precision.

    Four columns at a time: the right side is read and written once for all four.
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
        rest, a, b, c, d = found[j + 4 :], a[j + 4 :], b[j + 4 :], c[j + 4 :], d[j + 4 :]
        for i in range(rest.size):
            rest[i] -= p * a[i] + q * b[i] + r * c[i] + s * d[i]
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
