"""The displacement reading that would narrow the band most, and when it is due.

The covariance after a reading does not depend on what is read, so the band after it is known
beforehand. The band of the next hours is that at the present heat: the relaxations of the heat
approach it, and the effect of earlier readings decays. Uncertainty that the thermometers will have
removed by then is not subtracted.
"""

from __future__ import annotations

import numpy as np

from estimator.interface import NextReading
from estimator.joint_aware.band import WIDTH, half_band
from estimator.joint_aware.displacement_readings import correct_by, later
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.observer_state import unpacked
from thermojoint.artefacts.arrays import Array

#: Times at which the band is evaluated, s from now.
OUTLOOK = (0.0, 600.0, 1200.0, 1800.0, 3600.0, 7200.0)
#: A reading that narrows the band of its axis by less than this share is not requested.
LEAST = 0.1


def narrowest_band(estimator: JointAware) -> float:
    """Return the half-width after a reading if nothing else was known, m."""
    steady, probe = float(estimator.model.band.steady.max()), estimator.observer.thresholds.probe
    return float(WIDTH * np.sqrt(2.0 * steady + probe.noise**2))


def next_reading(estimator: JointAware, state: Array, limit: float) -> NextReading | None:
    """Return the reading to take when the band exceeds a limit; None if not, or if none helps.

    Parameters
    ----------
    estimator : JointAware
        The estimator.
    state : ndarray
        After a sample.
    limit : float
        Largest half-width of the 95 % interval of any axis, m.
    """
    for due in OUTLOOK:
        before, after = bands_around(estimator, state, due)
        if not (before > limit).any():
            continue
        # The axis whose reading leaves least above the limit, then the narrowest bands.
        left = [(np.maximum(band - limit, 0.0).sum(), band.sum()) for band in after]
        axis = min(range(len(left)), key=left.__getitem__)
        wide, narrow = float(before[axis]), float(after[axis, axis])
        if narrow > (1.0 - LEAST) * wide:
            return None
        return NextReading(estimator.axes[axis], due, wide, narrow)
    return None


def bands_around(estimator: JointAware, state: Array, due: float) -> tuple[Array, Array]:
    """Return the half-width some time (s) from now, and that after a reading of each axis, m.

    Shapes (axes,) and (axes read, axes).
    """
    observer, forgetting = estimator.observer, estimator.precomputed.forgetting
    probe = observer.thresholds.probe
    model, now = estimator.model, unpacked(state, estimator.parts)
    heat = now.linear[observer.heat] / model.power
    relaxed = now.linear[observer.relaxations].reshape(heat.size, -1)
    kept = np.exp(-model.discrepancy.rates * due)
    relaxed = kept * relaxed + (1.0 - kept) * heat[:, None]
    since = float(now.time - now.begun) + due
    slips, means = float(now.slip_knowledge), now.watch.means
    parts = observer.model_error(relaxed.ravel(), slips, means, since)
    known, factor = later(now.model_error, due, forgetting), now.covariance_factor
    after = []
    for innovation in np.where(np.eye(len(estimator.axes), dtype=bool), 0.0, np.nan):
        told = correct_by(innovation, probe, model.band, parts, factor, known)
        after.append(half_band(observer, parts, told.known, told.covariance_factor))
    return half_band(observer, parts, known, factor), np.array(after)
