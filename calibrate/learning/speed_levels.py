"""Levels of a speed: which were held in a log, and the error of a model without one of them.

Blocks of time that are held out do not show the error at a speed that was never run, because the
other blocks contain the same speeds. Leaving out a whole level shows it: its rows, and those so
near that its heat still affects them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibrate.learning.rules import Cleaning
from estimator.rows import rms
from thermojoint.artefacts.arrays import Array


class Cost(NamedTuple):
    """Rms error, µm, (axes,), at a level: of a model learned without it, and as usual."""

    unseen: Array
    usual: Array


def held_levels(speeds: Array, rules: Cleaning) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the level of every row (k,), and the levels but standstill that are held (l,).

    Parameters
    ----------
    speeds : ndarray, shape (k,)
        Relative to the largest. A level is a number of steps of `Cleaning.level`.
    rules : Cleaning
        Limits for standstill, and for levels that are held.
    """
    running = speeds > rules.stopped
    level = np.where(running, np.maximum(np.round(speeds / rules.level), 1.0), 0.0).astype(np.int64)
    values, counts = np.unique(level[running], return_counts=True)
    return level, values[counts > rules.seldom * len(speeds)]


def cost_of_unseen(
    level: NDArray[np.int64],
    held: Sequence[int],
    margin: int,
    errors: Array,
    usually: Callable[[NDArray[np.bool_]], NDArray[np.bool_]],
    without: Callable[[NDArray[np.bool_], NDArray[np.bool_]], Array],
) -> Cost | None:
    """Return the larger cost of learning without the lowest or without the highest level.

    Parameters
    ----------
    level : ndarray of int, shape (k,)
        Of every row.
    held : sequence of int
        Levels that may be left out, ascending.
    margin : int
        Rows on either side of a level that are left out with it.
    errors : ndarray, shape (k, axes)
        On blocks of time that were held out, µm.
    usually : callable
        Takes the rows of a level, (k,) of bool; returns those whose errors are compared (`usual`).
    without : callable
        Takes the rows of a level and those to be fitted, (k,) of bool; returns the errors of the
        former, µm, (n, axes).

    Returns
    -------
    Cost or None
        None if fewer than two levels are held, or one of them fills the log.
    """
    costs = []
    for one in {held[0], held[-1]} if len(held) > 1 else ():
        own = level == one
        near = np.convolve(own, np.ones(2 * margin + 1), "same") > 0.5
        if near.all():
            return None
        costs.append([rms(without(own, ~near)), rms(errors[usually(own)])])
    return Cost(*np.max(costs, axis=0)) if costs else None


def usual(
    own: NDArray[np.bool_],
    folds: Iterable[tuple[slice, NDArray[np.bool_]]],
    seldom: float,
) -> NDArray[np.bool_]:
    """Return the rows of a level that were judged by fits that included it; else all others.

    Parameters
    ----------
    own : ndarray of bool, shape (k,)
        Rows of the level. If it was run only once, they lie in the block that is held out.
    folds : iterable of (slice, ndarray of bool)
        Rows of every block that was held out, and those that were fitted then.
    seldom : float
        A level that is held in fewer than this share of the fitted rows is not included.
    """
    known = np.zeros_like(own)
    for held, away in folds:
        known[held] = own[away].mean() > seldom
    return own & known if (own & known).any() else ~own
