"""Displacement readings, e.g. by a touch probe, as measurements.

The uncertainty of the displacement given the temperatures has two parts: that of the state (the
columns L, corrected by a reading like by any other measurement), and the model error. The latter is
modelled as b = beta sigma, where sigma is the model's standard deviation at the present heat
(`Band`) and beta has unit variance and decays over `DisplacementProbe.memory`: an error found at
one heat is assumed to grow and shrink with sigma.
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
class DisplacementProbe:
    """Properties of displacement readings (docs/faulty-sensors.md).

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
    """Return the estimate after some time, s, for the correlation time `memory`, s."""
    kept = math.exp(-elapsed / memory)
    return ModelError(kept * known.mean, 1.0 - kept**2 * (1.0 - known.variance))


class Correction(NamedTuple):
    """Correction by a displacement reading.

    Attributes
    ----------
    state : ndarray, shape (n,)
        Increment of the linear state.
    covariance_factor : ndarray, shape (n, k)
        L after it.
    known : ModelError
        After it.
    refused : bool
        The reading is inconsistent: nothing is changed.
    """

    state: Array
    covariance_factor: Array
    known: ModelError
    refused: bool


def correct_by(
    innovation: Array,
    probe: DisplacementProbe,
    band: Band,
    sigma: Array,
    factor: Array,
    known: ModelError,
) -> Correction:
    """Return the correction by a displacement reading.

    With Y = T L and S = Y Y' + diag(steady + sigma^2 var(beta) + noise^2), the gains are L Y' S^-1
    and diag(sigma var(beta)) S^-1. Correlations between L and beta are neglected.

    Parameters
    ----------
    innovation : ndarray, shape (axes,)
        Reading minus estimate, m; NaN for an axis that was not read.
    probe : DisplacementProbe
        Properties of the readings.
    band : Band
        Band of the model: T, displacement per state, and the variance by the steady covariance.
    sigma : ndarray, shape (axes,)
        The model's standard deviation, m.
    factor : ndarray, shape (n, k)
        L.
    known : ModelError
        Before it.
    """
    at = np.flatnonzero(np.isfinite(innovation))
    own = (band.steady + sigma**2 * known.variance + probe.noise**2)[at]
    seen = band.tangent[at] @ factor
    covariance = seen @ seen.T + np.diag(own)
    whitened = np.linalg.solve(covariance, innovation[at])
    if innovation[at] @ whitened > probe.gate**2 * at.size:
        return Correction(np.zeros(len(factor)), factor, known, True)
    gain = (sigma * known.variance)[at]
    mean, variance = known.mean.copy(), known.variance.copy()
    mean[at] += gain * whitened
    variance[at] -= gain**2 * np.diag(np.linalg.inv(covariance))
    root = np.linalg.cholesky(np.eye(factor.shape[1]) + seen.T @ (seen / own[:, None]))
    after = factor @ np.linalg.inv(root).T
    return Correction(factor @ (seen.T @ whitened), after, ModelError(mean, variance), False)
