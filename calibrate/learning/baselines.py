"""Baseline regressions on all temperatures of a log, treated like the learned model.

``linear``: ordinary least squares. ``ridge``: standardised temperatures and their low-passes, the
penalty by held-out blocks of time. ``arx``: a pole from one-step predictions, then the weights of
the temperatures by the same ridge, free-running; that is a relaxation of the temperatures.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibrate.learning.blocks import Blocks, Sums, held_out, weights_of
from calibrate.learning.selection import Fitted
from calibrate.ridge import linear_weights
from thermojoint.artefacts.arrays import Array


def linear(blocks: Blocks, index: list[int]) -> Fitted:
    """Return ordinary least squares on the features of an index."""
    return ridge(blocks, index, (1e-9,))


def autoregressive_tau(
    rows: Array, features: int, now: list[int], interval: float, slowest: float
) -> float:
    """Return the time constant of ARX, s: that of its pole in one-step predictions, bounded.

    Parameters
    ----------
    rows : ndarray, shape (k, n)
        Features, then displacements.
    features : int
        Number of features.
    now : list of int
        Indices of the unfiltered temperatures among them.
    interval : float
        Between rows, s.
    slowest : float
        Its bound, s.
    """
    inputs, outputs = rows[:, now], rows[:, features:]
    inputs, outputs = inputs - inputs.mean(axis=0), outputs - outputs.mean(axis=0)
    poles = []
    for own in outputs.T:
        table = np.column_stack((own[:-1], inputs[1:]))
        poles.append(linear_weights(table, own[1:])[0])
    pole = float(np.clip(np.median(poles), 0.0, 1.0 - 1e-9))
    return float(np.clip(-interval / np.log(max(pole, 1e-6)), interval, slowest))


def ridge(blocks: Blocks, index: list[int], penalties: tuple[float, ...]) -> Fitted:
    """Return ridge on the standardised features of an index.

    Each displacement has the penalty with the smallest error on held-out blocks.
    """
    n = blocks.features
    at = np.array(index, dtype=np.int64)
    spread = np.sqrt(np.maximum(np.diag(blocks.whole.centred) / blocks.whole.count, 1e-18))
    spread[n:] = 1.0
    standard = _scaled(blocks, 1.0 / spread)
    rows = blocks.whole.count / blocks.penalty
    fits = weights_of(standard, at, [rows * penalty for penalty in penalties])
    errors = np.array([held_out(standard, fitted[:-1]).mean(axis=0) for fitted in fits])
    best = errors.argmin(axis=0)
    axes = errors.shape[1]
    weights = np.stack([fits[best[c], -1][:, c] for c in range(axes)], axis=1)
    weights /= spread[:n, None]
    covariance = np.zeros((axes, n, n))
    inner = standard.whole.centred[np.ix_(at, at)] / blocks.penalty
    for c in range(axes):
        error = max(errors[best[c], c], 1e-4)
        own = np.linalg.inv(inner / error + rows * penalties[best[c]] / error * np.eye(len(at)))
        covariance[c][np.ix_(at, at)] = own / np.outer(spread[at], spread[at])
    mean = blocks.whole.mean
    return Fitted(
        weights,
        covariance,
        mean[n:] - mean[:n] @ weights,
        np.sqrt(errors[best, np.arange(axes)]),
        errors[best, np.arange(axes)],
    )


def _scaled(blocks: Blocks, factor: Array) -> Blocks:
    def turned(sums: Sums) -> Sums:
        return replace(
            sums, products=sums.products * np.outer(factor, factor), total=sums.total * factor
        )

    return replace(
        blocks,
        whole=turned(blocks.whole),
        fits=tuple(turned(fit) for fit in blocks.fits),
        held=tuple(turned(held) for held in blocks.held),
    )
