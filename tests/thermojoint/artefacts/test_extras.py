"""Without its extras the program starts, and a feature that needs one names it in one line."""

import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions

import pytest
from repository import ROOT

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.extras import require

#: Import names that only an extra brings, and what they are tried with.
EXTRAS = {
    "zarr": "batch",
    "pyarrow": "batch",
    "openpyxl": "excel",
    "distributed": "dask",
    "control": "control",
    "asyncua": "serve",
    "aiomqtt": "serve",
    "uvicorn": "serve",
    "h11": "serve",
    "anyio": "serve",
    "starlette": "serve",
    "pyvista": "view",
    "imageio": "view",
    "gmsh": "gmsh",
    "sklearn": "dev",
}
#: Refuses every import of the names above, as if nothing had installed them.
WITHOUT = f"""
import importlib.abc, importlib.util, sys
class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {sorted(EXTRAS)!r}:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Absent())
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name in {sorted(EXTRAS)!r} else found(name)
"""


def without_extras(program):
    return subprocess.run(
        [sys.executable, "-c", WITHOUT + program], capture_output=True, text=True, check=False
    )


def test_what_an_extra_brings_is_declared_there_alone():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    owners = packages_distributions()
    for name, extra in EXTRAS.items():
        (distribution,) = set(owners[name])
        inside = [one.lower().startswith(distribution.lower()) for one in project["dependencies"]]
        assert not any(inside), name
        declared = project["optional-dependencies"][extra]
        assert any(one.lower().startswith(distribution.lower()) for one in declared), name


@pytest.mark.long
def test_every_public_name_is_there_without_extras():
    done = without_extras(
        "import thermojoint\nfor name in thermojoint.__all__: getattr(thermojoint, name)\n"
        "import thermojoint.cli.app, calibrate.baselines, thermojoint.paper.reproduce\n"
    )
    assert done.returncode == 0, done.stderr


def test_a_batch_without_its_extra_is_refused_in_one_line(tmp_path):
    case = (ROOT / "thermojoint" / "cases" / "reference.toml").read_text("utf-8")
    (tmp_path / "case.toml").write_text(case, "utf-8")
    study = "case = 'case.toml'\n[[grid]]\npath = 'heat_input.level'\nvalues = [1.0, 2.0]\n"
    (tmp_path / "study.toml").write_text(study, "utf-8")
    done = without_extras(
        "from thermojoint.cli.main import main\n"
        f"sys.argv = ['thermojoint', 'batch', {str(tmp_path / 'study.toml')!r}, '--out', "
        f"{str(tmp_path / 'out')!r}]\nmain()\n"
    )
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == (
        "thermojoint: batch: needs zarr; pip install 'thermojoint[batch]'"
    )
    assert not (tmp_path / "out").exists()


def test_what_is_missing_is_named_with_the_extra_that_brings_it():
    require("this", "serve", "json", "csv")
    with pytest.raises(
        InputError, match=r"^this: needs no_such; pip install 'thermojoint\[that\]'$"
    ):
        require("this", "that", "json", "no_such")
