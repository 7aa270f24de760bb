"""An exported learned model is the one in Python where no displacement is read."""

from dataclasses import replace

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
    written,
)
from machine_logs import as_csv, machine_log

from calibrate.learning.thinning import DRIVES
from estimator.columns import samples_of
from estimator.export.fmu import Standard, fmi_files
from estimator.export.program import REFUSED, Precision
from estimator.export.recorded import MOST, duty_cycle
from estimator.exporting import export_program
from estimator.interface import Status, follow
from estimator.learned.estimator import Learned
from estimator.learned.program import gains
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import UNITS
from thermojoint.cli.app import app
from thermojoint.models.filters.relaxations import relaxed
from thermojoint.models.learned import LogEnd, read_learned, write_learned

NAN = float("nan")
DT = 60.0
#: Another day: other speeds, another clock.
DAY = machine_log(hours=24.0, seed=5, start=500000.0)


@pytest.fixture(scope="module")
def samples(learned):
    return list(samples_of(learned.model.columns, [DAY]))


@needs_gcc
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_day_that_was_not_learned_is_the_same_in_c(learned, samples, precision, tmp_path):
    found = export_program(learned, precision, "m", samples, interval=DT)
    figures = selftest(written(found, tmp_path), "m", "-O1", *SANITISED)
    assert figures["samples"] == len(samples) == 1440
    assert figures["state"] == found.state
    worst, largest = figures["largest difference"], figures["largest displacement"]
    assert largest > 5e-6
    assert worst <= (1e-12 * largest if precision is Precision.DOUBLE else 0.01e-6)


@needs_gcc
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_log_with_missing_readings_is_a_self_test(learned, samples, precision, tmp_path):
    gaps = [
        (time, *(NAN if 20 < k < 60 and k % 3 == c else value for c, value in enumerate(values)))
        for k, (time, *values) in enumerate(samples[:100])
    ]
    found = export_program(learned, precision, "m", gaps, interval=DT)
    assert Status.READING_MISSING in Status(found.kept.words[30])
    selftest(written(found, tmp_path), "m", "-O1", *SANITISED)


@needs_gcc
@pytest.mark.parametrize("precision", PRECISIONS)
def test_it_holds_at_any_interval_and_over_gaps(learned, precision, tmp_path):
    found = export_program(learned, precision, "m", interval=2.0)
    selftest(written(found, tmp_path), "m", "-O2", *SANITISED)


def test_the_gains_of_an_interval_are_those_of_the_relaxation():
    taus = np.array([0.0, 1e5, 900.0, 60.0, 59.0, 2.0])
    before, old, new = np.zeros((3, 6)) + np.array([[1.0], [3.0], [-2.0]])
    g, h = gains(taus, 60.0).T
    ours = np.where(taus > 0.0, before + g * (old - before) + h * (new - old), new)
    np.testing.assert_allclose(ours, relaxed(before, old, new, 60.0, taus), rtol=1e-12)


@pytest.fixture(scope="module")
def program(learned, tmp_path_factory):
    """Gives what the compiled program says of samples, from its start on."""
    found = export_program(learned, Precision.DOUBLE, "m", interval=DT)
    estimates = compiled(found, tmp_path_factory.mktemp("program"))

    def run(samples):
        rows = np.array(samples)
        rows[:, 0] = np.diff(rows[:, 0], prepend=rows[0, 0] - DT)
        return estimates(rows.tolist())

    return run


@needs_gcc
def test_missing_readings_bands_and_status_are_those_of_python(learned, program, samples):
    draw, rows = np.random.default_rng(1), []
    for k, (time, *values) in enumerate(samples[:400]):
        if 30 < k < 60 or k == 0:
            values[draw.integers(len(values))] = NAN
        if k in (70, 71):  # a logger's 9999 °C, and what an open thermocouple gives
            values[0] = (9999.0 if k == 70 else -3276.8) + 273.15
        if 120 <= k < 250:
            values = [NAN] * len(values)
        time += 3.0 * 3600.0 * (k >= 300)  # nobody sees what happens meanwhile
        rows.append((time, *(value + (40.0 if k > 350 else 0.0) for value in values)))
    plain = Learned(replace(learned.model, log_end=None))
    states = set()
    warm = int(np.argmax([row[1] for row in samples[:1400]]))
    for run in (rows, samples[warm:]):
        for got, (_, there) in zip(
            program(run), follow(plain, run, plain.initial_state()), strict=True
        ):
            np.testing.assert_allclose(list(got.displacement), there.displacement, rtol=1e-11)
            np.testing.assert_allclose(list(got.band), there.band, rtol=1e-11)
            assert got.status == there.status
            states.add(Status(got.status))
    for one in (Status.READING_MISSING, Status.BEYOND_TEMPERATURE, Status.READINGS_LOST):
        assert any(one in status for status in states)
    assert any(Status.UNSETTLED in one and Status.READING_MISSING not in one for one in states)


@needs_gcc
@pytest.mark.parametrize("interval", [0.0, -1.0, NAN, np.inf])
def test_time_that_does_not_go_on_changes_nothing(program, samples, interval):
    first, second = samples[:2]
    plain = list(program([first, second]))[-1]
    rows = [first, (first[0] + interval, *second[1:])]
    assert list(program(rows))[-1].status == REFUSED
    assert plain.status != REFUSED


def test_it_starts_a_run_wherever_the_log_ended(learned, samples):
    model = learned.model
    end = LogEnd(samples[0][0] - DT, samples[0][1:], (5.0,) * len(model.features))
    going_on = export_program(Learned(replace(model, log_end=end)), "double", "m", samples[:9])
    fresh = export_program(Learned(replace(model, log_end=None)), "double", "m", samples[:9])
    np.testing.assert_array_equal(going_on.kept.compared, fresh.kept.compared)


@needs_gxx
def test_no_sample_costs_more_than_is_printed(learned, samples, tmp_path):
    found = export_program(learned, Precision.DOUBLE, "m", interval=DT)
    readings = ", ".join(map(repr, samples[50][1:]))
    body = f"""
int main() {{ static m_state state; static m_estimate found;
  const m_real readings[] = {{ {readings} }};
  const double intervals[] = {{60.0, 60.0, 0.01, 61.0, 7.0, 600.0, 1e5}};
  m_init(&state);
  for (double one : intervals) {{ CLEAR(); m_step(&state, one, readings, &found); PRINT(); }} }}
"""
    counted = np.array(counts(found, tmp_path, "m", body))
    usual, worst = np.array(operations(found.usual)), np.array(operations(found.worst))
    assert (counted[:2] <= usual).all()
    assert (counted[1, :2] >= 0.8 * usual[:2]).all()
    assert (counted <= worst).all()
    assert counted[2:, 0].max() > 0.7 * worst[0]


@needs_gcc
def test_the_command_exports_a_learned_model_with_a_log(learned, tmp_path, capsys):
    write_learned(learned.model, tmp_path / "model.json")
    as_csv(DAY.part(slice(0, 100)), tmp_path / "log.csv")
    names = [str(tmp_path / name) for name in ("model.json", "program", "log.csv")]
    arguments = ["export", names[0], "--out", names[1], "--samples", names[2], "--interval-s", "60"]
    app([*arguments, "--name", "m"], standalone_mode=False)
    assert "multiplications" in capsys.readouterr().out
    figures = selftest(tmp_path / "program", "m", "-O1")
    assert figures["samples"] == 100


@needs_gcc
def test_as_a_unit_for_co_simulation_it_says_the_same(learned, samples, tmp_path):
    found = export_program(learned, Precision.DOUBLE, "m", interval=DT)
    rows = [(DT * k, *values) for k, (_, *values) in enumerate(samples[:60])]
    moved = co_simulated(found, tmp_path / "m.fmu", Standard.FMI3, rows)
    plain = Learned(replace(learned.model, log_end=None))
    there = [e.displacement[0] for _, e in follow(plain, rows, plain.initial_state())]
    assert moved == pytest.approx(there[: len(moved)], rel=1e-9)


@needs_gcc
@pytest.mark.parametrize("unit", [name for name, own in UNITS.items() if own.quantity in DRIVES])
def test_a_unit_for_co_simulation_has_the_unit_of_every_reading(learned, tmp_path, unit):
    path = tmp_path / "model.json"
    write_learned(learned.model, path)
    path.write_text(path.read_text("utf-8").replace("n_rpm", f"n_{unit}"), "utf-8")
    model = Learned(read_learned(path))
    assert f"n_{unit}" in model.model.columns
    program = export_program(model, name="m", interval=DT)
    (own,) = (one.unit for one in program.interface.inputs if one.name == "n")
    text = fmi_files(program, Standard.FMI3)["modelDescription.xml"]
    assert f'<Unit name="{own}"><BaseUnit' in text


def test_a_short_interval_needs_no_more_samples_for_its_self_test_than_are_compiled_in():
    # A day of it would be 3e12 samples.
    duty = duty_cycle([(0.0, 10.0)], 1e-9)
    assert len(duty) == MOST
    assert (np.diff(duty[:, 0]) > 0.0).all()


def test_an_interval_that_is_none_is_refused(learned):
    with pytest.raises(InputError, match="give a positive one"):
        export_program(learned, Precision.DOUBLE, "m", interval=0.0)
