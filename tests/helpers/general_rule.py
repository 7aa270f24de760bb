"""Samples of the joint-aware estimator in machine code, against its general rule."""

import numpy as np

from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware


class InTheInterpreter(JointAware):
    """Takes every sample by its general rule."""

    def _process_ordinary(self, state, moment, readings, touched):
        return None


def assert_general_rule(ours, rows):
    """An estimator that takes samples in machine code gives what the general rule gives."""
    rule = InTheInterpreter(ours.model)
    for (after, quick), (expected, plain) in zip(
        follow(ours, rows, ours.initial_state()),
        follow(rule, rows, rule.initial_state()),
        strict=True,
    ):
        np.testing.assert_allclose(after, expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(quick.displacement, plain.displacement, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(quick.band, plain.band, rtol=1e-9)
        assert quick.words == plain.words
