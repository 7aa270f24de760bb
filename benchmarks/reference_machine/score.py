"""How far a machine is from what the paper prints: one number, made of one miss a statement.

A miss is the distance to the printed value in units of a tolerance, which is how exactly the
paper says it: a factor for sizes, a difference for ratios, shares and angles. Beyond `WORST`
tolerances a statement does not come out at all, and how far it is off says nothing more. The score
is the root mean square of the misses: 0 is the paper's machine, 1 is off by the tolerance
throughout, `WORST` has nothing of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

WORST = 3.0
#: A statement comes out if it is missed by no more than its tolerance.
OUT = 1.0


def by_factor(value: float, printed: float, tolerance: float) -> float:
    """Return |ln(value/printed)| / ln(tolerance); infinite if the signs differ."""
    quotient = value / printed
    return abs(float(np.log(quotient))) / float(np.log(tolerance)) if quotient > 0.0 else np.inf


def by_difference(value: float, printed: float, tolerance: float) -> float:
    """Return |value - printed| / tolerance."""
    return abs(value - printed) / tolerance


def at_least(value: float, printed: float, tolerance: float) -> float:
    """Return by how many tolerances `value` is below the printed one, 0 if it is above."""
    return max(0.0, printed - value) / tolerance


def at_most(value: float, printed: float, tolerance: float) -> float:
    """Return by how many tolerances `value` is above the printed one, 0 if it is below."""
    return max(0.0, value - printed) / tolerance


@dataclass(frozen=True)
class Statement:
    """One thing that the paper prints of its machine's behaviour."""

    #: Of the observable (`benchmarks.reference_machine.observables`).
    name: str
    #: Over its column.
    heading: str
    #: Value printed in the paper, in the observable's unit.
    printed: float
    #: (value, printed, tolerance) to tolerances.
    distance: Callable[[float, float, float], float]
    #: A factor above 1 for `by_factor`, else in the observable's unit.
    tolerance: float
    #: In the paper.
    where: str

    def miss(self, value: float) -> float:
        """Return by how many tolerances `value` is off, at most `WORST`; NaN is off by `WORST`."""
        if np.isnan(value):
            return WORST
        return min(WORST, self.distance(value, self.printed, self.tolerance))


STATEMENTS = (
    Statement("total_um", "δ, µm", 250.0, by_factor, 1.2, "section 5.3.3"),
    Statement("nonlinear_um", "δ_NL, µm", 23.0, by_factor, 1.2, "section 5.3.3, Figure 9"),
    Statement("ratio_half", "δ_NL 0.5 : 2", -0.125, by_difference, 0.025, "Table 2"),
    Statement("ratio_three", "δ_NL 3 : 2", 3.0, by_difference, 0.3, "Table 2, quadratic law"),
    Statement("deviation_K", "∂T at 3.0, K", 1.0, by_factor, 2.0, "section 3.3, Figure 8"),
    Statement("triangle_K", "∂T triangle, K", 0.24, by_factor, 1.5, "section 5.3.3, Figure 10"),
    Statement("triangle_top_K", "at T2, K", 0.07, by_factor, 1.5, "section 5.3.3, Figure 10"),
    Statement("pressure_share", "p in 1 min", 0.75, at_least, 0.25, "section 5.3.2, Figure 7"),
    Statement("late_change", "last 5 min", 0.034, at_most, 0.02, "Table 1; section 5.2"),
    Statement("half_time_s", "t½ δ, s", 479.0, by_factor, 1.3, "Table 1"),
)

#: Follow from the printed tables, too, but the tables name neither unit nor sign: told, not scored.
TOLD = (
    Statement("nonlinear_half_time_s", "t½ δ_NL, s", 131.0, by_factor, 1.5, "Tables 2 and 3"),
    Statement("from_vertical_deg", "δ off y, °", 10.0, by_difference, 15.0, "Table 1"),
    Statement(
        "nonlinear_from_vertical_deg", "δ_NL off y, °", 9.0, by_difference, 15.0, "Tables 2 and 3"
    ),
)


def misses(observables: Mapping[str, float]) -> dict[str, float]:
    """Return by how many tolerances every statement is missed, by name."""
    return {one.name: one.miss(observables[one.name]) for one in STATEMENTS}


def score(observables: Mapping[str, float]) -> float:
    """Return the root mean square of the misses: 0 is best, `WORST` is worst."""
    found = np.array(list(misses(observables).values()))
    return float(np.sqrt(np.mean(found**2)))
