"""No command costs anybody a file: inputs and files of another kind are never overwritten."""

import errno
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from own_process import OwnProcess
from reference_case import lasting
from small_disk import fill, mounted

from benchmarks.fuzz_inputs import unharmed
from fesim.batch import folder as batch_folder
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import write_response
from thermojoint.cli.arguments import write_json
from thermojoint.models.model_file import Provenance, write_model

SHORT = lasting(0.1)
SAMPLES = "time_s,delta_T_K,T1_K,T2_K\n" + "".join(f"{2 * k},{0.01 * k},0,0\n" for k in range(20))


@pytest.fixture(scope="module")
def originals(tmp_path_factory, coarse_response, hand_made_model):
    """Content of one file of each kind, by name."""
    folder = tmp_path_factory.mktemp("originals")
    name, given = next((n, f) for f, n in unharmed(folder) if n.endswith(".msh"))
    for file, content in given.items():
        (folder / file).write_bytes(content)
    (folder / name).rename(folder / "part.msh")
    (folder / "case.toml").write_text(SHORT)
    driven = SHORT.replace('kind = "step"\nlevel = 1.0', 'kind = "sampled"\nfile = "heat.csv"')
    assert driven != SHORT
    (folder / "driven.toml").write_text(driven)
    (folder / "heat.csv").write_text("time_s,heat_input\n0,0\n2,1\n6,1\n")
    (folder / "samples.csv").write_text(SAMPLES)
    write_response(coarse_response, folder / "response.nc")
    measured = coarse_response[["heat_input", "temperature", "displacement"]].copy()
    del measured.attrs["case"]
    write_response(measured, folder / "measured.nc")
    write_model(hand_made_model, folder / "model.json", Provenance(case="by hand"))
    (folder / "notes.md").write_text("# Verification of my own\n")
    return {one.name: one.read_bytes() for one in folder.iterdir() if one.is_file()}


@pytest.fixture
def at_hand(originals, tmp_path, monkeypatch):
    """A folder with those files, which is the working one."""
    for name, content in originals.items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def untouched(folder, originals, *, besides=()):
    names = {one.name for one in folder.iterdir()}
    return names - {*besides} == set(originals) and all(
        (folder / name).read_bytes() == content for name, content in originals.items()
    )


CALIBRATE = ["calibrate", "--reference", "response.nc", "--input", "2=measured.nc"]
SLIPS = {
    "response over its case": ["simulate", "case.toml", "--out", "case.toml"],
    "response over a history": ["simulate", "driven.toml", "--out", "heat.csv"],
    "response over a measured one": ["simulate", "case.toml", "--out", "measured.nc"],
    "response over a model": ["simulate", "case.toml", "--out", "model.json"],
    "state over the case": ["simulate", "case.toml", "--out", "o.nc", "--save-state", "case.toml"],
    "state over the response": ["simulate", "case.toml", "--out", "o.nc", "--save-state", "o.nc"],
    "model over the reference": [*CALIBRATE, "--out", "response.nc"],
    "model over a measurement": [*CALIBRATE, "--out", "measured.nc"],
    "estimate over the model": ["estimate", "model.json", "samples.csv", "--out", "model.json"],
    "estimate over the samples": ["estimate", "model.json", "samples.csv", "--out", "samples.csv"],
    "estimate over a history": ["estimate", "model.json", "samples.csv", "--out", "heat.csv"],
    "validation over the model": ["validate", "model.json", "response.nc", "--json", "model.json"],
    "verification over a case": ["verify", "--json", "case.toml"],
    "page over notes": ["verify", "--markdown", "notes.md"],
    "picture over the mesh": ["inspect", "part.msh", "--out", "part.msh"],
    "draft over a case": ["inspect", "part.msh", "--case", "case.toml"],
    "inspection over a model": ["inspect", "part.msh", "--json", "model.json"],
    "picture over the case": ["view", "case.toml", "--out", "case.toml"],
    "picture over the response": ["view", "response.nc", "--out", "response.nc"],
    "mesh over a case": ["mesh", "part.step", "--size-mm", "9", "--out", "case.toml"],
    "mesh over its part": ["mesh", "part.msh", "--size-mm", "9", "--out", "part.msh"],
    "results over other files": ["reproduce", "--case", "case.toml", "--out", "."],
    "snapshots over other files": [*("simulate", "case.toml", "--out", "o.nc", "--snapshots", ".")],
    "no name for a response": ["simulate", "case.toml", "--out", "-"],
    "no name for a state": ["simulate", "case.toml", "--out", "o.nc", "--save-state", "-"],
    "a device": ["simulate", "case.toml", "--out", "/dev/null"],
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_ends_in_one_line_and_no_file_changes(slip, command, at_hand, originals):
    code, _, err = command(*SLIPS[slip])
    assert (code, err.count("\n")) == (2, 1)
    assert untouched(at_hand, originals)


@pytest.mark.parametrize("link", ["symbolic", "hard", "way round"])
def test_an_input_is_known_by_every_name_it_has(link, command, at_hand, originals):
    other = at_hand / "other.csv"
    if link == "symbolic":
        other.symlink_to(at_hand / "samples.csv")
    elif link == "hard":
        other.hardlink_to(at_hand / "samples.csv")
    else:
        (at_hand / "below").mkdir()
        other = at_hand / "below" / ".." / "samples.csv"
    code, _, err = command("estimate", "model.json", "samples.csv", "--out", other)
    assert code == 2
    assert "is an input of this command" in err
    assert untouched(at_hand, originals, besides=["other.csv", "below"])


def test_outputs_of_an_earlier_run_are_replaced(command, at_hand):
    """Every kind of output is told from all others by what the command itself writes."""
    runs = [
        ["simulate", "case.toml", "--out", "o.nc", "--save-state", "s.npz", "--snapshots", "v"],
        ["estimate", "model.json", "samples.csv", "--out", "e.csv", "--save-state", "e.json"],
        ["inspect", "part.msh", "--json", "i.json"],
        *(["view", "response.nc", "--out", f"v.{suffix}"] for suffix in ("png", "svg", "pdf")),
    ]
    for arguments in runs:
        for _ in range(2):
            assert command(*arguments)[0] == 0


def test_a_state_may_be_replaced_by_its_successor(command, at_hand):
    estimate = ["estimate", "model.json", "samples.csv", "--out"]
    assert command(*estimate, "one.csv", "--save-state", "state.json")[0] == 0
    later = "".join(f"{100 + 2 * k},0.2,0,0\n" for k in range(5))
    (at_hand / "later.csv").write_text("time_s,delta_T_K,T1_K,T2_K\n" + later)
    before = (at_hand / "state.json").read_bytes()
    going_on = ["estimate", "model.json", "later.csv", "--out", "two.csv", "--interval-s", "2"]
    code, _, err = command(*going_on, "--continue", "state.json", "--save-state", "state.json")
    assert code == 0
    assert sum(line.startswith("wrote ") for line in err.splitlines()) == 2
    assert (at_hand / "state.json").read_bytes() != before


@pytest.mark.parametrize(
    ("ended", "begins", "told"),
    [
        ("23:59:58", "00:00:00", "begins at 0 s, and state.json ended at 86398 s; give what comes"),
        ("23:59:58", "2026-03-03T00:00:00", "ended at 86398 s: only one has a date"),
        ("2026-03-02T23:59:58", "00:00:00", "ended at 1772495998 s: only one has a date"),
    ],
)
def test_a_run_is_not_continued_on_another_clock(command, at_hand, ended, begins, told):
    """A date alone would be a pause of decades."""
    estimate = ["estimate", "model.json", "rows.csv", "--interval-s", "2", "--out", "e.csv"]
    row = "time,delta_T_K,T1_K,T2_K\n{},0.2,0,0\n"
    (at_hand / "rows.csv").write_text(row.format(ended))
    assert command(*estimate, "--save-state", "state.json")[0] == 0
    (at_hand / "rows.csv").write_text(row.format(begins))
    code, _, err = command(*estimate, "--continue", "state.json")
    assert (code, told in err) == (2, True), err


def test_a_run_is_continued_by_a_single_sample(command, at_hand):
    """Its coefficients are those of the run: no interval has to be given."""
    estimate = ["estimate", "model.json", "samples.csv", "--out"]
    assert command(*estimate, "one.csv", "--save-state", "state.json")[0] == 0
    (at_hand / "later.csv").write_text("time_s,delta_T_K,T1_K,T2_K\n100,0.2,0,0\n")
    going_on = ["estimate", "model.json", "later.csv", "--continue", "state.json", "--out"]
    assert command(*going_on, "two.csv")[0] == 0
    assert command(*going_on, "three.csv", "--interval-s", "2")[0] == 0
    assert (at_hand / "two.csv").read_text() == (at_hand / "three.csv").read_text()


#: The last argument names a file of a kind that is not written.
MISNAMED = {
    "o.nc": ["simulate", "case.toml", "--out", "o.csv"],
    "s.npz": ["simulate", "case.toml", "--out", "o.nc", "--save-state", "s.json"],
    "e.csv": ["estimate", "model.json", "samples.csv", "--out", "e.json"],
    "v.json": ["validate", "model.json", "response.nc", "--json", "v.csv"],
}


@pytest.mark.parametrize("better", MISNAMED)
def test_a_name_that_promises_another_kind_of_file_is_refused(better, command, at_hand, originals):
    code, _, err = command(*MISNAMED[better])
    assert (code, err.count("\n")) == (2, 1)
    assert f"name it {better}" in err
    assert untouched(at_hand, originals)


#: Writes a response to a disk that is full after 4 KiB.
FULL = """
import resource, sys, types
from thermojoint.artefacts.response import read_response, write_response
from thermojoint.cli import main as cli

def work(**_):
    response = read_response("response.nc")
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
    write_response(response, "out.nc")

sys.modules["thermojoint.cli.app"] = types.SimpleNamespace(app=work)
cli.main()
"""


def test_a_full_disk_ends_in_one_line_and_leaves_nothing(at_hand, originals):
    # What measures coverage could not write either.
    given = {name: one for name, one in os.environ.items() if not name.startswith("COVERAGE")}
    command = [sys.executable, "-c", FULL]
    done = subprocess.run(command, env=given, capture_output=True, text=True, check=False)
    told = "thermojoint: out.nc: File too large; choose another place\n"
    assert (done.returncode, done.stderr) == (2, told)
    assert untouched(at_hand, originals)


class Full(io.StringIO):
    """A stream onto a full disk: what it holds back it cannot write."""

    def flush(self):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_standard_output_that_takes_no_more_is_named(monkeypatch):
    monkeypatch.setattr(sys, "stdout", Full())
    with pytest.raises(OSError, match="No space left on device: 'standard output'"):
        write_json(Path("-"), {"errors": [0.1]})


@pytest.mark.parametrize("left", [0, 8192])
@pytest.mark.parametrize("arguments", [[], ["--save-state", "disk/state.npz"]])
def test_a_simulation_onto_a_full_disk_ends_in_one_line(left, arguments, at_hand):
    """No crash of a library, and no hidden file that takes the last byte."""
    with mounted(at_hand / "disk", 1) as disk:
        (disk / "kept").write_bytes(bytes(left))
        fill(disk)
        (disk / "kept").unlink()
        with (at_hand / "said").open("w") as said:
            words = ["simulate", "case.toml", "--out", "disk/out.nc", *arguments]
            assert OwnProcess(*words, stderr=said).wait() == 2
        assert "No space left on device" in (at_hand / "said").read_text().splitlines()[-1]
        assert [one.name for one in disk.iterdir()] == ["filler"]


def test_an_empty_file_is_no_loss(command, at_hand):
    (at_hand / "o.nc").touch()
    assert command("simulate", "case.toml", "--out", "o.nc")[0] == 0


def test_a_batch_leaves_a_folder_of_another_origin_alone(tmp_path):
    (tmp_path / "summary.csv").write_text("mine")
    with (
        pytest.raises(InputError, match=r"a summary\.csv of another origin"),
        batch_folder.locked(tmp_path),
    ):
        pytest.fail("nothing is written")
    assert [one.name for one in tmp_path.iterdir()] == ["summary.csv"]
