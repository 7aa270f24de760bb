"""Machine code and plain method: the same law, the same equilibria, the same march."""

from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
import pytest
from bars import assemble, driven, surface_law, two_bars
from hypothesis import example, given, settings
from hypothesis import strategies as st
from random_joints import law_of, powers, problems, random_problem, solved

from fesim.case.history import sampled_history
from fesim.joint import compiled_gap
from fesim.joint.compiled_gap import compile_gap
from fesim.joint.gap import TOLERANCE, gap_problem, solve_gap
from fesim.joint.law import SurfaceNormalLaw, evaluate, stiffness_at_rest
from fesim.march.stepping import march, staggered
from thermojoint.artefacts.errors import ConvergenceError


def compiled(problem, law, count):
    return compile_gap(problem, [(law, count)])


@settings(max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    friction=st.sampled_from([0.0, 0.15, 0.6, 5.0]),
    power=st.sampled_from([None, 0.5, 1.0]),
)
def test_the_law_is_that_of_the_plain_one(seed, friction, power):
    """Pressed, relieved and open contact elements, at rest, sticking and sliding."""
    rng = np.random.default_rng(seed)
    count = 8
    gap = rng.choice([1e-8, 1e-6, 3e-5], (3, count)) * rng.uniform(-1.0, 1.0, (3, count))
    slip = 1e-6 * rng.uniform(-1.0, 1.0, (2, count)) * rng.integers(0, 2, count)
    gap[1:, :2] = slip[:, :2]  # no trial traction at all
    law = law_of(friction, power)
    problem, _ = random_problem(seed, count, 1e-6, friction, law=law)
    made = compiled(problem, law, count)
    trial = compiled_gap.trial_at(gap)
    compiled_gap.evaluate_in_place(made.laws, slip, trial)
    plain = evaluate(law, gap, slip)
    stiffest = np.abs(plain.tangent).max()
    np.testing.assert_allclose(trial.value, plain.value, rtol=1e-12, atol=1e-6)
    np.testing.assert_allclose(trial.moved, plain.slip, rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose(trial.tangent, plain.tangent, rtol=1e-12, atol=1e-13 * stiffest)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(**problems, friction=st.sampled_from([0.0, 0.15, 0.3]), power=powers)
def test_it_finds_the_equilibrium_of_the_plain_method(seed, count, size, friction, power):
    law = law_of(friction, power)
    plain, thermal_gap = random_problem(seed, count, size, friction, law=law)
    zero = np.zeros((3, count))
    ours = compiled(plain, law, count).solve(thermal_gap, zero[1:], zero, 1e-16)
    theirs = solve_gap(plain, thermal_gap, zero[1:], zero, 1e-16)
    assert ours.residual <= 1e-16
    np.testing.assert_allclose(ours.gap, theirs.gap, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(ours.traction.slip, theirs.traction.slip, rtol=1e-9, atol=1e-12)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(**problems, friction=st.sampled_from([0.0, 0.6, 2.0, 10.0]), floating=st.booleans())
@example(seed=600, count=3, size=1e-4, friction=0.0, floating=True)
def test_it_finds_an_equilibrium_of_the_plain_equations_however_hard_the_problem(
    seed, count, size, friction, floating
):
    problem, thermal_gap = random_problem(seed, count, 30.0 * size, friction, floating=floating)
    rng = np.random.default_rng(seed)
    slip, guess = rng.uniform(-1e-6, 1e-6, (2, count)), rng.uniform(-5e-6, 20e-6, (3, count))
    kept = guess.copy()
    solve = compiled(problem, surface_law(friction), count).solve
    found = solved(solve, problem, thermal_gap, slip, guess, floating)
    np.testing.assert_array_equal(guess, kept)
    residual = problem.residual(found.gap, problem.law(found.gap, slip), thermal_gap)
    assert np.abs(residual).max() <= 2.0 * TOLERANCE
    assert found.residual <= TOLERANCE


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.3])
def test_a_march_is_that_of_the_plain_method(friction):
    """To 1e-12 m in every step, heated and then cooled: the joint turns, slides and opens."""
    machine = assemble(
        two_bars(left=(2, 3, 1), right=(2, 2, 1)),
        law=surface_law(friction),
        convection={"bottom": 50.0},
        sources={"left_top": 400.0},
        fixed=["left_end", "right_end"],
        grid=(3, 2),
        step=2.0,
    ).machine
    contact = replace(machine.contact)
    vars(contact)["settle"] = partial(solve_gap, contact.gap_problem)
    plain = replace(machine, contact=contact)
    history = sampled_history(np.array([0.0, 16.0, 20.0, 80.0]), np.array([0.0, 2.0, -6.0, 3.0]))
    pair = (march(one, driven(machine, history), staggered) for one in (machine, plain))
    for ours, theirs in islice(zip(*pair, strict=False), 50):
        for name in ("gap", "slip"):
            np.testing.assert_allclose(
                getattr(ours.state, name), getattr(theirs.state, name), rtol=0.0, atol=1e-12
            )
        np.testing.assert_allclose(ours.displacement, theirs.displacement, rtol=0.0, atol=1e-12)


def test_a_body_that_hangs_loose_raises():
    springs, laws = np.full(3, 11e12), [(surface_law(0.6), 1)]
    problem = gap_problem(
        np.diag(1.0 / springs), np.ones(3), springs, stiffness_at_rest(laws), None
    )
    made = compile_gap(problem, laws)
    far = np.full((3, 1), 2.0**40)
    with pytest.raises(ConvergenceError, match="has come loose"):
        made.solve(np.zeros(3), far[1:], far)


def test_no_number_is_no_equilibrium():
    problem, thermal_gap = random_problem(7, 2, 1e-5, 0.6)
    zero = np.zeros((3, 2))
    with pytest.raises(ConvergenceError, match="gap equations"):
        compiled(problem, surface_law(0.6), 2).solve(
            np.full_like(thermal_gap, np.nan), zero[1:], zero
        )


def test_a_law_of_the_users_own_is_left_to_the_plain_method():
    @dataclass(frozen=True)
    class Softer(SurfaceNormalLaw):
        def pressure(self, opening):
            return super().pressure(0.5 * opening)

    problem, _ = random_problem(1, 2, 1e-6, 0.6)
    law = surface_law(0.6)
    own = replace(law, normal=Softer(**vars(law.normal)))
    assert compiled(problem, law, 2) is not None
    assert compile_gap(problem, [(law, 1), (own, 1)]) is None
