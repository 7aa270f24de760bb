"""Shares of positions in a step, the line of a control, for all inputs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fesim.axes.line import line_over
from fesim.axes.occupation import distance, shares_of, weights_at
from fesim.case.history import History, sampled_history

POSITIONS = np.linspace(-0.1, 0.3, 9)
inside = st.floats(-0.1, 0.3)


@st.composite
def courses(draw):
    times = np.cumsum(draw(st.lists(st.floats(0.01, 20.0), min_size=1, max_size=12)))
    return History(times, np.array([draw(inside) for _ in times]))


@given(inside)
def test_a_position_is_the_mean_of_its_neighbours(at):
    shares = weights_at(POSITIONS, at)
    assert np.count_nonzero(shares) <= 2
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    assert shares.min() >= 0.0
    assert shares @ POSITIONS == pytest.approx(at, abs=1e-9)


@given(courses(), st.floats(0.0, 50.0), st.floats(0.1, 50.0))
def test_the_mean_of_a_step_is_that_of_time(course, start, length):
    found = shares_of(POSITIONS, course, start, start + length)
    shares = found.mean
    mean = float(course.integral(np.array(start + length)) - course.integral(np.array(start)))
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    assert shares.min() >= -1e-9
    assert shares @ POSITIONS == pytest.approx(mean / length, abs=1e-7)
    # The weights add up to one at every moment, so each is the sum of its products with all.
    products = found.square + np.append(found.product, 0.0) + np.append(0.0, found.product)
    assert products == pytest.approx(shares, abs=1e-12)


def test_an_even_way_takes_as_long_everywhere():
    course = sampled_history(np.array([0.0, 8.0]), np.array([-0.1, 0.3]))
    shares = shares_of(POSITIONS, course, 0.0, 8.0).mean
    assert shares[1:-1] == pytest.approx(1.0 / 8.0)
    assert shares[[0, -1]] == pytest.approx(1.0 / 16.0)
    there_and_back = sampled_history(np.array([0.0, 3.0, 8.0]), np.array([-0.1, 0.3, -0.1]))
    whole = shares_of(POSITIONS, there_and_back, 0.0, 8.0)
    assert whole.mean == pytest.approx(shares)
    # Of hat functions over an even way, as in a mass matrix.
    assert whole.square[1:-1] == pytest.approx(2.0 / 3.0 / 8.0)
    assert whole.product == pytest.approx(1.0 / 6.0 / 8.0)
    assert distance(there_and_back, 0.0, 8.0) == pytest.approx(0.8)


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_line_is_found_whole(offset, slope, reference):
    given_line = offset + slope * (POSITIONS - reference)
    line = line_over(POSITIONS, given_line[:, None], reference)
    assert line.offset[0] == pytest.approx(offset, abs=1e-12)
    assert line.slope[0] == pytest.approx(slope, abs=1e-11)
    assert line.left[0] == pytest.approx(0.0, abs=1e-12)
