"""The dense systems of compiled code are solved as NumPy solves them."""

import numpy as np
import pytest

from fesim.jit import compiled
from fesim.joint.linear_system import (
    factorise_columns,
    factorise_single,
    solve,
    solve_again,
)


@compiled
def solved(matrix, right_side):
    return solve(matrix, right_side)


@compiled
def solved_again(columns, right_sides):
    """The solution for the first right side, and by its factors for the second."""
    pivots = np.empty(columns.shape[0], np.int32)
    factorise_columns(columns, pivots, right_sides[0])
    solve_again(columns, pivots, right_sides[1])


@compiled
def solved_again_in_single_precision(columns, right_sides):
    pivots = np.empty(columns.shape[0], np.int32)
    factorise_single(columns, pivots, right_sides[0])
    solve_again(columns, pivots, right_sides[1])


@pytest.mark.parametrize("size", [0, 1, 2, 3, 4, 30, 81])
@pytest.mark.parametrize(
    ("solver", "kind"),
    [(solved_again, np.float64), (solved_again_in_single_precision, np.float32)],
)
def test_factors_serve_another_right_side(size, solver, kind):
    rng = np.random.default_rng(size)
    matrix = rng.standard_normal((size, size)) + 2.0 * np.sqrt(size) * np.eye(size)
    right_sides = rng.standard_normal((2, size))
    expected = np.linalg.solve(matrix, right_sides.T).T
    columns, found = np.ascontiguousarray(matrix.T, dtype=kind), right_sides.astype(kind)
    solver(columns, found)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=100.0 * np.finfo(kind).eps)


@pytest.mark.parametrize("size", [0, 1, 2, 30, 81])
def test_a_system_is_solved_as_by_numpy_and_stays_as_it_was(size):
    rng = np.random.default_rng(size)
    matrix, right_side = rng.standard_normal((size, size)), rng.standard_normal(size)
    before = matrix.copy(), right_side.copy()
    expected = np.linalg.solve(matrix, right_side)
    np.testing.assert_allclose(solved(matrix, right_side), expected, rtol=1e-9, atol=1e-12)
    assert np.array_equal(matrix, before[0])
    assert np.array_equal(right_side, before[1])


@pytest.mark.parametrize("entry", [0.0, np.nan, np.inf])
def test_what_has_no_solution_is_refused(entry):
    matrix = np.eye(3)
    matrix[1, 1] = entry
    with pytest.raises(np.linalg.LinAlgError):
        solved(matrix, np.array([np.inf, 1.0, 1.0]) if np.isinf(entry) else np.ones(3))
