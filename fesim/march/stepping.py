"""Time stepping of heat and contact on the condensed structure (docs/march.md).

No step factorises or assembles anything, or allocates arrays of mesh size other than the
temperature field. `march` is a generator of steps; a step's state is enough to continue with
identical results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from fesim.march.alternation import (
    GAIN,
    LARGE,
    STUBBORN,
    alternating,
    gain_of,
    suspected,
    turnings,
)
from fesim.march.half_step import can_be_halved
from fesim.march.iteration import carried_by, divided_step
from fesim.march.machine import CondensedMachine, State, Step
from fesim.march.settling import initial_state, settled_between
from fesim.march.step import said_at, step_with
from fesim.march.track import Track, first_of, kernel_march, track_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, ThermojointError

#: Largest number of parts into which alternating steps are divided.
MOST_PARTS = 16
#: Steps in a block, whose amplitudes fit into the processor's cache.
BLOCK = 128

#: Time at the end of a step (s) to the inputs (k + l,): sources, W; ambient and held surfaces, K;
#: factors of the mechanical loads.
Inputs = Callable[[float], Array]
#: From a state and inputs (n, k + l) to one or more of these steps.
Take = Callable[[State, Array], Track]
#: Starts a march of a machine; data stored between its steps belong to that march alone.
Advance = Callable[[CondensedMachine], Take]


def march(
    machine: CondensedMachine, inputs: Inputs, advance: Advance, start: State | None = None
) -> Iterator[Step]:
    """Yield an endless series of steps.

    Parameters
    ----------
    machine : CondensedMachine
        The machine.
    inputs : callable
        Time (s) to the inputs (k + l,); implicit Euler takes them at the end of each step.
    advance : callable
        `staggered` or `iterated`.
    start : State, optional
        State to continue from; default `initial_state`.

    Raises
    ------
    ConvergenceError
        A step has no equilibrium, or a body has come loose; that step is not yielded.
    InputError
        A pressure is beyond the conductance law.
    """
    state = start if start is not None else initial_state(machine, inputs(0.0))
    take = advance(machine)
    while True:
        driven = inputs((state.index + 1) * machine.thermal.step)
        step = advanced(machine, take, state, driven[None]).step(0)
        state = step.state
        yield step


def march_along(
    machine: CondensedMachine,
    inputs: Array,
    advance: Advance,
    start: State,
    between: Mapping[int, Array] | None = None,
) -> Iterator[Track]:
    """Yield the steps of a march under known inputs, several at a time.

    Parameters
    ----------
    machine : CondensedMachine
        The machine.
    inputs : ndarray, shape (n, k + l)
        Inputs of each step, as for `fesim.march.stepping.march`.
    advance : callable
        `staggered` or `iterated`.
    start : State
        State to continue from.
    between : mapping of int to ndarray, shape (j, l), optional
        Row of `inputs` to the factors of the loads at reversals within that step.

    Raises
    ------
    ConvergenceError, InputError
        As `march`, after the preceding steps have been yielded.
    """
    return tracks_along(machine, advance(machine), inputs, start, between)


def tracks_along(
    machine: CondensedMachine,
    take: Take,
    inputs: Array,
    start: State,
    between: Mapping[int, Array] | None = None,
) -> Iterator[Track]:
    """Yield the next steps of a started march; otherwise as `march_along`."""
    state, done, turns = start, 0, between or {}
    ends = [*sorted(turns), len(inputs)]
    while done < len(inputs):
        step, end = take, min(one for one in ends if one > done)
        if done in turns:
            step = _after(machine, take, turns[done])
        track = advanced(machine, step, state, inputs[done : min(done + BLOCK, end)])
        done += len(track)
        state = track.step(-1).state
        yield track


def _after(machine: CondensedMachine, take: Take, factors: Array) -> Take:
    """Take the steps after load reversals within the first one."""
    return lambda state, inputs: take(settled_between(machine, state, factors), inputs)


def advanced(machine: CondensedMachine, take: Take, state: State, inputs: Array) -> Track:
    """Take one step or more; an error message contains the time of the step.

    Raises
    ------
    ConvergenceError, InputError
        As `march`.
    """
    try:
        return take(state, inputs)
    except ThermojointError as error:
        raise said_at((state.index + 1) * machine.thermal.step, error) from error


def staggered(machine: CondensedMachine) -> Take:
    """Steps with the conductance at the pressure of the previous step, as in the paper.

    Once they alternate, the march continues with `iterated` ones, in more parts if those alternate,
    too.
    """
    fast = kernel_march(machine)
    if fast is None:
        return plainly_staggered(machine)

    def take(state: State, inputs: Array) -> Track:
        if _alternates(machine, state, inputs[0]):
            return _taken_over(machine, state, inputs[0])
        track = fast(state, inputs)
        if track is None:
            track = track_of(_staggered_step(machine, state, inputs[0]))
        return _steady(machine, _watched(machine, state, track), inputs)

    return take


def plainly_staggered(machine: CondensedMachine) -> Take:
    """The same steps without the compiled march: the reference implementation."""

    def take(state: State, inputs: Array) -> Track:
        step = None if state.parts else _steady_step(machine, state, inputs[0])
        if step is None:
            return _taken_over(machine, state, inputs[0])
        return _watched(machine, state, track_of(step))

    return take


def _staggered_step(machine: CondensedMachine, state: State, inputs: Array) -> Step:
    return step_with(machine, state, inputs, machine.conductance_in(state))


def _taken_over(machine: CondensedMachine, state: State, inputs: Array) -> Track:
    """Take an iterated step, like all later ones; in more parts if they alternate."""
    parts = max(state.parts, 1)
    step = divided_step(machine, state, inputs, parts)
    carried = carried_by(machine, state)
    moved = (carried.of(step.state) - carried.of(state)) / carried.scale
    turning = turnings(state.turning, moved[None])[0]
    if state.parts and _lasts(state.turning, turning) and can_be_halved(machine):
        parts = min(2 * parts, MOST_PARTS)
    return track_of(replace(step, state=replace(step.state, turning=turning, parts=parts)))


def _lasts(before: Array, turning: Array) -> bool:
    """Whether increments change sign and hardly decay, from the records (3, m) of two steps."""
    which = suspected(turning)
    return bool(which.any()) and gain_of(before[0, which], turning[0, which]) > GAIN


def _watched(machine: CondensedMachine, before: State, track: Track) -> Track:
    """Record sign changes of the increments in a track."""
    if not machine.contact.count:
        return track
    carried = carried_by(machine, before)
    values = track.pressure
    if not machine.contact.conducts_by_pressure:
        values = np.array([carried.of(track.step(at).state) for at in range(len(track))])
    moved = np.diff(np.vstack([carried.of(before), values]), axis=0) / carried.scale
    return replace(track, turning=turnings(before.turning, moved))


def _steady(machine: CondensedMachine, track: Track, inputs: Array) -> Track:
    """The steps of a track before they alternate; all if they do not."""
    for at in np.flatnonzero(suspected(track.turning[:-1]).any(axis=1)):
        if _alternates(machine, track.step(int(at)).state, inputs[at + 1]):
            return first_of(track, int(at) + 1)
    return track


def _alternates(machine: CondensedMachine, state: State, inputs: Array) -> bool:
    """Whether the next step is an iterated one, because staggered ones alternate."""
    if state.parts:
        return True
    doubtful = bool(suspected(state.turning).any())
    return doubtful and _steady_step(machine, state, inputs) is None


def _steady_step(machine: CondensedMachine, state: State, inputs: Array) -> Step | None:
    """Take a staggered step; None if its map's gain shows that such steps alternate."""
    which = suspected(state.turning)
    if not which.any():
        return _staggered_step(machine, state, inputs)
    carried = carried_by(machine, state)
    before = carried.of(state)
    # If a step has no equilibrium, the iteration finds another one or raises the error.
    with suppress(ConvergenceError):
        step = step_with(machine, state, inputs, carried.conductance(before))
        once = carried.of(step.state)
        again = step_with(machine, state, inputs, carried.conductance(once))
        moved = (once - before, carried.of(again.state) - once)
        steady = gain_of(*((each / carried.scale)[which] for each in moved)) <= GAIN
        large = np.abs(state.turning[0, which]).max() > LARGE
        if steady and not (large and _goes_on(machine, state, inputs)):
            return step
    return None


def _goes_on(machine: CondensedMachine, state: State, inputs: Array) -> bool:
    """Whether staggered steps oscillate while these inputs are constant.

    If the joint opens and the bodies must warm up before it closes, the period is three steps or
    more, and the gain over one step is no criterion.
    """
    carried = carried_by(machine, state)
    values = [carried.of(state)]
    none = np.zeros_like(state.turning)
    for _ in range(3 * STUBBORN):
        state = _staggered_step(machine, state, inputs).state
        values.append(carried.of(state))
        record = turnings(none, np.diff(values, axis=0) / carried.scale)
        if len(values) > STUBBORN and not suspected(record[-STUBBORN:]).any():
            return False
    return alternating(np.array(values) / carried.scale)


def iterated(machine: CondensedMachine) -> Take:
    """Steps with the conductance at the pressure at their end, unless the joint snaps."""
    return lambda state, inputs: track_of(divided_step(machine, state, inputs[0]))
