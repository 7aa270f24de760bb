"""`learn`, and `estimate` and `validate` with what it made, from the command line."""

import csv
import json
import re
import shlex
import shutil
import subprocess
import sys
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from in_process import run, undisturbed
from machine_logs import along_log, as_csv, changed, machine_log
from repository import ROOT

from thermojoint import console
from thermojoint.cli.app import app

LEARN = ["--displacement", "x_um", "--displacement", "z_um"]


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """Run the command line in a folder of its own; gives exit code and standard error."""
    monkeypatch.chdir(tmp_path)

    def told(*arguments):
        return run(*arguments), capsys.readouterr().err

    return told


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two days, a model of the first, and readings of the second."""
    folder = tmp_path_factory.mktemp("logs")
    day = machine_log(hours=6.0, seed=5, start=500000.0)
    as_csv(machine_log(), folder / "log.csv")
    as_csv(day, folder / "day.csv")
    as_csv(day.part(slice(0, 1)), folder / "readings.csv", ["x_um"])
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        made = ["--out", "model.json", "--figure", "held-out.svg"]
        app(["learn", "log.csv", *LEARN, *made], standalone_mode=False)
    return folder


@pytest.fixture
def here(files, tmp_path):
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    return tmp_path


def rows(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_an_estimate_has_a_column_for_each_displacement_named_as_in_the_log(here, command):
    code, _ = command("estimate", "model.json", "day.csv", "--out", "estimate.csv")
    assert not code
    found, day = rows(here / "estimate.csv"), rows(here / "day.csv")
    columns = ["time_s", "x_um", "z_um", "x_band_um", "z_band_um", "status", "quality"]
    assert list(found[0]) == columns
    assert [float(one["time_s"]) for one in found] == [float(one["time_s"]) for one in day]
    for name in ("x_um", "z_um"):
        error = [float(a[name]) - float(b[name]) for a, b in zip(found, day, strict=True)]
        actual = [float(one[name]) for one in day]
        assert np.std(error) < 0.3 * np.std(actual)


def test_displacements_in_the_log_are_not_looked_at(here, command):
    day = machine_log(hours=6.0, seed=5, start=500000.0)
    as_csv(changed(day, "x_um", lambda values: values * 0.0), here / "other.csv")
    command("estimate", "model.json", "day.csv", "--out", "a.csv")
    command("estimate", "model.json", "other.csv", "--out", "b.csv")
    assert (here / "a.csv").read_bytes() == (here / "b.csv").read_bytes()


def test_a_run_that_is_continued_is_the_run(here, command):
    lines = (here / "day.csv").read_text("utf-8").splitlines(keepends=True)
    (here / "one.csv").write_text("".join(lines[:100]))
    (here / "two.csv").write_text("".join([lines[0], *lines[100:]]))
    command("estimate", "model.json", "day.csv", "--out", "whole.csv")
    command("estimate", "model.json", "one.csv", "--out", "a.csv", "--save-state", "s.json")
    code, _ = command("estimate", "model.json", "two.csv", "--out", "b.csv", "--continue", "s.json")
    assert not code
    parts = rows(here / "a.csv") + rows(here / "b.csv")
    assert parts == rows(here / "whole.csv")


def test_readings_correct_an_estimate(here, command):
    (here / "readings.csv").write_text("time_s,x_um\n500000,30\n", encoding="utf-8")
    options = ["--readings", "readings.csv"]
    assert not command("estimate", "model.json", "day.csv", "--out", "a.csv", *options)[0]
    assert command("estimate", "model.json", "day.csv", "--out", "b.csv")[0] == 0
    assert rows(here / "a.csv")[0]["status"] != ""
    (here / "readings.csv").write_text("time_s,x_um\n500000,2\n", encoding="utf-8")
    command("estimate", "model.json", "day.csv", "--out", "c.csv", *options)
    assert float(rows(here / "c.csv")[0]["x_um"]) == pytest.approx(2.0, abs=1.0)
    assert float(rows(here / "c.csv")[0]["z_um"]) == float(rows(here / "b.csv")[0]["z_um"])


def test_learn_draws_what_it_was_judged_by(here, command):
    assert "<svg" in (here / "held-out.svg").read_text("utf-8")
    code, said = command("learn", "log.csv", *LEARN, "--out", "b.json", "--figure", "held.txt")
    assert code == 2
    assert "use .png, .svg or .pdf" in said


def test_validate_takes_a_log(here, command):
    code, _ = command(
        "validate", "model.json", "day.csv", "--json", "scores.json", "--out", "day.png"
    )
    assert not code
    assert (here / "day.png").read_bytes().startswith(b"\x89PNG")
    found = json.loads((here / "scores.json").read_text("utf-8"))["rows"]
    assert {(row["case"], row["axis"]) for row in found} == {("day", "x_um"), ("day", "z_um")}
    assert all(row["rms_error_um"] < 0.3 * row["rms_uncompensated_um"] for row in found)
    # A validation is replaced by another, a file of rows that is none is not.
    assert not command("validate", "model.json", "day.csv", "--json", "scores.json")[0]
    (here / "mine.json").write_text('{"rows": [1]}', encoding="utf-8")
    assert command("validate", "model.json", "day.csv", "--json", "mine.json")[0] == 2


def test_validate_says_that_its_errors_contain_misread_displacements(here, command):
    day = rows(here / "day.csv")
    for k in (100, 200):
        day[k]["x_um"] = "-999"
    with (here / "misread.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, day[0])
        writer.writeheader()
        writer.writerows(day)
    code, told = command("validate", "model.json", "misread.csv")
    assert not code
    assert "misread: x_um: 2 spikes, as of misread displacements; the errors contain" in told
    assert "spikes" not in command("validate", "model.json", "day.csv")[1]


def test_columns_of_fixed_positions_are_drawn_as_they_are_judged(here, command):
    day = rows(here / "day.csv")
    for one in day:
        one["z@0mm_um"], one["z@400mm_um"] = one.pop("z_um"), 2.0 * float(one["x_um"])
    with (here / "two.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, day[0])
        writer.writeheader()
        writer.writerows(day)
    made = ["--displacement", "z", "--out", "slope.json"]
    assert not command("learn", "two.csv", *made)[0]
    written = ["--out", "two.png", "--json", "two.json"]
    assert not command("validate", "slope.json", "two.csv", *written)[0]
    judged = json.loads((here / "two.json").read_text("utf-8"))["rows"]
    assert [row["axis"] for row in judged] == ["z@0mm_um", "z@400mm_um"]
    assert (here / "two.png").stat().st_size > 1000


def test_columns_may_have_other_names_in_every_log(here, command):
    for name in ("log.csv", "day.csv"):
        text = (here / name).read_text("utf-8").replace("T1_degC", "Fühler 1", 1)
        (here / name).write_text(text, encoding="utf-8")
    (here / "map.toml").write_text("[columns]\n'Fühler 1' = 'T1_degC'\n", encoding="utf-8")
    options = [*LEARN, "--mapping", "map.toml", "--out", "other.json"]
    assert not command("learn", "log.csv", *options)[0]
    assert not command("estimate", "other.json", "day.csv", "--out", "estimate.csv")[0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["learn", "none.csv", *LEARN], "no such file"),
        (["learn", "log.csv", "--displacement", "y_um"], "no column named 'y_um'"),
        (["learn", "log.csv", *LEARN, "--column", "T1_degC=T1"], "--column T1_degC=T1"),
        (["learn", "log.csv", *LEARN, "--ignore", "T9_degC"], "no column named 'T9_degC'"),
        (["learn", "log.csv", *LEARN, "--max-sensors", "0"], "--max-sensors 0"),
        (
            ["learn", "log.csv", *LEARN, "--kind", "joint-aware", "--ignore", "T1_degC"],
            "--ignore: goes with a model learned without --case",
        ),
        (
            ["learn", "log.csv", *LEARN, "--kind", "joint-aware", "--max-sensors", "2"],
            "--max-sensors: goes with a model learned without --case",
        ),
        (
            ["learn", "log.csv", *LEARN, "--like", "model.json", "--max-sensors", "2"],
            "--max-sensors: goes with a model learned without --like",
        ),
        (["learn", "short.csv", *LEARN], "h long"),
        (["learn", "kelvin.csv", *LEARN], "kelvin and not"),
        (["learn", "model.json", *LEARN], "no clock"),
        (["estimate", "model.json", "readings.csv"], "no column named"),
        (["estimate", "model.json", "day.csv", "--readings", "log.toml"], "log.toml"),
        (["validate", "model.json", "none.csv"], "no such file"),
    ],
)
def test_a_mistake_ends_in_one_line_and_nothing_is_written(here, command, arguments, said):
    log = machine_log(hours=1.0)
    as_csv(log, here / "short.csv")
    text = (here / "log.csv").read_text("utf-8").splitlines()
    text[1:] = [re.sub(r",2(\d\.\d+)$", r",29\1", line) for line in text[1:]]
    (here / "kelvin.csv").write_text("\n".join(text) + "\n", encoding="utf-8")
    name = {"estimate": "out.csv"}.get(arguments[0], "out.json")
    code, told = command(*arguments, "--json" if arguments[0] == "validate" else "--out", name)
    assert code == 2
    # Above the mistake stands what was read; the mistake is one line.
    *read, mistake = told.strip().splitlines()
    assert said in mistake
    assert not [line for line in read if line.startswith("thermojoint:")]
    assert not (here / name).exists()


def test_readings_go_with_learned_models_only(here, command):
    code, told = command(
        "estimate", "log.csv", "day.csv", "--readings", "readings.csv", "--out", "e.csv"
    )
    assert code == 2
    assert len(told.strip().splitlines()) == 1


@pytest.mark.long
def test_the_guide_does_what_it_says(tmp_path, monkeypatch, capsys):
    """Its commands in their order, then its Python, whose errors are those of its table."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    shutil.copytree(ROOT / "examples" / "measured_machine", tmp_path / "examples/measured_machine")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "guide-measured-machine.md").read_text("utf-8")
    for block in re.findall(r"^```sh\n(.*?)^```", page, re.M | re.S):
        for line in block.strip().splitlines():
            words = shlex.split(line)
            if words[0] == "cd":
                monkeypatch.chdir(words[1])
            elif words[0] == "thermojoint":
                with undisturbed():
                    app(words[1:], standalone_mode=False)
            else:
                subprocess.run(words, check=True, capture_output=True)
    [code] = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    capsys.readouterr()
    exec(compile(code, "guide", "exec"), {})
    told = [line.split() for line in capsys.readouterr().out.splitlines()]
    table = re.findall(r"^\| (disp\d) \| (.*?) \| (.*?) \| (.*?) \|$", page, re.M)
    left = re.findall(r"^\| ([YZ]) \(disp\d\) \| (.*?) \|$", page, re.M)
    assert (len(table), len(left)) == (5, 2)
    for (axis, found), (shown, value) in zip(told[5:], left, strict=True):
        assert axis == shown
        assert float(found) == pytest.approx(float(value), abs=0.3)
    for (name, *found), (shown, *values) in zip(told[:5], table, strict=True):
        assert name == f"{shown}_um"
        assert [float(one) for one in found] == pytest.approx([float(v) for v in values], abs=0.3)


def test_a_log_is_read_once_and_what_was_read_is_said(here, command, monkeypatch):
    """By the samples themselves: a log of a year is not read again for a line about it."""
    opened, with_path = [], Path.open

    def counted(path, *given, **named):
        opened.append(path.name)
        return with_path(path, *given, **named)

    monkeypatch.setattr(Path, "open", counted)
    for name, *wanted in (("estimate", "--out", "new.csv"), ("validate", "--json", "new.json")):
        opened.clear()
        code, told = command(name, "model.json", "day.csv", *wanted)
        assert not code
        assert opened.count("day.csv") == 1
        assert "day.csv: 360 rows, 5.787 d to 6.036 d, every 60 s" in told
        assert "T1_degC (temperature)" in told


def test_a_stream_says_how_it_is_read_and_what_is_new_in_it(here, command, monkeypatch):
    header, *lines = (here / "day.csv").read_text("utf-8").splitlines(keepends=True)
    lines[2] = lines[2].rpartition(",")[0] + ",---\n"
    stream = [f"Zeile;{header}".replace(",", ";"), *(f"a,{one}".replace(",", ";") for one in lines)]
    monkeypatch.setattr(sys, "stdin", iter([*stream[:5], *stream[200:]]))
    code, told = command("estimate", "model.json", "-", "--out", "estimate.csv")
    assert not code
    found = [line.strip() for line in told.splitlines()]
    assert found[0] == ("standard input: semicolon between cells; clock time_s, from its own start")
    assert "n_rpm (speed), x_um (length)" in found[1]
    assert found[2].startswith("ignored, no unit in the name: Zeile")
    assert found[3] == "T6_degC: readings missing: 1 x ---"
    assert found[4].startswith("2 runs, 1 pause: 3.267 h from 5.789 d")
    assert found[5].startswith("standard input: 165 rows, 5.787 d to 6.036 d, every 60 s")


@pytest.mark.parametrize(
    "arguments",
    [
        ["estimate", "model.json", "other.csv", "--out", "new.csv"],
        ["validate", "model.json", "other.csv", "--json", "new.json"],
        ["export", "model.json", "--samples", "other.csv", "--out", "new"],
        ["iso230-3", "other.csv", "--test", "spindle", "--json", "new.json"],
        ["look", "other.csv"],
    ],
)
def test_every_command_that_reads_a_log_takes_other_names(here, command, arguments):
    text = (here / "day.csv").read_text("utf-8").replace("T1_degC", "Fühler 1", 1)
    (here / "other.csv").write_text(text.replace("T3_degC", "Fühler 3", 1), encoding="utf-8")
    (here / "map.toml").write_text("[columns]\n'Fühler 1' = 'T1_degC'\n", encoding="utf-8")
    names = ["--mapping", "map.toml", "--column", "Fühler 3=T3_degC"]
    code, told = command(*arguments, *names)
    assert not code, told
    assert "ignored" not in told


def test_what_takes_long_says_so(here, command):
    """With -v every part says how long it took; without, a line comes after two seconds."""
    estimated = command("estimate", "model.json", "day.csv", "--out", "e.csv", "-v")[1]
    assert "estimating: " in estimated
    assert signature(console.progress_lines).parameters["first_s"].default <= 2.0


def test_displacements_read_apart_are_drawn_over_the_same_hours(command, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        "thermojoint.pictures.judged.write_figure", lambda figure, path, dpi: drawn.append(figure)
    )
    log = machine_log()
    for name, first in (("x_um", 0), ("z_um", 1)):
        own = np.arange(len(log.times)) % 10 == first
        log = changed(log, name, lambda values, own=own: np.where(own, values, np.nan))
    as_csv(log, tmp_path / "log.csv")
    made = ["--out", "model.json", "--figure", "held.png"]
    assert command("learn", "log.csv", *LEARN, *made)[0] == 0
    code, told = command("validate", "model.json", "log.csv", "--out", "v.png")
    assert code == 0, told
    for figure, points in zip(drawn, (0, 84), strict=True):
        for panel in figure.axes:
            hours = panel.get_lines()[1].get_xdata()
            assert hours[0] < 1.0
            assert 10.0 < hours[-1] < 14.0
            # The readings of a log are points, and a curve where all rows are readings.
            assert len(panel.get_lines()[1].get_markevery()) == points


def test_a_displacement_along_an_axis_has_a_slope_in_every_table(command, tmp_path):
    log, _, _ = along_log(every=5)
    as_csv(log, tmp_path / "log.csv")
    as_csv(along_log(hours=4.0, seed=5, start=500000.0)[0], tmp_path / "day.csv")
    wanted = ["--displacement", "x_um@y_pos_mm", "--out", "model.json", "--figure", "held.svg"]
    assert command("learn", "log.csv", *wanted)[0] == 0
    code, told = command("validate", "model.json", "day.csv", "--json", "s.json", "--out", "v.png")
    assert code == 0, told
    [row] = json.loads((tmp_path / "s.json").read_text())["rows"]
    assert row["rms_error_um"] < 0.2 * row["rms_uncompensated_um"]
    as_csv(log.part(slice(0, 1)), tmp_path / "readings.csv", ["x_um", "y_pos_mm"])
    for more in ([], ["--readings", "readings.csv"]):
        assert command("estimate", "model.json", "log.csv", "--out", "e.csv", *more)[0] == 0
        table = list(csv.DictReader((tmp_path / "e.csv").open()))
        names = ["x_slope_um_per_m", "x_slope_band_um_per_m", "x_P0_mm", "x_here_um"]
        assert set(names) <= table[0].keys()
        last = {name: float(table[-1][name] or "nan") for name in [*names, "x_um"]}
        assert 40.0 < last["x_P0_mm"] < 60.0
        if not more:
            lever = 1e3 * log.at("y_pos_mm")[-1] - last["x_P0_mm"]
            there = last["x_um"] + 1e-3 * lever * last["x_slope_um_per_m"]
            assert last["x_here_um"] == pytest.approx(there, abs=1e-3)
    line = '[axes.X]\nfollows = "x"\n[axes.X.slope]\nresolution_um_per_m = 1.0\n'
    limits = "cycle_s = 10.0\noldest_s = 120.0\nwidest_band_um = 100.0\n"
    (tmp_path / "line.toml").write_text(limits + line)
    code, told = command("compensate", "e.csv", "--settings", "line.toml", "--out", "line.csv")
    assert code == 0, told
    sent = list(csv.DictReader((tmp_path / "line.csv").open()))[-1]
    assert float(sent["P0_X_mm"]) == last["x_P0_mm"]
    for lever in (-0.1, 0.0, 0.1):
        wanted = last["x_um"] + lever * last["x_slope_um_per_m"]
        line = float(sent["offset_X_um"]) + lever * float(sent["slope_X_um_per_m"])
        assert line == pytest.approx(-wanted, abs=0.06 + 0.51 * abs(lever))
    code, told = command("learn", "log.csv", "--displacement", "x_um@nowhere", "--out", "m.json")
    assert code == 2
    assert "nowhere" in told
