"""Linear least squares, ordinary or with a ridge penalty."""

from __future__ import annotations

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Combinations of features smaller than this, relative to the largest, get no weight without a
#: penalty: neighbouring temperature samples are similar, and their differences are rounding.
LEAST = 1e-6


def linear_weights(features: Array, target: Array) -> Array:
    """Return the weights w that minimise |features w - target|².

    Parameters
    ----------
    features : ndarray, shape (k, n)
    target : ndarray, shape (k,) or (k, m)

    Returns
    -------
    ndarray, shape (n,) or (n, m)
    """
    return np.asarray(np.linalg.lstsq(features, target, rcond=LEAST)[0])


def ridge_weights(features: Array, target: Array, penalty: float) -> Array:
    """Return the weights w that minimise |features w - target|² + penalty |w|².

    Parameters
    ----------
    features, target
        As for `linear_weights`.
    penalty : float
        Positive.
    """
    left, sizes, right = np.linalg.svd(features, full_matrices=False)
    return np.asarray((right.T * (sizes / (sizes**2 + penalty))) @ (left.T @ target))
