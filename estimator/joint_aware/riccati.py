"""The Riccati equation of a steady Kalman filter, solved by doubling.

If the filter is stable, each doubling covers as many steps as all previous ones together, so a
dozen replace the generalised Schur form of a pencil twice as large, in a tenth of the time and with
a smaller residual. The information matrix is the square of a few columns, as readings determine
most modes only in combination; so a doubling takes three products of dense matrices.

References
----------
E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, "Structure-preserving algorithms for periodic
discrete-time algebraic Riccati equations", Int. J. Control 77 (2004) 767-788.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from scipy.linalg import solve_triangular

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Most doublings; the last ones cover more steps than a machine ever makes.
LARGEST_COUNT = 40
#: Accepted change by a doubling, and accepted residual, relative to the covariance.
CHANGE, RESIDUAL = 1e-14, 1e-8
#: Eigenvalues of the information that are rounding, relative to the largest.
TOLD = 1e-15


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
        There is no steady covariance: the readings do not determine the growing states.
    """
    step, told = transition.T, rows.T / np.sqrt(readings)
    noise = covariance = source @ source.T
    # Undetermined states grow with every doubling, until they overflow.
    with np.errstate(over="ignore", invalid="ignore"), suppress(np.linalg.LinAlgError):
        for _ in range(LARGEST_COUNT):
            # Information is C C^T, and 1 + C C^T P is inverted by Woodbury's formula.
            seen = covariance @ told
            root = np.linalg.cholesky(np.eye(told.shape[1]) + told.T @ seen)
            corrected, own = (
                solve_triangular(root, rows_of, lower=True, check_finite=False)
                for rows_of in (seen.T @ step, told.T)
            )
            change = step.T @ (covariance @ step) - corrected.T @ corrected
            covariance = covariance + 0.5 * (change + change.T)
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
            later = step @ own.T
            told = _fewest(np.hstack([told, later]))
            step = step @ step - later @ corrected
    raise ConvergenceError(
        "filter: the Riccati equation has no solution; place a sensor near every source"
    )


def _fewest(columns: Array) -> Array:
    """The fewest columns (n, k) that have the same C C^T, but for rounding."""
    values, turn = np.linalg.eigh(columns.T @ columns)
    return np.asarray(columns @ turn[:, values >= TOLD * values[-1]][:, -len(columns) :])
