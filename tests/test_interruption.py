"""Ctrl-C ends every command in one line, at any moment from the first import on."""

import os
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
        if name == "thermojoint.artefacts":
            os.write(1, b"begun\\n")
        if name == at:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
from thermojoint.cli.main import main
main()
"""


def simulate(folder, at="nothing", code=DRIVER, **options):
    (folder / "case.toml").write_text(lasting(35.0))
    arguments = [at, "simulate", folder / "case.toml", "--out", folder / "out.nc"]
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments, "--snapshots", folder / "fields"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def ended_in_one_line(process, folder):
    _, err = process.communicate(timeout=120)
    left = sorted(one.name for one in folder.iterdir())
    return (process.returncode, err, left) == (130, LINE, ["case.toml"])


@pytest.mark.parametrize(
    "module",
    ["thermojoint.artefacts.errors", "typer", "numpy.linalg", "scipy.sparse", "numba", "xarray"],
)
def test_ctrl_c_during_an_import_is_one_line(module, tmp_path):
    assert ended_in_one_line(simulate(tmp_path, module), tmp_path)


@pytest.mark.parametrize("delay", [0.0, 0.05, 0.3, 1.0, 2.0])
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


#: Stands in place of the commands.
WORK = """
import signal, sys, types
from thermojoint.cli import main as cli
sys.modules["thermojoint.cli.app"] = types.SimpleNamespace(app=lambda: work())
"""

SWALLOWED = """
class Late:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)  # an exception in here is lost

def work():
    Late()
    while True:
        pass

cli.main()
"""

SUPPRESSED = """
def work():
    try:
        signal.raise_signal(signal.SIGINT)
    except BaseException:  # as libraries written in C do
        pass
    while True:
        pass

cli.main()
"""

#: An extension module of NumPy's prints what went wrong in an import, and raises something else.
PRINTED = """
def work():
    try:
        signal.raise_signal(signal.SIGINT)
    except BaseException as error:
        sys.excepthook(type(error), error, error.__traceback__)
    raise ImportError("numpy.core.multiarray failed to import")

cli.main()
"""

REPLACED = """
def work():
    try:
        signal.raise_signal(signal.SIGINT)
    except BaseException:
        raise ImportError("numpy.core.multiarray failed to import")

cli.main()
"""

TWICE = """
import time

def work():
    try:
        signal.raise_signal(signal.SIGINT)
    finally:
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.2)
        print("cleared up", flush=True)

cli.main()
"""


@pytest.mark.parametrize(
    ("code", "said"),
    [(SWALLOWED, ""), (SUPPRESSED, ""), (PRINTED, ""), (REPLACED, ""), (TWICE, "cleared up\n")],
)
def test_ctrl_c_is_not_lost_where_an_exception_is(code, said):
    done = subprocess.run(
        [sys.executable, "-c", WORK + code], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, said, LINE)


def test_a_command_in_the_background_of_a_script_ignores_ctrl_c(tmp_path):
    """A shell has such a process ignore it; Ctrl-C is for the script."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited
    try:
        process = simulate(tmp_path, "typer")
    finally:
        signal.signal(signal.SIGINT, before)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0
    assert (tmp_path / "out.nc").is_file()
    assert "interrupted" not in err
