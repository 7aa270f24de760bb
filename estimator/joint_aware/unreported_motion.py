"""Uncertainty due to motion of the axes that odometers or positions have not reported.

While an odometer is missing, the travel of its axis is unknown; while a position is missing, so is
the place where heat passes its joints. Linear responses under the gain of the filter give the
largest effect on the displacement meanwhile and afterwards, in a table that exported programs
share. What the position itself changes while it is missing is evaluated in every sample
(`axis_lines.of_missing_positions`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import islice, permutations

import numpy as np

from estimator.joint_aware.dropouts import LONGEST, SLACK, Dropouts, powers
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_state import Absences
from fesim.axes.guideway import Place
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.axis_way import Way

#: Absences longer than this, s, count as this long: the axis has warmed through by then.
#: Uncertainty below this fraction of its largest value is dropped.
AWAY, NEGLIGIBLE = 8.0 * 3600.0, 0.01
#: With sliding joints, heat has up to this many times the effect of the linear model: at most 1.9
#: on a knee with a friction coefficient of 0.2.
NONLINEAR = 2.0


def absences_after(before: Absences, missing: Array, back: float, longest: float) -> Absences:
    """Return the absences after a sample.

    Parameters
    ----------
    before : Absences
        After the sample before.
    missing : ndarray, shape (2 c + x,)
        For how long each was missing since then, s.
    back : float
        For how long the others are back since then, s: zero if a temperature is missing.
    longest : float
        Time after the return, s, from which an absence has no effect any more, and is zero.
    """
    away = before.away + missing
    since = np.where(missing > 0.0, 0.0, before.back + back)
    counts = (away > 0.0) & (since <= longest * (1.0 + SLACK))
    return Absences(away * counts, since * counts)


def half_width(motion: Dropouts, absences: Absences, step: float, level: float) -> Array:
    """Return the half-width (axes,), m, due to unreported motion.

    Parameters
    ----------
    motion : Dropouts
        `unreported_motion`.
    absences : Absences
        Of the readings of axes.
    step : float
        The step of `motion`, s.
    level : float
        Heat of the sources, present or relaxed, relative to the largest calibrated one.
    """
    own = absences.away.size
    positions = slice(2 * own - len(motion.left), None)
    away = np.append(absences.away, absences.away[positions]) / step
    back = np.append(absences.back, absences.back[positions]) / step
    each = [
        motion.of(k, away[k], back[k]) * (level if k >= own else 1.0)
        for k in np.flatnonzero(away).tolist()
    ]
    return np.sum(each, axis=0) if each else np.zeros(motion.left.shape[-1])


def unreported_motion(observer: Observer) -> Dropouts:
    """Return the half-width due to unreported motion, m.

    While an odometer is missing, its axis may have moved at the speed of its fastest minute of the
    calibration all the time, or not at all. One that returns reports the whole travel, as heat of
    one sample; one that was reset never does. While a position is missing, its axis may stand or
    move elsewhere than assumed.

    The cases are those of `Absences`, with those of the positions for the heat of travel, and then
    the positions again, for the heat of the sources at the largest calibrated one.

    Parameters
    ----------
    observer : Observer
        Of a machine with axes, calibrated on runs in which they moved.
    """
    model, size = observer.model, observer.system.size
    middle, lengths = _ends_and_middle(observer)[1], _lengths(observer)
    every_place = {place for k in range(len(middle)) for place in _along(observer, k)}
    marches = {place: _march(observer, place) for place in every_place}
    march = marches[middle]
    kept = np.eye(len(march))
    kept[:size, :size] -= observer.steady_gain @ observer.system.rows
    once, rows = kept @ march, _rows(observer)
    travelled = [_errors_of_travel(observer, axis, once, kept) for axis in model.counted]
    elsewhere = [_errors_elsewhere(observer, k, kept, marches) for k in range(len(middle))]
    every = [*travelled, *(travel for travel, _ in elsewhere), *(heat for _, heat in elsewhere)]
    starts = np.cumsum([0] + [one.shape[-1] for one in every[:-1]])
    # Errors after 1, 2, 4 ... samples, and then in the first sample after them.
    errors = np.concatenate(every, axis=-1)
    never = once @ errors
    after = np.array([never - lengths[:, None, None] * errors[0], never])
    back, left = [0], [np.abs(rows @ np.array([errors, errors]))]
    for count, power in powers(once):
        back.append(1 + count)
        left.append(np.abs(rows @ power @ after))
        last, first = (one.max(axis=(0, 1, 2)) for one in (left[-1], left[0]))
        if (last <= NEGLIGIBLE * first).all() or count >= LONGEST:
            break
    # Maximum over the kinds of motion and over the places where the displacement is evaluated.
    shape = len(back), 2, lengths.size, -1, len(model.axes), len(every)
    largest = np.maximum.reduceat(np.array(left), starts, axis=-1).reshape(shape).max(axis=3)
    reported, lost = NONLINEAR * largest.transpose(1, 4, 2, 0, 3)
    cases = np.concatenate([reported[: len(travelled)], lost])
    cases = np.maximum.accumulate(cases[:, :, ::-1], axis=2)[:, :, ::-1]
    return Dropouts(lengths, np.array(back, dtype=float), cases)


def _errors_of_travel(observer: Observer, axis: int, once: Array, kept: Array) -> Array:
    """Errors of linear state and drives by travel that no odometer reports, (d, n + d, 3).

    After every length of an absence; at the ends and in the middle. `once` is a sample of all, and
    `kept` what its readings leave of the errors.
    """
    heat = [_heat_of_travel(observer, place, [axis]) for place in _ends_and_middle(observer)]
    error = kept @ np.stack(heat, axis=1)
    errors = [error]
    for power in _squares(once, _lengths(observer).size - 1):
        errors.append(errors[-1] + power @ errors[-1])
    return np.array(errors)


def _errors_elsewhere(
    observer: Observer, axis: int, kept: Array, marches_at: Mapping[Place, Array]
) -> tuple[Array, Array]:
    """Errors of linear state and drives as an axis is not where it is assumed.

    For every change between the ends and the middle of its stroke, after every length of an
    absence: by the heat of travel, (d, n + d, k), and by that of the sources, (d, n + d, l). Both
    have acted for `AWAY` before. Its travel may go on or not; an odometer tells it.
    """
    places, count = _along(observer, axis), _lengths(observer).size
    marches = [_squares(marches_at[place], count) for place in places]
    lasting = [_squares(kept @ powers_of[0], count) for powers_of in marches]
    warm = [_warm(observer, *each) for each in zip(places, marches, strict=True)]
    heat = [_heat_of_travel(observer, place, [axis]) for place in places]
    told, by_sources = axis in observer.model.counted, list[Array]()
    once = kept @ marches_at[places[1]]
    by_travel = [] if told else [_errors_of_travel(observer, axis, once, kept)]
    for a, b in permutations(range(len(places)), 2):
        travelled, heated = warm[a]
        start = np.stack([travelled, travelled, heated], axis=1)
        acting = heat[b][:, None] * [1.0, 0.0, 0.0]
        known = heat[a][:, None] * [float(told), 0.0, 0.0]
        # State and error go from (x, e) to (F_b x + g_b, R (F_a e + (F_b - F_a) x + g_b - g_a)).
        cross, more = kept @ (marches[b][0] - marches[a][0]), kept @ (acting - known)
        errors = list[Array]()
        for march, left in zip(marches[b], lasting[a], strict=True):
            errors.append(cross @ start + more)
            more = cross @ acting + left @ more + more
            acting = march @ acting + acting
            cross = cross @ march + left @ cross
        by_travel.append(np.array(errors)[:, :, :2])
        by_sources.append(np.array(errors)[:, :, 2:])
    return np.concatenate(by_travel, axis=-1), np.concatenate(by_sources, axis=-1)


def _warm(observer: Observer, place: Place, marches: Sequence[Array]) -> tuple[Array, Array]:
    """Linear state and drives (n + d,), beyond the cold ones, after a long time at a place.

    By the fastest travel of all axes, and by all sources at the largest calibrated heat. `marches`
    are the powers of a step.
    """
    model = observer.model
    travelled = _heat_of_travel(observer, place, range(len(place)))
    sources = np.zeros(travelled.size)
    sources[observer.heat] = model.calibrated.heat * model.power
    for march in marches:
        travelled = march @ travelled + travelled
    return travelled, marches[-1] @ sources


def _lengths(observer: Observer) -> Array:
    """Lengths of absences in samples, 1, 2, 4 ..., as floats."""
    doublings = math.ceil(math.log2(max(AWAY / observer.model.step, 1.0)))
    return np.exp2(np.arange(doublings + 1))


def _squares(matrix: Array, count: int) -> list[Array]:
    """The matrix, its square, the square of that, ... (`count` of them)."""
    return [power for _, power in islice(powers(matrix), 1, 1 + count)]


def _ends_and_middle(observer: Observer) -> list[Place]:
    """Positions of the axes: all at one end, all in the middle, all at the other end."""
    way = observer.model.modes.way
    assert way is not None  # with axes
    strokes = [one[[0, len(one) // 2, -1]] for one in way.stations.positions]
    return [tuple(place) for place in np.transpose(strokes).tolist()]


def _along(observer: Observer, axis: int) -> list[Place]:
    """One axis at its ends and in its middle, in order, the others in the middle."""
    places = _ends_and_middle(observer)
    return [(*places[1][:axis], place[axis], *places[1][axis + 1 :]) for place in places]


def _later(observer: Observer, before: Array, place: Place, gone: Array) -> Array:
    """Linear state and drives (n + d,) a step later; axes travel `gone` to and fro at a place."""
    size, way = observer.system.size, Way(place, place, tuple(gone.tolist()))
    parts = before[:size], before[size:]
    return np.concatenate(observer.later(parts, observer.physics.rest, observer.model.step, way))


def _cold(observer: Observer) -> Array:
    drives = observer.model.modes.drives
    assert drives is not None  # with axes
    return np.concatenate([np.zeros(observer.system.size), drives.cold])


def _march(observer: Observer, place: Place) -> Array:
    """Transition matrix (n + d, n + d) of linear state and drives, axes standing at a place."""
    cold, still = _cold(observer), np.zeros(len(place))
    first = _later(observer, cold, place, still)
    units = np.eye(cold.size)
    return np.stack([_later(observer, cold + one, place, still) - first for one in units], axis=1)


def _heat_of_travel(observer: Observer, place: Place, axes: Sequence[int]) -> Array:
    """Change of linear state and drives, (n + d,), by the fastest travel of axes in a step."""
    cold, still = _cold(observer), np.zeros(len(place))
    gone = still.copy()
    gone[axes] = np.array(observer.model.calibrated.speeds)[axes] * observer.model.step
    return _later(observer, cold, place, gone) - _later(observer, cold, place, still)


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
