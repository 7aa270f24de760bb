"""Variable projection finds what made the data, and says how well it is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from calibrate.fit_result import covariance, report
from calibrate.least_squares import (
    Separable,
    _jacobian,
    _project,
    fit,
    fit_linear,
    solve_linear,
)
from thermojoint.artefacts.errors import InputError

T = np.linspace(0.0, 100.0, 201)
RATES = np.array([0.3, 0.02])


def decays(theta):
    """Columns 1 - exp(-rate t), and their derivatives by ln(rate)."""
    phase = np.multiply.outer(T, theta)
    return -np.expm1(-phase), phase * np.exp(-phase)


def problem(data, **changes):
    made = Separable(
        basis=decays,
        data=data,
        names=("fast", "slow"),
        linear_names=tuple(f"{c}{j}" for c in "AB" for j in range(data.shape[1])),
        lower=(1e-3, 1e-3),
        upper=(10.0, 10.0),
        unit="K",
        column_of=(0, 1),
    )
    return replace(made, **changes)


def truth(amplitudes):
    return decays(RATES)[0] @ np.asarray(amplitudes, dtype=float)


def test_rates_and_amplitudes_of_several_right_hand_sides_are_recovered():
    amplitudes = [[2.0, -1.0, 0.5], [1.0, 3.0, 0.0]]
    found = fit(problem(truth(amplitudes)), starts=8)
    rates = np.array([found.values["fast"], found.values["slow"]])
    order = np.argsort(-rates)
    np.testing.assert_allclose(rates[order], RATES, rtol=1e-7)
    linear = np.array(list(found.values.values())[2:]).reshape(2, 3)
    np.testing.assert_allclose(linear[order], amplitudes, atol=1e-7)
    assert found.max_abs_error < 1e-8
    assert 1 <= found.starts_at_best <= found.starts == 8
    assert found.at_bound == ()


def test_the_same_seed_gives_the_same_fit_to_the_last_bit():
    data = truth([[2.0], [1.0]]) + 0.01 * np.sin(7.0 * T)[:, None]
    assert fit(problem(data), starts=4).values == fit(problem(data), starts=4).values


def test_every_evaluation_of_the_basis_is_counted_once():
    calls = []

    def counted(theta):
        calls.append(theta)
        return decays(theta)

    found = fit(problem(truth([[2.0], [1.0]]), basis=counted), starts=4)
    assert found.evaluations == len(calls) - 1  # the last one is for the report


@pytest.mark.parametrize("ridge", [0.0, 1e-6, 1e-2])
def test_the_jacobian_is_exact_far_from_the_solution(ridge):
    data = np.column_stack([np.sin(0.05 * T), np.cos(0.11 * T)])

    def residual(log_theta):
        return _project(decays(np.exp(log_theta))[0], data, ridge).residual.ravel()

    at = np.log([0.15, 0.04])
    columns, slopes = decays(np.exp(at))
    exact = _jacobian(_project(columns, data, ridge), columns, slopes, (0, 1)).reshape(-1, 2)
    expected = approx_fprime(at, residual, 1e-7)
    np.testing.assert_allclose(exact, expected, atol=1e-5 * np.abs(expected).max())


def test_standard_errors_predict_the_scatter_of_repeated_noisy_fits():
    rng = np.random.default_rng(5)
    found = []
    for _ in range(40):
        data = truth([[2.0], [1.0]]) + 0.01 * rng.standard_normal((T.size, 1))
        found.append(fit(problem(data), starts=0, guesses=[RATES]))
    for name in ("fast", "slow", "A0", "B0"):
        scatter = np.std([one.values[name] for one in found], ddof=1)
        predicted = np.mean([one.standard_errors[name] for one in found])
        assert predicted == pytest.approx(scatter, rel=0.35)


def test_ten_times_less_noise_gives_ten_times_smaller_standard_errors():
    noise = np.random.default_rng(1).standard_normal((T.size, 1))
    clean = truth([[2.0], [1.0]])
    loud = fit(problem(clean + 1e-2 * noise), starts=0, guesses=[RATES])
    quiet = fit(problem(clean + 1e-3 * noise), starts=0, guesses=[RATES])
    for name in loud.standard_errors:
        ratio = loud.standard_errors[name] / quiet.standard_errors[name]
        assert ratio == pytest.approx(10.0, rel=0.1)


def test_two_equal_columns_share_the_amplitude_instead_of_cancelling():
    columns = np.column_stack([T, T * (1.0 + 1e-13)])
    coefficients = solve_linear(columns, T[:, None], 1e-6)
    np.testing.assert_allclose(coefficients, 0.5, rtol=1e-3)


def test_nearly_equal_rates_do_not_get_huge_amplitudes_for_a_gain_below_the_noise():
    columns, _ = decays(np.array([0.05, 0.05 * (1.0 + 1e-7)]))
    # Data off by 1e-5 in the direction that only the difference of the two columns can follow.
    wrinkle = T * np.exp(-0.05 * T)
    data = (columns[:, 0] + 1e-5 * wrinkle / wrinkle.max())[:, None]
    plain = solve_linear(columns, data, 0.0)
    kept = solve_linear(columns, data, 1e-6)
    assert np.abs(plain).max() > 100.0
    assert np.abs(kept).max() < 1.0
    assert np.abs(columns @ kept - data).max() < 2e-5


def test_the_ridge_does_not_move_a_well_posed_solution():
    columns, _ = decays(RATES)
    coefficients = solve_linear(columns, truth([[2.0], [1.0]]), 1e-6)
    np.testing.assert_allclose(coefficients[:, 0], [2.0, 1.0], rtol=1e-9)


def test_parameters_at_a_bound_are_named():
    data = truth([[2.0], [1.0]])
    found = fit(problem(data, lower=(0.05, 0.05)), starts=8)
    assert found.at_bound
    assert min(found.values["fast"], found.values["slow"]) == pytest.approx(0.05, rel=1e-3)
    assert "at its bound" in report("bounded", found)


def test_parameters_that_the_data_cannot_tell_apart_are_named():
    # A run far shorter than the time constant shows amplitude times rate only.
    def ramp(theta):
        phase = 1e-5 * T * theta[0]
        return -np.expm1(-phase)[:, None], (phase * np.exp(-phase))[:, None]

    data = ramp(np.array([1.0]))[0] * 3.0 + 1e-6 * np.sin(T)[:, None]
    made = Separable(ramp, data, ("rate",), ("gain",), (0.1,), (10.0,), "K", (0,))
    found = fit(made, starts=2)
    assert [pair[:2] for pair in found.indistinct] == [("gain", "rate")]
    assert "cannot be told apart" in report("short run", found)


def test_what_the_data_do_not_see_at_all_has_no_standard_error():
    jacobian = np.column_stack([T, T, np.ones_like(T)])
    errors, _, condition = covariance(jacobian, 0.1 * np.cos(T))
    assert np.isinf(errors[:2]).all()
    assert np.isfinite(errors[2])
    assert condition == np.inf


def test_a_thinned_search_ends_at_the_optimum_of_all_samples():
    data = truth([[2.0], [1.0]]) + 0.02 * np.sin(0.3 * T)[:, None]
    full = problem(data)

    def thin(theta):
        columns, slopes = decays(theta)
        return columns[::7], slopes[::7]

    coarse = replace(full, basis=thin, data=data[::7])
    direct, thinned = fit(full, starts=8), fit(full, coarse=coarse, starts=8)
    assert thinned.rms_error == pytest.approx(direct.rms_error, rel=1e-6)


def test_amplitudes_alone_can_be_fitted_with_the_rates_given():
    found = fit_linear(problem(truth([[2.0], [1.0]])), RATES.tolist())
    assert found.values["A0"] == pytest.approx(2.0)
    assert set(found.standard_errors) == {"A0", "B0"}
    assert "fixed" in report("given rates", found)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"data": np.full((T.size, 1), np.nan)}, "finite"),
        ({"lower": (0.0, 1e-3)}, "bounds"),
        ({"upper": (1e-4, 1.0)}, "bounds"),
        ({"names": ("one",)}, "one name"),
    ],
)
def test_problems_that_cannot_be_fitted_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        fit(replace(problem(truth([[2.0], [1.0]])), **changes))


def test_a_search_without_a_start_is_refused():
    with pytest.raises(InputError, match="start"):
        fit(problem(truth([[2.0], [1.0]])), starts=0)


def test_terms_that_may_be_exchanged_come_in_an_order_that_no_rounding_decides():
    data = truth([[2.0], [1.0]])
    for guess in (RATES, RATES[::-1]):
        found = fit(problem(data, alike=((0, 1),)), starts=0, guesses=[guess.tolist()])
        assert found.values["fast"] == pytest.approx(RATES[0], rel=1e-6)
        assert found.values["A0"] == pytest.approx(2.0, rel=1e-6)
