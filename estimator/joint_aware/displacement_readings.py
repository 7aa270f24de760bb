"""Readings of the displacement itself, e.g. by a touch probe, as measurements.

What the temperatures leave open in the displacement has two parts: what the state is not known to
(the columns L, which a reading corrects like any other measurement), and what the model is wrong
by. The latter is taken as b = beta sigma, sigma being the model's own standard deviation at the
present heat (`Band`) and beta of unit variance, forgotten over `Touch.memory`: what was found at
one heat is taken to grow and to fade with sigma.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimator.interface import READING_NOISE
from estimator.joint_aware.observer_model import Band
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class Touch:
    """Properties of readings of the displacement (docs/faulty-sensors.md).

    Attributes
    ----------
    noise : float
        Standard deviation of a reading, m.
    memory : float
        Correlation time of the model's error, s.
    gate : float
        Innovation gate in standard deviations, beyond which a reading is refused.
    """

    noise: float = READING_NOISE
    memory: float = 4.0 * 3600.0
    gate: float = 5.0


class ModelError(NamedTuple):
    """Estimate of beta; arrays of shape (axes,).

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
    """Return the prior before any reading."""
    return ModelError(np.zeros(axes), np.ones(axes))


def later(known: ModelError, elapsed: float, memory: float) -> ModelError:
    """Return the estimate after some time, s, with the correlation time `memory`, s."""
    kept = math.exp(-elapsed / memory)
    return ModelError(kept * known.mean, 1.0 - kept**2 * (1.0 - known.variance))


class Correction(NamedTuple):
    """Correction by a reading of the displacement.

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
    touch: Touch,
    band: Band,
    sigma: Array,
    excess: Array,
    known: ModelError,
) -> Correction:
    """Return the correction by a reading of the displacement.

    With Y = T L and S = Y Y' + diag(steady + sigma^2 var(beta) + noise^2), the gains are L Y' S^-1
    and diag(sigma var(beta)) S^-1. What L and beta then have in common is left out.

    Parameters
    ----------
    innovation : ndarray, shape (axes,)
        Reading less estimate, m; NaN along an axis that was not read.
    touch : Touch
        How it is taken.
    band : Band
        Of the model: T, displacement per state, and the variance that the steady covariance has.
    sigma : ndarray, shape (axes,)
        The model's standard deviation, m.
    excess : ndarray, shape (n, k)
        L.
    known : ModelError
        Before it.
    """
    at = np.flatnonzero(np.isfinite(innovation))
    own = (band.steady + sigma**2 * known.variance + touch.noise**2)[at]
    seen = band.tangent[at] @ excess
    covariance = seen @ seen.T + np.diag(own)
    told = np.linalg.solve(covariance, innovation[at])
    if innovation[at] @ told > touch.gate**2 * at.size:
        return Correction(np.zeros(len(excess)), excess, known, True)
    gain = (sigma * known.variance)[at]
    mean, variance = known.mean.copy(), known.variance.copy()
    mean[at] += gain * told
    variance[at] -= gain**2 * np.diag(np.linalg.inv(covariance))
    root = np.linalg.cholesky(np.eye(excess.shape[1]) + seen.T @ (seen / own[:, None]))
    after = excess @ np.linalg.inv(root).T
    return Correction(excess @ (seen.T @ told), after, ModelError(mean, variance), False)
