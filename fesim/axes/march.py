"""Time stepping of a machine with a moving axis.

A step conducts heat between pads and the stations that they pass in it, by their shares of the
time, and settles the joints at the position of its end. A screw warms up before it and gives its
heat to the machine in the same step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fesim.axes.machine import MovingMachine
from fesim.axes.occupation import distance, shares_of, stretches
from fesim.axes.positioning import Drive, Way, warm_scale, warm_screw
from fesim.case.history import History
from fesim.march.machine import CondensedMachine, State
from fesim.march.stepping import Advance, advanced
from fesim.march.track import Track
from thermojoint.artefacts.arrays import Array


def march_moving(
    moving: MovingMachine,
    course: History,
    inputs: Array,
    advance: Advance,
    start: State,
    drive: Drive | None = None,
) -> Iterator[Track]:
    """Yield the steps of a march, one by one.

    Parameters
    ----------
    moving : MovingMachine
        The machine.
    course : History
        Position of the axis, m.
    inputs : ndarray, shape (n, k)
        Of each step; the last one, the heat of running friction, and those of the drive are filled
        in.
    advance : callable
        `plainly_staggered` or `iterated` of `fesim.march.stepping`.
    start : State
        State to continue from.
    drive : Drive, optional
        What positions the axis; its state is part of the march's.

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
        if drive is not None:
            way = Way(*stretches(course, *ends))
            screw, driven = warm_screw(drive, state, driven, way)
        track = advanced(machine, advance(machine), state, driven[None])
        if drive is not None:
            scale = warm_scale(drive, state, track.step(-1), step)
            track = replace(track, drive=np.concatenate([screw, scale])[None])
        state = track.step(-1).state
        yield track


def _in_step(
    moving: MovingMachine, course: History, state: State, ends: tuple[float, float]
) -> tuple[CondensedMachine, float]:
    """The machine in the step between two times (s), and its heat of running friction, W."""
    position, way = float(course(np.array(ends[1]))), distance(course, *ends)
    if way == 0.0:
        return moving.standing(position), 0.0
    heat = moving.guideway.friction_heat(state.pressure, way, moving.machine.thermal.step)
    total = float(heat.sum())
    shares = shares_of(moving.guideway.positions, course, *ends)
    spread = heat / total if total > 0.0 else heat
    return moving.moving(shares, position, spread), total * moving.copies
