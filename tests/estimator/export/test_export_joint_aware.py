"""An exported joint-aware estimator is the one in Python, and near it where a sensor is faulty."""

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported import (
    PRECISIONS,
    SANITISED,
    co_simulated,
    compiled,
    counts,
    needs_gcc,
    needs_gxx,
    operations,
    selftest,
    with_no_step,
    written,
)
from in_process import run as thermojoint
from observed import (
    FAULTS,
    ONSET,
    SENSORS,
    errors,
    estimates,
    faulty,
    run,
    step,
    that_is_surprised,
    that_knows_days,
)

from estimator.export.fmu import Standard
from estimator.export.program import COMMON, Precision
from estimator.exporting import export_program
from estimator.interface import Status, follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import write_observer
from estimator.joint_aware.observer_state import unpacked
from estimator.joint_aware.program import NOT_SETTLED, READING_JUMPED
from thermojoint.artefacts.errors import InputError
from thermojoint.cli.app import app
from thermojoint.reduced.physics import simulate_known

NAN = float("nan")


@pytest.fixture(scope="module")
def samples(estimator):
    """Heat input 4 for forty minutes, then none, with noise: the joint slides to and fro."""
    model, at = estimator.model, np.arange(1, 1800)
    load = np.minimum(at / 30.0, 1.0) * (at < 1200)
    inputs = np.column_stack([4.0 * model.power * load[:, None], at / 900.0])
    read, _ = simulate_known(estimator.observer.physics, inputs, model.step)
    rows = np.vstack([np.zeros(read.shape[1] + 1), np.column_stack([read, inputs[:, -1]])])
    rows += 0.03 * np.random.default_rng(1).standard_normal(rows.shape)
    return [(k * model.step, *row) for k, row in enumerate(rows.tolist())]


@pytest.fixture(scope="module")
def expected(estimator, samples):
    states, found = zip(*follow(estimator, samples, estimator.initial_state()), strict=True)
    for k in (1000, -1):
        slip = unpacked(states[k], estimator.parts).slip
        assert np.abs(slip).max() > 0.5e-6
    return found


@pytest.fixture(scope="module")
def program(joint_aware_program, tmp_path_factory):
    return compiled(joint_aware_program, tmp_path_factory.mktemp("program"))


@needs_gcc
@pytest.mark.parametrize("precision", Precision)
def test_the_self_test_agrees_with_every_warning_and_sanitiser(
    estimator, samples, precision, tmp_path
):
    """In double precision on samples with which the joint slides and opens."""
    own = samples if precision is Precision.DOUBLE else None
    found = export_program(estimator, precision, "m", own)
    figures = selftest(written(found, tmp_path), "m", "-O1", *SANITISED)
    assert figures["state"] == found.state
    assert figures["largest displacement"] > 50e-6
    assert figures["own status words"] == 0


@needs_gcc
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_joint_that_slides_to_and_fro_is_followed(
    estimator, samples, expected, program, precision, tmp_path
):
    double = precision is Precision.DOUBLE
    estimates = program
    if not double:
        single = export_program(estimator, precision, "m")
        estimates = compiled(single, tmp_path)
    got = list(estimates([row[1:] for row in samples]))
    for name in ("displacement", "band"):
        here = np.array([list(getattr(one, name)) for one in got])
        there = np.array([getattr(one, name) for one in expected])
        allowed = 1e-12 * np.abs(there).max() if double else 0.01e-6
        assert np.abs(here - there).max() <= allowed, name
    assert [one.status & COMMON for one in got] == [int(one.status) for one in expected]
    heat = np.array([[*one.heat, one.ambient, one.lowest_pressure] for one in got])
    there = np.array([one.details[:3] for one in expected])
    np.testing.assert_allclose(
        heat, there, rtol=1e-10 if double else 1e-4, atol=1e-9 if double else 1.0
    )


@pytest.mark.long
@needs_gcc
def test_innovations_that_last_widen_the_band_as_in_python(estimator, samples, expected, tmp_path):
    surprised, rows = that_is_surprised(estimator), np.array(samples)
    rows[:, 1:3] += 0.4
    there = [one.band for _, one in follow(surprised, rows.tolist(), surprised.initial_state())]
    estimates = compiled(export_program(surprised, Precision.DOUBLE, "m"), tmp_path)
    here = np.array([list(one.band) for one in estimates(rows[:, 1:].tolist())])
    np.testing.assert_allclose(here, there, rtol=1e-9)
    assert (here[-1] > 1.05 * expected[-1].band).all()


@needs_gcc
def test_what_days_tell_of_innovations_is_as_in_python(estimator, samples, tmp_path):
    knowing, rows = that_knows_days(estimator), np.array(samples)
    rows[:, 1:3] += 0.4
    there = [one for _, one in follow(knowing, rows.tolist(), knowing.initial_state())]
    plain = [one for _, one in follow(estimator, rows.tolist(), estimator.initial_state())]
    estimates = compiled(export_program(knowing, Precision.DOUBLE, "m"), tmp_path)
    here = list(estimates(rows[:, 1:].tolist()))
    for name in ("displacement", "band"):
        got = np.array([list(getattr(one, name)) for one in here])
        wanted = np.array([getattr(one, name) for one in there])
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-15)
    assert (np.abs(there[-1].displacement - plain[-1].displacement) > 1e-7).all()


@needs_gcc
@pytest.mark.parametrize("value", [NAN, np.inf, 9.9e37, -200.0])
def test_where_a_reading_is_missing_the_machine_is_held_by_prediction_alone(
    estimator, samples, program, value
):
    """As in Python where all are missing."""
    rows, nothing = list(samples[:400]), (NAN,) * len(samples[0][1:])
    gaps = [(time, *(nothing if k >= 350 else row)) for k, (time, *row) in enumerate(rows)]
    there = [found for _, found in follow(estimator, gaps, estimator.initial_state())]
    bad = (value,) * len(nothing)
    here = list(program([bad if k >= 350 else rows[k][1:] for k in range(400)]))
    for one, other in zip(here, there, strict=True):
        assert list(one.displacement) == pytest.approx(list(other.displacement), rel=1e-9)
    assert all(one.status & Status.READING_MISSING for one in here[350:])
    assert not any(one.status & Status.READING_MISSING for one in here[:350])


def left_out(one):
    """Whether an estimate says that a reading is missing or distrusted."""
    return bool(one.status & (Status.READING_MISSING | Status.SENSOR_DISTRUSTED))


@needs_gcc
@pytest.mark.parametrize(
    "sensor", [0, pytest.param(2, marks=pytest.mark.long)], ids=lambda k: SENSORS[k]
)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_sensor_is_left_out_when_python_leaves_it_out(
    estimator, stepped, program, fault, sensor
):
    """The steady gain without it differs from the one of a covariance by less than the band."""
    rows = faulty(stepped, sensor, FAULTS[fault])[:220]
    _, there = estimates(estimator, rows)
    here = list(program([row[1:] for row in rows]))
    assert [left_out(one) for one in here] == [left_out(one) for one in there]
    assert any(left_out(one) for one in here)
    band = np.maximum(1e-6, np.array([list(one.band) for one in here]))
    moved = np.array([list(one.displacement) for one in here])
    assert (np.abs(moved - [one.displacement for one in there]) <= band).all()
    actual = stepped.isel(time=slice(0, len(rows)))
    assert (
        np.abs(moved - np.array([e.displacement for e in there]) + errors(estimator, actual, there))
        <= band
    ).all()
    late = here[ONSET + 30 :]
    assert all(one.status & Status.UNSETTLED for one in late)


@needs_gcc
def test_heat_that_is_switched_on_is_no_fault(estimator, data, setup, program):
    response = run(data, setup, step(3.0), 4.0)
    rows = faulty(response, 0, lambda values: values)
    _, there = estimates(estimator, rows)
    here = list(program([row[1:] for row in rows]))
    assert not any(left_out(one) for one in here)
    moved = np.array([list(one.displacement) for one in here])
    np.testing.assert_allclose(moved, [one.displacement for one in there], rtol=1e-9, atol=1e-15)


JUMPS = {
    "offset": lambda after: np.ones_like(after),
    "heat": lambda after: np.sqrt(1.0 + after / 3.0),
    "spike": lambda after: 1.0 * (after == 0),
}


@needs_gcc
@pytest.mark.parametrize("jump", JUMPS)
def test_a_jump_that_may_be_heat_is_judged_by_the_samples_that_follow(
    estimator, stepped, program, jump
):
    added = 1.6 * JUMPS[jump](np.arange(241))
    rows = faulty(stepped, 0, lambda values: values + added)[:150]
    _, there = estimates(estimator, rows)
    here = list(program([row[1:] for row in rows]))
    jumped = [k - ONSET for k, one in enumerate(here) if one.status & READING_JUMPED]
    assert jumped[0] == 0
    assert jumped[-1] <= 8
    for name, allowed in (("displacement", 1e-9), ("band", 1e-7)):
        got = np.array([list(getattr(one, name)) for one in here[: ONSET + 6]])
        wanted = [getattr(one, name) for one in there[: ONSET + 6]]
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=allowed)
    assert [left_out(one) for one in here] == [left_out(one) for one in there]


@needs_gcc
def test_on_a_warm_machine_the_band_is_that_of_an_unknown_past_as_in_python(
    estimator, stepped, program
):
    rows = faulty(stepped, 0, lambda values: values)[150:]
    _, there = estimates(estimator, rows)
    here = list(program([row[1:] for row in rows]))
    moved = np.array([list(one.displacement) for one in here])
    band = np.array([list(one.band) for one in here])
    actual = moved - np.array([one.displacement for one in there])
    actual += errors(estimator, stepped.isel(time=slice(150, None)), there)
    assert (np.abs(actual) <= band).all()
    assert band[0] == pytest.approx(there[0].band, rel=1e-3)
    assert (band <= 1.5 * np.array([one.band for one in there])).all()
    assert all(one.status & Status.UNSETTLED for one in here)


@needs_gcc
@pytest.mark.parametrize("sensor", [1, 2, 4], ids=lambda k: (*SENSORS, "ambient")[k])
def test_on_a_warm_machine_a_reading_may_be_missing(estimator, stepped, program, sensor):
    """The steady gain without it would take what is unknown of the past for heat, kilowatts."""
    rows = faulty(stepped, 0, lambda values: values)[150:]
    for row in rows:
        row[1 + sensor] = NAN
    _, there = estimates(estimator, rows, estimator.warm_state())
    here = list(program([row[1:] for row in rows]))
    moved = np.array([list(one.displacement) for one in here])
    np.testing.assert_allclose(moved, [one.displacement for one in there], rtol=0.0, atol=3e-6)
    # Of either one source.
    assert here[-1].heat[0] == pytest.approx(there[-1].details[0], rel=0.05)


@needs_gcc
def test_after_two_thermometers_were_away_the_past_is_unknown(estimator, program):
    """Heat has changed meanwhile, so that readings that are back contradict the prediction."""
    model, rng = estimator.model, np.random.default_rng(3)
    heat = np.repeat(rng.uniform(0.0, 2.5, 10), 70)[:, None] * model.power
    inputs = np.column_stack([heat, np.zeros(len(heat))])
    read, moved = simulate_known(estimator.observer.physics, inputs, model.step)
    rows = np.column_stack([read, inputs[:, -1]])
    rows += 0.03 * rng.standard_normal(rows.shape)
    rows[100:300, 1:3] = np.nan
    found = list(program(rows.tolist()))
    off = np.array([one.displacement for one in found]) - moved
    band = np.array([one.band for one in found])
    assert all(one.status & Status.UNSETTLED for one in found[300:])
    assert not any(one.status & Status.SENSOR_DISTRUSTED for one in found[305:])
    assert np.all(np.abs(off[300:]) <= band[300:])
    assert np.all(band[400:] < 50e-6)


@needs_gcc
@pytest.mark.parametrize("away", [1, 15, 150])
@pytest.mark.parametrize("sensors", [[1], [1, 2, 3, 4, 5]], ids=["one", "all"])
def test_readings_that_are_back_leave_a_band_that_decays(
    estimator, samples, program, sensors, away
):
    """No narrower than in Python, whose gain of a covariance finds what was missed sooner."""
    rows, back = np.array(samples[:900]), 300 + away
    rows[300:back, sensors] = NAN
    _, there = estimates(estimator, rows.tolist())
    found = list(program(rows[:, 1:].tolist()))
    here, usual = np.array([one.band for one in found]), there[299].band
    assert (here[back:] >= (1.0 - 1e-9) * np.array([one.band for one in there[back:]])).all()
    assert (np.diff(here[back + 1 :], axis=0) <= 1e-3 * usual).all()
    assert (here[back + 1] > 5.0 * usual).all()
    assert (here[-1] < 0.5 * here[back + 1]).all()
    told = np.array([bool(one.status & Status.UNSETTLED) for one in found])
    without = np.array([one.band for one in program(np.array(samples[:900])[:, 1:].tolist())])
    assert told[(here > 1.45 * without).any(axis=1)].all()
    assert not told[900 - 1] or (here[-1] > 1.35 * without[-1]).any()
    if away == 1:
        assert here[-1] == pytest.approx(usual, rel=0.01)


@needs_gcc
def test_heat_that_no_source_has_is_a_bad_estimate(estimator, program):
    """Ten times the largest calibrated heat, slowly enough for no thermometer to be distrusted."""
    model, share = estimator.model, np.linspace(0.0, 10.0, 1200)[1:]
    heat = share[:, None] * model.calibrated.heat * model.power
    inputs = np.column_stack([heat, np.zeros(len(heat))])
    read, _ = simulate_known(estimator.observer.physics, inputs, model.step)
    rows = np.vstack([np.zeros(read.shape[1] + 1), np.column_stack([read, inputs[:, -1]])])
    samples = [(k * model.step, *row) for k, row in enumerate(rows.tolist())]
    _, there = estimates(estimator, samples)
    lost = np.array([bool(one.status & Status.READINGS_LOST) for one in there[1:]])
    assert not lost[share < 4.9].any()
    assert lost[share > 5.5].all()
    found = [bool(one.status & Status.READINGS_LOST) for one in program(rows.tolist())]
    assert found[1:] == lost.tolist()


@needs_gcc
def test_long_silence_is_said(stepped, program):
    rows = [row[1:] for row in faulty(stepped, 0, lambda values: values)]
    quiet = list(program([*rows[:60], *[[NAN] * len(rows[0])] * 1000]))
    lost = [bool(one.status & Status.READINGS_LOST) for one in quiet]
    assert not any(lost[:950])
    assert all(lost[970:])
    assert list(quiet[-1].band) > [3.0 * one for one in quiet[59].band]


@needs_gcc
def test_a_joint_that_needs_more_newton_steps_stays_and_says_so(
    joint_aware_program, samples, tmp_path
):
    found = with_no_step(joint_aware_program)
    for one in list(compiled(found, tmp_path)([row[1:] for row in samples[:40]]))[1:]:
        assert one.status & NOT_SETTLED
        assert one.status & Status.UNSETTLED
        assert one.newton_steps == -1
        assert one.lowest_pressure == one.highest_pressure > 0.0
        assert np.isfinite(list(one.displacement)).all()


@needs_gcc
def test_names_that_c_does_not_have_are_made_fit_and_no_comment_is_ended(
    estimator, samples, tmp_path
):
    def renamed(*names):
        known = estimator.model.calibrated
        ranges = dict(zip(names, known.temperatures.values(), strict=True))
        calibrated = replace(known, temperatures=ranges)
        return JointAware(replace(estimator.model, sensors=names, calibrated=calibrated))

    strange = renamed("spindle-front", "b 1", 'T"1', "T<2>*/")
    found = export_program(strange, Precision.DOUBLE, "m", samples[:5], "my */ log.csv")
    selftest(written(found, tmp_path), "m", "-O0")
    assert [one.name for one in found.interface.inputs[:2]] == ["spindle_front", "b_1"]
    with pytest.raises(InputError, match="not distinct"):
        export_program(renamed("T-1", "T 1", "b", "s"), Precision.DOUBLE, "m", samples[:5])


@pytest.mark.long
@needs_gxx
def test_a_program_is_also_part_of_a_project_in_cpp(joint_aware_program, tmp_path):
    written(joint_aware_program, tmp_path)
    command = ["g++", "-x", "c++", "-std=c++17", "-pedantic", "-Wall", "-Wextra", "-Werror"]
    sources = ["m.c", "m_selftest.c"]
    subprocess.run([*command, "-fsyntax-only", *sources], cwd=tmp_path, check=True)


@needs_gxx
def test_no_sample_costs_more_than_is_printed(joint_aware_program, samples, tmp_path):
    found = joint_aware_program
    rows = ",\n".join("{" + ", ".join(map(repr, row[1:])) + "}" for row in samples[:900])
    body = f"""
static const m_real rows[900][5] = {{ {rows} }};
int main() {{ static m_state state; static m_estimate found;
  m_init(&state);
  for (int k = 0; k < 900; k++) {{ CLEAR(); m_step(&state, rows[k], &found); PRINT(); }} }}
"""
    counted = np.array(counts(found, tmp_path, "m", body))
    assert (counted <= operations(found.worst)).all()
    usual = np.array(operations(found.usual))
    assert (counted.min(axis=0) <= usual).all()
    assert (np.median(counted, axis=0) >= 0.3 * usual).all()


def test_a_log_to_which_the_program_has_no_answer_is_no_self_test(estimator, samples):
    few, step = samples[:20], estimator.model.step
    late = [*few[:10], *((row[0] + 0.3 * step, *row[1:]) for row in few[10:])]
    missing = [*few[:10], (few[10][0], NAN, *few[10][2:])]
    for rows in (late, missing):
        with pytest.raises(InputError, match="late or has a reading missing"):
            export_program(estimator, Precision.DOUBLE, "m", rows)
    lying = [(row[0], row[1] + (500.0 if k == 15 else 0.0), *row[2:]) for k, row in enumerate(few)]
    with pytest.raises(InputError, match="sensor-distrusted"):
        export_program(estimator, Precision.DOUBLE, "m", lying)


@pytest.mark.parametrize(
    ("option", "said"),
    [("--interval-s", "is made for 2 s"), ("--run-length-min", "not for a joint-aware model")],
)
def test_what_its_model_has_is_not_an_option(estimator, tmp_path, capsys, option, said):
    """A program that is called every 10 s but steps by 2 s is wrong by a factor of five."""
    write_observer(estimator.model, tmp_path / "model.h5")
    out = tmp_path / "program"
    assert thermojoint("export", tmp_path / "model.h5", "--out", out, option, 10) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()
    if option == "--interval-s":
        assert thermojoint("export", tmp_path / "model.h5", "--out", out, option, 2) == 0


@needs_gcc
def test_the_command_exports_a_joint_aware_model_with_a_log(estimator, samples, tmp_path, capsys):
    write_observer(estimator.model, tmp_path / "model.h5")
    header = ",".join(["time_s", *(f"{name}_K" for name in SENSORS), "ambient_K"])
    lines = "\n".join(",".join(map(repr, row)) for row in samples[:60])
    (tmp_path / "log.csv").write_text(f"{header}\n{lines}\n")
    names = [str(tmp_path / name) for name in ("model.h5", "program", "log.csv")]
    arguments = ["export", names[0], "--out", names[1], "--samples", names[2], "--name", "m"]
    app(arguments, standalone_mode=False)
    assert "Newton" in capsys.readouterr().out
    figures = selftest(Path(names[1]), "m", "-O1")
    assert figures["samples"] == 60


@needs_gcc
def test_as_a_unit_for_co_simulation_it_says_the_same(
    estimator, joint_aware_program, samples, expected, tmp_path
):
    # A sample at t holds over the step that ends at t.
    rows = [(time - estimator.model.step, *values) for time, *values in samples[:60]]
    moved = co_simulated(joint_aware_program, tmp_path / "m.fmu", Standard.FMI2, rows)
    there = [one.displacement[0] for one in expected[: len(moved)]]
    assert moved == pytest.approx(there, rel=1e-9, abs=1e-15)


@needs_gcc
@pytest.mark.parametrize("sensor", [1, 2, 3, 4, 5])
def test_a_reading_that_is_missing_briefly_changes_as_little_as_in_python(
    estimator, samples, program, sensor
):
    """Also where another one jumps, from which heat would be found after a longer absence."""
    rows = np.array(samples[:600])
    rows[200:203, sensor] = NAN
    rows[200:203, 1 + sensor % 4] += 0.5
    _, there = estimates(estimator, rows.tolist())
    found = list(program(rows[:, 1:].tolist()))
    off = [np.subtract(list(found[k].displacement), there[k].displacement) for k in (200, 201, 202)]
    assert np.abs(off).max() < 0.02e-6
