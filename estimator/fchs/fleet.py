"""Figure 5 for many machines at once: one product of stacked propagators per sample.

Every machine has a model of its own, and its own gaps: a machine whose sample is missing keeps its
state and is brought up to date by its next sample, over the longer interval. Memory and time per
sample do not grow with the length of the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from estimator.fchs.stream import Signals, propagator
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.models.assembly import Assembly


@dataclass(frozen=True, eq=False)
class Fleet:
    """The estimators of n machines with the same axes and numbers of sources.

    Attributes
    ----------
    estimators : tuple of Assembly
        One for each machine; machines may share one.
    width : int
        Longest state among them, the time left out; shorter ones are padded with zeros.
    """

    estimators: tuple[Assembly, ...]
    width: int

    @property
    def n_sources(self) -> int:
        """Number of fictitious sources of each machine."""
        return self.estimators[0].n_sources

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the displacement axes."""
        return self.estimators[0].axes


def assemble_fleet(estimators: Sequence[Assembly]) -> Fleet:
    """Put machines side by side.

    Raises
    ------
    InputError
        There are none, or they differ in axes or in the number of sources.
    """
    if not estimators:
        raise InputError("fleet: no machines; give at least one estimator")
    first = estimators[0]
    for i, other in enumerate(estimators):
        if (other.axes, other.n_sources) != (first.axes, first.n_sources):
            raise InputError(
                f"fleet: machine {i} has axes {', '.join(other.axes)} and {other.n_sources} "
                f"sources, machine 0 {', '.join(first.axes)} and {first.n_sources}; "
                "estimate them in separate fleets"
            )
    return Fleet(tuple(estimators), max(one.n_state for one in estimators) - 1)


def initial_states(fleet: Fleet) -> Array:
    """Return the states (n, 1 + width) of machines at rest; the first column is the last time."""
    states = np.zeros((len(fleet.estimators), 1 + fleet.width))
    states[:, 0] = np.nan
    return states


def step_fleet(
    fleet: Fleet, states: Array, time: float, delta_T: Array, temperatures: Array
) -> tuple[Array, Signals]:
    """Take one sample of every machine.

    Parameters
    ----------
    fleet : Fleet
    states : ndarray, shape (n, 1 + width)
        From `initial_states` or the last step; not changed.
    time : float
        s, after the last sample's.
    delta_T : ndarray, shape (n,)
        T_a - T_b of every machine, K.
    temperatures : ndarray, shape (n, n_sources)
        T1, T2 ... of every machine, K. A machine with a NaN among its values has no sample.

    Returns
    -------
    states : ndarray
        The new states.
    estimate : Signals
        With a leading axis of length n; NaN for a machine whose sample is missing.

    Raises
    ------
    InputError
        Time does not increase, a value is infinite, or a shape is wrong.
    """
    count, sources = len(fleet.estimators), fleet.n_sources
    shapes = np.shape(states), np.shape(delta_T), np.shape(temperatures)
    expected = (count, 1 + fleet.width), (count,), (count, sources)
    if shapes != expected:
        raise InputError(
            f"fleet sample at t = {time:g} s: states, ΔT and T have shapes {shapes}, expected "
            f"{expected}; give a row for each of the {count} machines"
        )
    measured = np.column_stack((delta_T, temperatures))
    if bool(np.isinf(measured).any()):
        machine = int(np.flatnonzero(np.isinf(measured).any(axis=1))[0])
        raise InputError(
            f"fleet sample at t = {time:g} s: machine {machine} has an infinite value; give NaN "
            "where a sample is missing"
        )
    last = states[:, 0]
    intervals = np.where(np.isnan(last), [one.dt_s for one in fleet.estimators], time - last)
    if not bool((intervals > 0.0).all()) or not np.isfinite(time):
        raise InputError(f"fleet sample at t = {time:g} s: time does not increase; drop the sample")

    width = fleet.width
    results = np.full((count, width + 1 + sources + 2 * len(fleet.axes)), np.nan)
    present = np.asarray(np.isfinite(measured).all(axis=1))
    new_states = states.copy()
    for dt in np.unique(intervals[present]):
        at = np.flatnonzero(present & (intervals == dt))
        stack = _propagators(fleet, float(dt))
        matrices = stack if at.size == count else stack[at]
        given = np.concatenate((states[at, 1:], measured[at]), axis=1)
        results[at] = np.matmul(matrices, given[:, :, None])[:, :, 0]
        new_states[at, 0] = time
        new_states[at, 1:] = results[at, :width]
    after = width + 1 + sources
    linear, nonlinear = np.split(results[:, after:], 2, axis=1)
    return new_states, Signals(
        np.where(present, time, np.nan),
        results[:, width],
        results[:, width + 1 : after],
        np.where(present[:, None], new_states[:, 2 : 2 + sources], np.nan),
        linear,
        nonlinear,
        linear + nonlinear,
    )


@lru_cache(maxsize=8)
def _propagators(fleet: Fleet, dt: float) -> Array:
    """Return the propagators over `dt` s, padded to one size, shape (n, rows, columns)."""
    width, count = fleet.width, len(fleet.estimators)
    inputs, outputs = 1 + fleet.n_sources, 1 + fleet.n_sources + 2 * len(fleet.axes)
    stack = np.zeros((count, width + outputs, width + inputs))
    for padded, one in zip(stack, fleet.estimators, strict=True):
        matrix, inner = propagator(one, dt), one.n_state - 1
        padded[:inner, :inner] = matrix[:inner, :inner]
        padded[:inner, width:] = matrix[:inner, inner:]
        padded[width:, :inner] = matrix[inner:, :inner]
        padded[width:, width:] = matrix[inner:, inner:]
    stack.flags.writeable = False
    return stack
