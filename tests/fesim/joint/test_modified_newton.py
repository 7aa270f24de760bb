"""A kept inverse, corrected and moved: the equilibria and marches of the plain method."""

import numpy as np
from bars import surface_law
from hypothesis import given, settings
from hypothesis import strategies as st
from random_joints import TIGHT, law_of, powers, problems, random_problem, settled

from fesim.joint.blocks import one_block, part_of
from fesim.joint.compiled_gap import compile_gap
from fesim.joint.frozen_tangent import FROZEN, block_tangent, freeze_tangent, frozen_tangents
from fesim.joint.gap import solve_gap


def nowhere(problem):
    """Storage of one block without a frozen tangent yet."""
    columns = np.ascontiguousarray(problem.compliance.T)
    return frozen_tangents(one_block(problem.springs, problem.compliance, columns))


@settings(max_examples=150, derandomize=True)
@given(**problems, friction=st.sampled_from([0.0, 0.15, 0.3]), power=powers)
def test_it_finds_the_equilibrium_of_the_plain_method(seed, count, size, friction, power):
    """Or says that it did not: then its caller takes Newton's own method."""
    law = law_of(friction, power)
    problem, thermal_gap = random_problem(seed, count, size, friction, law=law)
    zero = np.zeros((3, count))
    theirs = solve_gap(problem, thermal_gap, zero[1:], zero, TIGHT)
    found, residual, gap, slip = settled(
        problem, [(law, count)], thermal_gap, zero[1:], zero, nowhere(problem)
    )
    if not found:
        assert size > 1e-7  # what a long step of a march moves
        return
    assert residual <= TIGHT
    true = problem.residual(gap, problem.law(gap, zero[1:]), thermal_gap)
    np.testing.assert_allclose(true, 0.0, rtol=0.0, atol=2.0 * TIGHT)
    np.testing.assert_allclose(gap, theirs.gap, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(slip, theirs.traction.slip, rtol=1e-9, atol=1e-12)


@settings(max_examples=150, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), friction=st.sampled_from([0.05, 0.15, 0.3]))
def test_a_tangent_frozen_far_away_changes_nothing(seed, friction):
    """Other contact elements slide, stick and are open there: they are corrected exactly."""
    count, law = 6, surface_law(friction)
    problem, thermal_gap = random_problem(seed, count, 1e-6, friction, law=law)
    zero = np.zeros((3, count))
    near, far = nowhere(problem), nowhere(problem)
    first, _, gap, slip = settled(problem, [(law, count)], thermal_gap, zero[1:], zero, near)
    rng = np.random.default_rng(seed)
    made = compile_gap(problem, [(law, count)])
    elsewhere = made.solve(
        random_problem(seed + 1, count, 3e-6, friction, law=law)[1],
        1e-7 * rng.normal(size=(2, count)),
        zero,
    )
    frozen = block_tangent(far, 0)
    frozen.tangent[:] = elsewhere.traction.tangent
    freeze_tangent(frozen, part_of(far.blocks, 0))
    second, _, other, moved = settled(problem, [(law, count)], thermal_gap, zero[1:], zero, far)
    if first and second:
        np.testing.assert_allclose(other, gap, rtol=1e-9, atol=1e-13)
        np.testing.assert_allclose(moved, slip, rtol=1e-9, atol=1e-13)


def test_a_joint_that_has_slipped_and_sticks_keeps_its_frozen_tangent():
    """The rounding of k0 (g - s), another in every iteration, is no change of a state."""
    count, law = 12, surface_law(0.6)
    problem, thermal_gap = random_problem(5, count, 1e-7, 0.6, law=law)
    slip = 1e-8 * np.random.default_rng(5).normal(size=(2, count))
    tangents, gap = nowhere(problem), np.vstack([np.zeros((1, count)), slip])
    for factor in np.linspace(0.0, 1.0, 20):
        driven = (problem, [(law, count)], factor * thermal_gap, slip, gap, tangents)
        solved, _, gap, moved = settled(*driven, tolerance=1e-13)
        assert solved
        np.testing.assert_array_equal(moved, slip)
    assert tangents.every.about[0, FROZEN] <= 3


def test_a_joint_at_rest_is_settled_at_once():
    """Exactly nothing is lacking, with Back and Burdekin's law and without friction."""
    law = law_of(0.0, 0.5)
    problem, _ = random_problem(1, 5, 1e-6, 0.0, law=law)
    zero = np.zeros((3, 5))
    found, residual, gap, _ = settled(
        problem, [(law, 5)], np.zeros(15), zero[1:], zero, nowhere(problem)
    )
    assert found
    assert residual == 0.0
    np.testing.assert_array_equal(gap, zero)


def test_a_tolerance_out_of_reach_is_not_reached():
    problem, thermal_gap = random_problem(7, 4, 1e-6, 0.6)
    zero = np.zeros((3, 4))
    laws = [(surface_law(0.6), 4)]
    assert not settled(problem, laws, thermal_gap, zero[1:], zero, nowhere(problem), 0.0)[0]
    none = np.full_like(thermal_gap, np.nan)
    assert not settled(problem, laws, none, zero[1:], zero, nowhere(problem))[0]
