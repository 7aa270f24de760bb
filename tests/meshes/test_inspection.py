"""What `inspect` finds in structures whose contents are known."""

import io
import json
import re
import tomllib
from dataclasses import asdict, replace

import numpy as np
import pytest
from bars import AREA, DEPTH, LEFT, RIGHT, WIDTH, shifted, two_bars
from rich.console import Console
from skfem import MeshHex, MeshHex2, MeshTet, MeshTet2

from fesim.case.schema import case_from_data
from fesim.setup.parts import check_names
from fesim.setup.structure import build_structure
from meshes.exchange import write_structure
from meshes.inspection import inspect
from meshes.milling_machine import box_milling_machine
from meshes.quality import cell_quality
from meshes.structure import Structure
from thermojoint.cli.inspection_report import case_skeleton, show


def test_cubes_are_perfect_and_slanted_ones_are_worse():
    cube = MeshHex.init_tensor(*([np.linspace(0.0, 1.0, 3)] * 3))
    assert cell_quality(cube) == pytest.approx(np.ones(8))
    assert cell_quality(MeshHex(2.0 * cube.p, cube.t)) == pytest.approx(np.ones(8))
    slant = cube.p.copy()
    slant[0] += slant[2]  # a shear by 45 degrees
    assert cell_quality(MeshHex(slant, cube.t)) == pytest.approx(np.full(8, np.sqrt(0.5)))


def test_regular_tetrahedra_are_perfect_and_slivers_are_not():
    points = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float).T
    cells = np.array([[0], [1], [2], [3]])
    assert cell_quality(MeshTet(points, cells)) == pytest.approx([1.0])
    flat = points * np.array([[1.0], [1.0], [1e-3]])
    assert cell_quality(MeshTet(flat, cells))[0] < 0.01


@pytest.mark.parametrize("tetrahedra", [False, True])
def test_volumes_areas_and_joints_are_measured(tetrahedra):
    found = inspect(two_bars((2, 3, 2), (2, 4, 3), tetrahedra))
    assert found.bodies["left"].volume == pytest.approx(LEFT * AREA)
    assert found.bodies["right"].extent == pytest.approx((RIGHT, WIDTH, DEPTH))
    assert found.surfaces["top"].area == pytest.approx((LEFT + RIGHT) * DEPTH)
    assert found.surfaces["top"].normal == pytest.approx((0.0, 1.0, 0.0))
    assert found.surfaces["top"].bodies == ("left", "right")
    joint = found.joints["joint"]
    assert (joint.area_a, joint.area_b, joint.overlap) == pytest.approx((AREA, AREA, AREA))
    assert joint.gap == pytest.approx((0.0, 0.0), abs=1e-12)
    assert joint.parts == 1
    assert not joint.matching
    assert found.warnings == ()
    # The front is the only side of the bars without a name.
    assert found.unnamed_area == pytest.approx((LEFT + RIGHT) * WIDTH)


@pytest.mark.parametrize("second_order", [MeshHex2, MeshTet2])
def test_the_area_of_curved_cells_is_that_of_the_curved_face(second_order):
    first_order = MeshHex if second_order is MeshHex2 else MeshTet
    straight = first_order.init_tensor(*(np.linspace(0.0, 1.0, n + 1) for n in (1, 3, 1)))
    facets = straight.boundary_facets()
    outside = facets[straight.p[0, straight.facets[:, facets]].min(axis=0) > 1.0 - 1e-9]
    fine = second_order.from_mesh(straight)
    radius, angle = 0.05 + 0.05 * fine.doflocs[0], 0.5 * np.pi * fine.doflocs[1]
    bent = np.array([radius * np.cos(angle), radius * np.sin(angle), 0.03 * fine.doflocs[2]])
    mesh = second_order(bent, fine.t)
    ring = Structure(mesh, {"ring": np.arange(mesh.nelements)}, {"outside": outside})
    found = inspect(ring)
    # A quarter of a cylinder; straight facets have 1.1 % less.
    assert found.surfaces["outside"].area == pytest.approx(0.5 * np.pi * 0.1 * 0.03, rel=2e-4)
    assert found.surfaces["outside"].normal == pytest.approx((2 / np.pi, 2 / np.pi, 0), rel=2e-4)
    whole = 0.5 * np.pi * (0.15 * 0.03 + 0.1**2 - 0.05**2) + 2.0 * 0.05 * 0.03
    outer = found.surfaces["outside"].area
    assert found.unnamed_area + outer == pytest.approx(whole, rel=2e-4)


@pytest.mark.parametrize("twist", [False, True])
def test_facets_match_if_their_corners_do(twist):
    """Triangles of the other diagonal have the same centres along every axis, but do not match."""
    lines = [np.linspace(0.0, 1.0, 3)] * 3
    below = MeshTet.init_tensor(*lines)
    # Seen in a mirror, the cells cut their squares along the other diagonal.
    above = below.p * [[1.0], [1.0], [-1.0]] + [[0.0], [0.0], [2.0]]
    if twist:
        above = above * [[-1.0], [1.0], [1.0]] + [[1.0], [0.0], [0.0]]
    mesh = MeshTet(np.hstack([below.p, above]), np.hstack([below.t, below.t + below.p.shape[1]]))
    facets = mesh.boundary_facets()
    between = facets[(mesh.p[2, mesh.facets[:, facets]] == 1.0).all(axis=0)]
    lower = mesh.f2t[0, between] < below.nelements
    structure = Structure(
        mesh,
        bodies={"all": np.arange(mesh.nelements)},
        surfaces={"joint.a": between[lower], "joint.b": between[~lower]},
        joints={"joint": ("joint.a", "joint.b")},
    )
    assert inspect(structure).joints["joint"].matching is not twist


BARS = two_bars((2, 2, 2), (2, 2, 2))
LONG = two_bars((2, 4, 2), (2, 7, 3), right_width=3 * WIDTH)
LONG = replace(LONG, surfaces={n: LONG.surfaces[n] for n in ("joint.a", "joint.b")})
FAULTS = {
    "a gap": (shifted(BARS, ["right"], (2e-3, 0.0, 0.0)), "its sides are 2 to 2 mm apart"),
    "half beside": (
        shifted(BARS, ["right"], (0.0, WIDTH / 2, 0.0)),
        "its sides share 12 of 24 cm2",
    ),
    "a long side": (
        LONG,
        "'joint': side b is 48 cm2 larger than what it shares, and nothing convects there",
    ),
    "not facing": (shifted(BARS, ["right"], (0.0, 2 * WIDTH, 0.0)), "do not face each other"),
    "one in the other": (
        shifted(BARS, ["right"], (-0.03, 0.0, 0.0)),
        "bodies 'left' and 'right' overlap around (",
    ),
    "millimetres": (
        replace(BARS, mesh=MeshHex(1e3 * BARS.mesh.p, BARS.mesh.t), probes={}),
        "250 m long: check the unit",
    ),
    "no joint": (replace(BARS, joints={}), "'left' and 'right' face each other on about 24 cm2"),
    "no partner": (
        replace(
            BARS, joints={}, surfaces={n: f for n, f in BARS.surfaces.items() if n != "joint.b"}
        ),
        "'joint.a' looks like a joint side, but there is no 'joint.b'",
    ),
    "one body in two": (
        replace(BARS, bodies={"both": np.arange(BARS.mesh.nelements)}, joints={}, probes={}),
        "body 'both' is in 2 pieces",
    ),
    "glued": (box_milling_machine(element_size=0.15), "'table' and 'screw' share"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_told(fault):
    structure, said = FAULTS[fault]
    assert any(said in warning for warning in inspect(structure).warnings)


def test_a_guide_may_be_longer_than_what_rides_on_it():
    assert not inspect(LONG, riding=["joint"]).warnings


def test_a_long_side_that_convects_is_no_fault():
    cooled = {"cooled": LONG.surfaces["joint.b"]}
    assert inspect(replace(LONG, surfaces=LONG.surfaces | cooled)).warnings == ()


def test_slivers_are_told_with_their_place():
    points = BARS.mesh.p.copy()
    inner = np.flatnonzero(np.isclose(points, [[LEFT / 2], [WIDTH / 2], [DEPTH / 2]]).all(axis=0))
    points[:, inner] = [[1e-3], [1e-3], [DEPTH / 2]]
    found = inspect(replace(BARS, mesh=MeshHex(points, BARS.mesh.t)))
    assert found.quality["worst"] < 0.1
    assert any("cells have a quality below 0.1" in warning for warning in found.warnings)


def test_what_was_found_is_valid_json():
    data = json.loads(json.dumps(asdict(inspect(BARS)), allow_nan=False))
    assert data["joints"]["joint"]["overlap"] == pytest.approx(AREA)


LONG_NAME = "Gehaeuse_Unterteil_rechts_Rev_C_4711-0815-003"


@pytest.mark.parametrize("width", [60, 80, 100])
def test_long_names_are_printed_whole(width):
    bodies = {f"{LONG_NAME}_{name}": cells for name, cells in BARS.bodies.items()}
    joint = "_".join(bodies)
    renamed = replace(BARS, bodies=bodies, joints={joint: BARS.joints["joint"]}, probes={})
    told = io.StringIO()
    show(Console(file=told, width=width, highlight=False, markup=False), "x.msh", inspect(renamed))
    for name in (*bodies, joint):
        assert name in told.getvalue()


def test_short_names_stand_in_tables():
    told = io.StringIO()
    show(Console(file=told, width=100, highlight=False, markup=False), "x.msh", inspect(BARS))
    assert "│ left_end " in told.getvalue()
    assert "│ joint │" in told.getvalue()


def test_the_skeleton_names_what_is_there(tmp_path):
    """Completed by a source and a point, it is a case that fits the mesh, wherever either lies."""
    mesh, case_file = tmp_path / "meshes" / 'two "bärs".vtu', tmp_path / "cases" / "bars.toml"
    mesh.parent.mkdir()
    case_file.parent.mkdir()
    write_structure(BARS, mesh)
    text = case_skeleton(mesh, case_file, "m", inspect(BARS))
    data = tomllib.loads(text)
    assert data["structure"]["file"] == '../meshes/two "bärs".vtu'
    assert set(data["bodies"]) == {"left", "right"}
    assert set(data["joints"]) == {"joint"}
    data["sources"]["heat"]["surface"] = "left_top"
    data["supports"]["fixed"] = ["left_end", "right_end"]
    case = case_from_data(data, "skeleton", case_file.parent)
    check_names(case, build_structure(case))


@pytest.mark.parametrize("said", ["initial_temperature", "radiation", "cavities", "materials"])
def test_the_skeletons_thermal_sections_are_sections(tmp_path, said):
    """Each block that is commented out becomes part of a case when the signs are taken away."""
    write_structure(BARS, tmp_path / "bars.vtu")
    text = case_skeleton(tmp_path / "bars.vtu", tmp_path / "bars.toml", "m", inspect(BARS))
    begins = text.index(f"# [{said}")
    block = text[begins : text.index("# [", begins + 3)]
    lines = re.findall(r"^# (\[.*|\w+ = .*)$", block, re.M)
    data = tomllib.loads(text.replace("[bodies]", "\n".join(lines) + "\n[bodies]", 1))
    data["sources"]["heat"]["surface"] = "left_top"
    data["supports"]["fixed"] = ["left_end", "right_end"]
    data["march"]["thermal"] = "full"
    if said == "cavities":
        data["convection_W_m2K"] = {}
    case = case_from_data(data, "skeleton", tmp_path)
    check_names(case, build_structure(case))
