"""Ctrl-C ends every command in one line, at any moment from the first import on."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from reference_case import lasting

LINE = "thermojoint: interrupted; no unfinished file is left\n"

#: The command line; Ctrl-C comes when a module is looked for that the first argument names. The
#: first import of all is told on standard output.
DRIVER = """
import os, signal, sys
at = sys.argv[1]
sys.argv[:2] = ["thermojoint"]

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "thermojoint.cli.app":
            os.write(1, b"begun\\n")
        if name == at:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
from thermojoint.cli.main import main
main()
"""


def started(at, *arguments, **options):
    return subprocess.Popen(
        [sys.executable, "-c", DRIVER, at, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def simulate(folder, at="nothing", **options):
    (folder / "case.toml").write_text(lasting(35.0))
    outputs = ["--out", folder / "out.nc", "--save-state", folder / "state.npz"]
    case = folder / "case.toml"
    return started(at, "simulate", case, *outputs, "--snapshots", folder / "fields", **options)


def ended_in_one_line(process, folder):
    _, err = process.communicate(timeout=120)
    # Where the set-up is slow, its progress stands before.
    err = re.sub(r"^setting up: \d+ s\n", "", err)
    left = sorted(one.name for one in folder.iterdir())
    return (process.returncode, err, left) == (130, LINE, ["case.toml"])


def test_the_signals_are_taken_before_any_library_is_imported():
    code = (
        "import sys; before = set(sys.modules); import thermojoint.cli.main;"
        "print(*(name for name in set(sys.modules) - before if not name.startswith('thermojoint')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    needed = {"signal", "enum", "types", "operator", "_operator", "functools", "_functools"}
    needed |= {"collections", "_collections", "keyword", "_keyword", "reprlib", "itertools"}
    assert set(done.stdout.split()) <= needed


@pytest.mark.parametrize(
    "module", ["thermojoint.artefacts.errors", "typer", "numpy.linalg", "scipy.sparse", "numba"]
)
def test_ctrl_c_during_an_import_is_one_line(module, tmp_path):
    assert ended_in_one_line(simulate(tmp_path, module), tmp_path)


@pytest.mark.parametrize("delay", [0.05, 0.3, 1.0])
def test_ctrl_c_after_any_delay_is_one_line(delay, tmp_path):
    with simulate(tmp_path) as process:
        assert process.stdout.readline() == "begun\n"
        time.sleep(delay)
        process.send_signal(signal.SIGINT)
        assert ended_in_one_line(process, tmp_path)


def test_ctrl_c_while_machine_code_is_made_is_one_line(tmp_path, tmp_path_factory):
    """Nothing is kept, so that all of it is made."""
    kept = tmp_path_factory.mktemp("machine-code")
    process = simulate(
        tmp_path, "llvmlite.ir.transforms", env=os.environ | {"NUMBA_CACHE_DIR": str(kept)}
    )
    assert ended_in_one_line(process, tmp_path)


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_learning_command_ends_at_every_signal(ending, tmp_path):
    (tmp_path / "log.csv").write_text("time_s,T1_degC,x_um\n0,20,0\n")
    log = tmp_path / "log.csv"
    with started("nothing", "learn", log, "--displacement", "x_um", "--out", "m.json") as process:
        assert process.stdout.readline() == "begun\n"
        process.send_signal(ending)
        err = process.communicate(timeout=60)[1]
    assert process.returncode == 128 + ending
    assert (err.count("\n"), err.endswith("no unfinished file is left\n")) == (1, True)


#: Stands in place of the commands.
WORK = """
import os, pathlib, signal, subprocess, sys, types
from thermojoint.cli import main as cli
sys.modules["thermojoint.cli.app"] = types.SimpleNamespace(app=lambda **_: work())
ctrl_c = lambda: signal.raise_signal(signal.SIGINT)
"""

SWALLOWED = """
class Late:
    def __del__(self):
        ctrl_c()  # an exception in here is lost

def work():
    Late()
    while True:
        pass
"""

SUPPRESSED = """
def work():
    try:
        ctrl_c()
    except BaseException:  # as libraries written in C do
        pass
    while True:
        pass
"""

TWICE = """
from thermojoint.artefacts.unfinished import cleared_at_stop

def clear():
    ctrl_c()
    print("cleared up", flush=True)

def work():
    with cleared_at_stop(clear):
        ctrl_c()
"""

FILES = """
from thermojoint.artefacts.files import temporary_folder, whole_file
from thermojoint.artefacts.folders import whole_folder

def work():
    with whole_folder(pathlib.Path("results")) as new, whole_file(pathlib.Path("a.csv")) as part:
        (new / "data").write_text("new")
        part.write_text("new")
        with temporary_folder() as place:
            (place / "data").write_text("new")
            ctrl_c()
"""

CHILD = """
from thermojoint.artefacts.processes import process_pool

def work():
    with process_pool(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        ctrl_c()
"""


def work(code, **options):
    return subprocess.run(
        [sys.executable, "-c", f"{WORK}{code}\ncli.main()"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        **options,
    )


@pytest.mark.parametrize(
    ("code", "said"), [(SWALLOWED, ""), (SUPPRESSED, ""), (TWICE, "cleared up\n")]
)
def test_ctrl_c_is_not_lost_where_an_exception_is(code, said):
    done = work(code)
    assert (done.returncode, done.stdout, done.stderr) == (130, said, LINE)


def test_ctrl_c_leaves_old_results_as_they_were_and_nothing_new(tmp_path):
    folder, temporary = tmp_path / "work", tmp_path / "temporary"
    temporary.mkdir()
    (folder / "results").mkdir(parents=True)
    (folder / "results" / "contents.json").write_text(
        '{"schema": "thermojoint-contents", "schema_version": 1, "files": ["data"]}'
    )
    (folder / "results" / "data").write_text("old")
    done = work(FILES, cwd=folder, env=os.environ | {"TMPDIR": str(temporary)})
    assert (done.returncode, done.stderr) == (130, LINE)
    assert [one.name for one in folder.iterdir()] == ["results"]
    assert sorted(one.name for one in (folder / "results").iterdir()) == ["contents.json", "data"]
    assert (folder / "results" / "data").read_text() == "old"
    assert not list(temporary.iterdir())


def test_ctrl_c_ends_the_child_processes(tmp_path):
    done = work(CHILD)
    assert (done.returncode, done.stderr) == (130, LINE)
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)


def test_no_alarm_and_no_handler_is_left_when_a_command_has_ended():
    done = work("def work(): pass\nimport atexit\n@atexit.register\ndef last(): ctrl_c()\n")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_command_in_the_background_of_a_script_ignores_ctrl_c():
    """A shell has such a process ignore it; Ctrl-C is for the script."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited
    try:
        done = work("def work():\n    ctrl_c()\n    print('done')")
    finally:
        signal.signal(signal.SIGINT, before)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")
