"""The closed loop: its controller, its transfer functions and margins, its tuning, its runs."""

import copy
import json
import math
import re
import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path

import browser
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nested_toml import as_toml
from observed import observed_data, observer, run
from repository import ROOT
from short_runs import QUICK
from typer.testing import CliRunner

from calibrate.joint_aware import calibration
from calibrate.joint_aware.readings import run_in
from estimator.joint_aware.filter_design import correct
from estimator.joint_aware.model_file import write_observer
from estimator.joint_aware.observer import Observer
from fesim.case.schema import case_from_data, read_case
from fesim.setup.machine import set_up
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.settings.read import settings_from
from thermojoint.cli.app import app
from thermojoint.compensation.loop import run as loop_run
from thermojoint.compensation.loop.controller import AT_REST, Controller, control
from thermojoint.compensation.loop.figure import runs_figure
from thermojoint.compensation.loop.judging import as_content
from thermojoint.compensation.loop.linear import (
    Channels,
    frequencies_of,
    loop_channels,
    margins_of,
    open_loop,
    responses_of,
    state_space,
)
from thermojoint.compensation.loop.march import Acting, Course, Plant, added_by, run_loop
from thermojoint.compensation.loop.run import Closed
from thermojoint.compensation.loop.schema import Loop, read_loop
from thermojoint.compensation.loop.tuning import Requirements, feed_forward_gain, tune
from thermojoint.compensation.offsets.output import followed
from thermojoint.compensation.offsets.settings import read_settings, settings_from_data
from thermojoint.reduced.machine import reduce_machine

pytest.importorskip("control", reason="needs python-control")

EXAMPLE = ROOT / "examples" / "closed_loop"
MICRO = 1e-6
SENSORS = ("s", "b", "T1", "T2", "r")
OFFSETS = {"rate_um_s": 5.0, "unusable": [], "axes": {"X": {"follows": "x"}, "V": {"follows": "y"}}}


@pytest.fixture(scope="module")
def data(coarse_data):
    """The coarse machine with a heater on the rear wall."""
    found = observed_data(coarse_data)
    found["probes"]["r"] = {"position_mm": [0.0, 600.0, 100.0], "body": "column"}
    found["sources"]["heater"] = {
        "surface": "rear",
        "reference_power_W": 1500.0,
        "reading": "total",
        "heat_input": {"kind": "step", "level": 0.0},
    }
    return found


@pytest.fixture(scope="module")
def setup(data):
    return set_up(case_from_data(data, "case", Path()))


@pytest.fixture(scope="module")
def estimator(data, setup):
    machine = reduce_machine(case_from_data(data, "case", Path()), setup, SENSORS)
    heated = copy.deepcopy(data)
    heated["sources"]["heater"]["heat_input"] = {"kind": "triangle", "peak": 2.0, "duration_min": 8}
    response = run(heated, setup, {"kind": "step", "level": 2.0})
    return observer(machine, {"both": response})


@pytest.fixture(scope="module")
def channels(estimator):
    return loop_channels(estimator.model, "heater", "bearings", "x")


@pytest.fixture(scope="module")
def responses(estimator, channels):
    return responses_of(estimator.model, channels, frequencies_of(estimator.model))


def start(estimator, channels, **changes):
    plain = Controller(
        gain=1.0,
        integral_time=1.0,
        derivative_time=0.0,
        derivative_filter=2.0,
        sign=1.0,
        feed_forward=feed_forward_gain(estimator.model, channels, 600.0),
        feed_forward_filter=0.0,
        largest=5000.0,
        resolution=10.0,
        interval=estimator.model.step,
    )
    return replace(plain, **changes)


def required(estimator, **changes):
    noise = np.append(np.full(len(estimator.model.sensors), 0.02), 0.0)
    plain = Requirements(2.0, math.radians(45.0), 0.3, 0.0, 2.0, noise, 100.0)
    return replace(plain, **changes)


@pytest.fixture(scope="module")
def tuned(estimator, channels, responses):
    return tune(responses, start(estimator, channels), required(estimator))


def linear_run(model, channels, controller, late, count=1500):
    """Size of the displacement after a kick, in the first and in the last tenth of a linear run."""
    system = Observer(model).system
    dynamic = system.decay.size
    rows = np.arange(len(system.rows))
    gain, _ = correct(model.filter, system.rows, rows, np.zeros((system.size, 1)), 1.0)
    tangent, source = model.band.tangent[channels.axis], dynamic + channels.disturbance
    plant, known = np.zeros(dynamic), np.zeros(system.size)
    state, heat, sent, moved = AT_REST, 0.0, [], []
    for index in range(count):
        given = heat + (100.0 if index < 3 else 0.0)
        plant = system.decay * plant + system.drive[:, channels.heater] * given
        read = system.rows[:, :dynamic] @ plant
        expected = system.advance(known[:, None])[:, 0]
        known = expected + gain @ (read - system.rows @ expected)
        sent.append((float(tangent @ known), float(known[source])))
        if index >= late:
            state, heat = unlimited(controller, state, *sent[index - late])
        moved.append(float(tangent[:dynamic] @ plant))
        if abs(moved[-1]) > 1.0:
            return 1.0, math.inf
    tenth = count // 10
    return np.abs(moved[:tenth]).max(), np.abs(moved[-tenth:]).max()


def unlimited(controller, state, displacement, disturbing):
    """The controller without limits, integral and feed-forward written once more."""
    error = -controller.sign * displacement
    step = controller.interval
    integral = state.integral + controller.gain * step / controller.integral_time * error
    fed = state.fed + step / (step + controller.feed_forward_filter) * (disturbing - state.fed)
    heat = controller.gain * error + integral + controller.feed_forward * fed
    return AT_REST._replace(integral=integral, fed=fed), heat


def test_the_machine_answers_as_its_state_space(estimator, channels, responses):
    found = state_space(estimator.model, channels.heater, channels.axis)
    points = np.exp(1j * responses.frequencies[::30] * estimator.model.step)
    assert responses.heater.displacement[::30] == pytest.approx(
        np.array([complex(np.squeeze(found(point))) for point in points]), rel=1e-9, abs=0
    )


def test_slow_heat_is_estimated_as_it_is(responses):
    """At low frequency the estimate is the displacement, and the heater is no disturbance."""
    assert responses.heater.estimate[0] == pytest.approx(responses.heater.displacement[0], rel=1e-3)
    assert abs(responses.heater.heat[0]) < 1e-3
    assert abs(responses.disturbance.heat[0] - 1.0) < 1e-3


def test_the_gain_margin_is_where_the_linear_loop_becomes_unstable(
    estimator, channels, responses, tuned
):
    factor = tuned.nominal.gain
    assert 2.0 <= factor < 100.0
    for share, stable in ((0.9, True), (1.1, False)):
        # Feed-forward and feedback are the loop's gain together.
        more = replace(
            tuned.controller,
            gain=share * factor * tuned.controller.gain,
            feed_forward=share * factor * tuned.controller.feed_forward,
        )
        first, last = linear_run(estimator.model, channels, more, 0)
        assert (last < 0.1 * first) == stable


def test_the_delay_margin_is_where_the_linear_loop_becomes_unstable(estimator, channels, tuned):
    most = tuned.nominal.delay / estimator.model.step
    for late, stable in ((math.floor(most - 0.3), True), (math.ceil(most + 0.7), False)):
        first, last = linear_run(estimator.model, channels, tuned.controller, late)
        assert (last < 0.1 * first) == stable


def test_margins_of_an_integrator_with_a_delay_are_its_closed_form():
    frequencies = np.geomspace(1e-3, np.pi, 400)
    loop = 0.1 / (1j * frequencies) * np.exp(-2j * frequencies)
    found = margins_of(frequencies, loop)
    assert found.crossover == pytest.approx(0.1, rel=1e-3)
    assert found.phase == pytest.approx(np.pi / 2 - 0.2, rel=1e-3)
    assert found.gain == pytest.approx(np.pi / 4 / 0.1, rel=1e-2)
    late = margins_of(frequencies, loop * np.exp(-60j * frequencies))
    assert late.phase == pytest.approx(np.pi / 2 - 6.2, rel=1e-3)


def test_the_tuned_loop_keeps_what_is_required_whatever_the_model_is_wrong_by(
    estimator, responses, tuned
):
    for error in (-0.3, 0.0, 0.3):
        found = margins_of(
            responses.frequencies, (1.0 + error) * open_loop(responses, tuned.controller, 2.0)
        )
        assert found.gain >= 2.0
        assert found.phase >= math.radians(45.0)
    assert tuned.heat_noise <= 100.0


def test_more_delay_or_less_noise_allowed_makes_a_slower_loop(
    estimator, channels, responses, tuned
):
    begun = start(estimator, channels)
    late = tune(responses, begun, required(estimator, delay=20.0))
    quiet = tune(responses, begun, required(estimator, most_noise=0.3 * tuned.heat_noise))
    assert late.nominal.crossover < 0.7 * tuned.nominal.crossover
    assert quiet.nominal.crossover < tuned.nominal.crossover
    with pytest.raises(InputError, match="no crossover"):
        tune(responses, begun, required(estimator, most_noise=1e-9))


def test_a_heater_that_pushes_the_wrong_way_is_refused(estimator):
    same = Channels(heater=0, disturbance=0, axis=0)
    with pytest.raises(InputError, match="cannot cool"):
        feed_forward_gain(estimator.model, same, 600.0)


@given(
    st.lists(st.tuples(st.floats(-1e-3, 1e-3), st.floats(-1e3, 1e4)), min_size=1, max_size=30),
    st.just(0.0) | st.floats(0.01, 500.0),
)
def test_a_heater_gives_whole_steps_between_nothing_and_its_most(course, resolution):
    controller = Controller(1e9, 40.0, 5.0, 2.0, 1.0, 1.5, 10.0, 5000.0, resolution, 2.0)
    state = AT_REST
    for displacement, disturbing in course:
        state, heat = control(controller, state, displacement, disturbing)
        assert 0.0 <= heat <= 5000.0 * (1.0 + 1e-9)
        if resolution > 0.0:
            assert heat / resolution == pytest.approx(round(heat / resolution), abs=1e-6)


def test_the_integral_does_not_wind_up():
    controller = Controller(1e8, 40.0, 0.0, 2.0, 1.0, 0.0, 0.0, 1000.0, 0.0, 2.0)
    state = AT_REST
    for _ in range(1000):
        state, heat = control(controller, state, -100.0 * MICRO, 0.0)
    assert heat == pytest.approx(1000.0)
    # The heater leaves its limit as soon as the error has changed its sign.
    _, heat = control(controller, state, 5.0 * MICRO, 0.0)
    assert heat < 600.0


@given(st.sampled_from((-1, 1)), st.sampled_from((-1, 1)), st.floats(-1.0, 1.0))
def test_offsets_cancel_what_was_estimated_whatever_their_signs(one, other, displacement):
    settings = settings_from_data(
        {"axes": {"U": {"follows": "y", "sign": one}, "V": {"follows": "x", "sign": other}}}, "s"
    )
    estimated = np.array([displacement, 2.0 * displacement])
    wanted = followed(settings.output, ("x", "y"), estimated)
    assert added_by(settings, ("x", "y"), wanted) == pytest.approx(-estimated)


@pytest.fixture(scope="module")
def plant(data, setup):
    driven = copy.deepcopy(data)
    driven["heat_input"] = {"kind": "step", "level": 2.0}
    return Plant(case_from_data(driven, "case", Path()), setup)


def course(plant, estimator, tuned, offsets=None, delay=0):
    acting = Acting(
        controller=None if tuned is None else tuned.controller,
        heater=1,
        disturbance=0,
        axis=0,
        offsets=offsets,
        delay=delay,
    )
    return run_loop(plant, estimator, acting, np.zeros((300, len(SENSORS))))


def test_the_heater_holds_its_axis_and_offsets_do_the_rest(plant, estimator, tuned):
    settings = settings_from_data(OFFSETS | {"cycle_s": 2.0}, "offsets")
    free = course(plant, estimator, None, settings)
    moves = np.abs(free.displacement).max(axis=0)
    assert (moves > 30.0 * MICRO).all()
    assert (np.abs(free.residual) < 0.03 * moves).all()
    held = course(plant, estimator, tuned, settings)
    assert np.abs(held.displacement[:, 0]).max() < 0.03 * moves[0]
    assert np.abs(held.displacement[:, 1]).max() > 0.5 * moves[1]
    assert np.abs(held.residual[:, 1]).max() < 0.03 * moves[1]
    assert held.heater.min() >= 0.0
    # What acts moves the machine only from the step after its sample on.
    assert held.heater[0] == pytest.approx(0.0)


@pytest.mark.long
def test_a_setpoint_is_reached_and_kept(plant, estimator, tuned):
    controller = replace(tuned.controller, setpoint=15.0 * MICRO)
    off = course(plant, estimator, replace(tuned, controller=controller))
    assert off.displacement[-50:, 0] == pytest.approx(15.0 * MICRO, abs=0.5 * MICRO)
    assert off.heater.mean() > course(plant, estimator, tuned).heater.mean()


@pytest.mark.parametrize(("follows", "left"), [("y", 1.0), ("x", 20.0)])
def test_an_axis_that_the_heater_holds_at_its_setpoint_has_nothing_left(folder, follows, left):
    """Unless they follow the axis: then they compensate what the heater makes of it, too."""
    (folder / "offsets.toml").write_text(f'[axes.A]\nfollows = "{follows}"\n', "utf-8")
    path = folder / "loop.toml"
    text = path.read_text("utf-8").replace('axis = "x"', 'axis = "x"\nsetpoint_um = 20.0')
    path.write_text(text, "utf-8")
    moved = MICRO * np.array([[20.0, 3.0], [19.0, 4.0]])
    still, times = np.zeros((2, 2)), np.array([2.0, 4.0])
    run = Course(times, moved, moved, still, np.ones(2))
    followed = read_settings(folder / "offsets.toml").output.estimated
    closed = Closed(read_loop(path), ("x", "y"), None, run, run, {}, followed)
    axes = as_content(closed)["runs"][1]["axes"]
    assert axes["x"]["displacement"]["largest_um"] == pytest.approx(1.0)
    assert axes["x"]["with_offsets"]["largest_um"] == pytest.approx(left)
    assert axes["y"]["with_offsets"]["largest_um"] == pytest.approx(4.0)


def test_every_tried_delay_is_drawn(folder):
    still = np.zeros((2, 2))
    run = Course(np.array([2.0, 4.0]), still, still, still, np.ones(2))
    late = {10.0 * k: run for k in range(1, 9)}
    closed = Closed(read_loop(folder / "loop.toml"), ("x", "y"), None, run, run, late)
    for panel, runs in zip(runs_figure(closed).axes, (10, 10, 10, 10, 9), strict=True):
        assert len(panel.lines) == runs


@pytest.mark.long
def test_a_delay_beyond_its_margin_makes_the_heater_swing(plant, estimator, tuned):
    most = math.ceil(2.5 * tuned.nominal.delay / estimator.model.step)
    good, bad = course(plant, estimator, tuned), course(plant, estimator, tuned, delay=most)
    swing = [np.abs(np.diff(one.heater[150:])).sum() for one in (good, bad)]
    assert swing[1] > 3.0 * swing[0]
    later = [np.abs(one.displacement[150:, 0]).max() for one in (good, bad)]
    assert later[1] > 3.0 * later[0]


@pytest.fixture
def folder(tmp_path, data, estimator):
    """A loop in files."""
    write_observer(estimator.model, tmp_path / "estimator.h5")
    (tmp_path / "machine.toml").write_text(as_toml(data), "utf-8")
    (tmp_path / "offsets.toml").write_text(
        'cycle_s = 2.0\n[axes.X]\nfollows = "x"\n[axes.Y]\nfollows = "y"\n', "utf-8"
    )
    text = (EXAMPLE / "step.toml").read_text("utf-8")
    text = text.replace("duration_min = 35.0", "duration_min = 2.0")
    text = re.sub(r"tried_delays_s = .*", "tried_delays_s = [30.0]", text)
    (tmp_path / "loop.toml").write_text(text, "utf-8")
    return tmp_path


def test_the_command_writes_margins_residuals_and_a_page(folder):
    outputs = folder / "loop.html", folder / "loop.json"
    command = ["control", str(folder / "loop.toml"), "--out", str(outputs[0])]
    done = CliRunner().invoke(app, [*command, "--json", str(outputs[1])])
    assert done.exit_code == 0, done.output
    content = json.loads(outputs[1].read_text("utf-8"))
    assert [one["run"] for one in content["runs"]] == ["free", "heater", "delay 30 s"]
    assert content["design"]["worst_phase_margin_deg"] >= 45.0
    assert content["design"]["worst_gain_margin_dB"] >= 6.0
    assert content["design"]["late"]["30"]["phase_margin_deg"] < 0.0
    free, heated, _ = (one["axes"]["x"] for one in content["runs"])
    assert heated["displacement"]["largest_um"] < 0.5 * free["displacement"]["largest_um"]
    page = outputs[0].read_text("utf-8")
    assert page.count("data:image/svg+xml") == 3
    assert "free machine moves" in page
    if browser.CHROMIUM:
        browser.assert_readable_at_400_px(page)
    # Its own outputs may be replaced, another file not.
    outputs[0].write_text("my page", "utf-8")
    done = CliRunner().invoke(app, command)
    assert isinstance(done.exception, InputError)


def test_a_heater_that_is_too_weak_is_said_to_be(folder):
    path = folder / "loop.toml"
    text = path.read_text("utf-8").replace("largest_W = 5000.0", "largest_W = 500.0")
    path.write_text(re.sub(r"tried_delays_s = .*", "", text), "utf-8")
    done = CliRunner().invoke(app, ["control", str(path)])
    assert done.exit_code == 0, done.output
    assert "gives no more than 500 W" in " ".join(done.output.split())


def refused(path):
    """What the command said of a mistake, in one line."""
    done = CliRunner().invoke(app, ["control", str(path)])
    assert isinstance(done.exception, InputError)
    assert "\n" not in str(done.exception)
    return str(done.exception)


def test_sources_that_are_driven_apart_calibrate_by_the_power_of_each(data, setup):
    driven = copy.deepcopy(data)
    driven["sources"]["heater"]["heat_input"] = {"kind": "step", "level": 2.0}
    response = run(driven, setup, {"kind": "step", "level": 0.5}, 1.0)
    machine = reduce_machine(case_from_data(data, "case", Path()), setup, SENSORS)
    inputs = run_in(response, machine, "run").inputs
    assert inputs[:, :2] == pytest.approx(np.tile([0.5 * machine.power[0], 3000.0], (30, 1)))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('axis = "x"', 'axis = "z"', "no axis named 'z'"),
        ('source = "heater"', 'source = "heaters"', "did you mean 'heater'"),
        ('against = "bearings"', 'against = "spindle"', "no source named 'spindle'"),
        ("largest_W", "largest_kW", "did you mean 'largest_W'"),
        ("resolution_W = 10.0", "resolution_W = 1e-9", "heater: resolution_W"),
        ("delay_s = 0.0", "delay_s = 3.0", "not a multiple"),
        ("delay_s = 0.0", "delay_s = -1.0", "estimator.delay_s"),
        ("seed = 0", "seed = -1", "estimator.seed"),
        ("gain_margin_dB = 6.0", "gain_margin_dB = 60.0", "no crossover"),
        ("gain_margin_dB = 6.0", "gain_margin_dB = 1e9", "tuning.gain_margin_dB"),
        ("phase_margin_deg = 45.0", "phase_margin_deg = 450.0", "tuning.phase_margin_deg"),
        ("delay_error_s = 2.0", "delay_error_s = 1e308", "tuning.delay_error_s"),
        ("[30.0]", "[30.0, 1e18]", "delay of 1e+18 s: plant: duration_min 2 ends before"),
    ],
)
def test_a_mistake_in_a_loop_is_one_line(folder, old, new, told):
    path = folder / "loop.toml"
    path.write_text(path.read_text("utf-8").replace(old, new, 1), "utf-8")
    assert told in refused(path)


@pytest.mark.parametrize(
    ("file", "old", "new", "told"),
    [
        ("loop.toml", "[30.0]", "[3.0]", "not a multiple"),
        ("loop.toml", "duration_min = 2.0", "duration_min = 1e308", "more than 10000000 steps"),
        ("machine.toml", '"step_s" = 2.0', '"step_s" = 3.0', "does not divide"),
        ("machine.toml", '"T2" = {', '"T3" = {', "the estimator reads"),
        ("estimator.h5", "", "", "bearings_power; a loop has temperatures only"),
    ],
)
def test_what_does_not_fit_is_refused_before_the_plant_is_set_up(
    folder, estimator, monkeypatch, file, old, new, told
):
    monkeypatch.setattr(loop_run, "set_up", lambda _: pytest.fail("set up"))
    if old:
        text = (folder / file).read_text("utf-8")
        assert old in text
        (folder / file).write_text(text.replace(old, new), "utf-8")
    else:
        write_observer(replace(estimator.model, power_shares={"bearings": 0.3}), folder / file)
    assert told in refused(folder / "loop.toml")


@pytest.mark.parametrize(
    ("delay", "tried", "oldest", "told"),
    [
        (32.0, 30.0, 30.0, "oldest_s 30 is shorter than estimator.delay_s 32"),
        (0.0, 32.0, 30.0, "oldest_s 30 is shorter than tried_delays_s 32"),
        (0.0, 30.0, 2.0, "oldest_s 2 is shorter than tried_delays_s 30"),
        (0.0, 2.0, 2.0, "oldest_s 2 is not longer than the estimator's step of 2 s"),
    ],
)
def test_estimates_that_offsets_would_not_follow_are_refused(folder, delay, tried, oldest, told):
    """They are too old when they arrive, or before the next one does."""
    path, offsets = folder / "loop.toml", folder / "offsets.toml"
    text = re.sub(r"\[heater\].*", "", path.read_text("utf-8"), flags=re.DOTALL)
    text = text.replace("[30.0]", f"[{tried}]")
    path.write_text(text.replace("delay_s = 0.0", f"delay_s = {delay}"), "utf-8")
    offsets.write_text(f"oldest_s = {oldest}\n{offsets.read_text('utf-8')}", "utf-8")
    assert told in refused(path)


def test_two_axes_do_not_compensate_one_displacement_twice(folder):
    """The two drives of a gantry take the same offset, and move it once."""
    axes = '[axes.X1]\nfollows = "x"\n[axes.X2]\nfollows = "x"\n'
    (folder / "offsets.toml").write_text(axes, "utf-8")
    assert "axes X1 and X2 both follow x" in refused(folder / "loop.toml")


@pytest.mark.parametrize(
    "lines", ["duration_min = 0.01", "duration_min = 0.55\njudged_from_min = 0.54"]
)
def test_a_run_of_which_nothing_counts_is_refused(folder, monkeypatch, lines):
    """It ends after whole steps of the estimator: here of 2 s, and 33 s of the plant."""
    monkeypatch.setattr(loop_run, "set_up", lambda _: pytest.fail("set up"))
    text = (folder / "machine.toml").read_text("utf-8")
    (folder / "machine.toml").write_text(text.replace('"step_s" = 2.0', '"step_s" = 1.0'))
    text = (folder / "loop.toml").read_text("utf-8")
    (folder / "loop.toml").write_text(text.replace("duration_min = 2.0", lines))
    assert "nothing of it counts" in refused(folder / "loop.toml")


@pytest.mark.parametrize(("minutes", "samples"), [(0.03, 1), (0.4, 12)])
def test_a_run_that_is_too_short_for_noise_is_refused(folder, monkeypatch, minutes, samples):
    monkeypatch.setattr(loop_run, "set_up", lambda _: pytest.fail("set up"))
    text = (folder / "loop.toml").read_text("utf-8").replace("[30.0]", "[]")
    (folder / "loop.toml").write_text(text.replace("_min = 2.0", f"_min = {minutes}"), "utf-8")
    done = CliRunner().invoke(app, ["control", str(folder / "loop.toml")])
    assert isinstance(done.exception, InputError)
    assert f"sensor noise: {samples} samples" in str(done.exception)


def test_a_loop_in_which_nothing_acts_is_refused():
    plant = {"case": "c.toml", "heat_input": {"kind": "step", "level": 1}, "duration_min": 1}
    with pytest.raises(InputError, match="nothing acts"):
        settings_from(
            Loop, {"title": "t", "plant": plant, "estimator": {"model": "m"}}, "l", Path()
        )


@pytest.mark.parametrize("name", ["step", "duty", "break", "warm"])
def test_the_example_loops_fit_their_machine(name):
    loop = read_loop(EXAMPLE / f"{name}.toml")
    case = read_case(loop.plant.case)
    assert loop.heater.source in case.sources
    known = read_case(EXAMPLE / "estimator.toml")
    assert known.structure.element_size_mm > case.structure.element_size_mm
    kept = ("materials", "joints", "sources", "probes", "heat_input", "supports")
    assert all(getattr(known, part) == getattr(case, part) for part in kept)


def test_the_commands_of_the_page_follow_one_another(tmp_path, monkeypatch):
    """Short, on coarser meshes, in longer steps; the estimator does not have the plant's mesh."""
    for path in EXAMPLE.glob("*.*"):
        if path.suffix in (".toml", ".csv"):
            text = path.read_text("utf-8").replace("step_s = 2.0", "step_s = 10.0")
            text = re.sub(r"joint_element_size_mm = .*", "", text)
            text = text.replace("element_size_mm = 40.0", "element_size_mm = 100.0")
            text = text.replace("element_size_mm = 50.0", "element_size_mm = 125.0")
            text = text.replace("cycle_s = 2.0", "cycle_s = 10.0")
            text = re.sub(r"tried_delays_s = .*", "", text)
            minutes = {"machine": 40.0, "break": 10.0, "duty": 10.0}.get(path.stem)
            if minutes is not None:
                text = re.sub(r"duration_min = .*", f"duration_min = {minutes}", text)
            (tmp_path / path.name).write_text(text, "utf-8")
    monkeypatch.chdir(tmp_path)
    page = (EXAMPLE.parents[1] / "docs" / "closing-the-loop.md").read_text("utf-8")
    (block,) = (one for one in re.findall(r"```sh\n(.*?)```", page, re.S) if "control" in one)
    quick = partial(calibration.calibrate_joint_aware, effort=QUICK)
    monkeypatch.setattr(calibration, "calibrate_joint_aware", quick)
    for command in block.strip().splitlines():
        done = CliRunner().invoke(app, shlex.split(command)[1:])
        assert done.exit_code == 0, done.output
    content = json.loads((tmp_path / "step.json").read_text("utf-8"))
    free, heated = (run["axes"]["x"] for run in content["runs"])
    assert free["displacement"]["largest_um"] > 200.0
    assert heated["displacement"]["largest_um"] < 0.05 * free["displacement"]["largest_um"]
    assert free["with_offsets"]["largest_um"] < 0.05 * free["displacement"]["largest_um"]
