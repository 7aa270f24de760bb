"""Equilibrium of the joint: always converged, never accepted when it is not."""

from functools import partial

import numpy as np
import pytest
from bars import surface_law
from hypothesis import given, settings
from hypothesis import strategies as st
from random_joints import (
    CONTACT_AREA,
    K_N,
    held_by_a_joint,
    problem_of,
    problems,
    random_problem,
    solved,
    structure_stiffness,
)

from fesim.joint.gap import TOLERANCE, gap_problem, solve_gap
from thermojoint.artefacts.errors import ConvergenceError


@pytest.mark.parametrize(
    "ratios",
    [[0.0, 1e-6, 0.5, 0.98, 0.995, 1.0, 2.0, 1e6], [0.0, 1e-6, 0.5, 0.98], [1.02, 2.0, 50.0, 1e6]],
)
def test_gaps_by_tractions_are_those_of_the_exchanged_springs(ratios):
    """F = J0^-1 C A, where the joint's springs are none, soft, nearly the same, equal and stiff.

    All softer, or all stiffer, the inverse is that of a symmetric matrix.
    """
    rng, size = np.random.default_rng(4), 48
    modes, _ = np.linalg.qr(rng.normal(size=(size, size)))
    area = rng.uniform(0.5, 1.0, size)
    compliance = (modes * rng.uniform(0.01, 0.5, size)) @ modes.T / K_N
    compliance /= np.sqrt(area) * np.sqrt(area)[:, None]
    reference, springs = np.full(size, K_N), K_N * np.resize(ratios, size)
    problem = gap_problem(compliance, area, reference, springs, surface_law(0.1))
    system = np.eye(size) - compliance * area * (reference - springs)
    exact = np.linalg.solve(system, compliance * area)
    np.testing.assert_allclose(problem.compliance, exact, rtol=0.0, atol=1e-13 / K_N)
    gaps = rng.normal(size=(size, 2))
    exact = np.linalg.solve(system, gaps)
    np.testing.assert_allclose(problem.at_rest(gaps), exact, rtol=0.0, atol=1e-12)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(**problems, friction=st.sampled_from([0.0, 0.15, 0.3]))
def test_joints_converge_in_one_go_from_rest(seed, count, size, friction):
    """Any held structure, thermal gaps up to 0.1 mm: a hundred times a step of the march."""
    problem, thermal_gap = random_problem(seed, count, size, friction)
    zero = np.zeros((3, count))
    found = solve_gap(problem, thermal_gap, zero[1:], zero)
    assert found.residual <= TOLERANCE
    residual = problem.residual(found.gap, problem.law(found.gap, zero[1:]), thermal_gap)
    assert np.abs(residual).max() <= TOLERANCE


@settings(max_examples=80, deadline=None, derandomize=True)
@given(**problems, friction=st.sampled_from([0.0, 0.6, 2.0, 10.0]), floating=st.booleans())
def test_an_equilibrium_is_found_however_hard_the_problem(seed, count, size, friction, floating):
    """Strong friction, mechanisms, gaps of up to 3 mm and a guess that is far away."""
    problem, thermal_gap = random_problem(seed, count, 30.0 * size, friction, floating=floating)
    slip = np.random.default_rng(seed).uniform(-1e-6, 1e-6, (2, count))
    guess = np.random.default_rng(seed).uniform(-5e-6, 20e-6, (3, count))
    found = solved(partial(solve_gap, problem), problem, thermal_gap, slip, guess, floating)
    law = problem.law(found.gap, slip)
    assert np.abs(problem.residual(found.gap, law, thermal_gap)).max() <= TOLERANCE
    np.testing.assert_array_equal(found.traction.value, law.value)
    assert np.spacing(np.abs(found.gap).max()) <= TOLERANCE


@settings(max_examples=100, deadline=None, derandomize=True)
@given(**problems)
def test_without_friction_the_equilibrium_does_not_depend_on_the_guess(seed, count, size):
    """The pressure falls monotonically with the opening, so there is one equilibrium only."""
    problem, thermal_gap = random_problem(seed, count, size, 0.0)
    zero = np.zeros((3, count))
    rng = np.random.default_rng(seed)
    first = solve_gap(problem, thermal_gap, zero[1:], zero, 1e-15)
    guess = rng.uniform(-5e-6, 20e-6, zero.shape)
    second = solve_gap(problem, thermal_gap, zero[1:], guess, 1e-15)
    np.testing.assert_allclose(second.gap, first.gap, rtol=1e-6, atol=1e-12)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(**problems, springs=st.sampled_from([0.1, 3.0]))
def test_reference_springs_leave_no_trace(seed, count, size, springs):
    one, thermal_one = random_problem(seed, count, size, 0.0)
    other, thermal_other = random_problem(seed, count, size, 0.0, springs)
    zero = np.zeros((3, count))
    first = solve_gap(one, thermal_one, zero[1:], zero, 1e-15)
    second = solve_gap(other, thermal_other, zero[1:], zero, 1e-15)
    np.testing.assert_allclose(second.gap, first.gap, rtol=1e-6, atol=1e-12)


def test_a_gap_so_wide_that_its_residual_is_rounding_is_no_equilibrium():
    """1e9 m less 1e9 m is zero in floating point, whatever the forces are."""
    problem = held_by_a_joint(surface_law(), np.eye(3) / K_N)
    far = np.full((3, 1), 2.0**40)
    with pytest.raises(ConvergenceError, match="has come loose"):
        solve_gap(problem, np.zeros(3), far[1:], far)


def test_one_spring_in_series_with_the_joint():
    """A structure of stiffness k pushed by a gap g0 onto the joint: p - p0 = (k/A) (g0 - g)."""
    stiffness = np.diag([0.2 * K_N * CONTACT_AREA] * 3)
    problem, compliance = problem_of(stiffness, 0.6)
    for free_gap in (-20e-6, -2e-6, 0.5e-6, 3e-6, 50e-6):
        load = stiffness @ np.array([free_gap, 0.0, 0.0])
        thermal_gap = compliance @ load
        found = solve_gap(problem, thermal_gap, np.zeros((2, 1)), np.zeros((3, 1)), 1e-16)
        excess = found.traction.value[0, 0]
        balance = stiffness[0, 0] / CONTACT_AREA * (found.gap[0, 0] - free_gap)
        assert excess == pytest.approx(balance, rel=1e-8, abs=1.0)
        assert (excess > 0.0) == (free_gap < 0.0)


def test_no_load_is_in_equilibrium_at_once():
    problem, _ = problem_of(structure_stiffness(np.random.default_rng(0), 4, True), 0.6)
    zero = np.zeros((3, 4))
    found = solve_gap(problem, np.zeros(12), zero[1:], zero)
    assert found.iterations == 0
    np.testing.assert_allclose(found.traction.value, 0.0, atol=1e-6)


@pytest.mark.parametrize("tolerance", [0.0, 1e-40])
def test_a_tolerance_out_of_reach_raises(tolerance):
    problem, thermal_gap = random_problem(7, 4, 1e-5, 0.6)
    zero = np.zeros((3, 4))
    with pytest.raises(ConvergenceError, match="gap equations") as caught:
        solve_gap(problem, thermal_gap, zero[1:], zero, tolerance)
    assert "\n" not in str(caught.value)


def test_a_thermal_gap_that_is_not_finite_raises():
    problem, thermal_gap = random_problem(7, 2, 1e-5, 0.6)
    zero = np.zeros((3, 2))
    with pytest.raises(ConvergenceError):
        solve_gap(problem, np.full_like(thermal_gap, np.nan), zero[1:], zero)


def test_jacobian_is_the_derivative_of_the_residual():
    problem, thermal_gap = random_problem(5, 3, 1e-5, 0.6)
    rng = np.random.default_rng(5)
    gap, slip = rng.uniform(-1e-6, 1e-6, (3, 3)), np.zeros((2, 3))
    jacobian = problem.jacobian(problem.law(gap, slip))
    h = 1e-11
    for j in range(9):
        shift = (h * np.eye(9)[j]).reshape(3, 3)
        up, down = (
            problem.residual(gap + s * shift, problem.law(gap + s * shift, slip), thermal_gap)
            for s in (1.0, -1.0)
        )
        np.testing.assert_allclose((up - down) / (2 * h), jacobian[:, j], rtol=1e-4, atol=1e-5)
