"""Mechanical equilibrium of the joint: Newton's method in the gap, with a backtracking line search.

Unknown: the gaps g (opening, two tangential) of all contact elements. Residual:
r(g) = g - g_T - C A [z(g) + k g], with the law's traction z, the thermal gap g_T and the reference
springs k, whose force C contains already. In the gap, unlike in the tractions, the law has a
bounded slope however much the joint slides or opens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artefacts.errors import ConvergenceError
from fesim.joint_law import Traction

Array = NDArray[np.float64]
Law = Callable[[Array, Array], Traction]

#: Largest gap residual of an accepted state, m.
TOLERANCE = 1e-13
MAX_ITERATIONS = 60
SHORTEST_STEP = 2.0**-10
MAX_FULL_STEPS = 10


@dataclass(frozen=True)
class Equilibrium:
    """A converged state of the joint.

    Attributes
    ----------
    gap : ndarray, shape (3, m)
        Opening and tangential relative displacements, m.
    traction : Traction
        The law there.
    residual : float
        Largest gap residual, m.
    iterations : int
        Newton iterations taken.
    """

    gap: Array
    traction: Traction
    residual: float
    iterations: int


@dataclass(frozen=True)
class GapProblem:
    """The linear side of the gap equations, with dense matrices made once.

    Attributes
    ----------
    force_compliance : ndarray, shape (3 m, 3 m)
        C A: gap per traction, m/Pa.
    reference : ndarray, shape (3 m,)
        k, Pa/m.
    law : callable
        (gap, slip) to `Traction`.
    """

    force_compliance: Array
    reference: Array
    law: Law

    def residual(self, gap: Array, traction: Traction, thermal_gap: Array) -> Array:
        """r(g), shape (3 m,), m."""
        remainder = traction.value.ravel() + self.reference * gap.ravel()
        return gap.ravel() - thermal_gap - self.force_compliance @ remainder

    def jacobian(self, traction: Traction) -> Array:
        """dr/dg, shape (3 m, 3 m)."""
        size = self.reference.size
        count = size // 3
        product = -self.force_compliance * self.reference
        blocks = self.force_compliance.reshape(size, 3, count)
        product -= np.einsum("rim,ijm->rjm", blocks, traction.tangent).reshape(size, size)
        product[np.diag_indices(size)] += 1.0
        return product


def solve_gap(
    problem: GapProblem,
    thermal_gap: Array,
    slip: Array,
    guess: Array,
    tolerance: float = TOLERANCE,
) -> Equilibrium:
    """Find the gaps in equilibrium with a thermal gap.

    Parameters
    ----------
    problem : GapProblem
        Compliance and law.
    thermal_gap : ndarray, shape (3 m,)
        g_T = S_T T, m.
    slip : ndarray, shape (2, m)
        Irreversible slip at the start of the step, m.
    guess : ndarray, shape (3, m)
        First guess of the gaps, m.
    tolerance : float
        Largest residual accepted, m.

    Raises
    ------
    ConvergenceError
        The residual stays above `tolerance`.
    """
    gap = guess
    traction = problem.law(gap, slip)
    residual = problem.residual(gap, traction, thermal_gap)
    full_steps = MAX_FULL_STEPS
    for iteration in range(MAX_ITERATIONS):
        size = float(np.abs(residual).max())
        # The residual is a difference of gaps: where these are coarser, zero is only rounding.
        if size <= tolerance and np.spacing(np.abs(gap).max()) <= tolerance:
            return Equilibrium(gap, traction, size, iteration)
        step = _newton_step(problem, traction, residual).reshape(gap.shape)
        length = 1.0
        while True:
            trial = gap + length * step
            trial_traction = problem.law(trial, slip)
            trial_residual = problem.residual(trial, trial_traction, thermal_gap)
            if _norm(trial_residual) <= (1.0 - 1e-4 * length) * _norm(residual):
                break
            length /= 2.0
            if length < SHORTEST_STEP:
                # No descent: the iterate sits on a kink of the law (stick to slip) and has the
                # tangent of the wrong side. A full step leaves the kink.
                if full_steps == 0:
                    raise stalled(size)
                full_steps -= 1
                trial = gap + step
                trial_traction = problem.law(trial, slip)
                trial_residual = problem.residual(trial, trial_traction, thermal_gap)
                break
        gap, traction, residual = trial, trial_traction, trial_residual
    raise unconverged(float(np.abs(residual).max()), tolerance)


def stalled(residual: float) -> ConvergenceError:
    """Return the error of a line search that finds no descent any more."""
    return ConvergenceError(
        f"gap equations: the line search stalled at a residual of {residual:.1e} m; take a shorter "
        "march.step_s"
    )


def unconverged(residual: float, tolerance: float) -> ConvergenceError:
    """Return the error of too many iterations."""
    return ConvergenceError(
        f"gap equations: residual {residual:.1e} m after {MAX_ITERATIONS} iterations, wanted "
        f"{tolerance:.0e} m; take a shorter march.step_s"
    )


def singular() -> ConvergenceError:
    """Return the error of a tangent that has no inverse."""
    return ConvergenceError(
        "gap equations: the tangent is singular: a body that the joint holds has come loose; "
        "support the body or raise preload_MPa"
    )


def _newton_step(problem: GapProblem, traction: Traction, residual: Array) -> Array:
    try:
        step = np.linalg.solve(problem.jacobian(traction), -residual)
    except np.linalg.LinAlgError as error:
        raise singular() from error
    return np.asarray(step, dtype=np.float64)


def _norm(residual: Array) -> float:
    return float(np.sqrt(residual @ residual))
