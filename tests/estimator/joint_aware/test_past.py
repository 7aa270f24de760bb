"""Pasts of a machine on which an estimator starts, and the start that they lead to."""

from dataclasses import replace

import numpy as np
import pytest
from observed import SENSORS, errors, estimates, run, step

from calibrate.joint_aware.past import Duty, Pasts, random_pasts, states_after
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.observer_state import UNKNOWN
from estimator.joint_aware.readings import samples_in

SHORT = Duty(pasts=40, step=60.0, begun=(1200.0, 14400.0))


def constant(level, hours, step=120.0):
    count = round(3600.0 * hours / step)
    return Pasts(step, np.full((count, 1, 1), level), np.zeros((count, 1)))


def after(estimator, pasts):
    model = estimator.model
    given = model.discrepancy.rates, model.power, model.filter.walk
    return states_after(model.modes, *given, pasts)


def test_after_a_past_of_constant_heat_the_machine_is_as_the_observer_marches_it(estimator):
    model, system = estimator.model, estimator.observer.system
    state = np.zeros(system.size)
    state[system.decay.size] = 2.0 * model.power[0]
    for _ in range(1800):
        state = system.advance(state[:, None])[:, 0]
    found = after(estimator, constant(2.0, 1800 * model.step / 3600.0))[:, 0]
    moved, expected = model.band.tangent @ found, model.band.tangent @ state
    # The observer's steps are implicit.
    assert moved == pytest.approx(expected, rel=2e-3)


def test_states_are_linear_in_what_the_past_was(estimator):
    one, two = (after(estimator, constant(level, 2.0)) for level in (1.0, 2.0))
    assert two == pytest.approx(2.0 * one, rel=1e-12)


def test_drawn_pasts_hold_the_largest_heat_and_an_ambient_as_wide_as_said():
    pasts = random_pasts(2.0, 2, SHORT)
    assert pasts.heat.shape == (240, 40, 2)
    assert pasts.heat.min() == 0.0
    assert 1.0 < pasts.heat.max() <= 2.0
    assert not np.allclose(pasts.heat[..., 0], pasts.heat[..., 1])
    assert np.sqrt(np.mean(pasts.ambient**2)) == pytest.approx(3.0, rel=0.3)


def test_a_start_on_a_machine_of_known_work_is_nearer_than_one_of_any_work(data, setup, estimator):
    """Its own past among the pasts that it may have had: the first estimate is within a few um."""
    response = run(data, setup, step(1.5), 40.0)
    late = response.isel(time=response["time"].to_numpy() >= 1800.0)
    model = estimator.model
    own = after(estimator, constant(1.5, 0.5, 60.0))
    informed = JointAware(replace(model, warm=np.hstack([own, 0.0 * model.warm[:, 1:]])))
    first = [
        np.abs(errors(one, late, estimates(one, samples_in(late, SENSORS), one.warm_state())[1]))[5]
        for one in (estimator, informed)
    ]
    assert np.linalg.norm(first[1]) < 0.5 * np.linalg.norm(first[0])


def test_a_start_holds_within_its_band_and_narrows(data, setup, estimator):
    response = run(data, setup, step(1.5), 40.0)
    late = response.isel(time=response["time"].to_numpy() >= 1200.0)
    _, found = estimates(estimator, samples_in(late, SENSORS), estimator.warm_state())
    band = np.array([one.band for one in found])
    assert np.all(np.abs(errors(estimator, late, found)) <= band)
    assert np.all(band[-1] < 0.5 * band[0])


def test_a_reading_that_the_model_follows_badly_errs_by_an_unknown_of_the_filter(estimator):
    """The textbook's gain and covariance for it, from the covariance that it begins with."""
    steady = estimator.model.filter
    ill = steady.lasting.copy()
    ill[SENSORS.index("T2")] *= 50.0
    own = replace(steady, lasting=ill)
    observer = replace(estimator.observer, model=replace(estimator.model, filter=own))
    start, size = observer.unknown_start, observer.system.size
    every = np.arange(len(observer.rows))
    gain, after = observer.gain(every, start, estimator.model.step, UNKNOWN)
    seen, errors = observer.rows @ start, start[size:]
    assert np.flatnonzero(errors.any(axis=1)).tolist() == [SENSORS.index("T2")]
    doubted = own.noise + estimator.thresholds.doubt_of_past**2 * own.lasting
    expected = errors @ seen.T @ np.linalg.inv(own.innovation + np.diag(doubted) + seen @ seen.T)
    assert gain[size:] == pytest.approx(expected, rel=1e-8, abs=1e-12)
    left = errors @ errors.T - expected @ seen @ errors.T
    assert after[size:] @ after[size:].T == pytest.approx(left, rel=1e-8, abs=1e-10)
