"""Solution of linear systems with prescribed unknowns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fesim.solid.linear_solver import checked_solve, factorise
from thermojoint.artefacts.arrays import Array


def solve_given(
    matrix: csr_array, load: Array, given: NDArray[np.int64], values: Array | float, what: str
) -> Array:
    """Solve matrix x = load for the unknowns that are not given.

    Parameters
    ----------
    matrix : scipy.sparse.csr_array, shape (n, n)
        Symmetric; positive definite on the unknowns that are not given.
    load : ndarray, shape (n,)
        Right-hand side; the rows of the given unknowns are not used.
    given : ndarray of int, shape (g,)
        Unknowns whose value is known.
    values : ndarray, shape (g,), or float
        Their values.
    what : str
        Name for error messages.

    Returns
    -------
    ndarray, shape (n,)
    """
    solution = np.zeros(matrix.shape[0])
    solution[given] = values
    free = np.setdiff1d(np.arange(matrix.shape[0]), given)
    rows = csr_array(matrix)[free]
    right = load[free] - rows @ solution
    solution[free] = checked_solve(factorise(rows[:, free], what), right, what)
    return solution
