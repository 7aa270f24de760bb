"""Many machines in one block give what each of them gives alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.fchs.fleet import assemble_fleet, initial_states, step_fleet
from estimator.fchs.stream import initial_state, step
from thermojoint.artefacts.errors import InputError
from thermojoint.models.assembly import assemble

DT, COUNT = 2.0, 12


@pytest.fixture(scope="module")
def estimators(hand_made_model):
    """Three machines: two alike, one with another plate, so that their states differ in length."""
    thermal = replace(hand_made_model.linear.thermal, a=9.0, alpha=5e-4)
    other = replace(hand_made_model, linear=replace(hand_made_model.linear, thermal=thermal))
    first = assemble(hand_made_model, DT, 1800.0)
    return [first, assemble(other, DT, 600.0), first]


def samples(seed, missing=0.0):
    random = np.random.default_rng(seed)
    values = random.normal(0.0, 1.0, (COUNT, 3, 3)).cumsum(axis=0)
    values[random.random((COUNT, 3)) < missing] = np.nan
    return values


def alone(estimator, table, times):
    state, found = initial_state(estimator), []
    for time, row in zip(times, table, strict=True):
        if np.isnan(row).any():
            found.append(None)
            continue
        state, estimate = step(estimator, state, time, *map(float, row))
        found.append(estimate)
    return found


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3]))
@settings(max_examples=20, deadline=None)
def test_each_machine_of_a_fleet_is_estimated_as_if_alone(estimators, seed, missing):
    """Also with samples missing here and there."""
    table, times = samples(seed, missing), DT * np.arange(1, COUNT + 1)
    fleet = assemble_fleet(estimators)
    states, together = initial_states(fleet), []
    for time, rows in zip(times, table, strict=True):
        states, estimate = step_fleet(fleet, states, time, rows[:, 0], rows[:, 1:])
        together.append(estimate)
    for machine, estimator in enumerate(estimators):
        for one, all_ in zip(alone(estimator, table[:, machine], times), together, strict=True):
            if one is None:
                assert np.isnan(all_.total[machine]).all()
                continue
            assert all_.time[machine] == one.time
            for name in ("heat", "sources", "deviation", "linear", "nonlinear", "total"):
                np.testing.assert_allclose(
                    getattr(all_, name)[machine], getattr(one, name), rtol=1e-9, atol=1e-15
                )


def test_a_fleet_needs_machines_of_one_kind(estimators, hand_made_model):
    lame = replace(
        hand_made_model,
        sources=hand_made_model.sources[:1],
        distances=((0.1,),),
        linear=replace(hand_made_model.linear, direct={"T1": hand_made_model.linear.direct["T1"]}),
    )
    with pytest.raises(InputError, match="machine 1 has axes x, y and 1 sources"):
        assemble_fleet([estimators[0], assemble(lame, DT, 600.0)])
    with pytest.raises(InputError, match="no machines"):
        assemble_fleet([])


@pytest.mark.parametrize(
    ("time", "value", "shape", "message"),
    [
        (2.0, np.inf, 3, "machine 1 has an infinite value"),
        (2.0, 0.0, 2, "each of the 3 machines"),
        (0.0, 0.0, 3, "time does not increase"),
        (np.nan, 0.0, 3, "time does not increase"),
    ],
)
def test_a_bad_sample_of_a_fleet_is_refused(estimators, time, value, shape, message):
    fleet = assemble_fleet(estimators)
    states, _ = step_fleet(fleet, initial_states(fleet), 1.0, np.zeros(3), np.zeros((3, 2)))
    rows = np.zeros((shape, 2))
    rows[1, 0] = value
    with pytest.raises(InputError, match=message):
        step_fleet(fleet, states, time, np.zeros(shape), rows)


def test_shapes_that_do_not_agree_are_refused(estimators):
    fleet = assemble_fleet(estimators)
    good = initial_states(fleet), np.zeros(3), np.zeros((3, 2))
    step_fleet(fleet, good[0], 1.0, *good[1:])
    for at, other in (
        (0, initial_states(assemble_fleet(estimators[:2]))),
        (0, good[0][:, :-1]),
        (1, np.zeros(4)),
        (1, np.zeros((3, 1))),
        (2, np.zeros((3, 3))),
        (2, np.zeros(3)),
    ):
        states, delta_T, temperatures = (*good[:at], other, *good[at + 1 :])
        with pytest.raises(InputError, match="states, ΔT and T have shapes"):
            step_fleet(fleet, states, 1.0, delta_T, temperatures)
