"""What counts as an oscillation of steps, and as its gain."""

import numpy as np
import pytest

from fesim.march.alternation import alternating, gain_of, oscillating, unresolved

STEPS = np.arange(30.0)[:, None]


@pytest.mark.parametrize("period", [2, 3, 4])
def test_values_that_come_back_after_a_few_steps_oscillate(period):
    cycle = 0.1 * np.cos(2.0 * np.pi * STEPS / period)
    assert alternating(1.0 + cycle)
    assert not alternating(1.0 + 0.8**STEPS * cycle)


@pytest.mark.parametrize(
    "values",
    [STEPS, STEPS * (29.0 - STEPS), np.sin(2.0 * np.pi * STEPS / 15.0), 1.0 + 1e-6 * (STEPS % 3)],
    ids=["ramp", "peak", "slow wave", "rounding"],
)
def test_what_is_resolved_by_the_steps_does_not_oscillate(values):
    assert not alternating(values)


def test_the_gain_is_that_of_the_element_that_alternates_most():
    once, twice = np.array([1.0, 0.5, 1e-3]), np.array([-0.2, -0.55, -5e-3])
    assert gain_of(once, twice) == pytest.approx(1.1)
    assert gain_of(once, -twice) == 0.0
    assert gain_of(np.zeros(2), np.zeros(2)) == 0.0


def test_only_the_steps_that_oscillate_are_named_and_none_that_an_input_drives():
    values = np.where(STEPS < 10.0, 0.0, 0.1 * (-1.0) ** STEPS)
    assert np.flatnonzero(oscillating(values)).tolist() == list(range(9, 30))
    still, driven = np.ones((30, 2)), np.hstack([np.ones((30, 1)), 5.0 * (STEPS % 2)])
    snaps = STEPS[:, 0] == 20.0
    assert unresolved(values, still, snaps).tolist() == list(range(9, 30))
    assert not unresolved(values, driven, snaps).size
