"""What counts as an oscillation of steps, and as its gain."""

import numpy as np
import pytest

from fesim.march.alternation import (
    SUSPECTED,
    alternating,
    gain_of,
    oscillating,
    suspected,
    turnings,
    unresolved,
)

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


def test_increments_that_change_their_sign_twice_in_a_row_are_suspected():
    moved = np.array(
        [
            [1.0, 1.0, 1.0, 1.0, 1.0],
            [-1.0, -1.0, 0.0, 1e-6, -1.0],
            [1.0, 0.0, -1.0, 0.0, -1.0],
            [-1.0, 1.0, 0.0, -1.0, 1.0],
            [1.0, -1.0, 1.0, 1.0, -1.0],
        ]
    )
    found = suspected(turnings(np.zeros((3, 5)), moved))
    at = {element: np.flatnonzero(found[:, element]).tolist() for element in range(5)}
    assert at == {0: [2, 3, 4], 1: [3, 4], 2: [4], 3: [], 4: [4]}


def test_a_record_goes_on_from_any_step():
    moved = np.random.default_rng(2).choice([-1.0, 0.0, 1.0], (40, 30))
    whole = turnings(np.zeros((3, 30)), moved)
    for first in range(1, 40):
        rest = turnings(whole[first - 1], moved[first:])
        np.testing.assert_array_equal(rest[:, ::2], whole[first:, ::2])
        # A count that has been reached starts again.
        beyond = whole[first - 1, 1] < SUSPECTED
        np.testing.assert_array_equal(rest[:, 1, beyond], whole[first:, 1, beyond])


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
