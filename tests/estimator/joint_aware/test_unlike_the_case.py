"""Machines that differ from their case by more than factors: sensors that lag, unknown errors."""

from dataclasses import replace

import numpy as np
import pytest
from observed import SENSORS

from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.misfit import Run, physics_with
from calibrate.joint_aware.open_band import surprise_of
from calibrate.joint_aware.physics_fit import Search, fit_physics
from estimator.interface import Status, follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.filter_design import Noise
from estimator.joint_aware.observer_model import Calibrated
from thermojoint.reduced.machine import NEAR
from thermojoint.reduced.parameters import lag_name
from thermojoint.reduced.physics import simulate_known

STEP, COUNT = 2.0, 150


def marched(machine, factors, level=2.0):
    """Temperatures (n, p) and displacements of a step of heat."""
    inputs = np.zeros((COUNT, 2))
    inputs[:, 0] = level * machine.power[0]
    return inputs, *simulate_known(physics_with(machine, factors), inputs, STEP)


def follows(values, lag):
    """What a sensor reads that follows its place, from rest, by implicit steps."""
    read, now = [], 0.0
    for value in values:
        now += STEP / (lag + STEP) * (value - now)
        read.append(now)
    return np.array(read)


@pytest.mark.parametrize(
    "lag",
    [pytest.param(3.0, marks=pytest.mark.long), 20.0, pytest.param(60.0, marks=pytest.mark.long)],
)
def test_a_sensor_that_lags_follows_its_place(machine, lag):
    _, still, moved = marched(machine, {})
    _, read, same = marched(machine, {lag_name("s"): lag})
    assert read[:, 0] == pytest.approx(follows(still[:, 0], lag), abs=1e-9)
    assert read[:, 1:] == pytest.approx(still[:, 1:], abs=1e-12)
    assert same == pytest.approx(moved, abs=1e-15)


@pytest.mark.parametrize("which", [0, 10, 30])
@pytest.mark.parametrize("beside", [0.0, 1e-9, -1e-6])
def test_a_lag_as_slow_as_a_mode_is_none_the_worse(machine, which, beside):
    """The limit of equal rates is approached, not divided by."""
    rates = physics_with(machine, {}).modes.rates
    lag = (1.0 + beside) / np.sort(rates)[which + rates.size // 2]
    _, still, _ = marched(machine, {})
    _, read, _ = marched(machine, {lag_name("s"): lag})
    assert read[:, 0] == pytest.approx(follows(still[:, 0], lag), rel=10.0 * NEAR, abs=0)


def runs_of(machine, factors, stretched=1.0):
    runs = []
    for level in (0.5, 2.0):
        inputs, sensed, moved = marched(machine, factors, level)
        times = STEP * np.arange(1.0, COUNT + 1.0)
        # What is stretched is not proportional to the heat.
        moved = moved[:, :2] * (stretched if level > 1.0 else 1.0)
        runs.append(Run(inputs, times, sensed, moved, STEP))
    return runs


def test_a_calibration_finds_lags_and_takes_no_sensor_for_slow_that_is_not(small):
    fitted = ["heat", *map(lag_name, SENSORS)]
    fit = fit_physics(small, runs_of(small, {lag_name("s"): 20.0}), fitted, Search(starts=0))
    found = dict(zip(fitted, fit.coordinates, strict=True))
    assert found.pop(lag_name("s")) == pytest.approx(20.0, rel=0.15)
    assert found["heat"] == pytest.approx(0.0, abs=0.02)
    assert all(found[lag_name(sensor)] == 0.0 for sensor in SENSORS[1:])


def test_errors_that_no_parameter_explains_leave_more_unknown(small):
    """A machine of the family is fitted as ever; one beyond it has a wider posterior."""
    own, other = (
        fit_physics(small, runs_of(small, {"heat": 1.05}, stretched), ["heat"], Search(starts=0))
        for stretched in (1.0, 1.3)
    )
    assert own.doubt == 1.0
    assert other.doubt > 1.5
    known = np.linalg.norm(other.jacobian) * other.doubt
    assert known == pytest.approx(np.linalg.norm(own.jacobian), rel=0.2)
    assert other.covariance[0, 0] > own.covariance[0, 0]


def test_few_readings_of_a_displacement_from_a_warm_machine_on_tell_its_expansion(small):
    """Both axes are read in turn; each reading is relative to the first one of its axis."""

    def probed(run):
        moved = np.full_like(run.displacement, np.nan)
        for axis, rows in enumerate([slice(20, None, 10), slice(21, None, 10)]):
            read = run.displacement[rows, axis]
            moved[rows, axis] = read - read[0]
        return replace(run, displacement=moved, zeroed=True)

    runs = runs_of(small, {"expansion": 1.03})
    every, few = (
        fit_physics(small, each, ["expansion"], Search(starts=0))
        for each in (runs, [probed(run) for run in runs])
    )
    assert few.coordinates == pytest.approx(every.coordinates, abs=0.2 * few.spread[0])
    assert few.doubt == 1.0


def test_noisy_sensors_do_not_make_a_machine_unlike_its_case(small):
    """Their noise leaves several times what is assumed of errors that last for a run."""
    rng = np.random.default_rng(1)
    runs = [
        replace(run, temperature=run.temperature + rng.normal(0.0, 0.06, run.temperature.shape))
        for run in runs_of(small, {"heat": 1.05})
    ]
    fit = fit_physics(small, runs, ["heat"], Search(starts=0))
    assert fit.doubt == 1.0
    assert fit.residuals @ fit.residuals > 2.0 * len(runs) * (len(SENSORS) + 2)


def test_a_step_of_heat_is_no_fault_of_a_sensor_that_lags(small):
    """The heat is found over many steps, in which the reading departs from its prediction."""
    factors = {lag_name("s"): 60.0}
    fit = fit_physics(small, runs_of(small, factors), [lag_name("s")], Search(starts=0))
    known = Calibrated(300.0, 2.0, dict.fromkeys(SENSORS, (0.0, 60.0)))
    model = make_observer(small, fit, known, Noise(sensor=0.2))
    observer = JointAware(model)
    onset, answer = observer.observer.step_response[:, 0, 0], observer.observer.dominant_response[0]
    assert observer.observer.peak_innovation[0, 0] > 2.0 * onset[0]
    # Where it is noticed, most of the sensor's own delay is over: it grows by less from there.
    assert answer[0] in onset
    assert answer[6] / answer[0] < 0.5 * onset[6] / onset[0]
    _, sensed, moved = marched(small, factors, 2.9)
    times = STEP * np.arange(1.0, COUNT + 1.0)
    samples = np.column_stack([times, sensed, np.zeros(COUNT)])
    first = np.zeros((1, samples.shape[1]))
    found = [one for _, one in follow(observer, [*first, *samples], observer.initial_state())][1:]
    assert not any(one.status & Status.SENSOR_DISTRUSTED for one in found)
    errors = np.array([one.displacement for one in found]) - moved[:, :2]
    assert np.abs(errors[-1]).max() < 0.05 * np.abs(moved[-1]).max()


def test_sensors_that_contradict_the_model_for_hours_widen_the_band(estimator, machine, small):
    """A machine with another film: its temperatures stay away from the model's."""
    inputs = np.zeros((3600, 2))
    inputs[:, 0] = machine.power[0]
    times = STEP * np.arange(1, 3601)
    marched = [simulate_known(physics_with(small, {"film": film}), inputs, STEP) for film in (1, 5)]
    known = Run(inputs, times, *marched[0], STEP)
    assert not surprise_of([known], doubt=1.0).any()
    band = replace(estimator.model.band, surprise=surprise_of([known], doubt=2.0))
    wide = JointAware(replace(estimator.model, band=band))
    ends = []
    for sensed, moved in marched:
        # A reading every twenty seconds.
        samples = np.column_stack([times, sensed, inputs[:, -1]])[9::10].tolist()
        for one in (estimator, wide):
            found = [estimate for _, estimate in follow(one, samples, one.initial_state())]
            off = np.abs(found[-1].displacement - moved[-1])
            ends.append((off, found[-1].band, found[45].band))
    (_, own, _), (_, same, _), (off, narrow, _), (_, wider, before) = ends
    assert same == pytest.approx(own, rel=1e-3)
    # In standard deviations, where the half-band is two of them.
    assert (off > 3.0 * narrow).any()
    assert (off < 2.0 * wider).all()
    assert (before < 0.2 * wider).all()
