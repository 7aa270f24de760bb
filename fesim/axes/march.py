"""Time stepping of a machine with a moving axis.

A step conducts heat between pads and the stations that they pass in it, by their shares of the
time, and settles the joints at the position of its end.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fesim.axes.machine import MovingMachine
from fesim.axes.occupation import distance, shares_of
from fesim.case.history import History
from fesim.march.machine import CondensedMachine, State
from fesim.march.stepping import Advance, advanced
from fesim.march.track import Track
from thermojoint.artefacts.arrays import Array


def march_moving(
    moving: MovingMachine, course: History, inputs: Array, advance: Advance, start: State
) -> Iterator[Track]:
    """Yield the steps of a march, one by one.

    Parameters
    ----------
    moving : MovingMachine
        The machine.
    course : History
        Position of the axis, m.
    inputs : ndarray, shape (n, k)
        Of each step; the last one, the heat of running friction, is filled in.
    advance : callable
        `plainly_staggered` or `iterated` of `fesim.march.stepping`.
    start : State
        State to continue from.

    Raises
    ------
    ConvergenceError
        A step has no equilibrium, or a body has come loose; that step is not yielded.
    InputError
        A pressure is beyond the conductance law.
    """
    state, step = start, moving.machine.thermal.step
    for row in inputs:
        ends = state.index * step, (state.index + 1) * step
        machine, friction = _in_step(moving, course, state, ends)
        driven = row.copy()
        driven[-1] = friction
        track = advanced(machine, advance(machine), state, driven[None])
        state = track.step(-1).state
        yield track


def _in_step(
    moving: MovingMachine, course: History, state: State, ends: tuple[float, float]
) -> tuple[CondensedMachine, float]:
    """The machine in the step between two times (s), and its heat of running friction, W."""
    position, way = float(course(np.array(ends[1]))), distance(course, *ends)
    if way == 0.0:
        return moving.standing(position), 0.0
    heat = moving.friction_heat(state.pressure, way)
    total = float(heat.sum())
    shares = shares_of(moving.guideway.positions, course, *ends)
    spread = heat / total if total > 0.0 else heat
    return moving.moving(shares, position, spread), total * moving.copies
