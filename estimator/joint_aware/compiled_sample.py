"""The usual sample in machine code: every reading there and believed, one step after the last one.

The same arithmetic as `observer.Observer`, whose steps take what is unusual: a start or a silence
that still counts, a reading that is missing, doubted or far from what is expected, a jump that is
not yet judged. What is usual is decided here, before anything is changed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimator.joint_aware.observer_state import UNKNOWN, Layout
from estimator.sensor_faults import GATE, MODEL_ERROR, Watch, look
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
    noise, low, high : ndarray, shape (p + 1,)
        Of the readings, and between which they are possible, K.
    forgetting : float
        Rate at which what readings of the displacement told is forgotten, 1/s.
    """

    relaxing: Array
    power: Array
    rows: Array
    gain: Array
    remainder: Array
    noise: Array
    low: Array
    high: Array
    forgetting: float


class Places(NamedTuple):
    """Where the parts of a flat state begin (`observer_state.layout`)."""

    time: int
    memory: int
    linear: int
    gap: int
    slip: int
    pressure: int
    change: int
    excess: int
    watch: int
    model_error: int
    suspected: int


def places(known: Layout) -> Places:
    """Return where the parts begin."""
    starts = {name: at.start for name, at, _ in known.parts}
    return Places(
        **{name: starts[name] for name in Places._fields[:-1]},
        suspected=starts["suspicion.channel"],
    )


@compiled
def usual_sample(
    own: Filter,
    heat: HeatStep,
    joint: JointKernel,
    at: Places,
    state: Array,
    time: float,
    length: float,
    readings: Array,
    displacement: Array,
) -> bool:
    """Take a sample into `state` and `displacement` (axes,), in place, if it is a usual one.

    Parameters
    ----------
    own, heat, joint, at
        What the observer is made of; `heat` for a step of `length`.
    state : ndarray
        Flat; the sample before is `length` (s) ago.
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
    channels, size = own.rows.shape
    contacts, modes = joint.preload.size, heat.decay.size
    if state[at.memory] == UNKNOWN or state[at.suspected] == state[at.suspected]:
        return False
    for k in range(at.excess, at.watch):
        if state[k] != 0.0:
            return False
    seen = state[at.watch : at.model_error].reshape((-1, channels))
    for k in range(channels):
        if seen[0, k] != 0.0 or not np.isfinite(readings[k]):
            return False
    linear = state[at.linear : at.gap]
    gap = state[at.gap : at.slip].reshape((3, contacts))
    slip = state[at.slip : at.pressure].reshape((2, contacts))
    pressure = state[at.pressure : at.change]
    change = state[at.change : at.excess].reshape((3, contacts))
    sources, rates = own.relaxing.shape
    dynamic = modes + sources * rates
    inputs = linear[dynamic:]
    conduct_step(heat, joint, linear[:modes], inputs, pressure)
    relaxed = linear[modes:dynamic]
    for s in range(sources):
        for q in range(rates):
            kept = own.relaxing[s, q]
            k = s * rates + q
            relaxed[k] = kept * relaxed[k] + (1.0 - kept) * inputs[s] / own.power[s]
    predicted = np.dot(own.rows, linear)
    innovation = readings - predicted
    # No contradiction is smaller than this; nor is a jump.
    if math.sqrt(np.dot(innovation, innovation)) > GATE * MODEL_ERROR:
        return False
    odd, near = np.empty(channels, np.bool_), np.empty(channels, np.bool_)
    watch = Watch(
        seen[0],
        seen[1],
        seen[2],
        seen[3],
        seen[4],
        seen[5],
        seen[6],
        seen[7],
        seen[8],
        seen[9],
        seen[10],
        seen[11],
        seen[12],
    )
    # The last channel is the ambient.
    look(watch, time, readings, predicted, own.noise, own.low, own.high, channels - 1, odd, near)
    if odd.any():
        return False
    for k in range(size):
        for c in range(channels):
            linear[k] += own.gain[k, c] * innovation[c]
    if settle_step(joint, linear[:modes], gap, slip, pressure, change, displacement) != 0:
        return False
    displacement += np.dot(own.remainder, relaxed)
    told = state[at.model_error : at.suspected].reshape((2, -1))
    kept = math.exp(-own.forgetting * length)
    for axis in range(displacement.size):
        told[0, axis] *= kept
        told[1, axis] = 1.0 - kept * kept * (1.0 - told[1, axis])
    state[at.time] = time
    return True
