"""CAD parts become meshes with names; needs Gmsh, but for what is said when it is not there."""

import subprocess
import sys

import numpy as np
import pytest
from step_files import gmsh, needs_gmsh, write_step

from meshes.cad import Names, free_faces, mesh_cad, read_names
from meshes.exchange import read_structure
from meshes.inspection import inspect
from meshes.pairing import pair_joint
from thermojoint.artefacts.errors import InputError


@pytest.fixture(scope="module")
def step(tmp_path_factory):
    """A bed, a head stock beside it and a pin standing on it, with one named face."""
    path = tmp_path_factory.mktemp("cad") / "part.step"
    write_step(
        path,
        [
            ("bed", "addBox", 0, 0, 0, 100, 40, 40),
            ("head stock", "addBox", 100, 0, 0, 50, 40, 40),
            ("pin", "addCylinder", 20, 20, 40, 0, 0, 30, 10),
        ],
    )
    return path


def found_in(part, folder, **options):
    """What a mesh of a part holds."""
    mesh_cad(part, folder / "part.msh", 0.02, **options)
    return inspect(read_structure(folder / "part.msh"))


@pytest.fixture(scope="module")
def found(step, tmp_path_factory):
    """What its mesh holds where no names are given."""
    return found_in(step, tmp_path_factory.mktemp("mesh"))


@needs_gmsh
def test_solids_keep_their_names_and_their_size_in_metres(found):
    assert set(found.bodies) == {"bed", "head_stock", "pin"}
    assert found.bodies["bed"].volume == pytest.approx(0.1 * 0.04 * 0.04)
    assert found.extent == pytest.approx((0.15, 0.04, 0.07))
    assert found.warnings == ()


@needs_gmsh
def test_faces_on_each_other_are_the_sides_of_a_joint(found):
    """Equal faces, and a small one that stands in the middle of a large one."""
    joints = found.joints
    assert set(joints) == {"bed_head_stock", "bed_pin"}
    assert joints["bed_head_stock"].overlap == pytest.approx(0.04**2)
    assert joints["bed_pin"].overlap == pytest.approx(np.pi * 0.01**2, rel=0.05)


@needs_gmsh
def test_what_a_joint_does_not_cover_of_a_face_still_convects(found):
    """The two sides are what the solids share; the rest of each face is a face of its own."""
    foot = found.surfaces["bed_pin.b"].area
    assert found.surfaces["bed_pin.a"].area == pytest.approx(foot)
    top, sides, end = 0.1 * 0.04 - foot, 3 * 0.1 * 0.04, 0.04**2
    assert found.surfaces["bed_outer"].area == pytest.approx(top + sides + end)
    assert found.unnamed_area == pytest.approx(0.0, abs=1e-12)


@needs_gmsh
def test_a_pin_through_a_longer_bore_leaves_both_their_rests(tmp_path):
    """Round faces that close on themselves are divided as plane ones are."""
    solids = [
        ("house", "addBox", -30, -30, 0, 60, 60, 40),
        ("hole", "addCylinder", 0, 0, 0, 0, 0, 40, 10),
        ("pin", "addCylinder", 0, 0, 10, 0, 0, 60, 10),
    ]
    write_step(tmp_path / "part.step", solids, holes=[(1, 2)])
    found = found_in(tmp_path / "part.step", tmp_path)
    around = 2.0 * np.pi * 0.01
    seat, end = around * 0.03, np.pi * 0.01**2
    assert found.joints["house_pin"].overlap == pytest.approx(seat, rel=0.02)
    box = 4 * 0.06 * 0.04 + 2 * (0.06**2 - end)
    assert found.surfaces["house_outer"].area == pytest.approx(box + around * 0.01, rel=0.01)
    assert found.surfaces["pin_outer"].area == pytest.approx(around * 0.03 + 2 * end, rel=0.03)
    joint = pair_joint(read_structure(tmp_path / "part.msh"), "house_pin", 9, 1)
    assert joint.area.sum() == pytest.approx(found.surfaces["house_pin.a"].area)


@needs_gmsh
def test_a_failure_inside_of_gmsh_is_told_in_one_line(step, tmp_path, monkeypatch):
    def fails(*_):
        raise Exception("Could not\n intersect")  # noqa: TRY002 - what Gmsh raises

    monkeypatch.setattr(gmsh.model.occ, "intersect", fails)
    with pytest.raises(InputError, match=r"step: Gmsh cannot find its joints \(Could not inter"):
        mesh_cad(step, tmp_path / "part.msh", 0.02)
    assert list(tmp_path.iterdir()) == []


@needs_gmsh
def test_an_element_size_that_would_never_end_is_refused_with_one_that_does(step, tmp_path):
    with pytest.raises(InputError, match=r"elements of 0\.012 mm .* take [0-9.]+ mm or larger"):
        mesh_cad(step, tmp_path / "out.msh", 1.2e-5)
    assert not list(tmp_path.iterdir())


@needs_gmsh
def test_curved_cells_are_rounder(step, found, tmp_path):
    volume = np.pi * 0.01**2 * 0.03
    straight, curved = (
        abs(one.bodies["pin"].volume / volume - 1.0)
        for one in (found, found_in(step, tmp_path, order=2))
    )
    assert curved < 0.1 * straight


@needs_gmsh
def test_points_name_faces(step, tmp_path):
    (tmp_path / "names.toml").write_text(
        "[surfaces_mm]\nfoot = [[0, 20, 20]]\nends = [[150, 20, 20], [20, 20, 70]]\n"
    )
    names = read_names(tmp_path / "names.toml")
    surfaces = found_in(step, tmp_path, names=names).surfaces
    assert surfaces["foot"].area == pytest.approx(0.04**2)
    assert surfaces["foot"].normal == pytest.approx((-1.0, 0.0, 0.0))
    assert set(surfaces["ends"].bodies) == {"head_stock", "pin"}


@needs_gmsh
def test_a_guide_is_the_face_below_its_slide_and_the_rest_of_it(step, tmp_path):
    """Where both sides of the joint are, that of the body with the other point is meant."""
    (tmp_path / "names.toml").write_text("[surfaces_mm]\nway = [[20, 20, 40], [60, 20, 40]]\n")
    found = found_in(step, tmp_path, names=read_names(tmp_path / "names.toml"))
    assert found.surfaces["way"].bodies == ("bed",)
    assert found.surfaces["way"].area == pytest.approx(0.1 * 0.04, rel=1e-3)


@needs_gmsh
def test_bodies_and_joints_are_named_and_every_face_has_a_point(step, tmp_path):
    faces, touching = free_faces(step, 0.02)
    own = {face.body: face.point for face in faces}
    points = {f"face_{k}": [face.point] for k, face in enumerate(faces)}
    bodies = {f"a_{name}": point for name, point in own.items()}
    joints = {f"j{k}": (f"a_{pair[1]}", f"a_{pair[0]}") for k, pair in enumerate(touching)}
    found = found_in(step, tmp_path, names=Names(points, bodies, joints))
    assert set(found.bodies) == set(bodies)
    assert set(found.joints) == set(joints)
    for k, face in enumerate(faces):
        assert found.surfaces[f"face_{k}"].area == pytest.approx(face.area, rel=0.1)
        assert found.surfaces[f"face_{k}"].bodies == (f"a_{face.body}",)
    assert not any(name.endswith("_outer") for name in found.surfaces)
    for name, (first, _) in joints.items():
        assert found.surfaces[f"{name}.a"].bodies == (first,)
    with pytest.raises(InputError, match=r"joints\.slide: no body named 'pim'"):
        mesh_cad(step, tmp_path / "part.msh", 0.02, names=Names({}, {}, {"slide": ("pim", "pin")}))


@needs_gmsh
def test_a_point_on_no_face_is_refused_with_the_distance(step, tmp_path):
    with pytest.raises(InputError, match=r"'foot': no face at \(-5, 20, 20\) mm.* 5 mm away"):
        mesh_cad(step, tmp_path / "part.msh", 0.02, names=Names({"foot": [(-0.005, 0.02, 0.02)]}))
    assert list(tmp_path.iterdir()) == []


@needs_gmsh
@pytest.mark.parametrize(
    ("names", "message"),
    [
        (Names({"bed": [(0.0, 0.02, 0.02)]}), r"surfaces_mm\.bed: a body or a side"),
        (Names({"bed_head_stock.a": [(0.0, 0.02, 0.02)]}), "a body or a side of a joint"),
        (Names({"bed_outer": [(0.0, 0.02, 0.02)]}), "faces of bed without a name are gathered"),
        (
            Names(joints={"one": ("bed", "head_stock"), "two": ("head_stock", "bed")}),
            r"joints\.two: the same bodies as joints\.one",
        ),
        (
            Names(joints={"bed_pin": ("head_stock", "bed")}),
            r"joints\.bed_pin: head_stock and bed have a joint of that name, bed and pin, too",
        ),
    ],
)
def test_two_parts_of_one_name_are_refused(step, tmp_path, names, message):
    """One of them would be lost without a word, and nothing would convect there."""
    with pytest.raises(InputError, match=message):
        mesh_cad(step, tmp_path / "part.msh", 0.02, names=names)
    assert list(tmp_path.iterdir()) == []


@needs_gmsh
def test_names_of_bodies_that_join_to_one_name_are_refused(tmp_path):
    """Of two joints of one name the first would be lost: nothing would pass there."""
    boxes = {"bed": (0, 0), "rail_pad": (0, 10), "bed_rail": (60, 0), "pad": (60, 10)}
    solids = [(name, "addBox", x, 0, z, 40, 40, 10) for name, (x, z) in boxes.items()]
    write_step(tmp_path / "part.step", solids)
    with pytest.raises(InputError, match=r"^joints\.bed_rail_pad: bed and rail_pad have a joint"):
        mesh_cad(tmp_path / "part.step", tmp_path / "part.msh", 0.02)
    named = Names(joints={"pads": ("bed_rail", "pad")})
    assert set(found_in(tmp_path / "part.step", tmp_path, names=named).joints) == {
        "bed_rail_pad",
        "pads",
    }


@needs_gmsh
@pytest.mark.parametrize("content", ["", "ISO-10303-21;\nHEADER;\n", "nonsense"])
def test_a_damaged_part_is_refused(tmp_path, content):
    (tmp_path / "bad.step").write_text(content)
    with pytest.raises(InputError, match=r"bad\.step: (Gmsh cannot read it|contains no solid)"):
        mesh_cad(tmp_path / "bad.step", tmp_path / "out.msh", 0.01)
    assert not (tmp_path / "out.msh").exists()


def test_without_gmsh_it_is_said_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    (tmp_path / "part.step").write_text("")
    with pytest.raises(InputError, match=r"pip install -e '.\[gmsh\]'"):
        mesh_cad(tmp_path / "part.step", tmp_path / "out.msh", 0.01)


@pytest.mark.parametrize(
    ("part", "out", "message"),
    [
        ("part.stl", "out.msh", "unknown suffix '.stl'"),
        ("part.step", "out.msh", "no such CAD file"),
        ("there.step", "out.vtu", "name it out.msh"),
    ],
)
def test_wrong_files_are_refused_before_gmsh_starts(tmp_path, part, out, message):
    (tmp_path / "there.step").write_text("")
    with pytest.raises(InputError, match=message):
        mesh_cad(tmp_path / part, tmp_path / out, 0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[surfaces]\nfoot = [[0, 0, 0]]\n", "did you mean 'surfaces_mm'"),
        ("[surfaces_mm]\nfoot = [[0, 0]]\n", r"surfaces_mm\.foot\.1\.3 is missing; add it"),
        ("[surfaces_mm]\nfoot = []\n", r"surfaces_mm\.foot"),
        ("[surfaces_mm]\nfoot.left = [[0, 0, 0]]\n", 'write it in quotes: "foot.left"'),
        ("[surfaces_mm\n", "no valid TOML"),
    ],
)
def test_a_file_of_names_is_checked(tmp_path, text, message):
    (tmp_path / "names.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_names(tmp_path / "names.toml")


def test_a_byte_order_mark_may_lead_a_file_of_names(tmp_path):
    (tmp_path / "names.toml").write_text("[surfaces_mm]\nfoot = [[0, 0, 0]]\n", "utf-8-sig")
    assert read_names(tmp_path / "names.toml").surfaces == {"foot": [(0.0, 0.0, 0.0)]}


AFTERWARDS = """
import socket, sys
from pathlib import Path
from meshes.cad import mesh_cad

mesh_cad(Path(sys.argv[1]), Path(sys.argv[2]), 0.05)
ours, theirs = socket.socketpair()
theirs.close()
try:
    ours.send(b"to nobody")
except BrokenPipeError:
    print("told")
"""


@needs_gmsh
def test_a_reader_who_left_does_not_end_the_process_after_meshing(step, tmp_path):
    """Gmsh lets the signal of a broken pipe end its process, without a word."""
    done = subprocess.run(
        [sys.executable, "-c", AFTERWARDS, str(step), str(tmp_path / "part.msh")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "told\n"), done.stderr
