"""The inverse filter recovers the heat (Eqs. 3-6), as its own convolution does."""

from __future__ import annotations

import numpy as np
import pytest
from convolution import heat_by_convolution, invert_laplace
from hypothesis import given, settings
from hypothesis import strategies as st

from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.models import ring_source
from thermojoint.models.argument_principle import count_right_zeros
from thermojoint.models.filters.bank import respond_to_line
from thermojoint.models.filters.inverse import inverse_bank, regularised_transfer, unstable_zeros
from thermojoint.models.parameters import Regularisation, RingModel
from thermojoint.models.regularisation import choose_regularisation

DT, LENGTH = 2.0, 2100.0
TABLE_1 = RingModel(K=3.372, a=3.20, alpha=0.000212, r=0.19, r0=0.12)
REGULARISED = choose_regularisation(TABLE_1, DT)
NEAR, FAR = 0.10, 0.30


def joint_ring(distance):
    return RingModel(K=3.0, a=4.0, alpha=2e-4, r=distance, r0=0.05)


PAIR = [[joint_ring(NEAR), joint_ring(FAR)], [joint_ring(FAR + 0.02), joint_ring(NEAR + 0.01)]]
PAIR_REGULARISED = [choose_regularisation(PAIR[i][i], DT) for i in range(2)]


@pytest.fixture(scope="module")
def inverse():
    return inverse_bank([[TABLE_1]], [REGULARISED], DT, LENGTH, 1e-7, "ΔT")


@pytest.fixture(scope="module")
def pair_inverse():
    return inverse_bank(PAIR, PAIR_REGULARISED, DT, LENGTH, 1e-7, "sources")


def superposed(ring, times, onsets, changes):
    """Temperature after steps of heat `changes` at `onsets`."""
    total = np.zeros(times.size)
    for onset, change in zip(onsets, changes, strict=True):
        late = times > onset
        total[late] += change * ring_source.step_response(
            times[late] - onset, ring.K, ring.a, ring.alpha, ring.r, ring.r0
        )
    return total


def test_the_recursion_agrees_with_the_convolution_of_eqs_5_and_6_at_irregular_times(pair_inverse):
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.uniform(0.3, 9.0, 50))
    temperatures = np.cumsum(rng.standard_normal((50, 2)), axis=0)
    recursion, _ = respond_to_line(pair_inverse, times, temperatures, 1.0)
    convolution = heat_by_convolution(PAIR, PAIR_REGULARISED, times, temperatures, 1.0)
    assert np.abs(recursion - convolution).max() < 1e-6 * np.abs(convolution).max()


def test_the_bank_is_the_inverse_matrix_at_every_frequency(pair_inverse):
    s = 1j * np.geomspace(1e-5, 30.0, 400)
    product = pair_inverse.transfer(s) @ regularised_transfer(PAIR, PAIR_REGULARISED)(s)
    assert np.abs(product - np.eye(2)).max() < 1e-5
    assert pair_inverse.slope == pytest.approx(
        np.diag([1.0 / f.A for f in PAIR_REGULARISED]), rel=1e-4, abs=1e-3
    )
    assert (pair_inverse.poles.real < 0.0).all()


def test_a_step_is_recovered_and_the_bias_of_the_regularisation_fades(inverse):
    times = np.arange(1, 1051) * DT
    delta_T = superposed(TABLE_1, times, [0.0], [1.0])[:, None]
    heat = respond_to_line(inverse, times, delta_T, DT)[0][:, 0]
    assert np.abs(heat[times > 60.0] - 1.0).max() < 0.02
    assert np.abs(heat[times > 300.0] - 1.0).max() < 1e-3
    # No energy is lost: what the transient lacks at first it gives back.
    assert np.sum(heat - 1.0) * DT == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize("shape", ["ramp", "triangle"])
def test_ramps_and_triangles_are_recovered_within_two_per_cent(inverse, shape):
    times = np.arange(1, 451) * DT
    middle = times - 0.5 * DT
    peak_at, end = 300.0, 600.0
    true = np.minimum(middle / peak_at, 1.0) * 2.0
    if shape == "triangle":
        true = np.interp(middle, [0.0, peak_at, end], [0.0, 2.0, 0.0])
    onsets = np.append(0.0, times[:-1])
    delta_T = superposed(TABLE_1, times, onsets, np.diff(true, prepend=0.0))[:, None]
    heat = respond_to_line(inverse, times, delta_T, DT)[0][:, 0]
    assert np.abs(heat - true).max() < 0.02 * 2.0


def test_two_sources_that_are_only_seen_together_are_told_apart(pair_inverse):
    times = np.arange(1, 1051) * DT
    strengths = (1.0, -0.4)
    temperatures = np.stack(
        [
            sum(superposed(PAIR[i][j], times, [0.0], [strengths[i]]) for i in range(2))
            for j in range(2)
        ],
        axis=1,
    )
    heat = respond_to_line(pair_inverse, times, temperatures, DT)[0]
    assert np.abs(heat[times > 600.0] - strengths).max() < 5e-3


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=2, max_size=25), st.integers(0, 2**32 - 1))
def test_any_intervals_give_the_means_of_fine_uniform_sampling(inverse, steps, seed):
    ends = np.cumsum(steps)
    coarse = ends * 0.25
    values = np.random.default_rng(seed).standard_normal(ends.size)
    fine = np.arange(1, ends[-1] + 1) * 0.25
    along = np.interp(fine, np.append(0.0, coarse), np.append(0.0, values))
    heat = respond_to_line(inverse, coarse, values[:, None], coarse[0])[0][:, 0]
    fine_heat = respond_to_line(inverse, fine, along[:, None], 0.25)[0][:, 0]
    begins = np.append(0, ends[:-1])
    means = np.add.reduceat(fine_heat, begins) / np.diff(np.append(begins, ends[-1]))
    assert heat == pytest.approx(means, abs=1e-9 * np.abs(fine_heat).max())


@settings(max_examples=30, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.integers(1, 30))
def test_the_inverse_superposes_and_does_not_care_when_it_is_used(inverse, p, q, delay):
    rng = np.random.default_rng(delay)
    times = np.arange(1, 61) * DT
    u, v = rng.standard_normal((2, 60, 1))
    heat_u, heat_v, heat_both = (
        respond_to_line(inverse, times, x, DT)[0] for x in (u, v, p * u + q * v)
    )
    assert heat_both == pytest.approx(p * heat_u + q * heat_v, abs=1e-10 * np.abs(heat_u).max())
    later = np.concatenate((np.zeros((delay, 1)), u))
    heat_later = respond_to_line(inverse, np.arange(1, 61 + delay) * DT, later, DT)[0]
    assert heat_later[delay:] == pytest.approx(heat_u, abs=1e-12 * np.abs(heat_u).max())


@pytest.mark.parametrize("dt", [0.05, 0.2, 1.0])
def test_the_noise_gain_is_what_A_says(dt):
    """White noise of variance σ² has first differences of 2σ²: Q̂ gets √2 σ/(A Δt)."""
    bank = inverse_bank([[TABLE_1]], [REGULARISED], dt, LENGTH, 1e-6, "ΔT")
    noise = 0.03 * np.random.default_rng(1).standard_normal((4000, 1))
    heat = respond_to_line(bank, np.arange(1, 4001) * dt, noise, dt)[0]
    predicted = np.sqrt(2.0) * 0.03 / (REGULARISED.A * dt)
    # The next term of G is of the order of γ Δt.
    assert heat.std() == pytest.approx(predicted, rel=0.05 + 2.0 * REGULARISED.gamma * dt)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(0.02, 20.0), max_size=3),
    st.lists(st.floats(0.02, 20.0), max_size=3),
    st.lists(st.tuples(st.floats(0.05, 5.0), st.floats(0.05, 5.0)), max_size=2),
)
def test_the_argument_principle_counts_the_zeros_on_the_right(left, right, pairs):
    def function(s):
        value = np.ones_like(s)
        for zero in left:
            value = value * (s + zero) / (s + 1.0)
        for zero in right:
            value = value * (s - zero) / (s + 1.0)
        for real, imaginary in pairs:
            value = value * ((s - real) ** 2 + imaginary**2) / (s + 1.0) ** 2
        return value

    assert count_right_zeros(function, 1e-4, 1e4, "test") == len(right) + 2 * len(pairs)


def test_an_inverse_that_would_be_unstable_is_refused_with_what_to_change():
    weak = Regularisation(A=5.59e-3, B=8.25e-6, gamma=0.290)
    assert unstable_zeros([[TABLE_1]], [weak], DT, LENGTH, "ΔT") == 2
    with pytest.raises(InputError, match=r"ΔT: .*2 zeros in the right half plane.*larger A"):
        inverse_bank([[TABLE_1]], [weak], DT, LENGTH, 1e-6, "ΔT")
    wrong_sign = Regularisation(A=-REGULARISED.A, B=0.0, gamma=REGULARISED.gamma)
    with pytest.raises(InputError, match="right half plane"):
        inverse_bank([[TABLE_1]], [wrong_sign], DT, LENGTH, 1e-6, "ΔT")


def test_a_zero_on_the_imaginary_axis_is_refused():
    with pytest.raises(ConvergenceError, match="zero on the imaginary axis"):
        count_right_zeros(lambda s: (s**2 + 1.0) / (s + 1.0) ** 2, 1e-3, 1e3, "test")


@pytest.mark.parametrize(("A", "gamma"), [(0.0, 0.1), (0.01, 0.0), (0.01, -0.1), (0.01, np.nan)])
def test_a_regularisation_that_does_not_regularise_is_refused(A, gamma):
    with pytest.raises(InputError, match="must not be zero"):
        inverse_bank([[TABLE_1]], [Regularisation(A, 0.0, gamma)], DT, LENGTH, 1e-6, "ΔT")


def test_sensors_that_see_the_sources_alike_are_refused():
    same = [[joint_ring(NEAR), joint_ring(NEAR)]] * 2
    with pytest.raises(InputError, match="not independent"):
        inverse_bank(same, PAIR_REGULARISED, DT, LENGTH, 1e-6, "sources")
    with pytest.raises(InputError, match="need 2 sensors"):
        inverse_bank([PAIR[0][:1], PAIR[1]], PAIR_REGULARISED, DT, LENGTH, 1e-6, "sources")


def test_the_numerical_inversion_returns_known_originals():
    times = np.geomspace(0.01, 100.0, 40)
    damped = invert_laplace(lambda s: (s + 0.1) / ((s + 0.1) ** 2 + 0.02), times)
    assert damped == pytest.approx(np.exp(-0.1 * times) * np.cos(np.sqrt(0.02) * times), abs=1e-9)
    slow = invert_laplace(lambda s: 1.0 / np.sqrt(s), times)
    assert slow == pytest.approx(1.0 / np.sqrt(np.pi * times), rel=1e-10)
