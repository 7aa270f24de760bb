"""JIT-compiled march of a machine on several axes: `fesim.axes.march` for staggered steps.

A step treats screws, heat and contact like the plain one; whatever depends on the positions comes
from tables computed once. Joints are settled as in `fesim.axes.survey`. A step that may alternate
is taken twice, for the gain of its map (`fesim.march.stepping`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.axes.compiled_drive import Drives, DriveWork, warm_scale, warm_screw
from fesim.axes.compiled_passing import (
    ROUGHLY,
    Guides,
    Passed,
    Ways,
    enter,
    exchange,
    go,
    rub,
    warm,
)
from fesim.axes.compiled_rows import add_rows, multiply
from fesim.axes.corner_table import CornerTable
from fesim.axes.row_blocks import RowBlocks
from fesim.axes.survey import (
    EXACT,
    Here,
    Pads,
    grown,
    mixed,
    probe,
    settle_here,
    unpacked,
)
from fesim.jit import compiled, compiled_part
from fesim.joint.compiled_gap import largest
from fesim.joint.in_place import fill, put
from fesim.joint.loosening import Watched, WatchWork, surely_held
from fesim.march.alternation import (
    GAIN,
    LARGE,
    LEADING,
    LEAST,
    SELDOM,
    SOMETIMES,
    STILL,
    STUBBORN,
    SUSPECTED,
)
from fesim.march.compiled_step import HeatStep, JointKernel, JointState, conduct, drive, take
from thermojoint.artefacts.arrays import Array


class AxesKernel(NamedTuple):
    """Data of a machine on axes."""

    #: Heat step; its influences are not used.
    heat: HeatStep
    guides: Guides
    drives: Drives
    #: Joint data; its matrices are not used.
    joint: JointKernel
    #: Its slip is that of the march, in place.
    pads: Pads
    #: u rows: untied displacements of pads, stations, anchors and probes, m/K.
    untied: RowBlocks
    #: q rows: the same per W that enters each row of the guides, m.
    warmed: RowBlocks
    #: Shapes (m,): frictional heat of motion per pressure and metre of travel in a step, W/(Pa m);
    #: reference pressure, Pa.
    running: Array
    scale: Array
    watched: Watched
    #: Number of copies of the meshed part in the whole machine.
    copies: int
    #: Step length, s.
    length: float


class AxesWork(NamedTuple):
    """Work arrays of a march."""

    passed: Passed
    drive: DriveWork
    #: Joints in a step, and in its repetition for the gain: with the same C and factors.
    here: Here
    again: Here
    check: WatchWork
    #: Shape (u,): untied displacements, m, and which of them a step needs.
    alone: Array
    wanted: NDArray[np.bool_]
    #: Shapes (k,) and (p h,): C and probes at a place; (m,): conductances times areas, W/K.
    packed: Array
    moved: Array
    conducted: Array
    #: Shapes (r,): amplitudes without and with the exchange.
    without: Array
    amplitudes: Array
    #: Shapes (m,), Pa, and (q,), W: pressures after a step, and the heat lost by the rows in it.
    pressure: Array
    left: Array
    #: Shape (3 m,): z + k g, Pa.
    remainder: Array
    #: Shapes (d,) and (k,): drives and inputs of a step.
    state: Array
    driven: Array
    #: False, True: whether there are factors. With literals, callees would be compiled twice.
    known: NDArray[np.bool_]


class AxesSteps(NamedTuple):
    """n steps."""

    #: Index of the first one in the march.
    first: int
    #: Shape (n, k): inputs without the heat of friction and of drives.
    inputs: Array
    ways: Ways
    #: Combinations of aligned positions; those around the end of each step (n, c), with their
    #: weights; storage for free gaps and probes there (k, h + p).
    table: CornerTable
    touched: NDArray[np.int64]
    weight: Array
    free: Array


class AxesState(NamedTuple):
    """State between two steps, in place."""

    amplitudes: Array
    joint: JointState
    #: Shape (3, m): as in `fesim.march.machine.State`.
    turning: Array
    #: Shape (d,): K.
    drive: Array


class AxesRecord(NamedTuple):
    """Records of n steps; the first dimension is n, the others as in `Step` and `State`."""

    inputs: Array
    amplitudes: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array
    turning: Array
    drive: Array
    conducted: Array
    heat_flow: Array
    displacement: Array
    remainder: Array
    residual: Array
    #: Negative for steps not taken.
    iterations: NDArray[np.int64]


@compiled
def march_axes(
    machine: AxesKernel, work: AxesWork, steps: AxesSteps, now: AxesState, record: AxesRecord
) -> None:
    """March through steps into `record`; `now` is the state after the last one.

    Fewer than n are taken if the plain method must take the next one.

    Raises
    ------
    numpy.linalg.LinAlgError
        A tangent is singular.
    """
    pressure, turning = work.pressure, now.turning
    for n in range(len(steps.inputs)):
        at = steps.first + n
        put(steps.inputs[n], work.driven)
        put(now.drive, work.state)
        go(machine.guides, steps.ways, n, work.passed)
        _rub(machine, work, now.joint.pressure)
        before = now.amplitudes
        warm_screw(machine.drives, (steps.ways, n), work.drive, before, work.state, work.driven)
        if (
            at % SELDOM == 0
            and _may_alternate(turning, LARGE)
            and not _dies_out(machine, work, steps, n, now)
        ):
            return
        taken, residual, iterations = _step(machine, work, steps, n, now)
        if not taken:
            return
        put(work.conducted, record.conducted[n])
        probe(work.here, work.moved, record.displacement[n])
        for e in range(pressure.size):
            record.heat_flow[n, e] = work.left[e]
        record.residual[n] = residual
        looks = at % SOMETIMES == 0 and _may_alternate(turning, 0.0)
        if looks and not _gain(machine, work, steps, n, now) <= GAIN:
            return
        turn(turning, now.joint.pressure, pressure, machine.scale)
        take(machine.joint, work.here.trial, now.joint, record.remainder[n])
        air = work.driven[machine.drives.ambient]
        warm_scale(machine.drives, machine.length, before, work.amplitudes, air, work.state)
        put(work.amplitudes, now.amplitudes)
        put(work.state, now.drive)
        _note(work, now, record, n)
        record.iterations[n] = iterations


@compiled_part
def _step(
    machine: AxesKernel, work: AxesWork, steps: AxesSteps, n: int, now: AxesState
) -> tuple[bool, float, int]:
    """Take heat, then contact: success without a loose body, residual, iterations."""
    guides, passed, joint, pressure = machine.guides, work.passed, machine.joint, work.pressure
    put(now.amplitudes, work.without)
    drive(machine.heat, work.without, work.driven)
    warm(guides, passed, work.without)
    conduct(joint, now.joint.pressure, work.conducted)
    if not exchange(guides, passed, work.conducted, work.known[0]):
        return False, np.nan, 0
    put(passed.leaving, work.left)
    put(work.without, work.amplitudes)
    enter(guides, passed, work.amplitudes)
    _displace(machine, work, steps, n)
    left, iterations = _settle(machine, work, steps, n, now)
    if not left >= 0.0:
        return False, left, iterations
    for e in range(pressure.size):
        pressure[e] = joint.preload[e] + work.here.trial.value[0, e]
    tangent = work.here.trial.tangent
    return surely_held(machine.watched, work.check, pressure, tangent), left, iterations


@compiled_part
def _dies_out(
    machine: AxesKernel, work: AxesWork, steps: AxesSteps, n: int, now: AxesState
) -> bool:
    """Whether alternation decays at constant inputs and travel; `now` is restored afterwards.

    If it does not soon, `fesim.march.stepping` checks whether the steps oscillate.
    """
    joint, turning, quiet = now.joint, np.zeros_like(now.turning), 0
    amplitudes, gap, slip = now.amplitudes.copy(), joint.gap.copy(), joint.slip.copy()
    pressure, change = joint.pressure.copy(), joint.change.copy()
    for _ in range(3 * STUBBORN):
        if not _step(machine, work, steps, n, now)[0]:
            break
        turn(turning, joint.pressure, work.pressure, machine.scale)
        quiet = 0 if _may_alternate(turning, 0.0) else quiet + 1
        take(machine.joint, work.here.trial, joint, work.remainder)
        put(work.amplitudes, now.amplitudes)
        if quiet == STUBBORN:
            break
    put(amplitudes, now.amplitudes)
    put(gap, joint.gap)
    put(slip, joint.slip)
    put(pressure, joint.pressure)
    put(change, joint.change)
    return quiet == STUBBORN


@compiled_part
def _rub(machine: AxesKernel, work: AxesWork, pressure: Array) -> None:
    """Compute the frictional heat of motion of the rows and among the inputs."""
    guides, heat = machine.guides, work.conducted
    axes = guides.first.size - 1
    fill(heat, 0.0)
    for axis in range(axes):
        total = 0.0
        for e in guides.riding[guides.group[axis] : guides.group[axis + 1]]:
            heat[e] = machine.running[e] * pressure[e] * work.passed.length[axis]
            total += heat[e]
        work.driven[work.driven.size - axes + axis] = total * machine.copies
    rub(guides, work.passed, heat)


@compiled_part
def _displace(machine: AxesKernel, work: AxesWork, steps: AxesSteps, n: int) -> None:
    """Compute the untied displacements that the surrounding aligned positions need."""
    table, touched, weight = steps.table, steps.touched[n], steps.weight[n]
    held, count, size = machine.pads.held, work.pressure.size, work.alone.size
    others = table.anchored.shape[2] + table.probes.shape[1]
    stations = (size - others) // 3 - count
    wanted = work.wanted
    fill(wanted, 0.0)
    for i in range(held.size):
        wanted[held[i]] = True
        direction, e = divmod(held[i], count)
        for c in range(touched.size):
            at = table.place[touched[c], e]
            if weight[c] != 0.0 and at >= 0:
                wanted[3 * count + direction * stations + at] = True
    for row in range(size - others, size):
        wanted[row] = True
    multiply(machine.untied, wanted, work.amplitudes, work.alone)


@compiled_part
def _open(pads: Pads, steps: AxesSteps, n: int, alone: Array, here: Here) -> None:
    """Compute gaps and probes without contact at the position of the axes."""
    table, touched, weight = steps.table, steps.touched[n], steps.weight[n]
    for c in range(touched.size):
        if weight[c] != 0.0:
            at = touched[c]
            one = CornerTable(
                table.compliance[at : at + 1],
                table.probes[at : at + 1],
                table.anchored[at : at + 1],
                table.place[at : at + 1],
            )
            grown(one, pads, alone, steps.free[at : at + 1])
    mixed(steps.free, touched, weight, here.free)


@compiled_part
def _settle(
    machine: AxesKernel, work: AxesWork, steps: AxesSteps, n: int, now: AxesState
) -> tuple[float, int]:
    """Settle the joints at the position of the axes: the error left, m, or NaN; iterations."""
    here, pads, table = work.here, machine.pads, steps.table
    touched, weight = steps.touched[n], steps.weight[n]
    _open(pads, steps, n, work.alone, here)
    mixed(table.compliance, touched, weight, work.packed)
    unpacked(work.packed, here.compliance)
    mixed(table.probes.reshape(len(table.probes), -1), touched, weight, work.moved)
    gap, change = now.joint.gap.reshape(-1), now.joint.change.reshape(-1)
    # While axes move, gaps do not continue their last change.
    moves = largest(work.passed.length) > 0.0
    for i in range(pads.held.size):
        at = pads.held[i]
        here.gap[i] = gap[at] + (0.0 if moves else change[at])
    left, iterations = settle_here(pads, here, work.known[0], EXACT)
    if left >= 0.0 or moves:
        return left, iterations
    for i in range(pads.held.size):
        here.gap[i] = gap[pads.held[i]]
    return settle_here(pads, here, work.known[0], EXACT)


@compiled_part
def _turns(turning: Array, element: int) -> bool:
    """Whether an element is `fesim.march.alternation.suspected`."""
    return turning[1, element] >= SUSPECTED and turning[2, element] == 0.0


@compiled_part
def _may_alternate(turning: Array, above: float) -> bool:
    """Whether any element is suspected, with an increment above a limit."""
    doubtful = False
    for e in range(turning.shape[1]):
        doubtful = doubtful or (_turns(turning, e) and abs(turning[0, e]) > above)
    return doubtful


@compiled_part
def _gain(machine: AxesKernel, work: AxesWork, steps: AxesSteps, n: int, now: AxesState) -> float:
    """Gain of a step: `fesim.march.alternation.gain_of`, from the same step taken twice."""
    pressure, turning, again = work.pressure, now.turning, work.again
    conduct(machine.joint, pressure, work.conducted)
    if not exchange(machine.guides, work.passed, work.conducted, work.known[1]):
        return np.inf
    for row in range(work.left.size):
        work.left[row] -= work.passed.leaving[row]
    add_rows(machine.warmed, work.passed.touched, work.left, work.alone)
    _open(machine.pads, steps, n, work.alone, again)
    put(work.here.gap, again.gap)
    if not settle_here(machine.pads, again, work.known[1], ROUGHLY)[0] >= 0.0:
        return np.inf
    most, gain = 1e-300, 0.0
    for e in range(pressure.size):
        if _turns(turning, e):
            once = (pressure[e] - now.joint.pressure[e]) / machine.scale[e]
            most = max(most, LEADING * abs(once))
    for e in range(pressure.size):
        once = (pressure[e] - now.joint.pressure[e]) / machine.scale[e]
        if _turns(turning, e) and abs(once) >= most:
            after = machine.joint.preload[e] + again.trial.value[0, e]
            gain = max(gain, -(after - pressure[e]) / machine.scale[e] / once)
    return gain


@compiled_part
def turn(turning: Array, before: Array, after: Array, scale: Array) -> None:
    """Record the increments of a step: `fesim.march.alternation.turnings`, in place."""
    for e in range(before.size):
        moved, last = (after[e] - before[e]) / scale[e], turning[0, e]
        if abs(moved) <= LEAST:
            turning[2, e] = turning[2, e] + 1.0 if last != 0.0 else 0.0
            continue
        turned = moved * last < 0.0 and turning[2, e] <= STILL
        once = 1.0 if 0.0 < turning[1, e] < SUSPECTED else 0.0
        turning[0, e], turning[1, e], turning[2, e] = moved, 1.0 + once if turned else 0.0, 0.0


@compiled_part
def _note(work: AxesWork, now: AxesState, record: AxesRecord, n: int) -> None:
    """Copy the results of a step into row n of the record."""
    put(work.driven, record.inputs[n])
    put(now.amplitudes, record.amplitudes[n])
    put(now.joint.gap, record.gap[n])
    put(now.joint.slip, record.slip[n])
    put(now.joint.pressure, record.pressure[n])
    put(now.joint.change, record.change[n])
    put(now.turning, record.turning[n])
    put(now.drive, record.drive[n])
