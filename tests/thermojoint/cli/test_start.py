"""What a command loads before it begins: as little as it needs."""

import json
import subprocess
import sys

import pytest

HEAVY = {
    *(
        "control",
        "h5py",
        "jinja2",
        "matplotlib",
        "meshio",
        "numba",
        "numpy",
        "pandas",
        "scipy",
        "skfem",
    ),
    *("xarray", "zarr"),
}

LOADED = """
import json, os, sys
from thermojoint.cli import main as cli
try:
    cli.main()
except SystemExit:
    pass
os.write(2, json.dumps(sorted({name.split(".")[0] for name in sys.modules})).encode())
"""


def loaded(*arguments):
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, check=True
    )
    return {*json.loads(done.stderr.splitlines()[-1])}


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--version"],
        ["simulate", "--help"],
        ["reproduce", "--help"],
        ["iso230-3", "--help"],
        ["control", "--help"],
        ["export", "--help"],
        ["serve", "--help"],
    ],
)
def test_help_and_version_load_none_of_the_libraries(arguments):
    assert not loaded(*arguments) & HEAVY


def test_a_command_loads_what_it_works_with_and_nothing_else():
    """Before its work, that is: the input is not there."""
    drawn_or_kept = {"matplotlib", "numba", "pandas", "xarray", "zarr"}
    for arguments in (
        ["simulate", "no.toml", "--out", "no.nc"],
        ["calibrate", "--reference", "no.nc", "--input", "2=no.nc", "--out", "no.json"],
        ["reproduce", "--case", "no.toml", "--out", "no"],
        ["view", "no.toml", "--out", "no.png"],
        ["place", "no.toml", "--out", "sensors.toml"],
        ["batch", "no.toml", "--out", "no"],
        ["compensate", "no.csv", "--settings", "no.toml", "--out", "o.csv"],
        ["control", "no.toml"],
    ):
        assert not loaded(*arguments) & drawn_or_kept
    elements = {"meshio", "skfem"}
    assert not loaded("tables", "no.json") & (drawn_or_kept | elements)
    estimate = ["estimate", "no.json", "no.csv", "--out", "no.csv"]
    assert not loaded(*estimate) & (drawn_or_kept | elements)
