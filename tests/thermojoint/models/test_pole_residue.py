"""Exponential states advance exactly; the rational approximation of Eq. 3 is stable and close."""

from __future__ import annotations

import numpy as np
import pytest
from closed_forms import deformation_transfer, steady_value
from hypothesis import given, settings
from hypothesis import strategies as st

from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.models import deformation, ring_source
from thermojoint.models.assembly import deformation_bank
from thermojoint.models.filters.bank import (
    Bank,
    over_interval,
    respond_to_line,
    respond_to_steps,
    simple_bank,
)
from thermojoint.models.filters.phi import phi_functions
from thermojoint.models.filters.pole_residue import (
    direct_bank,
    excited_band,
    fit_proper,
    fit_strictly_proper,
)
from thermojoint.models.parameters import DeformationModel, RingModel

TABLE_1 = RingModel(K=3.372, a=3.20, alpha=0.000212, r=0.19, r0=0.12)
EQ_18 = DeformationModel(0.767e-6, 1.2e-6, -1.45e-8, 0.00971, 0.00441, 0.00849, F=1.89e-8, f=0.0199)


@pytest.mark.parametrize("z", [-1e-9, -0.3, -1.999, -2.001, -40.0, -0.5 + 1.8j, -1.0 + 5.0j])
def test_phi_functions_are_the_weighted_integrals_of_the_exponential(z):
    nodes, weights = np.polynomial.legendre.leggauss(60)
    tau, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    factorial = [1.0, 1.0, 2.0, 6.0]
    values = phi_functions(np.array([z], dtype=complex))
    assert values[0][0] == pytest.approx(np.exp(z), rel=1e-14, abs=0.0)
    for k in range(1, 5):
        integral = np.sum(weights * np.exp(z * (1 - tau)) * tau ** (k - 1)) / factorial[k - 1]
        assert values[k][0] == pytest.approx(integral, rel=2e-13, abs=0.0)


@given(st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=12), st.floats(1e-5, 10.0))
def test_a_pole_follows_a_ramp_exactly_over_any_intervals(gaps, rate):
    times = np.cumsum(gaps)
    _, ends = respond_to_line(
        simple_bank(np.array([-rate]), np.array([1.0])), times, times[:, None], times[0]
    )
    exact = times / rate + np.expm1(-rate * times) / rate**2
    # Near the start the closed form above cancels; that is its error, not the recursion's.
    assert ends[:, 0] == pytest.approx(exact, rel=1e-9, abs=1e-14 / rate**2)


def test_a_complex_pair_rings_as_the_damped_cosine_it_stands_for():
    pole = -0.02 + 0.3j
    times = np.cumsum([0.5, 1.0, 7.0, 0.1, 20.0])
    ends = respond_to_steps(
        simple_bank(np.array([pole]), np.array([2.0])), times, np.ones((5, 1)), times[0]
    )
    exact = 2.0 * ((np.exp(pole * times) - 1.0) / pole).real
    assert ends[:, 0] == pytest.approx(exact, abs=1e-13 * np.abs(exact).max())


@pytest.mark.parametrize("pole", [-0.02, -0.02 + 0.3j, -1e-6])
def test_the_mean_over_an_interval_is_the_mean_of_many_shorter_ones(pole):
    bank = Bank(
        np.array([pole], dtype=complex),
        np.ones((1, 1)),
        np.array([[1.5]], dtype=complex),
        np.array([[0.7]], dtype=complex),
        np.array([[0.2]]),
        np.array([[3.0]]),
    )
    coarse, values = np.array([1.0, 4.0, 9.0]), np.array([0.5, -1.0, 2.0])
    fine = np.linspace(0.0, 9.0, 901)[1:]
    along = np.interp(fine, np.append(0.0, coarse), np.append(0.0, values))
    means, ends = respond_to_line(bank, coarse, values[:, None], 1.0)
    fine_means, fine_ends = respond_to_line(bank, fine, along[:, None], 0.01)
    for n, (start, end) in enumerate([(0, 100), (100, 400), (400, 900)]):
        assert means[n, 0] == pytest.approx(fine_means[start:end].mean(), rel=1e-11, abs=0.0)
        assert ends[n, 0] == pytest.approx(fine_ends[end - 1, 0], rel=1e-11)


def test_eqs_8_and_18_come_back_as_step_responses_of_their_banks():
    times = np.cumsum(np.tile([2.0, 0.5, 30.0, 1.0], 40))
    steps = respond_to_steps(deformation_bank(EQ_18), times, np.ones((160, 1)), times[0])[:, 0]
    exact = deformation.step_response(times, EQ_18)
    assert steps == pytest.approx(exact, abs=1e-13 * np.abs(exact).max())
    s = 1j * np.geomspace(1e-6, 10.0, 30)
    closed = deformation_transfer(s, EQ_18)
    assert deformation_bank(EQ_18).transfer(s)[:, 0, 0] == pytest.approx(
        closed, abs=1e-12 * np.abs(closed).max()
    )


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.5, 30.0), st.floats(5e-5, 5e-4), st.floats(0.02, 0.5), st.sampled_from([0.05, 0.12])
)
def test_poles_give_the_closed_form_step_response(a, alpha, distance, r0):
    ring = RingModel(K=2.0, a=a, alpha=alpha, r=distance, r0=r0)
    bank = direct_bank(ring, 2.0, 2100.0, 1e-7, "T1")
    assert (bank.poles.real < 0.0).all()
    times = np.arange(2.0, 2101.0, 2.0)
    steps = respond_to_steps(bank, times, np.ones((times.size, 1)), 2.0)[:, 0]
    exact = ring_source.step_response(times, ring.K, ring.a, ring.alpha, ring.r, ring.r0)
    steady = steady_value(ring.K, ring.a, ring.r, ring.r0)
    assert np.abs(steps - exact).max() < 1e-6 * steady


def test_the_error_that_was_reached_is_kept_and_true_between_the_samples():
    band = excited_band(2.0, 2100.0)

    def transfer(s):
        return ring_source.transfer_function(
            s, TABLE_1.K, TABLE_1.a, TABLE_1.alpha, TABLE_1.r, TABLE_1.r0
        )[:, None, None]

    fit = fit_strictly_proper(transfer, band, 1e-6, "T1")
    assert fit.error <= 1e-6
    s = 1j * np.geomspace(*band, 3001)
    pole = fit.poles[:, None]
    value = 0.5 * (
        fit.weights[:, 0] / (s - pole) + fit.weights[:, 0].conj() / (s - pole.conj())
    ).sum(axis=0)
    exact = transfer(s)[:, 0, 0]
    assert np.abs(value - exact).max() < 1.5 * fit.error * np.abs(exact).max() + 1e-9


def test_a_tolerance_out_of_reach_gives_the_best_fit_and_its_error():
    band = excited_band(2.0, 28800.0)
    fit = fit_strictly_proper(lambda s: (1.0 / (0.01 + s))[:, None, None], band, 1e-20, "T2")
    assert 1e-20 < fit.error < 1e-9


def test_a_transfer_function_that_poles_do_not_describe_is_refused():
    band = excited_band(2.0, 2100.0)
    with pytest.raises(ConvergenceError, match=r"delay: 56 poles reach a relative error of"):
        fit_proper(lambda s: np.exp(-1e3 * s)[:, None, None], band, 1e-6, "delay")


def test_a_pole_that_is_not_stable_is_refused():
    with pytest.raises(InputError, match="not stable"):
        simple_bank(np.array([-0.1, 0.0]), np.array([1.0, 1.0]))
    with pytest.raises(InputError, match="rate must be positive"):
        deformation_bank(DeformationModel(1e-6, 1e-6, 0.0, 0.01, -0.01, 0.02))


@pytest.mark.parametrize("band", [(0.0, 100.0), (2.0, 1.0), (float("nan"), 5.0), (1e-9, 7200.0)])
def test_a_run_without_samples_or_with_too_many_is_refused(band):
    with pytest.raises(InputError, match="do not make a run"):
        excited_band(*band)


def test_a_transfer_function_that_is_zero_is_refused():
    with pytest.raises(InputError, match="zero or not finite"):
        fit_strictly_proper(lambda s: np.zeros((s.size, 1, 1)), (1e-4, 1.0), 1e-6, "T1")


def test_far_down_the_left_half_plane_nothing_overflows():
    over = over_interval(simple_bank(np.array([-50.0]), np.array([50.0])), 1e5)
    assert abs(over.advance[0, 0]) < 1e-300
    assert over.end[0, 0] * (over.old + over.new)[0, 0] == pytest.approx(1.0)
