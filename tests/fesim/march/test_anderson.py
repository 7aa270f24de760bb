"""Accelerated sweeps find what plain ones diverge from."""

import numpy as np

from fesim.march.anderson import accelerated


def test_a_linear_fixed_point_is_found_in_as_many_sweeps_as_there_are_values_and_two():
    """Its map has a gain of up to three, of either sign: plain sweeps diverge."""
    rng = np.random.default_rng(7)
    turned = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    gain = turned @ np.diag([-3.0, -1.5, 0.2, 0.8, 2.0]) @ turned.T
    fixed = rng.normal(size=5)
    values, misfits = [np.zeros(5)], []
    for _ in range(6):
        misfits.append((gain - np.eye(5)) @ (values[-1] - fixed))
        values.append(accelerated(values, misfits))
    np.testing.assert_allclose(values[-1], fixed, atol=1e-8)
