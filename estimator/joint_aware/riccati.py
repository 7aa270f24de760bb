"""The Riccati equation of a steady Kalman filter, solved by doubling.

Where the filter is stable each doubling stands for as many steps of it as all before together, so
a dozen products of dense matrices replace the generalised Schur form of a pencil twice as large:
a fifth of the time, and a smaller residual.

References
----------
E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, "Structure-preserving algorithms for periodic
discrete-time algebraic Riccati equations", Int. J. Control 77 (2004) 767-788.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Doublings; the last ones stand for more steps than a machine ever makes.
LARGEST_COUNT = 40
#: Accepted change by a doubling, and accepted residual, relative to the covariance.
CHANGE, RESIDUAL = 1e-14, 1e-9


def predicted_covariance(transition: Array, rows: Array, source: Array, readings: Array) -> Array:
    """Return the steady covariance P before a reading.

    P = F (P - P H^T (H P H^T + R)^-1 H P) F^T + Q, with Q = G G^T.

    Parameters
    ----------
    transition : ndarray, shape (n, n)
        F, from one step to the next.
    rows : ndarray, shape (p, n)
        H, the readings of a state.
    source : ndarray, shape (n, m)
        G, the state's change by a unit of every noise.
    readings : ndarray, shape (p,)
        Variances of the readings' noise, the diagonal of R.

    Raises
    ------
    ConvergenceError
        There is no steady covariance: the readings do not determine what grows.
    """
    size = len(transition)
    step = transition.T
    information = rows.T @ (rows / readings[:, None])
    noise = covariance = source @ source.T
    # What is not determined grows with every doubling, until it is no number.
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(LARGEST_COUNT):
            factor = lu_factor(
                np.eye(size) + information @ covariance, check_finite=False, overwrite_a=True
            )
            solved = lu_solve(factor, np.hstack([step, information]), check_finite=False)
            change = step.T @ covariance @ solved[:, :size]
            information = _symmetric(information + step @ solved[:, size:] @ step.T)
            covariance = _symmetric(covariance + change)
            step = step @ solved[:, :size]
            largest = np.abs(covariance).max()
            if not np.isfinite(largest):
                break
            if np.abs(change).max() <= CHANGE * largest:
                gain = covariance @ rows.T
                kept = np.linalg.solve(rows @ gain + np.diag(readings), gain.T)
                again = transition @ (covariance - gain @ kept) @ transition.T + noise
                if np.abs(again - covariance).max() <= RESIDUAL * largest:
                    return covariance
                break
    raise ConvergenceError(
        "filter: the Riccati equation has no solution; place a sensor near every source"
    )


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))
