"""Pictures of machines that move: arrows over the volume, bodies where the axes take them."""

from importlib.resources import files

import numpy as np
import pytest
from in_process import run

from fesim.case.schema import case_from_data
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.pictures.moving import moving_scenes, volume_figure
from thermojoint.pictures.show import Show
from thermojoint.pictures.view import draw
from thermojoint.verification.axis_chain import chain_data, on_axes

UP = (0.0, 1.0, 0.0)


def quiet(*_):
    pass


def draw_case(case, show, out):
    """By the response that has it."""
    response = simulate(case).response
    response.to_netcdf(out.with_suffix(".nc"))
    draw(out.with_suffix(".nc"), show, out, quiet)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving")
    (folder / "x.csv").write_text("time_s,position_mm\n0,0\n120,240\n")
    return folder


@pytest.fixture(scope="module")
def case(folder):
    courses = {"x": {"file": "x.csv"}, "y": {"position_mm": 0.0}, "z": {"position_mm": 100.0}}
    data = on_axes(chain_data(folder, (0.0, 0.0, 0.0)), courses)
    data["march"] = {"step_s": 60.0, "duration_min": 2.0}
    data["volume"] = {"grid_mm": {"x": [-100.0, 100.0], "y": [0.0], "z": [0.0, 50.0, 100.0]}}
    return case_from_data(data, "chain", folder)


def test_a_film_shows_the_bodies_where_the_axes_have_taken_them(case):
    _, first, last = moving_scenes(case, quiet, 3, UP)
    (before,), (after,) = first.panels[0].surfaces, last.panels[0].surfaces
    moved = after.points - before.points
    # The column and the ram on it go 120 mm along x in a step; the bed and the table stand.
    ways = np.unique(np.round(moved, 9), axis=0)
    assert ways.tolist() == [[0.0, 0.0, 0.0], [0.12, 0.0, 0.0]]
    assert after.values.max() > before.values.max() > 0.0
    assert last.caption == "2 min"
    assert last.curve.now == 120.0


def test_a_film_of_a_moving_machine_begins_at_rest(case):
    rest, *_ = film = moving_scenes(case, quiet, 3, UP)
    assert [scene.curve.now for scene in film] == [0.0, 60.0, 120.0]
    (skin,) = rest.panels[0].surfaces
    assert not skin.values.any()


def test_where_the_mesh_shows_the_axes_does_not_move_the_picture_alone(case):
    """The table stands at 100 mm of z, and is drawn there."""
    first, *_ = moving_scenes(case, quiet, 3, UP)
    (skin,) = first.panels[0].surfaces
    # Of the table at zero z ends at 700 mm, of the bed at 900 mm.
    top = skin.points[np.abs(skin.points[:, 1] - 0.1) < 1e-9]
    assert top[:, 2].max() == pytest.approx(0.8)


def test_arrows_over_the_volume_are_its_displacements_and_rotations(case):
    response = simulate(case.replace(axes={"x": {"rotation_within_mm": 150.0}})).response
    figure = volume_figure(response, case)
    shown = [axes for axes in figure.axes if axes.get_title()]
    bars = [axes.get_ylabel() for axes in figure.axes if not axes.get_title()]
    assert bars == ["displacement (µm)", "rotation (µrad)"]
    for axes, name in zip(shown, ("displacement", "rotation"), strict=True):
        assert axes.get_title().startswith(f"{name} of ")
        assert "2 min" in axes.get_title()
        (found,) = (one.get_array() for one in axes.collections if one.get_array() is not None)
        sizes = 1e6 * np.linalg.norm(response[f"volume_{name}"][-1], axis=1)
        # A shaft and two sides of a head.
        assert np.allclose(found.reshape(3, -1), sizes)


def test_a_case_without_a_volume_is_told_before_it_is_simulated(tmp_path, capsys):
    shipped = files("thermojoint").joinpath("cases/moving_knee.toml")
    assert run("view", shipped, "--show", "volume", "--out", tmp_path / "a.png") == 2
    said = capsys.readouterr().err
    assert "add [volume]" in said
    assert "marching" not in said


def test_a_response_that_ends_before_the_survey_is_refused_in_one_line(case):
    response = simulate(case).response
    early = response.drop_vars([name for name in response if str(name).startswith("volume")])
    with pytest.raises(InputError, match="says nothing of the volume"):
        volume_figure(early, case)


def test_temperature_and_curves_of_a_moving_machine_are_drawn(case, folder):
    for show in (Show.temperature, Show.pressures):
        path = folder / f"{show}.png"
        draw_case(case, show, path)
        assert path.stat().st_size > 10_000


@pytest.mark.parametrize("more", [["--film"], []], ids=["film", "picture"])
def test_of_a_moving_machine_only_the_temperature_is_drawn(tmp_path, capsys, more):
    shipped = files("thermojoint").joinpath("cases/moving_knee.toml")
    out = tmp_path / ("a.gif" if more else "a.png")
    assert run("view", shipped, *more, "--show", "pressure", "--out", out) == 2
    assert "--show temperature is drawn" in capsys.readouterr().err
