"""Refined solutions: as exact as those of double precision, or none."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fesim.solid.refinement import refined


def system(seed, count, spread):
    """A matrix with eigenvalues from one to `spread`, and two right-hand sides."""
    rng = np.random.default_rng(seed)
    modes = np.linalg.qr(rng.standard_normal((count, count)))[0]
    matrix = modes * np.geomspace(1.0, spread, count) @ modes.T
    return 0.5 * (matrix + matrix.T), rng.standard_normal((count, 2))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), count=st.integers(1, 40), spread=st.floats(1.0, 1e4))
def test_inverses_of_single_precision_give_solutions_of_double(seed, count, spread):
    matrix, right_side = system(seed, count, spread)
    inverse = np.linalg.inv(matrix)
    rough = (0.5 * (inverse + inverse.T)).astype(np.float32)
    found = refined(lambda x: matrix @ x, lambda b: rough.astype(np.float64) @ b, right_side)
    exact = np.linalg.solve(matrix, right_side)
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-8 * spread * np.abs(exact).max())


def test_what_does_not_converge_has_no_solution():
    matrix, right_side = system(5, 200, 1e12)
    assert refined(lambda x: matrix @ x, lambda b: b, right_side) is None
