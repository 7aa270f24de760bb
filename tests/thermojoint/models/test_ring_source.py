"""The closed forms of Eqs. 1-3 are the paper's integrals, and each other's derivatives."""

from itertools import pairwise

import numpy as np
import pytest
from closed_forms import steady_value
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import i0e, ive, j0, kve

from thermojoint.artefacts.errors import InputError
from thermojoint.models.ring_source import (
    impulse_response,
    step_response,
    step_response_gradient,
    transfer_function,
)

TABLE_1 = {"K": 3.372, "a": 3.20, "alpha": 0.000212, "r": 0.19, "r0": 0.12}
RUN = np.arange(1051) * 2.0

rings = st.fixed_dictionaries(
    {
        "K": st.floats(-10.0, 10.0).filter(lambda k: abs(k) > 1e-3),
        "a": st.floats(0.01, 100.0),
        "alpha": st.floats(1e-6, 1e-3),
        "r": st.floats(0.0, 0.5),
        "r0": st.floats(0.01, 0.3),
    }
)


def bessel_integral(t, K, a, alpha, r, r0):
    """Eq. 2 by brute force; its transient part decays as a Gaussian in the wave number."""

    def transient(beta):
        rate = a + beta * beta
        return beta / rate * j0(beta * r) * j0(beta * r0) * np.exp(-rate * alpha * t)

    top = np.sqrt(45.0 / (alpha * t))
    edges = np.linspace(0.0, top, 1 + int(np.ceil(top * (r + r0) / np.pi)))
    parts = [
        quad(transient, low, high, epsabs=1e-15, epsrel=1e-12)[0] for low, high in pairwise(edges)
    ]
    return steady_value(K, a, r, r0) - K * sum(parts)


def log_time_integral(t, K, a, alpha, r, r0):
    """The same by adaptive quadrature of the smooth integrand in ln(tau)."""

    def integrand(u):
        x = alpha * np.exp(u)
        return np.exp(-a * x - (r - r0) ** 2 / (4 * x)) * i0e(r * r0 / (2 * x))

    edges = np.log(t) - np.arange(0.0, 70.0)
    parts = [
        quad(integrand, low, high, epsabs=0.0, epsrel=2e-14)[0]
        for low, high in zip(edges[1:], edges[:-1], strict=True)
    ]
    return K / 2 * sum(parts)


def talbot(transform, t, nodes=28):
    """Numerical inverse Laplace transform (fixed Talbot contour)."""
    theta = (2 * np.arange(nodes) + 1) * np.pi / nodes - np.pi
    cot = 1.0 / np.tan(0.6407 * theta)
    z = nodes * (0.5017 * theta * cot - 0.6122 + 0.2645j * theta)
    turn = 0.5017 * 0.6407 * theta / np.sin(0.6407 * theta) ** 2
    slope = nodes * (0.5017 * cot - turn + 0.2645j)
    return float((np.exp(z) * transform(z / t) * slope).sum().imag / (t * nodes))


@pytest.mark.parametrize("t", [5.0, 40.0, 300.0, 2100.0])
@pytest.mark.parametrize("r", [0.19, 0.12, 0.02])
def test_step_response_is_the_bessel_integral_of_equation_2(t, r):
    ring = TABLE_1 | {"r": r}
    exact = bessel_integral(t, **ring)
    assert step_response(t, **ring) == pytest.approx(exact, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("r", [0.19, 0.12, 0.1201, 0.0, 0.4])
def test_step_response_is_accurate_relative_to_its_own_value(r):
    ring = TABLE_1 | {"r": r}
    steady = steady_value(ring["K"], ring["a"], r, ring["r0"])
    times = np.array([0.5, 2.0, 20.0, 200.0, 2000.0])
    exact = np.array([log_time_integral(t, **ring) for t in times])
    visible = exact > 1e-10 * steady
    assert visible.sum() >= 2
    np.testing.assert_allclose(step_response(times, **ring)[visible], exact[visible], rtol=1e-10)


@given(rings)
@settings(max_examples=60, deadline=None)
def test_the_response_ends_at_its_steady_value(ring):
    forever = 1e3 / (ring["a"] * ring["alpha"])
    steady = steady_value(ring["K"], ring["a"], ring["r"], ring["r0"])
    ended = step_response(np.array([0.0, forever]), **ring)
    assert abs(ended[0]) <= 1e-12 * abs(steady)
    assert ended[1] == pytest.approx(steady, rel=1e-10, abs=0.0)
    at_zero = complex(transfer_function(0.0, **ring))
    assert at_zero == pytest.approx(steady, rel=1e-12, abs=0.0)


@given(rings)
@settings(max_examples=40, deadline=None)
def test_heat_only_ever_raises_the_temperature_whatever_the_order_of_the_times(ring):
    times = np.geomspace(0.1, 1e5, 300)
    sign = np.sign(ring["K"])
    response = sign * step_response(times, **ring)
    steady = sign * steady_value(ring["K"], ring["a"], ring["r"], ring["r0"])
    assert np.diff(response).min() > -1e-12 * steady
    shuffled = np.random.default_rng(0).permutation(times.size)
    again = sign * step_response(times[shuffled].reshape(30, 10), **ring).ravel()
    np.testing.assert_allclose(again, response[shuffled], rtol=0.0, atol=1e-12 * steady)


@pytest.mark.parametrize("r", [0.19, 0.125, 0.3])
@pytest.mark.parametrize("t", [10.0, 100.0, 1000.0])
def test_the_transfer_function_is_the_laplace_transform_of_the_step_response(t, r):
    ring = TABLE_1 | {"r": r}
    inverted = talbot(lambda s: transfer_function(s, **ring) / s, t)
    assert inverted == pytest.approx(float(step_response(t, **ring)), rel=1e-7, abs=1e-8)


def test_the_impulse_response_is_the_slope_of_the_step_response():
    t = np.geomspace(3.0, 2000.0, 50)
    h = 1e-5 * t
    slope = (step_response(t + h, **TABLE_1) - step_response(t - h, **TABLE_1)) / (2 * h)
    np.testing.assert_allclose(impulse_response(t, **TABLE_1), slope, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("r", [0.19, 0.1203, 0.05, 0.5])
def test_the_gradient_is_that_of_finite_differences(r):
    ring = TABLE_1 | {"r": r}
    response, gradient = step_response_gradient(RUN, **ring)
    alone = step_response(RUN, **ring)
    np.testing.assert_allclose(response, alone, rtol=0.0, atol=1e-12 * np.abs(alone).max())
    for index, name in enumerate(("K", "a", "alpha", "r")):
        # Not across r = r0, where the derivative by r jumps.
        h = 1e-5 * ring[name]
        up, down = ring | {name: ring[name] + h}, ring | {name: ring[name] - h}
        expected = (step_response(RUN, **up) - step_response(RUN, **down)) / (2 * h)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(gradient[:, index], expected, atol=1e-7 * scale)


def test_on_the_ring_the_derivative_by_distance_is_the_mean_of_both_sides():
    near, far = TABLE_1 | {"r": 0.12 * (1 - 1e-7)}, TABLE_1 | {"r": 0.12 * (1 + 1e-7)}
    t = np.array([20.0, 200.0, 2000.0])
    sides = [step_response_gradient(t, **ring)[1][:, 3] for ring in (near, far)]
    middle = step_response_gradient(t, **(TABLE_1 | {"r": 0.12}))[1][:, 3]
    np.testing.assert_allclose(middle, (sides[0] + sides[1]) / 2, rtol=1e-4)
    # Eq. 1: the jump is the heat that enters, K/r0 (Wronskian of I0 and K0).
    np.testing.assert_allclose(sides[0] - sides[1], TABLE_1["K"] / 0.12, rtol=1e-3)


def test_a_source_at_the_sensor_starts_as_the_square_root_of_time():
    ring = TABLE_1 | {"r": 0.12}
    t = np.array([1e-6, 4e-6])
    expected = ring["K"] * np.sqrt(ring["alpha"] * t / np.pi) / ring["r0"]
    np.testing.assert_allclose(step_response(t, **ring), expected, rtol=1e-6)
    assert impulse_response(0.0, **ring) == np.inf
    assert abs(impulse_response(0.0, **TABLE_1)) < 1e-300


def test_the_transfer_function_neither_overflows_nor_jumps_far_out():
    ring = TABLE_1 | {"r": 0.12}
    # Where the series takes over from the Bessel functions, |kappa| r = 1e5.
    switch = ring["alpha"] * (1e5 / ring["r"]) ** 2
    for direction in (1.0, 1j, -1j, np.exp(0.3j)):
        s = direction * switch * np.array([0.999999, 1.000001])
        kappa = np.sqrt(ring["a"] + s / ring["alpha"])
        phase = np.exp(-1j * kappa.imag * 0.12)
        exact = ring["K"] * ive(0, kappa * 0.12) * kve(0, kappa * 0.12) * phase
        np.testing.assert_allclose(transfer_function(s, **ring), exact, rtol=1e-9)
    huge = transfer_function(np.array([1e30, 1e30j, 1e200j]), **ring)
    assert np.isfinite(huge).all()
    assert np.abs(transfer_function(np.array([1e30, 1e12j]), **TABLE_1)).max() < 1e-300


@pytest.mark.parametrize(
    "change", [{"a": 0.0}, {"alpha": -1e-5}, {"r": -0.1}, {"r0": 0.0}, {"K": np.nan}]
)
def test_parameters_out_of_range_are_named(change):
    (name,) = change
    with pytest.raises(InputError, match=rf"{name} = "):
        step_response(1.0, **(TABLE_1 | change))


def test_times_before_the_step_are_refused():
    with pytest.raises(InputError, match="times"):
        step_response(np.array([-1.0, 1.0]), **TABLE_1)
