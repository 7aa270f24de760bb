"""The compiled march along an axis takes the plain steps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_knee import moving

from calibrate.joint_aware.calibration import machine_of
from calibrate.joint_aware.misfit import physics_with
from fesim.axes.occupation import even
from thermojoint.reduced.axis_way import way_between
from thermojoint.reduced.guided_march import occupy
from thermojoint.reduced.machine import along
from thermojoint.reduced.physics import (
    conduct,
    guided_steps,
    settle_joint,
    settle_plainly,
    simulate_known,
)

STEP = 30.0
FACTORS = {"film": 1.4, "preload": 0.8, "expansion": 1.1, "modulus": 0.9, "lag bearing, s": 20.0}
#: Stands where it is aligned and elsewhere, passes one place and several, turns, goes to both ends.
PLACES = (0.0, 0.0, 0.2, 0.2, 0.13, 0.13, 0.13, 0.12, -0.1, 0.2, -0.05, -0.05)


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    case = moving(tmp_path_factory.mktemp("course"), [(0, 0), (600, 0)])
    return along(machine_of(case, ("bearing", "guide")), ["x", "y"])


def plainly(physics, inputs, length, gone=None):
    """The march step by step, which the compiled one stands for."""
    known, place = inputs.shape[1] - 1, float(physics.modes.factors[-1])
    amplitudes, joint = physics.modes.start, physics.at_rest()
    sensed, moved = [], []
    for k, row in enumerate(inputs):
        way = way_between([place], row[-1:].tolist(), () if gone is None else gone[k])
        amplitudes = conduct(physics, amplitudes, row[:known], joint, length, way)
        joint, displacement = settle_plainly(physics, joint, amplitudes, row[-1:])
        sensed.append(physics.modes.sensors @ amplitudes)
        moved.append(displacement)
        place = row[-1]
    return np.array(sensed), np.array(moved)


@pytest.mark.parametrize("factors", [{}, FACTORS], ids=["as in the case", "other parameters"])
def test_the_compiled_march_takes_the_plain_steps(machine, factors):
    places = np.tile(PLACES, 8)
    inputs = machine.inputs(np.tile(machine.power, (places.size, 1)), places[:, None])
    physics = physics_with(machine, factors)
    sensed, moved = simulate_known(physics, inputs, STEP)
    plain_sensed, plain_moved = plainly(physics, inputs, STEP)
    np.testing.assert_allclose(sensed, plain_sensed, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(moved, plain_moved, rtol=0.0, atol=1e-12)
    assert np.abs(moved).max() > 2e-5
    # It goes there and back between samples, in some steps less far than the positions tell.
    gone = np.linspace(0.0, 0.6, places.size)[:, None]
    further = simulate_known(physics, inputs, STEP, gone)
    for one, other in zip(further, plainly(physics, inputs, STEP, gone.tolist()), strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-6)
    assert np.abs(further[1] - moved).max() > 1e-7


def test_without_a_position_the_axis_stands_where_it_is(machine):
    heat = np.tile(machine.power, (5, 1))
    standing = np.full((5, 1), machine.guide.first[0])
    physics = physics_with(machine, {})
    one = simulate_known(physics, machine.inputs(heat), STEP)
    other = simulate_known(physics, machine.inputs(heat, standing), STEP)
    assert all(map(np.array_equal, one, other))


@pytest.fixture(scope="module")
def steps(machine):
    return guided_steps(physics_with(machine, {}), STEP)


@given(st.floats(-0.11, 0.21), st.floats(-0.11, 0.21))
def test_the_compiled_shares_are_those_of_an_even_way(steps, start, end):
    guide, storage = steps
    positions = guide.aligned.positions
    occupy(positions, start, end, storage.passed)
    shares = even(positions, start, end)
    for name in ("mean", "square", "product"):
        found = getattr(storage.passed, name)
        np.testing.assert_allclose(found, getattr(shares, name), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("place", [-0.1, 0.02, 0.1, 0.2])
def test_a_joint_settles_at_any_position_as_plainly(machine, place):
    physics = physics_with(machine, FACTORS)
    heat = machine.inputs(np.tile(machine.power, (1, 1)))[0]
    joint, at = physics.at_rest(), np.array([place])
    warm = conduct(physics, physics.modes.start, heat, joint, 600.0, way_between([0.0], [0.0]))
    one, other = (settle(physics, joint, warm, at) for settle in (settle_joint, settle_plainly))
    np.testing.assert_allclose(one[1], other[1], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(one[0].pressure, other[0].pressure, rtol=1e-6, atol=1.0)
