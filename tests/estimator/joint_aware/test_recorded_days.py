"""What recorded days tell of a machine unlike its case, and what the observer makes of it."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from observed import MINUTE as STEP
from observed import PLACES, heated_through

from calibrate.joint_aware.calibration import Effort, calibrate_machine
from calibrate.joint_aware.misfit import Run, physics_with
from calibrate.joint_aware.open_band import Drawing
from calibrate.joint_aware.physics_fit import Search
from calibrate.joint_aware.random_heat import random_levels
from calibrate.joint_aware.recorded_days import is_day, shown_in, with_days
from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.filter_design import Noise
from estimator.joint_aware.model_file import read_observer, write_observer
from estimator.joint_aware.observer_state import unpacked
from thermojoint.artefacts.units import MICRO
from thermojoint.reduced.physics import simulate_known

HOURS = 8
FEW = Effort(Search(starts=0), Drawing(draws=2, duration=3600.0, step=120.0))


def marched(machine, heat, unlike):
    """A run of a machine; one unlike its case has heat of its own on two faces."""
    plant = heated_through(machine, ("top", "table"))
    # A bearing that warms with the spindle, and a cabinet that is slow to warm.
    own = heat[:, None] * machine.power
    slow = 60.0 * -np.expm1(-np.arange(len(heat)) / 120.0)
    inputs = np.column_stack([own, unlike * 40.0 * heat, unlike * slow, np.zeros(len(heat))])
    sensed, moved = simulate_known(physics_with(plant, {}), inputs, STEP)
    times = STEP * np.arange(1.0, len(heat) + 1.0)
    return Run(np.delete(inputs, [1, 2], axis=1), times, sensed, moved, STEP)


def day(machine, seed, unlike=1.0):
    return marched(machine, random_levels(seed, 3600.0 * HOURS, STEP, 2.0, 1)[:, 0], unlike)


def steps(machine, unlike):
    return [marched(machine, np.full(35, level), unlike) for level in (0.5, 1.0, 2.0)]


def response_of(run, machine):
    """A run as a response, with its first sample at rest."""
    first = [np.zeros((1, part.shape[1])) for part in (run.temperature, run.displacement)]
    heat = run.inputs[:, 0] / machine.power[0]
    values = {
        "heat_input": ("time", np.append(heat[0], heat)),
        "temperature": (("time", "probe"), np.vstack([first[0], run.temperature])),
        "displacement": (("time", "axis"), np.vstack([first[1], run.displacement])),
    }
    places = {"time": np.append(0.0, run.times), "probe": list(PLACES), "axis": ["x", "y"]}
    return xr.Dataset(values, places)


@pytest.fixture(scope="module")
def calibrated(spread):
    """By steps, and by steps and two days, each of which is unlike the case."""
    runs = {f"step {k}": run for k, run in enumerate(steps(spread, 1.0))}
    recorded = {f"day {seed}": day(spread, seed) for seed in (1, 2)}
    return [
        calibrate_machine(
            spread,
            {name: response_of(run, spread) for name, run in found.items()},
            Noise(),
            ["heat"],
            FEW,
        )
        for found in (runs, runs | recorded)
    ]


def judged(model, run):
    samples = np.column_stack([run.times, run.temperature, run.inputs[:, 1:]])
    moved, band = JointAware(model).whole_run(samples, JointAware(model).initial_state())
    return np.abs(moved - run.displacement), band


def test_days_make_another_day_of_a_machine_unlike_its_case_better(spread, calibrated):
    another = day(spread, 7)
    (before, _), (after, band) = (judged(one.model, another) for one in calibrated)
    assert calibrated[0].fit.doubt > 1.0
    assert calibrated[1].days == ("day 1", "day 2")
    assert before.max() > 3.0 * MICRO
    assert after.max() < 0.75 * before.max()
    assert np.mean(after <= band) > 0.92


def test_they_tell_no_parameters_of_it(calibrated):
    plain, told = calibrated
    assert np.array_equal(plain.fit.coordinates, told.fit.coordinates)
    assert [len(one.runs) for one in calibrated] == [3, 3]


def test_a_day_of_a_machine_like_its_case_is_a_run_like_any_other(spread):
    runs = [*steps(spread, 0.0), day(spread, 1, 0.0)]
    responses = {str(k): response_of(run, spread) for k, run in enumerate(runs)}
    found = calibrate_machine(spread, responses, Noise(), ["heat"], FEW)
    assert found.fit.doubt == 1.0
    assert not found.days
    assert len(found.runs) == 4
    assert not found.model.band.seen.size


def test_days_may_be_the_first_to_show_that_a_machine_is_unlike_its_case(spread):
    runs = [*steps(spread, 0.0), day(spread, 1)]
    responses = {str(k): response_of(run, spread) for k, run in enumerate(runs)}
    found = calibrate_machine(spread, responses, Noise(), ["heat"], FEW)
    assert found.fit.doubt == 1.0
    assert found.days == ("3",)
    assert found.model.band.told.any()


def test_where_all_runs_are_days_they_are_fitted(spread):
    found = calibrate_machine(
        spread, {"day": response_of(day(spread, 1), spread)}, Noise(), ["heat"], FEW
    )
    assert not found.days
    assert len(found.runs) == 1


def test_only_a_run_of_hours_is_a_day(spread):
    assert is_day(day(spread, 1))
    assert not is_day(steps(spread, 1.0)[0])


def test_days_without_errors_change_nothing(spread, calibrated):
    """The size zero is among the choices."""
    model = calibrated[0].model
    shown = replace(shown_in(model, day(spread, 1)), errors=np.zeros((HOURS * 7 + 4, 2)))
    assert with_days(model, [shown], [])[0] is model


def test_no_more_is_taken_from_innovations_than_days_show(calibrated):
    model = calibrated[1].model
    observer, seen = JointAware(model).observer, model.band.seen
    assert np.array_equal(observer.displacement_by(3.0 * seen), observer.displacement_by(seen))
    quiet, far = np.zeros((1, len(model.sources) * model.discrepancy.rates.size)), 3.0 * seen
    (inside,), (outside,) = (
        np.square(observer.model_error(quiet, 0.0, means[None])).sum(axis=-1)
        for means in (seen, far)
    )
    assert (outside > 1.5 * inside).all()


def test_a_sample_alone_is_that_of_a_whole_run_and_its_file(spread, calibrated, tmp_path):
    model = calibrated[1].model
    write_observer(model, tmp_path / "model.h5")
    run = day(spread, 7)
    samples = np.column_stack([run.times, run.temperature, run.inputs[:, 1:]])[:200]
    moved, bands = JointAware(model).whole_run(samples, JointAware(model).initial_state())
    again = JointAware(read_observer(tmp_path / "model.h5"))
    each = [one for _, one in follow(again, samples.tolist(), again.initial_state())]
    assert moved == pytest.approx(np.array([one.displacement for one in each]), abs=1e-15)
    assert bands == pytest.approx(np.array([one.band for one in each]), abs=1e-15)
    assert JointAware(model).displacements(samples) == pytest.approx(moved, abs=1e-15)


def test_a_reading_that_is_not_believed_has_no_part_in_it(spread, calibrated):
    estimator, run = JointAware(calibrated[1].model), day(spread, 7)
    samples = np.column_stack([run.times, run.temperature, run.inputs[:, 1:]])[:200]
    broken = samples.copy()
    broken[100:, 3] = np.nan
    broken[100:, 4] += 300.0
    ends = [
        unpacked(state, estimator.parts).watch
        for state, _ in follow(estimator, broken.tolist(), estimator.initial_state())
    ]
    for name in ("lasting", "longer", "longest"):
        means = [getattr(ends[k], name) for k in (99, -1)]
        assert np.array_equal(means[0][[2, 3]], means[1][[2, 3]])
        assert not np.array_equal(means[0][[0, 1]], means[1][[0, 1]])
