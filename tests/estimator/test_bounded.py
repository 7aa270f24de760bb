"""Estimators calibrated on 35 minutes stay bounded for 8 hours and for a week, and say so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from calibrate import chain
from calibrate.baselines import bounded_past, fit_baselines
from calibrate.linear import FADING, SLOWEST
from estimator.baselines.kind import regressions
from estimator.fchs.estimator import Fchs
from estimator.interface import Status, follow
from fesim.case.schema import case_from_data
from fesim.case.thermal_sections import StepInput
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import columns_of
from thermojoint.models.assembly import assemble
from thermojoint.models.baselines import read_baselines, write_baselines
from thermojoint.models.filters.bank import (
    leaking,
    respond_to_line,
    respond_to_steps,
    simple_bank,
    stacked,
    summed,
)
from thermojoint.models.sensors import readings, rises

AXES = ("x", "y")
CALIBRATED = 35.0
DAY, WEEK = 8 * 60.0, 7 * 24 * 60.0
STEP = 30.0
#: The estimators that know of a heat.
KINDS = ("mlr", "ridge", "arx", "fchs")


@pytest.fixture(scope="module")
def respond(coarse_data):
    """Simulate a step on the coarse machine: (heat input, minutes) to the response."""
    data = coarse_data | {"march": {"step_s": STEP, "duration_min": CALIBRATED}}
    coarse = case_from_data(data, "coarse case", Path())
    setup = set_up(coarse)

    def run(level, minutes):
        march = coarse.march.model_copy(update={"duration_min": minutes})
        heat = StepInput(kind="step", level=level)
        case = coarse.model_copy(update={"march": march, "heat_input": heat})
        return simulate(case, setup=setup).response.sel(axis=list(AXES))

    return run


@pytest.fixture(scope="module")
def calibration(respond):
    return {level: respond(level, CALIBRATED) for level in (0.5, 1.0, 2.0)}


@pytest.fixture(scope="module")
def model(calibration):
    others = {level: calibration[level] for level in (0.5, 2.0)}
    return chain.calibrate_responses(calibration[1.0], others).model


@pytest.fixture(scope="module")
def baselines(calibration):
    return fit_baselines(list(calibration.values()))


def test_baselines_take_runs_of_other_lengths(calibration):
    whole, half, _ = calibration.values()
    short = half.isel(time=slice(0, half.sizes["time"] // 2))
    fitted = fit_baselines([whole, short])
    assert fitted.span.duration_s == pytest.approx(float(whole["time"][-1]))
    assert fitted.span.heat == pytest.approx((0.0, 1.0))


@pytest.fixture(scope="module")
def estimators(model, baselines):
    assembly = assemble(model, STEP, 7200.0)
    found = [*regressions(baselines, STEP), Fchs(assembly)]
    return {one.kind: one for one in found}


def estimated(estimator, response):
    """Run an estimator on the temperatures of a response: displacements (k, axes) and statuses."""
    seen = readings(response)
    inputs = {
        3: np.column_stack((seen.delta_T, seen.temperatures)),
        4: rises(response),
    }[len(estimator.channels)]
    samples = np.column_stack((seen.times, inputs)).tolist()
    found = [one for _, one in follow(estimator, samples, estimator.initial_state())]
    return np.array([one.displacement for one in found]), [one.status for one in found]


@pytest.fixture(scope="module")
def long_runs(respond):
    week = respond(1.0, WEEK)
    return {
        "day": week.isel(time=slice(0, int(DAY * 60.0 / STEP) + 1)),
        # An estimator takes any interval.
        "week": week.isel(time=slice(0, None, 10)),
        "day at 3": respond(3.0, DAY),
    }


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("run", ["day", "week", "day at 3"])
def test_an_estimator_calibrated_for_35_minutes_is_bounded_for_as_long_as_it_runs(
    estimators, calibration, long_runs, kind, run
):
    response = long_runs[run]
    displacement, status = estimated(estimators[kind], response)
    heat = float(response["heat_input"][-1])
    largest = np.abs(columns_of(calibration[2.0], "displacement", AXES)).max() / 2.0 * heat
    # The slowest term goes on to at most this multiple of what it was when calibration ended.
    reach = -1.0 / np.expm1(-SLOWEST)
    if kind in ("mlr", "ridge", "arx"):
        # A regression follows the temperatures.
        hottest = np.abs(rises(calibration[2.0])).max() / 2.0 * heat
        reach = 1.5 * np.abs(rises(response)).max() / hottest
    assert np.abs(displacement).max() < reach * largest
    assert Status.BEYOND_TIME in status[-1]
    assert (Status.BEYOND_HEAT in status[-1]) == (run == "day at 3" and kind == "fchs")


@pytest.mark.parametrize("kind", ["ridge", "arx", "fchs"])
def test_a_start_on_a_warm_machine_and_after_a_pause_is_said_until_it_has_died_out(
    estimators, long_runs, kind
):
    response, estimator = long_runs["day"], estimators[kind]
    half = response.sizes["time"] // 2
    whole, _ = estimated(estimator, response)
    late, status = estimated(estimator, response.isel(time=slice(half, None)))
    unsettled = np.array([Status.UNSETTLED in one for one in status])
    settled = int(unsettled.argmin())
    assert unsettled[:settled].all()
    assert settled > 0
    assert not unsettled[settled:].any()
    assert np.abs(late - whole[half:])[settled:].max() < 0.1 * np.abs(whole).max()
    kept = np.delete(np.arange(half + 2), slice(half // 2, half))
    _, status = estimated(estimator, response.isel(time=kept))
    assert Status.UNSETTLED not in status[half // 2 - 1]
    assert Status.UNSETTLED in status[half // 2]


@pytest.mark.parametrize("kind", KINDS)
def test_inside_the_calibration_nothing_is_flagged_and_the_estimate_is_near(
    estimators, calibration, kind
):
    displacement, status = estimated(estimators[kind], calibration[1.0])
    actual = columns_of(calibration[1.0], "displacement", AXES)
    assert set(status) == {Status.OK}
    assert np.abs(displacement - actual).max() < 0.05 * np.abs(actual).max()


def test_every_fitted_rate_is_one_that_the_calibration_can_bear(model):
    length = model.span.duration_s
    shapes = [*model.linear.deformation.values()]
    shapes += [shape for source in model.sources for shape in source.applied.values()]
    for shape in shapes:
        assert min(shape.c, shape.d) >= SLOWEST / length * (1.0 - 1e-6)
        assert min(shape.e, shape.f or shape.e) >= FADING / length * (1.0 - 1e-6)
    for spectrum in model.linear.direct.values():
        assert min(spectrum.rates) >= SLOWEST / length * (1.0 - 1e-6)


def test_eq_8_ends_where_the_displacement_was_going_not_back_at_zero(model, calibration):
    actual = columns_of(calibration[1.0], "displacement", AXES)[-1]
    for k, axis in enumerate(AXES):
        shape = model.linear.deformation[axis]
        assert (shape.C + shape.D) / actual[k] > 0.9


def test_what_stands_still_fades_from_a_leaking_bank_and_what_moves_passes():
    bank, rate = simple_bank(np.array([-0.05, -0.002]), np.array([0.1, -0.001])), 1e-3
    leaky = leaking(bank, rate)
    s = 1j * np.geomspace(1e-6, 1.0, 30)
    wanted = bank.transfer(s) * (s / (s + rate))[:, None, None]
    assert leaky.transfer(s) == pytest.approx(wanted, rel=1e-9)
    times = 10.0 * np.arange(1, 2001)
    _, ends = respond_to_line(leaky, times, np.ones((2000, 1)), 10.0)
    assert np.abs(ends[-1]).max() < 1e-6 * np.abs(ends).max()


@given(st.lists(st.floats(0.5, 400.0), min_size=3, max_size=30), st.floats(1.05, 20.0))
def test_a_leak_is_one_more_pole_of_the_bank_by_partial_fractions(gaps, ratio):
    """Where the two poles lie apart; where they do not, its residues would cancel."""
    rate, poles, gains = 1e-3, np.array([-2e-2, -3e-2 + 1e-2j]), np.array([0.1, 0.2 - 0.1j])
    poles = np.append(poles, -rate * ratio)
    gains = np.append(gains, 3e-3)
    bank = replace(simple_bank(poles, gains), constant=np.array([[0.7]]), slope=np.array([[5.0]]))
    at_leak = bank.transfer(np.array([-rate + 0j]))[0, 0, 0].real
    poles, gains = (
        np.append(poles, -rate),
        np.append(gains * poles / (poles + rate), -rate * at_leak),
    )
    split = replace(
        simple_bank(poles, gains), constant=bank.constant - rate * bank.slope, slope=bank.slope
    )
    times = np.cumsum(gaps)
    inputs = np.sin(np.arange(len(gaps)) + 1.0)[:, None]
    for one, other in zip(
        respond_to_line(leaking(bank, rate), times, inputs, 7.0),
        respond_to_line(split, times, inputs, 7.0),
        strict=True,
    ):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-9 * np.abs(other).max())


def test_what_leaks_is_not_put_together_and_takes_no_steps():
    leaky = leaking(simple_bank(np.array([-0.05]), np.array([0.1])), 1e-3)
    for put in (stacked, summed):
        with pytest.raises(InputError, match="leak"):
            put([leaky, leaky])
    with pytest.raises(InputError, match="leak"):
        respond_to_steps(leaky, np.arange(3.0), np.ones((3, 1)), 1.0)


@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=3), st.floats(0.5, 0.999))
@example([2.2e-311], 0.5)
def test_whatever_a_prediction_says_an_autoregression_is_stable(past, radius):
    found = bounded_past(np.array(past), radius)
    poles = np.roots(np.concatenate(([1.0], -found)))
    # Of a multiple pole only the cube root of the rounding error is left.
    assert np.abs(poles).max(initial=0.0) <= radius + 1e-4


def test_an_autoregression_gives_the_same_at_the_steps_whatever_lies_between(estimators, respond):
    one = estimators["arx"]
    response = respond(1.0, 5.0)
    coarse, _ = estimated(one, response)
    fine_times = np.arange(0.0, 300.1, 7.5)
    values = rises(response)
    table = np.column_stack(
        [np.interp(fine_times, response["time"], column) for column in values.T]
    )
    samples = np.column_stack((fine_times, table)).tolist()
    # The run begins one interval before the first sample in both.
    fine = [e.displacement for _, e in follow(one, samples, one.initial_state())]
    assert np.array(fine)[::4] == pytest.approx(coarse, rel=1e-6, abs=1e-12)


def test_a_clock_that_is_set_costs_an_autoregression_no_hours(estimators):
    """From 1970 to now there are more steps than anything takes; most are forgotten in the end."""
    one = estimators["arx"]
    values = [1.0] * len(one.channels)
    state, _ = one.sample(one.initial_state(), 10.0, values)
    _, after = one.sample(state, 1.7e9, values)
    steady = [(STEP * k, *values) for k in range(1, 4000)]
    *_, (_, settled) = follow(one, steady, one.initial_state())
    assert after.displacement == pytest.approx(settled.displacement, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sample_that_goes_back_in_time_is_refused_and_the_state_stays(estimators, kind):
    one = estimators[kind]
    values = [1.0] * len(one.channels)
    state, _ = one.sample(one.initial_state(), 10.0, values)
    kept = state.copy()
    with pytest.raises(InputError, match="does not increase"):
        one.sample(state, 10.0, values)
    assert np.array_equal(state, kept)


def test_baselines_come_back_from_their_file(baselines, tmp_path):
    write_baselines(baselines, tmp_path / "baselines.json")
    assert read_baselines(tmp_path / "baselines.json") == baselines


def _short(content):
    content["ridge"]["weights"]["x"].pop()


def _other_axis(content):
    content["arx"]["z"] = content["arx"].pop("x")


@pytest.mark.parametrize("damage", [_short, _other_axis])
def test_a_damaged_file_of_baselines_is_refused(baselines, tmp_path, damage):
    path = tmp_path / "baselines.json"
    write_baselines(baselines, path)
    content = json.loads(path.read_text())
    damage(content)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="do not fit together; calibrate again"):
        read_baselines(path)
