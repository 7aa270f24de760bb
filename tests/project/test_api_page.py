"""The page for Python users does what it says: it names every public thing, and it runs."""

import re

import pytest
from repository import ROOT

import thermojoint

PAGE = ROOT / "docs" / "api.md"
TEXT = PAGE.read_text("utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", TEXT, re.M | re.S)


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


def test_the_page_runs_from_top_to_bottom(after):
    assert after["measured"].sizes == {"time": 3, "probe": 2, "axis": 1}


def test_the_estimate_of_the_page_is_near_what_the_machine_does(after):
    found, actual = after["estimate"].displacement, after["steps"][2.0]["displacement"][-1]
    assert found[0] == pytest.approx(float(actual.sel(axis="x")), rel=0.05)


def test_the_table_of_the_page_has_every_public_name_once():
    table = TEXT.split("## Public names")[1]
    assert sorted(re.findall(r"`(\w+)`", table)) == sorted(thermojoint.__all__)
