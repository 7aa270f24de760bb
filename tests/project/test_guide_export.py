"""The guide to an export does what it says: its commands, its Structured Text, its figures."""

import re
import shutil
import subprocess

import pytest
from exported import needs_gcc
from page_commands import run as run_command
from repository import ROOT
from structured_text import FLAGS, Translator, in_c, parsed, run

PAGE = (ROOT / "docs" / "guide-export.md").read_text("utf-8")


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Follow the page from top to bottom, with the files that a clone has."""
    root = tmp_path_factory.mktemp("guide")
    shutil.copytree(ROOT / "examples" / "measured_machine", root / "examples/measured_machine")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S):
            for line in block.strip().splitlines():
                run_command(line, patch)
    return root / "examples/measured_machine"


@pytest.mark.long
@needs_gcc
def test_its_commands_leave_what_it_says(followed):
    for name in re.findall(r"^\| `(spindle_st/\S+)`", PAGE, re.M):
        assert (followed / name).is_file()
    done = subprocess.run(["./selftest"], cwd=followed, check=True, capture_output=True, text=True)
    assert done.stdout.endswith("agrees\n")


@needs_gcc
def test_its_structured_text_runs_with_the_block_that_was_exported(followed, tmp_path):
    [program] = re.findall(r"^```iecst\n(.*?)^```", PAGE, re.M | re.S)
    files = {one.name: one.read_text("utf-8") for one in (followed / "spindle_st").glob("*.st")}
    assert run(files, "spindle", tmp_path)["samples"] == 418
    Translator().program(parsed(files["spindle.st"] + program))
    text = (
        in_c(files["spindle.st"], program)
        + """
static prg_compensation_t all;
int main(void)
{ begin_prg_compensation(&all);
  /* As cold as the log goes: the past of a warm machine is unknown, and no axis follows. */
  all.v_temp3_degc = 24.76; all.v_temp4_degc = 20.7; all.v_temp9_degc = 31.15;
  all.v_temp10_degc = 25.53; all.v_spindle_rpm = 3750.0;
  for (int k = 0; k < 10; k++) prg_compensation(&all);
  return !(all.v_spindle.v_status == 0 && all.v_offset_um != 0.0 && !all.v_first); }
"""
    )
    (tmp_path / "page.c").write_text(text, encoding="utf-8")
    subprocess.run(["gcc", *FLAGS, "page.c", "-lm", "-o", "page"], cwd=tmp_path, check=True)
    subprocess.run(["./page"], cwd=tmp_path, check=True)
