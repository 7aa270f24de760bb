"""The Riccati equation of a steady filter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from estimator.joint_aware.riccati import predicted_covariance
from thermojoint.artefacts.errors import ConvergenceError


@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.integers(1, 12),
    walks=st.integers(0, 2),
    noise=st.floats(1e-3, 1e3),
)
def test_it_is_what_the_schur_form_gives(seed, size, walks, noise):
    rng = np.random.default_rng(seed)
    # Modes decay; the first of the inputs walk, which the readings see.
    walks = min(walks, size)
    transition = np.diag(np.append(np.ones(walks), rng.uniform(0.0, 0.99, size - walks)))
    transition[walks:, :walks] = rng.normal(size=(size - walks, walks))
    rows, source = rng.normal(size=(3, size)), rng.normal(size=(size, 4))
    readings = noise * rng.uniform(0.5, 2.0, 3)
    found = predicted_covariance(transition, rows, source, readings)
    wanted = solve_discrete_are(transition.T, rows.T, source @ source.T, np.diag(readings))
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-6 * np.abs(wanted).max())


def test_what_grows_and_is_not_read_has_no_steady_covariance():
    with pytest.raises(ConvergenceError, match="place a sensor near every source"):
        predicted_covariance(np.eye(2), np.array([[1.0, 0.0]]), np.eye(2), np.ones(1))
