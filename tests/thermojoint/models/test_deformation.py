"""Eqs. 8 and 18 start at zero, end at C + D, and are linear in their amplitudes."""

import numpy as np
import pytest
from closed_forms import deformation_transfer, initial_slope
from hypothesis import given
from hypothesis import strategies as st

from thermojoint.artefacts.errors import InputError
from thermojoint.models import deformation
from thermojoint.models.parameters import DeformationModel

RUN = np.arange(0.0, 2101.0, 2.0)
#: Table 1, x-direction, and Table 3, first column (Attia & Fraser), in µm.
TABLE_1_X = DeformationModel(0.1695, -1.255, -0.04785, 0.0089, 0.00129, 0.0097)
TABLE_3 = DeformationModel(0.767, 1.20, -0.0145, 0.00971, 0.00441, 0.00849, 0.0189, 0.0199)

rates = st.floats(1e-4, 0.3)
amplitudes = st.floats(-10.0, 10.0)
models = st.builds(
    DeformationModel, amplitudes, amplitudes, amplitudes, rates, rates, rates, amplitudes, rates
)


def coefficients(model):
    return [model.C, model.D, model.E, model.F]


@given(models)
def test_the_step_response_starts_at_zero_and_ends_at_C_plus_D(model):
    assert deformation.step_response(0.0, model) == 0.0
    ended = deformation.step_response(1e7, model)
    assert ended == pytest.approx(model.C + model.D, abs=1e-9)
    assert complex(deformation_transfer(0.0, model)).real == pytest.approx(model.C + model.D)


@given(models)
def test_the_initial_slope_is_the_high_frequency_limit(model):
    slope = initial_slope(model)
    step = deformation.step_response(1e-5, model) / 1e-5
    assert step == pytest.approx(slope, abs=1e-4)
    far = complex(deformation_transfer(1e8, model)) * 1e8
    assert far.real == pytest.approx(slope, abs=1e-5)


@given(models)
def test_the_basis_times_the_amplitudes_is_the_step_response(model):
    columns, _ = deformation.basis(RUN, [model.c, model.d, model.e, model.f])
    expected = deformation.step_response(RUN, model)
    scale = np.abs(expected).max() + 1.0
    np.testing.assert_allclose(columns @ coefficients(model), expected, atol=1e-12 * scale)


@pytest.mark.parametrize("model", [TABLE_1_X, TABLE_3])
@pytest.mark.parametrize("frequency", [1e-4, 1e-3, 1e-2])
def test_the_transfer_function_is_the_steady_answer_to_a_sine(model, frequency):
    # s times the Laplace transform of the step response, integrated numerically.
    s = 0.002 + 1j * frequency
    nodes, weights = np.polynomial.legendre.leggauss(60)
    edges = np.linspace(0.0, 20000.0, 400)
    t = (edges[:-1, None] + np.diff(edges)[:, None] * (nodes + 1) / 2).ravel()
    w = (np.diff(edges)[:, None] * weights / 2).ravel()
    transform = s * np.sum(w * np.exp(-s * t) * deformation.step_response(t, model))
    assert complex(deformation_transfer(s, model)) == pytest.approx(transform, rel=1e-9)


@pytest.mark.parametrize("rate", [(0.0089, 0.00129, 0.0097), (0.00971, 0.00441, 0.00849, 0.0199)])
def test_derivatives_by_the_logarithm_of_the_rates(rate):
    basis = deformation.basis
    _, slopes = basis(RUN, rate)
    for k in range(len(rate)):
        up, down = np.array(rate), np.array(rate)
        up[k] *= np.exp(1e-5)
        down[k] *= np.exp(-1e-5)
        expected = (basis(RUN, up)[0] - basis(RUN, down)[0]) / 2e-5
        of_its_own = np.zeros_like(expected)
        of_its_own[:, k] = slopes[:, k]
        np.testing.assert_allclose(of_its_own, expected, atol=1e-8 * np.abs(expected).max())


def test_equation_8_as_printed_does_not_start_flat():
    # The text says dδ/dt = 0 at t = 0; the printed parameters of Table 1 do not give that.
    assert abs(initial_slope(TABLE_1_X)) > 0.9 * abs(TABLE_1_X.E)


@pytest.mark.parametrize("bad", [(0.1, 0.2), (0.1, 0.2, -0.3), (0.1, 0.2, np.nan, 0.4)])
def test_rates_that_make_no_model_are_refused(bad):
    with pytest.raises(InputError, match="deformation model"):
        deformation.basis(RUN, bad)
