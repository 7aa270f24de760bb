"""Structures in VTU and MSH files: what is written is read back, and damage is told in one line."""

from dataclasses import replace

import meshio
import numpy as np
import pytest
from bars import two_bars
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from skfem import MeshHex2, MeshTet2
from skfem.io.meshio import to_meshio

from fesim.case.schema import case_from_data
from fesim.simulate import simulate
from meshes.exchange import read_structure, write_structure
from meshes.milling_machine import box_milling_machine
from meshes.structure import Probe, Structure
from thermojoint.artefacts.errors import InputError

BARS = two_bars((2, 2, 1), (3, 2, 2))
STRUCTURES = {
    "hexahedra": BARS,
    "tetrahedra": two_bars((2, 2, 1), (3, 2, 2), tetrahedra=True),
    "machine": box_milling_machine(element_size=0.1, probes={"free": Probe((0.1, 0.2, 0.03))}),
}
suffixes = pytest.mark.parametrize("suffix", [".vtu", ".msh"])


def refused(path, match):
    with pytest.raises(InputError, match=match) as error:
        read_structure(path)
    assert str(error.value).count(str(path)) == 1
    assert "\n" not in str(error.value)


def same_groups(first, second):
    return list(first) == list(second) and all(
        np.array_equal(np.sort(first[name]), np.sort(second[name])) for name in first
    )


@suffixes
@pytest.mark.parametrize("name", STRUCTURES)
def test_a_structure_survives_the_way_there_and_back(tmp_path, name, suffix, capfd):
    structure = STRUCTURES[name]
    path = tmp_path / f"structure{suffix}"
    write_structure(structure, path)
    back = read_structure(path)
    assert type(back.mesh) is type(structure.mesh)
    assert np.array_equal(back.mesh.p, structure.mesh.p)
    assert np.array_equal(back.mesh.t, structure.mesh.t)
    assert same_groups(back.bodies, structure.bodies)
    assert same_groups(back.surfaces, structure.surfaces)
    assert back.joints == structure.joints
    assert back.probes == structure.probes
    assert capfd.readouterr() == ("", "")
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def with_sets(structure, suffix, folder):
    """The structure as another program writes it: element sets (INP) or groups (MED)."""
    volumes = to_meshio(structure.mesh, encode_cell_data=False)
    facets = structure.mesh.facets
    cells = [("hexahedron", volumes.cells[0].data[cells]) for cells in structure.bodies.values()]
    cells += [("quad", facets[:, chosen].T) for chosen in structure.surfaces.values()]
    names = [*structure.bodies, *structure.surfaces]
    path = folder / f"other{suffix}"
    if suffix == ".inp":
        sets = {
            name: [
                np.arange(len(nodes)) if i == k else np.array([], int)
                for i, (_, nodes) in enumerate(cells)
            ]
            for k, name in enumerate(names)
        }
        meshio.abaqus.write(path, meshio.Mesh(volumes.points, cells, cell_sets=sets))
        return path
    tags = [np.full(len(nodes), -1 - k) for k, (_, nodes) in enumerate(cells)]
    bodies = len(structure.bodies)
    halves = [slice(bodies), slice(bodies, None)]
    merged = [(cells[h.start or 0][0], np.vstack([n for _, n in cells[h]])) for h in halves]
    families = [np.concatenate(tags[h]) for h in halves]
    grid = meshio.Mesh(volumes.points, merged, cell_data={"cell_tags": families})
    grid.cell_tags = {-1 - k: [name] for k, name in enumerate(names)}
    grid.point_tags = {}
    meshio.med.write(path, grid)
    return path


@pytest.mark.parametrize("suffix", [".inp", ".med"])
def test_element_sets_and_groups_of_other_programs_are_names(tmp_path, suffix, capfd):
    back = read_structure(with_sets(BARS, suffix, tmp_path))
    assert back.joints == BARS.joints
    centre = {}
    for one in (BARS, back):
        mesh = one.mesh
        centre[id(one)] = {
            **{n: mesh.p[:, mesh.t[:, c]].mean(axis=(1, 2)) for n, c in one.bodies.items()},
            **{n: mesh.p[:, mesh.facets[:, f]].mean(axis=(1, 2)) for n, f in one.surfaces.items()},
        }
        assert sum(len(cells) for cells in one.bodies.values()) == BARS.mesh.nelements
    assert centre[id(BARS)].keys() == centre[id(back)].keys()
    for name, place in centre[id(BARS)].items():
        np.testing.assert_allclose(centre[id(back)][name], place, atol=1e-9)
    assert capfd.readouterr() == ("", "")


NODES = "*NODE\n" + "".join(
    f"{1 + x + 3 * y + 6 * z}, {x}, {y}, {z}\n" for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)
)
FIRST, SECOND = "1, 1,2,5,4,7,8,11,10\n", "2, 2,3,6,5,8,9,12,11\n"
BOTTOM, LID = "3, 1,2,5,4\n4, 2,3,6,5\n", "5, 7,8,11,10\n"
SOLID, SHELL = "*ELEMENT, TYPE=C3D8", "*ELEMENT, TYPE=S4"
LISTED = "*ELSET, ELSET=all\n1, 2\n*ELSET, ELSET=ends\n3, 4, 5\n"


def deck(path, *lines):
    """An Abaqus file: two cubes beside each other and what is said of them."""
    path.write_text(NODES + "".join(lines))
    return path


def test_cards_of_elements_are_one_surface_by_a_set_that_lists_them(tmp_path):
    """Empty cards are passed over."""
    cards = [f"{SOLID}\n{FIRST}", f"{SOLID}\n", f"{SOLID}\n{SECOND}"]
    cards += [f"{SHELL}\n", f"{SHELL}\n{BOTTOM}", f"{SHELL}\n{LID}"]
    found = read_structure(deck(tmp_path / "cubes.inp", *cards, LISTED))
    assert len(found.bodies["all"]) == 2
    assert len(found.surfaces["ends"]) == 3


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            [
                f"{SOLID}, ELSET=all\n{FIRST}{SECOND}",
                f"{SHELL}, ELSET=ends\n{BOTTOM}",
                f"{SHELL}, ELSET=ends\n{LID}",
            ],
            "element set 'ends' is on 2 cards",
        ),
        (
            [f"{SOLID}\n{FIRST}{SECOND}", LISTED, "*ELSET, ELSET=ends\n3\n"],
            "element set 'ends' is on 2 cards",
        ),
        (
            [
                f"{SOLID}, ELSET=all\n{FIRST}{SECOND}",
                f"{SHELL}\n{LID}",
                f"{SHELL}, elset = ends\n{BOTTOM}",
            ],
            "only some .ELEMENT cards have an ELSET",
        ),
        (
            [
                f"{SOLID}, ELSET=one\n{FIRST}",
                f"{SOLID}, ELSET=two\n{SECOND}",
                "*ELSET, ELSET=all\none\ntwo\n",
            ],
            "element set 'all' holds 'one', no number",
        ),
        (
            [f"{SOLID}\n{FIRST}{SECOND}", f"{SHELL}\n{LID}", LISTED, f"{SHELL}\n{BOTTOM}"],
            "element set 'all' is above an .ELEMENT card",
        ),
        ([NODES, f"{SOLID}, ELSET=all\n{FIRST}{SECOND}"], "several .NODE cards"),
        ([f"{SOLID}, ELSET=all\n", "*INCLUDE, INPUT=cells.inp\n"], "INCLUDE cannot be read"),
        ([f"{SOLID}, ELSET=all\n{FIRST}", "*NGEN\n1, 3, 1\n"], "NGEN cannot be read"),
        (["*SYSTEM\n5, 0, 0\n", f"{SOLID}, ELSET=all\n{FIRST}"], "SYSTEM cannot be read"),
        (["*NODE, SYSTEM=C\n", f"{SOLID}, ELSET=all\n{FIRST}"], "write Cartesian coordinates"),
        (
            [f"{SOLID}, ELSET=all\n{FIRST}", "*INSTANCE, NAME=a, PART=p\n5, 0, 0\n"],
            "an .INSTANCE moves its part",
        ),
        (
            [f"{SOLID}, ELSET=all\n{FIRST}", "*INSTANCE, NAME=a\n*INSTANCE, NAME=b\n"],
            "several .INSTANCE cards",
        ),
        ([f"{SOLID}, ELSET=all\n{FIRST}** the other\n{SECOND}"], "comment is inside a .ELEM"),
        ([f"{SOLID}, ELSET=all\n"], "no volume cells"),
    ],
)
def test_abaqus_cards_that_would_be_read_as_something_else_are_refused(tmp_path, lines, said):
    refused(deck(tmp_path / "cubes.inp", *lines), said)


def test_a_vtk_file_with_cell_arrays_is_read(tmp_path):
    write_structure(BARS, tmp_path / "bars.vtu")
    grid = meshio.vtu.read(str(tmp_path / "bars.vtu"))
    grid.cell_data = {
        name: [part.astype(np.int32) for part in parts] for name, parts in grid.cell_data.items()
    }
    meshio.vtk.write(str(tmp_path / "bars.vtk"), grid)
    back = read_structure(tmp_path / "bars.vtk")
    assert same_groups(back.bodies, BARS.bodies)
    assert same_groups(back.surfaces, BARS.surfaces)
    assert back.probes == BARS.probes


@pytest.mark.parametrize(
    ("unit", "metres"),
    [
        ("mm", 1e-3),
        *(pytest.param(*one, marks=pytest.mark.long) for one in (("m", 1.0), ("in", 0.0254))),
    ],
)
def test_the_unit_of_a_mesh_does_not_change_the_machine(
    tmp_path, coarse_data, coarse_response, coarse_setup, unit, metres
):
    """Invariance under the unit that the mesh is written in."""
    write_structure(coarse_setup.structure, tmp_path / "machine.vtu")
    grid = meshio.vtu.read(str(tmp_path / "machine.vtu"))
    grid.points = grid.points / metres
    meshio.vtu.write(str(tmp_path / "machine.vtu"), grid)
    section = {"kind": "mesh", "file": "machine.vtu", "unit": unit, "symmetry_factor": 2}
    case = case_from_data(coarse_data | {"structure": section}, "case", tmp_path)
    ours = simulate(case).response
    for name in ("displacement", "pressure", "temperature"):
        size = float(np.abs(coarse_response[name]).max())
        np.testing.assert_allclose(ours[name], coarse_response[name], atol=1e-8 * size)


@suffixes
def test_a_joint_with_other_side_names_is_read_by_its_own_name(tmp_path, suffix):
    renamed = {
        {"joint.a": "face", "joint.b": "seat"}.get(name, name): facets
        for name, facets in BARS.surfaces.items()
    }
    structure = replace(BARS, surfaces=renamed, joints={"knee": ("face", "seat")})
    write_structure(structure, tmp_path / f"bars{suffix}")
    back = read_structure(tmp_path / f"bars{suffix}")
    assert back.joints == {"knee": ("knee.a", "knee.b")}
    for side, own in zip(back.joints["knee"], ("face", "seat"), strict=True):
        assert np.array_equal(back.surfaces[side], back.surfaces[own])
        assert np.array_equal(back.surfaces[side], renamed[own])


def test_names_are_arrays_that_paraview_shows(tmp_path):
    write_structure(BARS, tmp_path / "bars.vtu")
    grid = meshio.vtu.read(tmp_path / "bars.vtu")
    assert [block.type for block in grid.cells] == ["hexahedron", "quad", "vertex"]
    assert grid.cell_data["body:left"][0].sum() == BARS.bodies["left"].size
    assert grid.cell_data["surface:left_top"][1].sum() == BARS.surfaces["left_top"].size
    assert grid.cell_data["probe:end@right"][2].sum() == 1


@suffixes
def test_a_bare_block_needs_no_surface_and_no_probe(tmp_path, suffix):
    block = Structure(BARS.mesh, {"all": np.arange(BARS.mesh.nelements)}, {})
    write_structure(block, tmp_path / f"block{suffix}")
    back = read_structure(tmp_path / f"block{suffix}")
    assert (back.surfaces, back.joints, back.probes) == ({}, {}, {})


@suffixes
@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"bodies": {'a"b': np.arange(BARS.mesh.nelements)}, "probes": {}}, "name 'a\"b'"),
        ({"probes": {"a@left": Probe((0.0, 0.0, 0.0))}}, "name 'a@left'"),
        ({"surfaces": BARS.surfaces | {"<x>": BARS.surfaces["top"]}}, "name '<x>'"),
        ({"joints": {}}, "would be read as a joint"),
        ({"joints": {"joint": ("joint.b", "joint.a")}}, "is not side a of joint 'joint'"),
    ],
)
def test_names_that_would_not_come_back_are_refused(tmp_path, suffix, changes, match):
    with pytest.raises(InputError, match=match):
        write_structure(replace(BARS, **changes), tmp_path / f"bars{suffix}")
    assert not list(tmp_path.iterdir())


def test_msh_tells_bodies_from_surfaces_by_name(tmp_path):
    structure = replace(BARS, surfaces=BARS.surfaces | {"left": BARS.surfaces["left_end"]})
    with pytest.raises(InputError, match="'left' is a body and a surface"):
        write_structure(structure, tmp_path / "bars.msh")
    write_structure(structure, tmp_path / "bars.vtu")
    assert "left" in read_structure(tmp_path / "bars.vtu").surfaces


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"unknown suffix '\.stl'; give one of \.vtu, \.msh"):
        write_structure(BARS, tmp_path / "bars.stl")
    refused(tmp_path / "bars.stl", "unknown suffix")
    refused(tmp_path / "bars.vtu", "no such mesh file")
    for name, text in [("a.vtu", "<VTKFile type='ImageData'></VTKFile>"), ("b.msh", "$EndNodes")]:
        (tmp_path / name).write_text(text)
        refused(tmp_path / name, "cannot read it")


@suffixes
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_truncated_file_is_refused_in_one_line(tmp_path, suffix, share):
    whole, part = tmp_path / f"whole{suffix}", tmp_path / f"part{suffix}"
    write_structure(BARS, whole)
    content = whole.read_bytes().rstrip()
    part.write_bytes(content[: int(share * len(content))])
    refused(part, "truncated|no volume cells")


def write_grid(grid, path):
    meshio.vtu.write(path, grid)
    return path


def labelled(grid):
    """The grid with all its volume cells in the body "all"."""
    label = [np.full(len(block), int(block.dim == 3), dtype=np.int8) for block in grid.cells]
    grid.cell_data["body:all"] = label
    return grid


def sorted_corners(mesh):
    return np.sort(mesh.p[:, mesh.t], axis=1)


@pytest.mark.parametrize(
    ("second_order", "name"), [(MeshHex2, "hexahedra"), (MeshTet2, "tetrahedra")]
)
def test_straight_cells_of_second_order_are_read_by_their_corners(tmp_path, second_order, name):
    mesh = STRUCTURES[name].mesh
    fine = second_order.from_mesh(mesh)
    path = write_grid(labelled(to_meshio(fine, encode_cell_data=False)), tmp_path / "fine.vtu")
    back = read_structure(path)
    assert np.allclose(sorted_corners(back.mesh), sorted_corners(mesh))


def test_serendipity_cells_are_read_too(tmp_path):
    grid = to_meshio(MeshHex2.from_mesh(BARS.mesh), encode_cell_data=False)
    grid.cells = [meshio.CellBlock("hexahedron20", grid.cells[0].data[:, :20])]
    back = read_structure(write_grid(labelled(grid), tmp_path / "fine.vtu"))
    assert np.allclose(sorted_corners(back.mesh), sorted_corners(BARS.mesh))


def test_cells_of_several_types_are_refused(tmp_path):
    grid = to_meshio(BARS.mesh, encode_cell_data=False)
    grid.cells.append(meshio.CellBlock("tetra", grid.cells[0].data[:1, [0, 1, 3, 4]]))
    refused(write_grid(labelled(grid), tmp_path / "mixed.vtu"), "hexahedron and tetra cells")
    grid.cells = [meshio.CellBlock("wedge", grid.cells[0].data[:1, [0, 1, 3, 4, 5, 7]])]
    grid.cell_data = {}
    refused(write_grid(labelled(grid), tmp_path / "wedges.vtu"), "wedge cells")
    grid.cells = [
        meshio.CellBlock("tetra", np.array([[0, 1, 3, 4]])),
        meshio.CellBlock("tetra10", np.array([[0, 1, 3, 4, 5, 6, 7, 8, 9, 10]])),
    ]
    refused(write_grid(labelled(grid), tmp_path / "orders.vtu"), "tetra and tetra10 .*one order")


def test_a_mesh_in_millimetres_is_refused(tmp_path):
    grid = labelled(to_meshio(BARS.mesh, encode_cell_data=False))
    grid.points = 1e3 * grid.points
    refused(write_grid(grid, tmp_path / "mm.vtu"), "250 m long; if it is in mm")


@pytest.mark.parametrize("kind", ["folded", "flat", "twice"])
def test_bad_cells_are_named(tmp_path, kind):
    grid = labelled(to_meshio(BARS.mesh, encode_cell_data=False))
    cells = grid.cells[0].data
    if kind == "folded":
        cells[3, [0, 1]] = cells[3, [1, 0]]
    elif kind == "flat":
        cells[3, 4:] = cells[3, :4]
    else:
        cells[3] = cells[2]
    match = "cell 3 is there twice" if kind == "twice" else "cell 3 is folded or has no volume"
    refused(write_grid(grid, tmp_path / "bad.vtu"), match)


def test_wedges_written_as_hexahedra_are_refused(tmp_path):
    """They have volume everywhere inside, but two of their faces are no quadrilaterals."""
    grid = labelled(to_meshio(BARS.mesh, encode_cell_data=False))
    cells = grid.cells[0].data
    cells[3, [3, 7]] = cells[3, [2, 6]]
    refused(write_grid(grid, tmp_path / "wedge.vtu"), "cell 3 has the same node at two corners")


def test_bodies_need_names_and_share_no_cell(tmp_path):
    grid = to_meshio(BARS.mesh, encode_cell_data=False)
    refused(write_grid(grid, tmp_path / "bare.vtu"), "no body has a name; .*'body:NAME'")
    half = np.arange(BARS.mesh.nelements) % 2
    grid.cell_data = {"body:half": [half]}
    refused(write_grid(grid, tmp_path / "half.vtu"), "cells are in no body")
    grid.cell_data = {"body:all": [half + 1]}
    refused(write_grid(grid, tmp_path / "two.vtu"), "'body:all' must hold 0 and 1")
    grid = to_meshio(BARS.mesh, encode_cell_data=False)
    tags = np.ones(BARS.mesh.nelements, dtype=np.int32)
    grid.cell_data = {"gmsh:physical": [tags], "gmsh:geometrical": [tags]}
    meshio.gmsh.write(tmp_path / "bare.msh", grid, fmt_version="2.2")
    refused(tmp_path / "bare.msh", r"no body has a name; .*Physical Volume\(\"NAME\"\)")


def with_facet(nodes, kind="quad"):
    grid = labelled(to_meshio(BARS.mesh, encode_cell_data=False))
    grid.cells.append(meshio.CellBlock(kind, np.array([nodes])))
    grid.cell_data["body:all"].append(np.zeros(1, dtype=np.int8))
    none = np.zeros(BARS.mesh.nelements, dtype=np.int8)
    grid.cell_data["surface:odd"] = [none, np.ones(1, dtype=np.int8)]
    return grid


def test_a_surface_off_the_boundary_is_named(tmp_path):
    mesh = BARS.mesh
    inside = np.setdiff1d(np.arange(mesh.nfacets), mesh.boundary_facets())[0]
    path = write_grid(with_facet(mesh.facets[:, inside]), tmp_path / "inside.vtu")
    refused(path, "surface 'odd' has facets inside the mesh")
    path = write_grid(with_facet([0, 1, 2, mesh.p.shape[1] - 1]), tmp_path / "off.vtu")
    refused(path, "surface 'odd' has facets that do not belong")
    path = write_grid(with_facet(mesh.facets[:3, 0], "triangle"), tmp_path / "triangle.vtu")
    refused(path, "surface 'odd' has triangle facets")


def test_a_probe_is_one_point(tmp_path):
    grid = labelled(to_meshio(BARS.mesh, encode_cell_data=False))
    grid.cells.append(meshio.CellBlock("vertex", np.array([[0], [1]])))
    grid.cell_data["body:all"].append(np.zeros(2, dtype=np.int8))
    none = np.zeros(BARS.mesh.nelements, dtype=np.int8)
    grid.cell_data["probe:A@all"] = [none, np.ones(2, dtype=np.int8)]
    refused(write_grid(grid, tmp_path / "probe.vtu"), "probe 'A@all' has 2 points")


def test_two_probes_of_one_name_are_refused(tmp_path):
    """A name in the case would mean one of them."""
    grid = labelled(to_meshio(BARS.mesh, encode_cell_data=False))
    grid.cells.append(meshio.CellBlock("vertex", np.array([[0], [1]])))
    grid.cell_data["body:all"].append(np.zeros(2, dtype=np.int8))
    none = np.zeros(BARS.mesh.nelements, dtype=np.int8)
    for name, at in (("probe:A@all", [1, 0]), ("probe:A", [0, 1])):
        grid.cell_data[name] = [none, np.array(at, dtype=np.int8)]
    refused(write_grid(grid, tmp_path / "probes.vtu"), "two probes have the name 'A'")


def gmsh_model(gmsh, order=1):
    """Two boxes that touch at x = 1 and share no node, meshed and named by Gmsh."""
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("bars")
    left = gmsh.model.occ.addBox(0, 0, 0, 1, 0.5, 0.5)
    right = gmsh.model.occ.addBox(1, 0, 0, 1, 0.5, 0.5)
    point = gmsh.model.occ.addPoint(0.25, 0.5, 0.25)
    gmsh.model.occ.synchronize()

    def face(volume, x):
        for _, tag in gmsh.model.getBoundary([(3, volume)], oriented=False):
            low, high = np.split(np.array(gmsh.model.getBoundingBox(2, tag)), 2)
            if abs(low[0] - x) < 1e-3 and abs(high[0] - x) < 1e-3:
                return tag
        raise AssertionError(x)

    for name, volume in (("left", left), ("right", right)):
        gmsh.model.addPhysicalGroup(3, [volume], name=name)
    groups = {
        "base": [face(left, 0)],
        "knee.a": [face(left, 1)],
        "knee.b": [face(right, 1)],
        "ends": [face(left, 0), face(right, 2)],
    }
    for name, tags in groups.items():
        gmsh.model.addPhysicalGroup(2, tags, name=name)
    gmsh.model.addPhysicalGroup(0, [point], name="probe:A@left")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(order)


@pytest.fixture
def gmsh():
    # Its wheel raises OSError where system libraries are missing.
    module = pytest.importorskip("gmsh", exc_type=(ImportError, OSError))
    module.initialize(interruptible=False)
    yield module
    module.finalize()


@pytest.mark.parametrize("version", [4.1, 2.2])
@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("order", [1, 2])
def test_a_mesh_from_gmsh_keeps_its_physical_groups(tmp_path, gmsh, version, binary, order):
    gmsh_model(gmsh, order)
    path = tmp_path / "bars.msh"
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(path))
    structure = read_structure(path)
    mesh = structure.mesh
    assert set(structure.bodies) == {"left", "right"}
    assert structure.joints == {"knee": ("knee.a", "knee.b")}
    assert structure.probes == {"A": Probe((0.25, 0.5, 0.25), "left")}
    assert set(structure.surfaces["base"]) < set(structure.surfaces["ends"])
    centres = mesh.p[0, mesh.facets].mean(axis=0)
    for name, planes in {"base": {0}, "knee.a": {1}, "knee.b": {1}, "ends": {0, 2}}.items():
        assert set(np.round(centres[structure.surfaces[name]], 9)) == planes
    assert mesh.p[0, mesh.t[:, structure.bodies["left"]]].max() == pytest.approx(1.0)


def test_gmsh_reads_what_we_write(tmp_path, gmsh):
    path = tmp_path / "bars.msh"
    write_structure(BARS, path)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(path))
    found = {
        gmsh.model.getPhysicalName(*group): gmsh.model.mesh.getNodesForPhysicalGroup(*group)[0]
        for group in gmsh.model.getPhysicalGroups()
    }
    assert set(found) == {
        *BARS.bodies,
        *BARS.surfaces,
        *(f"probe:{n}@{p.body}" for n, p in BARS.probes.items()),
    }
    for name, facets in BARS.surfaces.items():
        nodes = np.unique(BARS.mesh.facets[:, facets])
        assert np.array_equal(np.unique(found[name]) - 1, nodes)


@pytest.mark.parametrize("version", [4.1, 2.2])
def test_gmsh_files_with_unnamed_entities_are_refused_in_one_line(tmp_path, gmsh, version):
    """In MSH 2.2 no cell has a group then."""
    gmsh_model(gmsh)
    path = tmp_path / "all.msh"
    gmsh.option.setNumber("Mesh.SaveAll", 1)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.write(str(path))
    refused(path, "with the physical groups only")


@pytest.mark.parametrize("version", [4.1, 2.2])
def test_a_surface_with_the_name_of_a_body_is_refused(tmp_path, gmsh, version):
    """It was lost without a word: nothing convected there."""
    gmsh_model(gmsh)
    gmsh.model.addPhysicalGroup(2, [1], name="left")
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.write(str(tmp_path / "bars.msh"))
    refused(tmp_path / "bars.msh", "'left' is the name of two physical groups")


@pytest.mark.parametrize("version", [4.1, 2.2])
@pytest.mark.parametrize("binary", [0, 1])
def test_a_physical_group_has_the_surfaces_that_it_lists_reversed(tmp_path, gmsh, version, binary):
    gmsh_model(gmsh)
    ends = [tag for _, tag in gmsh.model.getEntitiesForPhysicalName("ends")]
    gmsh.model.addPhysicalGroup(2, [ends[0], -ends[1]], name="turned")
    gmsh.model.addPhysicalGroup(2, [-ends[0]], name="base turned")
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(tmp_path / "bars.msh"))
    surfaces = read_structure(tmp_path / "bars.msh").surfaces
    assert np.array_equal(surfaces["turned"], surfaces["ends"])
    assert np.array_equal(surfaces["base turned"], surfaces["base"])


def test_curves_and_points_may_have_names_too(tmp_path, gmsh):
    gmsh_model(gmsh)
    for dimension in (0, 1):
        gmsh.model.addPhysicalGroup(dimension, [1], name="base")
    gmsh.write(str(tmp_path / "bars.msh"))
    assert "base" in read_structure(tmp_path / "bars.msh").surfaces


def test_a_mesh_whose_bodies_share_nodes_cannot_have_a_joint_there(tmp_path, gmsh):
    gmsh_model(gmsh)
    gmsh.model.mesh.removeDuplicateNodes()
    path = tmp_path / "glued.msh"
    gmsh.write(str(path))
    refused(path, r"'knee\.a' .* sides of a joint must not share nodes")
