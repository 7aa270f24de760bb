"""The benchmark of thermal error: frozen data, what a score is, an outsider's method."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT

from benchmarks.thermal_error import __main__ as command
from benchmarks.thermal_error import drives, freezing, leaderboard, making, plants, tasks
from benchmarks.thermal_error.faults import FAULTS, SENSOR
from benchmarks.thermal_error.methods import METHODS, method_named
from benchmarks.thermal_error.methods.logs import held, moved_to_readings, responses
from benchmarks.thermal_error.scoring import NotApplicable, Score, score
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import column_named

PAGE = ROOT / "docs" / "thermal-error-benchmark.md"
KEPT = Path(leaderboard.__file__).with_name("leaderboard.json")
REGRESSIONS = ("mlr", "ridge", "arx")


def made_log(runs=1, count=900, seed=0):
    """A machine whose displacement is a low-pass of what one thermometer reads."""
    rng = np.random.default_rng(seed)
    pieces, starts = [], []
    for k in range(runs):
        starts.append(k * count)
        heat = np.repeat(rng.random(count // 60), 60)
        first, second = np.zeros(count), np.zeros(count)
        for i in range(1, count):
            first[i] = first[i - 1] + 0.02 * (20 * heat[i] - first[i - 1])
            second[i] = second[i - 1] + 0.02 * (first[i] - second[i - 1])
        pieces.append(np.column_stack((293.15 + first, 293.15 + second, 1e-6 * second)))
    names = ("T1_degC", "T2_degC", "x_um")
    times = np.tile(10.0 * np.arange(count), runs)
    columns = tuple(column_named(name) for name in names)
    return Log(times, columns, np.concatenate(pieces), tuple(starts))


@pytest.fixture(scope="module")
def task():
    return tasks.Task("made", made_log(runs=2, seed=1), made_log(seed=2))


# --- data


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=50).map(np.array),
    st.sampled_from([0.01, 0.1, 1.0]),
)
def test_what_other_processors_compute_is_rounded_alike(values, grid):
    """Within nine tenths of the margin, that is."""
    border, margin = freezing.widest_gap(values, grid)
    text = freezing.rounded(values, grid, border)
    for off in (-0.9 * margin, 0.9 * margin):
        np.testing.assert_array_equal(freezing.rounded(values + off, grid, border), text)
    assert np.abs(text - values).max() <= grid * (1 + 1e-9)


def test_values_that_stand_on_the_grid_stay_there():
    values = np.array([0.0, 10.0, 250.0, 3600.0])
    border, _ = freezing.widest_gap(values, 0.1)
    np.testing.assert_allclose(freezing.rounded(values, 0.1, border), values, rtol=1e-12)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_of_one_sensor_and_begins_late(fault):
    columns = {SENSOR: np.linspace(20.0, 50.0, 1000), "b_degC": np.zeros(1000)}
    spoilt = FAULTS[fault](columns)
    assert spoilt["b_degC"] is columns["b_degC"]
    np.testing.assert_array_equal(spoilt[SENSOR][:400], columns[SENSOR][:400])
    assert not np.array_equal(spoilt[SENSOR][400:], columns[SENSOR][400:], equal_nan=True)


def test_a_day_is_the_same_day_whenever_it_is_drawn():
    one, other = drives.day(3), drives.day(3)
    np.testing.assert_array_equal(one.rpm, other.rpm)
    assert one.rpm.max() > 2000.0
    assert (one.rpm == 0.0).mean() > 0.1
    assert np.abs(one.ambient - drives.AMBIENT_DEGC).max() < 6.1


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The benchmark with one machine of each family, coarse, whose days last half an hour."""
    folder = tmp_path_factory.mktemp("thermal_error")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "FROZEN", folder / "frozen.json")
        patch.setattr(plants, "PLANT_MM", (100.0, 100.0))
        patch.setattr(drives, "DAY_S", 1800.0)
        patch.setattr(drives, "STEP_S", 600.0)
        patch.setattr(tasks, "SETTLED", 300.0)
        coarse = plants.set_up_plant("reference", (100.0, 100.0))
        patch.setattr(making, "set_up_plant", lambda plant: coarse)
        making.freeze(folder / "data", print, ("reference", "structural-1"))
        yield folder / "data"


@pytest.mark.long
def test_data_made_again_are_the_frozen_ones(small, tmp_path):
    told = []
    assert making.make(tmp_path, told.append, ("reference", "structural-1")) == []
    assert len(told) == len(making.read_frozen()) == 9 + 5
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (small / path.name).read_bytes()


@pytest.mark.long
def test_a_file_that_is_not_the_frozen_one_is_refused(small, tmp_path):
    name = "reference-test-day"
    text = (small / f"{name}.csv").read_text()
    (tmp_path / f"{name}.csv").write_text(text.replace("20.", "21.", 1))
    with pytest.raises(InputError, match="not the frozen file"):
        making.check(tmp_path, name)
    with pytest.raises(InputError, match="no such file; make the data"):
        making.check(tmp_path, "reference-train-day")


@pytest.mark.long
def test_a_simulated_machine_is_learnt_from_its_steps_and_a_day(small):
    day, *faulty, _, _ = tasks.simulated(small, ("reference",))
    assert day.training.starts == (0, 61, 122, 183)
    assert day.test.of("length") == ("x_um", "y_um")
    assert {one.name.split(", ")[1] for one in faulty} == set(FAULTS)
    found = [level for level, _ in responses(day.training, ("a", "b", "T1", "T2"))]
    assert found == [0.5, 1.0, 2.0, None]


@pytest.mark.long
def test_a_plant_of_another_structure_is_no_reference_machine_in_the_same_runs(small):
    day, _, _ = tasks.simulated(small, ("structural-1",))
    (reference, *_) = tasks.simulated(small, ("reference",))
    np.testing.assert_array_equal(day.test.at("spindle"), reference.test.at("spindle"))
    moved, other = day.test.at("x_um"), reference.test.at("x_um")
    assert np.abs(moved - other).max() > 0.05 * np.abs(other).max() > 0.0


@pytest.mark.long
def test_a_warm_task_begins_within_the_day_and_another_is_read_twice(small):
    day, warm, read = tasks.simulated(small, ("structural-1",))
    assert warm.test.times[0] > 0.0
    assert warm.test.times[-1] == day.test.times[-1]
    shown = np.isfinite(tasks.as_given(read).at("x_um"))
    assert np.flatnonzero(shown).tolist() == list(read.read)
    assert len(read.read) == 2
    assert not tasks.as_given(warm).of("length")


def test_the_measured_machine_is_known_by_its_hash(tmp_path):
    path = tmp_path / "measured.csv"
    path.write_text("time_s,x_um\n0,1\n")
    with pytest.raises(InputError, match="not the measured log"):
        list(tasks.measured(path))


def test_a_log_is_split_in_time_and_both_ways():
    log = made_log(count=900)
    late, early = tasks.splits(log, "log")
    assert late.training.times[-1] < late.test.times[0]
    assert early.test.times[-1] < early.training.times[0]
    assert len(late.test.times) == len(early.test.times) == 360


# --- scores


def test_no_compensation_removes_nothing(task):
    (row,) = score(task, "none", method_named("none")[1])
    assert row.removed == pytest.approx(0.0, abs=1e-12)
    assert row.rms_um == pytest.approx(1e6 * np.sqrt(np.mean(task.test.at("x_um") ** 2)))


@pytest.mark.parametrize("name", REGRESSIONS)
def test_a_machine_that_a_regression_can_be_is_found_by_it(task, name):
    (row,) = score(task, name, method_named(name)[1])
    assert row.removed > 0.95


@pytest.mark.parametrize("name", REGRESSIONS)
def test_a_reading_that_is_missing_is_bridged(task, name):
    values = task.test.values.copy()
    values[300:330, 0] = np.nan
    holed = tasks.Task("holed", task.training, Log(task.test.times, task.test.columns, values))
    assert np.isfinite(score(holed, name, method_named(name)[1])[0].rms_um)


def test_what_is_held_is_the_last_reading():
    column = np.array([[1.0], [np.nan], [np.nan], [4.0]])
    np.testing.assert_array_equal(held(column), [[1.0], [1.0], [1.0], [4.0]])


def test_a_method_is_given_no_displacement_of_the_test(task):
    def spy(training, test):
        assert not test.of("length")
        return {"x_um": np.zeros(len(test.times))}

    score(task, "spy", spy)


def test_a_method_that_looks_ahead_is_refused(task):
    def prophet(training, test):
        return {"x_um": np.full(len(test.times), 1e-9 * test.at("T1").max() * len(test.times))}

    with pytest.raises(InputError, match="if the future is withheld"):
        score(task, "prophet", prophet)


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (lambda test: {}, "predicts no 'x_um'"),
        (lambda test: {"x_um": np.zeros(3)}, "has shape"),
        (lambda test: {"x_um": np.full(len(test.times), np.nan)}, "not finite"),
        (lambda test: {"x_um": np.full((len(test.times), 2), -1e-6)}, "band of x_um is negative"),
        (lambda test: {"x_um": np.ones((len(test.times), 2)) * [0.0, np.nan]}, "band of x_um"),
        (lambda test: {"x_um": np.ones((len(test.times), 2)) * [0.0, np.inf]}, "band of x_um"),
        (lambda test: {"x_um": ["left"] * len(test.times)}, "x_um is no array of numbers"),
        (lambda test: None, "returned a NoneType"),
    ],
)
def test_predictions_that_cannot_be_scored_are_refused(task, told, said):
    with pytest.raises(InputError, match=said):
        score(task, "bad", lambda training, test: told(test))


def test_a_method_that_fails_is_named_in_one_line_with_its_place(task):
    def failing(training, test):
        raise ValueError("singular matrix")

    with pytest.raises(
        InputError, match=r"own: made: ValueError, singular matrix \(test_\w+\.py:\d+\)"
    ):
        score(task, "own", failing)


def test_no_method_changes_the_log_that_the_next_one_is_given(task):
    def hot(training, test):
        warm = training.at("T1_degC")
        warm -= training.at("T2_degC")
        return {"x_um": np.zeros(len(test.times))}

    before = task.training.values.copy()
    with pytest.raises(InputError, match="read-only"):
        score(task, "hot", hot)
    np.testing.assert_array_equal(task.training.values, before)


def test_a_band_is_judged_by_what_it_covers(task):
    def banded(training, test):
        return {"x_um": np.column_stack((np.zeros(len(test.times)), np.ones(len(test.times))))}

    (row,) = score(task, "banded", banded)
    assert row.cover == pytest.approx(1.0)
    # Twice the half-width of 1 m, as nothing is outside.
    assert row.interval_score_um == pytest.approx(2e6)


KNOWN = made_log(seed=2)


def off_by(error):
    """A method that is off by as much, m, in every sample."""

    def predict(training, test):
        return {"x_um": np.interp(test.times, KNOWN.times, KNOWN.at("x_um")) + error}

    return predict


def test_a_method_without_readings_is_moved_to_the_last_one(task):
    read = tasks.Task("read", task.training, KNOWN, (450,))
    (as_it_is,) = score(read, "off", off_by(1e-6))
    (moved,) = score(read, "moved", moved_to_readings(off_by(1e-6)))
    assert as_it_is.rms_um == pytest.approx(1.0)
    assert moved.rms_um == pytest.approx(np.sqrt(0.5))


def test_a_method_that_uses_a_reading_before_it_was_made_is_refused(task):
    read = tasks.Task("read", task.training, KNOWN, (300, 600))

    def prophet(training, test):
        known = test.at("x_um")[np.isfinite(test.at("x_um"))]
        return {"x_um": np.full(len(test.times), known[0] if known.size else 0.0)}

    with pytest.raises(InputError, match="if the future is withheld"):
        score(read, "prophet", prophet)


def test_a_task_is_judged_from_when_it_has_settled(task):
    def late(training, test):
        return {"x_um": np.where(test.times < 1200.0, 1.0, test.times * 0.0)}

    settled = tasks.Task("warm", task.training, KNOWN, settled=1200.0)
    assert score(settled, "late", late)[0].removed == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", ["linear", "fchs", "joint-aware"])
def test_a_method_says_what_it_needs_of_a_log(task, name):
    with pytest.raises(NotApplicable):
        score(task, name, method_named(name)[1])


@pytest.mark.parametrize("name", METHODS)
def test_every_method_of_the_leaderboard_can_be_loaded(name):
    assert callable(method_named(name)[1])


def test_a_method_that_is_not_there_is_named():
    for text in ("rigde", "nowhere.to_be:found", "math:nothing"):
        with pytest.raises(InputError, match="--method"):
            method_named(text)


def test_a_method_whose_file_fails_is_named_in_one_line(tmp_path, monkeypatch):
    (tmp_path / "unfinished_method.py").write_text("def predict(training, test:\n    return {}\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"SyntaxError, .* \(unfinished_method.py, line 1\)"):
        method_named("unfinished_method:predict")


def test_the_best_method_stands_first(task):
    rows = [row for name in ("none", "ridge") for row in score(task, name, method_named(name)[1])]
    lines = leaderboard.as_markdown(rows).splitlines()
    assert lines[2].startswith("| ridge")
    assert "0 %" in lines[3]


def test_the_page_shows_the_leaderboard_of_the_scores_that_are_kept():
    kept = json.loads(KEPT.read_text("utf-8"))["scores"]
    table = leaderboard.as_markdown([Score(**row) for row in kept])
    assert table in PAGE.read_text("utf-8")
    assert table == KEPT.with_suffix(".md").read_text("utf-8")
    assert {row["method"] for row in kept} == set(METHODS)


@pytest.mark.long
def test_an_outsiders_method_as_on_the_page_is_scored_from_its_own_folder(
    small, tmp_path, monkeypatch, capsys
):
    (tmp_path / "outsider").mkdir()
    (tmp_path / "outsider" / "__init__.py").write_text("")
    (mine,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S)
    (tmp_path / "outsider" / "mine.py").write_text(mine)
    monkeypatch.chdir(tmp_path)
    chosen = ["--data", str(small), "--plant", "reference", "--out", "mine"]
    methods = ["--method", "outsider.mine:predict", "--method", "none"]
    assert command.main(["score", *chosen, *methods]) == 0
    rows = json.loads((tmp_path / "mine.json").read_text("utf-8"))["scores"]
    assert {row["method"] for row in rows} == {"outsider.mine:predict", "none"}
    assert len(rows) == 2 * 2 * (3 + len(FAULTS))
    assert "outsider.mine:predict" in (tmp_path / "mine.md").read_text("utf-8")
    assert command.main(["score", *chosen, "--method", "outsider.mine:nothing"]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("thermal_error: --method")
