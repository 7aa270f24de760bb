"""Tables 2 and 3: fictitious sources come back from deviations that they made."""

import numpy as np
import pytest

from calibrate.fictitious import (
    calibrate_fictitious,
    deviations_from,
    gains_and_strengths,
    strength_condition,
)
from calibrate.source_deformation import fit_source_deformation, source_displacements
from calibrate.source_thermal import (
    fit_by_averaging,
    fit_jointly,
    largest_ratio,
    make_geometry,
    unit_responses,
)
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import make_response
from thermojoint.models import deformation, ring_source
from thermojoint.models.parameters import DeformationModel, RingModel
from thermojoint.models.regularisation import right_half_plane_zeros

RUN = np.arange(1051) * 2.0
SHORT = RUN[:300]
#: From the source of Table 2's geometry, in m; here with a shorter way across.
DISTANCES = [[0.0489, 0.1247], [0.1084, 0.0621]]
RADII = [0.4 * DISTANCES[i][i] for i in (0, 1)]
#: (K, a, alpha); the second is a sink at the reference input.
SOURCES = [(1.3, 8.0, 3e-5), (-0.7, 20.0, 6e-5)]
STRENGTHS = {0.5: (-0.12, 0.2), 2.0: (1.0, 1.0)}
SHAPES = {
    "x": (
        DeformationModel(3e-6, 5e-6, -1e-8, 0.004, 0.0011, 0.009, 2e-8, 0.02),
        DeformationModel(-1e-6, 3e-6, 1e-8, 0.006, 0.0008, 0.012, -2e-8, 0.03),
    ),
    "y": (
        DeformationModel(1e-6, -6e-6, 3e-8, 0.003, 0.0015, 0.012, 2e-8, 0.05),
        DeformationModel(2e-6, -3e-6, 1e-8, 0.006, 0.0018, 0.012, -2e-8, 0.02),
    ),
}


def saturating(rate, gain):
    return gain * -np.expm1(-rate * RUN)


LINEAR = {
    "a": saturating(2e-3, 5.0),
    "b": saturating(1e-3, 2.0),
    "T1": saturating(6e-4, 1.5),
    "T2": saturating(4e-4, 1.0),
}
LINEAR_SHAPES = {"x": saturating(1e-3, 80e-6), "y": saturating(7e-4, -70e-6)}


def made(level, *, time=RUN, extra=None):
    """A structure proportional to its heat input but for the two sources."""
    temperature = {name: level * value.copy() for name, value in LINEAR.items()}
    shape = {axis: level * value.copy() for axis, value in LINEAR_SHAPES.items()}
    for i, strength in enumerate(STRENGTHS.get(level, ())):
        K, a, alpha = SOURCES[i]
        for j, sensor in enumerate(("T1", "T2")):
            temperature[sensor] += strength * ring_source.step_response(
                RUN, K, a, alpha, DISTANCES[i][j], RADII[i]
            )
        for axis, models in SHAPES.items():
            shape[axis] += strength * deformation.step_response(RUN, models[i])
    if extra is not None:
        temperature["T1"] += extra
    n = time.size
    return make_response(
        {
            "heat_input": np.full(n, float(level)),
            "temperature": np.stack([temperature[name][:n] for name in LINEAR], axis=1),
            "displacement": np.stack([shape["x"][:n], shape["y"][:n]], axis=1),
        },
        {"time": time, "probe": list(LINEAR), "axis": ["x", "y"]},
    )


@pytest.fixture(scope="module")
def tables():
    return calibrate_fictitious(made(1.0), {level: made(level) for level in STRENGTHS}, DISTANCES)


def noisy_deviations(scale, seed):
    data = deviations_from(made(1.0), {level: made(level) for level in STRENGTHS})
    noise = np.random.default_rng(seed).standard_normal(data.temperatures.shape)
    return data, data.temperatures + scale * noise


def test_deviations_are_what_goes_beyond_proportionality():
    data = deviations_from(made(1.0), {level: made(level) for level in STRENGTHS})
    assert data.inputs == (0.5, 2.0)
    for index, level in enumerate(data.inputs):
        expected = sum(
            STRENGTHS[level][i]
            * ring_source.step_response(RUN, *SOURCES[i], DISTANCES[i][1], RADII[i])
            for i in range(2)
        )
        np.testing.assert_allclose(data.temperatures[index, 1], expected, atol=1e-13)


def test_a_structure_without_a_joint_has_no_deviations():
    data = deviations_from(made(1.0), {3.0: made(3.0)})
    assert np.abs(data.temperatures).max() < 1e-13
    assert all(np.abs(value).max() < 1e-18 for value in data.displacements.values())


def test_rates_gains_and_strengths_of_table_2_are_recovered(tables):
    for source, (K, a, alpha), index in zip(tables.sources, SOURCES, (0, 1), strict=True):
        assert pytest.approx(K, rel=1e-6) == source.K
        assert source.a == pytest.approx(a, rel=1e-6)
        assert source.alpha == pytest.approx(alpha, rel=1e-6)
        assert source.r0 == pytest.approx(RADII[index])
        assert source.strengths[2.0] == 1.0
        assert source.strengths[0.5] == pytest.approx(STRENGTHS[0.5][index], rel=1e-6)


def test_the_averaging_loop_and_the_joint_fit_agree_on_data_of_the_model(tables):
    data = tables.deviations
    averaged = fit_by_averaging(data.t, data.temperatures, data.inputs, make_geometry(DISTANCES))
    assert "the inputs agree after" in averaged.reason
    assert largest_ratio(tables.joint, averaged.result) < 1.0 + 1e-5


def test_with_noise_both_find_the_rates_within_their_standard_errors():
    data, temperatures = noisy_deviations(2e-3, seed=1)
    geometry = make_geometry(DISTANCES)
    joint = fit_jointly(data.t, temperatures, data.inputs, geometry)
    averaged = fit_by_averaging(data.t, temperatures, data.inputs, geometry)
    for i in range(2):
        error = joint.fit.standard_errors[f"a{i + 1}"]
        assert abs(joint.a[i] - SOURCES[i][1]) < 4 * error
        error = joint.fit.standard_errors[f"alpha{i + 1}"]
        assert abs(joint.alpha[i] - SOURCES[i][2]) < 4 * error
    # The inputs cannot agree exactly any more: the loop says so and ends.
    assert "stopped moving" in averaged.reason
    assert joint.fit.rms_error <= averaged.result.fit.rms_error * (1.0 + 1e-9)
    assert joint.fit.rms_error == pytest.approx(2e-3, rel=0.05)


def test_inputs_that_want_different_rates_are_reported_not_hidden():
    geometry = make_geometry(DISTANCES)
    deviations = np.empty((2, 2, SHORT.size))
    for k, factor in enumerate((1.0, 1.5)):
        rates = np.array([8.0, 3e-5 * factor, 20.0, 6e-5])
        columns, _ = unit_responses(SHORT, rates, geometry)
        deviations[k] = (columns @ [1.3, 0.9]).reshape(2, -1)
    found = fit_by_averaging(SHORT, deviations, (0.5, 2.0), geometry)
    assert "stopped moving" in found.reason
    # The geometric mean of what the two inputs want.
    assert found.result.alpha[0] == pytest.approx(3e-5 * np.sqrt(1.5), rel=0.02)


def test_the_slopes_of_the_unit_responses_are_those_of_finite_differences():
    geometry = make_geometry(DISTANCES)
    rates = np.array([8.0, 3e-5, 20.0, 6e-5])
    _, slopes = unit_responses(SHORT, rates, geometry)
    for k in range(4):
        up, down = rates.copy(), rates.copy()
        up[k] *= np.exp(1e-5)
        down[k] *= np.exp(-1e-5)
        expected = unit_responses(SHORT, up, geometry)[0] - unit_responses(SHORT, down, geometry)[0]
        of_its_source = np.zeros_like(expected)
        of_its_source[:, k // 2] = slopes[:, k]
        np.testing.assert_allclose(of_its_source, expected / 2e-5, atol=1e-8)


def test_a_sink_has_a_negative_gain_and_a_stable_inverse(tables):
    for i, source in enumerate(tables.sources):
        ring = RingModel(source.K, source.a, source.alpha, DISTANCES[i][i], source.r0)
        assert np.sign(source.regularisation.A) == np.sign(source.K)
        assert right_half_plane_zeros(ring, source.regularisation) == 0
    assert tables.sources[1].K < 0.0


def test_table_3_reproduces_the_nonlinear_displacement_far_below_a_tenth_of_a_micrometre(tables):
    for axis in ("x", "y"):
        for level in ("0.5", "2.0"):
            assert tables.deformation_errors[axis][level] < 1e-9
        models = tuple(source.deformation[axis] for source in tables.sources)
        for model, truth in zip(models, SHAPES[axis], strict=True):
            got, want = (deformation.step_response(RUN, one) for one in (model, truth))
            assert np.abs(got - want).max() < 0.01e-6


def test_strengths_in_one_proportion_leave_table_3_finite_and_say_so():
    # Both sources always act as one: the split is arbitrary, the sum is not.
    strengths = np.array([[-0.12, 1.0], [-0.12000001, 1.0]])
    target = source_displacements(SHORT, SHAPES["x"], strengths)
    models, found = fit_source_deformation(SHORT, target, strengths, starts=4)
    assert strength_condition(strengths) > 1e6
    assert found.max_abs_error < 0.01e-6
    largest = max(np.abs(deformation.step_response(SHORT, model)).max() for model in models)
    assert largest < 100 * np.abs(target).max()


def test_strengths_are_one_at_the_reference_input_and_products_are_kept():
    products = np.array([[-0.2, 1.6], [0.3, -0.7]])
    for reference in (0, 1):
        gains, strengths = gains_and_strengths(products, reference)
        np.testing.assert_array_equal(strengths[:, reference], 1.0)
        np.testing.assert_allclose(gains[:, None] * strengths, products)


def test_a_source_silent_at_the_reference_input_is_refused():
    with pytest.raises(InputError, match="fictitious source 2 is silent"):
        gains_and_strengths(np.array([[1.0, 2.0], [0.5, 0.0]]), 1)


def test_fewer_inputs_than_sources_are_refused():
    with pytest.raises(InputError, match="at least as many inputs"):
        calibrate_fictitious(made(1.0), {2.0: made(2.0)}, DISTANCES)


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({0.7: made(0.5), 2.0: made(2.0)}, "its heat input is 0.5"),
        ({1.0: made(1.0), 2.0: made(2.0)}, "reference input"),
        ({0.5: made(0.5, time=RUN[:800]), 2.0: made(2.0)}, "sample times differ"),
        ({0.5: made(0.5, time=RUN + 0.5), 2.0: made(2.0)}, "sample times differ"),
        ({0.5: made(0.5).sel(axis=["x"]), 2.0: made(2.0)}, "no axis named 'y'"),
    ],
)
def test_responses_that_do_not_belong_together_are_refused(others, message):
    with pytest.raises(InputError, match=message) as caught:
        deviations_from(made(1.0), others)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("distances", [[[0.05, -0.1], [0.1, 0.06]], [[0.0, 0.1], [0.1, 0.06]], []])
def test_distances_must_be_positive(distances):
    with pytest.raises(InputError, match="distances"):
        make_geometry(distances)
