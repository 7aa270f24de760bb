"""The joint law: surface-model pressure, Coulomb micro-slip, conductance of Eq. 11."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fesim.joint.law import (
    BackBurdekinLaw,
    Friction,
    JointLaw,
    SurfaceNormalLaw,
    evaluate,
    exact_conductance,
    harmonic_conductivity,
    power_law_conductance,
    stiffness_at_rest,
    tangent_matrix,
)
from thermojoint.artefacts.errors import InputError

HARDNESS, ROUGHNESS, SLOPE, PRELOAD = 1.961e9, 1.25e-6, 0.14, 4.41e6
NORMAL = SurfaceNormalLaw(HARDNESS, ROUGHNESS, PRELOAD)
#: lambda = 0.6 um (p / MPa)^0.5
MEASURED = BackBurdekinLaw(0.6e-6 / 1e6**0.5, 0.5, PRELOAD)
K_N = -float(NORMAL.slope(np.zeros(1))[0])
K_T = 0.844 * K_N

micrometres = st.floats(-8e-6, 8e-6)
coefficients = st.sampled_from([0.0, 0.15, 0.6, 2.0])


def law(friction, normal=NORMAL):
    conductance = power_law_conductance(1.45, 0.985, SLOPE, ROUGHNESS, 47.0, HARDNESS)
    return JointLaw(normal, Friction(friction, K_T), conductance)


def gap_of(*components):
    return np.array(components, dtype=float).reshape(3, 1)


def pressure_of(traction):
    return traction.value[0] + PRELOAD


# --- conductance ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "conductance",
    [
        power_law_conductance(1.45, 0.985, SLOPE, ROUGHNESS, 47.0, HARDNESS),
        exact_conductance(SLOPE, ROUGHNESS, 47.0, HARDNESS),
    ],
)
def test_conductance_is_zero_when_open_and_grows_with_pressure(conductance):
    pressure = np.concatenate([[0.0], np.geomspace(1e-250, 0.49 * HARDNESS, 200)])
    values = conductance(pressure)
    assert values[0] == 0.0
    assert (np.diff(values) > 0.0).all()
    opened = NORMAL.pressure(np.array([100e-6]))
    assert conductance(opened)[0] == 0.0


def test_surface_model_conductance_ends_at_half_the_hardness():
    conductance = exact_conductance(SLOPE, ROUGHNESS, 47.0, HARDNESS)
    with pytest.raises(InputError, match="half the hardness"):
        conductance(np.array([0.5 * HARDNESS]))


def test_harmonic_conductivity_of_two_layers_in_series():
    assert harmonic_conductivity(47.0, 47.0) == pytest.approx(47.0)
    resistance = 0.5 / 16.0 + 0.5 / 47.0
    assert harmonic_conductivity(16.0, 47.0) == pytest.approx(1.0 / resistance)


# --- normal law ----------------------------------------------------------------------------------


def test_pressure_at_zero_opening_is_the_preload():
    for normal in (NORMAL, MEASURED):
        np.testing.assert_allclose(normal.pressure(np.zeros(1)), PRELOAD, rtol=1e-12)


@pytest.mark.parametrize("normal", [NORMAL, MEASURED])
def test_a_joint_at_rest_exerts_nothing(normal):
    one = law(0.6, normal)
    assert one.preload == normal.preload
    at_rest = evaluate(one, np.zeros((3, 1)), np.zeros((2, 1)))
    np.testing.assert_allclose(at_rest.value, 0.0, atol=1e-6)
    np.testing.assert_allclose(
        stiffness_at_rest([(one, 1)]),
        -np.diagonal(tangent_matrix(at_rest.tangent)[..., 0]),
        rtol=1e-12,
    )


def test_a_normal_law_that_is_not_at_its_preload_at_rest_is_refused():
    class Softer(SurfaceNormalLaw):
        def pressure(self, opening):
            return 0.5 * super().pressure(opening)

    with pytest.raises(InputError, match=r"at opening zero is 2.205e\+06 Pa, the preload 4.41e"):
        law(0.6, Softer(HARDNESS, ROUGHNESS, PRELOAD))


def test_surface_model_stiffness_at_the_papers_preload():
    stiffness = K_N * 1e-12  # MPa/um
    assert stiffness == pytest.approx(11.0, abs=0.2)


def test_surface_model_pressure_is_the_share_of_the_surface_in_contact():
    """p/H is the chance that a Gaussian height exceeds the separation."""
    heights = np.random.default_rng(1).normal(0.0, ROUGHNESS, 2_000_000)
    opening = -1.5e-6
    share = (heights > NORMAL.separation + opening).mean()
    assert NORMAL.pressure(np.array([opening]))[0] / HARDNESS == pytest.approx(share, rel=0.01)


@given(opening=st.floats(-30e-6, 200e-6))
@pytest.mark.parametrize("normal", [NORMAL, MEASURED])
def test_pressure_pushes_only_and_falls_as_the_joint_opens(normal, opening):
    here, further = normal.pressure(np.array([opening, opening + 1e-7]))
    assert 0.0 <= further <= here
    assert normal.slope(np.array([opening]))[0] <= 0.0


@given(opening=st.floats(-10e-6, 6e-6))
@pytest.mark.parametrize("normal", [NORMAL, MEASURED])
def test_normal_slope_is_the_derivative_of_the_pressure(normal, opening):
    h = 1e-11
    ends = normal.pressure(np.array([opening - h, opening + h]))
    slope = normal.slope(np.array([opening]))[0]
    assert (ends[1] - ends[0]) / (2 * h) == pytest.approx(slope, rel=1e-4, abs=1e-6 * K_N)


@given(pressure=st.floats(0.01e6, 50e6), exponent=st.floats(0.3, 1.0))
def test_back_burdekin_approach_is_a_power_of_the_pressure(pressure, exponent):
    coefficient = 0.6e-6 / 1e6**exponent
    normal = BackBurdekinLaw(coefficient, exponent, PRELOAD)
    approach = 0.6e-6 * (np.array([PRELOAD, pressure]) / 1e6) ** exponent
    opening = approach[0] - approach[1]
    assert normal.pressure(np.array([opening]))[0] == pytest.approx(pressure, rel=1e-6)
    assert normal.pressure(np.array([approach[0] + 1e-12]))[0] == 0.0


def test_an_open_joint_of_constant_stiffness_has_none():
    linear = BackBurdekinLaw(1e-13, 1.0, PRELOAD)
    openings = linear.coefficient * PRELOAD * np.array([0.5, 1.5])
    np.testing.assert_allclose(linear.slope(openings), [-1e13, 0.0])


# --- friction ------------------------------------------------------------------------------------


@given(micrometres, micrometres, micrometres, micrometres, micrometres, coefficients)
def test_shear_never_exceeds_friction_times_pressure(opening, u, v, s, r, friction):
    slip = np.array([[s], [r]])
    found = evaluate(law(friction), gap_of(opening, u, v), slip)
    shear = np.hypot(*found.value[1:])
    assert (pressure_of(found) >= -1e-8).all()
    assert (shear <= friction * pressure_of(found) * (1.0 + 1e-12) + 1e-7).all()


@given(micrometres, micrometres, micrometres, coefficients)
def test_return_mapping_done_twice_changes_nothing(opening, u, v, friction):
    gap = gap_of(opening, u, v)
    once = evaluate(law(friction), gap, np.zeros((2, 1)))
    twice = evaluate(law(friction), gap, once.slip)
    np.testing.assert_allclose(twice.value, once.value, rtol=1e-12, atol=1e-6)
    np.testing.assert_allclose(twice.slip, once.slip, rtol=0.0, atol=1e-18)


@given(micrometres, micrometres, micrometres, coefficients)
def test_tangent_is_the_derivative_of_the_traction(opening, u, v, friction):
    chosen, slip = law(friction), np.zeros((2, 1))
    gap = gap_of(opening, u, v)
    at = evaluate(chosen, gap, slip)
    trial = K_T * np.hypot(u, v)
    bound = friction * pressure_of(at)[0]
    # Away from the kinks: stick to slip, and no trial slip at all.
    assume(abs(trial - bound) > 1e-3 * (trial + bound) and trial > 0.01e-6 * K_T)
    h = 1e-11
    for j in range(3):
        shift = h * np.eye(3)[:, [j]]
        up, down = (evaluate(chosen, gap + s * shift, slip).value for s in (1.0, -1.0))
        scale = max(K_N, float(np.abs(at.tangent).max()))
        np.testing.assert_allclose(
            (up - down) / (2 * h), tangent_matrix(at.tangent)[:, j], rtol=0.0, atol=1e-5 * scale
        )


@given(
    path=st.lists(st.tuples(st.floats(-2e-6, 4e-6), micrometres, micrometres), max_size=30),
    friction=coefficients,
)
def test_friction_never_gives_work_back(path, friction):
    """The joint's shear is on the gap, so it takes -shear . d(slip) out of it."""
    slip = np.zeros((2, 1))
    for components in path:
        found = evaluate(law(friction), gap_of(*components), slip)
        dissipated = -(found.value[1:] * (found.slip - slip)).sum()
        assert dissipated >= -1e-15
        slip = found.slip


@given(u=st.floats(-1e-8, 1e-8), v=st.floats(-1e-8, 1e-8))
def test_a_sticking_joint_is_a_spring(u, v):
    found = evaluate(law(0.6), gap_of(0.0, u, v), np.zeros((2, 1)))
    np.testing.assert_allclose(found.value[1:, 0], [-K_T * u, -K_T * v], rtol=1e-12)
    np.testing.assert_array_equal(found.slip, 0.0)


@given(opening=st.floats(60e-6, 1e-3), u=micrometres, v=micrometres, friction=coefficients)
def test_an_open_joint_carries_nothing(opening, u, v, friction):
    found = evaluate(law(friction), gap_of(opening, u, v), np.zeros((2, 1)))
    assert abs(pressure_of(found)[0]) < 1e-12 * PRELOAD
    np.testing.assert_array_equal(found.value[1:], 0.0)
    np.testing.assert_allclose(found.tangent, 0.0, atol=1e-200)


def test_contact_elements_do_not_know_of_each_other():
    rng = np.random.default_rng(3)
    gap, slip = rng.normal(0.0, 1e-6, (3, 8)), rng.normal(0.0, 1e-6, (2, 8))
    together = evaluate(law(0.3), gap, slip)
    for i in range(8):
        alone = evaluate(law(0.3), gap[:, [i]], slip[:, [i]])
        for ours, theirs in (
            (together.value[:, [i]], alone.value),
            (together.tangent[..., [i]], alone.tangent),
            (together.slip[:, [i]], alone.slip),
        ):
            scale = np.abs(theirs).max()
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-12 * scale)
