"""Alternating steps of the staggered coupling.

A staggered step uses the conductance of the one before: a fixed-point map. If its gain is above
one, pressures alternate between too high and too low although every step is in balance. Increments
then change sign in every step, except where a joint stays open for one. Since an intermittent heat
input has the same effect, the gain is then computed (`fesim.march.stepping`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array, Flags

#: Smallest relative increment that counts: above the tolerance of the gap equations.
LEAST = 1e-5
#: Consecutive changes of sign after which the gain is computed.
SUSPECTED = 2
#: Steps without motion allowed between them.
STILL = 1
#: Gain from which on the alternation does not end; even alternation has a gain of one.
GAIN = 0.9
#: Changes of sign in a row that are required if the gain is estimated from the increments.
STUBBORN = 6
#: Motion to and fro reverses increments in most steps. A compiled march on axes computes the gain
#: in one of this many: it changes slowly, and alternating steps persist until then.
SOMETIMES = 4
#: In one of this many steps the march also checks whether longer periods decay, by steps with
#: constant inputs and positions.
SELDOM = 8
#: Increments below this fraction of the largest one are not used for the gain.
LEADING = 0.1
#: Relative increment from which on periods of more than two steps are looked for.
LARGE = 0.1


def turnings(last: Array, moved: Array) -> Array:
    """Return the record of alternating increments after each step.

    Its rows are the last increment above `LEAST`, its number of consecutive changes of sign (up to
    `SUSPECTED`, and then from the start), and the number of steps since then. An open joint may
    stand still between two increments, for at most `STILL` steps.

    Parameters
    ----------
    last : ndarray, shape (3, m)
        Record of the step before; zeros at the start of a march.
    moved : ndarray, shape (n, m)
        Relative increments of n steps.

    Returns
    -------
    ndarray, shape (n, 3, m)
    """
    time = np.arange(1.0, 1.0 + len(moved))[:, None]
    counted = np.abs(moved) > LEAST
    began = np.where(last[0] != 0.0, -last[2], -np.inf)
    # Time of the last increment that counts, at the start and after each step, and its index.
    when = np.maximum.accumulate(np.vstack([began, np.where(counted, time, -np.inf)]), axis=0)
    at = np.maximum(when, 0.0).astype(np.intp) * moved.shape[1] + np.arange(moved.shape[1])
    increment = np.vstack([last[0], moved]).ravel()[at]
    turned = counted & (moved * increment[:-1] < 0.0) & (time - when[:-1] <= 1.0 + STILL)
    once = np.vstack([(last[1] > 0.0) & (last[1] < SUSPECTED), turned]).ravel()[at[:-1]]
    counts = np.vstack([last[1], np.where(turned, 1.0 + once, 0.0)]).ravel()[at[1:]]
    since = np.where(np.isfinite(when[1:]), time - when[1:], 0.0)
    return np.stack([increment[1:], counts, since], axis=1)


def suspected(turning: Array) -> Array:
    """Return which elements may alternate, from the result (..., 3, m) of `turnings`."""
    return np.asarray((turning[..., 1, :] >= SUSPECTED) & (turning[..., 2, :] == 0.0))


def alternating(values: Array) -> bool:
    """Return whether relative values (n, m) of given steps begin to oscillate (`oscillating`)."""
    return bool(oscillating(values).any())


def oscillating(values: Array) -> Flags:
    """Return which of n steps belong to an oscillation from step to step that does not decay.

    Either increments change sign in `STUBBORN` steps in a row and hardly decay; or they do so in
    half of three times as many steps, return to about the same values, and each third swings hardly
    less than the one before: periods of two, three, four or six steps.

    Parameters
    ----------
    values : ndarray, shape (n, m)
        Relative values at the ends of the steps.
    """
    marked = np.zeros(len(values), dtype=np.bool_)
    # Few columns change sign often enough; a check of all would be expensive.
    often = _turned(np.diff(values, axis=0)).sum(axis=0) >= STUBBORN - 1
    if len(values) < STUBBORN + 2 or not often.any():
        return marked
    values = values[:, often]
    moved = np.diff(values, axis=0)
    size = np.abs(moved)
    turned = (moved[1:] * moved[:-1] < 0.0) & (size[1:] > GAIN * size[:-1]) & (size[1:] > LEAST)
    for first in np.flatnonzero(_windows(turned, STUBBORN).all(axis=-1).any(axis=-1)):
        marked[first : first + STUBBORN + 2] = True
    if len(moved) < 3 * STUBBORN:
        return marked
    swing = np.ptp(_windows(values, STUBBORN + 1), axis=-1)
    lasts = swing[STUBBORN:] > GAIN**STUBBORN * swing[:-STUBBORN]
    turns = _windows(_turned(moved), 3 * STUBBORN - 1).sum(axis=-1) >= 3 * STUBBORN // 2 - 1
    moved_on = np.abs(values[2 * STUBBORN :] - values[: -2 * STUBBORN])
    back = _windows(moved_on, STUBBORN + 1).max(axis=-1) < 0.5 * swing[: -2 * STUBBORN]
    found = turns & back & lasts[STUBBORN:] & lasts[:-STUBBORN]
    for first in np.flatnonzero(found.any(axis=-1)):
        marked[first : first + 3 * STUBBORN + 1] = True
    return marked


def unresolved(pressure: Array, inputs: Array, events: Flags) -> NDArray[np.intp]:
    """Return the steps whose pressures oscillate from step to step although no input does.

    Such iterated steps are in balance, each of them, but too long to resolve the oscillation that
    heat and pressure excite in each other (Barber, Dundurs and Comninou 1980).

    Parameters
    ----------
    pressure : ndarray, shape (n, m)
        At the ends of the steps, relative to the reference pressures.
    inputs : ndarray, shape (n, k)
        Inputs of the steps.
    events : ndarray of bool, shape (n,)
        Steps at which a march changes course: at a snap-through, or where iterated ones begin.
    """
    largest = np.abs(inputs).max(axis=0)
    driven = inputs / np.where(largest > 0.0, largest, 1.0)
    parts = np.split(np.arange(len(pressure)), np.flatnonzero(events))
    own = [oscillating(pressure[part]) & ~oscillating(driven[part]) for part in parts]
    return np.flatnonzero(np.concatenate(own))


def _turned(moved: Array) -> Flags:
    """Where increments (n, m) differ in sign from the last ones that count, shape (n - 1, m)."""
    counted = np.abs(moved) > LEAST
    last = np.maximum.accumulate(np.where(counted, np.arange(len(moved))[:, None], 0), axis=0)
    sign = np.take_along_axis(np.sign(moved) * counted, last, axis=0)
    return np.asarray(sign[1:] * sign[:-1] < 0.0)


def _windows(values: NDArray[Any], length: int) -> NDArray[Any]:
    """All runs of `length` rows of values (n, m), shape (n - length + 1, m, length)."""
    return np.asarray(sliding_window_view(values, length, axis=0))


def gain_of(once: Array, twice: Array) -> float:
    """Return the gain of an alternating map from two consecutive increments (k,).

    It is the gain of the element that alternates most: others may decay. Elements that move much
    less than the rest only follow it.
    """
    leading = np.abs(once) >= max(LEADING * float(np.abs(once).max()), 1e-300)
    return float((-twice[leading] / once[leading]).max(initial=0.0))
