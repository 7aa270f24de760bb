"""Element matrices in one product against the forms they stand for, and where they add up."""

import numpy as np
import pytest
from bars import IRON, STEEL, two_bars
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array, csr_array

from benchmarks.performance.plain_set_up import plain_operators
from fesim.solid import element_matrices
from fesim.solid.elasticity import elastic_operators, elastic_pieces
from fesim.solid.element_matrices import places_of
from fesim.solid.linear_solver import symmetric, symmetric_product, upper_triangle
from fesim.solid.spaces import make_spaces
from meshes.structure import Structure

MATERIALS = {"left": IRON, "right": STEEL}
SUPPORTS = (["left_end"], {"bottom": "y"})


def distorted(structure):
    """Turn every cell into one without a right angle, the joint's faces staying where they are."""
    x, y, z = structure.mesh.p
    moved = np.array([x + 0.1 * np.sin(30.0 * x) * y, y + 0.2 * x * z, z - 0.1 * x * y])
    mesh = type(structure.mesh)(moved, structure.mesh.t)
    return Structure(mesh, structure.bodies, structure.surfaces)


@pytest.mark.parametrize("shape", [lambda one: one, distorted], ids=["boxes", "distorted"])
@pytest.mark.parametrize("tetrahedra", [False, True])
def test_stiffness_and_thermal_load_are_those_of_the_forms(tetrahedra, shape, monkeypatch):
    monkeypatch.setattr(element_matrices, "AT_ONCE", 5)
    structure = shape(two_bars(left=(2, 3, 1), right=(2, 2, 2), tetrahedra=tetrahedra))
    spaces = make_spaces(structure.mesh)
    ours = elastic_operators(structure, spaces, MATERIALS, *SUPPORTS)
    plain = plain_operators(structure, spaces, MATERIALS, *SUPPORTS)
    for name in ("stiffness", "thermal_load"):
        one, other = (getattr(made, name).toarray() for made in (ours, plain))
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-13 * np.abs(other).max())
    np.testing.assert_array_equal(ours.free, plain.free)


def test_pieces_are_the_blocks_of_the_stiffness():
    structure = two_bars(left=(2, 3, 1), right=(2, 2, 1))
    spaces = make_spaces(structure.mesh)
    whole = elastic_operators(structure, spaces, MATERIALS, *SUPPORTS)
    made = list(elastic_pieces(structure, spaces, MATERIALS, *SUPPORTS))
    assert len(made) == 2
    for ours, other in zip(made, whole.pieces(), strict=True):
        np.testing.assert_array_equal(ours.unknowns, other.unknowns)
        np.testing.assert_array_equal(ours.free, other.free)
        np.testing.assert_allclose(ours.points, other.points)
        np.testing.assert_allclose(ours.stiffness.toarray(), other.stiffness.toarray())
        np.testing.assert_allclose(ours.thermal_load.toarray(), other.thermal_load.toarray())


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_entries_add_up_at_their_places(data):
    rows, columns = data.draw(st.tuples(st.integers(1, 6), st.integers(1, 6)))
    count = data.draw(st.integers(1, 40))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    row, column = rng.integers(rows, size=count), rng.integers(columns, size=count)
    entries = rng.normal(size=count)
    places = places_of(row, column, (rows, columns))
    ours = csr_array((places.sums(entries), places.indices, places.indptr), shape=(rows, columns))
    plain = coo_array((entries, (row, column)), shape=(rows, columns))
    np.testing.assert_allclose(ours.toarray(), plain.toarray(), rtol=0.0, atol=1e-13)
    assert ours.has_canonical_format


def test_an_upper_triangle_stands_for_the_whole():
    rng = np.random.default_rng(1)
    dense = rng.normal(size=(20, 20)) * (rng.random((20, 20)) < 0.4)
    whole = csr_array(dense + dense.T)
    upper = upper_triangle(whole)
    np.testing.assert_array_equal(upper.toarray(), np.triu(whole.toarray()))
    np.testing.assert_allclose(symmetric(upper).toarray(), whole.toarray(), atol=1e-15)
    vectors = rng.normal(size=(20, 3))
    np.testing.assert_allclose(symmetric_product(upper, vectors), whole @ vectors, atol=1e-13)
