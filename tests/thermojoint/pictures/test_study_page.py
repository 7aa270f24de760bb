"""The page of a batch: what varied, quantiles of its figures, pictures of all cases."""

import numpy as np
import pandas as pd
import pytest
from batch_cases import grid, write_study
from in_process import run

from fesim.batch.summary import FIGURES
from thermojoint.pictures.study_figures import fan_figure, map_figure, pair_figure, strongest
from thermojoint.pictures.study_page import figure_rows

CUBE = """
[latin_hypercube]
samples = 6
seed = 1
ranges = [
  { path = "heat_input.level", low = 0.5, high = 2.0 },
  { path = "joints.knee.preload_MPa", low = 2.0, high = 6.0 },
]
"""


@pytest.fixture(scope="module")
def table():
    rng = np.random.default_rng(1)
    heat, film = rng.uniform(0.5, 2.0, 40), rng.uniform(4.0, 8.0, 40)
    return pd.DataFrame({"heat": heat, "film": film, "moved": 90.0 * heat - 2.0 * film})


def test_the_value_that_a_figure_follows_comes_first(table):
    assert strongest(table, ["film", "heat"], "moved") == ["heat", "film"]


def test_a_fan_is_the_quantiles_of_its_curves():
    minutes = np.linspace(0.0, 10.0, 11)
    curves = np.outer(np.arange(101.0), minutes)
    curves[:, -1] = np.nan
    axes = fan_figure(minutes, curves, "x (µm)").axes[0]
    (median,) = (line for line in axes.lines if line.get_label() == "median")
    np.testing.assert_allclose(median.get_ydata(), 50.0 * minutes[:-1])
    outer = axes.collections[0].get_paths()[0].vertices
    assert outer[:, 1].max() == pytest.approx(95.0 * 9.0)


def test_a_fan_of_steps_of_different_lengths_has_every_case_at_every_time_of_its_run():
    minutes = np.arange(7.0)
    curves = np.outer([1.0, 2.0, 3.0], minutes)
    curves[1:, 1::2] = np.nan
    curves[2, 5:] = np.nan
    curves = np.vstack([curves, np.full(7, np.nan)])
    axes = fan_figure(minutes, curves, "x (µm)").axes[0]
    (median,) = (line for line in axes.lines if line.get_label() == "median")
    expected = np.where(minutes <= 4.0, 2.0, 1.5) * minutes
    np.testing.assert_allclose(median.get_ydata(), expected)


def test_pairs_show_each_column_against_each(table):
    assert len(pair_figure(table).axes) == 9


@pytest.mark.parametrize("lines", [True, False])
def test_a_map_has_lines_only_where_the_cases_span_an_area(table, lines):
    film = table["film"] if lines else pd.Series(2.0 * table["heat"], name="film")
    axes = map_figure(table["heat"], film, table["moved"]).axes[0]
    assert (len(axes.collections) > 1) == lines


def test_a_batch_writes_its_page(tmp_path):
    path, page = write_study(tmp_path, CUBE, 1.0), tmp_path / "study.html"
    assert run("batch", path, "--out", tmp_path / "out", "--workers", 1, "--page", page) == 0
    text = page.read_text()
    for part in ("6 done", "heat_input.level", "displacement_x_final_um", "Every pair"):
        assert part in text
    assert text.count("<img ") >= 4
    assert "http" not in text.replace("http://www.w3.org", "")


def test_the_page_of_one_case_has_its_values_and_its_figures(tmp_path):
    path, page = write_study(tmp_path, grid("heat_input.level", 1.5), 1.0), tmp_path / "study.html"
    assert run("batch", path, "--out", tmp_path / "out", "--workers", 1, "--page", page) == 0
    text = page.read_text()
    assert "<th>heat_input.level</th><td>1.5</td>" in text
    final = pd.read_csv(tmp_path / "out" / "summary.csv")["displacement_x_final_um"][0]
    assert text.count(f'<td class="n">{final:.4g}</td>') >= 5
    assert "Every pair" not in text


def test_a_page_shows_the_values_of_failed_cases_and_figures_that_only_some_cases_have(tmp_path):
    """What fails lies outside the column."""
    places = [[625.0, 450.0, 87.5], [700.0, 1000.0, 87.5]]
    varied = grid("probes.T1.position_mm", *places) + grid("heat_input.level", 1.0, 2.0)
    path, page = write_study(tmp_path, varied, 1.0), tmp_path / "study.html"
    assert run("batch", path, "--out", tmp_path / "out", "--workers", 1, "--page", page) == 1
    text = page.read_text()
    assert "<th>probes.T1.position_mm</th><td>2 different</td>" in text
    assert "displacement_x_final_um" in text
    summary = pd.DataFrame(
        {"id": ["a", "b"], "status": "done", "reason": "", "level": [1.0, 2.0]}
        | {"displacement_x_final_um": [3.0, np.nan], "pressure_max_MPa": 5.0}
    )
    assert [row[0] for row in figure_rows(summary, FIGURES)] == [
        "displacement_x_final_um",
        "pressure_max_MPa",
    ]


def test_a_page_replaces_nothing_else(tmp_path, capsys):
    path = write_study(tmp_path, CUBE, 1.0)
    page = tmp_path / "mine.html"
    page.write_text("<p>my own</p>")
    assert run("batch", path, "--out", tmp_path / "out", "--page", page) == 2
    assert "mine.html" in capsys.readouterr().err
    assert page.read_text() == "<p>my own</p>"
