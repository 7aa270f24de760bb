"""Steps of the staggered coupling that alternate.

Each takes what the joints conduct from the last one: a fixed-point map. Where its gain is above one
a pressure too high makes the next one too low, for ever, and every step is in balance. It is seen
by increments that change their sign step after step; the gain itself is then measured
(`fesim.march.stepping`), as heat that comes and goes looks alike.
"""

from __future__ import annotations

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Smallest increment that counts, of what it is relative to: above what the gap equations leave.
LEAST = 1e-5
#: So many changes of sign in a row are suspected.
SUSPECTED = 2
#: From this gain on steps alternate without end: it is one where they do so evenly.
GAIN = 0.9


def turnings(last: Array, moved: Array) -> Array:
    """Return what is kept of increments: themselves, and their changes of sign in a row.

    Parameters
    ----------
    last : ndarray, shape (2, m)
        What was kept of the step before.
    moved : ndarray, shape (n, m)
        Relative increments of n steps.

    Returns
    -------
    ndarray, shape (n, 2, m)
        Counts go up to `SUSPECTED`, and begin again behind it.
    """
    moves = np.concatenate([last[:1], moved])
    counted = np.abs(moves) > LEAST
    turned = (moves[1:] * moves[:-1] < 0.0) & counted[1:] & counted[:-1]
    before = np.concatenate([(last[1:] > 0.0) & (last[1:] < SUSPECTED), turned[:-1]])
    return np.stack([moved, np.where(turned, 1.0 + before, 0.0)], axis=1)


def suspected(turning: Array) -> Array:
    """Return which elements alternate, by the last axis of what is kept, (..., 2, m)."""
    return np.asarray(turning[..., 1, :] >= SUSPECTED)


def gain_of(once: Array, twice: Array) -> float:
    """Return the gain of an alternating map from two increments (k,), one after the other."""
    return float(-(once @ twice) / max(float(once @ once), 1e-300))
