"""Second-order march with step sizes chosen by estimated errors (docs/march.md).

Heat conduction is exact on the modes except for the joint heat flows, which are linear in a step
(`fesim.march.exponential`); pressure and conductance agree at its end (`iterated_step`); slip is
extrapolated (`fesim.march.slip_path`). Steps end at every knot of the inputs, never at the
requested times: there the joints are settled separately, and no later step depends on the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from fesim.case.history import Histories
from fesim.march.adaptive_state import (
    Asked,
    Now,
    Passed,
    Solving,
    StepEnds,
    no_effort,
    unpacked,
)
from fesim.march.exponential import Ends, ExponentialStep, exponential_step, heat_spread
from fesim.march.iteration import iterated_step
from fesim.march.machine import CondensedMachine, State, Step
from fesim.march.settling import displaced
from fesim.march.slip_path import origin, settled_at, slip_path
from fesim.march.step import said_at
from fesim.march.step_control import (
    BRIEF,
    ROUNDING,
    Pace,
    StepError,
    Tolerance,
    allowed,
    bent_over,
    least,
    next_pace,
    of_allowed,
    retreated,
    shorter,
    stretch,
    until,
)
from fesim.march.track import Track, joined, track_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, ThermojointError
from thermojoint.artefacts.units import MEGA

if TYPE_CHECKING:
    from fesim.march.adaptive_kernel import FreeMarch

#: Number of step lengths whose weights are kept.
KEPT = 4
#: Inputs whose difference is below this fraction of the largest are the same.
ALIKE = 1e-6


@dataclass(frozen=True)
class _March:
    """Data that do not change from step to step."""

    #: The simulated machine.
    machine: CondensedMachine
    #: Weights of a step as a function of its length, s.
    weights: Callable[[float], ExponentialStep]
    #: `fesim.march.exponential.heat_spread`.
    spread: float


@dataclass(frozen=True)
class _Tried:
    """A computed step, not yet accepted."""

    #: Result at its end.
    step: Step
    #: Weights of its length.
    weights: ExponentialStep
    #: Inputs and joint heat flows at its start and end.
    ends: Ends
    #: State at its end without extrapolated slip.
    once: State
    #: Estimated error.
    error: StepError


def march_adaptively(  # noqa: PLR0913 - the last is optional
    machine: CondensedMachine,
    rates: Array,
    drive: Histories,
    times: Array,
    tolerance: Tolerance,
    start: State,
    judge: Callable[[StepEnds], None] = lambda ends: None,
) -> Iterator[tuple[Track, Passed]]:
    """Yield the machine at given times, in blocks, and the march after each block.

    Parameters
    ----------
    machine : CondensedMachine
        With the modes of a reduced thermal model.
    rates : ndarray, shape (r,)
        Decay rates of the modes, 1/s.
    drive : Histories
        Inputs (k + l,) as functions of time, s.
    times : ndarray, shape (n,)
        Ascending, s. State k of the tracks has the index of `start` + k + 1.
    tolerance : Tolerance
        For the sum of the errors of the steps in half an hour.
    start : State
        State at time zero, or one that contains the march before these times (`Now.packed`).
    judge : callable, optional
        Called with the ends of steps; raises an error if such a state is not allowed.

    Raises
    ------
    ConvergenceError
        The shortest step has no solution, or is estimated to be off by more than the tolerance.
    InputError
        A pressure is beyond the conductance law.
    """
    weights = lru_cache(maxsize=KEPT)(partial(exponential_step, machine, rates))
    march = _March(machine, weights, heat_spread(machine.thermal, rates))
    knots = np.append(drive.times[drive.times > 0.0], np.inf)
    fast, usual, given = _compiled(machine, rates), True, 0
    now = _resumed(machine, drive, start) if start.course.size else _begun(machine, drive, start)
    while given < len(times):
        asked, index = Asked(drive, knots, times[given:], tolerance), start.index + given + 1
        if fast is None or not usual:
            (track, passed), usual = _plain_step(march, now, asked, index), True
        else:
            track, passed, usual = fast.run(now, asked, index)
        judge(passed.ends.until(float(times[-1])))
        now = passed.now
        if track is not None:
            yield track, passed
            given += len(track)


def _compiled(machine: CondensedMachine, rates: Array) -> FreeMarch | None:
    if not machine.contact.count:
        return None
    # Imported here because it loads a compiler, which structures without joints do not need.
    from fesim.march.adaptive_kernel import free_march

    return free_march(machine, rates)


def _plain_step(march: _March, now: Now, asked: Asked, index: int) -> tuple[Track | None, Passed]:
    """Take a step; `index` is that of the first requested time in it."""
    at = int(np.searchsorted(asked.knots, now.time, side="right"))
    knot, before = float(asked.knots[at]), float(asked.knots[at - 1]) if at else 0.0
    tried, pace, rejected = _accepted(march, asked, now, before, knot)
    length, solving = tried.weights.length, now.solving.and_of(tried.step)
    end = knot if length == knot - now.time else now.time + length
    due = asked.times[: np.searchsorted(asked.times, end * (1.0 + ROUNDING), side="right")]
    effort, track = now.effort.with_step(length, tried.error, rejected), None
    fields = (tried.step.state.temperature, tried.step.remainder, tried.step.state.pressure)
    ends = StepEnds(np.array([end]), *(each[None] for each in fields))
    if due.size:
        shares = np.where(due >= end * (1.0 - ROUNDING), 1.0, (due - now.time) / length)
        steps = [_within(march.machine, now, tried, float(share)) for share in shares]
        track, solving = _reported(steps, solving, index), Solving()
    if due.size == asked.times.size:
        return track, Passed(effort, now, ends)
    after = _after(now, tried, end, knot - before < BRIEF)
    after = replace(after, pace=pace, effort=effort, solving=solving)
    return track, Passed(effort, after, ends)


def _resumed(machine: CondensedMachine, drive: Histories, start: State) -> Now:
    """The march stored in a state; a new one from its time if other inputs led to it.

    That time may lie within a step, in which the inputs are linear.
    """
    axes = len(machine.contact.elastic.probe_thermal)
    now, last = unpacked(start, drive.values.shape[1], axes)
    span = np.array([now.time, start.index * machine.thermal.step])
    within = (drive.times > span[0] * (1.0 + ROUNDING)) & (drive.times < span[1] * (1.0 - ROUNDING))
    apart = np.abs(drive(span) - [now.inputs, last])
    if within.any() or (apart > ALIKE * np.abs(drive.values).max(axis=0)).any():
        return replace(_begun(machine, drive, start), effort=now.effort)
    return now


def _begun(machine: CondensedMachine, drive: Histories, start: State) -> Now:
    """The march at a state, settled at the prescribed temperatures just after its time."""
    time = start.index * machine.thermal.step
    thermal, inputs = machine.thermal, drive(time)
    held = thermal.capacity_rate.diagonal() == 0.0
    temperature = start.temperature.copy()
    temperature[held] = thermal.inputs[held] @ inputs[: thermal.inputs.shape[1]]
    settled, _ = settled_at(machine, start, temperature, inputs)
    pressure = machine.contact.preload + settled.traction.value[0]
    state = replace(start, temperature=temperature, gap=settled.gap, pressure=pressure)
    state = replace(state, slip=settled.traction.slip)
    area = machine.contact.elastic.area[: machine.contact.count]
    flow = machine.conductance_in(state) * area * (thermal.jump @ temperature)
    none = no_effort(len(machine.contact.elastic.probe_thermal), len(flow))
    return Now(time, state, inputs, flow, np.zeros_like(flow), 0.0, Pace(), none)


def _after(now: Now, tried: _Tried, end: float, edge: bool) -> Now:
    """The march after an accepted step; the flows' slope within an edge is not used later."""
    step, length, ends = tried.step, tried.weights.length, tried.ends
    after = replace(now, time=end, state=step.state, inputs=ends.inputs[1], flow=ends.flow[1])
    if step.cuts:
        return replace(after, slope=np.zeros_like(now.slope), length=0.0)
    if edge:
        return after
    return replace(after, slope=(after.flow - now.flow) / length, length=length)


def _accepted(
    march: _March, asked: Asked, now: Now, before: float, knot: float
) -> tuple[_Tried, Pace, int]:
    """The next step between two knots, the pace after it, and the number of rejected steps."""
    rejected, pace, times, tolerance = 0, now.pace, stretch(knot - before), asked.tolerance
    while True:
        length = until(pace.length, knot - now.time)
        last_chance = length <= least(times)
        try:
            tried = _tried(march, now, asked.drive(now.time + length), length, now.time == before)
            part, (moved, warmed) = tried.error.relative_to(tolerance), tried.error.largest()
            changed = _changed(march, now.state, tried)
            free = pace.way > tolerance.temperature
            followed = np.inf if free else tolerance.followed * changed
            ratio = of_allowed(part, allowed(times * length), warmed, followed)
            # The length of the step does not influence a snap-through.
            snaps = tried.step.cuts > 0 and times * length <= BRIEF
            if ratio <= 1.0 or ((snaps or last_chance) and part <= 1.0):
                return tried, next_pace(pace, length, ratio, changed), rejected
            if last_chance:
                # Perhaps because a body is coming loose.
                if (watch := march.machine.contact.watch) is not None:
                    watch.explain(march.machine.contact.traction(now.state.gap, now.state.slip))
                raise ConvergenceError(
                    f"the shortest step of {length:.2g} s is estimated to be off by "
                    f"{MEGA * moved:.2g} um and {warmed:.2g} K; raise march.tolerance_um and "
                    "march.tolerance_K"
                )
            pace = shorter(pace, length, ratio)
        except ThermojointError as error:
            if last_chance:
                raise said_at(now.time + length, error) from error
            pace = retreated(pace, length)
        rejected += 1


def _changed(march: _March, before: State, tried: _Tried) -> float:
    """Temperature change in a step, K: root mean square weighted by heat capacity."""
    count = tried.weights.rates.size
    change = tried.step.state.temperature[:count] - before.temperature[:count]
    return float(np.linalg.norm(change)) / march.spread


def _tried(march: _March, now: Now, inputs: Array, length: float, begins: bool) -> _Tried:
    """Compute a step to some inputs, which may begin at a knot; the state before is unchanged."""
    machine, weights, before = march.machine, march.weights(length), now.state
    half = weights.before_end(before.temperature, now.inputs, now.flow)
    further = length / now.length if now.length else 0.0
    begun = replace(before, temperature=half, change=further * before.change)
    step = iterated_step(weights.machine, begun, inputs)
    ends = Ends((now.inputs, inputs), (now.flow, step.heat_flow))
    unknowns = step.state.temperature

    def course(share: float) -> tuple[Array, Array]:
        return weights.within(before.temperature, ends, share), ends.inputs_at(share)

    slope = (step.heat_flow - now.flow) / length
    bend = (slope - now.slope) / bent_over(length, now.length, begins)
    area = machine.contact.elastic.area[: machine.contact.count]
    lacking = weights.lacking(bend, area * step.conductance)
    slip = step.state.slip if step.cuts else before.slip
    other = _settled_from(machine, step, slip, unknowns + lacking)
    off, once = other.displacement - step.displacement, step
    path = None if step.cuts else slip_path(machine, before, course, step.state)
    if path is not None:
        near = replace(step, state=replace(step.state, gap=path.gap))
        step = _settled_from(machine, near, path.origin, unknowns)
        off = off + path.doubt * (step.displacement - once.displacement)
    both = [rows @ lacking for rows in (machine.thermal.mean, machine.thermal.jump)]
    error = StepError(off, np.concatenate(both))
    state = replace(step.state, change=step.state.gap - before.gap)
    balance = weights.balance(before.temperature, unknowns, ends)
    conductance = machine.conductance_in(state)
    step = replace(step, state=state, conductance=conductance, heat_balance=balance)
    return _Tried(step, weights, ends, once.state, error)


def _within(machine: CondensedMachine, now: Now, tried: _Tried, share: float) -> Step:
    """The machine after a fraction of an accepted step, settled from the slip at its start.

    The extrapolated part of the slip grows with the square of the time.
    """
    if share == 1.0:
        return tried.step
    before, ends = now.state, tried.ends
    unknowns, inputs = tried.weights.within(before.temperature, ends, share), ends.inputs_at(share)
    change = share * (tried.step.state.gap - before.gap)
    near = replace(tried.step, state=replace(before, gap=before.gap + change), inputs=inputs)
    step = _settled_from(machine, near, before.slip, unknowns)
    slides, end, once = (step.state.slip != before.slip).any(axis=0), tried.step.state, tried.once
    if slides.any():
        gap = step.state.gap + share**2 * (end.gap - once.gap)
        slip = step.state.slip + np.where(slides, share**2 * (end.slip - once.slip), 0.0)
        near = replace(step, state=replace(step.state, gap=gap))
        begun = origin(before.slip, step.state.gap, gap, slip, slides)
        step = _settled_from(machine, near, begun, unknowns)
    return replace(
        step,
        heat_flow=ends.flow_at(share),
        conductance=machine.conductance_in(step.state),
    )


def _settled_from(machine: CondensedMachine, step: Step, slip: Array, unknowns: Array) -> Step:
    """A step with other temperatures, its joints settled again from another slip."""
    near = replace(step.state, slip=slip, change=np.zeros_like(step.state.change))
    settled, cuts = settled_at(machine, near, unknowns, step.inputs)
    remainder, displacement = displaced(machine, unknowns, settled, step.inputs)
    state = replace(
        near,
        temperature=unknowns,
        gap=settled.gap,
        slip=settled.traction.slip,
        pressure=machine.contact.preload + settled.traction.value[0],
    )
    return replace(
        step,
        state=state,
        displacement=displacement,
        remainder=remainder,
        residual=max(step.residual, settled.residual),
        iterations=step.iterations + settled.iterations,
        cuts=step.cuts + cuts,
    )


def _reported(steps: Sequence[Step], solving: Solving, index: int) -> Track:
    """Rows of a response, with the solver figures of all steps since the previous row."""
    rows = []
    for k, step in enumerate(steps):
        rows.append(
            replace(
                step,
                state=replace(step.state, index=index + k),
                residual=max(step.residual, solving.residual),
                heat_balance=solving.heat_balance,
                iterations=0 if k else solving.iterations,
                cuts=0 if k else solving.cuts,
            )
        )
    return joined([track_of(row) for row in rows])
