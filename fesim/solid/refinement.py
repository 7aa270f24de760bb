"""Solutions in double precision by factors in single precision.

The conjugate gradients of every column, with the factors as preconditioner: where these leave a
thousandth of the error, so does each iteration, and where they leave more, less of it than a plain
correction by the residual would.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thermojoint.artefacts.arrays import Array

#: What may be left of a residual, relative to its right-hand side. Solutions then agree with
#: those by a factor of double precision to about 1e-10 of the largest.
LEFT = 1e-9
#: Most iterations.
MOST = 20


def refined(
    product: Callable[[Array], Array],
    rough: Callable[[Array], Array],
    right_side: Array,
) -> Array | None:
    """Solve A X = B for a symmetric positive definite A; None if that does not converge.

    Parameters
    ----------
    product : callable
        X (n, k) to A X, stored as X is: one column after the other.
    rough : callable
        B (n, k) to a rough solution, by a symmetric positive definite matrix.
    right_side : ndarray, shape (n,) or (n, k)
        B.

    Returns
    -------
    ndarray, of the same shape, or None
    """
    residual = np.array(right_side.reshape(len(right_side), -1), order="F", dtype=np.float64)
    solution, direction = np.zeros_like(residual), np.zeros_like(residual)
    before = np.full(residual.shape[1], np.inf)
    enough = LEFT * np.abs(residual).max(axis=0, initial=0.0)
    for _ in range(MOST):
        corrected = rough(residual)
        steep = _products(residual, corrected)
        direction *= steep / before
        direction += corrected
        answer = product(direction)
        curved = _products(direction, answer)
        # A column whose residual is zero stays as it is.
        length = np.divide(steep, curved, out=np.zeros_like(steep), where=steep != 0.0)
        solution += length * direction
        residual -= length * answer
        if (np.abs(residual).max(axis=0, initial=0.0) <= enough).all():
            return solution.reshape(right_side.shape)
        before = np.where(steep != 0.0, steep, np.inf)
    return None


def _products(left: Array, right: Array) -> Array:
    return np.array([one @ other for one, other in zip(left.T, right.T, strict=True)])
