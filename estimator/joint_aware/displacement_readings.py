"""Displacement readings, e.g. by a touch probe, as measurements.

The uncertainty of the displacement given the temperatures has two parts: that of the state (the
columns L, corrected by a reading like by any other measurement), and the model error b = E e. Its
parts e have unit variance before any reading: one for each drawn machine of the band (`Band.open`),
whose error in the displacement follows the heat of the last hours, for each axis one for each
thermometer, whose error follows the innovations that last (`Band.surprise`), and one for each axis,
for the rest of the band. A reading thus narrows down which of the machines that the calibration
cannot distinguish is present, and corrects all axes at any later heat. It also determines the
displacement per innovation of a thermometer, which is a property of the machine. The parts decay
over `machine_memory`, `innovation_memory` and `memory` of `DisplacementProbe`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimator.interface import READING_NOISE
from estimator.joint_aware.observer_model import Band
from thermojoint.artefacts.arrays import Array

#: Most enlargements of the model error, each by the factor by which a reading still exceeds its
#: variance; other parts of the variance, such as the noise of the reading, are not enlarged.
ENLARGED = 10
#: Largest variance of a part of the model error. Only readings that contradict each other enlarge
#: it again and again, until it would overflow: those that need more are refused.
LARGEST = 1e100


@dataclass(frozen=True)
class DisplacementProbe:
    """Properties of displacement readings (docs/faulty-sensors.md)."""

    #: Standard deviation of a reading, m.
    noise: float = READING_NOISE
    #: Correlation times of the model error, s: of its rest, of the part that the calibration did
    #: not determine, and of the effect of innovations of the thermometers.
    memory: float = 4.0 * 3600.0
    machine_memory: float = 8.0 * 3600.0
    innovation_memory: float = 8.0 * 86400.0
    #: Innovation gate in standard deviations, beyond which a reading is refused.
    gate: float = 5.0
    #: A second reading beyond the gate confirms the first if it differs from it by no more than
    #: this share; as vectors, since both may agree with the model along some axes.
    alike: float = 0.5


class ModelError(NamedTuple):
    """Estimate of the parts e of the model error: d shared by the axes, then one per axis.

    The shared ones are those of the drawn machines, then of the lasting innovations.

    `refused` is the last refused reading minus the estimate, m; NaN for none.
    """

    #: Shape (axes,): of the axes' own parts; 0 and 1 without any reading.
    mean: Array
    variance: Array
    #: Shape (d,): mean of the shared parts; 0 without any reading.
    shared_mean: Array
    #: Shape (d + axes, d + axes): covariance of all parts, less `variance` on its diagonal.
    shared: Array
    refused: Array


def unknown(shared: int, axes: int) -> ModelError:
    """Return the prior before any reading."""
    own = np.diag(np.append(np.ones(shared), np.zeros(axes)))
    return ModelError(np.zeros(axes), np.ones(axes), np.zeros(shared), own, np.full(axes, np.nan))


def mean_of(known: ModelError) -> Array:
    """Return the mean of e, shape (d + axes,)."""
    return np.concatenate([known.shared_mean, known.mean])


def covariance_of(known: ModelError) -> Array:
    """Return the covariance of e, shape (d + axes, d + axes)."""
    return known.shared + np.diag(np.append(np.zeros(known.shared_mean.size), known.variance))


def known_error(mean: Array, covariance: Array, refused: Array) -> ModelError:
    """Return the estimate with a mean (d + axes,) and a covariance of e."""
    axes = refused.size
    count, variance = mean.size - axes, np.diag(covariance)[mean.size - axes :]
    shared = covariance - np.diag(np.append(np.zeros(count), variance))
    return ModelError(mean[count:], variance, mean[:count], shared, refused)


def later(known: ModelError, elapsed: float, rates: Array) -> ModelError:
    """Return the estimate after some time, s; `rates` are those of `forgetting`."""
    kept = np.exp(-elapsed * rates)
    covariance = kept[:, None] * covariance_of(known) * kept + np.diag(1.0 - kept**2)
    return known_error(kept * mean_of(known), covariance, known.refused)


def forgetting(band: Band, probe: DisplacementProbe) -> Array:
    """Return the decay rates of e, 1/s, shape (d + axes,)."""
    lasts = [probe.machine_memory, probe.innovation_memory, probe.memory]
    return 1.0 / np.repeat(lasts, [*band.shared, len(band.constant)])


class Correction(NamedTuple):
    """Correction by a displacement reading."""

    #: Shape (n + p + 1,): increment of the linear state, and of the errors of the readings.
    state: Array
    #: Shape (n + p + 1, k): L after the reading.
    covariance_factor: Array
    #: Model error after the reading.
    known: ModelError
    #: The reading is inconsistent: the estimate is not changed.
    refused: bool


def correct_by(
    innovation: Array,
    probe: DisplacementProbe,
    band: Band,
    parts: Array,
    factor: Array,
    known: ModelError,
) -> Correction:
    """Return the correction by a displacement reading.

    A reading beyond the gate is refused. If the next one of these axes differs by as much, the
    model is wrong: its error is enlarged until the reading is one standard deviation off.

    With Y = T L and S = Y Y' + E var(e) E' + diag(steady + noise^2), the gains are L Y' S^-1 and
    var(e) E' S^-1. Correlations between L and e are neglected.

    Parameters
    ----------
    innovation : ndarray, shape (axes,)
        Reading minus estimate, m; NaN for an axis that was not read.
    probe : DisplacementProbe
        Properties of the readings.
    band : Band
        Band of the model: T, displacement per state, and the variance by the steady covariance.
    parts : ndarray, shape (axes, d + axes)
        E: model error per part, m.
    factor : ndarray, shape (n + p + 1, k)
        L before the reading.
    known : ModelError
        Model error before the reading.
    """
    at = np.flatnonzero(np.isfinite(innovation))
    before, seen = covariance_of(known), band.tangent[at] @ factor[: band.tangent.shape[1]]
    noise = np.diag(band.steady[at] + probe.noise**2)

    def expected(across: Array) -> tuple[Array, Array, float]:
        own = across @ parts[at].T + noise
        covariance = seen @ seen.T + own
        squares = float(innovation[at] @ np.linalg.solve(covariance, innovation[at]))
        return own, covariance, squares / at.size

    across = parts[at] @ before
    own, covariance, beyond = expected(across)
    refused = known.refused.copy()
    if beyond > probe.gate**2:
        apart = np.linalg.norm((refused - innovation)[at])
        alike = apart <= probe.alike * np.linalg.norm(innovation[at])
        for _ in range(ENLARGED if alike else 0):
            before, across = beyond * before, beyond * across
            own, covariance, beyond = expected(across)
        if not alike or before.max() > LARGEST:
            refused[at] = innovation[at]
            return Correction(np.zeros(len(factor)), factor, known._replace(refused=refused), True)
    refused[at] = np.nan
    whitened = np.linalg.solve(covariance, innovation[at])
    after = before - across.T @ np.linalg.solve(covariance, across)
    learned = known_error(mean_of(known) + across.T @ whitened, after, refused)
    root = np.linalg.cholesky(np.eye(factor.shape[1]) + seen.T @ np.linalg.solve(own, seen))
    narrower = factor @ np.linalg.inv(root).T
    return Correction(factor @ (seen.T @ whitened), narrower, learned, False)
