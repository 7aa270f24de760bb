"""The page for one's own machine with a moving axis does what it says."""

import numpy as np
import pytest
import xarray as xr
from page_commands import blocks_of, copied, files_of, follow
from repository import ROOT
from step_files import needs_gmsh

PAGE = ROOT / "docs" / "your-own-moving-machine.md"
SLIDE = ROOT / "examples" / "slide"
BLOCKS = blocks_of(PAGE)
FILES = files_of(BLOCKS)


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Follow the page from top to bottom, with the files that a clone has."""
    root = tmp_path_factory.mktemp("moving")
    folder = copied(SLIDE, ("slide.step", *FILES), root)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        follow(BLOCKS, patch)
    return folder


def test_every_file_of_the_page_is_in_the_examples_as_it_stands_there():
    assert set(FILES) == {"names.toml", "slide.toml", "strokes.csv"}
    for name, content in FILES.items():
        assert (SLIDE / name).read_text("utf-8") == content, name


@needs_gmsh
def test_the_commands_of_the_page_take_parts_to_a_line(followed, capsys, monkeypatch):
    assert (followed / "curves.png").exists()
    response = xr.load_dataset(followed / "slide.nc")
    assert float(np.abs(response["heat_balance"]).max()) < 1e-8
    assert float(response["gap_residual"].max()) < 1e-11
    end = response.isel(time=-1, moving_axis=0)
    # The motor's heat raises the tool; friction heats the way from its first stroke on.
    assert float(response["displacement"].sel(axis="z")[-1]) > 1e-5
    assert float(response["running_heat"].max()) > 0.0
    line = end["line_offset"] + end["line_slope"] * (
        end["asked_position"] - end["reference_position"]
    )
    left = np.abs(end["asked_displacement"] - line).max("asked")
    np.testing.assert_allclose(left, end["line_left"], atol=1e-12)
    monkeypatch.chdir(followed)
    for one in BLOCKS:
        if one.language == "python":
            exec(compile(one.content, str(PAGE), "exec"), {})
    assert capsys.readouterr().out
