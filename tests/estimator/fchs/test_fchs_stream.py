"""The estimator of Figure 5: from temperatures alone, the same however the samples are fed."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.fchs.block_errors import block_errors
from estimator.fchs.estimator import Fchs
from estimator.fchs.judging import validate
from estimator.fchs.kind import KIND
from estimator.fchs.stream import initial_state, run, step
from estimator.interface import follow
from estimator.kind import Options
from estimator.noise import sensor_noise
from estimator.registry import resume_estimator, resumed, save_state
from estimator.states import read_state
from estimator.superposition import superposed
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import make_response
from thermojoint.models import blocks, deformation, ring_source
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import fingerprint, read_assembly, write_assembly
from thermojoint.models.model_file import Provenance, write_model
from thermojoint.models.parameters import (
    DeformationModel,
    FictitiousSource,
    LinearModel,
    Model,
    Relaxation,
    RingModel,
    Span,
)
from thermojoint.models.regularisation import choose_regularisation
from thermojoint.models.sensors import readings

DT, LENGTH = 2.0, 2100.0
TIMES = np.arange(1051) * DT
MAIN = RingModel(K=3.372, a=3.20, alpha=0.000212, r=0.19, r0=0.12)
DISTANCES = ((0.10, 0.30), (0.32, 0.11))
AXES = ("x", "y")


def source(axes):
    ring = RingModel(K=3.0, a=4.0, alpha=2e-4, r=0.10, r0=0.05)
    return FictitiousSource(
        K=ring.K,
        a=ring.a,
        alpha=ring.alpha,
        r0=ring.r0,
        strengths={2.0: 1.0, 0.5: -0.3},
        regularisation=choose_regularisation(ring, DT),
        deformation=dict(zip(AXES, axes, strict=True)),
    )


MODEL = Model(
    linear=LinearModel(
        thermal=MAIN,
        regularisation=choose_regularisation(MAIN, DT),
        deformation={
            "x": DeformationModel(0.1695e-6, -87e-6, -4.785e-8, 0.0089, 0.00129, 0.0097),
            "y": DeformationModel(3.845e-6, 66e-6, -3.54e-8, 0.00123, 0.00142, 0.0338),
        },
        direct={
            "T1": RingModel(K=2.0, a=3.0, alpha=2e-4, r=0.30, r0=0.12),
            "T2": Relaxation(amplitudes=(0.4, 0.2, -0.1), rates=(1e-3, 4e-3, 2e-2)),
        },
    ),
    sources=(
        source(
            (
                DeformationModel(1.0e-6, 3.0e-6, -1e-8, 0.0097, 0.0044, 0.0085, 1e-8, 0.0199),
                DeformationModel(-0.3e-6, 4.0e-6, 3e-8, 0.0031, 0.0046, 0.0123, 2e-8, 0.205),
            )
        ),
        source(
            (
                DeformationModel(-0.7e-6, 1.9e-6, -1e-8, 0.0120, 0.0029, 0.0077, 1e-8, 0.0191),
                DeformationModel(-0.1e-6, -3.0e-6, -1e-8, 0.0022, 0.0049, 0.0157, 2e-8, 0.0201),
            )
        ),
    ),
    distances=DISTANCES,
    span=Span(1800.0, (0.0, 2.0), {"delta_T": (0.0, 8.0), "T1": (0.0, 8.0), "T2": (0.0, 2.0)}),
    sensors=dict.fromkeys(("a", "b", "T1", "T2"), (0.0, 0.0, 0.0)),
    reference_power_W=295.0,
)


def ring_step(ring, times=TIMES):
    return ring_source.step_response(times, ring.K, ring.a, ring.alpha, ring.r, ring.r0)


def relaxation_step(spectrum, times=TIMES):
    return sum(
        -c * np.expm1(-rate * times)
        for c, rate in zip(spectrum.amplitudes, spectrum.rates, strict=True)
    )


def plant(level, strengths):
    """A response that obeys the model exactly: step `level`, fictitious steps `strengths`."""
    joint = np.stack(
        [
            level * ring_step(MODEL.linear.direct["T1"]),
            level * relaxation_step(MODEL.linear.direct["T2"]),
        ],
        axis=1,
    )
    displacement = np.stack(
        [level * deformation.step_response(TIMES, MODEL.linear.deformation[a]) for a in AXES],
        axis=1,
    )
    for i, strength in enumerate(strengths):
        s = MODEL.sources[i]
        for j, r in enumerate(DISTANCES[i]):
            joint[:, j] += strength * ring_step(RingModel(s.K, s.a, s.alpha, r, s.r0))
        for k, axis in enumerate(AXES):
            displacement[:, k] += strength * deformation.step_response(TIMES, s.deformation[axis])
    ambient = 0.1 * ring_step(MAIN)
    temperature = np.column_stack((level * ring_step(MAIN) + ambient, ambient, joint))
    return make_response(
        {
            "heat_input": np.full(TIMES.size, level),
            "temperature": temperature,
            "displacement": displacement,
        },
        {"time": TIMES, "probe": ["a", "b", "T1", "T2"], "axis": list(AXES)},
    )


@pytest.fixture(scope="module")
def assembly():
    return assemble(MODEL, DT, LENGTH)


@pytest.fixture(scope="module")
def response():
    return plant(2.0, (1.0, -0.5))


@pytest.fixture(scope="module")
def reference():
    return plant(1.0, (0.0, 0.0))


def random_samples(seed, count):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([0.5, 2.0, 2.0, 2.0, 31.0], count))
    return times, rng.standard_normal(count), rng.standard_normal((count, 2))


def test_displacement_is_found_from_temperatures_alone(assembly, response):
    seen = readings(response, tuple(MODEL.linear.direct))
    estimate, _ = run(assembly, seen.times, seen.delta_T, seen.temperatures)
    actual = response["displacement"].to_numpy()
    nonlinear = actual - 2.0 * plant(1.0, (0.0, 0.0))["displacement"].to_numpy()
    late = TIMES > 300.0
    assert np.abs(estimate.heat[late] - 2.0).max() < 2e-3
    assert np.abs(estimate.sources[TIMES > 900.0] - (1.0, -0.5)).max() < 5e-3
    assert np.abs(estimate.total - actual)[late].max() < 5e-3 * np.abs(nonlinear).max()
    assert np.abs(estimate.total - actual).max() < 0.15 * np.abs(nonlinear).max()
    both = estimate.linear + estimate.nonlinear
    assert estimate.total == pytest.approx(both, abs=1e-12 * np.abs(both).max())


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.data())
def test_samples_blocks_and_resumed_blocks_give_the_same_bits(assembly, seed, count, data):
    times, delta_T, temperatures = random_samples(seed, count)
    whole, end = run(assembly, times, delta_T, temperatures)
    cut = data.draw(st.integers(1, count - 1))
    _, half = run(assembly, times[:cut], delta_T[:cut], temperatures[:cut])
    rest, resumed_end = run(assembly, times[cut:], delta_T[cut:], temperatures[cut:], half)
    state = initial_state(assembly)
    for n in range(count):
        state, single = step(assembly, state, times[n], delta_T[n], *temperatures[n])
        for whole_column, value in zip(whole, single, strict=True):
            assert np.array_equal(whole_column[n], value)
    assert np.array_equal(end, state)
    assert np.array_equal(end, resumed_end)
    for whole_column, rest_column in zip(whole, rest, strict=True):
        assert np.array_equal(whole_column[cut:], rest_column)


def followed(estimator, samples, state):
    """Run the samples through the common interface; the displacements and the state at the end."""
    found = list(follow(estimator, samples, state))
    return np.array([estimate.displacement for _, estimate in found]), found[-1][0]


def test_a_saved_state_resumes_bit_for_bit(assembly, tmp_path):
    """With the coefficients it began with, whatever this processor would make of the model."""
    times, delta_T, temperatures = random_samples(3, 60)
    samples = np.column_stack((times, delta_T, temperatures)).tolist()
    estimator = Fchs(assembly)
    whole, end = followed(estimator, samples, estimator.initial_state())
    _, half = followed(estimator, samples[:25], estimator.initial_state())
    save_state(estimator, half, tmp_path / "state.json")
    again, loaded = resumed(KIND, assembly, Options(), tmp_path / "state.json")
    assert np.array_equal(loaded, half)
    assert fingerprint(again.assembly) == fingerprint(assembly)
    rest, resumed_end = followed(again, samples[25:], loaded)
    assert np.array_equal(end, resumed_end)
    assert np.array_equal(whole[25:], rest)
    assert [path.name for path in tmp_path.iterdir()] == ["state.json"]
    save_state(estimator, estimator.initial_state(), tmp_path / "fresh.json")
    assert np.isnan(read_state(tmp_path / "fresh.json").values[0])


def test_a_state_goes_on_where_the_fit_of_the_poles_differs_in_its_last_digits(assembly, tmp_path):
    """As on another processor."""
    heat = assembly.heat
    elsewhere = replace(assembly, heat=replace(heat, poles=heat.poles * (1.0 + 1e-13)))
    model, state = tmp_path / "model.json", tmp_path / "state.json"
    write_model(MODEL, model, Provenance("a plate"))
    estimator = Fchs(elsewhere)
    save_state(
        estimator, followed(estimator, [(2.0, 1.0, 0.5, 0.2)], estimator.initial_state())[1], state
    )
    again, _ = resume_estimator(model, state)
    assert fingerprint(again.assembly) == fingerprint(elsewhere)


def test_an_assembly_comes_back_from_its_file_to_the_last_bit(assembly, tmp_path):
    path = tmp_path / "assembly.json"
    write_assembly(assembly, path)
    again = read_assembly(path)
    assert again.model == assembly.model
    for mine, theirs in zip(again.banks, assembly.banks, strict=True):
        for field in fields(mine):
            one, other = (np.asarray(getattr(bank, field.name)) for bank in (mine, theirs))
            assert one.tobytes() == other.tobytes()
            assert (one.shape, one.dtype) == (other.shape, other.dtype)
    changed = json.loads(path.read_text())
    changed["banks"]["heat"]["slope"]["values"][0] *= 1.0 + 1e-9
    path.write_text(json.dumps(changed))
    with pytest.raises(InputError, match="it was changed"):
        read_assembly(path)


def test_a_state_that_has_overflowed_is_not_saved(assembly, tmp_path):
    estimator = Fchs(assembly)
    state = np.full_like(estimator.initial_state(), np.inf)
    with pytest.raises(InputError, match="the state is not finite"):
        save_state(estimator, state, tmp_path / "state.json")
    assert list(tmp_path.iterdir()) == []


def test_a_state_that_does_not_belong_here_is_refused(assembly, tmp_path):
    path, model = tmp_path / "state.json", tmp_path / "model.json"
    estimator = Fchs(assembly)
    save_state(
        estimator, estimator.sample(estimator.initial_state(), 2.0, (1.0, 0.5, 0.2))[0], path
    )
    hotter = replace(MODEL.linear, thermal=replace(MAIN, K=3.4))
    write_model(replace(MODEL, linear=hotter), model, Provenance("a hotter plate"))
    with pytest.raises(InputError, match="another model"):
        resume_estimator(model, path)
    text = path.read_text()
    newer = json.loads(text) | {"schema_version": 2}
    short = json.loads(text)
    short["state"] = short["state"][:-1]
    endless = json.loads(text)
    endless["state"][0] = float("inf")
    foreign = json.loads(text) | {"carried": {}}
    for content, message in (
        (text[: len(text) // 2], "truncated"),
        ("[]", "not a 'thermojoint-estimator-state'"),
        (json.dumps(newer), "version 2"),
        (json.dumps(short), "damaged"),
        (json.dumps(endless), "damaged"),
        (json.dumps(foreign), "damaged"),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=message):
            read_state(path)
    with pytest.raises(InputError, match="no such file"):
        read_state(tmp_path / "absent.json")


@pytest.mark.parametrize(
    ("time", "values", "words"),
    [
        (2.0, (1e-3, 1e-3, 1e-3), "ok"),
        (1e5, (1e-3, 1e-3, 1e-3), "beyond-time"),
        (2.0, (1e-3, 1e-3, 9.0), "beyond-temperature"),
        (2.0, (20.0, 0.1, 0.1), "beyond-heat beyond-temperature"),
    ],
)
def test_an_estimate_says_where_the_calibration_has_not_been(assembly, time, values, words):
    estimator = Fchs(assembly)
    state, _ = estimator.sample(estimator.initial_state(), 0.0, (0.0, 0.0, 0.0))
    assert estimator.sample(state, time, values)[1].status.words == words


def test_the_common_interface_says_what_the_blocks_say(assembly):
    estimator = Fchs(assembly)
    times, delta_T, temperatures = random_samples(7, 30)
    signals, _ = run(assembly, times, delta_T, temperatures)
    samples = np.column_stack((times, delta_T, temperatures)).tolist()
    displacements, _ = followed(estimator, samples, estimator.initial_state())
    assert np.array_equal(displacements, signals.total)
    assert len(estimator.details) == len(
        estimator.sample(estimator.initial_state(), 2.0, (0.0, 0.0, 0.0))[1].details
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_every_output_superposes(assembly, seed, p, q):
    times, u, U = random_samples(seed, 25)
    _, v, V = random_samples(seed + 1, 25)
    one, _ = run(assembly, times, u, U)
    other, _ = run(assembly, times, v, V)
    both, _ = run(assembly, times, p * u + q * v, p * U + q * V)
    for a, b, c in list(zip(one, other, both, strict=True))[1:]:
        scale = (1.0 + abs(p)) * np.abs(a).max() + (1.0 + abs(q)) * np.abs(b).max()
        assert np.abs(c - (p * a + q * b)).max() <= 1e-11 * scale


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 10**6))
def test_nothing_depends_on_when_the_clock_was_set(assembly, seed, shift):
    times, delta_T, temperatures = random_samples(seed, 20)
    now, _ = run(assembly, times, delta_T, temperatures)
    later, _ = run(assembly, times + shift, delta_T, temperatures)
    for a, b in list(zip(now, later, strict=True))[1:]:
        assert np.array_equal(a, b)


def test_the_single_blocks_are_the_parts_of_the_whole(assembly):
    times, delta_T, temperatures = random_samples(8, 80)
    whole, _ = run(assembly, times, delta_T, temperatures)
    heat = blocks.heat_part(assembly, times, delta_T)
    deviation = blocks.deviations(assembly, times, heat, temperatures)
    for part, expected in (
        (heat, whole.heat),
        (blocks.linear_part(assembly, times, heat), whole.linear),
        (deviation, whole.deviation),
        (blocks.source_part(assembly, times, deviation), whole.sources),
        (blocks.nonlinear_part(assembly, times, deviation), whole.nonlinear),
    ):
        assert part == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_true_heat_gives_the_exact_step_of_eq_8(assembly):
    heat = np.where(TIMES > 0.0, 1.5, 0.0)
    exact = 1.5 * deformation.step_response(TIMES, MODEL.linear.deformation["y"])
    given_heat = blocks.linear_part(assembly, TIMES, heat)[:, 1]
    assert given_heat == pytest.approx(exact, abs=1e-12 * np.abs(exact).max())


def test_a_gap_in_the_data_heals(assembly, response):
    seen = readings(response, tuple(MODEL.linear.direct))
    kept = (TIMES < 600.0) | (TIMES > 660.0)
    whole, _ = run(assembly, seen.times, seen.delta_T, seen.temperatures)
    gap, _ = run(assembly, TIMES[kept], seen.delta_T[kept], seen.temperatures[kept])
    assert np.abs(gap.total - whole.total[kept]).max() < 2e-8


@pytest.mark.parametrize(
    ("channel", "value", "name"),
    [(0, np.nan, "ΔT is not"), (1, np.inf, "T1 is not"), (2, -9999.0, "T2 is -9999 K, no temp")],
)
def test_a_sample_that_is_no_temperature_is_refused_by_name(assembly, channel, value, name):
    times, delta_T, temperatures = random_samples(4, 10)
    table = np.column_stack((delta_T, temperatures))
    table[6, channel] = value
    with pytest.raises(InputError, match=rf"sample 6: .*{times[6]:g} s: {name}"):
        run(assembly, times, table[:, 0], table[:, 1:])


def test_after_a_refused_sample_the_stream_goes_on_as_if_it_had_not_come(assembly):
    times, delta_T, temperatures = random_samples(4, 10)
    _, state = run(assembly, times, delta_T, temperatures)
    before = state.copy()
    for bad in (
        (times[-1], 0.1, 0.2, 0.3),
        (times[-1] - 5.0, 0.1, 0.2, 0.3),
        (np.nan, 0.1, 0.2, 0.3),
        (times[-1] + 2.0, 0.1, np.nan, 0.3),
        (times[-1] + 2.0, 0.1, 0.2),
    ):
        with pytest.raises(InputError):
            step(assembly, state, *bad)
        assert np.array_equal(state, before)
    with pytest.raises(InputError, match=r"sample 1: .*time does not increase"):
        run(assembly, np.ones(2), np.zeros(2), np.zeros((2, 2)))
    with pytest.raises(InputError, match="time does not increase"):
        blocks.linear_part(assembly, np.array([0.0, 2.0, 2.0]), np.zeros(3))
    with pytest.raises(InputError, match="sample 1 at 2 s is not finite"):
        blocks.linear_part(assembly, np.array([0.0, 2.0, 4.0]), np.array([0.0, np.nan, 1.0]))


@pytest.mark.parametrize("time", [np.nan, np.inf, -np.inf])
def test_a_time_that_is_not_finite_is_refused_also_in_the_first_sample(assembly, time):
    with pytest.raises(InputError, match="time is not finite"):
        step(assembly, initial_state(assembly), time, 0.1, 0.2, 0.3)
    with pytest.raises(InputError, match=r"sample 0: .*time is not finite"):
        run(assembly, np.array([time, 2.0]), np.zeros(2), np.zeros((2, 2)))


def test_blocks_whose_shapes_do_not_agree_are_refused(assembly):
    times, delta_T, temperatures = random_samples(4, 10)
    with pytest.raises(InputError, match="samples: time, ΔT and T have shapes"):
        run(assembly, times, delta_T[:-1], temperatures)
    with pytest.raises(InputError, match="no samples"):
        run(assembly, times[:0], delta_T[:0], temperatures[:0])
    with pytest.raises(InputError, match="another estimator"):
        run(assembly, times, delta_T, temperatures, np.zeros(3))


def test_a_model_whose_parts_do_not_fit_is_refused():
    with pytest.raises(InputError, match="1 fictitious sources and 2 sensors"):
        assemble(replace(MODEL, sources=MODEL.sources[:1], distances=DISTANCES[:1]), DT, LENGTH)
    with pytest.raises(InputError, match="distances are not 2 rows of 2"):
        assemble(replace(MODEL, distances=DISTANCES[:1]), DT, LENGTH)
    lame = replace(MODEL.sources[1], deformation={"x": MODEL.sources[1].deformation["x"]})
    with pytest.raises(InputError, match="source 2 has axes"):
        assemble(replace(MODEL, sources=(MODEL.sources[0], lame)), DT, LENGTH)


def test_validation_judges_both_estimators_on_every_axis(response, reference):
    judged = validate(response, MODEL, reference=reference)
    assert [(r["estimator"], r["axis"]) for r in judged.rows] == [
        ("none", "x"),
        ("none", "y"),
        ("linear", "x"),
        ("linear", "y"),
        ("fchs", "x"),
        ("fchs", "y"),
    ]
    rows, estimate = judged.rows[2:], judged.estimate
    actual = response["displacement"].to_numpy()
    nonlinear = actual - 2.0 * reference["displacement"].to_numpy()
    for k, row in enumerate(rows[2:]):
        error = (estimate.total - actual)[:, k] * 1e6
        assert row["max_abs_error_um"] == pytest.approx(np.abs(error).max())
        assert row["rms_error_um"] == pytest.approx(np.sqrt(np.mean(error**2)))
        assert row["peak_total_um"] == pytest.approx(np.abs(actual[:, k]).max() * 1e6)
        assert row["peak_nonlinear_um"] == pytest.approx(np.abs(nonlinear[:, k]).max() * 1e6)
        # What is left is the start of the step, where the regularisation answers for the delay.
        assert row["max_abs_error_um"] < 0.25 * rows[k]["max_abs_error_um"]
        assert row["rms_error_um"] < 0.05 * rows[k]["rms_error_um"]


def test_a_model_whose_axes_come_in_another_order_is_judged_by_its_own(response):
    """Judged after a model that differs in nothing else, x was held against y."""
    turned = replace(
        MODEL,
        linear=replace(MODEL.linear, deformation=backwards(MODEL.linear.deformation)),
        sources=tuple(
            replace(
                source, deformation=backwards(source.deformation), driven=backwards(source.driven)
            )
            for source in MODEL.sources
        ),
    )
    assert turned.digest == MODEL.digest
    errors = [
        {(row["estimator"], row["axis"]): row["max_abs_error_um"] for row in judged.rows}
        for judged in (validate(response, model) for model in (MODEL, turned))
    ]
    assert errors[1] == pytest.approx(errors[0])


def backwards(shapes):
    return dict(reversed(shapes.items()))


def test_validation_uses_the_temperatures_and_no_other_knowledge(response):
    seeing = validate(response, MODEL).estimate
    blind = response.copy(deep=True)
    blind["displacement"] *= 0.0
    blind["heat_input"] *= 0.0
    blinded = validate(blind, MODEL).estimate
    assert np.array_equal(seeing.total, blinded.total)


def test_true_signals_in_place_of_estimates_remove_their_share_of_the_error(response, reference):
    rows = block_errors("step-2.0", response, MODEL, reference)
    worst = {(r["driven_by"], r["axis"]): r for r in rows}
    estimate_rows = validate(response, MODEL, reference=reference).rows
    for k, axis in enumerate(AXES):
        as_is, both = worst["temperatures", axis], worst["both", axis]
        assert as_is["total_error_um"] == pytest.approx(
            estimate_rows[4 + k]["max_abs_error_um"], rel=1e-6
        )
        # The plant obeys Eq. 8, so with the true heat nothing is left of the linear error.
        assert worst["true heat", axis]["linear_error_um"] < 1e-6
        assert both["linear_error_um"] < 1e-6 < as_is["linear_error_um"]
        by_true_deviations = worst["true deviations", axis]["linear_error_um"]
        assert by_true_deviations == pytest.approx(as_is["linear_error_um"], rel=1e-9, abs=0.0)


def test_the_superposed_reference_follows_any_heat_input(reference):
    ramp = np.interp(TIMES, [0.0, 600.0, 1200.0], [0.0, 2.0, 0.0])
    case = reference.copy()
    case["heat_input"] = ("time", ramp, reference["heat_input"].attrs)
    result = superposed(reference, case, "displacement")
    assembly = assemble(MODEL, DT, LENGTH)
    exact = blocks.linear_part(assembly, TIMES, ramp)
    assert result == pytest.approx(exact, abs=1e-11 * np.abs(exact).max())
    assert superposed(case * 0.0 + reference, reference, "temperature") == pytest.approx(
        reference["temperature"].to_numpy(), abs=1e-12
    )
    with pytest.raises(InputError, match="calibration needs a step"):
        superposed(case, reference, "displacement")
    with pytest.raises(InputError, match="shorter than the response"):
        superposed(reference.isel(time=slice(0, 500)), case, "displacement")


def test_noise_is_seeded_has_no_offset_and_the_stated_range():
    noise = sensor_noise(TIMES, 0.12, seed=7, channels=3)
    assert np.array_equal(noise, sensor_noise(TIMES, 0.12, seed=7, channels=3))
    assert not np.array_equal(noise, sensor_noise(TIMES, 0.12, seed=8, channels=3))
    assert np.ptp(noise, axis=0) == pytest.approx(0.12)
    assert np.abs(noise.mean(axis=0)).max() < 1e-3
    power = np.abs(np.fft.rfft(noise[:, 0])) ** 2
    frequency = np.fft.rfftfreq(TIMES.size, DT)
    assert power[frequency < 1.0 / 240.0].mean() < 0.01 * power[frequency > 1.0 / 30.0].mean()
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.2
    with pytest.raises(InputError, match="sensor noise"):
        sensor_noise(np.arange(100) * 60.0)


def test_noise_on_the_joint_sensors_is_attenuated_by_the_deformation(response, reference):
    noise = sensor_noise(TIMES, 0.12, seed=7, channels=2)
    noisy = {"T1": noise[:, 0], "T2": noise[:, 1]}
    quiet = validate(response, MODEL).estimate
    judged = validate(response, MODEL, reference=reference, noise=noisy)
    rows, loud = judged.rows, judged.estimate
    in_sources = np.abs(loud.sources - quiet.sources).max()
    in_displacement = np.abs(loud.nonlinear - quiet.nonlinear).max(axis=0)
    for k, axis in enumerate(AXES):
        gains = [deformation.step_response(1e7, s.deformation[axis]) for s in MODEL.sources]
        assert in_displacement[k] < 0.2 * in_sources * np.abs(gains).sum()
    assert np.array_equal(quiet.linear, loud.linear)
    assert len(rows) == 6


def test_the_joint_is_read_above_the_ambient_of_the_moment(response, reference):
    drift = 1e-3 * TIMES
    moving = response.assign(ambient=("time", drift, {"units": "K"}))
    still, seen = (
        readings(response, tuple(MODEL.linear.direct)),
        readings(moving, tuple(MODEL.linear.direct)),
    )
    assert np.array_equal(seen.delta_T, still.delta_T)
    assert seen.temperatures == pytest.approx(still.temperatures - drift[:, None], abs=1e-12)
    steady = readings(response.assign(ambient=("time", 0.0 * drift, {"units": "K"})))
    assert np.array_equal(steady.temperatures, still.temperatures)


def test_a_step_whose_ambient_moves_is_none(response, reference):
    drift = {"ambient": ("time", 1e-3 * TIMES, {"units": "K"})}
    with pytest.raises(InputError, match="the ambient moves; calibration needs"):
        superposed(reference.assign(drift), response, "displacement")
    steady = reference.assign({"ambient": ("time", 0.0 * TIMES, {"units": "K"})})
    superposed(steady, response.assign(drift), "displacement")


def test_an_unknown_probe_role_or_axis_is_named(response):
    with pytest.raises(InputError, match=r"no probe named 'T9'.*did you mean"):
        readings(response, tuple(MODEL.linear.direct), roles={"T1": "T9"})
    with pytest.raises(InputError, match="no sensor role named 'T3'"):
        readings(response, tuple(MODEL.linear.direct), noise={"T3": np.zeros(TIMES.size)})
    with pytest.raises(InputError, match="no axis named 'y'"):
        validate(response.isel(axis=[0]), MODEL)
