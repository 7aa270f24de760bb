"""JIT-compiled time integration with staggered steps and frozen tangents.

A step needs no new factorisation as long as the stored ones are usable: for the gap equations that
of `fesim.joint.modified_newton`, for the joint heat flows that of `fesim.march.joint_flows`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled, compiled_part
from fesim.joint.frozen_tangent import FrozenTangents, add_product, forget, put_tangents
from fesim.joint.in_place import add, put
from fesim.joint.loosening import Watched, WatchWork, surely_held
from fesim.joint.modified_newton import settle_near
from fesim.march.compiled_step import (
    HeatStep,
    JointKernel,
    JointState,
    JointWork,
    add_loads,
    conduct,
    displace,
    drive,
    gap_kernel,
    settle_by_newton,
    take,
)
from fesim.march.extrapolation import differ, extrapolate
from fesim.march.joint_flows import Flows, solve_flows
from thermojoint.artefacts.arrays import Array

#: Rows of `State.frozen` (7, m): six entries of the frozen tangent, then the frozen conductance.
FROZEN_TANGENT, FROZEN_CONDUCTED = slice(0, 6), 6
#: Reason for the end of a march: complete; no equilibrium near; a body may have come loose.
THROUGH, SNAPS, LOOSE = range(3)


class MarchKernel(NamedTuple):
    """Data of a compiled march: heat step, joints, and detection of loose bodies."""

    heat: HeatStep
    joint: JointKernel
    watched: Watched


class Moving(NamedTuple):
    """State between two steps, updated in place: amplitudes (r,), K, and the joint."""

    amplitudes: Array
    joint: JointState
    #: As in `fesim.march.machine.State`.
    differences: Array


class Kept(NamedTuple):
    """Factors that are reused from step to step, and work arrays; written in place."""

    #: Factors of the gap equations, block by block.
    tangents: FrozenTangents
    #: Factors of the joint heat flows.
    flows: Flows
    #: Work arrays of the joint.
    work: JointWork
    #: Work arrays of the detection of loose bodies.
    check: WatchWork


class Solved(NamedTuple):
    """Further results of a step: heat, W/K and W, (m,); residual and iterations."""

    conducted: Array
    flow: Array
    residual: float
    iterations: int


class Record(NamedTuple):
    """Records of n steps; the first dimension is n, the others as in `Step` and `State`."""

    amplitudes: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array
    #: Shapes (n, 3, 3 m) and (n, 7, m): as in `fesim.march.machine.State`.
    differences: Array
    frozen: Array
    #: Shape (n, m): conductance times area, W/K.
    conducted: Array
    heat_flow: Array
    displacement: Array
    remainder: Array
    residual: Array
    iterations: NDArray[np.int64]


@compiled_part
def settle(
    joint: JointKernel, kept: Kept, now: JointState, ahead: Array
) -> tuple[bool, float, int]:
    """Settle with the stored factors, else by Newton's method: success, residual, iterations.

    `ahead` (3, m) is the expected change of the gaps, m.
    """
    free_gap, rest, trial = kept.work.free_gap, kept.work.rest, kept.work.trial
    put(now.gap, trial.gap)
    add(ahead, trial.gap)
    try:
        solved, residual, iterations = settle_near(
            gap_kernel(joint), kept.tangents, free_gap, rest, now.slip, trial
        )
    except Exception:  # a singular tangent
        solved, residual, iterations = False, np.nan, 0
    if solved:
        return True, residual, iterations
    forget(kept.tangents)
    if not joint.columns.size:  # Newton's method needs them: left to the plain step
        return False, residual, iterations
    put(now.gap, trial.gap)
    add(ahead, trial.gap)
    add_product(joint.columns, rest, free_gap)  # J0^-1 g_T
    return settle_by_newton(joint, free_gap, now, trial, kept.work.newton)


@compiled
def march_steps(
    machine: MarchKernel, kept: Kept, inputs: Array, now: Moving, record: Record
) -> tuple[int, int]:
    """March through inputs (n, k + l) into `record`, in place.

    Returns
    -------
    taken : int
        Number of recorded steps.
    why : int
        `THROUGH`; `SNAPS`: the gap equations of the next step have no solution nearby, and `now` is
        its initial state; `LOOSE`: `Watch.check` must examine the last step.
    """
    heat, joint = machine.heat, machine.joint
    count, thermal = now.joint.pressure.size, heat.drive.shape[1]
    flow, conducted = np.empty(count), np.empty(count)
    beyond, jump = np.empty(count), np.empty(count)
    free_gap, rest = kept.work.free_gap, kept.work.rest
    amplitudes, drawn = np.empty_like(now.amplitudes), np.empty_like(now.amplitudes)
    change, before = now.joint.change.reshape(-1), np.empty(3 * count)
    ahead = np.empty((3, count))
    for k in range(len(inputs)):
        put(now.amplitudes, amplitudes)
        drive(heat, amplitudes, inputs[k])
        conduct(joint, now.joint.pressure, conducted)
        np.dot(joint.jump, amplitudes, jump)
        for e in range(count):
            beyond[e] = conducted[e] - joint.held[e]
        solve_flows(heat.joint_influence, beyond, jump, kept.flows, flow)
        np.dot(heat.influence, flow, drawn)
        for r in range(amplitudes.size):
            amplitudes[r] -= drawn[r]
        np.dot(joint.gap, amplitudes, free_gap)
        add_loads(joint.loaded_gap, inputs[k, thermal:], free_gap)
        for row in range(rest.size):
            rest[row] = joint.change[row] * free_gap[row]
        extrapolate(change, now.differences, ahead.reshape(-1))
        solved, residual, iterations = settle(joint, kept, now.joint, ahead)
        if not solved:
            return k, SNAPS
        put(amplitudes, now.amplitudes)
        put(change, before)
        take(joint, kept.work.trial, now.joint, record.remainder[k])
        differ(before, change, now.differences)
        loads, remainder = inputs[k, thermal:], record.remainder[k]
        displace(joint, kept.work.moved, amplitudes, loads, remainder, record.displacement[k])
        _note(record, k, now, kept, Solved(conducted, flow, residual, iterations))
        tangent = kept.work.trial.tangent
        if not surely_held(machine.watched, kept.check, now.joint.pressure, tangent):
            return k + 1, LOOSE
    return len(inputs), THROUGH


@compiled_part
def _note(record: Record, k: int, now: Moving, kept: Kept, solved: Solved) -> None:
    """Copy the results of a step into row k of the record."""
    put(now.amplitudes, record.amplitudes[k])
    put(now.joint.gap, record.gap[k])
    put(now.joint.slip, record.slip[k])
    put(now.joint.pressure, record.pressure[k])
    put(now.joint.change, record.change[k])
    put(now.differences, record.differences[k])
    put(solved.conducted, record.conducted[k])
    put(solved.flow, record.heat_flow[k])
    record.residual[k] = solved.residual
    record.iterations[k] = solved.iterations
    put(kept.flows.conducted, record.frozen[k, FROZEN_CONDUCTED])
    put_tangents(kept.tangents, record.frozen[k, FROZEN_TANGENT])
