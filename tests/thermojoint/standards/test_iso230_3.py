"""The thermal tests of ISO 230-3: their parameters, their cases, their command."""

import json
import tomllib
from dataclasses import replace
from importlib.resources import files
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fesim.case.schema import parse_case
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log_file import read_log
from thermojoint.artefacts.response import write_response
from thermojoint.standards.iso230_3.evaluation import evaluate
from thermojoint.standards.iso230_3.extremes import extremes
from thermojoint.standards.iso230_3.figure import figure_of
from thermojoint.standards.iso230_3.parameters import distortion, unsettled
from thermojoint.standards.iso230_3.period import Period, running
from thermojoint.standards.iso230_3.protocol import Protocol
from thermojoint.standards.iso230_3.record import (
    Record,
    log_record,
    response_record,
    with_second,
    with_tilts,
)
from thermojoint.standards.iso230_3.report import parameters_json, report_html

CASES = files("thermojoint").joinpath("cases")
NAMES = ("etve", "spindle", "spindle_rear", "spectrum")
HOUR = 3600.0

signals = st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=20).map(np.array)


def warm_up(step=30.0, rest=2 * HOUR, tau=HOUR, final=100e-6, running=4 * HOUR):
    """Running after half an hour of standstill, then rest: a first-order machine."""
    begin, end = 0.5 * HOUR, 0.5 * HOUR + running
    times = np.arange(0.0, end + rest + step, step)
    on = np.clip(times, begin, end) - begin
    grown = final * -np.expm1(-on / tau) * np.exp(-np.maximum(times - end, 0.0) / tau)
    drive = ((times > begin) & (times <= end)).astype(float)
    return Record(times, {"X": grown, "X2": 0.4 * grown}, {"nose": 20.0 + 1e5 * grown}, {}, drive)


def by_symbol(evaluation):
    return {one.symbol: one.value for one in evaluation.parameters}


def test_a_first_order_machine_has_the_parameters_of_its_exponential():
    found = by_symbol(evaluate(Protocol.SPINDLE, warm_up()))
    assert found["d(X)60"] == pytest.approx(100e-6 * (1 - np.exp(-1)), rel=1e-9, abs=0)
    assert found["d(X)t"] == pytest.approx(100e-6 * (1 - np.exp(-4)), rel=1e-9, abs=0)
    assert found["ΔT(nose)60"] == pytest.approx(10 * (1 - np.exp(-1)), rel=1e-9)


def test_the_running_period_is_from_the_first_to_the_last_motion():
    record = warm_up()
    period = evaluate(Protocol.SPINDLE, record).period
    assert period == pytest.approx((0.5 * HOUR, 4.5 * HOUR))
    stops = record.drive * (np.sin(record.times / 300.0) > -0.5)
    assert running(record.times, stops).begin == period.begin


def test_a_measured_speed_that_is_never_quite_zero_stands_still(tmp_path):
    """The jitter of an encoder once began the period in the first sample."""
    record, path = warm_up(), tmp_path / "log.csv"
    measured = 3000.0 * record.drive + np.resize([1.5, -0.5, 0.0], record.times.shape)
    for drive in (measured, -measured):
        rows = "".join(f"{t:g},{v:g},1\n" for t, v in zip(record.times, drive, strict=True))
        path.write_text("time_s,n_rpm,x_um\n" + rows)
        logged = log_record(read_log([path]))
        assert running(logged.times, logged.drive) == running(record.times, record.drive)


def test_a_simulated_test_runs_however_little_it_is_driven_at_first():
    """Heat inputs of 1 and friction of hundreds of watts are one signal."""
    record = warm_up()
    unequal = record.drive * np.where(record.times < HOUR, 1.0, 500.0)
    assert running(record.times, unequal) == running(record.times, record.drive)


def test_what_still_moves_at_the_end_is_told_relative_to_the_first_hour():
    record = warm_up()
    period = Period(0.5 * HOUR, 4.5 * HOUR)
    assert unsettled(record, period)["X"] == pytest.approx(np.exp(-3), rel=1e-9)


@given(signals, st.floats(-1e3, 1e3))
def test_a_range_does_not_know_where_a_sensor_was_zeroed(values, offset):
    times = np.arange(values.size, dtype=float)
    one, other = (extremes(times, v, 0.0, times[-1], "x") for v in (values, values + offset))
    assert other.range == pytest.approx(one.range, rel=1e-9, abs=1e-9)


@given(signals, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_longer_period_has_no_smaller_range(values, one, other):
    times = np.arange(values.size, dtype=float)
    short, long = sorted((one * times[-1], other * times[-1]))
    if short > 0.0:
        inside = extremes(times, values, 0.0, short, "x").range
        assert inside <= extremes(times, values, 0.0, long, "x").range + 1e-9


@given(signals, st.data())
def test_samples_on_the_straight_lines_between_samples_change_nothing(values, data):
    times = np.arange(values.size, dtype=float)
    begin, end = sorted(data.draw(st.tuples(*2 * [st.floats(0.0, times[-1])])))
    fine = np.union1d(times, np.linspace(0.0, times[-1], 50))
    coarse = extremes(times, values, begin, end, "x").range
    assert extremes(fine, np.interp(fine, times, values), begin, end, "x").range == pytest.approx(
        coarse, rel=1e-9, abs=1e-9
    )


def test_missing_readings_inside_are_bridged_and_at_the_ends_refused():
    record = warm_up()
    holed = record.displacements["X"].copy()
    holed[100:130] = np.nan
    period = Period(0.5 * HOUR, 4.5 * HOUR)
    full, less = (
        extremes(record.times, v, *period, "X") for v in (record.displacements["X"], holed)
    )
    assert less.range == pytest.approx(full.range)
    holed[:200] = np.nan
    with pytest.raises(InputError, match=r"X: read over .* give a longer record"):
        extremes(record.times, holed, *period, "X")


def test_a_rigid_turn_is_its_tilt_whatever_the_distance():
    angle, shift = np.linspace(0.0, 2e-4, 50), np.linspace(0.0, 5e-5, 50)
    times = np.linspace(0.0, 2 * HOUR, 50)
    for distance in (0.1, 0.6):
        record = Record(times, {"X1": shift + angle * distance, "X2": shift}, {})
        found = by_symbol(
            evaluate(Protocol.SPINDLE, with_tilts(record, {"B": ("X1", "X2")}, distance))
        )
        assert found["d(B)t"] == pytest.approx(2e-4, rel=1e-9, abs=0)


def test_the_environment_is_taken_over_the_whole_record():
    times = np.linspace(0.0, 24 * HOUR, 289)
    day = np.sin(2 * np.pi * times / (24 * HOUR))
    record = Record(times, {"Z": 8e-6 * day}, {"room": 20 + 3 * day}, drive=np.zeros(times.size))
    found = by_symbol(evaluate(Protocol.ETVE, record))
    assert found["ETVE(Z)"] == pytest.approx(16e-6, rel=1e-3, abs=0)
    assert found["ΔT(room)"] == pytest.approx(6.0, rel=1e-3)
    with pytest.raises(InputError, match="whole record"):
        evaluate(Protocol.ETVE, record, begin=0.0)


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ((0.5 * HOUR, HOUR), "first 60 min"),
        ((3 * HOUR, HOUR), "within it"),
        ((0.0, 99 * HOUR), "within it"),
    ],
)
def test_a_period_that_cannot_be_evaluated_is_refused(ends, said):
    with pytest.raises(InputError, match=said):
        evaluate(Protocol.SPINDLE, warm_up(), *ends)


def test_a_machine_that_never_turns_ran_no_test():
    record = warm_up()
    with pytest.raises(InputError, match="zero throughout"):
        running(record.times, 0.0 * record.drive)


def test_a_second_point_is_of_the_same_run():
    record = warm_up()
    both = with_second(Record(record.times, {"y": record.displacements["X"]}, {}), record)
    assert list(both.displacements) == ["y", "X2", "X22"]
    with pytest.raises(InputError, match="other times"):
        with_second(record, warm_up(step=60.0))
    with pytest.raises(InputError, match="already"):
        with_second(record, record)


def test_a_second_point_of_another_day_is_refused(tmp_path):
    """Its time from its start is the same, but the machine was another."""
    found = []
    for day in ("01", "02"):
        path = tmp_path / f"{day}.csv"
        path.write_text(f"timestamp,x_um\n2024-03-{day}T08:00:00,1\n2024-03-{day}T10:30:00,4\n")
        found.append(log_record(read_log([path])))
    assert set(with_second(found[0], found[0]).displacements) == {"x", "x2"}
    with pytest.raises(InputError, match="another day"):
        with_second(*found)


def test_every_range_of_the_report_is_in_the_json_with_its_unit():
    record = with_tilts(warm_up(), {"B": ("X", "X2")}, 0.15)
    evaluation = evaluate(Protocol.SPINDLE, record)
    content = json.loads(json.dumps(parameters_json(evaluation, "log.csv")))
    units = {row["symbol"]: row["unit"] for row in content["parameters"]}
    assert units["d(X)60"] == "µm"
    assert units["d(B)t"] == "µm/m"
    assert units["ΔT(nose)t"] == "K"
    page = report_html(record, evaluation, "<b>log</b>")
    assert all(symbol in page for symbol in units)
    assert "&lt;b&gt;log" in page
    assert "http" not in page.replace("http-equiv", "")


@pytest.mark.parametrize(("channels", "arrows_drawn"), [(2, 4), (6, 6)])
def test_no_label_of_the_figure_lies_on_another_or_on_an_arrow(channels, arrows_drawn):
    # An hour is a small part of what is shown, and all points have moved as far.
    record = warm_up(step=300.0, running=15 * HOUR)
    moved = record.displacements["X"]
    record = replace(
        record, displacements={f"X{k}": (1.1 - 0.1 * k) * moved for k in range(1, channels + 1)}
    )
    figure = figure_of(record, evaluate(Protocol.SPINDLE, record))
    figure.draw_without_rendering()
    for panel in figure.axes:
        boxes = [label.get_window_extent() for label in panel.texts if label.get_text()]
        assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
        arrows = [arrow for label in panel.texts if (arrow := label.arrow_patch) is not None]
        lines = [arrow.get_path().get_extents(arrow.get_transform()) for arrow in arrows]
        assert not any(one.padded(1.0).overlaps(line) for one in boxes for line in lines)
    assert [len(panel.texts) // 2 for panel in figure.axes] == [arrows_drawn, 0]


# --- the cases


def machine(data):
    return {
        key: data[key]
        for key in ("structure", "materials", "bodies", "joints", "supports", "convection_W_m2K")
    }


def case_data(name):
    return tomllib.loads(CASES.joinpath(f"iso230_3_{name}.toml").read_text("utf-8"))


def test_all_tests_are_run_on_the_reference_machine():
    """But for its mesh."""
    reference = machine(tomllib.loads(CASES.joinpath("reference.toml").read_text("utf-8")))
    sizes = {"element_size_mm": 50.0, "joint_element_size_mm": 25.0}
    reference["structure"] |= sizes
    for name in NAMES:
        assert machine(case_data(name)) == reference


@pytest.mark.parametrize(
    "name", [*NAMES[:2], *(pytest.param(name, marks=pytest.mark.long) for name in NAMES[2:])]
)
def test_a_case_of_a_test_gives_the_parameters_of_that_test(name):
    """On a coarse mesh, in long steps, the first hours of it."""
    text = CASES.joinpath(f"iso230_3_{name}.toml").read_text("utf-8")
    case = parse_case(text, name, Path(str(CASES)))
    coarse = {"element_size_mm": 100.0, "joint_element_size_mm": 100.0}
    march = {"step_s": 120.0, "duration_min": 300.0, "thermal": "full"}
    case = case.model_copy(
        update={
            "structure": case.structure.model_copy(update=coarse),
            "march": case.march.model_copy(update=march),
        }
    )
    record = response_record(simulate(case).response)
    protocol = Protocol.ETVE if name == "etve" else Protocol.SPINDLE
    found = by_symbol(evaluate(protocol, record))
    if protocol is Protocol.ETVE:
        assert found["ΔT(ambient)"] > 1.0
        assert 0.5e-6 < found["ETVE(y)"] < 50e-6
    else:
        assert 5e-6 < found["d(y)60"] <= found["d(y)t"] < 500e-6
    # Along z nothing moves: it is the normal of the plane of symmetry.
    assert set(record.displacements) == {"x", "y"}


# --- logs and the command


def refused(command, *arguments):
    code, _, err = command("iso230-3", *arguments)
    assert (code, err.count("\n")) == (2, 1)
    return err


@pytest.fixture
def log(tmp_path):
    record = warm_up()
    rows = zip(
        record.times,
        3000 * record.drive,
        1e6 * record.displacements["X"],
        1e6 * record.displacements["X2"],
        record.temperatures["nose"],
        strict=True,
    )
    path = tmp_path / "warm_up.csv"
    path.write_text(
        "time_s,n_rpm,front_um,back_um,nose_degC\n"
        + "".join(",".join(f"{value:.6f}" for value in row) + "\n" for row in rows)
    )
    return path


def test_a_log_is_evaluated_in_the_names_that_are_given(log):
    record = log_record(read_log([log]), {"X1": "front_um", "X2": "back"})
    found = by_symbol(evaluate(Protocol.SPINDLE, record))
    assert found["d(X1)t"] == pytest.approx(100e-6 * (1 - np.exp(-4)), rel=1e-4, abs=0)
    assert found["d(X2)60"] == pytest.approx(40e-6 * (1 - np.exp(-1)), rel=1e-4, abs=0)
    assert record.temperatures["nose"][0] == pytest.approx(20.0)


def test_a_clock_that_tells_the_date_is_counted_from_the_first_sample(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("timestamp,x_um\n2024-03-01T22:00:00,1\n2024-03-02T00:30:00,4\n")
    evaluation = evaluate(Protocol.SPINDLE, log_record(read_log([path])))
    assert evaluation.period == pytest.approx((0.0, 2.5 * HOUR))
    assert by_symbol(evaluation)["d(x)60"] == pytest.approx(1.2e-6, rel=1e-9, abs=0)


def test_of_two_speeds_the_one_that_runs_in_the_test_is_named(command, log, tmp_path):
    """Without it the hours of rest before and after would count as running."""
    lines = log.read_text().splitlines()
    both = tmp_path / "both.csv"
    both.write_text("\n".join([f"{lines[0]},table_rpm", *(f"{line},0" for line in lines[1:])]))
    assert "n_rpm, table_rpm: name the one" in refused(command, both, "--test", "spindle")
    content = tmp_path / "found.json"
    ways = (["--speed", "n_rpm"], ["--begin-min", "30", "--end-min", "270"])
    for way in (*ways, ["--speed", "table_rpm", *ways[1]]):
        found = command("iso230-3", both, "--test", "spindle", *way, "--json", content)
        assert found[0] == 0
        rows = {row["symbol"]: row for row in json.loads(content.read_text("utf-8"))["parameters"]}
        assert rows["d(front)60"]["value"] == pytest.approx(100 * (1 - np.exp(-1)), rel=1e-4)
    assert command("iso230-3", both, "--test", "etve")[0] == 0


def test_a_log_that_begins_while_the_machine_runs_is_warned_of(command, log, tmp_path):
    """What it grew before is missing: 63 of 100 um after an hour."""
    head, *rows = log.read_text().splitlines()
    late, warning = tmp_path / "late.csv", "already runs in the first reading"
    late.write_text("\n".join([head, *rows[180:]]))
    spindle = ("--test", "spindle")
    code, _, errors = command("iso230-3", late, *spindle)
    assert (code, warning in errors) == (0, True)
    assert warning not in command("iso230-3", late, *spindle, "--begin-min", "90")[2]
    assert warning not in command("iso230-3", late, "--test", "etve")[2]
    assert warning not in command("iso230-3", log, *spindle)[2]


def test_a_pause_of_the_log_before_the_first_motion_is_no_part_of_the_run(command, log, tmp_path):
    """The night before counted as running: 0 um in the first 60 min of a warm-up."""
    head, *rows = log.read_text().splitlines()
    paused, found = tmp_path / "paused.csv", tmp_path / "found.json"
    # Logged until the machine was at rest for a quarter of an hour, and again ten hours later.
    later = [f"{float(row.split(',')[0]) + 10 * HOUR:g},{row.partition(',')[2]}" for row in rows]
    paused.write_text("\n".join([head, *rows[:30], *later[61:]]))
    spindle = ("--test", "spindle", "--json", found)
    code, _, errors = command("iso230-3", paused, *spindle)
    assert (code, "first reading after a pause, at 630.5 min" in errors) == (0, True)
    assert "not read from" not in errors
    values = {row["symbol"]: row for row in json.loads(found.read_text("utf-8"))["parameters"]}
    assert values["d(front)60"]["begin_s"] == pytest.approx(10.5 * HOUR + 30.0)
    # The first half minute of it is missing.
    grown = 100 * (np.exp(-30.0 / HOUR) - np.exp(-1 - 30.0 / HOUR))
    assert values["d(front)60"]["value"] == pytest.approx(grown, rel=1e-4)


def test_misread_values_are_warned_of(command, log, tmp_path):
    """One of -999 um, as of a probe without signal, made d(front)t 1100 instead of 98 um."""
    head, *rows = log.read_text().splitlines()
    cells = rows[400].split(",")
    cells[2] = "-999"
    misread, warning = tmp_path / "misread.csv", "1 spikes, as of misread values"
    misread.write_text("\n".join([head, *rows[:400], ",".join(cells), *rows[401:]]))
    code, _, errors = command("iso230-3", misread, "--test", "spindle")
    assert (code, warning in errors) == (0, True)
    assert warning not in command("iso230-3", log, "--test", "spindle")[2]


def test_a_channel_that_was_not_read_for_long_is_warned_of(command, log, tmp_path):
    """Its extreme may lie in that time; here the highest reading is lost, 98 of 100 um."""
    head, *rows = log.read_text().splitlines()
    holed, said = tmp_path / "holed.csv", "front: not read from 60 to 280.5 min of the record"
    for first, last, warned in ((121, 561, True), (121, 125, False), (0, 40, False)):
        cells = [row.split(",") for row in rows]
        for row in cells[first:last]:
            row[2] = ""
        holed.write_text("\n".join([head, *map(",".join, cells)]))
        code, _, errors = command("iso230-3", holed, "--test", "spindle")
        assert (code, said in errors, "not read" in errors) == (0, warned, warned)


def test_a_column_of_another_quantity_is_refused(log):
    with pytest.raises(InputError, match="'n_rpm' is a speed, not a length"):
        log_record(read_log([log]), {"X1": "n_rpm"})


def test_columns_that_differ_in_their_unit_alone_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time_s,x_um,x_mm\n0,1,0.2\n7200,4,0.3\n")
    with pytest.raises(InputError, match="'x_um' and 'x_mm' would both be 'x'"):
        log_record(read_log([path]))
    assert set(log_record(read_log([path]), {"near": "x_um"}).displacements) == {"near"}


def test_where_an_axis_stands_is_no_displacement(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time_s,x_um,y_pos_mm\n0,1,-300\n7200,4,300\n")
    assert set(log_record(read_log([path])).displacements) == {"x"}
    path.write_text("time_s,y_pos_mm\n0,-300\n7200,300\n")
    with pytest.raises(InputError, match="no displacement"):
        log_record(read_log([path]))


def test_the_command_writes_the_report_and_the_parameters(command, log, tmp_path):
    page, content = tmp_path / "page.html", tmp_path / "found.json"
    channels = ["--displacement", "X1=front_um", "--displacement", "X2=back_um"]
    tilts = ["--tilt", "B=X1,X2", "--distance-mm", "150"]
    written = ["--out", str(page), "--json", str(content)]
    for _ in range(2):  # its own files it replaces
        assert command("iso230-3", log, "--test", "spindle", *channels, *tilts, *written)[0] == 0
    rows = {row["symbol"]: row for row in json.loads(content.read_text("utf-8"))["parameters"]}
    assert rows["d(B)60"]["value"] == pytest.approx(400 * (1 - np.exp(-1)), rel=1e-4)
    assert rows["d(B)60"]["begin_s"] == pytest.approx(0.5 * HOUR)
    assert "d(B)60" in page.read_text("utf-8")


def test_the_command_takes_a_response(command, coarse_response, tmp_path):
    """Which is one minute long: too short for a test with motion, long enough for the other."""
    path = tmp_path / "response.nc"
    write_response(coarse_response, path)
    assert command("iso230-3", path, "--test", "etve", "--json", tmp_path / "etve.json")[0] == 0
    assert "first 60 min" in refused(command, path, "--test", "spindle")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--displacement", "sideways_um"], "no column named 'sideways_um'"),
        (["--tilt", "B=front,back"], "give both or neither"),
        (["--tilt", "B=front", "--distance-mm", "100"], "NAME=FIRST,SECOND"),
        (["--tilt", "front=front,back", "--distance-mm", "100"], "has such a channel"),
        (2 * ["--tilt", "B=front,back"] + ["--distance-mm", "100"], "--tilt B: is given twice"),
        (["--displacement", "X=front", "--displacement", "X=back"], "--displacement X: is given"),
        (["--tilt", "B=front,bac", "--distance-mm", "100"], "did you mean 'back'"),
        (["--tilt", "B=front,back", "--distance-mm", "0"], "positive length"),
        (["--column", "n_rpm"], "write THEIRS=OURS"),
        (["--speed", "nose_degC", "--begin-min", "-5"], "within it"),
    ],
)
def test_what_is_wrong_on_the_command_line_is_said_in_one_line(
    command, log, tmp_path, options, said
):
    out = tmp_path / "page.html"
    message = refused(command, log, "--test", "spindle", *options, "--out", out)
    assert said in message
    assert not out.exists()


def test_the_log_itself_is_never_overwritten(command, log):
    before = log.read_bytes()
    assert "an input" in refused(command, log, "--test", "spindle", "--out", log)
    assert log.read_bytes() == before


def test_the_distortion_of_a_period_ends_with_the_period():
    record = warm_up()
    short = distortion(record, Period(0.5 * HOUR, 1.5 * HOUR))
    assert {one.symbol: one.value for one in short}["d(X)t"] == pytest.approx(
        {one.symbol: one.value for one in short}["d(X)60"]
    )
