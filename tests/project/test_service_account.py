"""The program needs nothing of its user but a place to write to: no home, no cache, no own copy."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from reference_case import lasting
from repository import ROOT

from fesim.joint import compiled_gap
from thermojoint.artefacts import own_folder as places
from thermojoint.artefacts.own_folder import own_folder

#: Tells where the machine code of the gap equations is kept, and that it works.
KEPT = """
from fesim.joint import compiled_gap
assert compiled_gap.newton_work(2).system.size == 36
print(getattr(compiled_gap.newton_work._cache, "cache_path", None))
"""


def without_home(tmp_path, temporary):
    """An environment in which no folder of the user's own can be made, for root neither."""
    no_folder = tmp_path / "no-folder"
    no_folder.touch()
    names = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME")
    environment = os.environ | dict.fromkeys(names, str(no_folder / "below"))
    kept = {"TMPDIR": str(temporary), "THERMOJOINT_CACHE": "", "NUMBA_CACHE_DIR": ""}
    return environment | kept


def run(arguments, environment, **options):
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        **options,
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture
def temporary(tmp_path):
    folder = tmp_path / "temporary"
    folder.mkdir()
    return folder


@pytest.fixture
def read_only(tmp_path):
    """A copy of the packages beside which nothing can be kept, for root neither."""
    copy = tmp_path / "installed"
    for package in ("fesim", "meshes", "thermojoint"):
        shutil.copytree(
            ROOT / package, copy / package, ignore=shutil.ignore_patterns("__pycache__")
        )
        for folder in (copy / package, *(copy / package).rglob("*/")):
            (folder / "__pycache__").touch()
    return copy


def test_machine_code_is_kept_in_a_temporary_folder_where_there_is_no_home(
    tmp_path, temporary, read_only
):
    environment = without_home(tmp_path, temporary) | {"PYTHONPATH": str(read_only)}
    where = Path(run(["-c", KEPT], environment, cwd=tmp_path).stdout.strip())
    own = where.parent
    assert own.parent == temporary / f"thermojoint-{os.geteuid()}"
    assert own.name.startswith("machine-code-")
    assert list(where.glob("*.nbc"))
    assert stat.S_IMODE(own.stat().st_mode) == 0o700


@pytest.mark.long
def test_machine_code_of_another_source_is_not_read(tmp_path, temporary, read_only):
    """It may name classes that have moved since; what nobody used for long is dropped."""
    environment = without_home(tmp_path, temporary) | {"PYTHONPATH": str(read_only)}
    before = Path(run(["-c", KEPT], environment, cwd=tmp_path).stdout.strip()).parent
    other = before.with_name("machine-code-of-long-ago")
    other.mkdir()
    os.utime(other, (0, 0))
    module = read_only / "fesim" / "joint" / "gap.py"
    module.chmod(0o644)
    module.write_text(module.read_text() + "\n# changed\n")
    after = Path(run(["-c", KEPT], environment, cwd=tmp_path).stdout.strip()).parent
    assert after != before
    assert before.is_dir()
    assert not other.exists()


@pytest.mark.long
def test_machine_code_is_made_where_nothing_can_be_kept(tmp_path, temporary, read_only):
    (temporary / f"thermojoint-{os.geteuid()}").touch()  # no folder
    environment = without_home(tmp_path, temporary) | {"PYTHONPATH": str(read_only)}
    assert run(["-c", KEPT], environment, cwd=tmp_path).stdout.strip() == "None"


def test_a_case_runs_and_is_drawn_without_a_home(tmp_path, temporary):
    (tmp_path / "case.toml").write_text(lasting(0.1))
    # Machine code is that of the tests: making all of it takes longer than they do.
    environment = without_home(tmp_path, temporary)
    kept = Path(compiled_gap.newton_work._cache.cache_path).parent
    environment |= {"NUMBA_CACHE_DIR": str(kept)}
    command = ["-m", "thermojoint"]
    simulate = [*command, "simulate", "case.toml", "--out", "out.nc"]
    assert run(simulate, environment, cwd=tmp_path).stderr.endswith("wrote out.nc\n")
    view = [*command, "view", "out.nc", "--out", "out.svg"]
    # Before it, on a slow machine, matplotlib says that it makes its list of fonts.
    assert run(view, environment, cwd=tmp_path).stderr.endswith("wrote out.svg\n")
    made = {one.name for one in tmp_path.iterdir()}
    assert made == {"case.toml", "no-folder", "out.nc", "out.svg", "temporary"}


def test_a_user_whom_nobody_knows_gets_no_folder_called_tilde(tmp_path, temporary, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(places, "user_cache_path", lambda *name, **options: Path("~/.cache/x"))
    monkeypatch.setattr(places.tempfile, "tempdir", str(temporary))
    assert places.user_cache() is None
    assert own_folder("x") == temporary / f"thermojoint-{os.geteuid()}" / "x"
    assert not (tmp_path / "~").exists()


@pytest.mark.parametrize("theirs", ["a link", "open to all"])
def test_a_folder_that_another_user_prepared_is_not_used(theirs, tmp_path, temporary, monkeypatch):
    """What lies in it would be executed."""
    own = temporary / f"thermojoint-{os.geteuid()}"
    own.mkdir()
    if theirs == "a link":
        (own / "x").symlink_to(tmp_path)
    else:
        (own / "x").mkdir()
        (own / "x").chmod(0o777)
    monkeypatch.setattr(places, "user_cache", lambda: None)
    monkeypatch.setattr(places.tempfile, "tempdir", str(temporary))
    assert own_folder("x") is None


def test_two_users_share_no_folder(temporary, monkeypatch):
    monkeypatch.setattr(places, "user_cache", lambda: None)
    monkeypatch.setattr(places.tempfile, "tempdir", str(temporary))
    first = own_folder("x")
    # The first one's folder is not the second one's: what belongs to another user is refused.
    user = os.geteuid()
    monkeypatch.setattr(places.os, "geteuid", lambda: user + 1)
    shutil.move(temporary / f"thermojoint-{user}", temporary / f"thermojoint-{user + 1}")
    assert first is not None
    assert own_folder("x") is None
