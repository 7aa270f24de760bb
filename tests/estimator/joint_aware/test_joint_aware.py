"""The joint-aware estimator: the machine's own physics, corrected by its temperatures."""

import copy
import json
import math
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from general_rule import assert_general_rule, in_machine_code
from observed import MINUTE, PLACES, SENSORS, errors, estimates, heated_through, observer, run, step
from short_runs import QUICK
from typer.testing import CliRunner
from written_estimates import assert_compensate_reads_what_is_written

from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.calibration import (
    JointAwareCalibration,
    calibrate_machine,
    calibrated_range,
)
from calibrate.joint_aware.identifiability import further_runs, profiles
from calibrate.joint_aware.left_out import widened
from calibrate.joint_aware.misfit import Run, fewer, make_problem, physics_with, residuals
from calibrate.joint_aware.open_band import (
    Drawing,
    on_longer_steps,
    open_band,
    unlike_its_case,
)
from calibrate.joint_aware.physics_fit import Search, Slopes, fit_physics
from calibrate.joint_aware.readings import run_in
from calibrate.joint_aware.report import report, whole_report
from estimator.interface import Status
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.filter_design import NOISE, correct
from estimator.joint_aware.kind import KIND
from estimator.joint_aware.log import log_samples
from estimator.joint_aware.model_file import (
    fingerprint,
    read_observer,
    write_observer,
)
from estimator.joint_aware.observer_model import Calibrated
from estimator.joint_aware.readings import samples_in
from estimator.kind import Cold, Options, followed
from estimator.quality import Quality, quality_of
from estimator.registry import kind_of, kind_of_file, resumed, save_state
from estimator.states import read_state
from fesim.case.joint_sections import JointSection
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import make_response, write_response
from thermojoint.artefacts.tables.pieces import pieces_in
from thermojoint.cli.app import app
from thermojoint.reduced.machine import along, diagonal_modes
from thermojoint.reduced.parameters import with_factors
from thermojoint.reduced.physics import conduct, make_physics, settle_joint, simulate_known

MICRO = 1e-6


@pytest.fixture(scope="module")
def response(data, setup):
    return run(data, setup, {"kind": "triangle", "peak": 2.0, "duration_min": 6.0})


@pytest.mark.parametrize("law", ["cmy-1969", "back-burdekin", "cmy-exact"])
def test_machine_code_marches_as_the_plain_step(machine, law):
    """Heating that makes the joint slide, and cooling; a law that machine code does not know."""
    section = machine.joints[0].section
    given = {"normal_law": law} if law == "back-burdekin" else {"conductance": {"law": law}}
    section = JointSection.model_validate(section.model_dump() | given)
    other = replace(machine, joints=tuple(replace(one, section=section) for one in machine.joints))
    physics = physics_with(other, {})
    # Settled as closely under either law: a softer one is else settled to parts of its own gaps.
    physics = replace(physics, contact=replace(physics.contact, gap_tolerance=1e-13))
    assert (physics.kernel is None) == (law == "cmy-exact")
    inputs = np.zeros((120, 2))
    inputs[:60, 0], inputs[80:, 1] = 4.0 * machine.power[0], -3.0
    marched = simulate_known(physics, inputs, 10.0)
    amplitudes, joint = np.zeros(physics.modes.rates.size), physics.at_rest()
    # A conductance of the user's own is none that machine code knows.
    laws = [
        (replace(law, conductance=partial(law.conductance)), m) for law, m in physics.contact.laws
    ]
    plain = replace(physics, contact=replace(physics.contact, laws=laws))
    assert plain.kernel is None
    sensed, moved = [], []
    for row in inputs:
        amplitudes = conduct(plain, amplitudes, row, joint, 10.0)
        joint, displacement = settle_joint(plain, joint, amplitudes, np.zeros(0))
        sensed.append(physics.modes.sensors @ amplitudes)
        moved.append(displacement)
    assert np.abs(joint.slip).max() > 0.1 * MICRO
    temperature, displacement = marched
    assert temperature == pytest.approx(np.array(sensed), abs=1e-8)
    assert displacement == pytest.approx(np.array(moved), abs=1e-12)


def test_other_parameters_on_the_same_modes_are_as_good_as_new_ones(data, machine):
    """Film, conduction and capacity are not those that the modes were made for."""
    given = copy.deepcopy(data)
    given["convection_W_m2K"] = {"exterior": 9.0, "interior": 3.0}
    for material in given["materials"].values():
        material["conductivity_W_mK"] *= 1.08
        material["heat_capacity_J_kgK"] *= 0.95
        material["youngs_modulus_GPa"] *= 1.06
        material["expansion_1_K"] *= 1.04
    given["joints"]["knee"] |= {"friction_coefficient": 0.45, "roughness_um": 1.5}
    case = case_from_data(given, "case", Path())
    response = run(given, set_up(case), step(3.0))
    other = with_factors(
        machine,
        {
            "film": 1.5,
            "film interior, W/m2K": 3.0,
            "conduction": 1.08,
            "capacity": 0.95,
            "modulus": 1.06,
            "expansion": 1.04,
            "friction": 0.75,
            "roughness": 1.2,
        },
    )
    held = other.at_preload
    seen = run_in(response, machine, "step 3")
    physics = make_physics(diagonal_modes(other, held), other.joints, held)
    _, displacement = simulate_known(physics, seen.inputs, machine.step)
    steps = np.rint(seen.times[1:] / machine.step).astype(int) - 1
    assert displacement[steps] == pytest.approx(seen.displacement[1:], abs=0.02 * MICRO)


def test_a_plant_that_is_the_model_is_followed_without_error(estimator, response):
    _, found = estimates(estimator, samples_in(response, SENSORS))
    assert np.abs(errors(estimator, response, found)).max() < 0.05 * MICRO
    peak = float(np.abs(response["displacement"].to_numpy()).max())
    assert peak > 5.0 * MICRO
    assert all(estimate.status == Status.OK for estimate in found)


def test_the_heat_of_the_source_comes_out(estimator, response):
    _, found = estimates(estimator, samples_in(response, SENSORS))
    heat = np.array([estimate.details[0] for estimate in found])
    given = response["source_power"].to_numpy()[:, 0]
    assert np.abs(heat - given).max() < 0.05 * given.max()


def test_a_day_stays_bounded_and_says_that_it_is_longer_than_the_calibration(data, setup, machine):
    """Readings of eight hours that no machine has: one sensor is hot, the others stay cold."""
    slow = replace(machine, step=20.0)
    response = run(data, setup, step(2.0))
    slow_observer = observer(slow, {"step 2": response})
    samples = [(20.0 * k, 20.0, 0.0, 0.0, 0.0, 0.0) for k in range(1441)]
    _, found = estimates(slow_observer, samples)
    moved = np.array([estimate.displacement for estimate in found])
    assert np.abs(moved).max() < 1e-3
    assert np.abs(moved[-1] - moved[-180]).max() < 5.0 * MICRO
    assert Status.BEYOND_TIME in found[-1].status


def test_a_usual_sample_in_machine_code_is_that_of_the_general_rule(estimator, response):
    rng = np.random.default_rng(5)
    rows = [
        (time, *(np.array(values) + 0.03 * rng.standard_normal(len(values))))
        for time, *values in samples_in(response, estimator.model.sensors)
    ]
    assert_general_rule(estimator, rows)
    taken = [one for _, one in in_machine_code(estimator, rows)]
    assert sum(not one for one in taken) < 0.1 * len(taken)


@pytest.mark.parametrize("missing", [(), (7, 8, 9)])
def test_many_samples_at_once_are_estimated_as_one_after_the_other(estimator, response, missing):
    samples = np.array(list(samples_in(response, estimator.model.sensors)))
    samples[list(missing), 1] = np.nan
    moved, bands = followed(estimator, map(tuple, samples.tolist()), estimator.initial_state())
    found, around = estimator.whole_run(samples, estimator.initial_state())
    np.testing.assert_allclose(found, moved, atol=1e-15)
    np.testing.assert_allclose(around, bands, rtol=1e-12)
    assert np.array_equal(estimator.displacements(samples), found)


def test_without_any_thermometer_for_long_the_estimate_is_bad(estimator, response):
    samples = [list(row) for row in samples_in(response, SENSORS)][:40]
    time, *readings = samples[-1]
    nothing = [np.nan] * len(SENSORS) + readings[len(SENSORS) :]
    samples += [[time + 900.0 * k, *nothing] for k in (1, 2, 3)]
    _, found = estimates(estimator, samples)
    quality = [quality_of(one.words, one.displacement) for one in found]
    assert quality[-4:] == [Quality.GOOD, Quality.UNCERTAIN, Quality.UNCERTAIN, Quality.BAD]
    assert found[-1].band.max() > 3.0 * found[-4].band.max()


def test_a_missing_sensor_costs_little_and_is_said(estimator, response):
    samples = [list(row) for row in samples_in(response, SENSORS)]
    for row in samples[60:120]:
        row[3] = np.nan
    _, found = estimates(estimator, samples)
    assert np.abs(errors(estimator, response, found)).max() < 0.1 * MICRO
    assert Status.READING_MISSING in found[80].status
    assert Status.READING_MISSING not in found[150].status
    assert np.all(found[119].band >= found[59].band)


def test_without_any_reading_the_band_grows_and_then_comes_back(estimator, response):
    samples = [list(row) for row in samples_in(response, SENSORS)]
    for row in samples[60:120]:
        row[1:] = [np.nan] * 5
    _, found = estimates(estimator, samples)
    assert np.all(found[119].band > 2.0 * found[59].band)
    assert np.all(found[200].band < 0.5 * found[119].band)
    wrong = np.abs(errors(estimator, response, found))
    assert np.all(wrong[119] < found[119].band)


def test_late_samples_are_marched_in_between(estimator, response):
    """Every fifth sample alone: the joint's pressures keep up, the heat is known less often."""
    samples = list(samples_in(response, SENSORS))[::5]
    _, found = estimates(estimator, samples)
    assert np.abs(errors(estimator, response.isel(time=slice(None, None, 5)), found)).max() < (
        0.3 * MICRO
    )


def test_samples_that_are_always_late_are_settled(estimator, response):
    """A log has a row every ten seconds: nothing is wrong with it, and an axis may follow it."""
    samples = list(samples_in(response, SENSORS))[::5]
    _, found = estimates(estimator, samples)
    assert not any(Status.UNSETTLED in one.status for one in found)
    # A pause has an effect for a while, as at any interval.
    _, paused = estimates(estimator, samples[:10] + samples[13:])
    since = [Status.UNSETTLED in one.status for one in paused[10:]]
    assert since[0]
    assert not since[-1]
    _, warm = estimates(estimator, samples, estimator.warm_state())
    assert all(Status.UNSETTLED in one.status for one in warm[:20])


@pytest.mark.parametrize("jitter", [1e-6, 1e-3, 0.2])
def test_a_clock_that_jitters_leaves_the_machine_settled(estimator, response, jitter):
    """By 1 ms at steps of 2 s one sample in nine was unsettled, and offsets froze."""
    samples, random = list(samples_in(response, SENSORS)), np.random.default_rng(1)
    late = random.uniform(0.0, jitter, len(samples))
    rows = [(row[0] + by, *row[1:]) for row, by in zip(samples, late, strict=True)]
    (_, usual), (_, found) = (estimates(estimator, given) for given in (samples, rows))
    assert [one.status for one in found] == [one.status for one in usual]
    moved = np.array([[one.displacement for one in each] for each in (found, usual)])
    assert np.abs(np.diff(moved, axis=0)).max() < 0.2 * MICRO


@pytest.mark.parametrize("missing", [1, 5, 60])
def test_a_gap_is_unsettled_while_it_makes_the_band_wider_by_more_than_41_percent(
    response, estimator, missing
):
    """Ten seconds without a reading do not end a compensation for an hour."""
    samples = list(samples_in(response, SENSORS))
    gap = range(30, 30 + missing)
    rows = [(row[0], *[np.nan] * 5) if k in gap else row for k, row in enumerate(samples)]
    (_, usual), (_, found) = (estimates(estimator, given) for given in (samples, rows))
    pairs = list(zip(found, usual, strict=True))[gap.stop :]
    wider = np.array([(one.band / other.band).max() for one, other in pairs])
    unsettled = np.array([Status.UNSETTLED in one.status for one, _ in pairs])
    assert np.all(unsettled[wider > 1.45])
    assert not np.any(unsettled[wider < 1.35])
    assert unsettled[0]
    assert unsettled[-1] == (missing > 1)


@pytest.mark.parametrize("days", [1.0, 365.0, 20_000.0])
def test_the_band_holds_after_a_gap_at_whose_end_the_machine_began_to_warm_up(
    response, estimator, days
):
    """The clock of a source may have been in 1970 until the network told it the time."""
    samples = list(samples_in(response, SENSORS))[100:110]
    rows = [(0.0, *[0.0] * 5), *((86_400.0 * days + row[0], *row[1:]) for row in samples)]
    _, found = estimates(estimator, rows)
    wrong = np.abs(errors(estimator, response.isel(time=slice(100, 110)), found[1:]))
    assert np.all(wrong <= [one.band for one in found[1:]])


def test_a_warm_start_comes_to_what_a_cold_one_knows(data, setup, estimator):
    response = run(data, setup, step(1.0), 20.0)
    samples = list(samples_in(response, SENSORS))[150:]
    _, found = estimates(estimator, samples, estimator.warm_state())
    wrong = np.abs(errors(estimator, response.isel(time=slice(150, None)), found))
    band = np.array([estimate.band for estimate in found])
    assert np.all(wrong <= band)
    assert np.all(band[-1] < band[0] / 3.0)
    assert wrong[-1].max() < 1.0 * MICRO
    assert Status.UNSETTLED in found[0].status


def test_a_warm_start_takes_as_long_however_often_it_is_sampled(stepped, estimator):
    """A quarter of the model's step apart, readings say as much in a minute as before."""
    samples = np.array(list(samples_in(stepped, SENSORS)))[100:]

    def band_after(apart, lasts=120.0):
        times = samples[0, 0] + np.arange(0.0, lasts + apart, apart)
        read = [np.interp(times, samples[:, 0], column) for column in samples[:, 1:].T]
        _, found = estimates(
            estimator, np.column_stack([times, *read]).tolist(), estimator.warm_state()
        )
        return found[-1].band

    usual = band_after(estimator.model.step)
    assert band_after(0.25 * estimator.model.step) == pytest.approx(usual, rel=0.02)


def test_the_excess_covariance_is_exact(estimator):
    """Against the recursion of the whole matrix: a reading is missing, another start."""
    system = estimator.observer.system
    steady = replace(estimator.model.filter, lasting=np.zeros(5))
    rows, rng = system.rows, np.random.default_rng(0)
    noise = np.diag(steady.noise)
    # P from its own columns is not kept: take any P that has these.
    basis = np.linalg.svd(rows, full_matrices=False)[2]
    whole = steady.cross @ np.linalg.solve(steady.innovation, steady.cross.T)
    assert rows @ whole == pytest.approx(steady.cross.T, rel=1e-6, abs=1e-9)
    excess = rng.normal(size=(system.size, 2)) * steady.scale[:, None]
    present = np.array([0, 2, 4])
    seen = rows[present]
    prior = whole + excess @ excess.T
    innovation = seen @ prior @ seen.T + noise[np.ix_(present, present)]
    wanted_gain = np.linalg.solve(innovation, seen @ prior).T
    after = prior - wanted_gain @ seen @ prior
    usual = whole - whole @ rows.T @ np.linalg.solve(rows @ whole @ rows.T + noise, rows @ whole)
    gain, more = correct(steady, rows, present, excess, 1.0)
    assert basis @ gain == pytest.approx(basis @ wanted_gain, rel=1e-6, abs=1e-9)
    scale = np.abs(after - usual).max()
    assert more @ more.T == pytest.approx(after - usual, abs=1e-6 * scale)


def test_a_state_goes_on_bit_for_bit(estimator, response):
    samples = list(samples_in(response, SENSORS))
    samples[40] = (*samples[40][:2], np.nan, *samples[40][3:])
    whole, _ = estimates(estimator, samples)
    middle, _ = estimates(estimator, samples[:50])
    kept = middle.copy()
    resumed, _ = estimates(estimator, samples[50:], middle)
    assert np.array_equal(resumed, whole, equal_nan=True)
    assert np.array_equal(middle, kept, equal_nan=True)


def test_a_model_file_gives_the_same_estimates(estimator, response, tmp_path):
    path = tmp_path / "model.h5"
    write_observer(estimator.model, path)
    read = JointAware(read_observer(path))
    assert fingerprint(read.model) == fingerprint(estimator.model)
    samples = list(samples_in(response, SENSORS))[:30]
    assert np.array_equal(
        estimates(read, samples)[0], estimates(estimator, samples)[0], equal_nan=True
    )


def test_a_response_whose_thermometer_is_elsewhere_is_said(estimator, response, tmp_path):
    write_observer(estimator.model, tmp_path / "model.h5")
    model, name = read_observer(tmp_path / "model.h5"), SENSORS[1]
    moved = response.copy(deep=True)
    moved["probe_position"].loc[{"probe": name}] += [0.0, 3e-3, 4e-3]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        list(KIND.response(model, response))
    with pytest.warns(UserWarning, match=f"probe '{name}' of the response is 5 mm from that of"):
        list(KIND.response(model, moved))


def test_a_response_whose_displacement_is_that_of_other_points_is_said(estimator, response):
    other = response.assign_attrs(displacement_of="B relative to A")
    with pytest.warns(UserWarning, match="that of B relative to A, and .* that of A relative to B"):
        list(KIND.response(estimator.model, other))


def test_what_estimate_writes_is_what_compensate_reads(estimator, tmp_path):
    write_observer(estimator.model, tmp_path / "model.h5")
    assert_compensate_reads_what_is_written(tmp_path / "model.h5", tmp_path, "joint-aware")


def test_foreign_and_damaged_files_are_refused_in_one_line(estimator, tmp_path):
    path = tmp_path / "model.h5"
    write_observer(estimator.model, path)
    assert kind_of_file(path) is KIND
    whole = path.read_bytes()
    middle = len(whole) // 2
    damaged = whole[:middle] + bytes(2000) + whole[middle + 2000 :]
    for content in (b"", b"{}", whole[:middle], damaged):
        path.write_bytes(content)
        with pytest.raises(InputError) as caught:
            read_observer(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="no such file"):
        read_observer(tmp_path / "none.h5")


def test_bad_samples_are_refused_and_leave_the_state(estimator):
    state, _ = estimator.sample(estimator.initial_state(), 0.0, [0.0] * 5)
    with pytest.raises(InputError, match="does not come after"):
        estimator.sample(state, 0.0, [0.0] * 5)
    with pytest.raises(InputError, match="expected 5"):
        estimator.sample(state, 2.0, [0.0] * 4)


def test_a_response_without_a_sensor_is_refused(estimator, response):
    with pytest.raises(InputError, match="no probe named 'T2'"):
        list(samples_in(response.drop_sel(probe="T2"), SENSORS))


def test_a_heat_beyond_the_calibration_is_said(data, setup, estimator):
    _, found = estimates(estimator, samples_in(run(data, setup, step(3.0), 5.0), SENSORS))
    assert Status.BEYOND_HEAT in found[-1].status


@pytest.fixture(scope="module")
def plant(data, setup, machine):
    """Calibration runs of a machine with another friction and heat than the case says."""
    physics, runs = physics_with(machine, TRUE), []
    for level in (1.0, 3.0):
        seen = run_in(run(data, setup, step(level)), machine, "step")
        inputs = seen.inputs[:150]
        times = machine.step * np.arange(10, 151, 10)
        temperature, displacement = simulate_known(physics, inputs, machine.step)
        runs.append(Run(inputs, times, temperature[9::10], displacement[9::10, :2], 2.0))
    return runs


TRUE = {"friction": 0.75, "heat": 1.05}


@pytest.fixture(scope="module")
def fit(small, plant):
    return fit_physics(small, plant, list(TRUE))


@pytest.fixture(scope="module")
def known():
    return Calibrated(300.0, 3.0, dict.fromkeys(SENSORS, (0.0, 50.0)))


@pytest.fixture(scope="module")
def model(small, fit, known):
    return make_observer(small, fit, known)


def test_the_fit_leaves_less_than_the_case_does_and_knows_what_it_knows(small, plant, fit):
    before = fit_physics(small, plant, [])
    assert fit.residual_displacement.max() < 0.7 * before.residual_displacement.max()
    for one, value, spread in zip(
        fit.parameters, fit.coordinates, np.sqrt(np.diag(fit.covariance)), strict=True
    ):
        assert abs(value - np.log(TRUE[one.name])) < 3.0 * spread
        assert spread < one.spread
    told = report(fit)
    assert {one["parameter"] for one in told["parameters"]} == set(TRUE)
    assert {one["decided_by"] for one in told["directions"]} <= {"data", "prior"}


def gradient(machine, runs, fit, coordinates):
    """Of half the sum of squares by the machine's own march, in units of the priors."""
    problem, step = make_problem(machine, runs), 1e-3

    def cost(scaled):
        found = residuals(problem, fit.parameters, scaled * fit.spread)
        return 0.5 * (found @ found + scaled @ scaled)

    at, sides = coordinates / fit.spread, step * np.eye(fit.spread.size)
    return np.array([cost(at + one) - cost(at - one) for one in sides]) / (2.0 * step)


def test_a_search_by_coarse_marches_comes_to_the_minimum_of_the_machine_s_own(small, plant, fit):
    begin = gradient(small, plant, fit, np.zeros(2))
    end = gradient(small, plant, fit, fit.coordinates)
    assert np.abs(end).max() < 0.01 * np.abs(begin).max()
    assert len(fit.starts) > 1
    assert np.ptp([one.cost for one in fit.starts]) < 0.1


def test_slopes_that_are_moved_explain_every_step_and_are_those_of_a_linear_machine():
    rng = np.random.default_rng(2)
    each, beyond = rng.normal(size=(2, 3, 7, 2))
    places = rng.normal(size=(4, 3))
    slopes = Slopes(places[0], np.tensordot(places[0], each, axes=1), each + beyond)
    for place in places[1:]:
        before = slopes
        slopes = slopes.moved(place, np.tensordot(place, each, axes=1))
        explained = before.errors + np.tensordot(place - before.at, slopes.each, axes=1)
        np.testing.assert_allclose(explained, slopes.errors, atol=1e-12)
        assert np.linalg.norm(slopes.each - each) < np.linalg.norm(before.each - each)
    still = slopes.moved(slopes.at, slopes.errors)
    np.testing.assert_array_equal(still.each, slopes.each)


def test_offsets_and_noise_of_the_sensors_are_found(small, plant, fit):
    offset, noise = np.array([0.2, -0.15, 0.1, -0.2]), 0.02
    rng = np.random.default_rng(0)
    runs = [
        replace(
            one,
            temperature=one.temperature + offset + noise * rng.normal(size=one.temperature.shape),
        )
        for one in plant
    ]
    found = fit_physics(small, runs, list(TRUE), Search(starts=0))
    assert found.offset == pytest.approx(offset, abs=0.05)
    assert found.noise == pytest.approx(np.full(4, noise), rel=0.5)
    assert np.all(np.abs(found.coordinates - fit.coordinates) < 0.5 * fit.spread)


def test_an_offset_costs_nothing_once_it_is_known(estimator, response):
    offset = np.array([0.3, -0.2, 0.1, -0.3])
    shifted = JointAware(replace(estimator.model, offset=offset))
    samples = np.array(list(samples_in(response, SENSORS)))
    _, exact = estimates(estimator, samples.tolist())
    samples[:, 1:5] += offset
    _, found = estimates(shifted, samples.tolist())
    for one, other in zip(found, exact, strict=True):
        assert one.displacement == pytest.approx(other.displacement, abs=1e-9 * MICRO)


def test_a_profile_has_its_minimum_at_the_fit(small, plant, fit):
    for one in profiles(small, plant, fit):
        assert np.argmin(one.cost) == 2
        # A search ends before its last digit: a standard deviation costs a half.
        assert one.cost[2] == pytest.approx(0.0, abs=1e-6)
        # That holds where the machine is linear in its parameters.
        assert np.all(one.cost[[0, 4]] > one.cost[[1, 3]])
        assert one.cost[[1, 3]] == pytest.approx([0.5, 0.5], rel=0.5)


def test_a_further_run_leaves_less_unknown(small, plant, fit):
    none, *others = further_runs(small, plant, fit)
    assert none.name == "none"
    assert none.deviation == pytest.approx(np.sqrt(np.diag(fit.covariance)), rel=1e-6)
    for one in others:
        assert np.all(one.deviation <= none.deviation)
        assert np.all(one.day <= none.day)
        assert one.deviation.min() < 0.9 * none.deviation.min()


def test_the_whole_report_is_plain_numbers(small, plant, fit, model):
    told = json.loads(json.dumps(whole_report(JointAwareCalibration(model, fit, small, plant))))
    assert set(told["offsets_K"]) == set(SENSORS)
    assert set(told["prediction_only"]) <= set(TRUE)
    assert all(one["agrees"] for one in told["starts"])
    assert set(told["condensation"]["reuse_one"]) == set(TRUE)


def test_the_band_holds_what_only_the_prior_decides_in_full(small, plant, fit, model):
    """Data count more in the band than in the fit; what they do not tell is not known better."""
    untold = replace(fit, jacobian=np.zeros_like(fit.jacobian))
    drawings = (Drawing(draws=2, duration=900.0, assumed=assumed) for assumed in (1.0, 2.0))
    wide, wider = (
        np.linalg.norm(open_band(small, plant, untold, model, drawing=drawing).open)
        for drawing in drawings
    )
    assert wider == pytest.approx(wide, rel=0.1)


def test_what_the_calibration_leaves_open_widens_the_band_with_the_heat(small, plant, fit, model):
    band = open_band(small, plant, fit, model, drawing=Drawing(draws=2, duration=2400.0))
    assert np.all(band.square >= 0.0)
    assert band.open.shape == (2, 2, 2 * fit.discrepancy.displacement.shape[1])
    assert np.all(np.abs(band.open).max(axis=(1, 2)) > 0.0)


def test_a_machine_unlike_its_case_is_known_less_the_longer_it_is_warm(small, plant, fit, known):
    """No run lasts for as long as that; a machine of the family needs no such allowance."""
    like, unlike = (
        unlike_its_case(
            on_longer_steps(small, plant, known, replace(fit, doubt=doubt), NOISE, Drawing())
        )
        for doubt in (1.0, 2.0)
    )
    assert not like.any()
    assert not unlike[:, :-1].any()
    moved = np.max([np.abs(one.displacement).max(axis=0) for one in plant], axis=0) / 3.0
    # Along every axis as in the mean of them.
    size = np.full(2, np.sqrt(np.mean(moved**2)))
    assert np.sqrt(unlike[:, -1]) == pytest.approx(0.169 * size, rel=0.01)


def test_a_band_is_not_checked_on_slow_errors_of_which_the_other_runs_cannot_tell(machine, small):
    """Those of a machine unlike its case, in a run that is several times as long as all others."""
    inputs = np.tile(np.append(machine.power, 0.0), (120, 1))
    sensed, moved = simulate_known(physics_with(machine, {}), inputs, 20.0)
    times = 20.0 * np.arange(1.0, 121.0)
    long, short = (Run(inputs[:n], times[:n], sensed[:n], moved[:n, :2], 20.0) for n in (120, 30))
    fit = fit_physics(small, [long, short], ["heat"], Search(starts=0))
    known = Calibrated(2400.0, 1.0, dict.fromkeys(SENSORS, (0.0, 50.0)))
    model, drawing = make_observer(small, fit, known), Drawing(draws=2, duration=900.0)
    unchecked = [
        widened(small, [long, short], replace(fit, doubt=doubt), model, NOISE, drawing)[1]
        for doubt in (1.0, 1.5)
    ]
    assert unchecked == [[], [0]]


def test_the_heat_of_every_source_is_in_the_range_of_its_own_calibration(spread):
    """A small source alone, three times its reference: hardly any of what all have together."""
    two = heated_through(spread, ("table",))
    powers = np.array([[0.0, 0.0], [0.0, 3.0 * two.power[1]]])
    values = {
        "heat_input": powers.sum(axis=1) / two.power.sum(),
        "source_power": powers,
        "temperature": np.zeros((2, len(PLACES))),
        "displacement": np.zeros((2, 3)),
    }
    names = {"probe": list(PLACES), "axis": list("xyz"), "source": list(two.source_names)}
    alone = make_response(values, {"time": np.array([0.0, MINUTE]), **names})
    assert calibrated_range(two, {"alone": alone}).heat == pytest.approx(3.0)


def test_a_run_without_heat_and_one_of_two_steps_are_runs(data, setup, machine, stepped):
    """Without the heated one there is no fit, on which its band could be checked."""
    cold = run(data, setup, step(0.0), 2.0)
    runs = {"step": stepped, "cold": cold}
    found = calibrate_machine(machine, runs, fitted=["heat"], effort=QUICK)
    assert found.unchecked == ("step",)
    runs["cold"] = stepped.isel(time=slice(3))
    assert not calibrate_machine(machine, runs, fitted=["heat"], effort=QUICK).unchecked
    with pytest.raises(InputError, match="no run has any heat"):
        calibrate_machine(machine, {"cold": cold.isel(time=slice(3))}, effort=QUICK)


def test_one_step_more_of_the_runs_does_not_change_the_band(machine):
    """Steps of 10 s are joined to those of the band, whatever their number."""
    small, known = along(replace(machine, step=10.0), ["x", "y"]), dict.fromkeys(SENSORS, (0.0, 50))
    physics, drawing = physics_with(small, TRUE), Drawing(draws=2, duration=900.0)

    def added(count):
        runs = []
        for level, unlike in ((1.0, 1.0), (3.0, 1.3)):
            inputs = np.tile(np.append(level * small.power, 0.0), (count, 1))
            sensed, moved = simulate_known(physics, inputs, small.step)
            times = small.step * np.arange(1.0, count + 1)
            runs.append(Run(inputs, times, sensed, unlike * moved, small.step))
        fit = fit_physics(small, runs, ["heat"], Search(starts=0))
        model = make_observer(small, fit, Calibrated(600.0, 3.0, known))
        return widened(small, runs, fit, model, NOISE, drawing)[0].square.sum(axis=1)

    assert added(61) == pytest.approx(added(60), rel=0.05)


def test_a_run_that_the_others_do_not_predict_widens_the_band(machine, small, plant, fit, model):
    """A machine of the family keeps its band; one that no parameter explains does not."""
    drawing = Drawing(draws=2, duration=900.0)
    physics = physics_with(machine, TRUE)
    whole = []
    for one in plant:
        marched = simulate_known(physics, one.inputs, one.length)
        read = (np.vstack([np.zeros(values.shape[1]), values]) for values in marched)
        temperature, displacement = read
        times = one.length * np.arange(len(temperature))
        whole.append(Run(one.inputs, times, temperature, displacement[:, :2], one.length))
    weak, strong = whole
    bent = replace(strong, displacement=strong.displacement * [1.0, 1.2])

    def square_of(runs):
        fitted = fit_physics(small, [fewer(run) for run in runs], list(TRUE), Search(starts=0))
        return widened(small, runs, fitted, model, NOISE, drawing)[0].square

    own, other = square_of(whole), square_of([weak, bent])
    assert np.all(other >= 0.0)
    assert other[1].sum() > 100.0 * own[1].sum()
    assert widened(small, [strong], fit, model, NOISE, drawing) == (model.band, [])


def test_a_state_file_goes_on_bit_for_bit_and_knows_its_model(estimator, response, tmp_path):
    path = tmp_path / "state.json"
    samples = list(samples_in(response, SENSORS))[:40]
    state, _ = estimates(estimator, samples)
    save_state(estimator, state, path)
    _, again = resumed(KIND, estimator.model, Options(), path)
    assert np.array_equal(again, state, equal_nan=True)
    save_state(estimator, estimator.warm_state(), path)
    _, again = resumed(KIND, estimator.model, Options(), path)
    assert np.array_equal(again, estimator.warm_state(), equal_nan=True)
    other = replace(estimator.model, step=1.0)
    with pytest.raises(InputError, match="another model"):
        resumed(KIND, other, Options(), path)
    path.write_text("{}")
    with pytest.raises(InputError, match="not a 'thermojoint-estimator-state'"):
        resumed(KIND, estimator.model, Options(), path)


def test_a_log_above_the_ambient_and_one_of_thermometers_say_the_same():
    above = ["time_s,b_K,s_K", "0,0,0", "2,,1.5"]
    read = ["time_s,s_degC,b_degC,ambient_degC", "0,20,20,20", "2,21.5,nan,20"]
    first = list(log_samples(pieces_in(above, "log"), ("s", "b"), "log"))
    second = list(log_samples(pieces_in(read, "log"), ("s", "b"), "log"))
    assert first[0] == second[0] == (0.0, 0.0, 0.0, 0.0)
    assert first[1][:2] == second[1][:2] == (2.0, 1.5)
    assert np.isnan(first[1][2])
    assert np.isnan(second[1][2])


def test_a_log_in_two_parts_counts_from_where_the_first_one_began(estimator, response, tmp_path):
    """The room warms up, so that the first ambient of the second part is another."""
    model, state, out = (tmp_path / name for name in ("model.h5", "state.json", "e.csv"))
    write_observer(estimator.model, model)
    table = np.array(list(samples_in(response, SENSORS)))[:40]
    warmer = 20.0 + 0.05 * np.arange(len(table))
    head = ",".join(["time_s", *(f"{name}_degC" for name in (*SENSORS, "ambient"))])
    lines = [
        ",".join(map(repr, (time, *(row[:-1] + now).tolist(), now)))
        for (time, *_), row, now in zip(table.tolist(), table[:, 1:], warmer.tolist(), strict=True)
    ]

    def estimated(rows, *more):
        (tmp_path / "log.csv").write_text("\n".join([head, *rows]) + "\n")
        command("estimate", model, tmp_path / "log.csv", "--out", out, *more)
        return out.read_text().splitlines()[1:]

    whole = estimated(lines)
    first = estimated(lines[:20], "--save-state", state)
    assert [*first, *estimated(lines[20:], "--continue", state)] == whole
    for cold, told in (
        (Cold(0.0), "temperatures above the ambient"),
        (Cold(continued=True), "state"),
    ):
        with pytest.raises(InputError, match=told):
            list(log_samples(pieces_in([head, lines[0]], "log"), SENSORS, "log", cold=cold))


def test_the_first_row_of_a_log_is_shown_as_it_was_read(estimator):
    """For warnings about a unit: of the sensors that it has, and once."""
    rows = [["68"] * len(SENSORS), ["69"] * len(SENSORS)]
    head = ",".join(["time_s", *(f"{name}_degC" for name in (*SENSORS, "ambient"))])
    lines = [head, *(",".join([f"{2 * k}", *row, "68"]) for k, row in enumerate(rows))]
    lines[1] = lines[1].replace("68", "", 1)
    told, pieces = [], pieces_in(lines, "log", rows=1)
    list(kind_of(estimator).log(estimator.model, pieces, "log", told.append, Cold()))
    (first,) = told
    assert list(first) == [f"{name}_degC" for name in (*SENSORS[1:], "ambient")]
    assert list(first.values()) == pytest.approx([68.0] * len(SENSORS))


@pytest.mark.parametrize("broken", [-200.0, 850.0])
def test_a_broken_first_reading_of_the_ambient_is_no_cold_machine(estimator, broken):
    """A wire that is broken or touches another; what is read next is the ambient."""
    kind, names = kind_of(estimator), (*SENSORS, "ambient")
    lines = [
        ",".join(["time_s", *(f"{name}_degC" for name in names)]),
        ",".join(["0", *["20"] * len(SENSORS), f"{broken:g}"]),
        ",".join(["2", *["21.5"] * len(SENSORS), "20"]),
    ]
    cold = Cold()
    pieces = pieces_in(lines, "log")
    before, after = kind.log(estimator.model, pieces, "log", None, cold)
    assert np.isnan(before[1:]).all()
    assert after == (2.0, *[1.5] * len(SENSORS), 0.0)
    assert cold.value == pytest.approx(293.15)
    intake = kind.intake(estimator.model, False)
    absent = [math.nan] * (len(intake.names) - intake.wanted)
    _, unknown = intake.convert([*[20.0] * len(SENSORS), broken, *absent], math.nan)
    assert math.isnan(unknown)
    _, known = intake.convert([*[21.5] * len(SENSORS), 20.0, *absent], unknown)
    assert known == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        (["time_s,s_K", "0,1"], "the model needs time_s, s_K, b_K"),
        (["time_s,s_degC,b_degC", "0,1,1"], "log: no column ambient_degC, of the air"),
        (["time_s,s_K,b_K,ambient_degC", "0,1,1,20"], "ambient_degC is no rise"),
        (["time_s,s_degC,s_degF,b_degC,ambient_degC", "0,1,99,1,20"], "both the temperature 's'"),
        (["time_s,s_K,b_K", "0,1"], "2 cells, expected 3"),
        (["time_s,s_K,b_K", "0,1,warm"], "not a number"),
        (["time_s,s_K,b_K", ",1,2"], "the time is missing"),
        ([], "no header"),
    ],
)
def test_a_bad_log_is_refused_in_one_line(lines, what):
    with pytest.raises(InputError, match=what) as caught:
        list(log_samples(pieces_in(lines, "log"), ("s", "b"), "log"))
    assert "\n" not in str(caught.value)


def test_the_command_line_estimates_and_validates_with_a_model_file(estimator, response, tmp_path):
    model, run_file = tmp_path / "model.h5", tmp_path / "run.nc"
    write_observer(estimator.model, model)
    write_response(response.isel(time=slice(0, 60)), run_file)
    out, state = tmp_path / "estimate.csv", tmp_path / "state.json"
    command("estimate", model, run_file, "--out", out, "--save-state", state)
    rows = out.read_text().splitlines()
    assert rows[0].startswith("time_s,heat_bearings_W")
    assert len(rows) == 61
    assert read_state(state).values[0] == pytest.approx(118.0)
    judged = tmp_path / "validation.json"
    command("validate", model, run_file, "--json", judged)
    found = json.loads(judged.read_text())["rows"]
    assert {row["estimator"] for row in found} == {"joint-aware"}
    assert max(row["max_abs_error_um"] for row in found) < 0.05


def test_a_log_judges_a_model_as_its_response_does(estimator, response, tmp_path):
    """Whatever zero its displacements have, and where these are read in few of its rows."""
    write_observer(estimator.model, tmp_path / "model.h5")
    part = response.isel(time=slice(0, 60))
    write_response(part, tmp_path / "run.nc")
    warm = 21.5 + part["temperature"].sel(probe=list(SENSORS)).to_numpy()
    moved = 1e6 * part["displacement"].sel(axis=["x", "y"]).to_numpy() + [30.0, -7.0]
    head = ["time_s", *(f"{name}_degC" for name in SENSORS), "ambient_degC", "x_um", "y_um"]
    table = np.column_stack((part["time"], warm, np.full(60, 21.5), moved))
    rows = [[f"{one:.9g}" for one in row] for row in table]
    sparse = [row if k % 10 == 0 else [*row[:-2], "", ""] for k, row in enumerate(rows)]
    found = {}
    for name, lines in (("run.nc", None), ("full.csv", rows), ("sparse.csv", sparse)):
        if lines:
            text = "\n".join(",".join(line) for line in [head, *lines])
            (tmp_path / name).write_text(text + "\n")
        command("validate", tmp_path / "model.h5", tmp_path / name, "--json", tmp_path / "v.json")
        judged = json.loads((tmp_path / "v.json").read_text())["rows"]
        found[name] = np.array([row["max_abs_error_um"] for row in judged])
    assert found["full.csv"] == pytest.approx(found["run.nc"], abs=1e-5)
    assert (found["sparse.csv"] <= found["run.nc"] + 1e-5).all()
    absolute = np.column_stack((table[:, 0], 273.15 + warm, np.full(60, 294.65), moved))
    names = ",".join(head).replace("_degC", "_K")
    np.savetxt(tmp_path / "kelvin.csv", absolute, "%.9g", ",", header=names, comments="")
    told = command("validate", tmp_path / "model.h5", tmp_path / "kelvin.csv")
    assert "warning: kelvin: T1_K = 294.65 is implausible" in told
    picture = tmp_path / "truth.png"
    command("validate", tmp_path / "model.h5", tmp_path / "sparse.csv", "--out", picture)
    assert picture.stat().st_size > 1000


def test_calibrating_without_a_machine_is_refused(tmp_path, response):
    run_file = tmp_path / "run.nc"
    write_response(response, run_file)
    given = ("--reference", run_file, "--input", f"2={run_file}", "--out", tmp_path / "m.h5")
    result = CliRunner().invoke(
        app, [str(one) for one in ("calibrate", "--kind", "joint-aware", *given)]
    )
    assert "--case" in str(result.exception)
    assert isinstance(result.exception, InputError)


def command(*words):
    result = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output
