"""Time stepping of a machine with moving axes.

A step conducts heat between pads and the stations that they pass in it, according to their shares
of the time, and settles the joints at the positions at its end. Screws are stepped first, and
their heat enters the machine in the same step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fesim.axes.axis import Axis, parts_of, place_of
from fesim.axes.machine import MovingMachine
from fesim.axes.occupation import distance, shares_of, stretches
from fesim.axes.positioning import Way, warm_scale, warm_screw
from fesim.march.machine import CondensedMachine, State
from fesim.march.stepping import Advance, advanced, iterated, plainly_staggered
from fesim.march.track import Track
from thermojoint.artefacts.arrays import Array

#: Number of steps per compiled call, at most and after a plain one; their aligned positions share
#: an array.
BLOCK, FEW = 64, 4


def march_moving(
    moving: MovingMachine, axes: Sequence[Axis], inputs: Array, advance: Advance, start: State
) -> Iterator[Track]:
    """Yield the steps of a march, one by one.

    Parameters
    ----------
    moving : MovingMachine
        The machine.
    axes : sequence of Axis
        Its axes; the states of their drives are part of that of the march.
    inputs : ndarray, shape (n, k)
        Inputs of each step; the last ones, the frictional heat of motion of each axis, and those of
        the drives are filled in.
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
    state, step, parts = start, moving.machine.thermal.step, parts_of(axes)
    for row in inputs:
        ends = state.index * step, (state.index + 1) * step
        machine, friction = _in_step(moving, axes, state, ends)
        driven, screws = row.copy(), []
        driven[-len(axes) :] = friction
        before = [replace(state, drive=state.drive[part]) for part in parts]
        for axis, own in zip(axes, before, strict=True):
            if axis.drive is not None:
                way = Way(*stretches(axis.course, *ends))
                screw, driven = warm_screw(axis.drive, own, driven, way)
                screws.append(screw)
        track = advanced(machine, advance(machine), state, driven[None])
        if screws:
            taken = track.step(-1)
            driving = [(axis.drive, own) for axis, own in zip(axes, before, strict=True)]
            scales = [warm_scale(drive, own, taken, step) for drive, own in driving if drive]
            each = (part for pair in zip(screws, scales, strict=True) for part in pair)
            track = replace(track, drive=np.concatenate(list(each))[None])
        state = track.step(-1).state
        yield track


def march_iterated(
    moving: MovingMachine, axes: Sequence[Axis], inputs: Array, start: State
) -> Iterator[Track]:
    """Yield the steps of `march_moving` with iterated coupling."""
    return march_moving(moving, axes, inputs, iterated, start)


def march_staggered(
    moving: MovingMachine, axes: Sequence[Axis], inputs: Array, start: State
) -> Iterator[Track]:
    """Yield the steps of `march_moving` with staggered coupling, one or more at a time.

    They are compiled if possible.
    """
    # Imported here because it loads a compiler, as in `fesim.march.contact.gap_solver`.
    from fesim.axes.kernel import axes_march

    compiled, state, done, block = axes_march(moving, axes), start, 0, BLOCK
    while done < len(inputs):
        rows, track = inputs[done : done + block], None
        block = min(2 * block, BLOCK)
        if compiled is not None and not state.parts:
            track = compiled.take(state, rows)
        if track is None:
            (track,), block = march_moving(moving, axes, rows[:1], plainly_staggered, state), FEW
        done, state = done + len(track), track.step(-1).state
        yield track


def _in_step(
    moving: MovingMachine, axes: Sequence[Axis], state: State, ends: tuple[float, float]
) -> tuple[CondensedMachine, Array]:
    """The machine in the step between two times (s), and the frictional heat (axes,) of motion."""
    at = place_of(axes, ends[1])
    ways = [distance(axis.course, *ends) for axis in axes]
    if not any(ways):
        return moving.standing(at), np.zeros(len(axes))
    stations, step = moving.guideway.stations, moving.machine.thermal.step
    heat = moving.guideway.friction_heat(state.pressure, stations.ridden(ways), step)
    shares = [
        shares_of(positions, axis.course, *ends)
        for positions, axis in zip(stations.positions, axes, strict=True)
    ]
    return moving.moving(shares, at, heat.sum(axis=0)), heat.sum(axis=1) * moving.copies
