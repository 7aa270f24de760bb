"""Uncertainty due to missing readings, while they are missing and after they return.

After their return the covariance is propagated with the gain of all readings. Exported programs,
which have no covariance, look it up in these tables.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from estimator.joint_aware.observer import Observer
from thermojoint.artefacts.arrays import Array

#: Most samples over which an absence lasts or has an effect.
LONGEST = 1 << 16
#: Tolerance of a number of samples.
SLACK = 1e-6


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


def powers(matrix: Array) -> Iterator[tuple[int, Array]]:
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
    adds to it. There are few readings, and the product is P - K W^T - W K^T with
    W = P H^T - K H P H^T / 2.

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
    beyond, gain, rows = without - observer.steady_gain, without + more, system.rows
    noise = beyond @ spread @ beyond.T + more @ doubted @ more.T
    while True:
        seen = rows @ covariance
        taken = gain @ (seen - 0.5 * (seen @ rows.T) @ gain.T)
        covariance = covariance - (taken + taken.T) + noise
        yield covariance
        covariance = onward(observer, covariance)


def onward(observer: Observer, covariance: Array) -> Array:
    """Return the covariance (n, n) beyond the steady one before the next sample."""
    system, size = observer.system, observer.system.decay.size
    advanced = system.advance(covariance)
    advanced[:, :size] *= system.decay
    advanced[:, :size] += advanced[:, size:] @ system.drive.T
    return advanced


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
    for count, power in powers(kept @ system.matrix):
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
