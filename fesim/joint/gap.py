"""Mechanical equilibrium of the joint by Newton's method in the gap with line search.

Unknown: the gaps g (opening, two tangential) of all contact elements. The condensation gives
g = g_T + C A [z(g) + k g], with the law's traction z, the thermal gap g_T and the reference springs
k, whose forces C already includes. They are replaced by springs k0 as stiff as the joint itself:
r(g) = g - J0^-1 g_T - F [z(g) + k0 g], J0 = I - C A (k - k0), F = J0^-1 C A. The solutions are the
same, and r does not depend on k: it is the error of the gaps of a joint that sticks at its preload.
As a function of the gap, unlike of the tractions, the law has a bounded slope however much the
joint slides or opens.

Start here: `solve_gap` is the method to read. The same method exists as compiled code for known
laws (`fesim.joint.compiled_gap`), and a march tries a frozen tangent first
(`fesim.joint.modified_newton`); their tests compare both with this one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from fesim.joint.law import Traction, tangent_matrix
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

Law = Callable[[Array, Array], Traction]
Real = TypeVar("Real", np.float32, np.float64)

#: Largest residual of an accepted state, m.
TOLERANCE = 1e-13
MAX_ITERATIONS = 60
SHORTEST_STEP = 2.0**-10
MAX_FULL_STEPS = 10
#: Reference springs whose relative difference from the joint's own is below this are nearly equal.
NEAR = 0.01
#: Number of rows copied at a time from one triangle of a symmetric matrix into the other.
AT_ONCE = 64
#: Edge of the tiles in which a matrix is transposed.
TILE = 500


@dataclass(frozen=True)
class Equilibrium:
    """A converged state of the joint."""

    #: Shape (3, m): opening and tangential relative displacements, m.
    gap: Array
    #: Tractions there.
    traction: Traction
    #: Largest gap residual, m.
    residual: float
    #: Newton iterations taken.
    iterations: int


@dataclass(frozen=True)
class GapProblem:
    """The gap equations of one machine, with precomputed dense matrices; see `gap_problem`."""

    #: Shape (3 m,): k0: stiffness of the joint at its preload while it sticks, Pa/m.
    springs: Array
    #: Shape (3 m,): k - k0: excess stiffness of the condensation's springs, Pa/m.
    change: Array
    #: Shape (3 m, 3 m): F: gap per traction of the structure with the springs k0, m/Pa.
    compliance: Array
    #: From (gap, slip) to `Traction`.
    law: Law

    @cached_property
    def columns(self) -> Array:
        """F transposed, contiguous: shape (3 m, 3 m), m/Pa."""
        return transposed(self.compliance, np.float64)

    def at_rest(self, gap: Array) -> Array:
        """J0^-1 g of gaps g with the condensation's springs, shape (3 m,) or (3 m, n), m.

        J0^-1 = I + F (k - k0).
        """
        moved = self.compliance @ (self.change * gap.T).T
        moved += gap
        return np.asarray(moved)

    def residual(self, gap: Array, traction: Traction, thermal_gap: Array) -> Array:
        """r(g), shape (3 m,), m."""
        remainder = traction.value.ravel() + self.springs * gap.ravel()
        return gap.ravel() - self.at_rest(thermal_gap) - self.compliance @ remainder

    def jacobian(self, traction: Traction) -> Array:
        """dr/dg, shape (3 m, 3 m)."""
        size = self.springs.size
        count = size // 3
        product = -self.compliance * self.springs
        blocks = self.compliance.reshape(size, 3, count)
        tangent = tangent_matrix(traction.tangent)
        product -= np.einsum("rim,ijm->rjm", blocks, tangent).reshape(size, size)
        product[np.diag_indices(size)] += 1.0
        return product


def transposed(matrix: Array, precision: type[Real]) -> NDArray[Real]:
    """Return the transpose of a square matrix, contiguous.

    It is computed tile by tile, as whole rows would miss the cache.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    precision : type
        Type of the numbers of the transpose.
    """
    found = np.empty(matrix.shape, dtype=precision)
    starts = range(0, len(matrix), TILE)
    for i in starts:
        for j in starts:
            found[j : j + TILE, i : i + TILE] = matrix[i : i + TILE, j : j + TILE].T
    return found


def gap_problem(
    compliance: Array, area: Array, reference: Array, springs: Array, law: Law
) -> GapProblem:
    """Replace the springs of the condensation by springs as stiff as the joint.

    Parameters
    ----------
    compliance : ndarray, shape (3 m, 3 m)
        C, symmetric: gap per joint force with the reference springs, m/N.
    area : ndarray, shape (3 m,)
        A, m2.
    reference : ndarray, shape (3 m,)
        k, Pa/m.
    springs : ndarray, shape (3 m,)
        k0, Pa/m: `fesim.joint.law.stiffness_at_rest`.
    law : callable
        From (gap, slip) to `Traction`.

    Raises
    ------
    ConvergenceError
        A body is constrained by the joint alone, and not sufficiently.
    """
    change = reference - springs
    near = np.abs(change) <= NEAR * springs
    sides = np.sign(change)
    found = None
    if springs.size and not near.any() and (sides == sides[0]).all():
        found = _definite_inverse(compliance, area * change)
    if found is None:
        found = _inverse(compliance, area * change)
    # J0^-1 C A (k - k0) = J0^-1 - I: a product is only needed for columns with nearly equal k, k0.
    product = found @ (compliance[:, near] * area[near])
    divisor = np.where(near, 1.0, change)
    found /= divisor
    found[np.diag_indices(springs.size)] -= 1.0 / divisor
    found[:, near] = product
    return GapProblem(springs, change, found, law)


def _inverse(compliance: Array, change: Array) -> Array:
    """(I - C D)^-1 of stiffnesses D (3 m,), N/m."""
    tangent = compliance * -change
    tangent[np.diag_indices(change.size)] += 1.0
    try:
        return np.asarray(np.linalg.inv(tangent), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise singular() from error


def _definite_inverse(compliance: Array, change: Array) -> Array | None:
    """`_inverse` of stiffnesses of one sign; None if it is not definite.

    With R = |D|^1/2 it is R^-1 (I -+ R C R)^-1 R: the inverse of a symmetric matrix takes less than
    half as long. It is positive definite if supports and joints hold all bodies.
    """
    root = np.sqrt(np.abs(change))
    system = compliance * root
    system *= (-np.sign(change) * root)[:, None]
    system[np.diag_indices(root.size)] += 1.0
    # In place, as allocating a large array costs more than the operations. LAPACK uses column
    # order: its lower triangle is the upper one here.
    factor, failed = lapack.dpotrf(system.T, lower=True, clean=False, overwrite_a=True)
    if failed:
        return None
    inverse, failed = lapack.dpotri(factor, lower=True, overwrite_c=True)
    if failed:
        return None
    inverse = inverse.T
    for start in range(0, root.size, AT_ONCE):
        block = slice(start, start + AT_ONCE)
        inverse[block, :start] = inverse[:start, block].T
        own = np.triu(inverse[block, block])
        inverse[block, block] = own + np.triu(own, 1).T
    inverse *= root
    inverse /= root[:, None]
    return np.asarray(inverse)


# Too long a step ends in infinities, which are never accepted.
@np.errstate(over="ignore", invalid="ignore")
def solve_gap(
    problem: GapProblem,
    thermal_gap: Array,
    slip: Array,
    guess: Array,
    tolerance: float = TOLERANCE,
    iterations: int = MAX_ITERATIONS,
) -> Equilibrium:
    """Find the equilibrium gaps for a thermal gap.

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
    iterations : int
        Largest number of iterations.

    Raises
    ------
    ConvergenceError
        The residual stays above `tolerance`; `fesim.joint.relaxation.relax` may still succeed.
    """
    gap = guess
    traction = problem.law(gap, slip)
    residual = problem.residual(gap, traction, thermal_gap)
    full_steps = MAX_FULL_STEPS
    for iteration in range(iterations):
        size = float(np.abs(residual).max())
        # The residual is a difference of gaps: below their rounding, it cannot be smaller.
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
    raise unconverged(float(np.abs(residual).max()), tolerance, iterations)


def stalled(residual: float) -> ConvergenceError:
    """Return the error of a line search without descent."""
    return ConvergenceError(
        f"gap equations: Newton's method stalled at a residual of {residual:.1e} m: perhaps no "
        "equilibrium is near"
    )


def unconverged(
    residual: float, tolerance: float, iterations: int = MAX_ITERATIONS
) -> ConvergenceError:
    """Return the error of too many iterations."""
    return ConvergenceError(
        f"gap equations: residual {residual:.1e} m after {iterations} iterations of Newton's "
        f"method, wanted {tolerance:.0e} m"
    )


def singular() -> ConvergenceError:
    """Return the error of a tangent that has no inverse."""
    return loose("the tangent is singular")


def loose(sign: str) -> ConvergenceError:
    """Return the error of an unconstrained body, with the details known."""
    return ConvergenceError(
        f"gap equations: {sign}: a body that the joint holds has come loose; support the body or "
        "raise preload_MPa"
    )


def _newton_step(problem: GapProblem, traction: Traction, residual: Array) -> Array:
    try:
        step = np.linalg.solve(problem.jacobian(traction), -residual)
    except np.linalg.LinAlgError as error:
        raise singular() from error
    return np.asarray(step, dtype=np.float64)


def _norm(residual: Array) -> float:
    return float(np.sqrt(residual @ residual))
