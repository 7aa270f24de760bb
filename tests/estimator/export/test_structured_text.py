"""An estimator in Structured Text is the estimator: held to strict rules, and run."""

import math
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import structured_text
from exported import PRECISIONS, compiled, needs_gcc, with_no_step
from machine_logs import machine_log
from matiec import needs_matiec, selftest_by_matiec
from observed import estimates, faulty, that_is_surprised, that_knows_days
from structured_text import FLAGS, Translator, called, parsed, run

from estimator.columns import samples_of
from estimator.export.program import Precision
from estimator.export.structured_text import decimal, literal, st_files
from estimator.exporting import export_program
from estimator.fchs.estimator import Fchs
from estimator.interface import Status, follow
from estimator.joint_aware import program as joint_aware
from estimator.measured import response_samples
from thermojoint.cli.app import app
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly

pytest.importorskip("tree_sitter_iec61131_3_st", reason="needs tree-sitter-iec61131-3-st")
pytestmark = needs_gcc
DT = 20.0


def agrees(program, folder, flags=FLAGS):
    """Run the self-test; it must agree as closely as it is meant to."""
    figures = run(st_files(program), program.name, folder, flags)
    assert figures["samples"] == program.samples
    assert figures["differing"] == 0
    double = program.precision is Precision.DOUBLE
    allowed = 1e-12 * figures["largest displacement"] if double else 0.01e-6
    assert figures["largest difference"] <= allowed
    return figures


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_day_of_the_coarse_machine_is_the_same(fchs, coarse_day, precision, tmp_path):
    samples = list(response_samples(coarse_day, fchs.assembly.model))[6::6]
    figures = agrees(export_program(fchs, precision, "spindle", samples), tmp_path)
    assert figures["samples"] == 720


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_leaking_estimator_is_the_same_at_any_interval(hand_made_model, precision, tmp_path):
    model = Fchs(assemble(replace(hand_made_model, leak=1.0 / 7200.0), DT, 7200.0))
    agrees(export_program(model, precision, "spindle"), tmp_path)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_day_that_was_not_learned_is_the_same(learned, precision, tmp_path):
    log = machine_log(hours=24.0, interval=240.0, seed=5, start=500000.0)
    samples = list(samples_of(learned.model.columns, [log]))
    agrees(export_program(learned, precision, "m", samples, interval=240.0), tmp_path / "even")
    agrees(export_program(learned, precision, "m"), tmp_path / "uneven")


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_joint_aware_estimator_is_the_same(estimator, precision, tmp_path):
    duty = list(joint_aware.contents(estimator, precision).duty())[:300]
    agrees(export_program(estimator, precision, "machine", duty), tmp_path)


@pytest.mark.long
def test_innovations_that_last_widen_the_band_as_in_python(estimator, tmp_path):
    wider = that_is_surprised(estimator)
    duty = np.array(list(joint_aware.contents(wider, Precision.DOUBLE).duty())[:200])
    duty[:, 1:3] += 0.4
    agrees(export_program(wider, Precision.DOUBLE, "machine", duty.tolist()), tmp_path)
    bands = [one.band for _, one in follow(wider, duty.tolist(), wider.initial_state())]
    plain = [one.band for _, one in follow(estimator, duty.tolist(), estimator.initial_state())]
    assert (bands[-1] > 1.0001 * plain[-1]).all()


@pytest.mark.long
def test_what_days_tell_of_innovations_is_as_in_python(estimator, tmp_path):
    knowing = that_knows_days(estimator)
    duty = np.array(list(joint_aware.contents(knowing, Precision.DOUBLE).duty())[:200])
    duty[:, 1:3] += 0.4
    agrees(export_program(knowing, Precision.DOUBLE, "machine", duty.tolist()), tmp_path)


@needs_matiec
@pytest.mark.parametrize(
    "kind",
    [
        "learned",
        *(pytest.param(kind, marks=pytest.mark.long) for kind in ("fchs", "joint_aware_program")),
    ],
)
def test_matiec_compiles_it_and_it_is_the_same(kind, request, tmp_path):
    """That compiler runs a loop of a single pass not at all."""
    program = request.getfixturevalue(kind)
    if kind != "joint_aware_program":
        program = export_program(program, Precision.DOUBLE, "m")
    figures = selftest_by_matiec(st_files(program), "m", tmp_path)
    assert figures["agrees"] == 1
    assert figures["samples"] == program.samples


def test_a_joint_that_needs_more_newton_steps_stays_and_says_so(joint_aware_program, tmp_path):
    last = called(with_no_step(joint_aware_program), tmp_path, [{}] * 40, ("newton_steps",))[-1]
    assert last["status"] & joint_aware.NOT_SETTLED
    assert last["status"] & Status.UNSETTLED
    assert last["newton_steps"] == -1
    assert math.isfinite(last["displacement_x"])


def test_readings_that_are_back_leave_the_band_of_the_program_in_c(joint_aware_program, tmp_path):
    inputs = joint_aware_program.interface.inputs
    rows = joint_aware_program.kept.samples[:90, 1:].copy()
    rows[20:40, 0] = rows[60:65] = -1e9
    calls = [{f"reading_{one.name}": v for one, v in zip(inputs, row, strict=True)} for row in rows]
    found = called(joint_aware_program, tmp_path, calls)
    expected = list(compiled(joint_aware_program, tmp_path / "c")(rows.tolist()))
    assert [one["band_x"] for one in found] == pytest.approx([one.band[0] for one in expected])
    assert found[66]["band_x"] > found[59]["band_x"] > 2.0 * found[10]["band_x"]


def test_on_a_warm_machine_a_reading_may_be_missing(estimator, stepped, tmp_path):
    rows = np.array(faulty(stepped, 0, np.copy))[150:190]
    program = export_program(estimator, Precision.DOUBLE, "machine", [*(rows - rows[0]).tolist()])
    rows[:, 2] = math.nan
    names = [f"reading_{one.name}" for one in program.interface.inputs]
    read = np.nan_to_num(rows[:, 1:], nan=-1e9).tolist()
    found = called(program, tmp_path, [dict(zip(names, row, strict=True)) for row in read])
    _, there = estimates(estimator, rows.tolist(), estimator.warm_state())
    for one, other in zip(found, there, strict=True):
        assert one["displacement_x"] == pytest.approx(other.displacement[0], rel=0.0, abs=3e-6)


@pytest.mark.long
def test_faulty_sensors_are_left_out_as_in_python(estimator, stepped, tmp_path):
    """Three runs: one thermometer lies and another jumps; one is away; it begins when warm."""
    every = np.array(faulty(stepped, 0, np.copy))
    healthy, warm = every[:45], every[150:195]
    lying, away = healthy.copy(), healthy.copy()
    lying[20:, 3] += 5.0
    lying[30, 1] += 1.6
    away[20:35, 1] = math.nan
    program = export_program(estimator, Precision.DOUBLE, "machine", [*healthy.tolist()])
    program = replace(
        program, kept=replace(program.kept, samples=np.tile(program.kept.samples, (3, 1)))
    )
    names = [f"reading_{one.name}" for one in program.interface.inputs]
    rows = np.nan_to_num(np.vstack((lying, away, warm))[:, 1:], nan=-1e9).tolist()
    calls = [dict(zip(names, row, strict=True)) for row in rows]
    calls[len(healthy)]["reset"] = calls[-len(warm)]["reset"] = 1
    found = called(program, tmp_path, calls)
    there = [one for run in (lying, away, warm) for one in estimates(estimator, run.tolist())[1]]
    gone = Status.READING_MISSING | Status.SENSOR_DISTRUSTED
    flagged = [bool(one["status"] & gone) for one in found]
    assert flagged == [bool(one.status & gone) for one in there]
    assert flagged.count(True) == 25 + 15
    assert any(one["status"] & joint_aware.READING_JUMPED for one in found)
    begun = found[-len(warm) :]
    assert all(one["status"] & Status.UNSETTLED for one in begun)
    assert begun[0]["band_x"] == pytest.approx(there[-len(warm)].band[0], rel=1e-3)
    for one, other in zip(found, there, strict=True):
        assert abs(one["displacement_x"] - other.displacement[0]) <= max(1e-7, one["band_x"])


def test_what_is_no_temperature_is_left_out_and_the_next_sample_covers_the_gap(fchs, tmp_path):
    program = export_program(
        fchs, Precision.DOUBLE, "spindle", [(DT * k, k, 0.1, 0.2) for k in range(1, 8)]
    )
    bad = [{"reading_T1": value} for value in ("NAN", "INFINITY", "-6000.0")]
    found = called(program, tmp_path, [{}, *bad, {"interval": 0.0}, {}, {"reset": 1}])
    assert [one["status"] for one in found[1:5]] == [0x8000] * 4
    assert {one["displacement_x"] for one in found[1:5]} == {found[0]["displacement_x"]}
    # The good sample comes four intervals after the last good one: that of 0 s does not count.
    state, _ = fchs.sample(fchs.initial_state(), DT, (1, 0.1, 0.2))
    _, there = fchs.sample(state, 5 * DT, (6, 0.1, 0.2))
    assert found[5]["displacement_x"] == pytest.approx(there.displacement[0], rel=1e-11)
    _, fresh = fchs.sample(fchs.initial_state(), DT, (7, 0.1, 0.2))
    assert found[6]["displacement_x"] == pytest.approx(fresh.displacement[0], rel=1e-11)


def test_missing_readings_a_pause_and_a_warm_machine_are_said_as_in_python(learned, tmp_path):
    ends = zip(*(learned.model.spans[name] for name in learned.model.columns), strict=True)
    cold, warm = (list(values) for values in ends)
    times = [0.0, 60.0, 120.0, 4000.0, 7500.0, 7560.0, 7620.0, 30000.0, 30060.0]
    values = [cold, cold, cold, cold, cold, cold, warm, warm, warm]
    samples = [(time, *row) for time, row in zip(times, values, strict=True)]
    program = export_program(learned, Precision.DOUBLE, "m", samples, interval=60.0)
    names = [f"reading_{one.name}" for one in program.interface.inputs]
    # One is away, by two codes, then all are.
    calls = [{}, {names[0]: "NAN"}, {names[0]: 10272.15}, *[dict.fromkeys(names, 1e31)] * 2]
    read = np.array(samples)
    read[1:3, 1] = read[3:5, 1:] = math.nan
    found = called(program, tmp_path, [*calls, {}, {}, {}, {}])
    plain = replace(learned, model=replace(learned.model, log_end=None))
    there = [one for _, one in follow(plain, read.tolist(), plain.initial_state())]
    assert [one["status"] for one in found] == [int(one.status) for one in there]
    assert Status.READINGS_LOST in there[4].status
    assert Status.UNSETTLED in there[-1].status
    for one, other in zip(found, there, strict=True):
        for k, axis in enumerate(program.interface.axes):
            assert one[f"displacement_{axis}"] == pytest.approx(other.displacement[k], rel=1e-9)
            assert one[f"band_{axis}"] == pytest.approx(other.band[k], rel=1e-9)


def test_the_complementary_error_function_is_good_to_the_last_digits(joint_aware_program, tmp_path):
    text = structured_text.in_c(st_files(joint_aware_program)["m.st"])
    text += r"""
int main(void)
{ for (int k = -600; k < 2660; k++) printf("%.17g\n", f_m_erfc(k / 100.0 + 1e-3)); }
"""
    (tmp_path / "e.c").write_text(text, encoding="utf-8")
    subprocess.run(["gcc", *FLAGS, "e.c", "-lm", "-o", "e"], cwd=tmp_path, check=True)
    done = subprocess.run(["./e"], cwd=tmp_path, check=True, capture_output=True, text=True)
    got = np.array([float(line) for line in done.stdout.split()])
    there = np.array([math.erfc(k / 100.0 + 1e-3) for k in range(-600, 2660)])
    near = there > 1e-300
    np.testing.assert_allclose(got[near], there[near], rtol=2e-15)


def test_the_command_writes_a_folder_that_runs(fchs, tmp_path, capsys):
    write_assembly(fchs.assembly, tmp_path / "estimator.json")
    names = [str(tmp_path / name) for name in ("estimator.json", "program")]
    app(
        ["export", names[0], "--to", "st", "--out", names[1], "--name", "Spindle_2"],
        standalone_mode=False,
    )
    assert "multiplications" in capsys.readouterr().out
    files = {one.name: one.read_text("utf-8") for one in Path(names[1]).glob("*.st")}
    assert set(files) == {"Spindle_2.st", "Spindle_2_selftest.st"}
    figures = run(files, "Spindle_2", tmp_path / "run")
    assert figures["samples"] > 500


@pytest.mark.parametrize("precision", Precision)
@pytest.mark.parametrize("value", [0.1, -1e-30, 3.0, 1e22, 2.0**-120, 0.0])
def test_numbers_have_a_point_and_come_back_to_the_last_bit(value, precision):
    text = decimal(value, precision)
    assert "." in text.split("E")[0]
    number = np.float64 if precision is Precision.DOUBLE else np.float32
    assert number(text) == number(value)
    assert literal(value, precision).strip("(-").startswith(("LREAL#", "REAL#"))


GOOD = """
FUNCTION_BLOCK FB_a
VAR_INPUT x : LREAL; END_VAR
VAR_OUTPUT y : LREAL; END_VAR
VAR CONSTANT c : ARRAY [0..1] OF LREAL := [1.0, 2.0]; END_VAR
VAR k : DINT; w : WORD; END_VAR
FOR k := 0 TO 1 DO y := y + c[k] * x; END_FOR;
END_FUNCTION_BLOCK
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("c[k] * x", "c[k] * k", "LREAL \\* DINT"),
        ("c[k] * x", "c[k] * 2.0", "has its type"),
        ("c[k] * x", "c[k] * REAL#2.0", "LREAL \\* REAL"),
        ("c[k] * x", "c[k] * z", "not declared"),
        ("c[k] * x", "c[x]", "not DINT"),
        ("y := y", "x := y", "variable of its own"),
        ("y := y", "c[0] := y", "variable of its own"),
        ("y := y", "k := 2; y := y", "variable of a loop"),
        ("[1.0, 2.0]", "[1.0, 2.0, 3.0]", "3 initial values for 2"),
        ("[1.0, 2.0]", "[1.0, 2]", "DINT, not LREAL"),
        ("w : WORD", "X : WORD", "taken"),
        ("w : WORD", "w__1 : WORD", "not a name"),
        ("w : WORD", "ton : WORD", "reserved"),
        ("c[k] * x;", "c[k] * x", "grammar refuses"),
    ],
)
def test_what_a_strict_system_refuses_is_refused_here(old, new, said):
    Translator().program(parsed(GOOD))
    assert old in GOOD
    with pytest.raises(AssertionError, match=said):
        Translator().program(parsed(GOOD.replace(old, new)))


def test_an_index_beyond_its_array_stops_the_run(tmp_path):
    text = structured_text.in_c(GOOD.replace("0 TO 1 DO", "0 TO 2 DO"))
    text += "int main(void) { static fb_a_t one; fb_a(&one); }"
    (tmp_path / "b.c").write_text(text, encoding="utf-8")
    subprocess.run(["gcc", *FLAGS, "b.c", "-lm", "-o", "b"], cwd=tmp_path, check=True)
    done = subprocess.run(["./b"], cwd=tmp_path, check=False, capture_output=True, text=True)
    assert done.returncode != 0
    assert "2 of 2" in done.stderr
