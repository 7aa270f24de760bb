"""Odometers of moving axes: dropouts and resets, and the doubt of the displacement they leave.

Where an odometer is missing, its axis has travelled the distance between its positions, or more. It
reports the rest when it returns, unless it was reset meanwhile. `dropouts.unreported_travel` is the
uncertainty meanwhile and afterwards.
"""

from __future__ import annotations

import numpy as np

from estimator.joint_aware.dropouts import SLACK, Dropouts
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_state import ObserverState
from thermojoint.artefacts.arrays import Array, Flags


def count(
    observer: Observer, after: ObserverState, counts: Array, stood: Array, elapsed: float
) -> tuple[Array, Flags]:
    """Take the odometers of a sample into its state, in place.

    Parameters
    ----------
    observer : Observer
        Observer of the machine.
    after : ObserverState
        State of the sample before, but with the loads of this one.
    counts : ndarray, shape (c,)
        Odometers, m; NaN where missing.
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
    after.odometer_age[:] = np.where(unread, since, 0.0)
    travel = after.odometer - last
    moved = plausible(travel, since, observer.thresholds.fastest)
    travelled[at] = np.where(moved & ~unread, travel, 0.0)
    return travelled, ~unread & ~moved


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


def dropout_times(
    before: ObserverState, elapsed: float, whole: bool, longest: float
) -> tuple[Array, Array]:
    """Return for how long odometers were missing, and are back, (2 c,) each, s.

    Zero where it has no effect any more, `longest` (s) after the return. Only samples with all
    readings, `whole`, count for the return.
    """
    age = before.odometer_age
    missing = np.append(age > 0.0, np.zeros(age.size, dtype=bool))
    away = before.away + elapsed * missing
    back = np.where(missing, 0.0, before.back + elapsed * whole)
    counts = (away > 0.0) & (back <= longest * (1.0 + SLACK))
    return away * counts, back * counts


def half_width(travel: Dropouts, after: ObserverState, step: float) -> Array:
    """Return the half-width (axes,), m, due to travel that odometers have not reported.

    `step` (s) is the one of the table `travel`.
    """
    pairs = enumerate(zip(after.away / step, after.back / step, strict=True))
    each = [travel.of(k, away, back) for k, (away, back) in pairs if away > 0.0]
    return np.sum(each, axis=0) if each else np.zeros(travel.left.shape[-1])
