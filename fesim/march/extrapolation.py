"""Extrapolation from step to step by backward differences.

Newton's formula of order p predicts the change of a value as the sum of its differences of order 1
to p. Its error in the last step was the difference of order p + 1, so that each value is predicted
by the order that was best there: a smooth history by the highest, one that has just bent or
jumped by a low one.
"""

from __future__ import annotations

from fesim.jit import compiled
from thermojoint.artefacts.arrays import Array


@compiled
def extrapolate(change: Array, further: Array, ahead: Array) -> None:
    """Predict the change of n values in the next step.

    Parameters
    ----------
    change : ndarray, shape (n,)
        Their change in the last step.
    further : ndarray, shape (k, n)
        Their differences of order 2 to k + 1; zero before they are known.
    ahead : ndarray, shape (n,)
        The prediction, in place.
    """
    for i in range(change.size):
        predicted, least, total, term = 0.0, abs(change[i]), 0.0, change[i]
        for k in range(len(further)):
            total += term
            term = further[k, i]
            if abs(term) < least:
                predicted, least = total, abs(term)
        ahead[i] = predicted


@compiled
def differ(before: Array, change: Array, further: Array) -> None:
    """Update the differences beyond the first after a step.

    Parameters
    ----------
    before, change : ndarray, shape (n,)
        Change of n values in the step before, and in this one.
    further : ndarray, shape (k, n)
        Their differences of order 2 to k + 1, in place.
    """
    for i in range(change.size):
        now, last = change[i], before[i]
        for k in range(len(further)):
            now, last, further[k, i] = now - last, further[k, i], now - last
