"""Eq. 18 driven by strengths that vary: superposition, recovery, and errors that count."""

import numpy as np
import pytest

from calibrate.driven_deformation import (
    UNCERTAIN,
    driver,
    fit_driven_deformation,
    uncertain_signals,
)
from thermojoint.artefacts.errors import InputError
from thermojoint.models import deformation
from thermojoint.models.parameters import DeformationModel

INTERVAL = 4.0
TIMES = INTERVAL * np.arange(1, 251)
MODEL = DeformationModel(2e-6, -5e-6, 3e-8, 0.02, 0.002, 0.01, -1e-8, 0.03)


def step_response(t):
    return deformation.step_response(t, MODEL)


def driven_by(strength):
    """What the model's source does when its strength follows `strength`."""
    [[column]] = driver(strength[None])(step_response(TIMES)[:, None]).transpose(0, 2, 1)
    return column


def test_a_constant_strength_gives_the_step_response():
    driven = driven_by(np.full(TIMES.size, 3.0))
    assert driven == pytest.approx(3.0 * step_response(TIMES), abs=1e-18)


def test_a_strength_holds_over_the_interval_that_ends_at_its_sample():
    strength = np.zeros(TIMES.size)
    strength[3] = 2.0
    held = driven_by(strength)
    on, off = (np.maximum(TIMES - INTERVAL * k, 0.0) for k in (3, 4))
    assert held == pytest.approx(2.0 * (step_response(on) - step_response(off)), abs=1e-18)


def test_several_strengths_drive_several_shapes():
    strengths = np.stack([np.ones(TIMES.size), np.sin(TIMES / 150.0)])
    shapes = np.stack([step_response(TIMES), TIMES], axis=1)
    together = driver(strengths)(shapes)
    assert together.shape == (2, TIMES.size, 2)
    assert together[1, :, 0] == pytest.approx(driven_by(strengths[1]), abs=1e-18)
    assert together[0, :, 1] == pytest.approx(TIMES)


def test_a_strength_that_changes_is_the_sum_of_its_steps():
    strength = np.where(TIMES > 400.0, -1.5, 0.5)
    late = np.maximum(TIMES - 400.0, 0.0)
    expected = 0.5 * step_response(TIMES) - 2.0 * step_response(late)
    assert driven_by(strength) == pytest.approx(expected, abs=1e-18)


def test_the_displacement_of_a_known_model_is_recovered_from_varying_strengths():
    strengths = np.stack([1.0 - np.exp(-TIMES / 200.0), np.sin(TIMES / 150.0)])[None]
    data = np.stack([driven_by(s) for s in strengths[0]])
    models, fit = fit_driven_deformation(TIMES, data, strengths, ridge=1e-6)
    assert fit.max_abs_error < 1e-9
    fitted = deformation.step_response(TIMES, models[0])
    assert fitted == pytest.approx(step_response(TIMES), abs=2e-8)


def test_runs_of_mere_error_shrink_the_response():
    # Steps, so that the strength tells the displacement exactly; and errors far larger than it.
    steps = np.ones((1, 1, TIMES.size))
    error = np.random.default_rng(1).standard_normal((1, 4, TIMES.size)).cumsum(axis=2)
    data = step_response(TIMES)[None]
    nothing = np.zeros((4, TIMES.size))
    trusting, _ = fit_driven_deformation(TIMES, data, steps)
    wary, _ = fit_driven_deformation(
        TIMES, np.concatenate([data, nothing]), np.concatenate([steps, error], axis=1)
    )
    size = [np.abs(deformation.step_response(TIMES, m[0])).max() for m in (trusting, wary)]
    assert size[1] < 0.8 * size[0]


def test_uncertain_signals_have_the_asked_size_and_their_own_memory():
    times = 20.0 * np.arange(106)
    signals = uncertain_signals(times, 0.12, 500, seed=5)
    assert len(signals) == len(UNCERTAIN)
    for signal, share in zip(signals, UNCERTAIN, strict=True):
        memory = share * times[-1]
        assert signal.shape == (times.size, 500)
        assert np.sqrt((signal**2).mean()) == pytest.approx(0.12, rel=0.25)
        lag = round(memory / 20.0)
        correlation = (signal[lag:] * signal[:-lag]).mean() / (signal**2).mean()
        assert correlation == pytest.approx(np.exp(-1.0), abs=0.2)


def test_the_same_seed_gives_the_same_signals():
    first, again, other = (uncertain_signals(TIMES, 0.1, 2, seed) for seed in (3, 3, 4))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])


def test_uneven_times_and_wrong_shapes_are_refused():
    strengths = np.ones((1, 1, TIMES.size))
    uneven = TIMES.copy()
    uneven[-1] += 1.0
    with pytest.raises(InputError, match="evenly"):
        fit_driven_deformation(uneven, np.zeros((1, TIMES.size)), strengths)
    with pytest.raises(InputError, match="one value per input and time"):
        fit_driven_deformation(TIMES, np.zeros((2, TIMES.size)), strengths)
