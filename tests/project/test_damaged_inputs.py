"""The fuzz: what it gives to the command, what it lets pass; damage that it once found."""

from dataclasses import replace

import h5py
import meshio
import numpy as np
import pytest
from bars import two_bars
from skfem.io.meshio import to_meshio

from benchmarks.fuzz import mutated, page, verdict
from benchmarks.fuzz_inputs import WRITERS, bars, unharmed
from fesim.case.schema import read_case
from fesim.simulate import simulate
from fesim.solid.spaces import cells_at
from meshes.exchange import read_structure
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import write_response


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return unharmed(tmp_path_factory.mktemp("unharmed"))


def laid_out(files, folder):
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder


def peak_pressure(inputs, name, folder):
    (files,) = (files for files, damaged in inputs if damaged == name)
    response = simulate(read_case(laid_out(files, folder) / "case.toml")).response
    return float(response["pressure"].max())


@pytest.mark.long
def test_an_unharmed_mesh_gives_the_same_response_in_every_format(tmp_path, inputs):
    peaks = []
    for suffix in WRITERS:
        (tmp_path / suffix).mkdir()
        peaks.append(peak_pressure(inputs, f"bars{suffix}", tmp_path / suffix))
    assert peaks == pytest.approx(len(WRITERS) * peaks[:1], rel=1e-6)


def test_every_kind_of_file_is_damaged(inputs):
    damaged = {name.rpartition(".")[2] for _, name in inputs}
    assert damaged == {"toml", "csv", *(suffix.removeprefix(".") for suffix in WRITERS)}
    for files, name in inputs:
        kind, found = mutated(files, name, np.random.default_rng(0))
        assert kind.startswith(name.rpartition(".")[2])
        assert [one for one in files if files[one] != found[one]] == [name]
    assert all(suffix.removeprefix(".").upper() in page([], 0, 0) for suffix in WRITERS)


@pytest.fixture
def ended(tmp_path):
    """What the fuzz says of a run that ended with some code and standard error."""

    def say(code, said, files=()):
        (tmp_path / "stderr").write_text(said)
        for name in files:
            (tmp_path / name).write_text("")
        return verdict(tmp_path, {}, code)

    return say


def test_one_line_with_exit_code_2_passes(ended):
    assert ended(2, "thermojoint: case.toml: no such thing\n") == "refused"


def test_a_warning_before_the_one_line_passes(ended):
    assert ended(2, "warning: case.toml: odd\nthermojoint: no such thing\n") == "refused"


@pytest.mark.parametrize(
    "said",
    [
        "",
        "warning: odd\n",
        "no such thing\n",
        "thermojoint: one\nthermojoint: two\n",
        "[stdin] something else\nthermojoint: one\n",
        "thermojoint: one\n  and its second line\n",
    ],
)
def test_anything_else_on_standard_error_fails(ended, said):
    assert ended(2, said).startswith("not one line")


def test_a_file_left_behind_a_hang_a_traceback_and_a_missing_response_fail(ended):
    assert ended(2, "thermojoint: one\n", ["out.nc.part"]) == "files left: ['out.nc.part']"
    assert ended(None, "").startswith("hang")
    assert ended(1, "Traceback\nValueError: x\n") == "exit code 1: ValueError: x"
    assert ended(0, "") == "exit code 0 without a response"


def test_an_input_that_has_changed_fails(tmp_path):
    (tmp_path / "stderr").write_text("thermojoint: one\n")
    (tmp_path / "case.toml").write_text("overwritten")
    assert verdict(tmp_path, {"case.toml": b"given"}, 2) == "input changed: ['case.toml']"


def test_a_whole_response_passes(tmp_path, ended, coarse_response):
    write_response(coarse_response, tmp_path / "out.nc")
    assert ended(0, "wrote out.nc\n") == "result"


@pytest.mark.parametrize("kind", ["quad", "vertex"])
def test_a_facet_or_point_that_names_a_missing_node_is_refused(tmp_path, kind):
    grid = to_meshio(two_bars((1, 1, 1), (1, 1, 1)).mesh, encode_cell_data=False)
    nodes = {"quad": [[0, 1, 2, 10**9]], "vertex": [[10**9]]}[kind]
    grid.cells.append(meshio.CellBlock(kind, np.array(nodes)))
    own = [np.ones(len(grid.cells[0].data), dtype=np.int32), np.zeros(1, dtype=np.int32)]
    name = {"quad": "surface:odd", "vertex": "probe:odd"}[kind]
    grid.cell_data = {"body:all": own, name: [1 - part for part in own]}
    path = tmp_path / "odd.vtk"
    meshio.vtk.write(str(path), grid)
    with pytest.raises(InputError, match="a missing node"):
        read_structure(path)


def test_damage_inside_an_hdf5_file_is_refused(tmp_path):
    path = tmp_path / "bars.med"
    WRITERS[".med"](bars(), path)
    content = path.read_bytes()
    with h5py.File(path) as file:
        assert "ENS_MAA" in file
    # The signature of every node of a group's table.
    path.write_bytes(content.replace(b"SNOD", b"SNOE"))
    with pytest.raises(InputError, match="meshio cannot read it"):
        read_structure(path)


def test_an_abaqus_element_without_a_type_is_refused(tmp_path):
    path = tmp_path / "bars.inp"
    WRITERS[".inp"](bars(), path)
    path.write_bytes(path.read_bytes().replace(b"TYPE=", b"KIND="))
    with pytest.raises(InputError, match="TYPE not found"):
        read_structure(path)


def test_a_point_in_the_flat_corner_of_a_cell_is_in_no_cell():
    """Where two corners of a cell meet, its map has no inverse."""
    mesh = two_bars((1, 1, 1), (1, 1, 1)).mesh
    points = mesh.p.copy()
    first, other = mesh.t[0, 0], mesh.t[1, 0]
    points[:, other] = points[:, first]
    flat = replace(mesh, doflocs=points)
    inside = flat.p[:, flat.t[:, 0]].mean(axis=1)
    cells = np.array([0])
    found = cells_at(flat, np.array([points[:, first], inside]), cells)
    assert found.tolist() == [-1, 0]
