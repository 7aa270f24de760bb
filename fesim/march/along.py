"""A march along known inputs: from block to block in machine code, where it can be.

A step that machine code leaves is taken plainly, and machine code goes on from there.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from artefacts.arrays import Array
from fesim.march.stepping import (
    Advance,
    CondensedMachine,
    State,
    Step,
    advanced,
    initial_state,
    load_factors,
    staggered,
)
from fesim.march.track import Track, kernel_track, track_of

#: Steps of a block: their amplitudes stay in the processor's cache.
BLOCK = 128


def at_rest(machine: CondensedMachine, inputs: Array | None = None) -> Step:
    """Row zero of a response: the machine at ambient temperature, at its preload, under its loads.

    Parameters
    ----------
    machine : CondensedMachine
        What will march.
    inputs : ndarray, shape (k + l,), optional
        At time zero; only the factors of mechanical loads count. Default: no load.
    """
    if inputs is None:
        loads = 0 if machine.loads is None else machine.loads.gap.shape[1]
        inputs = np.zeros(machine.thermal.inputs.shape[1] + loads)
    state, elastic = initial_state(machine, inputs), machine.elastic
    displacement = np.zeros(elastic.probe_thermal.shape[0])
    remainder = np.zeros(3 * machine.contacts)
    if state.gap.any():
        value = machine.traction(state.gap, state.slip).value
        remainder = value.ravel() + elastic.reference * state.gap.ravel()
        displacement = elastic.probe_compliance @ (elastic.area * remainder)
    driven = np.zeros(len(inputs))
    if machine.loads is not None:
        factors = load_factors(machine, inputs)
        driven[machine.thermal.inputs.shape[1] :] = factors
        displacement = displacement + machine.loads.probes @ factors
    return Step(
        state=state,
        inputs=driven,
        conductance=machine.conductance_in(state),
        heat_flow=np.zeros(machine.contacts),
        displacement=displacement,
        remainder=remainder,
        residual=0.0,
        iterations=0,
        cuts=0,
        heat_balance=0.0,
    )


def march_along(
    machine: CondensedMachine, inputs: Array, advance: Advance, start: State
) -> Iterator[Track]:
    """Yield the steps of a march along known inputs, some at a time.

    Parameters
    ----------
    machine : CondensedMachine
        What marches.
    inputs : ndarray, shape (n, k + l)
        Of each step, as `fesim.march.stepping.march` takes them one by one.
    advance : callable
        `staggered` or `iterated`.
    start : State
        Where to go on.

    Raises
    ------
    ConvergenceError, InputError
        As `march` does, after what came before is yielded.
    """
    compiled = machine.kernel is not None and advance is staggered
    state, done = start, 0
    while done < len(inputs):
        track = None
        if compiled:
            track = kernel_track(machine, state, inputs[done : done + BLOCK])
        if track is None:
            track = track_of(advanced(machine, advance, state, inputs[done]))
        done += len(track)
        state = track.step(-1).state
        yield track
