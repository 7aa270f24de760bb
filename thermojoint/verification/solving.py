"""Solution of linear systems with prescribed unknowns; all roots of a function on a grid."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.sparse import csr_array

from fesim.solid.linear_solver import checked_solve, factorise
from thermojoint.artefacts.arrays import Array


def solve_given(
    matrix: csr_array, load: Array, given: NDArray[np.int64], values: Array | float, what: str
) -> Array:
    """Solve matrix x = load for the unknowns that are not given, shape (n,).

    On these the matrix is symmetric and positive definite. `given` are the numbers of the others,
    shape (g,), `values` their values; their rows of the load are not used.
    """
    solution = np.zeros(matrix.shape[0])
    solution[given] = values
    free = np.setdiff1d(np.arange(matrix.shape[0]), given)
    rows = csr_array(matrix)[free]
    right = load[free] - rows @ solution
    solution[free] = checked_solve(factorise(rows[:, free], what), right, what)
    return solution


def roots_on(
    grid: Iterable[float], function: Callable[[float], float], **tolerances: float
) -> list[float]:
    """Return the roots between neighbours of a grid where the sign of a function changes."""
    values = [(float(at), function(float(at))) for at in grid]
    return [
        brentq(function, low, high, **tolerances)
        for (low, before), (high, after) in pairwise(values)
        if before * after < 0.0
    ]
