"""Random heat and positions of a working day: levels that last some minutes each."""

from __future__ import annotations

import numpy as np

from fesim.axes.guideway import Guideway
from thermojoint.artefacts.arrays import Array

#: Duration of a level, s.
LASTS = (300.0, 2400.0)


def random_levels(
    seed: int | np.random.Generator, length: float, step: float, highest: float, sources: int
) -> Array:
    """Return the heat of every source at the end of each step, shape (n, s).

    Parameters
    ----------
    seed : int or Generator
        The same seed gives the same day.
    length, step : float
        s.
    highest : float
        Of the levels, relative to the reference; uniform from zero.
    sources : int
        Each has its own levels.
    """
    rng = np.random.default_rng(seed)
    levels = np.zeros((round(length / step), sources))
    for source in range(sources):
        at = 0
        while at < len(levels):
            lasts = max(1, round(rng.uniform(*LASTS) / step))
            levels[at : at + lasts, source] = rng.uniform(0.0, highest)
            at += lasts
    return levels


def random_course(rng: np.random.Generator, steps: int, step: float, way: Guideway) -> Array:
    """Return positions of x axes at the end of each step, m, shape (n, x).

    Half of the time an axis stands at a random position of its stroke; otherwise it moves to
    another one in every step.

    Parameters
    ----------
    rng : Generator
        Draws them.
    steps : int
        n.
    step : float
        s.
    way : Guideway
        Their strokes.
    """
    strokes = [positions[[0, -1]] for positions in way.stations.positions]
    return np.column_stack([_course(rng, steps, step, *stroke) for stroke in strokes])


def _course(rng: np.random.Generator, steps: int, step: float, low: float, high: float) -> Array:
    """Positions (n,) of one axis, between two ends, m."""
    course, at = np.empty(steps), 0
    while at < steps:
        lasts = max(1, round(rng.uniform(*LASTS) / step))
        part = course[at : at + lasts]
        part[:] = rng.uniform(low, high, 1 if rng.uniform() < 0.5 else part.size)
        at += lasts
    return course
