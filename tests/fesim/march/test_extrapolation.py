"""The first guess of a step, by backward differences of the steps before."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from reduced_bars import bars_of, modes_of, on_modes

from fesim.march.extrapolation import differ, extrapolate
from fesim.march.machine import FURTHER
from fesim.march.settling import initial_state
from fesim.march.stepping import march_along, staggered
from fesim.march.track import joined


def predicted(values):
    """Expected change after the last row of values (steps, n), each recorded as a step."""
    change, further = np.zeros(values.shape[1]), np.zeros((FURTHER, values.shape[1]))
    for before, after in pairwise(values):
        last, change = change, after - before
        differ(last, change, further)
    ahead = np.empty_like(change)
    extrapolate(change, further, ahead)
    return ahead


@settings(max_examples=60, derandomize=True)
@given(degree=st.integers(0, FURTHER), seed=st.integers(0, 2**32 - 1))
def test_polynomials_up_to_the_highest_order_are_continued_exactly(degree, seed):
    powers = np.random.default_rng(seed).uniform(-1.0, 1.0, (degree + 1, 5))
    times = np.arange(12.0)
    values = sum(power * (times[:, None] / 10.0) ** k for k, power in enumerate(powers))
    ahead = predicted(values[:-1])
    np.testing.assert_allclose(ahead, values[-1] - values[-2], rtol=0.0, atol=1e-12)


@settings(max_examples=60, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_each_value_is_predicted_by_the_order_that_was_best_in_the_last_step(seed):
    values = np.random.default_rng(seed).normal(size=(9, 4))
    differences = [np.diff(values, k, axis=0)[-1] for k in range(1, FURTHER + 2)]
    sums = np.vstack([np.zeros(4), np.cumsum(differences[:-1], axis=0)])
    best = np.abs(differences).argmin(axis=0)
    np.testing.assert_allclose(predicted(values), sums[best, np.arange(4)], rtol=0.0, atol=1e-12)


def test_a_value_that_rests_is_expected_to_rest_and_one_that_has_jumped_not_to_jump_again():
    steps = np.array([[0.0, 0.0]] * 6 + [[0.0, 1.0]])
    np.testing.assert_array_equal(predicted(steps[:-1]), 0.0)
    assert abs(predicted(steps)[1]) <= 1.0


def test_a_smooth_march_takes_fewer_iterations_than_from_the_last_change_alone():
    """To the same gaps, within what the tolerance of each step allows."""
    bars = bars_of()
    machine = on_modes(bars, modes_of(bars))
    inputs = np.tile([600.0, 0.0], (60, 1))
    start = initial_state(machine)
    one_more = replace(start, differences=start.differences[:1])
    track, linear = (
        joined(list(march_along(machine, inputs, staggered, state))) for state in (start, one_more)
    )
    np.testing.assert_allclose(track.gap, linear.gap, rtol=0.0, atol=1e-12)
    assert track.iterations.mean() <= 0.75 * linear.iterations.mean()
