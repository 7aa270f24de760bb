"""Joints drawn at random, on structures drawn at random, and ways to settle them."""

from dataclasses import replace

import numpy as np
from bars import surface_law
from hypothesis import assume
from hypothesis import strategies as st

from fesim.joint.compiled_gap import compile_gap, trial_at
from fesim.joint.gap import gap_problem
from fesim.joint.law import BackBurdekinLaw, evaluate, stiffness_at_rest
from fesim.joint.modified_newton import settle_near
from fesim.joint.relaxation import relax
from thermojoint.artefacts.errors import ConvergenceError

CONTACT_AREA = 3.3e-3


K_N = 11e12


problems = {
    "seed": st.integers(0, 2**32 - 1),
    "count": st.integers(1, 6),
    "size": st.sampled_from([1e-7, 1e-6, 1e-5, 1e-4]),  # m
}


def held_by_a_joint(law, compliance):
    """The problem of one contact element with reference springs, of a body that hangs on it."""
    return gap_problem(
        compliance,
        np.ones(3),
        np.full(3, K_N),
        stiffness_at_rest([(law, 1)]),
        lambda gap, slip: evaluate(law, gap, slip),
    )


def structure_stiffness(rng, count, floating):
    """A random symmetric structure seen from its joint, N/m; semi-definite if it floats."""
    n = 3 * count
    modes, _ = np.linalg.qr(rng.normal(size=(n, n)))
    values = K_N * CONTACT_AREA * 10.0 ** rng.uniform(-3.0, 1.0, n)
    if floating:
        values[: max(1, n // 3)] = 0.0
    return (modes * values) @ modes.T


def problem_of(stiffness, friction, springs=1.0, law=None):
    """The gap problem, and gap per force of the structure with reference springs, m/N."""
    count = len(stiffness) // 3
    law = surface_law(friction) if law is None else law
    reference = np.full(3 * count, springs * K_N)
    compliance = np.linalg.inv(stiffness + CONTACT_AREA * np.diag(reference))
    compliance = 0.5 * (compliance + compliance.T)
    problem = gap_problem(
        compliance,
        np.full(3 * count, CONTACT_AREA),
        reference,
        stiffness_at_rest([(law, count)]),
        lambda gap, slip: evaluate(law, gap, slip),
    )
    return problem, compliance


def random_problem(seed, count, size, friction, springs=1.0, floating=False, law=None):
    """The gap problem, and its thermal gaps: `size` if nothing were in contact.

    With springs in it the compliance scales the thermal gap too, as K_r^-1 F T does.
    """
    rng = np.random.default_rng(seed)
    stiffness = structure_stiffness(rng, count, floating)
    free_gap = size * rng.uniform(-1.0, 1.0, 3 * count)
    problem, compliance = problem_of(stiffness, friction, springs, law)
    return problem, compliance @ (stiffness @ free_gap)


def solved(solve, problem, thermal_gap, slip, guess, floating):
    """Newton's method from a guess or, where it fails, the viscous way from there.

    One that only its joint holds, `floating`, may come loose: there is no equilibrium to be found.
    """
    try:
        return solve(thermal_gap, slip, guess)
    except ConvergenceError:
        pass
    try:
        return relax(problem, thermal_gap, slip, guess)[0]
    except ConvergenceError as error:
        assume(not (floating and "come loose" in str(error)))
        raise


powers = st.sampled_from([None, 0.5])


def law_of(friction, exponent):
    """The surface law, or Back and Burdekin's with an exponent."""
    law = surface_law(friction)
    if exponent is None:
        return law
    return replace(law, normal=BackBurdekinLaw(2.52e-6 / 4.41e6**exponent, exponent, 4.41e6))


#: So tight that nothing but the method is compared, m.
TIGHT = 1e-16


def settled(problem, laws, thermal_gap, slip, guess, tangents, tolerance=TIGHT):
    """Whether it is solved, the residual, the gaps and the slip."""
    trial, solver = trial_at(guess), compile_gap(problem, laws)
    kernel = solver.kernel(problem.columns, tolerance)
    rest = problem.change * thermal_gap
    found, residual, _ = settle_near(kernel, tangents, thermal_gap, rest, slip, trial)
    return found, residual, trial.gap, trial.moved
