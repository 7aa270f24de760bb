"""Whole runs: consecutive ordinary samples at once, in compiled code."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from estimator.joint_aware import compiled_sample
from estimator.joint_aware.band import half_band
from estimator.joint_aware.compiled_sample import Place, Results, empty_results
from estimator.joint_aware.displacement_readings import mean_of
from estimator.joint_aware.observer_state import unpacked
from estimator.joint_aware.precomputed import Precomputed
from estimator.joint_aware.sample_estimate import estimate_of
from estimator.joint_aware.sample_processing import SAME, Processed, process, results_of
from estimator.joint_aware.sample_values import SampleValues, split_sample
from thermojoint.artefacts.arrays import Array

#: Most samples processed at once; those after the first unusual one are processed again.
AT_ONCE = 1000


def results_in(data: Precomputed, samples: Array, state: Array) -> Results:
    """Return the results of a run without displacement readings: see `JointAware.results`."""
    results = empty_results(len(samples), data.sizes)
    for at, _, found in _stretches(data, samples, state):
        now = found if isinstance(found, Results) else results_of(data.observer, found[0])
        for whole, part in zip(results, now, strict=True):
            whole[at] = part
    return results


def banded(data: Precomputed, samples: Array, state: Array) -> tuple[Array, Array]:
    """Return the displacements in a run and their bands: see `JointAware.whole_run`."""
    moved, bands = np.empty((2, len(samples), len(data.observer.model.axes)))
    for at, after, found in _stretches(data, samples, state):
        if isinstance(found, Results):
            moved[at] = displacements_of(data, found)
            bands[at] = _bands(data, after, found)
        else:
            processed, read = found
            estimate = estimate_of(data, processed, float(samples[at.start, 0]), read)
            moved[at], bands[at] = estimate.displacement, estimate.band
    return moved, bands


def displacements_of(data: Precomputed, results: Results) -> Array:
    """Return displacements without displacement readings, (n, axes), m."""
    return results.displacement + data.observer.displacement_by(results.means)


def _stretches(
    data: Precomputed, samples: Array, state: Array
) -> Iterator[tuple[slice, Array, Results | tuple[Processed, SampleValues]]]:
    """Yield the indices of samples, the state after them, and their results.

    Consecutive ordinary samples are one stretch; any other sample is processed alone.
    """
    readings, k = _readings_of(data, samples, state), 0
    while k < len(samples):
        time, *values = samples[k].tolist()
        read = split_sample(data, values)
        state, processed = process(data, state, time, read)
        yield slice(k, k + 1), state, (processed, read)
        k += 1
        # Where a start or a gap still has an effect, no sample is usual.
        unsettled = processed.after.covariance_factor.any()
        if data.place is None or readings is None or unsettled or k == len(samples):
            continue
        state, results = _run(data, data.place, state, samples[k:, 0], readings[k:])
        at = slice(k, k + len(results.displacement))
        yield at, state, results
        k = at.stop


def _readings_of(data: Precomputed, samples: Array, state: Array) -> Array | None:
    """Readings of samples (n, 1 + channels), (n, p + 1), K; None if they cannot be usual.

    Usual ones are a step apart, of a machine without loads, axes and displacement readings.
    """
    model, thermal = data.observer.model, len(data.observer.system.rows)
    told = mean_of(unpacked(state, data.layout).model_error).any()
    if told or samples.shape[1] != 1 + thermal:
        return None
    if (np.abs(np.diff(samples[:, 0]) - model.step) > SAME * model.step).any():
        return None
    return np.asarray(samples[:, 1:] - np.append(model.offset, 0.0))


def _run(
    data: Precomputed, place: Place, state: Array, times: Array, readings: Array
) -> tuple[Array, Results]:
    """State before the first unusual one of samples (n,), and the results of those before."""
    count = min(len(times), AT_ONCE)
    while True:
        after, results = state.copy(), empty_results(count, data.sizes)
        now = times[:count].copy(), data.observer.model.step, readings[:count], results
        own = unpacked(after, data.layout)
        usual = compiled_sample.ordinary_samples(place, own, *now)
        if usual == count:
            if count:
                own.steps[()] = 1.0
            return after, results
        # The first other sample has made the state invalid.
        count = usual


def _bands(data: Precomputed, state: Array, results: Results) -> Array:
    """Half-widths of the bands (n, axes), m, of ordinary samples; `state` is after the last."""
    observer, last = data.observer, unpacked(state, data.layout)
    parts = observer.model_error(results.relaxed, float(last.slip_knowledge), results.means)
    return half_band(observer, parts, last.model_error, last.covariance_factor)
