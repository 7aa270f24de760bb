"""Fault isolation of jumps: heat or a faulty sensor, decided by the samples that follow.

A thermometer on a source that is suddenly off by some kelvin, and a source that is switched on,
look alike in one sample. The reading is used; beside the state a second one is marched without it.
A temperature that follows the heat goes on rising; one that is off stays where it is; a spike is
gone. In the latter two cases the second state is the machine's.
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
    """A jump that is not yet judged.

    Attributes
    ----------
    channel : ndarray, shape ()
        Which reading jumped; NaN for none, and so the others.
    since : ndarray, shape ()
        When, s.
    interval : ndarray, shape ()
        Since the sample before, s.
    jump : ndarray, shape ()
        By how much, K.
    samples : ndarray, shape ()
        That came since.
    linear : ndarray, shape (n,)
        The linear state without that channel.
    """

    channel: Array
    since: Array
    interval: Array
    jump: Array
    samples: Array
    linear: Array


class Judgement(Enum):
    """Cause of a jump."""

    OPEN = auto()
    HEAT = auto()
    SPIKE = auto()
    OFFSET = auto()


def none(states: int) -> PendingJump:
    """Return that there is nothing to be judged."""
    unknown = np.array(np.nan)
    return PendingJump(unknown, unknown, unknown, unknown, np.array(0.0), np.zeros(states))


def suspected(
    linear: Array, innovation: Array, limit: Array, time: float, interval: float
) -> PendingJump:
    """Return the suspicion that a sample arouses.

    Parameters
    ----------
    linear : ndarray, shape (n,)
        What was expected before it.
    innovation : ndarray, shape (p,)
        Of the readings that are believed, K; 0 for the others.
    limit : ndarray, shape (p,)
        Beyond which one is a jump, K.
    time, interval : float
        Of the sample and since the one before, s.
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
    """Return by what factor a jump that was heat would have grown by now.

    Parameters
    ----------
    known : PendingJump
        The jump.
    elapsed : float
        Since it, s.
    answer : ndarray, shape (k,)
        The reading's answer to heat that is switched on, after 1, 2 ... steps, K/W.
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
    """Say what a jump was, a sample later.

    Parameters
    ----------
    known : PendingJump
        The jump.
    departure : float
        The reading less what the state without it expects, K; NaN where there is none.
    limit : float
        What the reading may be off by, K.
    due : bool
        Whether it is late enough to tell heat from an offset.
    expected : float
        By what factor it would have grown if it was heat (`growth`).
    """
    if not math.isfinite(departure):
        return Judgement.OPEN
    if abs(departure) <= limit:
        return Judgement.SPIKE
    if not due:
        return Judgement.OPEN
    grown = departure / float(known.jump)
    return Judgement.HEAT if grown >= math.sqrt(max(expected, 1.0)) else Judgement.OFFSET


def without_heat(
    innovation: Array,
    at: NDArray[np.int64],
    covariance: Array,
    onset: Array,
    bounds: tuple[Array, Array],
) -> Array:
    """Return what of the innovations no change of the heat within bounds explains, K, shape (p,).

    Parameters
    ----------
    innovation : ndarray, shape (p,)
        K.
    at : ndarray of int, shape (q,)
        The readings that count.
    covariance : ndarray, shape (p, p)
        K2.
    onset : ndarray, shape (p, s)
        Readings per W of each source, switched on since the sample before, K/W.
    bounds : pair of ndarray, shape (s,)
        Least and largest change of the heat, W.
    """
    root = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(at, at)]))
    found = lsq_linear(root @ onset[at], root @ innovation[at], bounds=bounds)
    return np.asarray(innovation - onset @ found.x)
