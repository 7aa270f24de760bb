"""What a joint covers does not convect, to the part of a facet; what is left does."""

import json
from dataclasses import replace

import numpy as np
import pytest
from bars import AREA, DEPTH, IRON, LEFT, RIGHT, WIDTH, conduct, two_bars
from boxes import boxes
from hypothesis import given, settings
from hypothesis import strategies as st
from skfem import CellBasis, ElementTetP1, FacetBasis, MeshHex
from vees_and_sleeves import SEAT, long_sleeve, two_rings

from fesim.case.schema import read_case
from fesim.march.heat_step import heat_step
from fesim.simulate import simulate
from fesim.solid.heat import convection_form, convection_matrix
from fesim.solid.spaces import make_spaces
from meshes.covered import cover_of, covered_areas
from meshes.exchange import write_structure
from meshes.pairing import pair_joint
from thermojoint.cli.app import app

#: A bar against the middle of a plate: of its side b a third is covered, facets in part.
BROAD = 3 * WIDTH


def on_a_plate(left=(2, 4, 2), right=(2, 7, 3), tetrahedra=False):
    return two_bars(left, right, tetrahedra, right_width=BROAD)


def film(structure, surface, grid=(3, 2)):
    joints = [pair_joint(structure, name, *grid) for name in structure.joints]
    basis = make_spaces(structure.mesh).heat
    return convection_matrix(structure, basis, surface, joints), covered_areas(
        structure, [surface], joints
    )


def least_and_largest(matrix):
    """Eigenvalues of the part of a film matrix that is not empty."""
    own = np.unique(matrix.tocoo().row)
    values = np.linalg.eigvalsh(matrix.tocsr()[own][:, own].toarray())
    return values[0], values[-1]


@pytest.mark.parametrize("tetrahedra", [False, True])
def test_a_side_that_is_covered_wholly_has_no_film(tetrahedra):
    matrix, covered = film(two_bars(tetrahedra=tetrahedra), "joint.a")
    assert matrix.nnz == 0
    assert covered == {"joint.a": pytest.approx(AREA)}


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    left=st.tuples(*[st.integers(1, 4)] * 3),
    right=st.tuples(*[st.integers(1, 5)] * 3),
    tetrahedra=st.booleans(),
)
def test_the_film_on_a_side_that_is_covered_in_part_is_exact(left, right, tetrahedra):
    """Integrals of 1, y, z and y z over what is left: the side less the bar's section."""
    structure = on_a_plate(left, right, tetrahedra)
    matrix, covered = film(structure, "joint.b")
    _, y, z = make_spaces(structure.mesh).heat.doflocs
    first = (BROAD**2 - WIDTH**2) / 2.0
    assert covered["joint.b"] == pytest.approx(AREA, rel=1e-9)
    assert matrix.sum() == pytest.approx((BROAD - WIDTH) * DEPTH, rel=1e-9)
    assert y @ matrix @ np.ones_like(y) == pytest.approx(first * DEPTH, rel=1e-9)
    assert y @ matrix @ z == pytest.approx(first * DEPTH**2 / 2.0, rel=1e-9)
    low, high = least_and_largest(matrix)
    assert low >= -1e-12 * high


def test_a_covered_surface_convects_as_one_that_was_split_by_hand():
    """The plate's facets end where the bar ends: the rest of them is a surface of its own."""
    structure = on_a_plate((2, 3, 2), (2, 9, 2))
    side = structure.surfaces["joint.b"]
    y = structure.mesh.p[1, structure.mesh.facets[:, side]].mean(axis=0)
    split = replace(structure, surfaces=structure.surfaces | {"rest": side[y > WIDTH]})
    listed = conduct(split, convection={"joint.b": 50.0, "top": 20.0}, sources={"left_end": 1.0})
    by_hand = conduct(split, convection={"rest": 50.0, "top": 20.0}, sources={"left_end": 1.0})
    for ours, theirs in (
        (listed.heat.convection.toarray(), by_hand.heat.convection.toarray()),
        (listed.heat.inputs, by_hand.heat.inputs),
    ):
        assert ours == pytest.approx(theirs, abs=1e-12 * np.abs(theirs).max())


def test_heat_goes_through_a_listed_joint_as_through_a_wall():
    """1/U = L1/k + 1/h_c + L2/k + 1/h: no heat is lost on the way."""
    films = {"joint.a": 400.0, "joint.b": 400.0, "right_end": 500.0}
    made = conduct(two_bars(), convection=films, sources={"left_end": 1.0}, step=1e10)
    conductance, power = 4000.0, 20.0
    after, flow = heat_step(
        made.thermal,
        np.zeros(made.spaces.heat.N),
        np.array([power, 0.0]),
        conductance * made.operators.area,
    )
    hot = (power / AREA) * ((LEFT + RIGHT) / IRON.conductivity + 1.0 / conductance + 1.0 / 500.0)
    assert flow.sum() == pytest.approx(power, rel=1e-6)
    x = made.spaces.heat.doflocs[0]
    assert after[x < 1e-9] == pytest.approx(hot, rel=1e-6)


@pytest.mark.parametrize("second_order", [False, True])
def test_a_curved_side_is_covered_as_far_as_the_other_reaches(second_order):
    """Both sides of a seat are covered but for what facets of other size leave of a circle."""
    structure = two_rings((2, 12, 1), (2, 18, 2), second_order)
    area = 0.5 * np.pi * SEAT * 0.02
    for side in ("joint.a", "joint.b"):
        matrix, covered = film(structure, side, (6, 1))
        assert covered[side] == pytest.approx(area, rel=5e-3)
        assert 0.0 <= matrix.sum() < 5e-3 * area


def test_half_a_seat_convects_on_its_other_half():
    """The bore is twice as long as the shaft; facets of the two do not match."""
    long, short = (long_sleeve(length, (24, 5), (30, 4)) for length in (0.2, 0.1))
    assert long.bodies.keys() == short.bodies.keys()
    points = long.mesh.p.copy()
    inner = np.unique(long.mesh.t[:, long.mesh.f2t[0, long.surfaces["joint.a"]]])
    points[2, inner] *= 0.53
    half = replace(long, mesh=MeshHex(points, long.mesh.t))
    matrix, covered = film(half, "joint.b", (12, 1))
    whole = 30 * 2.0 * SEAT * np.sin(np.pi / 30) * 0.2
    assert covered["joint.b"] == pytest.approx(0.53 * whole, rel=1e-2)
    assert matrix.sum() + covered["joint.b"] == pytest.approx(whole, rel=1e-9)
    low, high = least_and_largest(matrix)
    assert low >= -1e-6 * high


def test_a_skewed_facet_keeps_a_film_that_cools():
    """On facets that are no parallelograms the two integrals differ by their rules alone."""
    structure = on_a_plate((2, 3, 2), (2, 5, 3))
    points = structure.mesh.p.copy()
    rng = np.random.default_rng(5)
    _, y, z = points
    right = np.isin(np.arange(points.shape[1]), structure.mesh.t[:, structure.bodies["right"]])
    inside = right & (y > 1e-9) & (y < BROAD - 1e-9) & (z > 1e-9) & (z < DEPTH - 1e-9)
    points[1:, inside] += rng.uniform(-0.25, 0.25, (2, int(inside.sum()))) * [
        [BROAD / 5],
        [DEPTH / 3],
    ]
    skewed = replace(structure, mesh=MeshHex(points, structure.mesh.t), probes={})
    matrix, _ = film(skewed, "joint.b")
    assert matrix.sum() == pytest.approx((BROAD - WIDTH) * DEPTH, rel=1e-9)
    low, high = least_and_largest(matrix)
    assert low >= -1e-9 * high


def test_what_no_joint_covers_keeps_its_film_to_the_bit():
    structure = two_bars(tetrahedra=True)
    basis = CellBasis(structure.mesh, ElementTetP1(), intorder=2)
    joints = [pair_joint(structure, "joint", 2, 2)]
    facets = structure.surfaces["top"]
    plain = convection_form.assemble(
        FacetBasis(structure.mesh, basis.elem, facets=facets, intorder=2)
    )
    np.testing.assert_array_equal(
        convection_matrix(structure, basis, "top", joints).toarray(), plain.toarray()
    )
    assert not cover_of(structure, "top", joints).share.any()
    assert covered_areas(structure, ["top"], joints) == {}


# --- three bodies --------------------------------------------------------------------------------

THREE = boxes(
    {"first": ("left.x1", "middle.x0"), "second": ("middle.x1", "right.x0")},
    left=((0.0, 0.0, 0.0), (0.1, 0.04, 0.04), (2, 1, 1)),
    middle=((0.1, 0.0, 0.0), (0.3, 0.04, 0.04), (2, 2, 1)),
    right=((0.3, 0.0, 0.0), (0.4, 0.04, 0.04), (2, 1, 3)),
)
CONDUCTIVITY, FILM, EXPANSION, WATTS = 50.0, 300.0, 1.1e-5, 24.0
ROLLERS = ", ".join(
    f'"{body}.{axis}0" = "{axis}"' for body in ("left", "middle", "right") for axis in "yz"
)
LISTED = ("left.x1", "middle.x0", "middle.x1", "right.x0")
JOINT = (
    "{ preload_MPa = 4.0, along = 1, across = 1, roughness_um = 1.25, asperity_slope = 0.14, "
    "hardness_GPa = 1.961, friction_coefficient = 0.6 }"
)
CASE = f"""
title = "Three rods in line"
bodies = {{ left = "iron", middle = "iron", right = "iron" }}
supports = {{ symmetry = {{ "left.x0" = "x", {ROLLERS} }} }}
march = {{ step_s = 1000.0, duration_min = 4000.0, thermal = "full" }}
displacement = {{ point = "P" }}
probes = {{ P = {{ position_mm = [400.0, 0.0, 0.0] }} }}
heat_input = {{ kind = "step", level = 1.0 }}
[structure]
kind = "mesh"
file = "three.vtu"
[materials.iron]
conductivity_W_mK = {CONDUCTIVITY}
density_kg_m3 = 7200.0
heat_capacity_J_kgK = 500.0
youngs_modulus_GPa = 110.0
poisson_ratio = 0.25
expansion_1_K = {EXPANSION}
[joints]
first = {JOINT}
second = {JOINT}
[sources.heat]
surface = "left.x0"
reference_power_W = {WATTS}
reading = "total"
[convection_W_m2K]
{"".join(f'"{name}" = {FILM}{chr(10)}' for name in (*LISTED, "right.x1"))}
"""


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """A folder with the case and its mesh."""
    folder = tmp_path_factory.mktemp("three")
    write_structure(THREE, folder / "three.vtu")
    (folder / "three.toml").write_text(CASE)
    return folder


def test_three_rods_whose_ends_are_listed_grow_as_the_closed_form_says(three):
    """The joints stay at their preload, nothing is lost in them: T falls linearly in each rod.

    Its sections bulge by alpha T' (y^2 + z^2) / 2, on which the joints see the mean.
    """
    response = simulate(read_case(three / "three.toml")).response
    flux = WATTS / 0.04**2
    jump = flux / float(response["conductance"][-1, 0])
    end = flux / FILM
    centres = [0.35, 0.2, 0.05]
    mean = [end + flux * (0.4 - x) / CONDUCTIVITY + jumps * jump for jumps, x in enumerate(centres)]
    grown = EXPANSION * float(np.dot(mean, [0.1, 0.2, 0.1]))
    bulge = EXPANSION * flux / CONDUCTIVITY * 0.04**2 / 3.0
    found = float(response["displacement"][-1].sel(axis="x"))
    assert found == pytest.approx(grown - bulge, rel=1e-5)
    assert response["heat_flow"][-1].to_numpy() == pytest.approx(WATTS, rel=1e-6)
    assert json.loads(response.attrs["covered_area_m2"]) == pytest.approx(
        dict.fromkeys(LISTED, 0.04**2)
    )


def test_simulate_says_what_it_took_out(three, capsys):
    short = three / "short.toml"
    short.write_text(CASE.replace("4000.0", "40.0"))
    app(["simulate", str(short), "--out", str(three / "short.nc")], standalone_mode=False)
    said = capsys.readouterr().err
    assert "joints cover 16 cm2 of 'left.x1', 16 cm2 of 'middle.x0'" in said
