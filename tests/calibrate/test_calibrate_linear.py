"""Table 1: the linear models come back from responses they made, and fit one they did not."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from closed_forms import regularisation_function, steady_value
from hypothesis import given, settings
from hypothesis import strategies as st

from calibrate.linear import (
    calibrate_displacements,
    calibrate_heat,
    fit_deformation,
    fit_relaxation,
    relaxation_response,
    with_direct_models,
)
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import make_response
from thermojoint.models import deformation, ring_source
from thermojoint.models.parameters import DeformationModel, Regularisation, RingModel
from thermojoint.models.regularisation import (
    cancellation,
    choose_regularisation,
    right_half_plane_zeros,
    steepest_rise,
    transfer_contribution,
)

RUN = np.arange(1051) * 2.0
#: Table 1 (Attia & Fraser); displacements in m.
THERMAL = RingModel(K=3.372, a=3.20, alpha=0.000212, r=0.19, r0=0.12)
SHAPES = {
    "x": DeformationModel(0.1695e-6, -1.255e-6, -0.04785e-6, 0.0089, 0.00129, 0.0097),
    "y": DeformationModel(3.845e-6, 2.355e-6, -0.0354e-6, 0.00123, 0.00142, 0.0338),
}


def rod(x, length=0.5, diffusivity=1.4e-5, loss=4e-5, modes=300):
    """Step response of a rod heated at x = 0 that loses heat: a series, no model of ours."""
    k = np.arange(modes) * np.pi / length
    rate = diffusivity * k**2 + loss
    share = np.where(k == 0.0, 1.0, 2.0) * np.cos(k * x) / rate
    return -np.expm1(-np.multiply.outer(RUN, rate)) @ share


def response(temperatures, displacements, heat=None):
    return make_response(
        {
            "heat_input": np.ones(RUN.size) if heat is None else heat,
            "temperature": np.stack([temperatures[p] for p in ("a", "b", "T1", "T2")], axis=1),
            "displacement": np.stack([displacements["x"], displacements["y"]], axis=1),
        },
        {"time": RUN, "probe": ["a", "b", "T1", "T2"], "axis": ["x", "y"]},
    )


def made_by_the_models(level=1.0, heat=None):
    b = 5e-4 * rod(0.1)
    temperatures = {
        "a": b + ring_source.step_response(RUN, **asdict(THERMAL)),
        "b": b,
        "T1": 5e-4 * rod(0.1),
        "T2": 5e-4 * rod(0.25),
    }
    shapes = {axis: deformation.step_response(RUN, model) for axis, model in SHAPES.items()}
    return response(
        {name: level * value for name, value in temperatures.items()},
        {name: level * value for name, value in shapes.items()},
        np.full(RUN.size, level) if heat is None else heat,
    )


def calibrate_linear(measured):
    return with_direct_models(calibrate_heat(measured, calibrate_displacements(measured)), measured)


@pytest.fixture(scope="module")
def table_1():
    return calibrate_linear(made_by_the_models())


def test_the_thermal_parameters_of_table_1_are_recovered(table_1):
    found = table_1.model.thermal
    for name, value in asdict(THERMAL).items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-7)
    assert table_1.fits["thermal"].max_abs_error < 1e-9


@pytest.mark.parametrize("axis", ["x", "y"])
def test_the_displacement_of_table_1_is_reproduced_far_below_a_tenth_of_a_micrometre(table_1, axis):
    model = table_1.model.deformation[axis]
    expected = deformation.step_response(RUN, SHAPES[axis])
    error = np.abs(deformation.step_response(RUN, model) - expected).max()
    assert error < 1e-10
    assert error == pytest.approx(table_1.fits[f"deformation.{axis}"].max_abs_error, abs=1e-15)


def test_well_separated_rates_of_equation_8_are_recovered():
    made = DeformationModel(60e-6, -140e-6, 0.2e-6, 0.012, 0.0011, 0.004)
    found, _ = fit_deformation(RUN, deformation.step_response(RUN, made))
    for name in ("C", "D", "c", "d"):
        # The two exponentials may come in either order.
        values = {getattr(found, name), getattr(found, "DCdc"["CDcd".index(name)])}
        assert min(abs(v / getattr(made, name) - 1.0) for v in values) < 1e-4
    assert found.e == pytest.approx(made.e, rel=1e-4)
    assert pytest.approx(made.E, rel=1e-4) == found.E


def test_minutes_and_hours_together_take_the_four_rates_of_equation_18():
    times = np.geomspace(2.0, 28_800.0, 400)
    made = DeformationModel(40e-6, -90e-6, 0.03e-6, 0.02, 0.002, 0.0002, 0.04e-6, 0.005)
    data = deformation.step_response(times, made)
    model, found = fit_deformation(times, data)
    assert model.F != 0.0
    assert found.max_abs_error < 1e-3 * np.abs(data).max()


def test_a_rod_that_is_no_model_of_ours_is_fitted_with_amplitudes_of_its_own_size():
    data = 80e-6 * rod(0.2) / rod(0.2)[-1]
    model, found = fit_deformation(RUN, data)
    # Rates that the run can bear cost accuracy: 0.02 µm without bounds.
    assert found.max_abs_error < 0.3e-6
    columns, _ = deformation.basis(RUN, [model.c, model.d, model.e])
    terms = columns * [model.C, model.D, model.E]
    assert np.abs(terms).max() < 10 * np.abs(data).max()


@pytest.mark.parametrize("x", [0.1, 0.25, 0.4])
def test_the_relaxation_spectrum_follows_a_distant_sensor_within_a_millikelvin(x):
    data = 5e-4 * rod(x)
    model = fit_relaxation(RUN, data)
    error = np.abs(relaxation_response(RUN, model) - data).max()
    assert error < 1e-4
    terms = np.array(model.amplitudes) * -np.expm1(-np.array(model.rates) * RUN[-1])
    assert np.abs(terms).max() < 10 * np.abs(data).max()
    # Also between the samples that it was fitted to.
    half = fit_relaxation(RUN[::2], data[::2])
    assert np.abs(relaxation_response(RUN, half) - data).max() < 1e-3


def test_the_direct_models_are_the_spectra_and_equation_2_is_reported_beside_them(table_1):
    for sensor in ("T1", "T2"):
        assert table_1.direct_errors[sensor] < 1e-4
        assert table_1.fits[f"direct.{sensor}"].max_abs_error > table_1.direct_errors[sensor]


def test_the_level_of_the_step_and_heat_at_time_zero_do_not_matter(table_1):
    heat = np.full(RUN.size, 2.0)
    heat[0] = 0.0
    twice = calibrate_linear(made_by_the_models(2.0, heat))
    assert pytest.approx(table_1.model.thermal.K, rel=1e-7) == twice.model.thermal.K
    assert twice.model.direct["T1"].amplitudes == pytest.approx(
        table_1.model.direct["T1"].amplitudes, rel=1e-6, abs=1e-9
    )


def test_a_response_that_is_no_step_is_refused():
    heat = np.ones(RUN.size)
    heat[500:] = 1.2
    with pytest.raises(InputError, match="needs a step") as caught:
        calibrate_linear(made_by_the_models(heat=heat))
    assert str(caught.value).startswith("reference response: ")
    assert "\n" not in str(caught.value)


def test_a_missing_probe_is_named_with_the_nearest_one():
    wrong = made_by_the_models().assign_coords(probe=["a", "b", "T1", "T22"])
    with pytest.raises(InputError, match=r"no probe named 'T2'; did you mean 'T22'"):
        calibrate_linear(wrong)


# The regularisation rule


def test_a_regularisation_function_is_the_inverse_of_its_transfer_contribution():
    made = Regularisation(A=0.02, B=3e-4, gamma=0.1)
    t = np.linspace(0.0, 600.0, 200001)
    s = 0.03 + 0.05j
    integrand = np.exp(-s * t) * regularisation_function(t, made)
    expected = s * np.trapezoid(integrand, t)
    assert complex(transfer_contribution(s, made)) == pytest.approx(expected, rel=1e-6)


@given(
    st.floats(-5.0, 5.0).filter(lambda k: abs(k) > 1e-3),
    st.floats(1e-2, 100.0),
    st.floats(1e-6, 1e-3),
    st.floats(0.0, 0.6),
)
@settings(max_examples=40, deadline=None)
def test_the_rule_leaves_a_stable_inverse_that_neither_steps_nor_ramps_bias(K, a, alpha, r):
    ring = RingModel(K, a, alpha, r, 0.12)
    chosen = choose_regularisation(ring, 2.0)
    assert np.sign(chosen.A) == np.sign(K)
    assert right_half_plane_zeros(ring, chosen) == 0
    assert cancellation(ring, chosen) >= 0.5
    slow = 1e-6 * min(chosen.gamma, a * alpha)
    share = transfer_contribution(slow, chosen) / ring_source.transfer_function(
        slow, **asdict(ring)
    )
    # Second order in s: what is added for a ramp is lost against what is there.
    assert abs(share) < 1e-8


def test_the_largest_slope_is_found():
    time, slope = steepest_rise(THERMAL)
    t = np.linspace(1.0, 100.0, 100001)
    slopes = ring_source.impulse_response(t, **asdict(THERMAL))
    assert slope == pytest.approx(slopes.max(), rel=1e-8)
    assert time == pytest.approx(t[slopes.argmax()], abs=0.01)


def test_a_zero_in_the_right_half_plane_is_found_and_counted():
    # With gamma far too large, f_R is gone before the response arrives and the two cancel.
    time, slope = steepest_rise(THERMAL)
    gamma = 8.0 / time
    wrong = Regularisation(slope, -slope * gamma / 2, gamma)
    assert right_half_plane_zeros(THERMAL, wrong) == 2

    def total(s):
        return ring_source.transfer_function(s, **asdict(THERMAL)) + transfer_contribution(s, wrong)

    # Find one of the pair by Newton's method from a grid of guesses.
    real, imaginary = np.meshgrid(np.linspace(0.001, 0.5, 60), np.linspace(0.01, 1.0, 60))
    grid = real + 1j * imaginary
    s = complex(grid.ravel()[np.abs(total(grid)).argmin()])
    for _ in range(50):
        slope_there = (total(s + 1e-6) - total(s - 1e-6)) / 2e-6
        s -= complex(total(s) / slope_there)
    assert s.real > 0.0
    assert abs(total(s)) < 1e-9


def test_a_ring_through_the_sensor_needs_no_filling_in():
    at_ring = replace(THERMAL, r=0.12)
    chosen = choose_regularisation(at_ring, 2.0)
    added = np.abs(regularisation_function(RUN, chosen)).max()
    assert added < 0.01 * steady_value(3.372, 3.2, 0.12, 0.12)
    with pytest.raises(InputError, match="r = r0"):
        steepest_rise(at_ring)
