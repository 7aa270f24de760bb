"""The page for newcomers does what it says: its files are in the examples, its commands are run."""

import re
import shlex
import shutil
import subprocess
import sys

import numpy as np
import pytest
import typer
import xarray as xr
from page_commands import blocks_of, copied, files_of, follow
from repository import ROOT
from skfem import MeshHex
from step_files import gmsh, needs_gmsh

from meshes.box_grid import put_side_by_side
from meshes.exchange import write_structure
from meshes.structure import Structure
from thermojoint.cli.app import app

PAGE = ROOT / "docs" / "your-own-machine.md"
CLAMP = ROOT / "examples" / "clamp"
BLOCKS = blocks_of(PAGE)
FILES = files_of(BLOCKS)
COMMANDS = [
    (page.name, line)
    for page in (PAGE.parents[1] / "README.md", *sorted(PAGE.parent.glob("*.md")))
    for block in re.findall(r"^```sh[^\n]*\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)
    for line in block.splitlines()
    if line.startswith("thermojoint ")
]


def clamp_mesh():
    """The same part where Gmsh is missing."""
    parts = [
        MeshHex.init_tensor(*(np.linspace(low, high, n + 1) for low, high, n in spans))
        for spans in (
            ((0.0, 0.15, 9), (0.0, 0.04, 3), (0.0, 0.02, 2)),
            ((0.05, 0.10, 4), (0.0, 0.04, 4), (0.02, 0.04, 2)),
        )
    ]
    mesh, (bed, block) = put_side_by_side(parts)
    facets = mesh.boundary_facets()
    x, _, z = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    of_bed = mesh.f2t[0, facets] < len(bed)
    between = (np.abs(z - 0.02) < 1e-9) & (np.abs(x - 0.075) < 0.025)
    named = {
        "foot": x < 1e-9,
        "warm": z > 0.04 - 1e-9,
        "bed_block.a": between & of_bed,
        "bed_block.b": between & ~of_bed,
    }
    rest = ~np.any(list(named.values()), axis=0)
    named |= {"bed_outer": of_bed & rest, "block_outer": ~of_bed & rest}
    return Structure(
        mesh=mesh,
        bodies={"bed": bed, "block": block},
        surfaces={name: facets[mask] for name, mask in named.items()},
        joints={"bed_block": ("bed_block.a", "bed_block.b")},
    )


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Follow the page from top to bottom, with the files that a clone has."""
    root = tmp_path_factory.mktemp("newcomer")
    folder = copied(CLAMP, ("clamp.step", *FILES), root)
    if gmsh is None:
        write_structure(clamp_mesh(), folder / "clamp.msh")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        follow(BLOCKS, patch, () if gmsh is not None else ("cad",))
    return folder


def test_every_file_of_the_page_is_in_the_examples_as_it_stands_there():
    assert set(FILES) == {"names.toml", "clamp.toml", "spindle.csv"}
    for name, content in FILES.items():
        assert (CLAMP / name).read_text("utf-8") == content, name


@needs_gmsh
def test_the_script_makes_the_cad_file_of_the_page(tmp_path):
    done = [sys.executable, CLAMP / "clamp.py", tmp_path / "clamp.step"]
    subprocess.run(done, check=True, capture_output=True)
    made, kept = (
        path.read_text("utf-8") for path in (tmp_path / "clamp.step", CLAMP / "clamp.step")
    )
    for what in ("MANIFOLD_SOLID_BREP", "ADVANCED_FACE", "PRODUCT('bed'", "PRODUCT('block'"):
        assert made.count(what) == kept.count(what) > 0


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_the_environment_is_set_up_by_one_command():
    (once,) = (content for _, rest, content in BLOCKS if rest == "once")
    make, activate = once.strip().splitlines()
    told = subprocess.run([*make.split(), "-n"], cwd=ROOT, check=False, capture_output=True)
    assert told.returncode == 0
    assert activate == ". .venv/bin/activate"


@pytest.mark.long
def test_every_command_of_the_page_leaves_its_file(followed):
    for name in re.findall(r"--(?:out|case|save-state|snapshots) (\S+)", PAGE.read_text("utf-8")):
        assert (followed / name).exists(), name


@pytest.mark.long
def test_the_clamp_does_what_physics_says(followed):
    response = xr.load_dataset(followed / "clamp.nc")
    assert float(np.abs(response["heat_balance"]).max()) < 1e-8
    assert float(response["gap_residual"].max()) < 1e-11
    # Heat goes down from the block (side b) into the bed (side a).
    assert float(response["heat_flow"][60].sum()) < -5.0
    tip, base = (response["temperature"].sel(probe=name) for name in ("tip", "base"))
    assert float(tip[60]) > float(base[60]) > 0.0
    # It goes on from where it ended.
    rest = xr.load_dataset(followed / "rest.nc")
    assert float(rest["time"][0]) == pytest.approx(605.0)
    # It rises, and sinks again when the spindle slows down.
    height = response["displacement"].sel(axis="z")
    assert float(height[60]) > 1e-6
    assert float(tip[120]) < float(tip[60])


@pytest.mark.parametrize(("page", "line"), COMMANDS)
def test_a_command_line_of_a_page_has_all_that_its_command_needs(page, line):
    _, name, *arguments = shlex.split(line, comments=True)
    # Parsed as a whole, and not run: a missing or unknown option is an exception.
    typer.main.get_command(app).commands[name].make_context(name, arguments)


def test_the_readme_shows_every_command():
    shown = {shlex.split(line)[1] for page, line in COMMANDS if page == "README.md"}
    assert shown == set(typer.main.get_command(app).commands)


@pytest.mark.long
def test_the_python_of_the_page_runs(followed, capsys, monkeypatch):
    monkeypatch.chdir(followed)
    for language, _, content in BLOCKS:
        if language == "python":
            exec(compile(content, str(PAGE), "exec"), {})
    assert "displacement" in capsys.readouterr().out
