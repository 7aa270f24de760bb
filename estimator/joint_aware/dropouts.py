"""Uncertainty due to missing readings, while they are missing and after they return.

After their return the covariance is propagated with the gain of all readings. Exported programs,
which have no covariance, look it up in these tables.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from estimator.joint_aware.observer import Observer
from fesim.axes.guideway import Place
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.axis_way import Way

#: Most samples over which an absence lasts or has an effect.
LONGEST = 1 << 16
#: Tolerance of a number of samples.
SLACK = 1e-6
#: Absences of an odometer longer than this, s, count as this long: the axis has warmed through by
#: then. Uncertainty below this fraction of its largest value is dropped.
AWAY, NEGLIGIBLE = 8.0 * 3600.0, 0.01
#: With sliding joints, travel has up to this many times the effect of the linear model: at most 1.9
#: on a knee with a friction coefficient of 0.2.
NONLINEAR = 2.0


class Dropouts(NamedTuple):
    """Uncertainty that absences leave, by their length and by the time since they ended."""

    #: Shape (d,): lengths of absences in samples; the last one also stands for longer ones.
    away: Array
    #: Shape (t,): numbers of samples since the return; after the last, no uncertainty is left.
    back: Array
    #: Shape (cases, d, t, axes): uncertainty from then on.
    left: Array

    def of(self, case: int, away: float, back: float) -> Array:
        """Return the uncertainty of a case, (axes,), by samples of absence and since the return."""
        # Times are sums of steps, with rounding errors.
        longer = int(np.searchsorted(self.away, away * (1.0 - SLACK)))
        since = int(np.searchsorted(self.back, back * (1.0 + SLACK), side="right")) - 1
        return np.asarray(self.left[case, min(longer, len(self.away) - 1), since])


def doubled(most: int) -> list[int]:
    """Return 1, 2, 4 ... and `most`."""
    powers = [1 << k for k in range(most.bit_length())]
    return powers if powers[-1] == most else [*powers, most]


def _powers(matrix: Array) -> Iterator[tuple[int, Array]]:
    """Yield 0, 1, 2, 4 ... and the powers of a matrix."""
    yield 0, np.eye(len(matrix))
    count = 1
    while True:
        yield count, matrix
        count, matrix = 2 * count, matrix @ matrix


def with_gain(
    observer: Observer, covariance: Array, without: Array, more: Array
) -> Iterator[Array]:
    """Yield the covariance (n, n) beyond the steady one after every sample with a constant gain.

    With K_s the steady gain, K_s + D that of the present readings at the steady covariance, and the
    gain K = K_s + D + M, a sample turns P into (1 - K H) P (1 - K H)^T + D S D^T + M S' M^T. S is
    the covariance of the innovations, and S' has the lasting errors that `filter_design.correct`
    adds to it.

    Parameters
    ----------
    observer : Observer
        Observer of the machine.
    covariance : ndarray, shape (n, n)
        P before the first sample.
    without : ndarray, shape (n, p + 1)
        K_s + D.
    more : ndarray, shape (n, p + 1)
        M.
    """
    system, own = observer.system, observer.model.filter
    spread = own.innovation + np.diag(own.noise)
    doubted = spread + observer.thresholds.doubt_of_heat**2 * np.diag(own.lasting)
    beyond, left = without - observer.steady_gain, np.eye(system.size)
    left -= (without + more) @ system.rows
    noise = beyond @ spread @ beyond.T + more @ doubted @ more.T
    while True:
        covariance = left @ covariance @ left.T + noise
        yield covariance
        covariance = onward(observer, covariance)


def onward(observer: Observer, covariance: Array) -> Array:
    """Return the covariance (n, n) beyond the steady one before the next sample."""
    advance = observer.system.advance
    return advance(advance(covariance).T)


def factor_of(covariance: Array) -> Array:
    """Return a factor L of a covariance L L^T, both (n, n)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def left_by_dropouts(
    observer: Observer, away: Sequence[int], factors: Sequence[Sequence[Array]]
) -> Dropouts:
    """Return the variance of the displacement that absences leave, m2.

    Parameters
    ----------
    observer : Observer
        With all its readings present again.
    away : sequence of int
        Lengths of the absences in samples.
    factors : sequence of sequences of ndarray, shape (n, k)
        For every case, the covariance factors after absences of these lengths.
    """
    system, tangent = observer.system, observer.model.band.tangent
    joined = np.concatenate([one for case in factors for one in case], axis=1)
    ends = np.cumsum([one.shape[1] for case in factors for one in case])[:-1]
    kept = np.eye(system.size) - observer.steady_gain @ system.rows
    least = observer.thresholds.forgotten * observer.model.band.steady
    back, left = list[int](), list[Array]()
    for count, power in _powers(kept @ system.matrix):
        each = np.split(np.square(tangent @ power @ joined), ends, axis=1)
        back.append(count)
        left.append(observer.thresholds.doubt**2 * np.array([one.sum(axis=1) for one in each]))
        if count > 0 and ((left[-1] <= least).all() or count >= LONGEST):
            break
    every = np.array(left).reshape(len(left), len(factors), len(away), -1).transpose(1, 2, 0, 3)
    # Never less than after the next shorter absence, or than later on.
    every[:, 1:] = np.maximum(every[:, 1:], every[:, :-1])
    every = np.maximum.accumulate(every[:, :, ::-1], axis=2)[:, :, ::-1]
    return Dropouts(np.array(away, dtype=float), np.array(back, dtype=float), every)


def unreported_travel(observer: Observer) -> Dropouts:
    """Return the half-width due to travel that odometers have not reported, m.

    While an odometer is missing, its axis may have moved at the speed of its fastest minute of the
    calibration all the time, or not at all. The cases are first each odometer that reports the
    whole travel when it returns, as heat of one sample, and then each that never does, as it was
    reset.

    Parameters
    ----------
    observer : Observer
        Of a machine with odometers, which was calibrated on runs with its axes.
    """
    march, places = _march(observer), _ends_and_middle(observer)
    size, step = observer.system.size, observer.model.step
    kept = np.eye(len(march))
    kept[:size, :size] -= observer.steady_gain @ observer.system.rows
    once, rows = kept @ march, _rows(observer)
    each = [
        np.stack([_heat_of_travel(observer, place, axis) for place in places], axis=1)
        for axis in observer.model.counted
    ]
    heat = kept @ np.concatenate(each, axis=1)
    # Errors after 1, 2, 4 ... samples, and then in the first sample after them.
    away, power, error = [1], once, heat
    errors = [error]
    while away[-1] * step < AWAY:
        error, power, away = error + power @ error, power @ power, [*away, 2 * away[-1]]
        errors.append(error)
    never = once @ np.array(errors)
    after = np.array([never - np.array(away)[:, None, None] * heat, never])
    back, left = [0], [np.abs(rows @ np.array([errors, errors]))]
    for count, power in _powers(once):
        back.append(1 + count)
        left.append(np.abs(rows @ power @ after))
        if left[-1].max() <= NEGLIGIBLE * left[0].max() or count >= LONGEST:
            break
    # Maximum over the places of the heat and over those where the displacement is evaluated.
    axes = len(observer.model.axes)
    every = np.array(left).reshape(len(back), 2, len(away), -1, axes, len(each), len(places))
    every = every.max(axis=(3, 6)).transpose(1, 4, 2, 0, 3)
    every = NONLINEAR * every.reshape(2 * len(each), len(away), len(back), axes)
    every = np.maximum.accumulate(every[:, :, ::-1], axis=2)[:, :, ::-1]
    return Dropouts(np.array(away, dtype=float), np.array(back, dtype=float), every)


def _ends_and_middle(observer: Observer) -> list[Place]:
    """Positions of the axes: all at one end, all in the middle, all at the other end."""
    way = observer.model.modes.way
    assert way is not None  # with axes
    strokes = [one[[0, len(one) // 2, -1]] for one in way.stations.positions]
    return [tuple(place) for place in np.transpose(strokes).tolist()]


def _later(observer: Observer, before: Array, place: Place, gone: Place) -> Array:
    """Linear state and drives (n + d,) a step later; axes travel `gone` to and fro at a place."""
    size, way = observer.system.size, Way(place, place, gone)
    parts = before[:size], before[size:]
    return np.concatenate(observer.later(parts, observer.physics.rest, observer.model.step, way))


def _cold(observer: Observer) -> Array:
    drives = observer.model.modes.drives
    assert drives is not None  # with axes
    return np.concatenate([np.zeros(observer.system.size), drives.cold])


def _march(observer: Observer) -> Array:
    """Transition matrix (n + d, n + d) of linear state and drives, axes in the middle."""
    cold, place = _cold(observer), _ends_and_middle(observer)[1]
    still = (0.0,) * len(place)
    first = _later(observer, cold, place, still)
    units = np.eye(cold.size)
    return np.stack([_later(observer, cold + one, place, still) - first for one in units], axis=1)


def _heat_of_travel(observer: Observer, place: Place, axis: int) -> Array:
    """Change of linear state and drives by the fastest travel of an axis in a step, (n + d,)."""
    cold, gone = _cold(observer), np.zeros(len(place))
    still = _later(observer, cold, place, tuple(gone.tolist()))
    gone[axis] = observer.model.calibrated.speeds[axis] * observer.model.step
    return _later(observer, cold, place, tuple(gone.tolist())) - still


def _rows(observer: Observer) -> Array:
    """Displacement per linear state and drives at every place, m, (places axes, n + d)."""
    model, drives, cold = observer.model, observer.model.modes.drives, _cold(observer)
    assert drives is not None  # with axes
    size, none, found = observer.system.size, len(model.modes.elastic.probe_thermal), []
    for place in _ends_and_middle(observer):
        places = drives.with_zeros(np.array(place))
        probes = np.zeros((len(places), none))
        states = np.vstack([cold[size:], cold[size:] + np.eye(cold.size - size)])
        moved = np.array([drives.displacement(one, places, probes)[0] for one in states])
        found.append(np.hstack([model.band.tangent, (moved[1:] - moved[0]).T[: len(model.axes)]]))
    return np.vstack(found)
