"""Plane geometry of a joint: clipping, quadrature, and the pairing of sides that do not match."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from bars import AREA, DEPTH, IRON, LEFT, WIDTH, conduct, shifted, two_bars
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from skfem import MeshHex
from vees_and_sleeves import HEIGHT, INNER, OUTER, SEAT, long_sleeve, two_rings, vee

from fesim.march.heat_step import heat_step
from fesim.solid.joint_operators import joint_operators
from fesim.solid.spaces import interpolation, local_coordinates, make_spaces
from meshes.box_grid import put_side_by_side
from meshes.exchange import read_structure
from meshes.milling_machine import box_milling_machine
from meshes.pairing import movable_joint, pair_joint
from meshes.polygons import anticlockwise, clip, quadrature, signed_area
from meshes.structure import Structure
from meshes.three_axes import three_axis_machine
from thermojoint.artefacts.errors import InputError

FLANGE = Path(__file__).parents[2] / "examples" / "bolted_flange" / "flange.msh"


@st.composite
def polygons(draw):
    """Convex polygons of three to eight corners, each on an ellipse near the origin."""
    count = draw(st.integers(3, 8))
    gaps = np.array([draw(st.floats(0.2, 1.0)) for _ in range(count)])
    angles = 2 * np.pi * np.cumsum(gaps) / gaps.sum()
    width, height, x, y = (draw(st.floats(*ends)) for ends in [(0.2, 2)] * 2 + [(-1, 1)] * 2)
    return np.stack([x + width * np.cos(angles), y + height * np.sin(angles)], axis=1)


def overlap(first, second):
    both = clip(first, second)
    return signed_area(both) if len(both) else 0.0


@given(polygons(), polygons())
def test_clipping_is_symmetric_and_never_grows(first, second):
    area = overlap(first, second)
    assert area == pytest.approx(overlap(second, first), abs=1e-12)
    assert -1e-12 <= area <= min(signed_area(first), signed_area(second)) + 1e-12


@given(polygons(), st.floats(0.0, 2 * np.pi), st.floats(-0.5, 0.5))
def test_two_halves_make_the_whole(polygon, angle, offset):
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    foot = polygon.mean(axis=0) + offset * across
    half = np.array([foot - 9 * along, foot + 9 * along])
    above = np.array([*half, *(half[::-1] + 9 * across)])
    below = np.array([*half[::-1], *(half - 9 * across)])
    assert overlap(polygon, above) + overlap(polygon, below) == pytest.approx(
        signed_area(polygon), rel=1e-12, abs=0.0
    )


@given(polygons())
def test_clipping_with_itself_and_with_a_stranger(polygon):
    assert overlap(polygon, polygon) == pytest.approx(signed_area(polygon), rel=1e-12, abs=0.0)
    assert overlap(polygon, polygon + 7.0) == pytest.approx(0.0, abs=1e-12)


@given(polygons())
def test_orientation_does_not_change_the_polygon(polygon):
    assert np.array_equal(anticlockwise(polygon), polygon)
    assert signed_area(polygon[::-1]) == pytest.approx(-signed_area(polygon))
    assert signed_area(anticlockwise(polygon[::-1])) > 0.0


def moment(polygon, i, j):
    """Integral of x^i y^j over a polygon, by Green's theorem with a rule of degree seven."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    start, end = polygon, np.roll(polygon, -1, axis=0)
    t = (1 + nodes[:, None]) / 2
    x = start[:, 0] + t * (end - start)[:, 0]
    y = start[:, 1] + t * (end - start)[:, 1]
    slope = (end - start)[:, 1]
    return float((weights[:, None] / 2 * x ** (i + 1) * y**j * slope).sum() / (i + 1))


@given(polygons())
def test_quadrature_is_exact_to_degree_four(polygon):
    (x, y), weights = quadrature(polygon)[0].T, quadrature(polygon)[1]
    assert (weights > 0.0).all()
    assert weights.sum() == pytest.approx(signed_area(polygon), rel=1e-12, abs=0.0)
    for i in range(5):
        for j in range(5 - i):
            assert weights @ (x**i * y**j) == pytest.approx(moment(polygon, i, j), abs=1e-11)


DIVISIONS = st.tuples(st.integers(1, 2), st.integers(1, 5), st.integers(1, 5))


@settings(max_examples=25, deadline=None)
@given(DIVISIONS, DIVISIONS, st.booleans(), st.integers(1, 7), st.integers(1, 3))
def test_sides_that_do_not_match_are_integrated_exactly(left, right, tetrahedra, along, across):
    structure = two_bars(left, right, tetrahedra)
    joint = pair_joint(structure, "joint", along, across)
    assert joint.weights.sum() == pytest.approx(AREA, rel=1e-12, abs=0.0)
    # Equal contact elements: the grid, not the facets, divides the joint.
    equal = np.full(along * across, AREA / (along * across))
    assert joint.area == pytest.approx(equal, rel=1e-9, abs=0.0)

    basis = make_spaces(structure.mesh).heat
    slopes, constant = np.array([3.0, -5.0, 7.0]), 11.0
    field = slopes @ structure.mesh.p + constant
    share = joint.weights / joint.area[joint.element]
    for points, cells in ((joint.points_a, joint.cells_a), (joint.points_b, joint.cells_b)):
        means = interpolation(basis, points, cells, joint.element, share, len(joint.area))
        assert means @ field == pytest.approx(joint.centre @ slopes + constant, rel=1e-11)
        local = local_coordinates(structure.mesh, points, cells)
        inside = np.maximum(-local, local - 1.0).max()
        assert inside < 1e-9
        if tetrahedra:
            assert (local.sum(axis=0) < 1.0 + 1e-9).all()
    assert np.isin(joint.cells_a, structure.bodies["left"]).all()
    assert np.isin(joint.cells_b, structure.bodies["right"]).all()


@settings(max_examples=15, deadline=None)
@given(st.floats(0.02, 50.0), st.booleans())
def test_by_default_a_joint_resists_rocking_about_either_axis_whatever_its_shape(ratio, tetrahedra):
    structure = two_bars(tetrahedra=tetrahedra)
    mesh, scale = structure.mesh, np.array([1.0, ratio, 1.0])
    stretched = type(mesh)(mesh.p * scale[:, None], mesh.t)
    joint = pair_joint(replace(structure, mesh=stretched, probes={}), "joint")
    arms = joint.centre - joint.area @ joint.centre / joint.area.sum()
    resistance = joint.area @ arms[:, 1:] ** 2
    sides = np.ptp(stretched.p[1:, :], axis=1)
    whole = joint.area.sum() * sides**2 / 12.0
    assert (resistance > 0.95 * whole).all()
    assert len(joint.area) <= 75


@settings(max_examples=20, deadline=None)
@given(
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    st.tuples(*[st.floats(-2.0, 2.0)] * 3),
    st.floats(0.0, 0.01),
)
def test_a_joint_may_stand_anywhere_and_have_a_gap(turn, shift, gap):
    bars = two_bars((2, 3, 2), (2, 4, 3))
    rotation = Rotation.from_rotvec(turn)
    points = bars.mesh.p.copy()
    points[0, np.unique(bars.mesh.t[:, bars.bodies["right"]])] += gap
    moved = type(bars.mesh)(rotation.apply(points.T).T + np.array(shift)[:, None], bars.mesh.t)
    joint = pair_joint(replace(bars, mesh=moved, probes={}), "joint", 3, 2)
    normal = rotation.apply([1.0, 0.0, 0.0])
    assert joint.normal == pytest.approx(np.tile(normal, (6, 1)), abs=1e-9)
    assert joint.area == pytest.approx(np.full(6, AREA / 6), rel=1e-6)
    apart = joint.points_b - joint.points_a
    assert apart == pytest.approx(np.outer(normal, np.full(apart.shape[1], gap)), abs=1e-12)
    frame = np.vstack([joint.normal[0], joint.tangents[0]])
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-9)


def test_contact_elements_are_counted_along_the_strip_from_bottom_to_top():
    half = pair_joint(box_milling_machine(element_size=0.1), "knee", 9, 1)
    assert half.tangents[:, 0] == pytest.approx(np.tile([0.0, 1.0, 0.0], (9, 1)), abs=1e-12)
    assert half.centre[:, 1] == pytest.approx(0.35 + 0.4 * (np.arange(9) + 0.5) / 9)
    whole = pair_joint(box_milling_machine(element_size=0.1, half=False), "knee", 9, 2)
    assert whole.area == pytest.approx(np.full(36, 0.4 * 0.075 / 18))
    first, second = whole.centre[:18], whole.centre[18:]
    for strip in (first, second):
        assert strip[:9, 1] == pytest.approx(half.centre[:, 1])
        assert np.ptp(strip[:9, 2]) < 1e-12
    assert (first[:, 2] < 0.25).all() != (second[:, 2] < 0.25).all()


def test_pieces_cover_the_contact_elements():
    joint = pair_joint(two_bars((2, 3, 2), (2, 4, 3)), "joint", 4, 2)
    areas = [
        0.5 * np.linalg.norm(np.cross(piece, np.roll(piece, -1, axis=0)).sum(axis=0))
        for piece in joint.pieces
    ]
    assert np.bincount(joint.piece_element, areas) == pytest.approx(joint.area)
    corners = np.concatenate(joint.pieces)
    assert corners.min(axis=0) == pytest.approx([LEFT, 0.0, 0.0], abs=1e-12)
    assert corners.max(axis=0) == pytest.approx([LEFT, WIDTH, DEPTH])


def test_only_the_overlap_of_the_sides_is_joint():
    bars = shifted(two_bars((2, 2, 2), (2, 2, 2)), ["right"], (0.0, WIDTH / 4, 0.0))
    joint = pair_joint(bars, "joint", 4, 1)
    assert joint.area == pytest.approx(np.full(4, 0.75 * AREA / 4))


def on_its_bed():
    """The machine with three axes and the joint below its column, which moves along x."""
    joints = {"foot": ("column_foot", "bed_top")}
    return replace(three_axis_machine(0.1), joints=joints, probes={})


def test_the_long_side_of_a_square_is_the_same_wherever_it_lies():
    machine = on_its_bed()
    for way in np.linspace(-0.3, 0.3, 13):
        there = shifted(machine, ["column", "ram"], np.array([way, 0.0, 0.0]))
        along = pair_joint(there, "foot", 2, 2).tangents[:, 0]
        assert np.allclose(np.abs(along), [0.0, 0.0, 1.0])


@pytest.mark.parametrize("joint", ["head", "nut"])
def test_where_a_machine_stands_does_not_turn_the_grid_of_a_round_joint(joint):
    flange = read_structure(FLANGE)
    along = pair_joint(flange, joint, 3, 3).tangents[:, 0]
    for place in np.random.default_rng(1).uniform(-2.0, 2.0, (10, 3)):
        moved = shifted(flange, list(flange.bodies), place)
        assert np.allclose(pair_joint(moved, joint, 3, 3).tangents[:, 0], along, atol=1e-6)


@pytest.mark.parametrize("way", [-0.3, -0.07, 0.0, 0.22])
def test_a_joint_that_slides_covers_what_it_covers_where_its_pads_are_meshed(way):
    machine, shift = on_its_bed(), np.array([way, 0.0, 0.0])
    movable = movable_joint(machine, pair_joint(machine, "foot", 3, 2), 3, 2)
    there = pair_joint(shifted(machine, ["column", "ram"], shift), "foot", 3, 2)
    for e in range(len(there.area)):
        own, covered = there.element == e, movable.covered(e, shift)
        assert np.array_equal(covered.facets, there.facets_b[own])
        assert np.abs(covered.points - there.points_b[:, own]).max() < 1e-12
        assert covered.weights == pytest.approx(there.weights[own], rel=1e-9)
        assert covered.centre == pytest.approx(there.centre[e], abs=1e-12)


def test_a_joint_that_slides_off_covers_nothing():
    machine = on_its_bed()
    movable = movable_joint(machine, pair_joint(machine, "foot", 3, 2), 3, 2)
    assert movable.covered(0, np.array([5.0, 0.0, 0.0])) is None


def test_the_grid_spans_what_the_sides_share_whichever_is_longer():
    wide = two_bars((2, 4, 2), (2, 7, 3), right_width=10 * WIDTH)
    turned = replace(wide, joints={"joint": ("joint.b", "joint.a")})
    for structure in (wide, turned):
        joint = pair_joint(structure, "joint", 4, 3)
        assert joint.area == pytest.approx(np.full(12, AREA / 12))
        assert np.ptp(joint.centre[:, 1]) == pytest.approx(0.75 * WIDTH)


def test_an_edge_that_two_meshes_round_differently_does_not_move_the_grid():
    bars = shifted(two_bars((2, 2, 2), (2, 2, 2)), ["right"], (0.0, 0.01 * WIDTH, 0.0))
    joint = pair_joint(bars, "joint", 4, 1)
    assert joint.area[1:] == pytest.approx(np.full(3, AREA / 4))
    assert joint.area[0] == pytest.approx(AREA / 4 - 0.01 * AREA)


def test_sides_that_do_not_face_each_other_are_refused():
    apart = shifted(two_bars((1, 1, 1), (1, 1, 1)), ["right"], (0.0, 2 * WIDTH, 0.0))
    with pytest.raises(InputError, match="'joint': its sides do not face each other"):
        pair_joint(apart, "joint", 3, 1)


def test_layers_of_plates_in_one_joint_are_refused():
    """The lower plate of side a lies under both plates of side b: it would conduct twice."""
    layers = [0.0, 0.01, 0.02, 0.03, 0.04]
    mesh, cells = put_side_by_side(
        [
            MeshHex.init_tensor(np.linspace(0, 0.1, 3), np.linspace(0, 0.1, 3), np.array(ends))
            for ends in pairwise(layers)
        ]
    )
    facets = mesh.boundary_facets()
    height = mesh.p[2, mesh.facets[:, facets]]
    on = {
        (body, level): facets[np.isin(mesh.f2t[0, facets], cells[body]) & (height == level).all(0)]
        for body, ends in enumerate(pairwise(layers))
        for level in ends
    }
    joints = {
        "lower": (on[0, 0.01], on[1, 0.01]),
        "upper": (on[2, 0.03], on[3, 0.03]),
        "both": (np.hstack([on[0, 0.01], on[2, 0.03]]), np.hstack([on[1, 0.01], on[3, 0.03]])),
    }
    structure = Structure(
        mesh,
        bodies={"all": np.arange(mesh.nelements)},
        surfaces={
            f"{n}.{s}": f for n, pair in joints.items() for s, f in zip("ab", pair, strict=True)
        },
        joints={name: (f"{name}.a", f"{name}.b") for name in joints},
    )
    for name in ("lower", "upper"):
        assert pair_joint(structure, name, 2, 2).area.sum() == pytest.approx(0.01)
    with pytest.raises(InputError, match="'both': several layers of side b"):
        pair_joint(structure, "both", 2, 2)


def test_each_flank_of_a_vee_has_its_own_normal_and_grid():
    angle = np.deg2rad(40.0)
    joint = pair_joint(vee(angle, (4, 4, 2), (2, 6, 3)), "joint", 3, 2)
    assert joint.area == pytest.approx(np.full(12, AREA / np.cos(angle) / 12), rel=1e-9, abs=0.0)
    flank = np.sign(joint.centre[:, 1] - WIDTH / 2)
    expected = np.stack([np.full(12, np.cos(angle)), -np.sin(angle) * flank, np.zeros(12)], axis=1)
    assert joint.normal == pytest.approx(expected, abs=1e-9)
    assert joint.points_a == pytest.approx(joint.points_b, abs=1e-12)
    for normal, tangents in zip(joint.normal, joint.tangents, strict=True):
        frame = np.vstack([normal, tangents])
        assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-9)


def test_a_vee_presses_as_its_flanks_divide_the_load():
    """A uniform axial stress on the vee: its normal part presses, its tangential part shears."""
    angle, stress = np.deg2rad(40.0), 2.0e6
    structure = vee(angle, (4, 4, 2), (2, 6, 3))
    spaces = make_spaces(structure.mesh)
    joint = pair_joint(structure, "joint", 3, 2)
    forces = joint_operators([joint], spaces)
    # Tractions of sigma_xx on each flank, by their definition t = sigma n.
    traction = -stress * joint.normal[:, 0, None] * np.array([1.0, 0.0, 0.0])
    parts = np.concatenate(
        [
            np.einsum("mi,mi->m", traction, direction)
            for direction in (joint.normal, joint.tangents[:, 0], joint.tangents[:, 1])
        ]
    )
    load = (forces.gap.T @ (np.tile(joint.area, 3) * parts)).reshape(-1, 3)
    right = np.unique(spaces.elastic.element_dofs[:, structure.bodies["right"]])
    assert load[right].sum(axis=0) == pytest.approx([-stress * AREA, 0.0, 0.0], abs=1e-6)
    assert load.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-6)


@pytest.mark.parametrize("second_order", [False, True])
def test_a_sleeve_conducts_into_its_bore_by_the_logarithm(second_order):
    """Curved joint, meshes that do not match: better by the second order of the element size."""
    conductance = 3000.0
    angle = 0.5 * np.pi
    resistance = np.log(OUTER / INNER) / (IRON.conductivity * angle * HEIGHT) + 1.0 / (
        conductance * angle * SEAT * HEIGHT
    )
    errors = []
    for n in (1, 2):
        structure = two_rings((2 * n, 5 * n, 1), (3 * n, 7 * n, 2), second_order)
        made = conduct(structure, held=["bore", "rim"], grid=(5, 1), step=1e15)
        assert len(made.operators.area) == 5
        joint = conductance * made.operators.area
        start = np.zeros(made.spaces.heat.N)
        _, flow = heat_step(made.thermal, start, np.array([0.0, 10.0, 0.0]), joint)
        errors.append(abs(flow.sum() * resistance / 10.0 - 1.0))
    assert errors[0] < 0.03
    assert errors[1] < 0.35 * errors[0]


def test_normals_of_a_curved_joint_point_from_the_sleeve_into_the_bore():
    joint = pair_joint(two_rings((2, 12, 1), (2, 18, 1), second_order=False), "joint", 6, 1)
    radial = joint.centre[:, :2] / np.hypot(*joint.centre[:, :2].T)[:, None]
    assert np.einsum("mi,mi->m", joint.normal[:, :2], radial) == pytest.approx(np.ones(6), abs=1e-6)
    assert joint.area.sum() == pytest.approx(0.5 * np.pi * SEAT * HEIGHT, rel=2e-3)
    assert joint.area == pytest.approx(np.full(6, joint.area.mean()), rel=1e-6)
    turn = np.sort(np.arctan2(joint.centre[:, 1], joint.centre[:, 0]))
    assert turn == pytest.approx((np.arange(6) + 0.5) * np.pi / 12, abs=1e-6)


@pytest.mark.parametrize("length", [0.4 * SEAT, 2.0 * SEAT, 8.0 * SEAT])
@pytest.mark.parametrize("count", [4, 9, 27])
def test_a_seat_all_around_a_shaft_keeps_its_area_however_long(length, count):
    joint = pair_joint(long_sleeve(length, (24, 20), (30, 16)), "joint", count, 1)
    facet = 2.0 * SEAT * np.sin(np.pi / 24)
    assert joint.area.sum() == pytest.approx(24 * facet * length, rel=1e-9)
    assert len(joint.area) == count
    assert joint.area.max() < 1.25 * joint.area.min()
    radial = joint.centre[:, :2] / np.hypot(*joint.centre[:, :2].T)[:, None]
    assert np.einsum("mi,mi->m", joint.normal[:, :2], radial).min() > 0.95


@pytest.mark.parametrize("count", [1, 2])
def test_a_contact_element_around_half_a_shaft_is_refused(count):
    sleeve = long_sleeve(8.0 * SEAT, (24, 20), (30, 16))
    with pytest.raises(InputError, match="turns through more than 120 degrees; raise along"):
        pair_joint(sleeve, "joint", count, 1)
