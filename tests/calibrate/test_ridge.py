"""Least squares, plain and with a penalty: what makes the sum of squares least."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibrate.ridge import linear_weights, ridge_weights


def drawn(seed, rows=12, columns=4, targets=2):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(rows, columns)), rng.normal(size=(rows, targets))


@given(seed=st.integers(0, 1000), penalty=st.floats(1e-6, 1e6))
def test_the_gradient_of_the_penalised_squares_vanishes(seed, penalty):
    features, target = drawn(seed)
    weights = ridge_weights(features, target, penalty)
    slope = features.T @ (features @ weights - target) + penalty * weights
    size = np.linalg.norm(features) * np.linalg.norm(target) + penalty
    assert np.abs(slope).max() <= 1e-12 * size


@given(seed=st.integers(0, 1000))
def test_without_a_penalty_nothing_of_the_error_lies_along_a_feature(seed):
    features, target = drawn(seed)
    error = features @ linear_weights(features, target) - target
    assert np.abs(features.T @ error).max() <= 1e-11 * np.linalg.norm(target)


def test_a_small_penalty_changes_little():
    features, target = drawn(3)
    assert ridge_weights(features, target, 1e-10) == pytest.approx(
        linear_weights(features, target), rel=1e-8
    )


def test_features_that_are_alike_share_their_weight():
    features, target = drawn(5, columns=1)
    twice = linear_weights(np.hstack((features, features * (1.0 + 1e-9))), target)
    assert twice[0] == pytest.approx(twice[1], rel=1e-6)
    assert twice.sum(axis=0) == pytest.approx(linear_weights(features, target)[0], rel=1e-6)
