"""Odometers of moving axes: dropouts and resets.

Where an odometer is missing, or stands while its axis moves, the axis has travelled the distance
between its positions, or more. It reports the rest when it returns, unless it was reset meanwhile.
`unreported_motion` has the uncertainty meanwhile and afterwards.
"""

from __future__ import annotations

import numpy as np

from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_state import ObserverState
from estimator.joint_aware.sample_values import OVERTRAVEL
from thermojoint.artefacts.arrays import Array, Flags


def count(
    observer: Observer, after: ObserverState, counts: Array, stood: Array, elapsed: float
) -> tuple[Array, Flags]:
    """Take the odometers of a sample into its state, and mark those that stand as missing.

    Both are changed in place.

    Parameters
    ----------
    observer : Observer
        Observer of the machine.
    after : ObserverState
        State of the sample before, but with the loads of this one.
    counts : ndarray, shape (c,)
        Odometers, m; NaN where missing, and afterwards also where it tells less than half of the
        distance between the positions.
    stood : ndarray, shape (x,)
        Positions of the axes at the sample before, m.
    elapsed : float
        Time since then, s.

    Returns
    -------
    travelled : ndarray, shape (x,)
        Travel of the axes since then, m; zero where the odometer does not tell it.
    reset : ndarray of bool, shape (c,)
        Odometers that were reset.
    """
    at, travelled = list(observer.model.counted), np.zeros(stood.size)
    if not at:
        return travelled, np.zeros(0, dtype=bool)
    last, unread = after.odometer.copy(), np.isnan(counts)
    least = np.abs(observer.place(after.loads) - stood)[at]
    after.odometer[:] = np.where(unread, last + least, counts)
    since = after.odometer_age + elapsed
    travel = after.odometer - last
    moved = plausible(travel, since, observer.thresholds.fastest)
    travelled[at] = np.where(moved & ~unread, travel, 0.0)
    reset = ~unread & ~moved
    counts[moved & (travel < 0.5 * least) & (least > OVERTRAVEL)] = np.nan
    after.odometer_age[:] = np.where(np.isnan(counts), since, 0.0)
    return travelled, reset


def plausible(travel: Array, elapsed: Array, fastest: float) -> Flags:
    """Return whether axes can have travelled distances (c,), m, in some times (c,), s.

    A distance that no axis can travel at the `fastest` speed, m/s, means a reset odometer: then
    only positions count.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray((travel >= 0.0) & (travel <= fastest * elapsed))


def after_reset(before: ObserverState, reset: Flags) -> ObserverState:
    """Return the state after a reset of odometers (c,), which never report the missed travel."""
    (reporting, never), (back, since) = np.split(before.away, 2), np.split(before.back, 2)
    lost = reset & (reporting > 0.0)
    return before._replace(
        away=np.append(np.where(lost, 0.0, reporting), np.where(lost, reporting, never)),
        back=np.append(back, np.where(lost, 0.0, since)),
    )
