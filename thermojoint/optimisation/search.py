"""Search by differential evolution (Storn & Price 1997; scipy), one generation of cases at a time.

Everything follows from the seed: a search that is begun again asks for the same cases.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import NonlinearConstraint, differential_evolution
from scipy.stats import qmc

from fesim.batch.study import RangeSection, Values, values_in
from thermojoint.artefacts.arrays import Array

#: Runs cases; gives their figures, shape (cases, figures), NaN where there is no result.
Run = Callable[[list[Values]], Array]
#: Turns figures (cases, figures) into aim and excess over each limit, (cases, 1 + limits).
Measure = Callable[[Array], Array]
Key = tuple[float, ...]
#: Significant digits of the values: no design needs more.
DIGITS = 5
#: Counts as excess where a case has no result.
HOPELESS = 1e9


@dataclass(frozen=True)
class Effort:
    """Length of a search."""

    #: Cases of a generation, 5 or more.
    population: int = 12
    #: At most; fewer where the whole generation agrees to a hundredth.
    generations: int = 15
    #: Of all that is random.
    seed: int = 1


@dataclass(frozen=True, eq=False)
class Search:
    """Cases of a search."""

    #: Values of the cases, in the order of their generations.
    rows: list[Values]
    #: Shape (cases, figures): as `Run`.
    figures: Array
    #: Shape (cases, 1 + limits): as `Measure`.
    measured: Array
    #: Numbers of cases after each generation.
    sizes: list[int]

    def best(self, count: int | None = None) -> int | None:
        """Return the best of the first `count` cases: of those within all limits the lowest.

        Where none is within them, the one with the least excess; None where none has a result.
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
        As `Run` and `Measure`; each case is run once.
    effort : Effort
        Length.
    first : sequence of dict
        Cases that are run beside the first generation.
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
        # None where no case of a generation is within the limits.
        found = measured(unit)[:, 0] if unit.size else np.empty(0)
        return np.where(np.isnan(found), np.inf, found)

    def excess(unit: Array) -> Array:
        # scipy tries a single point, too.
        found = measured(unit.reshape(len(ranges), -1))[:, 1:].T
        return np.where(np.isnan(found), HOPELESS, found).reshape(-1, *unit.shape[1:])

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
    )
    found = np.array([figures[_key(values)] for values in rows])
    return Search(rows, found, measure(found), sizes)


def _rounded(ranges: Sequence[RangeSection], values: Values) -> Values:
    """Values with `DIGITS` digits, or at the end of a range that these would pass."""
    return {
        span.path: min(max(float(f"{values[span.path]:.{DIGITS}g}"), span.low), span.high)
        for span in ranges
    }


def _key(values: Values) -> Key:
    return tuple(values.values())
