"""Page and notebook for Python users do what they say; the page names every public thing."""

import json
import re

import numpy as np
import pytest
from repository import ROOT

import thermojoint

PAGE = ROOT / "docs" / "api.md"
TEXT = PAGE.read_text("utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", TEXT, re.M | re.S)


@pytest.fixture(scope="module", autouse=True)
def calibrated_once(few_starts):
    """Page and notebook calibrate from the same responses; it is done for the first of them."""
    calibrate, kept = thermojoint.calibrate, []

    def once(reference, others):
        if not kept:
            kept.extend((reference, calibrate(reference, others)))
        sensors = ["a", "b", "T1", "T2"]
        for name in ("temperature", "displacement"):
            found, first = (one.sel(probe=sensors)[name] for one in (reference, kept[0]))
            np.testing.assert_allclose(found, first, rtol=0.0, atol=1e-9)
        return kept[1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(thermojoint, "calibrate", once)
        yield


@pytest.fixture(scope="module")
def after(tmp_path_factory):
    """What the page has defined at its end, run in a folder that looks like a clone."""
    folder = tmp_path_factory.mktemp("clone")
    (folder / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
    names = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in BLOCKS:
            exec(compile(block, str(PAGE), "exec"), names)
    return names


@pytest.mark.long
def test_the_page_runs_from_top_to_bottom(after):
    assert after["measured"].sizes == {"time": 3, "probe": 2, "axis": 1}


@pytest.mark.long
def test_the_estimate_of_the_page_is_near_what_the_machine_does(after):
    found, actual = after["estimate"].displacement, after["steps"][2.0]["displacement"][-1]
    assert found[0] == pytest.approx(float(actual.sel(axis="x")), rel=0.05)


def test_the_table_of_the_page_has_every_public_name_once():
    table = TEXT.split("## Public names")[1]
    assert sorted(re.findall(r"`(\w+)`", table)) == sorted(thermojoint.__all__)


@pytest.mark.long
def test_the_notebook_runs(tmp_path, monkeypatch):
    path = ROOT / "examples" / "notebook" / "first_steps.ipynb"
    cells = json.loads(path.read_text("utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in cells)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    names = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), str(path), "exec"), names)
    assert names["errors"]["max_abs_error_um"].max() < 10.0
