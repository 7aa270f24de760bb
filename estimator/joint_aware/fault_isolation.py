"""Fault isolation of jumps: heat or a faulty sensor, decided by the samples that follow.

In a single sample, a thermometer near a source that suddenly reads some kelvin wrong looks like a
source that is switched on. The reading is used, and a second state is marched without it. A
temperature that follows the heat keeps rising; a wrong one stays at its offset; a spike vanishes.
In the latter two cases the second state is the correct one.
"""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from thermojoint.artefacts.arrays import Array


class PendingJump(NamedTuple):
    """A jump whose cause is still unknown."""

    #: Shape (): index of the reading that jumped; NaN if none, as are the next three.
    channel: Array
    #: Shape (): time of the jump, s.
    since: Array
    #: Shape (): interval from the previous sample, s.
    interval: Array
    #: Shape (): size, K.
    jump: Array
    #: Shape (): number of samples since.
    samples: Array
    #: Shape (n,): linear state without that channel.
    linear: Array


class Judgement(Enum):
    """Cause of a jump."""

    OPEN = auto()
    HEAT = auto()
    SPIKE = auto()
    OFFSET = auto()


def none(states: int) -> PendingJump:
    """Return the value for no pending jump."""
    unknown = np.array(np.nan)
    return PendingJump(unknown, unknown, unknown, unknown, np.array(0.0), np.zeros(states))


def pending_jump(
    linear: Array, innovation: Array, limit: Array, time: float, interval: float
) -> PendingJump:
    """Return the pending jump after a sample, if there is one.

    Parameters
    ----------
    linear : ndarray, shape (n,)
        Linear state predicted before it.
    innovation : ndarray, shape (p,)
        Innovations of the readings that are used, K; 0 for the others.
    limit : ndarray, shape (p,)
        Innovations beyond it are jumps, K.
    time, interval : float
        Time of the sample and interval from the previous one, s.
    """
    relative = np.abs(innovation) / limit
    channel = int(np.argmax(relative))
    if relative[channel] <= 1.0:
        return none(linear.size)
    return PendingJump(
        channel=np.array(float(channel)),
        since=np.array(time),
        interval=np.array(interval),
        jump=np.array(innovation[channel]),
        samples=np.array(0.0),
        linear=linear,
    )


def growth(known: PendingJump, elapsed: float, answer: Array, step: float) -> float:
    """Return the factor by which a jump caused by heat would have grown by now.

    Parameters
    ----------
    known : PendingJump
        The jump.
    elapsed : float
        Time since, s.
    answer : ndarray, shape (k,)
        Step response of the reading to heat, after 1, 2 ... steps, K/W.
    step : float
        s.
    """
    times = step * np.arange(1, answer.size + 1)
    interval = float(known.interval)
    now, then = np.interp(elapsed + interval, times, answer), np.interp(interval, times, answer)
    return float(now / then)


def judged(
    known: PendingJump, departure: float, limit: float, due: bool, expected: float
) -> Judgement:
    """Return the cause of a jump, judged one sample later.

    Parameters
    ----------
    known : PendingJump
        The jump.
    departure : float
        Reading minus prediction of the state without it, K; NaN if missing.
    limit : float
        Tolerance of the reading, K.
    due : bool
        Whether enough time has passed to distinguish heat from an offset.
    expected : float
        Expected growth factor if it was heat (`growth`).
    """
    if not math.isfinite(departure):
        return Judgement.OPEN
    if abs(departure) <= limit:
        return Judgement.SPIKE
    if not due:
        return Judgement.OPEN
    grown = departure / float(known.jump)
    return Judgement.HEAT if grown >= math.sqrt(max(expected, 1.0)) else Judgement.OFFSET


def explaining_heat(onset: Array, covariance: Array) -> Array:
    """Return the best-fitting change of heat per innovation, W/K, shape (s, p).

    Parameters
    ----------
    onset, covariance : ndarray, shapes (p, s) and (p, p)
        As for `without_heat`, which also applies bounds.
    """
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    return np.asarray(np.linalg.lstsq(root @ onset, root, rcond=-1)[0])


def without_heat(
    innovation: Array,
    at: NDArray[np.int64],
    covariance: Array,
    onset: Array,
    bounds: tuple[Array, Array],
) -> Array:
    """Return the part of the innovations, K, shape (p,), that no possible change of heat explains.

    Parameters
    ----------
    innovation : ndarray, shape (p,)
        K.
    at : ndarray of int, shape (q,)
        Indices of the readings to consider.
    covariance : ndarray, shape (p, p)
        K2.
    onset : ndarray, shape (p, s)
        Change of the readings per W of each source, switched on since the previous sample, K/W.
    bounds : pair of ndarray, shape (s,)
        Bounds on the change of heat, W.
    """
    root = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(at, at)]))
    low, high = bounds
    given = root @ onset[at], root @ innovation[at]
    heat = np.linalg.lstsq(*given, rcond=-1)[0]
    # Usually it is within the bounds, and `lsq_linear` would find the same.
    if not ((heat >= low) & (heat <= high)).all():
        heat = lsq_linear(*given, bounds=bounds).x
    return np.asarray(innovation - onset @ heat)
