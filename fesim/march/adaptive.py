"""March of second order whose steps are chosen by estimated errors (docs/march.md).

Heat is exact on the modes but for the joint heat flows, which are linear in a step
(`fesim.march.exponential`); pressure and conductance agree at its end (`iterated_step`); slip is
extrapolated (`fesim.march.slip_path`). Steps end at every knot of what drives the machine, never at
the times that are asked for: there the joints are settled once more, and nothing depends on it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from fesim.case.history import Histories
from fesim.march.exponential import Ends, ExponentialStep, exponential_step
from fesim.march.machine import CondensedMachine, State, Step
from fesim.march.settling import displaced
from fesim.march.slip_path import settled_at, slip_path
from fesim.march.step_control import (
    SHORTEST,
    Pace,
    StepError,
    Tolerance,
    allowed,
    next_pace,
    retreated,
    shorter,
    until,
)
from fesim.march.stepping import iterated_step
from fesim.march.track import Track, joined, track_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError, ThermojointError
from thermojoint.artefacts.units import MEGA

#: Weights of so many lengths are kept.
KEPT = 4
#: Times that differ by less than this part are the same.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Effort:
    """Steps of an adaptive march so far, and what they are estimated to be off by.

    Attributes
    ----------
    steps, rejected : int
        Steps that were taken, and tried in vain.
    shortest, longest : float
        Of the steps taken, s.
    sum : StepError
        Of the estimated errors of all steps: some cancel.
    displacement, temperature : float
        Largest magnitudes that this sum has had, m and K.
    """

    steps: int
    rejected: int
    shortest: float
    longest: float
    sum: StepError
    displacement: float
    temperature: float


@dataclass(frozen=True)
class _March:
    """What stays the same from step to step.

    Attributes
    ----------
    machine : CondensedMachine
        What marches.
    weights : callable
        Length (s) to the weights of a step.
    drive : Histories
        The inputs.
    tolerance : Tolerance
        Of the whole march.
    end : float
        Of the march, s.
    """

    machine: CondensedMachine
    weights: Callable[[float], ExponentialStep]
    drive: Histories
    tolerance: Tolerance
    end: float


@dataclass(frozen=True)
class _Now:
    """The march between two steps.

    Attributes
    ----------
    time : float
        s.
    state : State
        Temperatures, and what friction has come to.
    inputs, flow : ndarray, shapes (k + l,) and (m,)
        Inputs and joint heat flows, W.
    slope : ndarray, shape (m,)
        Change of the flows in the last step, W/s.
    length : float
        Of the last step, s; zero if there is none that tells anything of the next.
    """

    time: float
    state: State
    inputs: Array
    flow: Array
    slope: Array
    length: float


@dataclass(frozen=True)
class _Tried:
    """A step that has been computed.

    Attributes
    ----------
    step : Step
        At its end.
    weights : ExponentialStep
        Of its length.
    ends : Ends
        What acts in it.
    bent : ndarray, shape (2, m)
        What extrapolation has added to the slip at its end, m.
    error : StepError
        Estimated.
    """

    step: Step
    weights: ExponentialStep
    ends: Ends
    bent: Array
    error: StepError


def march_adaptively(
    machine: CondensedMachine,
    rates: Array,
    drive: Histories,
    times: Array,
    tolerance: Tolerance,
    start: State,
) -> Iterator[tuple[Track, Effort]]:
    """Yield the machine at given times, some at a time, and the effort so far.

    Parameters
    ----------
    machine : CondensedMachine
        On the modes of a reduced thermal model.
    rates : ndarray, shape (r,)
        Of the modes, 1/s.
    drive : Histories
        Inputs (k + l,) in time, s.
    times : ndarray, shape (n,)
        Ascending, s, above zero. The last one ends the march. State k of the track has the index of
        `start` + k + 1.
    tolerance : Tolerance
        For the sum of the errors of all steps.
    start : State
        At time zero: the march does not go on from a later one.

    Raises
    ------
    ConvergenceError
        The shortest step has no solution, or is estimated to be off by more than the tolerance.
    InputError
        A pressure is beyond the conductance law.
    """
    weights = lru_cache(maxsize=KEPT)(partial(exponential_step, machine, rates))
    march = _March(machine, weights, drive, tolerance, float(times[-1]))
    knots = np.append(drive.times[(drive.times > 0.0) & (drive.times < march.end)], march.end)
    now, pace, effort = _begun(machine, drive, start), Pace(), _no_effort(machine)
    unreported: list[Step] = []
    given = 0
    while given < len(times):
        knot = float(knots[np.searchsorted(knots, now.time, side="right")])
        tried, pace, rejected = _accepted(march, now, pace, knot)
        effort = _added(effort, tried, rejected)
        length = tried.weights.length
        end = knot if length == knot - now.time else now.time + length
        unreported.append(tried.step)
        due = times[given : np.searchsorted(times, end * (1.0 + ROUNDING), side="right")]
        if due.size:
            shares = np.where(due >= end * (1.0 - ROUNDING), 1.0, (due - now.time) / length)
            steps = [_within(machine, now, tried, float(share)) for share in shares]
            yield _reported(steps, unreported, start.index + given + 1), effort
            given += due.size
            unreported.clear()
        now = _after(now, tried, end)


def _begun(machine: CondensedMachine, drive: Histories, start: State) -> _Now:
    """The march at time zero, settled at the held temperatures of the first instant after it."""
    thermal, inputs = machine.thermal, drive(0.0)
    held = thermal.capacity_rate.diagonal() == 0.0
    temperature = start.temperature.copy()
    temperature[held] = thermal.inputs[held] @ inputs[: thermal.inputs.shape[1]]
    settled, _ = settled_at(machine, start, temperature, inputs)
    pressure = machine.contact.preload + settled.traction.value[0]
    state = replace(start, temperature=temperature, gap=settled.gap, pressure=pressure)
    state = replace(state, slip=settled.traction.slip)
    area = machine.contact.elastic.area[: machine.contact.count]
    flow = machine.conductance_in(state) * area * (thermal.jump @ temperature)
    return _Now(0.0, state, inputs, flow, np.zeros_like(flow), 0.0)


def _after(now: _Now, tried: _Tried, end: float) -> _Now:
    """The march after an accepted step."""
    step, length = tried.step, tried.weights.length
    after = replace(now, time=end, state=step.state, inputs=tried.ends.inputs[1])
    after = replace(after, flow=tried.ends.flow[1])
    if step.cuts:
        return replace(after, slope=np.zeros_like(now.slope), length=0.0)
    # Between the two knots of an edge the flows change by less than the joints' tolerance.
    if length < SHORTEST:
        return after
    return replace(after, slope=(after.flow - now.flow) / length, length=length)


def _accepted(march: _March, now: _Now, pace: Pace, knot: float) -> tuple[_Tried, Pace, int]:
    """The next step, the pace after it, and how many were tried in vain."""
    rejected = 0
    while True:
        length = until(pace.length, knot - now.time)
        last_chance = length <= SHORTEST
        where = f"step to t = {now.time + length:g} s"
        try:
            tried = _tried(march, now, length)
        except ThermojointError as error:
            if last_chance:
                raise type(error)(f"{where}: {error}") from error
            pace = retreated(pace, length)
        else:
            share = allowed(length, march.end)
            part = tried.error.relative_to(march.tolerance)
            if part <= (1.0 if last_chance else share):
                return tried, next_pace(pace, length, part / share), rejected
            if last_chance:
                moved, warmed = tried.error.largest()
                raise ConvergenceError(
                    f"{where}: the shortest step of {length:.2g} s is estimated to be off by "
                    f"{MEGA * moved:.2g} um and {warmed:.2g} K; raise march.tolerance_um and "
                    "march.tolerance_K"
                )
            pace = shorter(pace, length, part / share)
        rejected += 1


def _tried(march: _March, now: _Now, length: float) -> _Tried:
    """Compute a step; the state before it is as it was."""
    machine, weights, before = march.machine, march.weights(length), now.state
    inputs = march.drive(now.time + length)
    half = weights.before_end(before.temperature, now.inputs, now.flow)
    further = length / now.length if now.length else 0.0
    begun = replace(before, temperature=half, change=further * before.change)
    step = iterated_step(weights.machine, begun, inputs)
    ends = Ends((now.inputs, inputs), (now.flow, step.heat_flow))
    unknowns = step.state.temperature

    def course(share: float) -> tuple[Array, Array]:
        return weights.within(before.temperature, ends, share), ends.inputs_at(share)

    path = None if step.cuts else slip_path(machine, before, course, step.state)
    bent, better = np.zeros_like(before.slip), step.state.slip if step.cuts else before.slip
    if path is not None:
        bent, better = path.slip - step.state.slip, path.slip + path.error
        step = _settled_from(machine, step, path.slip, unknowns)
    slope = (step.heat_flow - now.flow) / length
    bend = (slope - now.slope) / (length + (now.length or length))
    area = machine.contact.elastic.area[: machine.contact.count]
    lacking = weights.lacking(bend, area * step.conductance)
    other = _settled_from(machine, step, better, unknowns + lacking)
    both = [rows @ lacking for rows in (machine.thermal.mean, machine.thermal.jump)]
    error = StepError(other.displacement - step.displacement, np.concatenate(both))
    state = replace(step.state, change=step.state.gap - before.gap)
    balance = weights.balance(before.temperature, unknowns, ends)
    conductance = machine.conductance_in(state)
    step = replace(step, state=state, conductance=conductance, heat_balance=balance)
    return _Tried(step, weights, ends, bent, error)


def _within(machine: CondensedMachine, now: _Now, tried: _Tried, share: float) -> Step:
    """The machine after a share of an accepted step, settled from the slip at its start.

    What extrapolation adds to the slip grows with the square of the time.
    """
    if share == 1.0:
        return tried.step
    before, ends = now.state, tried.ends
    unknowns, inputs = tried.weights.within(before.temperature, ends, share), ends.inputs_at(share)
    change = share * (tried.step.state.gap - before.gap)
    near = replace(tried.step, state=replace(before, gap=before.gap + change), inputs=inputs)
    step = _settled_from(machine, near, before.slip, unknowns)
    slid = step.state.slip != before.slip
    if slid.any() and tried.bent.any():
        slip = step.state.slip + np.where(slid, share**2 * tried.bent, 0.0)
        step = _settled_from(machine, step, slip, unknowns)
    return replace(
        step,
        heat_flow=ends.flow_at(share),
        conductance=machine.conductance_in(step.state),
    )


def _settled_from(machine: CondensedMachine, step: Step, slip: Array, unknowns: Array) -> Step:
    """A step at other temperatures, its joints settled once more from another slip."""
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


def _reported(steps: Sequence[Step], unreported: Sequence[Step], index: int) -> Track:
    """Rows of a response, with what the solvers say of all steps since the row before."""
    residual = max(step.residual for step in unreported)
    balance = max((step.heat_balance for step in unreported), key=abs)
    rows = []
    for k, step in enumerate(steps):
        rows.append(
            replace(
                step,
                state=replace(step.state, index=index + k),
                residual=max(step.residual, residual),
                heat_balance=balance,
                iterations=0 if k else sum(one.iterations for one in unreported),
                cuts=0 if k else sum(one.cuts for one in unreported),
            )
        )
    return joined([track_of(row) for row in rows])


def _no_effort(machine: CondensedMachine) -> Effort:
    axes = len(machine.contact.elastic.probe_thermal)
    none = StepError(np.zeros(axes), np.zeros(2 * machine.contact.count))
    return Effort(0, 0, np.inf, 0.0, none, 0.0, 0.0)


def _added(effort: Effort, tried: _Tried, rejected: int) -> Effort:
    """The effort with a step more."""
    length, total = tried.weights.length, effort.sum + tried.error
    moved, warmed = total.largest()
    return Effort(
        steps=effort.steps + 1,
        rejected=effort.rejected + rejected,
        shortest=min(effort.shortest, length),
        longest=max(effort.longest, length),
        sum=total,
        displacement=max(effort.displacement, moved),
        temperature=max(effort.temperature, warmed),
    )
