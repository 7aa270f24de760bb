"""The reference machine against its closed forms: volumes, areas, symmetry, every dimension."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skfem import CellBasis, ElementHex0, Functional

from meshes.milling_machine import MillingMachineDimensions, box_milling_machine
from meshes.pairing import outward_areas
from thermojoint.artefacts.errors import InputError

REFERENCE = MillingMachineDimensions()
#: Of the machine that stands: the ends of longer strips and of a nut have tests of their own.
KNEE = {"strip_bottom", "strip_top", "screw_bottom"}
NAMES = [field.name for field in fields(MillingMachineDimensions) if field.name not in KNEE]


def volumes(structure):
    """Volume of each body, m3."""
    mesh = structure.mesh
    one = Functional(lambda w: np.ones_like(w.x[0]))
    cells = one.elemental(CellBasis(mesh, ElementHex0(), intorder=2))
    return {name: cells[chosen].sum() for name, chosen in structure.bodies.items()}


def areas(structure):
    """Area of each surface, m2."""
    return {
        name: np.linalg.norm(outward_areas(structure.mesh, facets), axis=1).sum()
        for name, facets in structure.surfaces.items()
    }


def exact_volumes(d):
    """Volumes of the whole machine, m3: boxes less their cavities."""
    across = d.width - 2 * d.wall
    column = d.column_depth * d.column_height * d.width
    hollow = d.column_height - 2 * d.wall - (d.bracket_top - d.bracket_bottom)
    column -= (d.column_depth - 2 * d.wall) * hollow * across
    height = d.table_top - d.table_bottom
    strips = 2 * d.strip_depth * height * d.strip_width
    table = d.table_length * height * d.width
    table -= (d.table_length - 2 * d.wall) * (height - 2 * d.wall) * across
    screw = d.screw_depth * d.table_bottom * d.screw_width
    return {"column": column + strips, "table": table, "screw": screw}


def exact_areas(d):
    """Areas of the whole machine, m2."""
    height = d.table_top - d.table_bottom
    joint = 2 * height * d.strip_width
    foot = d.screw_depth * d.screw_width
    base = d.column_depth * d.width
    column = 2 * d.column_height * (d.column_depth + d.width) + base
    table = 2 * (d.table_length * (height + d.width) + height * d.width)
    across, deep = d.width - 2 * d.wall, d.column_depth - 2 * d.wall
    cavities = [
        (deep, d.bracket_bottom - d.wall, across),
        (deep, d.column_height - d.wall - d.bracket_top, across),
        (d.table_length - 2 * d.wall, height - 2 * d.wall, across),
    ]
    # A strip covers as much of the column as its end shows; its end and what it touches are joint.
    strips = 2 * 2 * d.strip_depth * (height + d.strip_width) - joint
    screw = 2 * d.table_bottom * (d.screw_depth + d.screw_width) - foot
    return {
        "exterior": column + strips + table - joint + screw,
        "interior": sum(2 * (x * y + y * z + z * x) for x, y, z in cavities),
        "column_base": base,
        "screw_foot": foot,
        "bearings": 2 * d.source_height * d.source_width,
        "rear": d.column_height * d.width,
        "knee.a": joint,
        "knee.b": joint,
    }


def cut_area(d):
    """Area of the symmetry plane's cut, m2."""
    frame = d.column_depth * d.column_height - (d.column_depth - 2 * d.wall) * (
        d.column_height - 2 * d.wall - (d.bracket_top - d.bracket_bottom)
    )
    height = d.table_top - d.table_bottom
    box = d.table_length * height - (d.table_length - 2 * d.wall) * (height - 2 * d.wall)
    return frame + box + d.screw_depth * d.table_bottom


def agrees(structure, d, share):
    assert volumes(structure) == pytest.approx(
        {name: share * value for name, value in exact_volumes(d).items()}, rel=1e-7
    )
    found = areas(structure)
    if share < 1.0:
        assert found.pop("symmetry") == pytest.approx(cut_area(d), rel=1e-7)
    exact = {name: share * value for name, value in exact_areas(d).items()}
    assert found == pytest.approx(exact, rel=1e-7)


@pytest.mark.parametrize("half", [True, False])
def test_volumes_and_areas_are_the_closed_forms(half):
    structure = box_milling_machine(element_size=0.1, half=half)
    agrees(structure, REFERENCE, 0.5 if half else 1.0)
    assert structure.symmetry_factor == (2 if half else 1)


@pytest.mark.parametrize("name", NAMES)
def test_every_dimension_is_a_parameter(name):
    # The source may reach neither into the side wall nor into the bracket, where the reference has
    # it end.
    factor = 1.04 if name in ("source_inset", "bracket_bottom") else 0.96
    changed = replace(REFERENCE, **{name: factor * getattr(REFERENCE, name)})
    structure = box_milling_machine(changed, element_size=0.2)
    agrees(structure, changed, 0.5)
    original = box_milling_machine(element_size=0.2)
    assert structure.mesh.p.shape != original.mesh.p.shape or not np.allclose(
        structure.mesh.p, original.mesh.p
    )


@settings(max_examples=15, deadline=None)
@given(
    size=st.floats(0.06, 0.3),
    joint_size=st.none() | st.floats(0.03, 0.1),
    scales=st.fixed_dictionaries({name: st.floats(0.97, 1.0) for name in NAMES}).map(
        lambda scales: (
            scales
            | {
                "source_inset": 2.0 - scales["source_inset"],
                "source_top": 0.99 * scales["bracket_bottom"],
            }
        )
    ),
)
def test_volumes_and_areas_hold_for_all_sizes(size, joint_size, scales):
    d = MillingMachineDimensions(**{n: s * getattr(REFERENCE, n) for n, s in scales.items()})
    structure = box_milling_machine(d, element_size=size, joint_element_size=joint_size)
    agrees(structure, d, 0.5)
    edges = np.ptp(structure.mesh.p[:, structure.mesh.t], axis=1)
    assert edges.max() <= size * (1 + 1e-6)


def test_boundaries_are_closed_and_named_once():
    structure = box_milling_machine(element_size=0.1)
    facets = structure.mesh.boundary_facets()
    assert np.allclose(outward_areas(structure.mesh, facets).sum(axis=0), 0.0, atol=1e-12)
    parts_of = {"bearings": "interior", "rear": "exterior"}
    parts = [at for name, at in structure.surfaces.items() if name not in parts_of]
    assert np.array_equal(np.sort(np.concatenate(parts)), facets)
    for part, whole in parts_of.items():
        assert np.isin(structure.surfaces[part], structure.surfaces[whole]).all()


def test_the_whole_machine_is_its_own_mirror_image():
    mesh = box_milling_machine(element_size=0.1, half=False).mesh
    mirrored = mesh.p * np.array([[1], [1], [-1]]) + np.array([[0], [0], [REFERENCE.width]])

    def ordered(points):
        return points[:, np.lexsort(np.round(points, 9))]

    assert np.allclose(ordered(mesh.p), ordered(mirrored), atol=1e-12)


def test_the_sides_of_the_joint_face_each_other():
    structure = box_milling_machine(element_size=0.1)
    for side, direction in (("knee.a", 1.0), ("knee.b", -1.0)):
        vectors = outward_areas(structure.mesh, structure.surfaces[side])
        assert np.allclose(vectors[:, 0], direction * np.linalg.norm(vectors, axis=1))
    column, table = (
        np.unique(structure.mesh.t[:, structure.bodies[name]]) for name in ("column", "table")
    )
    assert np.intersect1d(column, table).size == 0


def test_points_a_and_b_are_nodes():
    structure = box_milling_machine(element_size=0.13)
    for name in ("A", "B"):
        probe = structure.probes[name]
        nodes = structure.mesh.p[:, np.unique(structure.mesh.t[:, structure.bodies[probe.body]])]
        gap = np.linalg.norm(nodes - np.array(probe.position)[:, None], axis=0)
        assert gap.min() < 1e-12


def test_a_knee_has_longer_strips_and_a_nut():
    d = replace(REFERENCE, strip_bottom=0.15, strip_top=1.05, screw_bottom=0.25)
    structure = box_milling_machine(d, element_size=0.1)
    found, usual = areas(structure), exact_areas(REFERENCE)
    longer = 0.9 / (d.table_top - d.table_bottom)
    assert found["knee.a"] == pytest.approx(0.5 * longer * usual["knee.a"], rel=1e-7)
    assert found["knee.b"] == pytest.approx(0.5 * usual["knee.b"], rel=1e-7)
    assert found["screw_foot"] == pytest.approx(0.5 * usual["screw_foot"], rel=1e-7)
    assert volumes(structure)["screw"] == pytest.approx(
        0.5 * 0.1 * d.screw_depth * d.screw_width, rel=1e-7
    )


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [0.0, -0.1, np.nan, np.inf])
def test_a_dimension_that_is_no_length_is_named(name, value):
    with pytest.raises(InputError, match=name):
        box_milling_machine(replace(REFERENCE, **{name: value}))


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"bracket_bottom": 1.2}, "bracket"),
        ({"strip_width": 0.3}, "strips"),
        ({"strip_bottom": 0.8}, "strips"),
        ({"strip_top": 1.2}, "strips"),
        ({"screw_bottom": 0.4}, "screw"),
        ({"screw_bottom": -0.1}, "screw_bottom"),
        ({"table_bottom": 0.7}, "table"),
        ({"screw_x": 1.43}, "screw"),
        ({"source_width": 0.3}, "source"),
        ({"source_top": 0.76}, "source"),
        ({"nose_height": 1.2}, "nose"),
        ({"table_point": 0.9}, "table_point"),
        ({"column_depth": 0.09}, "column"),
        ({"table_length": 0.09}, "table"),
    ],
)
def test_parts_that_do_not_fit_are_named(changes, part):
    with pytest.raises(InputError, match=part):
        box_milling_machine(replace(REFERENCE, **changes))


@pytest.mark.parametrize("size", [0.0, -0.1, np.nan])
def test_an_element_size_that_is_no_length_is_refused(size):
    with pytest.raises(InputError, match="element size"):
        box_milling_machine(element_size=size)
