"""Time stepping of heat and contact on the condensed structure (docs/march.md).

No step factorises or assembles anything, or allocates arrays of mesh size other than the
temperature field. `march` is a generator of steps; a step's state is enough to continue with
identical results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

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
from fesim.march.anderson import accelerated
from fesim.march.half_step import can_be_halved, halved, joined
from fesim.march.machine import CondensedMachine, State, Step
from fesim.march.passing import pass_heat
from fesim.march.secant_step import HeatLoads, HeatTaken, step_heat
from fesim.march.settling import (
    acting_on,
    displaced,
    exerted,
    initial_state,
    loaded_gap,
    settle_along,
    settled_between,
)
from fesim.march.softening import lifted
from fesim.march.track import Track, first_of, kernel_march, track_of
from fesim.solid.friction_heat import GivenHeat, friction_work, given_heat
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, ThermojointError

#: In-step iteration: largest change of a pressure between sweeps, relative to the preload.
PRESSURE_TOLERANCE = 1e-9
#: Smallest and largest weight of a sweep, and the number of sweeps that are weighted.
WEIGHTS = 0.05, 10.0
SEEKING = 400
#: Weight of later sweeps.
RELAXING = 300 * (0.3,) + 400 * (0.1,) + 800 * (0.03,)
#: From this sweep on, agreement within the tolerance of the gap equations is sufficient.
PATIENCE = 20
#: Sweeps after which a step that can be halved is taken anew with accelerated ones, the number of
#: these after which it is halved, and how often it may be.
UNSETTLED, ACCELERATED, HALVINGS = 30, 60, 8
#: Largest change of a pressure in the shortest parts, relative to the preload, for a joint that
#: snaps between two values of the conductance.
SNAPS = 1e-2
#: Parts into which steps are divided at most because longer ones alternate.
MOST_PARTS = 16
#: Largest change of the heat of friction between sweeps, relative to it, and number of sweeps.
FRICTION_TOLERANCE, FRICTION_SWEEPS = 1e-9, 50
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
        Of each step, as `fesim.march.stepping.march` takes them one by one.
    advance : callable
        `staggered` or `iterated`.
    start : State
        State to continue from.
    between : mapping of int to ndarray, shape (j, l), optional
        Row of `inputs` to the factors of the loads at reversals within that step.

    Raises
    ------
    ConvergenceError, InputError
        As `march`, after the steps before are yielded.
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
    """Take one step or more; an error names the step.

    Raises
    ------
    ConvergenceError, InputError
        As `march`.
    """
    try:
        return take(state, inputs)
    except ThermojointError as error:
        time = (state.index + 1) * machine.thermal.step
        raise type(error)(f"step to t = {time:g} s: {error}") from error


def staggered(machine: CondensedMachine) -> Take:
    """Steps in which the last step's pressure sets the conductance, as in the paper.

    Once they alternate, the march continues with `iterated` ones.
    """
    fast, plain = kernel_march(machine), _plain(machine)

    def take(state: State, inputs: Array) -> Track:
        track = None if fast is None else fast(state, inputs)
        return plain(state, inputs) if track is None else track

    return _watching(machine, take)


def plainly_staggered(machine: CondensedMachine) -> Take:
    """The same steps without the compiled march: the reference implementation."""
    return _watching(machine, _plain(machine))


def _plain(machine: CondensedMachine) -> Take:
    return lambda state, inputs: track_of(
        _step_with(machine, state, inputs[0], machine.conductance_in(state))
    )


def _watching(machine: CondensedMachine, take: Take) -> Take:
    """Take steps until they alternate, then iterated ones; these in more parts if they do, too."""
    if not machine.contact.count:
        return take

    def watching(state: State, inputs: Array) -> Track:
        if not state.parts and not _alternates(machine, state, inputs[0]):
            return _watched(machine, state, take(state, inputs))
        parts = max(state.parts, 1)
        step, _ = _divided(machine, state, inputs[0], HALVINGS, parts.bit_length() - 1)
        carried = _carried(machine, state)
        moved = (carried.of(step.state) - carried.of(state)) / carried.scale
        turning = turnings(state.turning, moved[None])[0]
        if state.parts and _lasts(state.turning, turning) and can_be_halved(machine):
            parts = min(2 * parts, MOST_PARTS)
        return track_of(replace(step, state=replace(step.state, turning=turning, parts=parts)))

    return watching


def _record(carried: _Carried, values: Sequence[Array]) -> Array:
    """Record (n, 3, m) of alternating increments from n + 1 values (m,)."""
    return turnings(np.zeros((3, values[0].size)), np.diff(values, axis=0) / carried.scale)


def _lasts(before: Array, turning: Array) -> bool:
    """Whether increments of steps turn and hardly decay, by the records (3, m) of the last two."""
    which = suspected(turning)
    return bool(which.any()) and gain_of(before[0, which], turning[0, which]) > GAIN


def _watched(machine: CondensedMachine, before: State, track: Track) -> Track:
    """Record sign changes in a track; it ends with the first step that may alternate."""
    carried = _carried(machine, before)
    values = track.pressure
    if not machine.contact.conducts_by_pressure:
        values = np.array([carried.of(track.step(at).state) for at in range(len(track))])
    moved = np.diff(np.vstack([carried.of(before), values]), axis=0) / carried.scale
    turning = turnings(before.turning, moved)
    found = np.flatnonzero(suspected(turning).any(axis=1))
    last = int(found[0]) + 1 if found.size else len(track)
    return first_of(replace(track, turning=turning), last)


def _alternates(machine: CondensedMachine, state: State, inputs: Array) -> bool:
    """Whether steps alternate at the next one, by the gain of the staggered map over it."""
    which = suspected(state.turning)
    if not which.any():
        return False
    carried = _carried(machine, state)
    values = [carried.of(state)]
    # Where a step has no equilibrium, the iteration finds another one or raises the error.
    with suppress(ConvergenceError):
        for _ in range(2):
            step = _step_with(machine, state, inputs, carried.conductance(values[-1]))
            values.append(carried.of(step.state))
        once, twice = (np.diff(values, axis=0) / carried.scale)[:, which]
        if gain_of(once, twice) > GAIN:
            return True
        large = np.abs(state.turning[0, which]) > LARGE
        return bool(large.any()) and _goes_on(machine, state, inputs)
    return True


def _goes_on(machine: CondensedMachine, state: State, inputs: Array) -> bool:
    """Whether staggered steps oscillate while these inputs are held.

    Where the joint opens and the bodies must warm up before it closes, the period is of three steps
    or more, and the gain over one step says nothing.
    """
    carried = _carried(machine, state)
    values = [carried.of(state)]
    for _ in range(3 * STUBBORN):
        state = _step_with(machine, state, inputs, machine.conductance_in(state)).state
        values.append(carried.of(state))
        if len(values) > STUBBORN and not suspected(_record(carried, values))[-STUBBORN:].any():
            return False
    return alternating(np.array(values) / carried.scale)


def iterated(machine: CondensedMachine) -> Take:
    """Steps with the conductance of the pressure at their end, unless the joint snaps."""
    return lambda state, inputs: track_of(_divided(machine, state, inputs[0], HALVINGS)[0])


def _divided(
    machine: CondensedMachine, state: State, inputs: Array, halvings: int, least: int = 0
) -> tuple[Step, int]:
    """Take an iterated step, in halves of halves where its sweeps do not settle.

    Returns the step and how often its shortest part was halved, at least `least` times: the second
    half of a step is not tried in longer parts than the first one needed.
    """
    if not can_be_halved(machine):
        return iterated_step(machine, state, inputs), 0
    if not halvings:
        with suppress(_UnsettledError):
            return iterated_step(machine, state, inputs, Sweeps(UNSETTLED, (), 0, SNAPS)), 0
        return iterated_step(machine, state, inputs, Sweeps(snaps=SNAPS)), 0
    if not least:
        for seeking, accelerating in ((UNSETTLED, 0), (0, ACCELERATED)):
            with suppress(_UnsettledError):
                return iterated_step(machine, state, inputs, Sweeps(seeking, (), accelerating)), 0
    shorter = halved(machine)
    first, needed = _divided(shorter, state, inputs, halvings - 1, max(least - 1, 0))
    begun = replace(first.state, index=state.index)
    second, deepest = _divided(shorter, begun, inputs, halvings - 1, needed)
    return joined(first, second), 1 + deepest


class _UnsettledError(ConvergenceError):
    """Pressure and heat flow of a step still change after all sweeps."""


@dataclass(frozen=True)
class Sweeps:
    """How the value that is carried is found: by these sweeps, one kind after the other."""

    #: Number of sweeps with weights by Aitken's method.
    seeking: int = SEEKING
    #: Weights of further ones.
    relaxing: tuple[float, ...] = RELAXING
    #: Number of sweeps with Anderson acceleration.
    accelerating: int = 0
    #: Largest change of a pressure, relative to the preload, in the sweep that is taken where none
    #: settles.
    snaps: float = 0.0


def iterated_step(
    machine: CondensedMachine, state: State, inputs: Array, sweeps: Sweeps = Sweeps()
) -> Step:
    """Take one step of `iterated`.

    Fixed-point iteration. Every sweep starts from the state at the start of the step, so that
    friction sees one increment only; the first takes the pressure of the state. Where a joint snaps
    between two values of the conductance no sweep settles: the one that changes least can be taken,
    with at least one viscous step counted.

    Raises
    ------
    ConvergenceError
        The pressures still change after all sweeps.
    """
    carried = _carried(machine, state)
    value = carried.of(state)
    weight, last = 1.0, np.zeros_like(value)
    iterations = cuts = 0
    taken: list[Array] = []
    misfits: list[Array] = []
    least, closest = np.inf, None
    weighted = sweeps.seeking + len(sweeps.relaxing)
    for sweep in range(weighted + sweeps.accelerating):
        step = _step_with(machine, state, inputs, carried.conductance(value))
        iterations += step.iterations
        cuts += step.cuts
        after = carried.of(step.state)
        misfit = (after - value) / carried.scale
        change = float(np.abs(misfit).max(initial=0.0))
        enough = PRESSURE_TOLERANCE if sweep < PATIENCE else left_open(machine)
        # Where the joint snaps, the pressure jumps: it cannot agree with the conductance before.
        if change <= enough or step.cuts > 0:
            return replace(step, iterations=iterations, cuts=cuts)
        if change < least:
            least, closest = change, step
        # First guess of the next sweep: equal gaps give equal pressures, while another guess would
        # keep changing them within the tolerance of the gap equations.
        state = replace(state, change=step.state.change)
        slow = change > 0.5 * float(np.abs(last).max(initial=0.0))
        ends = 0.5 * np.minimum(value, after), 2.0 * np.maximum(value, after)
        if sweep >= weighted:
            taken.append(value / carried.scale)
            misfits.append(misfit)
            value = np.clip(carried.scale * accelerated(taken, misfits), *ends)
            continue
        if sweep >= sweeps.seeking:
            weight = sweeps.relaxing[sweep - sweeps.seeking]
        elif slow:
            weight = _aitken(weight, last, misfit)
        last = misfit
        value = np.clip(value + weight * (after - value), *ends)
    if closest is not None and least <= sweeps.snaps:
        return replace(closest, iterations=iterations, cuts=cuts + 1)
    raise _UnsettledError(
        f"in-step iteration: pressure and heat flow drive each other: {change:.1e} of the preload "
        f"after {sweep + 1} sweeps; take a shorter march.step_s"
    )


@dataclass(frozen=True)
class _Carried:
    """Quantity carried from one sweep of an in-step iteration to the next, m values."""

    #: Returns it for a state.
    of: Callable[[State], Array]
    #: Returns conductances, W/(m2 K).
    conductance: Callable[[Array], Array]
    #: Shape (m,): scale of its changes.
    scale: Array


def _carried(machine: CondensedMachine, state: State) -> _Carried:
    """Pressures; or conductances, if they depend on openings or temperatures as well."""
    if machine.contact.conducts_by_pressure:
        pressures = machine.contact.reference_pressure
        return _Carried(lambda settled: settled.pressure, machine.contact.conductance, pressures)
    given = machine.conductance_in(state)
    scale = np.where(given > 0.0, given, 1.0)
    return _Carried(machine.conductance_in, lambda values: values, scale)


def left_open(machine: CondensedMachine) -> float:
    """Return ten times the tolerance of the gaps as one of pressures, relative to the preload."""
    stiffness = machine.contact.gap_problem.springs[: machine.contact.count]
    left = 10.0 * machine.contact.tolerance * stiffness / machine.contact.reference_pressure
    return float(left.max(initial=PRESSURE_TOLERANCE))


def _aitken(weight: float, last: Array, misfit: Array) -> float:
    """Weight of the next sweep by Aitken's method (Irons & Tuck 1969), where sweeps settle slowly.

    Growing sweeps leave an unstable state; full steps lead to a stable one.
    """
    turn = misfit - last
    if last @ turn >= 0.0:
        return 1.0
    return float(np.clip(-weight * (last @ turn) / (turn @ turn), *WEIGHTS))


def _conducted(machine: CondensedMachine, temperature: Array, loads: HeatLoads) -> HeatTaken:
    if machine.passing is not None:
        return pass_heat(machine.thermal, machine.passing, temperature, loads.inputs, loads.joint)
    return step_heat(machine.thermal, machine.variable, temperature, loads)


def _step_with(machine: CondensedMachine, state: State, inputs: Array, conductance: Array) -> Step:
    """Take a step with given conductances (m,), W/(m2 K)."""
    take = partial(_step_heated, machine, state, inputs, conductance)
    return take() if machine.friction is None else _with_friction(machine, state.slip, take)


def _with_friction(
    machine: CondensedMachine, before: Array, take: Callable[[GivenHeat], Step]
) -> Step:
    """Repeat a step until the heat that entered is the work of friction in it."""
    length, friction, contact = machine.thermal.step, machine.friction, machine.contact
    assert friction is not None
    # Work that the tolerance of the gap equations leaves open.
    area = contact.elastic.area[: contact.count]
    least = float((area * contact.reference_pressure).max()) * contact.tolerance / length
    power = np.zeros(contact.count)
    for _ in range(FRICTION_SWEEPS):
        step = take(given_heat(friction, power))
        moved = (step.state.slip - before)[None]
        work = friction_work(contact.elastic, step.remainder[None], step.state.gap[None], moved)[0]
        change, power = work / length - power, work / length
        if np.abs(change).max() <= FRICTION_TOLERANCE * np.abs(power).max() + least:
            return step
    raise ConvergenceError(
        "the heat of friction still changes the slip after "
        f"{FRICTION_SWEEPS} sweeps; take a shorter march.step_s"
    )


def _step_heated(
    machine: CondensedMachine,
    state: State,
    inputs: Array,
    conductance: Array,
    given: GivenHeat | None = None,
) -> Step:
    count = machine.contact.count
    elastic = machine.contact.elastic
    thermal = inputs if machine.contact.loads is None else inputs[: machine.thermal.inputs.shape[1]]
    joint = conductance * elastic.area[:count]
    loads = HeatLoads(thermal, joint, given)
    heat = _conducted(machine, state.temperature, loads)
    strained = machine.strained(heat.temperature)
    thermal_gap = loaded_gap(machine, elastic.thermal_gap @ strained, inputs)
    added = None
    if machine.stiffness is not None:
        without = thermal_gap

        def settle(added: Array) -> Array:
            found, _ = settle_along(machine.contact, state, without + added)
            return exerted(machine.contact, found.gap, found.traction.value)

        lift = lifted(machine.stiffness, acting_on(machine, heat.temperature, inputs), settle)
        thermal_gap, added = without + lift.gap, lift.probes
    settled, cuts = settle_along(machine.contact, state, thermal_gap)
    pressure = machine.contact.preload + settled.traction.value[0]
    if machine.contact.watch is not None:
        machine.contact.watch.check(pressure, settled.traction.tangent)
    remainder, displacement = displaced(machine, strained, settled, inputs)
    if added is not None:
        displacement = displacement + added
    return Step(
        state=State(
            index=state.index + 1,
            temperature=heat.temperature,
            gap=settled.gap,
            slip=settled.traction.slip,
            pressure=pressure,
            change=settled.gap - state.gap,
            model=machine.thermal.model,
            frozen=np.zeros_like(state.frozen),
            turning=state.turning,
            parts=state.parts,
            drive=state.drive,
        ),
        inputs=inputs,
        conductance=conductance,
        heat_flow=heat.heat_flow,
        displacement=displacement,
        remainder=remainder,
        residual=settled.residual,
        iterations=settled.iterations,
        cuts=cuts,
        heat_balance=heat.balance,
        secant_residual=heat.residual,
    )
