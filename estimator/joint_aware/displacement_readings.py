"""A reading of the displacement itself, a touch probe's, as one more measurement.

What the temperatures leave open in the displacement has two parts: what the state is not known to
(the columns L, which a reading corrects like any other measurement), and what the model is wrong
by. The latter is taken as b = beta sigma, sigma being the model's own standard deviation at the
present heat (`Band`) and beta of unit variance, forgotten over `MEMORY`: what was found at one
heat is taken to grow and to fade with sigma.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array

#: How long what was found of the model's error lasts, s.
MEMORY = 4.0 * 3600.0
#: Standard deviations of an innovation beyond which a reading is refused.
GATE = 5.0


class ModelError(NamedTuple):
    """What is known of beta; arrays of shape (axes,).

    Attributes
    ----------
    mean : ndarray
        0 without any reading.
    variance : ndarray
        1 without any reading.
    """

    mean: Array
    variance: Array


def unknown(axes: int) -> ModelError:
    """Return what is known before any reading."""
    return ModelError(np.zeros(axes), np.ones(axes))


def later(known: ModelError, elapsed: float) -> ModelError:
    """Return what is left of it after some time, s."""
    kept = math.exp(-elapsed / MEMORY)
    return ModelError(kept * known.mean, 1.0 - kept**2 * (1.0 - known.variance))


class Correction(NamedTuple):
    """What a reading of the displacement changes.

    Attributes
    ----------
    state : ndarray, shape (n,)
        To be added to the linear state.
    excess : ndarray, shape (n, k)
        L after it.
    known : ModelError
        After it.
    refused : bool
        It contradicts everything: nothing is changed.
    """

    state: Array
    excess: Array
    known: ModelError
    refused: bool


def correct_by(
    innovation: Array,
    noise: float,
    steady: Array,
    sigma: Array,
    tangent: Array,
    excess: Array,
    known: ModelError,
) -> Correction:
    """Return what a reading of the displacement changes.

    With Y = T L and S = Y Y' + diag(steady + sigma^2 var(beta) + noise^2), the gains are L Y' S^-1
    and diag(sigma var(beta)) S^-1. What L and beta then have in common is left out.

    Parameters
    ----------
    innovation : ndarray, shape (axes,)
        Reading less estimate, m; NaN along an axis that was not read.
    noise : float
        Standard deviation of a reading, m.
    steady : ndarray, shape (axes,)
        Variance of the displacement that the steady covariance has, m2.
    sigma : ndarray, shape (axes,)
        The model's standard deviation, m.
    tangent : ndarray, shape (axes, n)
        T, displacement per state, m.
    excess : ndarray, shape (n, k)
        L.
    known : ModelError
        Before it.
    """
    at = np.flatnonzero(np.isfinite(innovation))
    own = (steady + sigma**2 * known.variance + noise**2)[at]
    seen = tangent[at] @ excess
    covariance = seen @ seen.T + np.diag(own)
    told = np.linalg.solve(covariance, innovation[at])
    if innovation[at] @ told > GATE**2 * at.size:
        return Correction(np.zeros(len(excess)), excess, known, True)
    gain = (sigma * known.variance)[at]
    mean, variance = known.mean.copy(), known.variance.copy()
    mean[at] += gain * told
    variance[at] -= gain**2 * np.diag(np.linalg.inv(covariance))
    root = np.linalg.cholesky(np.eye(excess.shape[1]) + seen.T @ (seen / own[:, None]))
    after = excess @ np.linalg.inv(root).T
    return Correction(excess @ (seen.T @ told), after, ModelError(mean, variance), False)
