"""JIT-compiled processing of an ordinary sample: all readings present and trusted, one step.

The same arithmetic as `observer.Observer`, which handles all exceptions: an unknown start or a long
gap that still has an effect, a missing or distrusted reading, one that the others contradict, a
pending jump. Whether a sample is ordinary is decided here, before anything is changed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimator.joint_aware.displacement_readings import ModelError
from estimator.joint_aware.observer_state import UNKNOWN, ObserverState
from estimator.sensor_faults import Channels, Sample, Thresholds, certainly_consistent, update_watch
from fesim.jit import compiled, compiled_part
from fesim.joint.in_place import add, put
from fesim.joint.linear_system import solve
from fesim.march.compiled_step import (
    HeatStep,
    HeatWork,
    JointKernel,
    JointState,
    JointWork,
    conduct_step,
    heat_work,
    joint_work,
    settle_step,
)
from thermojoint.artefacts.arrays import Array, Flags


class Possible(NamedTuple):
    """Data to explain innovations by changes of heat (`innovation_gate.possible_heat`)."""

    #: Shape (p + 1, s): readings per W of a change since the sample before, K/W.
    onset: Array
    #: Shape (s, p + 1): best-fitting change of heat per innovation, W/K.
    found: Array
    #: Shape (s,): largest heat of each source, and tolerance beyond it or below zero, W.
    most: Array
    slack: Array
    #: Shape (p + 1, p + 1): covariance of the innovations with the steady covariance, K2.
    covariance: Array


class Filter(NamedTuple):
    """Filter data of a sample; n states, of which d are dynamic."""

    #: Shape (s, q): decay of the relaxations of the model discrepancy over a step.
    relaxing: Array
    #: Shape (s,): heat of each source at heat input 1, W.
    power: Array
    #: Shape (p + 1, n): rows of the readings.
    rows: Array
    #: Shape (n, p + 1): of all readings with the steady covariance.
    gain: Array
    #: Shape (axes, s q): displacement per relaxation, m.
    discrepancy: Array
    #: Properties of the readings.
    channels: Channels
    #: Thresholds for rejecting a reading.
    rules: Thresholds
    #: Data to explain innovations by changes of heat.
    possible: Possible
    #: Shape (d + axes,): decay rates of the corrections by displacement readings, 1/s.
    forgetting: Array


class Results(NamedTuple):
    """Results of n samples, written in place."""

    #: Shape (n, axes): displacement, m, before corrections by innovations and readings of it.
    displacement: Array
    #: Shape (n, s q): relaxations of the heat.
    relaxed: Array
    #: Shape (n, 3 (p + 1)): means of the innovations (`Watch.means`), K.
    means: Array


def empty_results(count: int, sizes: tuple[int, int, int]) -> Results:
    """Return storage for `count` samples; `sizes` are the numbers of values per sample."""
    return Results(*(np.empty((count, size)) for size in sizes))


class SampleWork(NamedTuple):
    """Storage of a sample of p + 1 readings; its content is not used afterwards."""

    heat: HeatWork
    joint: JointWork
    predicted: Array
    innovation: Array
    invalid: Flags
    near: Flags
    discrepancy: Array
    #: Shapes (s,), (p + 1,), (p + 1,) and (p + 1, p + 1): of `_consistent`.
    heat_change: Array
    rest: Array
    unit: Array
    system: Array


class Place(NamedTuple):
    """Data for one sample: the machine and its joint over one step, the filter, storage."""

    own: Filter
    heat: HeatStep
    joint: JointKernel
    work: SampleWork


def place_of(own: Filter, heat: HeatStep, joint: JointKernel) -> Place:
    """Return the data for samples, with their storage."""
    count, axes = len(own.rows), len(joint.free)
    work = SampleWork(
        heat_work(joint),
        joint_work(joint),
        np.empty(count),
        np.empty(count),
        np.empty(count, np.bool_),
        np.empty(count, np.bool_),
        np.empty(axes),
        np.empty(own.power.size),
        np.empty(count),
        np.zeros(count),
        np.empty((count, count)),
    )
    return Place(own, heat, joint, work)


@compiled
def ordinary_samples(
    place: Place,
    state: ObserverState,
    times: Array,
    length: float,
    readings: Array,
    results: Results,
) -> int:
    """Process ordinary samples into `state` and `results`, in place.

    Parameters
    ----------
    place : Place
        Data of the observer for a step of `length`.
    state : ObserverState
        Views of a flat state; the sample before is `length` (s) before the first of these.
    times : ndarray, shape (n,)
        `length` (s) apart.
    length : float
        s.
    readings : ndarray, shape (n, p + 1)
        K.
    results : Results
        Of n samples.

    Returns
    -------
    int
        Number of samples before the first that is not ordinary. If there is one, the content of
        `state` is invalid.
    """
    judging = state.pending.channel[()]
    if state.slip_knowledge[()] == UNKNOWN or judging == judging:
        return 0
    for more in state.covariance_factor.flat:
        if more != 0.0:
            return 0
    modes, channels = place.heat.decay.size, readings.shape[1]
    relaxed = state.linear[modes : modes + results.relaxed.shape[1]]
    for k in range(times.size):
        if not _process_ordinary(
            place, state, times[k], length, readings[k], results.displacement[k]
        ):
            return k
        put(relaxed, results.relaxed[k])
        put(state.watch.lasting, results.means[k, :channels])
        put(state.watch.longer, results.means[k, channels : 2 * channels])
        put(state.watch.longest, results.means[k, 2 * channels :])
    return times.size


@compiled_part
def _process_ordinary(
    place: Place,
    state: ObserverState,
    time: float,
    length: float,
    readings: Array,
    displacement: Array,
) -> bool:
    """Process one sample: readings (p + 1,) at a time (s); False if it is not ordinary."""
    own, heat, joint, work = place.own, place.heat, place.joint, place.work
    channels, size = own.rows.shape
    for k in range(channels):
        if state.watch.distrusted[k] != 0.0 or not np.isfinite(readings[k]):
            return False
    modes = heat.decay.size
    sources, rates = own.relaxing.shape
    dynamic = modes + sources * rates
    linear, inputs, relaxed = state.linear, state.linear[dynamic:], state.linear[modes:dynamic]
    conduct_step(heat, joint, work.heat, linear[:modes], inputs, state.pressure)
    for s in range(sources):
        for q in range(rates):
            kept = own.relaxing[s, q]
            k = s * rates + q
            relaxed[k] = kept * relaxed[k] + (1.0 - kept) * inputs[s] / own.power[s]
    predicted, innovation, invalid, near = work.predicted, work.innovation, work.invalid, work.near
    np.dot(own.rows, linear, predicted)
    for c in range(channels):
        innovation[c] = readings[c] - predicted[c]
    if not (
        certainly_consistent(innovation, own.rules)
        or _consistent(own.possible, own.rules, work, inputs[:sources])
    ):
        return False
    sample = Sample(time, readings, predicted)
    update_watch(state.watch, sample, own.channels, own.rules, invalid, near)
    if invalid.any():
        return False
    for k in range(size):
        for c in range(channels):
            linear[k] += own.gain[k, c] * innovation[c]
    now = JointState(state.gap, state.slip, state.pressure, state.change)
    if settle_step(joint, work.joint, linear[:modes], state.loads, now, displacement) != 0:
        return False
    np.dot(own.discrepancy, relaxed, work.discrepancy)
    add(work.discrepancy, displacement)
    forget(state.model_error, own.forgetting, length)
    state.time[()] = time
    return True


@compiled_part
def _consistent(possible: Possible, rules: Thresholds, work: SampleWork, heat: Array) -> bool:
    """Whether no innovation is a contradiction by `sensor_faults`, or a jump by `innovation_gate`.

    Also False where the best-fitting change of heat is not possible: then bounds apply, which is
    left to the observer. `heat` (s,) is the present one, W.
    """
    innovation, change, rest, unit = work.innovation, work.heat_change, work.rest, work.unit
    for s in range(heat.size):
        change[s] = 0.0
        for c in range(innovation.size):
            change[s] += possible.found[s, c] * innovation[c]
        least = min(-heat[s], 0.0) - possible.slack[s]
        most = max(possible.most[s] - heat[s], 0.0) + possible.slack[s]
        if not least <= change[s] <= most:
            return False
    put(possible.covariance, work.system)
    for c in range(innovation.size):
        imperfect = rules.model_error + rules.model_share * abs(work.predicted[c])
        work.system[c, c] += imperfect * imperfect
        if abs(innovation[c]) > rules.gate * math.sqrt(work.system[c, c]):
            return False  # a jump
        rest[c] = innovation[c]
        for s in range(heat.size):
            rest[c] -= possible.onset[c, s] * change[s]
    for c in range(innovation.size):
        unit[c] = 1.0
        row = solve(work.system, unit)  # of the inverse, which is symmetric
        unit[c] = 0.0
        if not abs(np.dot(row, rest)) <= rules.gate * math.sqrt(row[c]):
            return False
    return True


@compiled
def forget(error: ModelError, rates: Array, length: float) -> None:
    """Forget displacement readings over some time (s), in place, as `displacement_readings.later`.

    Parameters
    ----------
    error : ModelError
    rates : ndarray, shape (d + axes,)
        1/s.
    length : float
        s.
    """
    count = error.shared_mean.size
    for i in range(rates.size):
        kept = math.exp(-rates[i] * length)
        for k in range(rates.size):
            error.shared[i, k] *= kept
            error.shared[k, i] *= kept
        if i < count:
            error.shared_mean[i] *= kept
            error.shared[i, i] += 1.0 - kept * kept
        else:
            error.mean[i - count] *= kept
            error.variance[i - count] = 1.0 - kept * kept * (1.0 - error.variance[i - count])
