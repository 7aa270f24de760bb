"""The direct solvers behind the one seam: same answers, and no answer to an impossible system."""

import gc
from importlib.util import find_spec

import numpy as np
import pytest
from bars import IRON, bar_mesh, two_bars
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array, diags_array

from fesim.solid.elasticity import elastic_operators
from fesim.solid.linear_solver import (
    Factor,
    checked_solve,
    default_solver,
    factorise,
    factorise_upper,
    upper_triangle,
)
from fesim.solid.spaces import make_spaces
from meshes.structure import Structure
from thermojoint.artefacts.errors import ConvergenceError, InputError

HERE = [
    pytest.param("superlu"),
    pytest.param(
        "pardiso",
        marks=pytest.mark.skipif(not find_spec("pypardiso"), reason="pypardiso is not installed"),
    ),
]


def chain(count, loose=False):
    """Springs in a row, N/m; the first mass is held to a wall unless loose."""
    main = np.full(count, 2.0)
    main[-1] = 1.0
    if loose:
        main[0] = 1.0
    return csr_array(
        diags_array([-np.ones(count - 1), main, -np.ones(count - 1)], offsets=[-1, 0, 1])
    )


def operators_of(structure, **supports):
    materials = dict.fromkeys(structure.bodies, IRON)
    return elastic_operators(structure, make_spaces(structure.mesh), materials, **supports)


def stiffness_of(structure, **supports):
    elastic = operators_of(structure, **supports)
    return elastic.stiffness[elastic.free][:, elastic.free]


def block(tetrahedra=False):
    mesh = bar_mesh(0.0, 0.1, (3, 2, 2), tetrahedra)
    facets = mesh.boundary_facets()
    middle = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    ends = {
        "left": facets[middle[0] < 1e-9],
        "bottom": facets[middle[1] < 1e-9],
        "back": facets[middle[2] < 1e-9],
    }
    return Structure(mesh, {"block": np.arange(mesh.nelements)}, ends)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40), columns=st.integers(0, 5))
@pytest.mark.parametrize("solver", HERE)
def test_solves_any_symmetric_positive_definite_system(solver, seed, count, columns):
    rng = np.random.default_rng(seed)
    dense = rng.normal(size=(count, count)) * (rng.random((count, count)) < 0.3)
    matrix = dense @ dense.T + np.eye(count)
    right_side = rng.normal(size=(count, columns) if columns else count)
    factor = factorise(csr_array(matrix), "test", solver)
    solution = factor.solve(right_side)
    assert solution.shape == right_side.shape
    np.testing.assert_allclose(matrix @ solution, right_side, rtol=1e-8, atol=1e-10)
    assert factor.solver == solver


@pytest.mark.skipif(not find_spec("pypardiso"), reason="pypardiso is not installed")
def test_both_solvers_agree_on_a_stiffness():
    matrix = stiffness_of(block(), fixed=["left"], symmetry={})
    right_side = np.cos(np.arange(2 * matrix.shape[0])).reshape(-1, 2)
    first, second = (
        factorise(matrix, "stiffness", solver).solve(right_side)
        for solver in ("pardiso", "superlu")
    )
    np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-12 * np.abs(first).max())


@pytest.mark.parametrize("solver", HERE)
def test_two_factors_alive_at_once_do_not_disturb_each_other(solver):
    one, other = (factorise(scale * chain(30), "chain", solver) for scale in (1.0, 5.0))
    right_side = np.ones(30)
    np.testing.assert_allclose(one.solve(right_side), 5.0 * other.solve(right_side), rtol=1e-12)
    np.testing.assert_allclose(one.solve(right_side), 5.0 * other.solve(right_side), rtol=1e-12)


@pytest.mark.parametrize("solver", HERE)
@pytest.mark.parametrize(
    "matrix",
    [
        pytest.param(chain(50, loose=True), id="loose chain"),
        pytest.param(csr_array(np.diag([1.0, 0.0, 2.0])), id="a node without material"),
        pytest.param(csr_array((4, 4)), id="nothing"),
    ],
)
def test_a_singular_matrix_is_an_input_error(solver, matrix):
    with pytest.raises(InputError, match=r"stiffness.*supports") as caught:
        factorise(matrix, "stiffness", solver)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("solver", HERE)
@pytest.mark.parametrize("tetrahedra", [False, True])
@pytest.mark.parametrize(
    ("symmetry"),
    [{}, {"left": "x"}, {"left": "x", "bottom": "y"}],
    ids=["free", "slides in a plane", "slides along a line"],
)
def test_a_body_that_is_free_to_move_is_an_input_error(solver, tetrahedra, symmetry):
    matrix = stiffness_of(block(tetrahedra), fixed=[], symmetry=symmetry)
    with pytest.raises(InputError, match="some body is free to move"):
        factorise(matrix, "stiffness", solver)


@pytest.mark.parametrize("solver", HERE)
def test_one_free_body_among_held_ones_is_an_input_error(solver):
    matrix = stiffness_of(two_bars(), fixed=["left_end"], symmetry={})
    with pytest.raises(InputError, match="some body is free to move"):
        factorise(matrix, "stiffness", solver)


def test_an_unknown_solver_is_named_with_the_known_ones():
    with pytest.raises(InputError, match="'cholmod' is unknown; use one of pardiso, superlu"):
        factorise(chain(3), "chain", "cholmod")


def test_superlu_is_the_default_where_pardiso_is_not_installed(monkeypatch):
    monkeypatch.delenv("THERMOJOINT_SOLVER", raising=False)
    monkeypatch.setattr("fesim.solid.linear_solver._installed", lambda: "superlu")
    assert default_solver() == "superlu"


def test_a_variable_names_the_default_solver_and_must_name_a_known_one(monkeypatch):
    monkeypatch.setenv("THERMOJOINT_SOLVER", "superlu")
    assert factorise(chain(3), "chain").solver == "superlu"
    monkeypatch.setenv("THERMOJOINT_SOLVER", "SuperLU")
    with pytest.raises(InputError, match="THERMOJOINT_SOLVER: 'SuperLU' is unknown"):
        default_solver()


def test_pardiso_that_is_not_installed_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pypardiso", None)
    with pytest.raises(InputError, match=r"thermojoint\[pardiso\]"):
        factorise(chain(3), "chain", "pardiso")


@pytest.fixture
def large(monkeypatch):
    """Every matrix counts as large, for factors of single precision."""
    pytest.importorskip("pypardiso")
    monkeypatch.setattr("fesim.solid.linear_solver.LARGE", 0)


def test_large_stiffness_is_solved_as_exactly_by_factors_of_single_precision(large):
    matrix = stiffness_of(block(), fixed=["left"], symmetry={})
    loads = np.random.default_rng(3).standard_normal((matrix.shape[0], 20))
    loads[:, 7] = 0.0
    exact, found = (factorise(matrix, "block", name) for name in ("superlu", "pardiso"))
    right, solved = (checked_solve(factor, loads, "block") for factor in (exact, found))
    np.testing.assert_allclose(solved, right, rtol=0.0, atol=1e-9 * np.abs(right).max())
    alone = checked_solve(found, loads[:, 0], "block")
    np.testing.assert_allclose(alone, right[:, 0], rtol=0.0, atol=1e-9 * np.abs(right).max())


@pytest.mark.parametrize("from_size", [0, 500_000], ids=["single precision", "double precision"])
def test_blocks_of_nodes_give_the_solutions_of_the_plain_matrix(monkeypatch, from_size):
    """Where supports hold one direction of a node, all of it, or nothing of it."""
    pytest.importorskip("pypardiso")
    monkeypatch.setattr("fesim.solid.linear_solver.LARGE", from_size)
    monkeypatch.setattr("fesim.solid.linear_solver.BLOCKED", 0)
    piece = next(iter(operators_of(block(), fixed=["left"], symmetry={"back": "z"}).pieces()))
    places = np.flatnonzero(piece.free)
    held = np.bincount(places // 3, minlength=len(piece.points))
    assert set(held) == {0, 2, 3}
    upper = upper_triangle(piece.stiffness[places][:, places])
    loads = np.random.default_rng(4).standard_normal((places.size, 20))
    exact = factorise_upper(upper, "block", "superlu")
    found = factorise_upper(upper, "block", "pardiso", places)
    for load in (loads, loads[:, 0]):
        right, solved = (checked_solve(factor, load, "block") for factor in (exact, found))
        np.testing.assert_allclose(solved, right, rtol=0.0, atol=1e-9 * np.abs(right).max())


def test_a_singular_matrix_in_blocks_is_an_input_error(monkeypatch, large):
    monkeypatch.setattr("fesim.solid.linear_solver.BLOCKED", 0)
    loose = upper_triangle(csr_array(chain(51, loose=True)))
    with pytest.raises(InputError, match="singular"):
        factorise_upper(loose, "chain", "pardiso", np.arange(51))


@pytest.mark.parametrize("soft", [1e-4, 1e-9])
def test_what_single_precision_cannot_hold_is_factorised_in_double(large, soft):
    """Masses that hang on springs which are small beside those between them, or lost there."""
    matrix = csr_array(chain(40, loose=True) + soft * diags_array([np.ones(40)], offsets=[0]))
    load = np.cos(np.arange(40))
    solved = checked_solve(factorise(matrix, "chain", "pardiso"), load, "chain")
    right = factorise(matrix, "chain", "superlu").solve(load)
    np.testing.assert_allclose(solved, right, rtol=1e-4)


def test_a_large_matrix_that_is_singular_is_an_input_error(large):
    with pytest.raises(InputError, match="singular"):
        factorise(chain(50, loose=True), "chain", "pardiso")


@pytest.mark.parametrize("wrong", [0.0, np.nan, 2.0])
def test_a_wrong_solution_is_never_passed_on(wrong):
    factor = Factor(chain(5), lambda right_side: wrong * np.ones_like(right_side), "broken")
    with pytest.raises(ConvergenceError, match="relative residual"):
        checked_solve(factor, np.arange(1.0, 6.0), "chain")


@pytest.mark.parametrize("wrong", [1e-4, np.nan])
def test_one_wrong_column_among_many_is_found(wrong):
    right = factorise(chain(5), "chain", "superlu")

    def solve(right_side):
        solution = right.solve(right_side)
        solution[2, 37] += wrong
        return solution

    factor, loads = Factor(right.matrix, solve, "broken"), np.ones((5, 100))
    with pytest.raises(ConvergenceError, match="relative residual"):
        checked_solve(factor, loads, "chain")
    assert np.array_equal(checked_solve(right, loads, "chain"), right.solve(loads))


@pytest.mark.parametrize("solver", HERE)
def test_a_zero_right_side_has_the_zero_solution(solver):
    factor = factorise(chain(6), "chain", solver)
    np.testing.assert_array_equal(checked_solve(factor, np.zeros(6), "chain"), 0.0)


@pytest.mark.skipif(not find_spec("pypardiso"), reason="pypardiso is not installed")
def test_a_dropped_factor_gives_its_memory_back(monkeypatch):
    """MKL keeps it otherwise: hundreds of MB for every structure that a study condenses."""
    import pypardiso

    freed = []
    give_back = pypardiso.PyPardisoSolver.free_memory

    def free_memory(self, everything=False):
        freed.append(everything)
        give_back(self, everything)

    monkeypatch.setattr(pypardiso.PyPardisoSolver, "free_memory", free_memory)
    factor = factorise(chain(30), "chain", "pardiso")
    assert freed == []
    del factor
    gc.collect()
    assert freed == [True]


@pytest.mark.parametrize(("off", "passes"), [(1, True), (200, False)])
def test_the_last_bits_of_a_stiff_body_on_a_soft_spring_are_no_failure(off, passes):
    """Its two ends move together: no doubles are nearer, and what they leave is 1e13 of the bit."""
    stiff, soft = 1e13, 1e3
    matrix = csr_array(np.array([[soft + stiff, -stiff], [-stiff, stiff]]))
    ends = np.array([1.0 / soft, 1.0 / soft + 1.0 / stiff])
    ends[1] += off * np.spacing(ends[1])
    factor = Factor(upper_triangle(matrix), lambda _: ends, "by hand")
    load = np.array([0.0, 1.0])
    if passes:
        assert np.abs(matrix @ checked_solve(factor, load, "two masses") - load).max() > 1e-6
    else:
        with pytest.raises(ConvergenceError, match=r"two masses: .* relative residual"):
            checked_solve(factor, load, "two masses")
