"""What displacement readings tell of a machine that its calibration left open, and the next one."""

from dataclasses import replace

import numpy as np
import pytest
from observed import SENSORS, estimates
from typer.testing import CliRunner

from estimator.interface import Status, follow
from estimator.joint_aware.compiled_sample import forget
from estimator.joint_aware.displacement_readings import (
    ModelError,
    covariance_of,
    known_error,
    later,
    mean_of,
    unknown,
)
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import write_observer
from estimator.joint_aware.next_reading import bands_around, narrowest_band, next_reading
from estimator.joint_aware.observer_state import unpacked
from estimator.joint_aware.readings import samples_in
from estimator.states import completed
from thermojoint.artefacts.response import write_response
from thermojoint.artefacts.units import MICRO
from thermojoint.cli.app import app

LIMIT = 2.0 * MICRO


@pytest.fixture(scope="module")
def undecided(estimator):
    """An observer of machines that its calibration cannot tell apart: they err on both axes."""
    model = estimator.model
    relaxations = model.discrepancy.rates.size * model.power.size
    rng = np.random.default_rng(1)
    errors = np.zeros((2, 3, 2 * relaxations))
    errors[:, :, :relaxations] = 8.0 * MICRO / relaxations * rng.normal(size=(2, 3, 1))
    return JointAware(replace(model, band=replace(model.band, open=errors)))


@pytest.fixture(scope="module")
def warmed(undecided, stepped):
    """The samples of ten minutes, and the state after each."""
    samples = list(samples_in(stepped, SENSORS))
    found = list(follow(undecided, samples, undecided.initial_state()))
    return samples, [state for state, _ in found], [estimate for _, estimate in found]


def with_reading(estimator, sample, along, off):
    """A sample with a reading of one axis that is off from the estimate by something (m)."""
    at = estimator.axes.index(along)
    probed = [np.nan] * len(estimator.axes)
    probed[at] = off[at]
    return [*sample, *probed]


def test_a_reading_of_one_axis_tells_which_machine_it_is_and_corrects_the_other(undecided, warmed):
    samples, states, alone = warmed
    true = undecided.model.band.open[:, 0, 0] / MICRO
    off = alone[150].displacement + 3.0 * MICRO * true / np.abs(true).max()
    (time, *values) = samples[150]
    _, told = undecided.sample(states[149], time, with_reading(undecided, values, "x", off))
    assert np.all(told.band < alone[150].band)
    assert told.displacement[1] != pytest.approx(alone[150].displacement[1], abs=0.01 * MICRO)


def test_the_band_after_a_reading_is_known_before_it(undecided, warmed):
    samples, states, alone = warmed
    before, after = bands_around(undecided, states[149], 0.0)
    assert before == pytest.approx(alone[149].band, rel=1e-9)
    (time, *values) = samples[150]
    for k, axis in enumerate(undecided.axes):
        given = with_reading(undecided, values, axis, alone[150].displacement)
        _, told = undecided.sample(states[149], time, given)
        assert told.band == pytest.approx(after[k], rel=0.05)


def test_the_axis_is_asked_for_whose_reading_leaves_least_above_the_limit(undecided, warmed):
    _, states, alone = warmed
    state, limit = states[-1], 0.6 * float(alone[-1].band.max())
    asked = next_reading(undecided, state, limit)
    _, after = bands_around(undecided, state, 0.0)
    left = [np.maximum(band - limit, 0.0).sum() for band in after]
    assert asked.due == 0.0
    assert asked.narrowed < asked.band
    assert left[undecided.axes.index(asked.axis)] == min(left)


def test_a_reading_is_announced_before_it_is_due(undecided, warmed):
    _, states, alone = warmed
    asked = next_reading(undecided, states[150], 1.2 * float(alone[150].band.max()))
    assert asked.due > 0.0


def test_what_no_reading_narrows_is_not_asked_for(estimator, stepped):
    """Its only error is that of its own state after a reading."""
    state, _ = estimates(estimator, list(samples_in(stepped, SENSORS))[:50])
    assert next_reading(estimator, state, 0.01 * MICRO) is None
    assert narrowest_band(estimator) > 0.9 * MICRO


def test_two_readings_that_agree_against_the_band_are_believed_and_widen_it(undecided, warmed):
    samples, states, alone = warmed
    (time, *values), (after, *later) = samples[150:152]
    off = alone[150].displacement + 200.0 * MICRO
    given = with_reading(undecided, values, "x", off)
    state, first = undecided.sample(states[149], time, given)
    assert Status.READING_REFUSED in first.status
    state, second = undecided.sample(state, after, with_reading(undecided, later, "x", off))
    assert Status.READING_REFUSED not in second.status
    assert second.displacement[0] == pytest.approx(off[0], abs=10.0 * MICRO)
    assert second.band[1] > 3.0 * alone[151].band[1]


@pytest.fixture(scope="module")
def unlike(estimator):
    """An observer whose band takes lasting innovations of T1 for 20 um a kelvin."""
    surprise = np.zeros_like(estimator.model.band.surprise)
    surprise[:, SENSORS.index("T1")] = (20.0 * MICRO) ** 2
    return JointAware(
        replace(estimator.model, band=replace(estimator.model.band, surprise=surprise))
    )


@pytest.fixture(scope="module")
def warmer_than_said(unlike, stepped):
    """Samples in which T1 is 0.4 K above the model, the state after each, and the estimates."""
    samples = np.array(list(samples_in(stepped, SENSORS)))
    samples[:, 1 + SENSORS.index("T1")] += 0.4
    found = list(follow(unlike, samples.tolist(), unlike.initial_state()))
    return samples.tolist(), [state for state, _ in found], [estimate for _, estimate in found]


def test_a_reading_tells_what_a_thermometer_that_disagrees_means(unlike, warmer_than_said):
    """The correction grows with the innovation, along the axis that was read only."""
    samples, states, alone = warmer_than_said
    (time, *values) = samples[100]
    off = alone[100].displacement + np.array([3.0 * MICRO, 0.0])
    state, told = unlike.sample(states[99], time, with_reading(unlike, values, "x", off))
    assert told.displacement == pytest.approx(off, abs=0.5 * MICRO)
    assert told.band[0] < 0.5 * alone[100].band[0]
    assert told.band[1] == pytest.approx(alone[100].band[1], rel=1e-6)
    *_, (_, last) = follow(unlike, samples[101:], state)
    at = SENSORS.index("T1")
    now, then = (
        unpacked(states[k], unlike.parts).watch.lasting[at] for k in (len(samples) - 1, 100)
    )
    corrected = last.displacement - alone[-1].displacement
    assert now > 1.5 * then
    assert corrected[0] == pytest.approx(3.0 * MICRO * now / then, rel=0.1)
    assert told.band[0] < last.band[0] < alone[-1].band[0]


def test_what_a_thermometer_means_is_known_the_next_day(unlike):
    rates = unlike.precomputed.forgetting
    innovations = slice(unlike.model.band.shared[0], sum(unlike.model.band.shared))
    known = known_error(np.ones(rates.size), np.eye(rates.size), np.full(2, np.nan))
    kept = mean_of(later(known, 16.0 * 3600.0, rates))
    assert np.all(kept[innovations] > 0.9)
    assert np.all(kept[-2:] < 0.05)


def test_readings_are_forgotten_alike_in_machine_code():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(5, 5))
    known = known_error(rng.normal(size=5), root @ root.T, np.full(2, np.nan))
    rates = np.array([1e-5, 2e-5, 3e-5, 4e-5, 5e-5])
    slowly = later(known, 600.0, rates)
    quickly = ModelError(*(part.copy() for part in known))
    forget(quickly, rates, 600.0)
    assert mean_of(quickly) == pytest.approx(mean_of(slowly), rel=1e-12)
    assert covariance_of(quickly) == pytest.approx(covariance_of(slowly), rel=1e-12)
    long = later(known, 1e9, rates)
    assert covariance_of(long) == pytest.approx(covariance_of(unknown(3, 2)), abs=1e-12)


def test_a_state_of_an_earlier_version_has_read_nothing_of_the_machines(undecided, warmed):
    _, states, _ = warmed
    parts = undecided.parts.parts
    begins = next(at.start for name, at, _ in parts if name == "model_error.shared_mean")
    whole = completed(states[100][:begins], undecided.initial_state())
    # How often the machine is sampled is known one sample later.
    assert unpacked(whole, undecided.parts).steps == 0.0
    assert whole[:-1] == pytest.approx(states[100][:-1], rel=1e-9, nan_ok=True)
    known = unpacked(whole, undecided.parts).model_error
    assert covariance_of(known) == pytest.approx(np.eye(5), rel=1e-9)


def test_the_command_asks_for_readings(undecided, stepped, tmp_path):
    model, log, out = tmp_path / "model.h5", tmp_path / "stepped.nc", tmp_path / "out.csv"
    write_observer(undecided.model, model)
    write_response(stepped, log)
    given = ["estimate", str(model), str(log), "--out", str(out), "--ask-above-um"]
    assert CliRunner().invoke(app, [*given, "2"]).exit_code == 0
    header, *rows = (line.split(",") for line in out.read_text().splitlines())
    assert header[-5:-2] == ["next_reading", "next_reading_in_min", "next_reading_narrows_um"]
    assert rows[-1][-5] in undecided.axes
    assert rows[-1][-4] == "0"
    refused = CliRunner().invoke(app, [*given, "0.5"])
    assert "make it larger" in str(refused.exception)
