"""Samples of the joint-aware estimator in machine code, against its general rule."""

import numpy as np

from estimator.interface import follow
from estimator.joint_aware.observer_state import unpacked
from estimator.joint_aware.precomputed import Precomputed
from estimator.joint_aware.sample_estimate import estimate_of
from estimator.joint_aware.sample_processing import moment_of, process, process_ordinary
from estimator.joint_aware.sample_values import split_sample


def by_the_general_rule(estimator, rows, state):
    """States and estimates if every sample is taken by the general rule."""
    known = Precomputed(estimator.observer)
    vars(known)["place"] = None  # of no machine code
    for time, *values in rows:
        read = split_sample(known, values)
        state, processed = process(known, state, time, read)
        yield state, estimate_of(known, processed, time, read)


def in_machine_code(estimator, rows):
    """States before samples, and whether the samples are taken in machine code."""
    known, before = estimator.precomputed, estimator.initial_state()
    for row, (after, _) in zip(rows, follow(estimator, rows, before), strict=True):
        time, *values = row
        own = unpacked(before.copy(), known.layout)
        moment = moment_of(known.observer, float(own.time), time)
        taken = process_ordinary(known, own, moment, split_sample(known, values))
        yield unpacked(before, known.layout), taken is not None
        before = after


def assert_general_rule(ours, rows):
    """An estimator that takes samples in machine code gives what the general rule gives."""
    for (after, quick), (expected, plain) in zip(
        follow(ours, rows, ours.initial_state()),
        by_the_general_rule(ours, rows, ours.initial_state()),
        strict=True,
    ):
        np.testing.assert_allclose(after, expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(quick.displacement, plain.displacement, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(quick.band, plain.band, rtol=1e-9)
        assert quick.words == plain.words
