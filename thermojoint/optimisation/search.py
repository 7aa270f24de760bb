"""Search by differential evolution (Storn & Price 1997; scipy), one generation of cases at a time.

Everything is determined by the seed: a restarted search requests the same cases.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import NonlinearConstraint, OptimizeResult, differential_evolution
from scipy.stats import qmc

from fesim.batch.study import RangeSection, Values, values_in
from thermojoint.artefacts.arrays import Array

#: Runs cases; returns their figures, shape (cases, figures), NaN without a result.
Run = Callable[[list[Values]], Array]
#: Converts figures (cases, figures) to aim and excess over each limit, (cases, 1 + limits).
Measure = Callable[[Array], Array]
Key = tuple[float, ...]
#: Significant digits of the values; no design needs more.
DIGITS = 5
#: A generation agrees if its aims deviate by this fraction of their mean, and of the range of all
#: aims so far: a large part of an aim may not depend on the values.
AGREES = 0.01
#: Excess of a case without a result.
HOPELESS = 1e9


@dataclass(frozen=True)
class Effort:
    """Length of a search."""

    #: Number of cases of a generation, 5 or more.
    population: int = 12
    #: Largest number of generations; fewer if a whole generation agrees (`AGREES`).
    generations: int = 15
    #: Seed of all random numbers.
    seed: int = 1


@dataclass(frozen=True, eq=False)
class Search:
    """Cases of a search."""

    #: Values of the cases, in the order of their generations.
    rows: list[Values]
    #: Shape (cases, figures): result of `Run`.
    figures: Array
    #: Shape (cases, 1 + limits): result of `Measure`.
    measured: Array
    #: Number of cases after each generation.
    sizes: list[int]

    def best(self, count: int | None = None) -> int | None:
        """Return the best of the first `count` cases: the lowest one within all limits.

        If none is within the limits, the one with the least excess; None if none has a result.
        """
        measured = self.measured[:count]
        excess = np.maximum(measured[:, 1:], 0.0).sum(axis=1)
        order = np.lexsort((measured[:, 0], excess))
        return next((int(at) for at in order if not np.isnan(measured[at]).any()), None)


def search(
    ranges: Sequence[RangeSection],
    run: Run,
    measure: Measure,
    effort: Effort,
    first: Sequence[Values] = (),
) -> Search:
    """Minimise an aim within limits.

    Parameters
    ----------
    ranges : sequence of RangeSection
        Values to choose.
    run, measure : callable
        See `Run` and `Measure`; each case is run once.
    effort : Effort
        Length of the search.
    first : sequence of dict
        Cases that are run with the first generation.
    """
    figures: dict[Key, Array] = {}
    rows: list[Values] = []
    sizes: list[int] = []

    def measured(unit: Array) -> Array:
        """Measure points (values, cases) in the unit cube."""
        asked = [_rounded(ranges, values) for values in values_in(ranges, unit.T)]
        more = {_key(values): values for values in [*(() if rows else first), *asked]}
        fresh = {key: values for key, values in more.items() if key not in figures}
        if fresh:
            rows.extend(fresh.values())
            figures.update(zip(fresh, run(list(fresh.values())), strict=True))
            sizes.append(len(rows))
        return measure(np.array([figures[_key(values)] for values in asked]))

    def aim(unit: Array) -> Array:
        # Empty if no case of a generation is within the limits.
        found = measured(unit)[:, 0] if unit.size else np.empty(0)
        return np.where(np.isnan(found), np.inf, found)

    def excess(unit: Array) -> Array:
        # scipy also passes a single point.
        found = measured(unit.reshape(len(ranges), -1))[:, 1:].T
        return np.where(np.isnan(found), HOPELESS, found).reshape(-1, *unit.shape[1:])

    def agrees(intermediate_result: OptimizeResult) -> bool:
        aims = intermediate_result.population_energies
        if not np.isfinite(aims).all():
            return False
        every = measure(np.array(list(figures.values())))[:, 0]
        size = min(abs(np.mean(aims)), np.ptp(every[np.isfinite(every)]))
        return bool(np.std(aims) <= AGREES * size)

    cube = qmc.LatinHypercube(len(ranges), rng=np.random.default_rng(effort.seed))
    begin = cube.random(effort.population)
    limits = measured(begin.T).shape[1] - 1
    differential_evolution(
        aim,
        [(0.0, 1.0)] * len(ranges),
        init=begin,
        maxiter=effort.generations - 1,
        constraints=NonlinearConstraint(excess, -np.inf, 0.0) if limits else (),
        rng=effort.seed,
        polish=False,
        updating="deferred",
        vectorized=True,
        tol=0.0,
        callback=agrees,
    )
    found = np.array([figures[_key(values)] for values in rows])
    return Search(rows, found, measure(found), sizes)


def _rounded(ranges: Sequence[RangeSection], values: Values) -> Values:
    """Round values to `DIGITS` digits, limited to their ranges."""
    return {
        span.path: min(max(float(f"{values[span.path]:.{DIGITS}g}"), span.low), span.high)
        for span in ranges
    }


def _key(values: Values) -> Key:
    return tuple(values.values())
