"""The compiled march along axes takes the plain steps, and leaves to them what it cannot take."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from fesim.axes.axis import cold_drives
from fesim.axes.kernel import AxesMarch, axes_march
from fesim.axes.march import march_moving, march_staggered
from fesim.axes.setup import axis_inputs, set_up_axes
from fesim.case.history import History
from fesim.case.schema import case_from_data, read_case
from fesim.march.settling import initial_state
from fesim.march.stepping import plainly_staggered
from fesim.march.track import joined
from thermojoint.artefacts.errors import ConvergenceError

#: Steps; a body comes loose in the one after.
COUNT = 39
PATH = Path(str(files("thermojoint").joinpath("cases/three_axes.toml")))
#: Largest differences: what the plain march leaves open (8e-14 m) is 1e-6 of the preload.
ALLOWED = {
    "displacement": 1e-12,
    "gap": 1e-12,
    "slip": 1e-12,
    "change": 1e-12,
    "pressure": 2.0,
    "remainder": 2.0,
    "conductance": 0.01,
    "inputs": 1e-5,
    "heat_flow": 1e-5,
    "temperature": 1e-5,
    "drive": 1e-8,
    "turning": 1e-5,
    "heat_balance": 1e-10,
}


@pytest.fixture(scope="module")
def machine():
    """Screws that heat the machine, a scale that follows it, between stations and turning there."""
    case = read_case(PATH)
    return turning(case, 35.0, 1.0, hot(case, COUNT, 10.0))


def turning(case, time, reach, inputs):
    """The machine with axes that turn after a time (s) anywhere within a part of their strokes."""
    ready = set_up_axes(case)
    rng = np.random.default_rng(8)
    times = time * np.arange(26.0)
    axes = [
        replace(axis, course=History(times, reach * rng.uniform(at[0], at[-1], times.size)))
        for axis, at in zip(ready.axes, ready.moving.guideway.stations.positions, strict=True)
    ]
    start = replace(initial_state(ready.moving.machine), drive=cold_drives(axes))
    return ready.moving, axes, inputs, start


def hot(case, count, level):
    inputs = axis_inputs(case).at(case.march.step_s * np.arange(1.0, count + 1.0))
    inputs[:, 0] *= level
    return inputs


@pytest.fixture(scope="module")
def tracks(machine):
    return list(march_staggered(*machine))


def plainly(moving, axes, inputs, start):
    return joined(list(march_moving(moving, axes, inputs, plainly_staggered, start)))


def assert_alike(track, other):
    off = {
        name: float(np.abs(getattr(track, name) - getattr(other, name)).max()) / allowed
        for name, allowed in ALLOWED.items()
    }
    assert {name: by for name, by in off.items() if not by <= 1.0} == {}


def test_the_compiled_march_takes_the_plain_steps(machine, tracks):
    track, plain = joined(tracks), plainly(*machine)
    assert_alike(track, plain)
    assert np.abs(plain.displacement).max() > 1e-5
    # Some slide, some turn in every other step, and pressures differ.
    assert plain.slip.any()
    assert (plain.turning[:, 1] >= 2.0).any()
    assert np.ptp(plain.pressure) > 1e5
    assert np.array_equal(track.parts, plain.parts)
    assert np.abs(track.heat_balance).max() < 1e-8
    assert track.residual.max() <= machine[0].machine.contact.tolerance
    # Most steps are those of the kernel.
    assert len(tracks) < COUNT / 2


def test_a_march_continues_bit_by_bit(machine, tracks):
    moving, axes, inputs, _ = machine
    track = joined(tracks)
    for done in (1, 17):
        rest = joined(
            list(march_staggered(moving, axes, inputs[done:], track.step(done - 1).state))
        )
        for name in (*ALLOWED, "residual", "iterations"):
            assert np.array_equal(getattr(rest, name), getattr(track, name)[done:])


def test_steps_before_one_that_raises_are_kept(machine, tracks):
    moving, axes, inputs, start = machine
    broken = inputs.copy()
    broken[5] = np.nan
    track, whole = axes_march(moving, axes).take(start, broken), joined(tracks)
    assert track is not None
    assert len(track) == 5
    for name in (*ALLOWED, "residual", "iterations"):
        assert np.array_equal(getattr(track, name), getattr(whole, name)[:5])
    assert axes_march(moving, axes).take(start, broken[5:]) is None


def test_what_the_kernel_cannot_take_is_taken_plainly(machine, monkeypatch):
    moving, axes, inputs, start = machine
    take, refused = AxesMarch.take, []

    def refuse(march, state, rows):
        if state.index == 3:
            refused.append(state)
            return None
        return take(march, state, rows)

    monkeypatch.setattr(AxesMarch, "take", refuse)
    track = joined(list(march_staggered(moving, axes, inputs[:8], start)))
    monkeypatch.undo()
    assert_alike(track, plainly(moving, axes, inputs[:8], start))
    # Iterated steps go on to be iterated.
    iterated = replace(start, parts=2)
    monkeypatch.setattr(AxesMarch, "take", lambda *_: pytest.fail("compiled"))
    track = joined(list(march_staggered(moving, axes, inputs[:2], iterated)))
    assert (track.parts == 2).all()


def test_a_body_that_comes_loose_is_an_error(machine, tracks):
    moving, axes, _, _ = machine
    state, inputs = tracks[-1].step(-1).state, hot(read_case(PATH), COUNT + 1, 10.0)
    with pytest.raises(ConvergenceError, match="step to t = 800 s: a body has come loose"):
        list(march_staggered(moving, axes, inputs[COUNT:], state))


def test_steps_that_alternate_are_taken_over_at_once():
    data = read_case(PATH).model_dump(mode="json", exclude_unset=True)
    for joint in data["joints"].values():
        joint |= {"preload_MPa": 0.5, "friction_coefficient": 30.0}
    data["march"] |= {"step_s": 600.0, "duration_min": 100.0}
    case = case_from_data(data, "long steps", PATH.parent)
    machine = turning(case, 1020.0, 0.5, hot(case, 10, 4.0))
    track, plain = joined(list(march_staggered(*machine))), plainly(*machine)
    assert plain.parts.tolist() == [*(8 * [0]), 1, 1]
    assert np.array_equal(track.parts, plain.parts)
    np.testing.assert_allclose(track.displacement, plain.displacement, rtol=0.0, atol=1e-12)


def test_a_law_of_the_user_is_marched_plainly(machine, monkeypatch):
    moving, axes, inputs, start = machine
    law, count = moving.machine.contact.laws[0]
    own = type("Own", (type(law.normal),), {})(**vars(law.normal))
    laws = [(replace(law, normal=own), count), *moving.machine.contact.laws[1:]]
    others = replace(moving, machine=moving.machine.with_laws(laws))
    assert axes_march(others, axes) is None
    track = joined(list(march_staggered(others, axes, inputs[:3], start)))
    assert_alike(track, plainly(moving, axes, inputs[:3], start))


def test_steps_taken_at_once_do_not_change_them(machine, tracks, monkeypatch):
    monkeypatch.setattr("fesim.axes.march.BLOCK", 3)
    track = joined(list(march_staggered(*machine)))
    for name in ALLOWED:
        assert np.array_equal(getattr(track, name), getattr(joined(tracks), name))
