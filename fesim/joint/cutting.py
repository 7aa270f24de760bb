"""Subdivision of a step of the gap equations that has no continuous solution path.

The thermal gap of a long step may pass through states that affect friction: an element that would
close, stick and open again sees only the end points. So the step from the last equilibrium is
divided into pieces, each starting from the friction history of the previous ones: with Newton's
method if it finds an equilibrium, with `fesim.joint.relaxation` if a piece snaps. A piece that
fails is halved repeatedly.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from fesim.joint.gap import TOLERANCE, Equilibrium, GapProblem, solve_gap
from fesim.joint.law import Traction
from fesim.joint.relaxation import relax
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Length of the shortest piece, relative to the step.
SHORTEST = 2.0**-10


def cut(
    problem: GapProblem,
    thermal_gap: Array,
    slip: Array,
    gap: Array,
    tolerance: float = TOLERANCE,
    explain: Callable[[Traction], None] | None = None,
) -> tuple[Equilibrium, int]:
    """Return the equilibrium at the end of a step, and its numbers of pieces and viscous steps.

    Parameters as for `fesim.joint.gap.solve_gap`; `gap` is the equilibrium at the start. `explain`
    receives the last state reached, and may raise a more specific error.

    Raises
    ------
    ConvergenceError
        A piece of `SHORTEST` fails as well.
    """
    start = held_by(problem, gap, slip)
    reached, length, taken, iterations = 0.0, 0.5, 0, 0
    while True:
        end = min(reached + length, 1.0)
        between = start + end * (thermal_gap - start) if end < 1.0 else thermal_gap
        try:
            settled, steps = _piece(problem, between, slip, gap, tolerance)
        except ConvergenceError:
            length *= 0.5
            if length < SHORTEST:
                if explain is not None:
                    explain(problem.law(gap, slip))
                raise
            continue
        gap, slip = settled.gap, settled.traction.slip
        taken, iterations = taken + steps + 1, iterations + settled.iterations
        if end == 1.0:
            return replace(settled, iterations=iterations), taken
        reached, length = end, 2.0 * length


def held_by(problem: GapProblem, gap: Array, slip: Array) -> Array:
    """Return the thermal gap (3 m,), m, at which gaps (3, m) are in equilibrium."""
    remainder = problem.law(gap, slip).value.ravel() + problem.springs * gap.ravel()
    free = gap.ravel() - problem.compliance @ remainder
    inverse = problem.compliance * problem.change
    inverse[np.diag_indices(free.size)] += 1.0
    return np.asarray(np.linalg.solve(inverse, free))


def _piece(
    problem: GapProblem, thermal_gap: Array, slip: Array, gap: Array, tolerance: float
) -> tuple[Equilibrium, int]:
    with suppress(ConvergenceError):
        return solve_gap(problem, thermal_gap, slip, gap, tolerance), 0
    return relax(problem, thermal_gap, slip, gap, tolerance)
