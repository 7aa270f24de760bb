"""What a command loads before it begins: as little as it needs."""

import json
import os
import subprocess
import sys
from importlib.metadata import version

import pytest
from repository import ROOT

HEAVY = {
    *("control", "h5py", "jinja2", "matplotlib", "meshio", "numba", "numpy", "pandas", "scipy"),
    *("skfem", "xarray", "zarr"),
}

#: Each command in a process of its own, forked from one that has loaded the modules named first.
LOADED = """
import importlib, json, os, sys
from thermojoint.cli import main as cli

for name in json.loads(sys.argv[1]):
    importlib.import_module(name)
for arguments in json.loads(sys.argv[2]):
    if not os.fork():
        sys.argv[1:] = arguments
        try:
            cli.main()
        except SystemExit:
            pass
        names = [name for name, module in sys.modules.items() if module]
        os.write(2, json.dumps(names).encode())
        os.write(2, b"\\n")
        os._exit(0)
    os.wait()
"""


def loaded(commands, before=()):
    """What has been loaded by the end of each command: modules and their packages."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, json.dumps(before), json.dumps(commands)],
        capture_output=True,
        text=True,
        check=True,
    )
    found = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("[")]
    assert len(found) == len(commands)
    return [set(one) for one in found]


def test_help_and_version_load_none_of_the_libraries():
    commands = [
        ["--help"],
        ["--version"],
        ["simulate", "--help"],
        ["reproduce", "--help"],
        ["iso230-3", "--help"],
        ["control", "--help"],
        ["export", "--help"],
        ["serve", "--help"],
    ]
    for arguments, found in zip(commands, loaded(commands), strict=True):
        assert not found & HEAVY, arguments


@pytest.mark.long
def test_a_command_loads_what_it_works_with_and_nothing_else():
    """Before its work, that is: the input is not there."""
    drawn_or_kept = {"matplotlib", "numba", "pandas", "xarray", "zarr"}
    elements = {"meshio", "skfem"}
    estimate = ["estimate", "no.json", "no.csv", "--out", "no.csv"]
    without_elements = [["tables", "no.json"], estimate]
    commands = [
        ["simulate", "no.toml", "--out", "no.nc"],
        ["calibrate", "--reference", "no.nc", "--input", "2=no.nc", "--out", "no.json"],
        ["reproduce", "--case", "no.toml", "--out", "no"],
        ["view", "no.toml", "--out", "no.png"],
        ["place", "no.toml", "--out", "sensors.toml"],
        ["batch", "no.toml", "--out", "no"],
        ["compensate", "no.csv", "--settings", "no.toml", "--out", "o.csv"],
        ["control", "no.toml"],
        *without_elements,
    ]
    # What all of them need is loaded once, before.
    for arguments, found in zip(commands, loaded(commands, ["numpy", "scipy.sparse"]), strict=True):
        assert not found & drawn_or_kept, arguments
        assert arguments not in without_elements or not found & elements, arguments


@pytest.mark.long
def test_a_simulation_loads_neither_xarray_nor_pandas(tmp_path):
    case = ROOT / "examples" / "two_rods" / "case.toml"
    (found,) = loaded([["simulate", str(case), "--out", str(tmp_path / "rods.nc")]])
    assert (tmp_path / "rods.nc").is_file()
    assert not found & {"xarray", "pandas", "h5netcdf", "numpy.f2py.f2py2e"}


#: A command, then SciPy, which asks NumPy for all of its parts, then one of these parts.
TRANSLATOR = """
import sys
from thermojoint.cli import main as cli

try:
    cli.main()
except SystemExit:
    pass
import scipy.sparse
print("numpy.f2py.f2py2e" in sys.modules)
import numpy
print(numpy.f2py.get_include())
"""


def test_numpys_translator_is_loaded_when_it_is_used():
    command = [sys.executable, "-c", TRANSLATOR, "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    _, loaded_before, place = done.stdout.splitlines()
    assert loaded_before == "False"
    assert place.endswith("src")


#: What every command and every child process begins with.
BEGIN = """
import os
from thermojoint.artefacts.process_start import prepare_process

prepare_process()
print(os.environ["OPENBLAS_THREAD_TIMEOUT"])
"""


def test_threads_of_openblas_wait_as_long_as_the_user_says():
    environment = os.environ | {"OPENBLAS_THREAD_TIMEOUT": "20"}
    command = [sys.executable, "-c", BEGIN]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.strip() == "20"


def test_python_runs_the_package_as_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "thermojoint", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert version("thermojoint") in done.stdout
    wrong = subprocess.run(
        [sys.executable, "-m", "thermojoint", "simulate", "no.toml", "--out", "no.nc"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("thermojoint: no.toml: ")


def test_an_estimate_and_a_service_begin_without_statistics_and_signals():
    """Noise alone needs them; they take longer to load than all else that an estimator needs."""
    commands = [["estimate", "no.json", "no.csv", "--out", "no.csv"], ["serve", "no.toml"]]
    before = ["numpy", "scipy.sparse", "estimator.registry", "thermojoint.live.service"]
    for arguments, found in zip(commands, loaded(commands, before), strict=True):
        assert not found & {"scipy.signal", "scipy.stats"}, arguments


#: A command that ends at once, then what every response needs, then what a cluster needs.
VARIABLE = """
import sys
from thermojoint.artefacts.process_start import let_dask_load
from thermojoint.cli import main as cli

try:
    cli.main()
except SystemExit:
    pass
import xarray
xarray.Variable("time", [0.0])
print(*(name for name, module in sys.modules.items() if module and name.startswith("dask")))
let_dask_load()
import dask.array
print(xarray.Variable("time", dask.array.zeros(1)).sizes["time"])
"""


def test_responses_load_no_dask_and_a_cluster_finds_it_nevertheless():
    pytest.importorskip("dask")
    command = [sys.executable, "-c", VARIABLE, "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[1:] == ["", "1"]


#: A script that has used xarray before it runs a command.
AFTERWARDS = """
import sys
import xarray
xarray.Variable("time", [0.0])
from thermojoint.cli import main as cli

try:
    cli.main()
except SystemExit:
    pass
print(xarray.Variable("time", [0.0, 1.0]).sizes["time"])
"""


@pytest.mark.long
def test_where_xarray_was_used_before_it_goes_on_with_dask():
    pytest.importorskip("dask")
    command = [sys.executable, "-c", AFTERWARDS, "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "2"


#: SciPy asks of every array whether it is one of Dask.
BLOCKS = """
from thermojoint.artefacts.process_start import prepare_process

prepare_process()
import xarray
from scipy.linalg import block_diag
print(block_diag([[1.0]], xarray.Variable("time", [2.0]).to_numpy()).sum())
"""


def test_scipy_works_where_dask_is_not_loaded():
    done = subprocess.run(
        [sys.executable, "-c", BLOCKS], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["3.0"]
