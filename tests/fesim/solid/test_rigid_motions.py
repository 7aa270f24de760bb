"""Bodies that nothing holds: refused before the march, by name and direction; nothing else is."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bars import two_bars
from boxes import boxes
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from vees_and_sleeves import long_sleeve, vee

from fesim.solid.rigid_motions import check_held, constraints_of
from meshes.pairing import pair_joint
from thermojoint.artefacts.errors import InputError

BASE = ((0.0, 0.0, 0.0), (0.4, 0.1, 0.3))
BLOCK = ((0.1, 0.1, 0.1), (0.2, 0.2, 0.2))
#: A block on a plane, and the same block against a wall to its right.
ON_PLANE = boxes({"seat": ("base.y1", "block.y0")}, base=BASE, block=BLOCK)
WALL = ((0.2, 0.1, 0.0), (0.3, 0.3, 0.3))
AT_WALL = boxes(
    {"seat": ("base.y1", "block.y0"), "side": ("block.x1", "wall.x0")},
    base=BASE,
    block=BLOCK,
    wall=WALL,
)


def check(structure, fixed=(), symmetry=None, springs=None, friction=(), grid=(3, 2)):
    """Check a structure of which some joints have friction."""
    joints = [pair_joint(structure, name, *grid) for name in structure.joints]
    holds = constraints_of(structure, joints, fixed, symmetry or {}, springs or {})
    rough = [np.full(len(joint.area), joint.name in friction) for joint in joints]
    check_held(holds, np.concatenate([np.empty(0, dtype=bool), *rough]))


def test_a_block_that_slides_on_a_plane_is_refused_by_name_and_direction():
    with pytest.raises(InputError) as caught:
        check(ON_PLANE, ["base.y0"])
    said = str(caught.value)
    assert "keeps body 'block' from moving along x and z and from turning about y" in said
    assert "friction_coefficient above 0" in said
    assert "\n" not in said


def test_friction_holds_the_block():
    check(ON_PLANE, ["base.y0"], friction=["seat"])


def test_springs_hold_the_block_along_their_stiffness_alone():
    check(ON_PLANE, ["base.y0"], springs={"block.x1": (1e3, 0.0, 1e3)})
    with pytest.raises(InputError, match=r"body 'block' from moving along z; hold it"):
        check(ON_PLANE, ["base.y0"], springs={"block.x1": (1e3, 0.0, 0.0)})


def test_a_wall_holds_the_block_across_itself_alone():
    with pytest.raises(InputError, match=r"body 'block' from moving along z; hold it"):
        check(AT_WALL, ["base.y0", "wall.x1"])
    check(AT_WALL, ["base.y0", "wall.x1"], symmetry={"block.z0": "z"})
    check(AT_WALL, ["base.y0", "wall.x1"], friction=["side"])


def test_a_half_model_is_held_by_its_symmetry_plane():
    """A plane x and a plane z leave the way along y, which the joint closes."""
    check(ON_PLANE, ["base.y0"], symmetry={"block.x0": "x", "block.z0": "z"})
    with pytest.raises(InputError, match=r"body 'block' from moving along z; hold it"):
        check(ON_PLANE, ["base.y0"], symmetry={"block.x0": "x"})


def test_one_contact_element_is_a_hinge():
    with pytest.raises(InputError, match=r"'block' from turning about x, y and z; .* more contact"):
        check(ON_PLANE, ["base.y0"], friction=["seat"], grid=(1, 1))
    with pytest.raises(InputError, match=r"'block' from turning about x; .* more contact elements"):
        check(ON_PLANE, ["base.y0"], friction=["seat"], grid=(2, 1))
    check(ON_PLANE, ["base.y0"], friction=["seat"], grid=(2, 2))


def test_bodies_that_stick_to_each_other_slide_together():
    tower = boxes(
        {"seat": ("base.y1", "block.y0"), "top": ("block.y1", "cap.y0")},
        base=BASE,
        block=BLOCK,
        cap=((0.1, 0.2, 0.1), (0.2, 0.3, 0.2)),
    )
    with pytest.raises(InputError, match=r"body 'block' and body 'cap' together from moving"):
        check(tower, ["base.y0"], friction=["top"])
    check(tower, ["base.y0"], friction=["top", "seat"])
    check(tower, ["base.y0"], {"cap.x0": "x", "cap.z0": "z"}, friction=["top"])


def test_a_body_that_nothing_touches_is_refused():
    with pytest.raises(InputError, match="body 'block' has no support, spring or joint"):
        check(replace(ON_PLANE, joints={}), ["base.y0"], grid=())


def test_a_long_chain_of_bodies_is_held_from_its_ends():
    ends = np.linspace(0.0, 3.0, 31)
    chain = boxes(
        {f"j{i}": (f"b{i}.x1", f"b{i + 1}.x0") for i in range(29)},
        **{
            f"b{i}": ((low, 0.0, 0.0), (high, 0.1, 0.1), (1, 1, 1))
            for i, (low, high) in enumerate(pairwise(ends))
        },
    )
    check(chain, ["b0.x0"], friction=[f"j{i}" for i in range(29)], grid=(2, 2))
    loose = [f"j{i}" for i in range(29) if i != 20]
    with pytest.raises(InputError, match="body 'b21', body 'b22'"):
        check(chain, ["b0.x0"], friction=loose, grid=(2, 2))


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_a_small_seat_holds_a_large_body_against_tilting(size):
    """A mast of a metre on a foot of a tenth of a millimetre."""
    foot = 1e-4
    mast = boxes(
        {"seat": ("base.y1", "mast.y0")},
        base=((0.0, 0.0, 0.0), (foot * size, 0.1 * size, foot * size)),
        mast=((0.0, 0.1 * size, 0.0), (foot * size, 1.1 * size, foot * size)),
    )
    check(mast, ["base.y0"], friction=["seat"])
    with pytest.raises(InputError, match=r"'mast' from moving along x and z and from turning abou"):
        check(mast, ["base.y0"])


# --- joints that are not plane -------------------------------------------------------------------


def test_a_vee_guides_along_itself_alone():
    guide = vee(np.deg2rad(40.0), (4, 4, 2), (2, 6, 3))
    with pytest.raises(InputError, match=r"body 'right' from moving along z; hold it"):
        check(guide, ["left_end"])
    check(guide, ["left_end"], {"back": "z"})


def test_a_flank_that_leans_a_little_is_enough():
    check(vee(2e-2, (4, 4, 2), (2, 6, 3)), ["left_end"], {"back": "z"})


@pytest.mark.parametrize("irregular", [0.0, 0.02])
def test_a_shaft_in_a_seat_without_friction_slides_and_spins(irregular):
    """On an irregular mesh its facets seem to hold it a little."""
    sleeve = long_sleeve(0.1, (24, 6), (24, 6))
    points = sleeve.mesh.p.copy()
    turn = irregular * np.random.default_rng(2).standard_normal(points.shape[1])
    points[0], points[1] = (
        np.cos(turn) * points[0] - np.sin(turn) * points[1],
        np.sin(turn) * points[0] + np.cos(turn) * points[1],
    )
    sleeve = replace(sleeve, mesh=type(sleeve.mesh)(points, sleeve.mesh.t))
    inner = np.unique(sleeve.mesh.f2t[0, sleeve.surfaces["joint.a"]])
    cells = np.arange(sleeve.mesh.nelements)
    ends = sleeve.mesh.boundary_facets()
    low = ends[sleeve.mesh.p[2, sleeve.mesh.facets[:, ends]].max(axis=0) < 1e-9]
    owner = np.isin(sleeve.mesh.f2t[0, low], inner)
    whole = replace(
        sleeve,
        bodies={"shaft": inner, "bore": np.setdiff1d(cells, inner)},
        surfaces=sleeve.surfaces | {"bore_end": low[~owner], "shaft_end": low[owner]},
    )
    with pytest.raises(InputError, match=r"'shaft' from moving along z and from turning about z;"):
        check(whole, ["bore_end"], grid=(12, 1))
    with pytest.raises(InputError, match=r"'shaft' from turning about z;"):
        check(whole, ["bore_end"], {"shaft_end": "z"}, grid=(12, 1))
    check(whole, ["bore_end"], friction=["joint"], grid=(12, 1))


# --- laws ----------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    scale=st.floats(1e-3, 1e3),
    friction=st.sets(st.sampled_from(["seat", "side"])),
)
def test_what_holds_does_not_depend_on_place_turn_or_size(seed, scale, friction):
    """The block at its wall is free along the wall, however the structure lies."""
    turn = Rotation.random(random_state=seed).as_matrix()
    place = np.random.default_rng(seed).uniform(-3.0, 3.0, 3)
    points = scale * (turn @ AT_WALL.mesh.p + place[:, None])
    moved = replace(AT_WALL, mesh=type(AT_WALL.mesh)(points, AT_WALL.mesh.t))

    def left(structure):
        joints = [pair_joint(structure, name, 3, 2) for name in structure.joints]
        holds = constraints_of(structure, joints, ["base.y0", "wall.x1"], {}, {})
        sticks = np.concatenate([np.full(len(j.area), j.name in friction) for j in joints])
        normal, first, second = holds.directions
        every, stuck = np.arange(len(sticks)), np.flatnonzero(sticks)
        along = np.vstack([normal, first[stuck], second[stuck]])
        return holds.unheld(np.concatenate([every, stuck, stuck]), along).shape[1]

    assert left(moved) == left(AT_WALL) == (0 if friction else 1)


def test_a_body_in_loose_pieces_is_told_by_the_place_of_the_piece():
    bars = two_bars()
    one = replace(bars, bodies={"both": np.arange(bars.mesh.nelements)}, joints={}, probes={})
    with pytest.raises(InputError, match=r"the piece of body 'both' around \(0\.175, 0\.03, 0\.02"):
        check(one, ["left_end"], grid=())
