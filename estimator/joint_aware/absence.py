"""What is left of the uncertainty of readings that were away, while and after they are.

The covariance that they leave is marched with the gain of all readings: exported programs, which
have no covariance, look it up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.joint_aware.observer import Observer
from thermojoint.artefacts.arrays import Array

#: So many samples are as long as any absence lasts or counts.
LONGEST = 1 << 16


class Absence(NamedTuple):
    """Steps at which it is known."""

    #: Shape (d,): how many samples something was away; the last one stands for more.
    away: Array
    #: Shape (t,): for how many samples it is back; after the last, nothing is left.
    back: Array
    #: Shape (cases, d, t, axes): what is left from then on.
    left: Array


def doubled(most: int) -> list[int]:
    """Return 1, 2, 4 ... and `most`."""
    powers = [1 << k for k in range(most.bit_length())]
    return powers if powers[-1] == most else [*powers, most]


def left_by(observer: Observer, away: Sequence[int], factors: Sequence[Sequence[Array]]) -> Absence:
    """Return the variance of the displacement that absences leave, m2.

    Parameters
    ----------
    observer : Observer
        All of whose readings are back.
    away : sequence of int
        How many samples they were away.
    factors : sequence of sequences of ndarray, shape (n, k)
        Of every case the covariance factors after absences so long.
    """
    system, tangent = observer.system, observer.model.band.tangent
    joined = np.concatenate([one for case in factors for one in case], axis=1)
    ends = np.cumsum([one.shape[1] for case in factors for one in case])[:-1]
    kept = np.eye(system.size) - observer.usual_gain @ system.rows
    power = kept @ system.matrix
    least = observer.thresholds.forgotten * observer.model.band.steady
    back, left, seen = [0, 1], list[Array](), tangent @ joined
    while True:
        each = np.split(np.square(seen), ends, axis=1)
        left.append(observer.thresholds.doubt**2 * np.array([one.sum(axis=1) for one in each]))
        if len(left) > 1 and ((left[-1] <= least).all() or back[len(left) - 1] >= LONGEST):
            break
        if len(left) > 1:
            power = power @ power
            back.append(2 * back[-1])
        seen = tangent @ power @ joined
    every = np.array(left).reshape(len(left), len(factors), len(away), -1).transpose(1, 2, 0, 3)
    # Nor less than after the next shorter absence, nor than later.
    every[:, 1:] = np.maximum(every[:, 1:], every[:, :-1])
    every = np.maximum.accumulate(every[:, :, ::-1], axis=2)[:, :, ::-1]
    return Absence(np.array(away, dtype=float), np.array(back, dtype=float), every)
