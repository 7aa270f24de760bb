"""`thermojoint look`, the examples of docs/tables.md, and the same model from any dialect."""

import re
import shlex

import numpy as np
import pytest
from machine_logs import as_csv, machine_log
from repository import ROOT

from calibrate.learning.learn import learn
from thermojoint.artefacts.log import joined
from thermojoint.artefacts.log_file import log_pieces
from thermojoint.artefacts.tables.pieces import pieces_in


@pytest.fixture(autouse=True)
def folder_of_its_own(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def test_every_example_of_the_page_is_the_same_log():
    page = (ROOT / "docs" / "tables.md").read_text("utf-8")
    examples = re.findall(r"```csv\n(.*?)```", page, re.DOTALL)
    assert len(examples) == 5
    first, *others = [joined(pieces_in(one.splitlines(keepends=True), "page")) for one in examples]
    for log in others:
        np.testing.assert_array_equal(log.times, first.times)
        np.testing.assert_array_equal(log.values, first.values)


def test_a_look_says_what_was_read_and_what_to_do_next(command, tmp_path):
    night = "".join(
        f"{t},20.5,{t % 7},---\n" for t in (*range(0, 7200, 60), *range(50_000, 57_200, 60))
    )
    (tmp_path / "log.csv").write_text("time_s,T1_degC,x_um,T2_degC\n" + night)
    code, out, _ = command("look", "log.csv", "--out", "log.png")
    assert code == 0
    assert "2 runs, 1 pause" in out
    assert "T2_degC: readings missing: 240 x ---" in out
    assert "next: thermojoint learn log.csv --displacement x_um --out model.json" in out
    assert (tmp_path / "log.png").read_bytes().startswith(b"\x89PNG")
    # What it names is a command line as it stands.
    line = next(one for one in out.splitlines() if one.startswith("next: "))
    assert shlex.split(line)[1:3] == ["thermojoint", "learn"]


def test_a_look_suggests_the_position_of_a_displacement_along_an_axis(command, tmp_path):
    rows = "".join(f"{60 * t},{20 + 0.1 * t},{t % 7},{t % 5 * 100}\n" for t in range(200))
    (tmp_path / "log.csv").write_text("time_s,T1_degC,x_um,y_pos_mm\n" + rows)
    code, out, _ = command("look", "log.csv")
    assert code == 0
    assert "next: thermojoint learn log.csv --displacement x_um@y_pos_mm --out model.json" in out


def test_positions_and_odometers_have_panels_of_their_own(command, tmp_path, monkeypatch):
    """A stroke of 600 mm beside a displacement of 7 µm left of it a straight line."""
    drawn = []

    def keep(figure, path, dpi):
        drawn.append(figure)

    monkeypatch.setattr("thermojoint.pictures.log.write_figure", keep)
    rows = "".join(f"{60 * t},{20 + 0.1 * t},{t % 7},{t % 5 * 150},{t * 100}\n" for t in range(200))
    (tmp_path / "log.csv").write_text("time_s,T1_degC,x_um,y_pos_mm,y_way_mm\n" + rows)
    code, out, _ = command("look", "log.csv", "--out", "log.png")
    assert code == 0
    assert "learn log.csv --displacement x_um@y_pos_mm --out" in out
    tops = {
        panel.get_ylabel(): max(line.get_ydata().max() for line in panel.get_lines())
        for panel in drawn[0].axes
    }
    assert tops["displacement (µm)"] == pytest.approx(6.0)
    assert tops["position (mm)"] == pytest.approx(600.0)
    assert tops["way (m)"] == pytest.approx(19.9)


@pytest.mark.parametrize(
    ("columns", "label"),
    [("T1_degC,T2_degF", "°C"), ("T1_K,T2_K", "K"), ("T1_K,T2_degC", "K and °C")],
)
def test_temperatures_in_kelvin_are_not_drawn_as_degrees_celsius(
    columns, label, command, tmp_path, monkeypatch
):
    drawn = []
    monkeypatch.setattr(
        "thermojoint.pictures.log.write_figure", lambda figure, path, dpi: drawn.append(figure)
    )
    rows = "".join(f"{60 * t},{20 + 0.1 * t},{30 + 0.1 * t}\n" for t in range(20))
    (tmp_path / "log.csv").write_text(f"time_s,{columns}\n{rows}")
    assert command("look", "log.csv", "--out", "log.png")[0] == 0
    assert drawn[0].axes[0].get_ylabel() == f"temperature ({label})"


def test_a_single_misreading_and_a_pause_are_seen_in_the_picture_of_a_long_log(
    command, tmp_path, monkeypatch
):
    drawn = []
    monkeypatch.setattr(
        "thermojoint.pictures.log.write_figure", lambda figure, path, dpi: drawn.append(figure)
    )
    read = {12_345: "-900", 23_456: "900"} | dict.fromkeys(range(15_000, 15_040), "")
    rows = "".join(f"{t},{read.get(t, t % 7)}\n" for t in range(30_001))
    (tmp_path / "log.csv").write_text("time_s,x_um\n" + rows)
    assert command("look", "log.csv", "--out", "log.png")[0] == 0
    (line,) = drawn[0].axes[0].get_lines()
    hours, shown = line.get_data()
    assert (np.nanmin(shown), np.nanmax(shown)) == pytest.approx((-900.0, 900.0))
    assert 3600.0 * hours[np.nanargmin(shown)] == pytest.approx(12_345.0)
    assert np.isnan(shown).any()
    assert np.all(np.diff(hours) > 0.0)
    assert len(shown) <= 8000


def test_a_reading_between_missing_ones_is_a_point_in_the_picture(command, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        "thermojoint.pictures.log.write_figure", lambda figure, path, dpi: drawn.append(figure)
    )
    rows = [(t, 20, t if t % 5 == 0 or t > 21 else "") for t in range(30)]
    text = "".join(f"{t},{warm},{moved}\n" for t, warm, moved in rows)
    (tmp_path / "log.csv").write_text("time_s,T1_degC,x_um\n" + text)
    assert command("look", "log.csv", "--out", "log.png")[0] == 0
    warm, moved = (panel.get_lines()[0] for panel in drawn[0].axes)
    assert (warm.get_markevery(), moved.get_markevery()) == ([], [0, 5, 10, 15, 20])


def test_a_look_at_no_log_ends_in_one_line_that_shows_the_value(command, tmp_path):
    (tmp_path / "log.csv").write_text("time,T1_degC\nnoon,20\n1 pm,21\n")
    code, out, err = command("look", "log.csv", "--out", "log.png")
    assert (code, out) == (2, "")
    assert "time is 'noon', which is no known form of time; write seconds" in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "log.png").exists()


def rows_of(path):
    header, *rows = path.read_text("utf-8").splitlines()
    return [name.rpartition("_") for name in header.split(",")], [row.split(",") for row in rows]


def german(header, rows):
    units = {"s": "s", "rpm": "min-1", "um": "µm", "degC": "°C"}
    names = ";".join(f"{base} [{units[unit]}]" for base, _, unit in header)
    lines = (";".join(cell.replace(".", ",") for cell in row) for row in rows)
    return "\n".join(["Messung 4;7", names, *lines]).encode("cp1252")


def units_below(header, rows):
    names = "\t".join(base for base, _, _ in header)
    units = "\t".join(unit for _, _, unit in header)
    return "\n".join([names, units, *("\t".join(row) for row in rows)]).encode("utf-16")


def blanks(header, rows):
    names = "  ".join("".join(parts) for parts in header)
    return "\n".join(["# one day", f"# {names}", *("  ".join(row) for row in rows)]).encode()


def test_a_learned_model_is_the_same_to_the_last_bit_from_three_dialects(tmp_path):
    plain = as_csv(machine_log(hours=5.0), tmp_path / "plain.csv")
    expected = learn(log_pieces([plain]), ["x"])
    for dialect in (german, units_below, blanks):
        path = tmp_path / f"{dialect.__name__}.csv"
        path.write_bytes(dialect(*rows_of(plain)))
        found = learn(log_pieces([path]), ["x"])
        assert found.channels[0].weights == expected.channels[0].weights
        assert found.learned_from.errors_um == expected.learned_from.errors_um
