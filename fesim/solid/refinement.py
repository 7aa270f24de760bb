"""Solutions in double precision from factors in single precision.

Conjugate gradients for every column, with the factors as preconditioner: if a solution with the
factors leaves a thousandth of the error, so does each iteration; if it leaves more, an iteration
leaves less than a plain correction by the residual.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Largest residual left, relative to its right-hand side. Solutions then agree with those by a
#: factor in double precision to about 1e-10 of the largest.
LEFT = 1e-9
#: Most iterations.
MOST = 20


def refined(
    product: Callable[[Array], Array],
    rough: Callable[[Array], Array],
    right_side: Array,
) -> Array | None:
    """Solve A X = B for a symmetric positive definite A; None if the iteration does not converge.

    Parameters
    ----------
    product : callable
        From X (n, k) to A X, stored like X in column order.
    rough : callable
        From B (n, k) to a rough solution, by a symmetric positive definite matrix.
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
        # A column with zero residual does not change.
        length = np.divide(steep, curved, out=np.zeros_like(steep), where=steep != 0.0)
        solution += length * direction
        residual -= length * answer
        if (np.abs(residual).max(axis=0, initial=0.0) <= enough).all():
            return solution.reshape(right_side.shape)
        before = np.where(steep != 0.0, steep, np.inf)
    return None


def _products(left: Array, right: Array) -> Array:
    return np.array([one @ other for one, other in zip(left.T, right.T, strict=True)])
