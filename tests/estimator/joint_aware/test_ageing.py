"""A machine that ages is learnt as it runs."""

import copy
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.misfit import physics_with
from calibrate.joint_aware.physics_fit import Run, fit_physics
from estimator.interface import Status, follow
from estimator.joint_aware.ageing import AgeingJointAware
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.joint_aware.model_file import write_observer
from estimator.joint_aware.observer_model import Calibrated
from estimator.joint_aware.slow_parameters import learnt
from estimator.kind import Options
from estimator.registry import resumed, save_state
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from thermojoint.artefacts.errors import InputError
from thermojoint.cli.app import app
from thermojoint.reduced.machine import along, reduce_machine
from thermojoint.reduced.parameters import with_factors
from thermojoint.reduced.physics import simulate_known

SENSORS = ("s", "b", "T1", "T2")
STEP = 30.0
HOURS = 8


@pytest.fixture(scope="module")
def machine(coarse_data):
    data = copy.deepcopy(coarse_data)
    data["march"] |= {"thermal": "reduced"}
    data["probes"]["s"] = {"position_mm": [550.0, 700.0, 100.0], "body": "column"}
    case = case_from_data(data, "case", Path())
    return along(replace(reduce_machine(case, set_up(case), SENSORS), step=STEP), ["x", "y"])


def answers(machine, inputs):
    return simulate_known(physics_with(machine, {}), inputs, STEP)


@pytest.fixture(scope="module")
def observer(machine):
    inputs = np.tile([2.0 * machine.power[0], 0.0], (100, 1))
    times = STEP * np.arange(1, 101)
    fit = fit_physics(machine, [Run(inputs, times, *answers(machine, inputs), STEP)], [])
    known = Calibrated(2000.0, 2.0, dict.fromkeys(SENSORS, (0.0, 100.0)))
    return JointAware(make_observer(machine, fit, known))


@pytest.fixture(scope="module")
def inputs(machine):
    """Levels of half an hour; the ambient rises by 3 K."""
    levels = np.random.default_rng(4).uniform(0.0, 2.0, 2 * HOURS)
    heat = np.repeat(levels, 1800 // int(STEP))
    return np.column_stack([heat * machine.power[0], np.linspace(0.0, 3.0, heat.size)])


def samples(temperatures, inputs):
    for k, (row, given) in enumerate(zip(temperatures, inputs, strict=True)):
        yield (STEP * (k + 1), *row, given[-1])


def run(estimator, temperatures, inputs):
    start = estimator.initial_state()
    found = list(follow(estimator, samples(temperatures, inputs), start))
    return found[-1][0], [one for _, one in found]


def errors(found, displacement):
    return np.abs(np.array([one.displacement for one in found]) - displacement)


@pytest.mark.long
def test_a_machine_that_does_not_age_is_left_as_it_is(machine, observer, inputs):
    temperatures, displacement = answers(machine, inputs)
    estimator = AgeingJointAware(observer, ("preload", "film"))
    _, found = run(estimator, temperatures, inputs)
    assert found[-1].details[-4] == pytest.approx(1.0, abs=0.02)
    assert found[-1].details[-2] == pytest.approx(1.0, abs=0.05)
    assert errors(found, displacement).max() < 0.3e-6


@pytest.mark.parametrize(
    ("name", "factor", "within", "left"),
    [("preload", 0.7, 0.04, 1.0), pytest.param("film", 1.4, 0.01, 0.5, marks=pytest.mark.long)],
)
def test_what_aged_is_found_and_the_error_falls(
    machine, observer, inputs, name, factor, within, left
):
    """Slips from before the preload was known stay wrong for hours, a film leaves nothing."""
    temperatures, displacement = answers(with_factors(machine, {name: factor}), inputs)
    _, plain = run(observer, temperatures, inputs)
    _, found = run(AgeingJointAware(observer, (name,)), temperatures, inputs)
    assert found[-1].details[-2] == pytest.approx(factor, abs=within)
    assert found[-1].details[-1] < found[0].details[-1]
    late = slice(len(found) // 2, None)
    before, after = (errors(one, displacement)[late].max() for one in (plain, found))
    assert after < left * before


def test_a_touch_probe_now_and_then_tells_what_temperatures_do_not(machine, observer, inputs):
    """No thermometer sees a friction that was lost."""
    temperatures, displacement = answers(with_factors(machine, {"friction": 0.6}), inputs)
    estimator = AgeingJointAware(observer, ("friction",))
    rows = []
    for k, row in enumerate(samples(temperatures, inputs)):
        read = displacement[k] if k % 60 == 59 else [np.nan, np.nan]
        rows.append((*row, *read))
    found = [one for _, one in follow(estimator, rows, estimator.initial_state())]
    _, untouched = run(AgeingJointAware(observer, ("friction",)), temperatures, inputs)
    told, silent = (np.log(one[-1].details[-2]) for one in (found, untouched))
    assert abs(told - np.log(0.6)) < abs(silent - np.log(0.6))
    assert found[-1].details[-1] < untouched[-1].details[-1]


def test_a_sample_that_cannot_be_trusted_does_not_teach(observer):
    """Without any reading there is nothing to learn from: the uncertainty grows."""
    estimator = AgeingJointAware(observer, ("preload",))
    rows = [(STEP * k, *[np.nan] * 5) for k in range(100)]
    found = [one for _, one in follow(estimator, rows, estimator.initial_state())]
    assert Status.UNSETTLED in found[-1].status
    assert found[-1].details[-2] == pytest.approx(1.0, abs=1e-12)


def test_a_displacement_reading_that_is_refused_does_not_teach(machine, observer, inputs):
    """A probe that hits a chip reads a millimetre; the rest of that sample is as ever."""
    temperatures, displacement = answers(machine, inputs[:60])
    estimator, nothing = AgeingJointAware(observer, ("preload", "friction")), [np.nan] * 2
    rows = [[*row, *nothing] for row in samples(temperatures, inputs[:60])]
    _, untouched = run(estimator, temperatures, inputs[:60])
    rows[30][-2:] = displacement[30] + 1e-3
    found = [one for _, one in follow(estimator, rows, estimator.initial_state())]
    assert Status.READING_REFUSED in found[30].status
    assert found[-1].details[-4:] == pytest.approx(untouched[-1].details[-4:], abs=1e-4)


def test_the_filter_weighs_what_it_knows_with_what_it_reads():
    """One parameter, one reading: the mean of both by their variances."""
    found, covariance = learnt(
        np.zeros(1), np.eye(1), np.array([1.0]), np.array([[2.0]]), np.array([4.0]), 1.5
    )
    assert found[0] == pytest.approx(0.25)
    assert covariance[0, 0] == pytest.approx(0.5)


def test_a_state_goes_on_bit_for_bit_and_knows_what_it_learns(machine, observer, inputs, tmp_path):
    few = inputs[:120]
    temperatures, _ = answers(with_factors(machine, {"preload": 0.8}), few)
    estimator, path = AgeingJointAware(observer, ("preload", "film")), tmp_path / "state.json"
    every = list(samples(temperatures, few))
    whole = list(follow(estimator, every, estimator.initial_state()))[-1][0]
    half = list(follow(estimator, every[:70], estimator.initial_state()))[-1][0]
    save_state(estimator, half, path)
    options = Options(ageing=estimator.ageing)
    again, begun = resumed(KIND, observer.model, options, path)
    rest = list(follow(again, every[70:], begun))[-1][0]
    assert np.array_equal(rest, whole, equal_nan=True)
    with pytest.raises(InputError, match="saved with --ageing preload,film"):
        resumed(KIND, observer.model, Options(), path)
    save_state(estimator, estimator.warm_state(), path)
    _, begun = resumed(KIND, observer.model, options, path)
    assert np.array_equal(begun, estimator.warm_state(), equal_nan=True)


@pytest.mark.parametrize(
    ("names", "what"),
    [(("rust",), "rust"), (("film", "film"), "twice"), ((), "no parameter"), (("",), "ageing")],
)
def test_what_does_not_age_is_refused_in_one_line(observer, names, what):
    with pytest.raises(InputError, match=what) as caught:
        AgeingJointAware(observer, names)
    assert "\n" not in str(caught.value)


def test_a_machine_without_a_film_has_none_that_ages(observer):
    modes = replace(observer.model.modes, film=np.zeros_like(observer.model.modes.film))
    bare = JointAware(replace(observer.model, modes=modes))
    with pytest.raises(InputError, match="no film"):
        AgeingJointAware(bare, ("film",))


def test_the_command_line_learns_what_it_is_asked_to(machine, observer, inputs, tmp_path):
    model, log, out = tmp_path / "model.h5", tmp_path / "log.csv", tmp_path / "estimate.csv"
    write_observer(observer.model, model)
    temperatures, _ = answers(machine, inputs[:40])
    rows = [
        ",".join(f"{one!r}" for one in map(float, row))
        for row in samples(temperatures, inputs[:40])
    ]
    log.write_text("\n".join(["time_s,s_K,b_K,T1_K,T2_K,ambient_K", *rows]) + "\n")
    state = tmp_path / "state.json"
    words = ["estimate", model, log, "--ageing", "preload,friction", "--out", out]
    words += ["--save-state", state]
    result = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0
    header = out.read_text().splitlines()[0].split(",")
    assert {"preload_factor", "preload_std", "friction_factor", "friction_std"} <= set(header)
    assert json.loads(state.read_text())["carried"] == ["preload", "friction"]


def test_only_a_joint_aware_model_learns(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("time_s\n0\n")
    model = tmp_path / "model.json"
    model.write_text('{"schema": "thermojoint-learned-model"}')
    words = ["estimate", model, log, "--ageing", "film", "--out", tmp_path / "out.csv"]
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert "--ageing" in str(result.exception)
