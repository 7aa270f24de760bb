"""Points are found in the cell that holds them, however cells differ in size and shape."""

import numpy as np
import pytest
from bars import two_bars
from hypothesis import given
from hypothesis import strategies as st
from skfem import FacetBasis, Functional, MeshHex, MeshTet

from fesim.case.schema import CandidatesSection
from fesim.setup.structure import candidate_probes
from fesim.solid.spaces import cells_at, make_spaces, probe_cells
from meshes.structure import Probe, Structure
from thermojoint.artefacts.errors import InputError

#: A bar with cells of 100 mm at one end and of 2 mm at the other.
GRADED = MeshHex.init_tensor(
    np.r_[0.0, 0.1, 0.1 + 0.002 * np.arange(1, 21)],
    np.linspace(0.0, 0.02, 11),
    np.linspace(0.0, 0.02, 11),
)


def all_cells(mesh):
    return np.arange(mesh.nelements)


@pytest.mark.parametrize("depth", [1e-4, 5e-3, 0.05])
def test_a_large_cell_is_found_among_small_ones(depth):
    """The centres of more than 32 small cells are nearer than its own."""
    (cell,) = cells_at(GRADED, np.array([[0.1 - depth, 0.001, 0.001]]), all_cells(GRADED))
    corners = GRADED.p[:, GRADED.t[:, cell]]
    assert corners[0].min() == pytest.approx(0.0, abs=1e-12)
    assert corners[0].max() == pytest.approx(0.1, rel=1e-12)


@given(
    points=st.lists(st.tuples(*3 * [st.floats(-0.2, 1.2)]), min_size=1, max_size=20),
    tetrahedra=st.booleans(),
)
def test_a_point_is_in_a_cell_exactly_if_it_is_in_the_cube(points, tetrahedra):
    kind = MeshTet if tetrahedra else MeshHex
    mesh = kind.init_tensor(*3 * [np.linspace(0.0, 1.0, 4)])
    at = np.array(points)
    depth = np.minimum(at, 1.0 - at).min(axis=1)
    found = cells_at(mesh, at, all_cells(mesh))
    assert (found[depth > 1e-3] >= 0).all()
    assert (found[depth < -1e-3] == -1).all()
    inside = found >= 0
    corners = mesh.p[:, mesh.t[:, found[inside]]]
    assert (at[inside] + 1e-4 >= corners.min(axis=1).T).all()
    assert (at[inside] - 1e-4 <= corners.max(axis=1).T).all()


@pytest.mark.parametrize("away", [1.0, 10.0])
def test_thin_cells_may_be_far_from_the_origin(away):
    """Their points are rounded by more than a millionth of a millionth of a cell."""
    lines = np.linspace(0.0, 0.1, 6), np.linspace(0.0, 0.1, 6), np.linspace(0.0, 4e-4, 3)
    mesh = MeshHex.init_tensor(*(line + away for line in lines))
    basis = make_spaces(mesh).heat
    faces = FacetBasis(mesh, basis.elem, basis.mapping, facets=mesh.boundary_facets())
    area = Functional(lambda w: np.ones(w.x.shape[1:])).assemble(faces)
    assert area == pytest.approx(2 * 0.01 + 4 * 0.1 * 4e-4, rel=1e-10, abs=0)


def test_candidates_leave_out_what_a_body_of_tetrahedra_does_not_hold():
    """A wedge: the boxes around its cells reach beyond its slope."""
    cube = MeshTet.init_tensor(*3 * [np.linspace(0.0, 0.1, 3)])
    x, y, z = cube.p
    wedge = MeshTet(np.array([x, y * (1.0 - 9.0 * x), z]), cube.t)
    structure = Structure(wedge, {"wedge": np.arange(wedge.nelements)}, {})
    box = CandidatesSection(
        body="wedge", low_mm=(10.0, 2.5, 20.0), high_mm=(90.0, 92.5, 20.0), spacing_mm=10.0
    )
    case = type("OnlyCandidates", (), {"candidates": [box]})()
    found = candidate_probes(case, structure)
    lattice = [(a, b + 0.5) for a in range(10, 100, 10) for b in range(2, 100, 10)]
    assert set(found) == {f"s{a}_{b}_20" for a, b in lattice if b < 100.0 - 0.9 * a}


def test_a_point_outside_is_told_as_plain_numbers():
    structure = two_bars()
    probe = Probe(tuple(np.array([0.05, 0.03, 9.0])), "left")
    with pytest.raises(InputError, match=r"probe 'far' at \(0.05, 0.03, 9\) m lies in no cell"):
        probe_cells(structure, {"far": probe})


@pytest.mark.parametrize("mesh", [GRADED, MeshTet()])
def test_displacements_are_not_evaluated_where_nothing_is_integrated(mesh):
    """Their gradients on the points of an integral would be gigabytes of a fine mesh."""
    assert make_spaces(mesh).displacement.dx.shape == (mesh.nelements, 1)
