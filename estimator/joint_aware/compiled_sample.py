"""JIT-compiled processing of an ordinary sample: all readings present and trusted, one step.

The same arithmetic as `observer.Observer`, whose steps take what is unusual: a start or a silence
that still counts, a reading that is missing, doubted or far from what is expected, a jump that is
not yet judged. What is usual is decided here, before anything is changed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimator.joint_aware.observer_state import UNKNOWN, ObserverState
from estimator.sensor_faults import Channels, Sample, Thresholds, certainly_alike, look
from fesim.machine_code import compiled
from fesim.march.compiled_step import HeatStep, JointKernel, conduct_step, settle_step
from thermojoint.artefacts.arrays import Array


class Filter(NamedTuple):
    """What a sample needs beside the machine and its joint; n states, of which d are dynamic.

    Attributes
    ----------
    relaxing : ndarray, shape (s, q)
        What is left of the relaxations of the remainder after a step.
    power : ndarray, shape (s,)
        Heat of each source at heat input 1, W.
    rows : ndarray, shape (p + 1, n)
        Of what is read.
    gain : ndarray, shape (n, p + 1)
        Of all readings with the steady covariance.
    remainder : ndarray, shape (axes, s q)
        Displacement per relaxation, m.
    channels : Channels
        What the readings can say.
    rules : Thresholds
        When one is distrusted.
    forgetting : float
        Rate at which what readings of the displacement told is forgotten, 1/s.
    """

    relaxing: Array
    power: Array
    rows: Array
    gain: Array
    remainder: Array
    channels: Channels
    rules: Thresholds
    forgetting: float


class Place(NamedTuple):
    """Where a sample is taken: the machine and its joint over one step, and what is not theirs."""

    own: Filter
    heat: HeatStep
    joint: JointKernel


@compiled
def usual_sample(
    place: Place,
    state: ObserverState,
    time: float,
    length: float,
    readings: Array,
    displacement: Array,
) -> bool:
    """Take a sample into `state` and `displacement` (axes,), in place, if it is a usual one.

    Parameters
    ----------
    place : Place
        What the observer is made of, for a step of `length`.
    state : ObserverState
        Views of a flat state; the sample before is `length` (s) ago.
    time, length : float
        s.
    readings : ndarray, shape (p + 1,)
        K.
    displacement : ndarray, shape (axes,)
        m, without what readings of it have told.

    Returns
    -------
    bool
        Whether it was. If not, `state` is no state any more.
    """
    own, heat, joint = place.own, place.heat, place.joint
    channels, size = own.rows.shape
    judging = state.suspicion.channel[()]
    if state.memory[()] == UNKNOWN or judging == judging:
        return False
    for more in state.excess.flat:
        if more != 0.0:
            return False
    for k in range(channels):
        if state.watch.distrusted[k] != 0.0 or not np.isfinite(readings[k]):
            return False
    modes = heat.decay.size
    sources, rates = own.relaxing.shape
    dynamic = modes + sources * rates
    linear, inputs, relaxed = state.linear, state.linear[dynamic:], state.linear[modes:dynamic]
    conduct_step(heat, joint, linear[:modes], inputs, state.pressure)
    for s in range(sources):
        for q in range(rates):
            kept = own.relaxing[s, q]
            k = s * rates + q
            relaxed[k] = kept * relaxed[k] + (1.0 - kept) * inputs[s] / own.power[s]
    predicted = np.dot(own.rows, linear)
    innovation = readings - predicted
    if not certainly_alike(innovation, own.rules):
        return False
    odd, near = np.empty(channels, np.bool_), np.empty(channels, np.bool_)
    sample = Sample(time, readings, predicted)
    look(state.watch, sample, own.channels, own.rules, odd, near)
    if odd.any():
        return False
    for k in range(size):
        for c in range(channels):
            linear[k] += own.gain[k, c] * innovation[c]
    if settle_step(
        joint,
        linear[:modes],
        state.gap,
        state.slip,
        state.pressure,
        state.change,
        displacement,
    ):
        return False
    displacement += np.dot(own.remainder, relaxed)
    kept = math.exp(-own.forgetting * length)
    told = state.model_error
    for axis in range(displacement.size):
        told.mean[axis] *= kept
        told.variance[axis] = 1.0 - kept * kept * (1.0 - told.variance[axis])
    state.time[()] = time
    return True
