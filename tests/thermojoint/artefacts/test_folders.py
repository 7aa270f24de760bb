"""Folders that are replaced whole or not at all, whatever ends the process in between."""

import json
import os
import subprocess
import sys

import pytest
import small_disk

from thermojoint.artefacts import folders
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.folders import CONTENTS, check_replaceable, whole_folder


def fill(path, text, names=("a.txt", "below/b.txt")):
    with whole_folder(path) as new:
        for name in names:
            (new / name).parent.mkdir(exist_ok=True)
            (new / name).write_text(text)


def content(path):
    return {
        str(one.relative_to(path)): one.read_text()
        for one in path.rglob("*")
        if one.is_file() and one.name != CONTENTS
    }


@pytest.fixture(params=["at one stroke", "in two steps"])
def swap(request, monkeypatch):
    """Both ways to swap two folders."""
    if request.param == "in two steps":

        def impossible(one, other):
            raise OSError(22, "Invalid argument")

        monkeypatch.setattr(folders, "_exchange", impossible)


@pytest.mark.usefixtures("swap")
def test_a_folder_is_all_old_until_it_is_all_new(tmp_path):
    out = tmp_path / "results"
    fill(out, "old", ["a.txt", "gone.txt"])
    with whole_folder(out) as new:
        (new / "a.txt").write_text("new")
        assert content(out) == {"a.txt": "old", "gone.txt": "old"}
    assert content(out) == {"a.txt": "new"}
    assert json.loads((out / CONTENTS).read_text())["files"] == ["a.txt"]
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.usefixtures("swap")
def test_files_of_somebody_else_are_carried_over(tmp_path):
    out = tmp_path / "results"
    fill(out, "old")
    (out / "below" / "notes.txt").write_text("mine")
    (out / "c.txt").write_text("mine")  # the next run writes one of this name
    (out / "empty").mkdir()
    (out / "link").symlink_to(tmp_path)
    fill(out, "new", ["a.txt", "c.txt"])
    assert content(out) == {
        "a.txt": "new",
        "c.txt": "new",
        "c.txt.old": "mine",
        "below/notes.txt": "mine",
    }
    assert (out / "empty").is_dir()
    assert (out / "link").readlink() == tmp_path


def test_a_failure_leaves_the_old_folder_and_nothing_beside_it(tmp_path):
    out = tmp_path / "results"
    fill(out, "old")
    before = content(out)
    with pytest.raises(TypeError):
        fill(out, 1, ["a.txt"])  # no text
    assert content(out) == before
    assert list(tmp_path.iterdir()) == [out]


def test_a_file_that_cannot_be_written_is_told_by_the_folder_that_was_wanted(tmp_path):
    """Not by the hidden one beside it, which has gone."""
    out = tmp_path / "results"
    with pytest.raises(OSError, match=r"results'$"), whole_folder(out) as new:
        (new / "none" / "a.txt").write_text("text")
    with pytest.raises(OSError, match=r"elsewhere'$"), whole_folder(out):
        (tmp_path / "elsewhere").read_text()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_told_by_the_folder_that_was_wanted(tmp_path):
    """Not as 'file', which is all that the system says of it."""
    with small_disk.mounted(tmp_path / "disk", 1) as disk:
        small_disk.fill(disk)
        with pytest.raises(OSError, match="No space left") as caught, whole_folder(disk / "out"):
            pass
        assert caught.value.filename == str(disk / "out")
        assert [one.name for one in disk.iterdir()] == ["filler"]


def test_a_folder_of_another_origin_is_refused_and_untouched(tmp_path):
    out = tmp_path / "thesis"
    out.mkdir()
    (out / "model.json").write_text("mine")
    with pytest.raises(InputError, match="another origin"), whole_folder(out):
        pytest.fail("nothing is built")
    assert content(tmp_path) == {"thesis/model.json": "mine"}
    with pytest.raises(InputError, match="is a file"):
        check_replaceable(out / "model.json")
    with pytest.raises(InputError, match="mount"):
        check_replaceable("/proc")


def test_an_empty_folder_and_a_link_to_one_of_ours_are_filled(tmp_path):
    (tmp_path / "empty").mkdir()
    fill(tmp_path / "empty", "new")
    (tmp_path / "link").symlink_to(tmp_path / "empty")
    fill(tmp_path / "link", "newer")
    assert (tmp_path / "link").is_symlink()
    assert set(content(tmp_path / "empty").values()) == {"newer"}


#: Kills itself at a place that is named, in the way kill -9 does.
KILLED = """
import os, signal, sys
from pathlib import Path
from thermojoint.artefacts import folders

def end(*arguments, **options):
    os.kill(os.getpid(), signal.SIGKILL)

def impossible(one, other):
    raise OSError(22, "Invalid argument")

if sys.argv[2] == "carrying":
    folders._carry_over = end
elif sys.argv[2] == "before the swap":
    folders._swap = end
elif sys.argv[2] == "after the swap":
    folders._settle = end
elif sys.argv[2] == "between two steps":
    folders._exchange = impossible
    rename, seen = Path.rename, []
    def second(self, target):
        seen.append(target)
        return end() if len(seen) == 2 else rename(self, target)
    Path.rename = second
with folders.whole_folder(Path(sys.argv[1])) as new:
    (new / "a.txt").write_text("new")
    if sys.argv[2] == "building":
        end()
"""


@pytest.mark.parametrize(
    ("when", "left"),
    [
        ("building", "old"),
        ("carrying", "old"),
        ("before the swap", "old"),
        ("between two steps", None),
        ("after the swap", "new"),
    ],
)
def test_a_killed_run_leaves_a_whole_folder_and_the_next_one_clears_up(when, left, tmp_path):
    out = tmp_path / "results"
    fill(out, "old", ["a.txt"])
    (out / "notes.txt").write_text("mine")
    done = subprocess.run([sys.executable, "-c", KILLED, out, when], check=False)
    assert done.returncode == -9
    assert len(list(tmp_path.glob(".results.*"))) == 1
    if left:
        assert content(out) == {"a.txt": left, "notes.txt": "mine"}
    with pytest.raises(ValueError, match="at once"), whole_folder(out):
        raise ValueError("at once")
    assert content(out) == {"a.txt": left or "old", "notes.txt": "mine"}
    assert list(tmp_path.iterdir()) == [out]


def test_a_run_that_still_lasts_is_left_alone(tmp_path):
    out = tmp_path / "results"
    with whole_folder(out) as first:
        (first / "a.txt").write_text("first")
        fill(out, "second")
        assert (first / "a.txt").is_file()
    assert content(out)["a.txt"] == "first"
    assert list(tmp_path.iterdir()) == [out]


def test_results_that_cannot_be_put_in_place_are_kept_elsewhere(tmp_path, monkeypatch):
    def refuse(*folders):
        raise OSError(18, "Invalid cross-device link")

    out = tmp_path / "results"
    fill(out, "old")
    monkeypatch.setattr(folders, "_swap", refuse)
    with pytest.raises(InputError, match="the new one is in"):
        fill(out, "new")
    [kept] = tmp_path.glob("results-new-*")
    assert set(content(out).values()) == {"old"}
    assert set(content(kept).values()) == {"new"}
    assert not list(tmp_path.glob(".*"))


def test_others_may_read_a_folder_if_the_umask_lets_them(tmp_path):
    before = os.umask(0o022)
    try:
        fill(tmp_path / "results", "new")
    finally:
        os.umask(before)
    assert (tmp_path / "results").stat().st_mode & 0o777 == 0o755
