"""Band of the displacement: half-width of its 95 % interval, by its causes."""

from __future__ import annotations

import math

import numpy as np

from estimator.joint_aware import unreported_motion
from estimator.joint_aware.displacement_readings import ModelError
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_state import ObserverState
from estimator.joint_aware.precomputed import Precomputed
from thermojoint.artefacts.arrays import Array

#: Half-width of the 95 % interval, in standard deviations.
WIDTH = 1.96
#: Share by which unreported motion of axes, or loads, may widen a band: as `Observer.unsettled`.
WIDENED = math.sqrt(2.0) - 1.0


def half_band(observer: Observer, parts: Array, known: ModelError, factor: Array) -> Array:
    """Return the half-width of the 95 % interval, m, shape (..., axes).

    Parameters
    ----------
    observer : Observer
        Observer of the machine.
    parts : ndarray, shape (..., axes, d + axes)
        Model error per part, m (`Observer.model_error`).
    known : ModelError
        Its estimate from displacement readings.
    factor : ndarray, shape (n + p + 1, k)
        Covariance factor.
    """
    usual, left = variances(observer, parts, known, factor)
    return np.asarray(WIDTH * np.sqrt(usual + left))


def variances(
    observer: Observer, parts: Array, known: ModelError, factor: Array
) -> tuple[Array, Array]:
    """Return the variance of the displacement, m2, without a start or a gap, and what they add.

    Shapes (..., axes) and (axes,). The arguments are those of `half_band`.
    """
    band = observer.model.band
    # E var(e) E', of which only the diagonal is needed, in every sample.
    shared = ((parts @ known.shared) * parts).sum(axis=-1)
    own = np.square(parts[..., known.shared_mean.size :]) @ known.variance
    left = np.zeros(band.steady.size)
    if factor.any():
        fields = factor[: observer.system.size]
        uncertain = np.square(band.tangent @ fields).sum(axis=1)
        left = observer.thresholds.doubt**2 * uncertain
    return np.asarray(band.steady + shared + own), np.asarray(left)


def of_pending_jump(observer: Observer, after: ObserverState) -> Array:
    """Return the effect of a pending jump, m, shape (axes,): the band covers both causes."""
    band = observer.model.band
    if not np.isfinite(after.pending.channel):
        return np.zeros(band.steady.size)
    return np.abs(band.tangent @ (after.linear - after.pending.linear))


def of_missing_loads(observer: Observer, after: ObserverState, factors: Array) -> Array:
    """Return the half-width (axes,), m, due to missing factors of loads.

    The largest difference to the displacement under the lowest and the highest calibrated factor.
    `factors` (l + x,) are those of the sample, NaN where missing, and then the positions.
    """
    found, ranges = np.zeros(observer.model.band.steady.size), observer.model.calibrated.loads
    missing = np.flatnonzero(np.isnan(factors[: len(ranges)]))
    if not missing.size:
        return found
    present = observer.displacement_under(after, after.loads)
    for k in missing.tolist():
        others = np.tile(after.loads, (2, 1))
        others[:, k] = ranges[k]
        moved = [observer.displacement_under(after, loads) for loads in others]
        found += np.abs(np.array(moved) - present).max(axis=0)
    return found


def of_unreported_motion(data: Precomputed, after: ObserverState) -> Array:
    """Return the half-width (axes,) due to the heat of unreported motion of the axes, m."""
    absences = after.absences
    if not absences.away.any() or (motion := data.unreported_motion) is None:
        return np.zeros(data.observer.model.band.steady.size)
    observer, model = data.observer, data.observer.model
    relaxed, present = after.linear[observer.relaxations], after.linear[observer.heat] / model.power
    level = np.abs(np.append(relaxed, present)).max() / model.calibrated.heat
    return unreported_motion.half_width(motion, absences, model.step, float(level))
