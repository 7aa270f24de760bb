"""JIT-compiled adaptive march: the steps of `fesim.march.adaptive` for built-in laws.

It is the same method, line by line; the gap equations are solved by Newton's method, whose factors
are reused in later iterations of a step as long as the residual falls quickly. A step that needs
special treatment (a joint snaps, a body may be loose, pressure and heat flow do not agree soon, no
step is short enough) is left to the plain march.

Start at `march_freely`; `tests/fesim/march/test_adaptive.py` compares both marches. Arrays of the
same shape are rows of one array: compile time is proportional to the number of arrays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled, compiled_part
from fesim.joint.compiled_gap import NewtonWork, Trial, evaluate_in_place, largest
from fesim.joint.in_place import add, fill, put
from fesim.joint.linear_system import factorise_columns
from fesim.joint.loosening import Watched, WatchWork, surely_held
from fesim.march import iteration
from fesim.march.compiled_exponential import (
    BENDS,
    MEAN,
    STARTS,
    STAYS,
    TURNS,
    Lengths,
    Modes,
    place_of,
    weigh,
)
from fesim.march.compiled_step import (
    JointKernel,
    JointState,
    add_loads,
    conduct,
    displace,
    settle_by_newton,
    take,
)
from fesim.march.iteration import PATIENCE, PRESSURE_TOLERANCE
from fesim.march.slip_path import ABRUPT, SMOOTH
from fesim.march.step_control import (
    BRIEF,
    ROUNDING,
    SMALL,
    allowed,
    below,
    bent_over,
    least,
    next_length,
    of_allowed,
    rung,
    shorter_length,
    stretch,
    until,
)
from thermojoint.artefacts.arrays import Array

#: Sweeps of the in-step iteration; `fesim.march.iteration` has more of them.
SWEEPS = 60
LIGHTEST, HEAVIEST = iteration.WEIGHTS

#: Rows of `Course`: start and end of a step.
BEFORE, AFTER = range(2)
#: Rows of its errors: sum over all steps, and this step.
ALL, THIS = range(2)
#: Entries of its clock, s: start, end and length of the step, length of the last (zero: its slope
#: is not used), planned length; error of the last step relative to the allowed one; requested time,
#: s; temperature change so far, K; time in which the flows of this step and the last bend.
START, STOP, LENGTH, LAST, PLANNED, ERROR, ASKED, WAY, BENT_OVER = range(9)
#: Entries of its effort, as in `fesim.march.adaptive_state.Effort`.
STEPS, REJECTED, SHORT, LONG, MOVED, WARMED = range(6)
#: Rows of `Work`.
AT, DRAWN, WEIGHTS = range(3)
CONDUCTED, JUMP, FLOW, VALUE, MISFIT, MISFIT_BEFORE, PRESSURE = range(7)
#: Entries of its sweeps: weight, and largest misfit of the previous one; then the estimated
#: relative error of the slip that extrapolation adds.
WEIGHT, LARGEST, DOUBT = range(3)
SLIP, BENT, ORIGIN, HALFWAY = range(4)
GAP, CHANGE, GUESS, HALF, ONCE = range(5)
#: Rows of its tractions and displacements: of the step; of a fraction of it or a time within it.
WHOLE, PART = range(2)
#: Equilibria of the joint in a step, in their order: sweeps of the in-step iteration, the step with
#: the missing curvature of the flows, both halves of it, its end with extrapolated slip; at a time
#: within it, and there with the extrapolated part of the slip. Then it is done, or given up.
SWEEP, LACKING, HALVES, WHOLE_STEP, MOMENT, BENT_MOMENT, DONE, GIVEN_UP = range(8)
#: Entries of `Asked.limits`, as in `fesim.march.step_control.Tolerance`.
DISPLACEMENT, TEMPERATURE, FOLLOWED = range(3)

_allowed, _rung, _until = compiled_part(allowed), compiled_part(rung), compiled_part(until)
_of_allowed, _stretch = compiled_part(of_allowed), compiled_part(stretch)
_below, _bent_over, _least = compiled_part(below), compiled_part(bent_over), compiled_part(least)
_next_length, _shorter_length = compiled_part(next_length), compiled_part(shorter_length)


class AdaptiveKernel(NamedTuple):
    """Data of a machine."""

    #: The heat equation.
    modes: Modes
    joint: JointKernel
    #: Detection of loose bodies.
    watched: Watched
    #: Shape (m, n): mean temperature of both sides of each contact element.
    mean: Array
    #: Shape (m,): reference pressures, Pa.
    scale: Array
    #: Relative change of a pressure within the tolerance of the gap equations.
    left_open: float
    #: Magnitude of the amplitudes for a uniform temperature of 1 K.
    spread: float


class Asked(NamedTuple):
    """Request to the march."""

    #: Shape (t,): requested times, ascending, s.
    times: Array
    #: Shape (k,): times at which steps end, ascending, s; the last one is infinite.
    knots: Array
    #: Shapes (d,) and (d, k + l): `fesim.case.history.Histories`.
    drive_times: Array
    drive: Array
    #: Shape (3,): tolerance.
    limits: Array


class Course(NamedTuple):
    """The march at the start of a step, and at the end of the attempted one.

    The first dimension of the first eight arrays is `BEFORE` and `AFTER`.
    """

    #: Shape (2, n): unknowns, and their forcing: heat input of modes, W; temperatures of held
    #: surfaces, K.
    unknowns: Array
    acting: Array
    #: Shapes (2, 3, m), (2, 2, m), (2, m) and (2, 3, m): as in `JointState`.
    gap: Array
    slip: Array
    pressure: Array
    change: Array
    #: Shape (2, m): joint heat flows, W.
    flow: Array
    #: Shape (2, k + l): inputs.
    inputs: Array
    #: Shape (m,): rate of change of the flows in the last step, W/s.
    slope: Array
    #: Shapes (9,) and (6,): see `START` and `STEPS`.
    clock: Array
    effort: Array
    #: Shapes (2, axes) and (2, 2 m): estimated errors of all steps together, and of this one, m and
    #: K.
    moved: Array
    warmed: Array


class Work(NamedTuple):
    """Work arrays; their content is not used after a step."""

    #: Shape (5, n): `AT` a time, `DRAWN` by the joints, and three `WEIGHTS` of that time.
    unknowns: Array
    #: Shape (7, m): see `CONDUCTED`, conductance times area of the step, W/K.
    contact: Array
    #: Shapes (4, 2, m) and (5, 3, m), m: slip in a part of the step; slip added by extrapolation
    #: (`BENT`), that of `fesim.march.slip_path.origin`, and after half of the step; gaps after half
    #: of it, and after all of it in one piece (`ONCE`).
    slip: Array
    gap: Array
    #: Shapes (2, 3 m) and (2, axes): `WHOLE` and `PART`.
    remainder: Array
    displacement: Array
    #: Shape (k + l,): inputs at that time.
    inputs: Array
    #: Shapes (m, m) and (m,): I + diag(conductance times area) S in column order; its factors.
    system: Array
    pivots: NDArray[np.int32]
    #: Shapes (axes,), (2, 3 m) and (3,): displacement by the joint, m; J0^-1 g_T, m, of the step
    #: (`WHOLE`) and of a part or a time within it; see `WEIGHT`.
    moved: Array
    free_gap: Array
    sweeps: Array
    #: Shape (1,): number of equilibria in this stage so far.
    turn: NDArray[np.int64]


class Storage(NamedTuple):
    """Work arrays of a march: for its steps, the gap equations, `surely_held`, and the weights."""

    work: Work
    trial: Trial
    newton: NewtonWork
    check: WatchWork
    lengths: Lengths


class Sweeping(NamedTuple):
    """Machine data for a sweep; see `JointKernel` and `AdaptiveKernel`."""

    preload: Array
    scale: Array
    left_open: float


class Heat(NamedTuple):
    """The heat equation in a step of one length; see `AdaptiveKernel`, `Modes` and `Lengths`."""

    rates: Array
    inputs: Array
    drawn: Array
    jump: Array
    mean: Array
    weights: Array
    influence: Array


class Rows(NamedTuple):
    """Records at the requested times, which are the first dimension."""

    #: Of a state, (n,), (3, m), (2, m); pressure, conductance times area and heat flow (3, m); (3
    #: m,) and (axes,).
    unknowns: Array
    gap: Array
    slip: Array
    contact: Array
    remainder: Array
    displacement: Array


class Taken(NamedTuple):
    """Records of the steps, which are the first dimension."""

    #: Shape (s, n): at the end of the step, and its mean over the step.
    unknowns: Array
    mean: Array
    #: Shape (s, 4 m): at the end: remainder, then pressure.
    joint: Array
    #: Shapes (s, k + l) and (s, m): in the middle of the step.
    inputs: Array
    flow: Array
    #: Shape (s, 4): length, s; residual of the gap equations, m; Newton iterations; rows up to its
    #: end.
    numbers: Array


@compiled_part
def _part(work: Work) -> JointState:
    """The joint in a part of a step."""
    return JointState(work.gap[GAP], work.slip[SLIP], work.contact[PRESSURE], work.gap[CHANGE])


@compiled_part
def _begun_at(gap: Array, slip: Array, part: JointState) -> None:
    """Start the part from a gap and a slip."""
    put(gap, part.gap)
    put(slip, part.slip)
    fill(part.change, 0.0)


@compiled_part
def _between(ends: Array, share: float, into: Array) -> None:
    for k in range(into.size):
        into[k] = ends[BEFORE, k] + share * (ends[AFTER, k] - ends[BEFORE, k])


@compiled_part
def _within(course: Course, weights: Array, into: Array) -> None:
    """The unknowns after a fraction of a step, from its weights E, A, B."""
    start, acting = course.unknowns[BEFORE], course.acting
    for k in range(into.size):
        turn = acting[AFTER, k] - acting[BEFORE, k]
        into[k] = weights[STAYS, k] * start[k] + weights[STARTS, k] * acting[BEFORE, k]
        into[k] += weights[TURNS, k] * turn


@compiled_part
def _give(matrix: Array, inputs: Array, into: Array) -> None:
    """Product of a matrix (n, k) and the first of the inputs (k + l,)."""
    for k in range(into.size):
        into[k] = 0.0
        for i in range(matrix.shape[1]):
            into[k] += matrix[k, i] * inputs[i]


@compiled_part
def _begin(modes: Modes, work: Work, course: Course) -> None:
    """The forcing at the start of the first step, bit-identical to that after a step."""
    _give(modes.inputs, course.inputs[BEFORE], course.acting[BEFORE])
    np.dot(modes.drawn, course.flow[BEFORE], work.unknowns[DRAWN])
    for k in range(course.acting.shape[1]):
        course.acting[BEFORE, k] -= work.unknowns[DRAWN, k]


@compiled_part
def _flows(heat: Heat, work: Work, flow: Array) -> None:
    """Joint heat flows from conductances and jumps, and the heat they draw from the unknowns."""
    conducted, jump, at = work.contact[CONDUCTED], work.contact[JUMP], work.unknowns[AT]
    drawn, system, count = work.unknowns[DRAWN], work.system, flow.size
    for f in range(count):
        flow[f] = conducted[f] * jump[f]
        # Column after column: S is symmetric.
        for e in range(count):
            system[f, e] = conducted[e] * heat.influence[f, e]
        system[f, f] += 1.0
    factorise_columns(system, work.pivots, flow)
    np.dot(heat.drawn, flow, drawn)
    for k in range(at.size):
        at[k] -= heat.weights[TURNS, k] * drawn[k]


@compiled_part
def _first_guess(heat: Heat, joint: JointKernel, work: Work, trial: Trial, course: Course) -> None:
    """Unknowns without joint heat flows, and pressures extrapolated from the last step."""
    part, base, weights = _part(work), course.unknowns[AFTER], heat.weights
    inputs, value = course.inputs[AFTER], work.contact[VALUE]
    given = course.acting[AFTER]
    _give(heat.inputs, inputs, given)
    for k in range(base.size):
        base[k] = weights[STAYS, k] * course.unknowns[BEFORE, k] + weights[TURNS, k] * given[k]
        base[k] += (weights[STARTS, k] - weights[TURNS, k]) * course.acting[BEFORE, k]
    _begun_at(course.gap[BEFORE], course.slip[BEFORE], part)
    if course.clock[LAST] > 0.0:
        further = course.clock[LENGTH] / course.clock[LAST]
        for k in range(part.change.size):
            part.change.flat[k] = further * course.change[BEFORE].flat[k]
    put(part.gap, trial.gap)
    add(part.change, trial.gap)
    evaluate_in_place(joint.laws, part.slip, trial)
    for e in range(value.size):
        value[e] = joint.preload[e] + trial.value[0, e]
        work.contact[MISFIT_BEFORE, e] = 0.0
    np.dot(heat.jump, base, work.contact[JUMP])
    work.sweeps[WEIGHT], work.sweeps[LARGEST] = 1.0, 0.0


@compiled_part
def _lacking(heat: Heat, work: Work, course: Course) -> None:
    """The unknowns with the effect of the flows' curvature (`fesim.march.exponential`)."""
    at, bend, jump = work.unknowns[AT], work.contact[VALUE], work.contact[JUMP]
    length, span = course.clock[LENGTH], course.clock[BENT_OVER]
    for e in range(bend.size):
        slope = (course.flow[AFTER, e] - course.flow[BEFORE, e]) / length
        bend[e] = (slope - course.slope[e]) / span
    np.dot(heat.drawn, bend, at)
    for k in range(at.size):
        at[k] *= heat.weights[BENDS, k]
    np.dot(heat.jump, at, jump)
    _flows(heat, work, work.contact[FLOW])
    np.dot(heat.mean, at, course.warmed[THIS, : bend.size])
    np.dot(heat.jump, at, course.warmed[THIS, bend.size :])
    add(course.unknowns[AFTER], at)


@compiled_part
def _prepare(heat: Heat, work: Work, course: Course, stage: int) -> None:
    """Prepare unknowns, inputs and start of the next equilibrium."""
    part, at, gap, slip = _part(work), work.unknowns[AT], course.gap, course.slip
    turn, clock = work.turn[0], course.clock
    if stage == SWEEP:
        put(course.unknowns[AFTER], at)
        put(course.inputs[AFTER], work.inputs)
        _flows(heat, work, course.flow[AFTER])
    elif stage == LACKING:
        _lacking(heat, work, course)
        _begun_at(gap[AFTER], slip[BEFORE], part)
    elif stage == HALVES:
        share = 0.5 * (turn + 1.0)
        if turn == 0:
            _begun_at(gap[BEFORE], slip[BEFORE], part)
        else:
            put(part.gap, work.gap[HALF])
        for k in range(part.change.size):
            first, last = gap[BEFORE].flat[k], gap[AFTER].flat[k]
            part.change.flat[k] = first + share * (last - first) - part.gap.flat[k]
        if turn == 0:
            # The second of `fesim.march.compiled_exponential.SHARES`.
            _within(course, heat.weights[3:6], at)
            _between(course.inputs, share, work.inputs)
    elif stage == WHOLE_STEP:
        put(course.unknowns[AFTER], at)
        put(course.inputs[AFTER], work.inputs)
        put(work.slip[ORIGIN], part.slip)
        fill(part.change, 0.0)
    elif stage == MOMENT:
        share = (clock[ASKED] - clock[START]) / clock[LENGTH]
        weights, guess = work.unknowns[WEIGHTS : WEIGHTS + 3], work.gap[GUESS]
        half, once, middle = work.gap[HALF], work.gap[ONCE], 4.0 * share * (1.0 - share)
        weigh(heat.rates, clock[LENGTH], share, weights)
        _within(course, weights, at)
        _between(course.inputs, share, work.inputs)
        for k in range(guess.size):
            # In one piece from the same slip, as the step and its first half: a parabola.
            first, last = gap[BEFORE].flat[k], once.flat[k]
            guess.flat[k] = first + share * (last - first)
            guess.flat[k] += middle * (half.flat[k] - 0.5 * (first + last))
        _begun_at(guess, slip[BEFORE], part)
    else:
        _begun_at(work.gap[GUESS], work.slip[ORIGIN], part)


@compiled_part
def _swept(machine: Sweeping, work: Work, trial: Trial, gap: Array) -> int:
    """The stage after a sweep: another sweep, or the next one if pressure and conductance agree.

    `gap` (3, m) is that at the start of the step, m.
    """
    value, misfit, last = work.contact[VALUE], work.contact[MISFIT], work.contact[MISFIT_BEFORE]
    preload, scale, left_open = machine
    change = along = across = 0.0
    for e in range(value.size):
        misfit[e] = (preload[e] + trial.value[0, e] - value[e]) / scale[e]
        change, difference = max(change, abs(misfit[e])), misfit[e] - last[e]
        along, across = along + last[e] * difference, across + difference * difference
    if change <= (PRESSURE_TOLERANCE if work.turn[0] < PATIENCE else left_open):
        return LACKING
    for k in range(gap.size):
        work.gap[CHANGE].flat[k] = trial.gap.flat[k] - gap.flat[k]
    if change > 0.5 * work.sweeps[LARGEST]:
        factor = 1.0
        if along < 0.0:
            factor = -work.sweeps[WEIGHT] * along / across
            factor = min(max(factor, LIGHTEST), HEAVIEST)
        work.sweeps[WEIGHT] = factor
    work.sweeps[LARGEST] = change
    for e in range(value.size):
        # Not value plus misfit: rounding would give an open joint a negative pressure.
        after = preload[e] + trial.value[0, e]
        least, most = 0.5 * min(value[e], after), 2.0 * max(value[e], after)
        value[e] = min(max(value[e] + work.sweeps[WEIGHT] * (after - value[e]), least), most)
        last[e] = misfit[e]
    return SWEEP if work.turn[0] + 1 < SWEEPS else GIVEN_UP


@compiled_part
def _trace_back(course: Course, once: Array, gap: Array, slip: Array, slides: bool, e: int) -> None:
    """`fesim.march.slip_path.origin` of a contact element, in place of the slip (2, m)."""
    begun, longer = course.slip[BEFORE], 1.0
    if slides:
        held = math.hypot(gap[1, e] - slip[0, e], gap[2, e] - slip[1, e])
        tried = math.hypot(once[1, e] - begun[0, e], once[2, e] - begun[1, e])
        longer = tried / held if held > 0.0 else 1.0
    for i in range(2):
        slip[i, e] = gap[i + 1, e] - longer * (gap[i + 1, e] - slip[i, e])


@compiled_part
def _extrapolate(work: Work, course: Course) -> None:
    """Extrapolate the gap of the part from both halves of a step, and the origin of its slip."""
    gap, slip, once, whole = work.gap[GAP], work.slip[SLIP], work.gap[ONCE], course.slip[AFTER]
    origin, halfway = work.slip[ORIGIN], work.slip[HALFWAY]
    for k in range(gap.size):
        gap.flat[k] = 2.0 * gap.flat[k] - once.flat[k]
    for k in range(slip.size):
        origin.flat[k] = 2.0 * slip.flat[k] - whole.flat[k]
    work.sweeps[DOUBT], begun = SMOOTH, course.slip[BEFORE]
    for e in range(slip.shape[1]):
        slides = slip[0, e] != halfway[0, e] or slip[1, e] != halfway[1, e]
        slid = halfway[0, e] != begun[0, e] or halfway[1, e] != begun[1, e]
        if slides != slid:
            work.sweeps[DOUBT] = ABRUPT
        _trace_back(course, once, gap, origin, slides, e)


@compiled_part
def _bend(work: Work, course: Course) -> int:
    """Add the extrapolated part of gap and slip at a time within the step; the next stage."""
    part, gap, begun = _part(work), course.gap[AFTER], course.slip[BEFORE]
    guess, origin, further = work.gap[GUESS], work.slip[ORIGIN], False
    grown = ((course.clock[ASKED] - course.clock[START]) / course.clock[LENGTH]) ** 2
    for k in range(guess.size):
        guess.flat[k] = part.gap.flat[k] + grown * (gap.flat[k] - work.gap[ONCE].flat[k])
    for e in range(begun.shape[1]):
        slides = part.slip[0, e] != begun[0, e] or part.slip[1, e] != begun[1, e]
        for i in range(2):
            origin[i, e] = part.slip[i, e] + (grown * work.slip[BENT, i, e] if slides else 0.0)
        _trace_back(course, part.gap, guess, origin, slides, e)
        further = further or slides
    return BENT_MOMENT if further else DONE


@compiled_part
def _conclude(work: Work, course: Course, stage: int) -> int:
    """Store the equilibrium of the part; return the next stage."""
    part, remainder, moved = _part(work), work.remainder, work.displacement
    gap, before, error = course.gap[AFTER], course.gap[BEFORE], course.moved[THIS]
    if stage == SWEEP:
        put(part.gap, gap)
        put(part.gap, work.gap[ONCE])
        put(part.slip, course.slip[AFTER])
        put(work.unknowns[AT], course.unknowns[AFTER])
        for k in range(course.acting.shape[1]):
            course.acting[AFTER, k] -= work.unknowns[DRAWN, k]
        return LACKING
    if stage == LACKING:
        for k in range(error.size):
            error[k] = moved[PART, k] - moved[WHOLE, k]
        return HALVES
    if stage == HALVES:
        if work.turn[0] == 0:
            put(part.gap, work.gap[HALF])
            put(part.slip, work.slip[HALFWAY])
            return HALVES
        _extrapolate(work, course)
        return WHOLE_STEP
    if stage == WHOLE_STEP:
        for k in range(error.size):
            error[k] += work.sweeps[DOUBT] * (moved[PART, k] - moved[WHOLE, k])
        for k in range(part.slip.size):
            work.slip[BENT].flat[k] = part.slip.flat[k] - course.slip[AFTER].flat[k]
        put(part.gap, gap)
        put(part.slip, course.slip[AFTER])
        put(part.pressure, course.pressure[AFTER])
        put(remainder[PART], remainder[WHOLE])
        put(moved[PART], moved[WHOLE])
        for k in range(gap.size):
            course.change[AFTER].flat[k] = gap.flat[k] - before.flat[k]
        return DONE
    return _bend(work, course) if stage == MOMENT else DONE


@compiled_part
def _free_gap(stage: int, turn: int) -> tuple[int, bool]:
    """Row of `Work.free_gap` for an equilibrium, and whether an earlier one already set it."""
    ends = stage == WHOLE_STEP or (stage == HALVES and turn == 1)
    return WHOLE if ends or stage == SWEEP else PART, ends or stage == BENT_MOMENT


@compiled_part
def _solved(
    machine: AdaptiveKernel, storage: Storage, heat: Heat, course: Course, stage: int
) -> tuple[bool, float, int]:
    """Find all equilibria from a stage on: success, largest residual and total iterations.

    This is the only call of the solver of the gap equations: each takes seconds to compile.
    """
    joint, work, trial, newton = machine.joint, storage.work, storage.trial, storage.newton
    part, at = _part(work), work.unknowns[AT]
    loads = work.inputs[heat.inputs.shape[1] :]
    sweeping = Sweeping(joint.preload, machine.scale, machine.left_open)
    largest_residual, all_iterations = 0.0, 0
    work.turn[0] = 0
    while stage < DONE:
        if stage == SWEEP:
            if work.turn[0] == 0:
                _first_guess(heat, joint, work, trial, course)
            conduct(joint, work.contact[VALUE], work.contact[CONDUCTED])
        _prepare(heat, work, course, stage)
        of, known = _free_gap(stage, work.turn[0])
        free_gap = work.free_gap[of]
        if not known:
            np.dot(joint.gap, at, free_gap)
            add_loads(joint.loaded_gap, loads, free_gap)
        put(part.gap, trial.gap)
        add(part.change, trial.gap)
        solved, residual, iterations = settle_by_newton(joint, free_gap, part, trial, newton)
        if not solved:
            return False, residual, all_iterations
        largest_residual = max(largest_residual, residual)
        all_iterations += iterations
        after = SWEEP
        if stage == SWEEP:
            after = _swept(sweeping, work, trial, course.gap[BEFORE])
        if after == GIVEN_UP:
            return False, residual, all_iterations
        if stage > SWEEP or after > SWEEP:
            of = WHOLE if stage == SWEEP else PART
            remainder = work.remainder[of]
            take(joint, trial, part, remainder)
            if stage != HALVES:
                displace(joint, work.moved, at, loads, remainder, work.displacement[of])
            after = _conclude(work, course, stage)
            held = stage > SWEEP or surely_held(
                machine.watched, storage.check, part.pressure, trial.tangent
            )
            if not held:
                return False, residual, all_iterations
        work.turn[0] = work.turn[0] + 1 if after == stage else 0
        stage = after
    return True, largest_residual, all_iterations


@compiled_part
def _driven(asked: Asked, time: float, inputs: Array) -> None:
    """The inputs at a time (s): `fesim.case.history.Histories`."""
    below, above = 0, asked.drive_times.size
    while above - below > 1:
        middle = (below + above) // 2
        if asked.drive_times[middle] <= time:
            below = middle
        else:
            above = middle
    if above == asked.drive_times.size:
        put(asked.drive[below], inputs)
        return
    start, end = asked.drive_times[below], asked.drive_times[above]
    _between(asked.drive[below : above + 1], (time - start) / (end - start), inputs)


@compiled_part
def _note(joint: JointKernel, work: Work, course: Course, rows: Rows, row: int) -> None:
    """Record the machine at a requested time: the end of the step, or within it."""
    part, clock, contact = _part(work), course.clock, rows.contact[row]
    if clock[ASKED] < clock[STOP]:
        share = (clock[ASKED] - clock[START]) / clock[LENGTH]
        _between(course.flow, share, contact[2])
    else:
        put(course.unknowns[AFTER], work.unknowns[AT])
        put(course.gap[AFTER], part.gap)
        put(course.slip[AFTER], part.slip)
        put(course.pressure[AFTER], part.pressure)
        put(course.flow[AFTER], contact[2])
        put(work.remainder[WHOLE], work.remainder[PART])
        put(work.displacement[WHOLE], work.displacement[PART])
    put(work.unknowns[AT], rows.unknowns[row])
    put(part.gap, rows.gap[row])
    put(part.slip, rows.slip[row])
    put(part.pressure, contact[0])
    conduct(joint, part.pressure, contact[1])
    put(work.remainder[PART], rows.remainder[row])
    put(work.displacement[PART], rows.displacement[row])


@compiled_part
def _record(weights: Array, work: Work, course: Course, taken: Taken, step: int) -> None:
    """Record the attempted step."""
    joint, size = taken.joint[step], work.remainder.shape[1]
    put(work.remainder[WHOLE], joint[:size])
    put(course.pressure[AFTER], joint[size:])
    _within(course, weights[MEAN : MEAN + 3], taken.mean[step])
    put(course.unknowns[AFTER], taken.unknowns[step])
    _between(course.inputs, 0.5, taken.inputs[step])
    _between(course.flow, 0.5, taken.flow[step])


@compiled_part
def _changed(course: Course, rates: Array, spread: float) -> float:
    """Temperature change in a step, K."""
    total = 0.0
    for k in range(rates.size):
        # Held surfaces have an infinite rate.
        if rates[k] < np.inf:
            total += (course.unknowns[AFTER, k] - course.unknowns[BEFORE, k]) ** 2
    return float(np.sqrt(total)) / spread


@compiled_part
def _accept(course: Course, edge: bool) -> None:
    """Accept the attempted step; the flows' slope within an edge is not used later."""
    clock, effort, length = course.clock, course.effort, course.clock[LENGTH]
    add(course.moved[THIS], course.moved[ALL])
    add(course.warmed[THIS], course.warmed[ALL])
    effort[STEPS] += 1.0
    effort[SHORT], effort[LONG] = min(effort[SHORT], length), max(effort[LONG], length)
    effort[MOVED] = max(effort[MOVED], largest(course.moved[ALL]))
    effort[WARMED] = max(effort[WARMED], largest(course.warmed[ALL]))
    if not edge:
        for e in range(course.slope.size):
            course.slope[e] = (course.flow[AFTER, e] - course.flow[BEFORE, e]) / length
        clock[LAST] = length
    clock[START] = clock[STOP]
    put(course.unknowns[AFTER], course.unknowns[BEFORE])
    put(course.acting[AFTER], course.acting[BEFORE])
    put(course.gap[AFTER], course.gap[BEFORE])
    put(course.slip[AFTER], course.slip[BEFORE])
    put(course.pressure[AFTER], course.pressure[BEFORE])
    put(course.change[AFTER], course.change[BEFORE])
    put(course.flow[AFTER], course.flow[BEFORE])
    put(course.inputs[AFTER], course.inputs[BEFORE])


@compiled
def march_freely(
    machine: AdaptiveKernel,
    storage: Storage,
    course: Course,
    asked: Asked,
    rows: Rows,
    taken: Taken,
) -> tuple[int, int, bool]:
    """March until all times are reached or the records are full, in place.

    The step with the last time is recorded, but the march stays at its start.

    Returns
    -------
    step, row : int
        Numbers of recorded steps and times.
    usual : bool
        False if the plain march must take the next step.
    """
    clock, limits, lengths = course.clock, asked.limits, storage.lengths
    modes, jump, work = machine.modes, machine.joint.jump, storage.work
    begun, step, row, knot = int(course.effort[STEPS]), 0, 0, 0
    _begin(modes, work, course)
    while row < asked.times.size and step < len(taken.numbers):
        while asked.knots[knot] <= clock[START]:
            knot += 1
        left = asked.knots[knot] - clock[START]
        length = _until(clock[PLANNED], left)
        clock[LENGTH] = length
        clock[STOP] = asked.knots[knot] if length == left else clock[START] + length
        last = row
        while last < asked.times.size and asked.times[last] <= clock[STOP] * (1.0 + ROUNDING):
            last += 1
        if last > len(rows.unknowns):
            break
        _driven(asked, clock[START] + length, course.inputs[AFTER])
        place = place_of(modes, jump, lengths, length)
        weights, influence = lengths.weights[place], lengths.influence[place]
        heat = Heat(modes.rates, modes.inputs, modes.drawn, jump, machine.mean, weights, influence)
        before = asked.knots[knot - 1] if knot > 0 else 0.0
        apart = asked.knots[knot] - before
        times = _stretch(apart)
        clock[BENT_OVER] = _bent_over(length, clock[LAST], clock[START] == before)
        share, residual, iterations, stage = _allowed(times * length), 0.0, 0, SWEEP
        for at in range(row - 1, last):
            # The step itself, then the times within it.
            if at >= row:
                within = asked.times[at] < clock[STOP] * (1.0 - ROUNDING)
                clock[ASKED] = asked.times[at] if within else clock[STOP]
                stage = MOMENT if within else DONE
            # Factors serve one step or one time within it: neither depends on earlier requests.
            storage.newton.kept[0] = 0
            solved, most, more = _solved(machine, storage, heat, course, stage)
            if not solved:
                return step, row, False
            residual, iterations = max(residual, most), iterations + more
            if at >= row:
                _note(machine.joint, work, course, rows, at)
                continue
            moved, warmed = largest(course.moved[THIS]), largest(course.warmed[THIS])
            part = max(moved / limits[DISPLACEMENT], warmed / limits[TEMPERATURE])
            changed = _changed(course, modes.rates, machine.spread)
            free = clock[WAY] > limits[TEMPERATURE]
            followed = np.inf if free else limits[FOLLOWED] * changed
            error = _of_allowed(part, share, warmed, followed)
            shortest = length <= _least(times)
            fine = error <= 1.0 or (shortest and part <= 1.0)
            if not fine:
                break
        if not fine:
            if shortest:
                return step, row, False
            clock[PLANNED] = _below(length, _rung(_shorter_length(length, error)))
            course.effort[REJECTED] += 1.0
            continue
        row = last
        numbers = taken.numbers[step]
        numbers[0], numbers[1], numbers[2], numbers[3] = length, residual, iterations, row
        _record(weights, work, course, taken, int(course.effort[STEPS]) - begun)
        if row == asked.times.size:
            return step + 1, row, True
        _accept(course, apart < BRIEF)
        error, clock[WAY] = max(error, SMALL), clock[WAY] + changed
        wanted = _next_length(clock[PLANNED], clock[ERROR], length, error)
        clock[PLANNED], clock[ERROR] = _rung(wanted), error
        step += 1
    return step, row, True
