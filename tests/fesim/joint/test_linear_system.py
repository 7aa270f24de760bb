"""The dense systems of compiled code are solved as NumPy solves them."""

import numpy as np
import pytest

from fesim.jit import compiled
from fesim.joint.linear_system import solve


@compiled
def solved(matrix, right_side):
    return solve(matrix, right_side)


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
