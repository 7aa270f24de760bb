"""Snap-through to another equilibrium by viscous relaxation of the gap equations.

Friction can end a branch of equilibria: a contact element begins to slide, its neighbours cannot
carry the released load, and there is no equilibrium nearby any more. Newton's method then fails,
however short the step. A real joint snaps to an equilibrium tens of micrometres away. Dampers of
c k0 (Pa s/m) across the joint provide a path there. Its implicit Euler step solves

    r(g) + d F k0 (g - g_before) = 0,    d = c / (length of the step),

which is the gap problem with a damped law. For large d it has one solution, nearby. Steps grow as
long as they converge easily, until no damper is needed (pseudo-transient continuation, Kelley &
Keyes 1998): the result solves the equations without dampers, to the same tolerance.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from fesim.joint.gap import TOLERANCE, Equilibrium, GapProblem, loose, solve_gap, unconverged
from fesim.joint.law import ACROSS, ALONG, NORMAL, Traction
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: Most viscous steps, including failed ones.
MAX_STEPS = 500
#: Most Newton iterations of a viscous step, or without dampers; if more are needed, the step is too
#: long, or dampers are still needed.
MAX_ITERATIONS = 12
#: Tolerance of a viscous step, relative to its initial residual.
ROUGHLY = 1e-2
#: Factors on d after a successful step, and after a failed one.
LONGER, SHORTER = 0.25, 8.0
#: Below this d, Newton's method is tried without dampers.
WEAK = 0.02
#: Weaker dampers have no effect, stiffer ones prevent any motion: only rounding is left.
WEAKEST, STIFFEST = 1e-12, 1e12
#: Gap of an unconstrained body, m.
ADRIFT = 1.0


def relax(
    problem: GapProblem,
    thermal_gap: Array,
    slip: Array,
    gap: Array,
    tolerance: float = TOLERANCE,
) -> tuple[Equilibrium, int]:
    """Return the equilibrium reached by an overdamped joint, and its number of viscous steps.

    Parameters as for `fesim.joint.gap.solve_gap`; `gap` is the start of the joint.

    Raises
    ------
    ConvergenceError
        The joint does not come to rest.
    """
    if not np.isfinite(thermal_gap).all():
        raise ConvergenceError(
            "gap equations: the thermal gaps are not finite; check heat and materials of the case"
        )
    damping, moved, iterations = 1.0, 0.0, 0
    for steps in range(1, MAX_STEPS + 1):
        if damping <= WEAK:
            try:
                settled = solve_gap(problem, thermal_gap, slip, gap, tolerance, MAX_ITERATIONS)
            except ConvergenceError:
                pass
            else:
                return replace(settled, iterations=iterations + settled.iterations), steps
        size = float(np.abs(problem.residual(gap, problem.law(gap, slip), thermal_gap)).max())
        if not WEAKEST < damping < STIFFEST:
            raise unconverged(size, tolerance, iterations)
        damped = replace(problem, law=partial(_damped, problem, damping, gap))
        roughly = max(tolerance, ROUGHLY * size)
        try:
            settled = solve_gap(damped, thermal_gap, slip, gap, roughly, MAX_ITERATIONS)
        except ConvergenceError:
            damping *= SHORTER
            continue
        moved = float(np.abs(settled.gap - gap).max())
        gap, iterations = settled.gap, iterations + settled.iterations
        damping *= LONGER
        if np.abs(gap).max() > ADRIFT:
            raise loose(f"the joint moves by more than {ADRIFT:g} m")
    raise ConvergenceError(
        f"gap equations: the joint does not come to rest: it still moves by {moved:.1e} m in a "
        f"viscous step after {MAX_STEPS} of them; lower friction_coefficient"
    )


def _damped(
    problem: GapProblem, damping: float, before: Array, gap: Array, slip: Array
) -> Traction:
    """The joint's law with dampers in parallel."""
    traction = problem.law(gap, slip)
    dampers = damping * problem.springs.reshape(before.shape)
    tangent = traction.tangent.copy()
    tangent[[NORMAL, ALONG, ACROSS]] -= dampers
    return Traction(traction.value - dampers * (gap - before), tangent, traction.slip)
