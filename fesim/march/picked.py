"""JIT-compiled products with some rows of a matrix.

A step needs a fifth of the rows of a moving machine. Copying them for a product takes longer than a
product with all rows; here they are read in place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled
from thermojoint.artefacts.arrays import Array


@compiled
def product_of(matrix: Array, rows: NDArray[np.int64], vector: Array) -> Array:
    """Return some rows (k,) of a matrix (q, n), whose rows are contiguous, times a vector (n,)."""
    found = np.empty(rows.size)
    for i in range(rows.size):
        found[i] = np.dot(matrix[rows[i]], vector)
    return found


@compiled
def sum_of(matrix: Array, rows: NDArray[np.int64], weights: Array) -> Array:
    """Return the sum (n,) of some rows (k,) of a matrix (q, n) with weights (k,)."""
    total = np.zeros(matrix.shape[1])
    for i in range(rows.size):
        row, weight = matrix[rows[i]], weights[i]
        for j in range(total.size):
            total[j] += weight * row[j]
    return total
