"""A staggered step on a diagonal thermal model in machine code, and a march of such steps.

The arithmetic of `fesim.march.stepping.staggered` for what it knows by name: implicit Euler on
modes, Eq. 11 or a fixed value for what joints conduct, the laws of `fesim.joint.compiled_gap`.
Nothing is factorised anew in a step: the gap equations and the joint heat flows are iterated with
inverses that are kept (`fesim.joint.modified_newton`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from artefacts.arrays import Array
from fesim.joint.compiled_gap import largest, solve_in_place
from fesim.joint.loosening import Watched, surely_held
from fesim.joint.modified_newton import MADE, Anchor, settle_near
from fesim.machine_code import compiled

#: Joint heat flows are iterated until their equations lack no more than this part of what drives
#: them; after more iterations than `HEAT_PATIENCE` the inverse is made anew.
HEAT_TOLERANCE = 1e-13
HEAT_PATIENCE = 8

#: Why a march stopped: it is through; a joint has no equilibrium near; a body may have come loose.
THROUGH, SNAPS, LOOSE = range(3)


class HeatStep(NamedTuple):
    """Implicit Euler of one length on r modes that do not know of each other.

    Attributes
    ----------
    decay : ndarray, shape (r,)
        Of the amplitudes.
    drive : ndarray, shape (r, k)
        Amplitudes per unit of each input.
    influence : ndarray, shape (r, m)
        Amplitudes per W across each contact element.
    joint_influence : ndarray, shape (m, m)
        Temperature jumps per W across each contact element, K/W.
    """

    decay: Array
    drive: Array
    influence: Array
    joint_influence: Array


class JointKernel(NamedTuple):
    """What the joint needs of a machine, whatever the step.

    Attributes
    ----------
    jump : ndarray, shape (m, r)
        Temperature jump at every contact element, K.
    held : ndarray, shape (m,)
        Conductance times area that the modes hold, W/K.
    conductance : ndarray, shape (m, 3)
        Factor times area (W/K), hardness (Pa) and exponent of Eq. 11.
    laws : ndarray, shape (m, 7)
        As in `fesim.joint.compiled_gap.CompiledGap`.
    springs, compliance, columns : ndarray, shapes (3 m,) and (3 m, 3 m)
        k0, F and F transposed of the gap problem.
    gap, loaded_gap : ndarray, shapes (3 m, r) and (3 m, l)
        J0^-1 S_T, and the same of loads: gaps of the joint that sticks at its preload, m.
    preload : ndarray, shape (m,)
        Pa.
    reference : ndarray, shape (3 m,)
        k, Pa/m.
    moved : ndarray, shape (axes, 3 m)
        D_C A: displacement per traction, m/Pa.
    free, loaded : ndarray, shapes (axes, r) and (axes, l)
        D_T, and displacement per load, m.
    tolerance : float
        Of the gap equations, m.
    """

    jump: Array
    held: Array
    conductance: Array
    laws: Array
    springs: Array
    compliance: Array
    columns: Array
    gap: Array
    loaded_gap: Array
    preload: Array
    reference: Array
    moved: Array
    free: Array
    loaded: Array
    tolerance: float


class Moving(NamedTuple):
    """What a step goes on from, written in place; shapes as in `fesim.march.stepping.State`."""

    amplitudes: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array


class Kept(NamedTuple):
    """Inverses that are kept from step to step, written in place.

    Attributes
    ----------
    anchor : Anchor
        Of the gap equations.
    conducted : ndarray, shape (m,)
        Conductance times area at which the other was made, W/K; zero at first.
    flows : ndarray, shape (m, m)
        (I + diag(conducted) S)^-1.
    """

    anchor: Anchor
    conducted: Array
    flows: Array


class Record(NamedTuple):
    """What is recorded of n steps; shapes begin with n, then as in `Step` and `State`.

    Attributes
    ----------
    conducted : ndarray, shape (n, m)
        Conductance times area, W/K.
    anchor : ndarray, shape (n, 7, m)
        As in `fesim.march.stepping.State`.
    """

    amplitudes: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array
    anchor: Array
    conducted: Array
    heat_flow: Array
    displacement: Array
    remainder: Array
    residual: Array
    iterations: Array


@compiled
def _drive(heat: HeatStep, amplitudes: Array, inputs: Array) -> None:
    """The amplitudes after a step without joint, in place."""
    for k in range(amplitudes.size):
        total = heat.decay[k] * amplitudes[k]
        for i in range(heat.drive.shape[1]):
            total += heat.drive[k, i] * inputs[i]
        amplitudes[k] = total


@compiled
def _conduct(joint: JointKernel, pressure: Array, conducted: Array) -> None:
    """Conductance times area (m,), W/K, at pressures (m,), Pa."""
    for e in range(pressure.size):
        factor, hardness, exponent = joint.conductance[e]
        conducted[e] = factor * (pressure[e] / hardness) ** exponent


@compiled
def conduct_step(
    heat: HeatStep, joint: JointKernel, amplitudes: Array, inputs: Array, pressure: Array
) -> None:
    """Advance the amplitudes (r,) by one step, in place, at the conductance of pressures (m,)."""
    count = pressure.size
    _drive(heat, amplitudes, inputs)
    beyond = np.empty(count)
    _conduct(joint, pressure, beyond)
    beyond -= joint.held
    system, flow = np.empty((count, count)), np.dot(joint.jump, amplitudes)
    for e in range(count):
        flow[e] *= beyond[e]
        for f in range(count):
            system[e, f] = beyond[e] * heat.joint_influence[e, f]
        system[e, e] += 1.0
    amplitudes -= np.dot(heat.influence, np.linalg.solve(system, flow))


@compiled
def _flow(joint_influence: Array, beyond: Array, jump: Array, kept: Kept, flow: Array) -> None:
    """Solve (I + diag(beyond) S) j = diag(beyond) jump with the kept inverse, into `flow` (m,)."""
    driving = beyond * jump
    enough = HEAT_TOLERANCE * largest(driving)
    if not kept.conducted.any():
        _invert_flows(joint_influence, beyond, kept)
    for attempt in range(2):
        flow[:] = np.dot(kept.flows, driving)
        for _ in range(HEAT_PATIENCE):
            lack = driving - flow - beyond * np.dot(joint_influence, flow)
            if largest(lack) <= enough:
                return
            flow += np.dot(kept.flows, lack)
        if attempt == 0:
            _invert_flows(joint_influence, beyond, kept)


@compiled
def _invert_flows(joint_influence: Array, beyond: Array, kept: Kept) -> None:
    """Make the inverse of the joint heat flows anew."""
    count = beyond.size
    system = np.empty((count, count))
    for e in range(count):
        for f in range(count):
            system[e, f] = beyond[e] * joint_influence[e, f]
        system[e, e] += 1.0
    kept.flows[:] = np.linalg.inv(system)
    kept.conducted[:] = beyond


@compiled
def settle_step(
    joint: JointKernel,
    amplitudes: Array,
    gap: Array,
    slip: Array,
    pressure: Array,
    change: Array,
    displacement: Array,
) -> int:
    """Settle the joint (3, m), (2, m), (m,), (3, m) and read the displacement (axes,), in place.

    Returns 0, or anything else if no equilibrium was near: then the joint is as it was.
    """
    count = pressure.size
    value, moved, tangent = np.empty((3, count)), np.empty((2, count)), np.empty((6, count))
    found, remainder = gap + change, np.empty(3 * count)
    free_gap = np.dot(joint.gap, amplitudes)
    solved, _, _ = _newton(joint, free_gap, slip, gap, found, value, moved, tangent)
    if not solved:
        return 1
    _take(joint, found, value, moved, gap, slip, pressure, change, remainder)
    displacement[:] = np.dot(joint.free, amplitudes) + np.dot(joint.moved, remainder)
    return 0


@compiled
def _newton(
    joint: JointKernel,
    free_gap: Array,
    slip: Array,
    gap: Array,
    found: Array,
    value: Array,
    moved: Array,
    tangent: Array,
) -> tuple[bool, float, int]:
    """Newton's method from `found`, then from `gap`: whether it is solved, residual, iterations."""
    for attempt in range(2):
        if attempt == 1:
            found[:] = gap
        try:
            outcome, residual, iterations = solve_in_place(
                joint.springs,
                joint.compliance,
                joint.laws,
                free_gap,
                slip,
                joint.tolerance,
                found,
                value,
                moved,
                tangent,
            )
        except Exception:  # a singular tangent: machine code knows no other name for it
            outcome, residual, iterations = 1, np.nan, 0
        if outcome == 0:
            return True, residual, iterations
    return False, np.nan, 0


@compiled
def _take(
    joint: JointKernel,
    found: Array,
    value: Array,
    moved: Array,
    gap: Array,
    slip: Array,
    pressure: Array,
    change: Array,
    remainder: Array,
) -> None:
    """Put a joint that has settled in the place of what it was, and z + k g into `remainder`."""
    count = pressure.size
    for i in range(3):
        for e in range(count):
            change[i, e] = found[i, e] - gap[i, e]
            gap[i, e] = found[i, e]
            remainder[i * count + e] = value[i, e] + joint.reference[i * count + e] * found[i, e]
    slip[:] = moved
    for e in range(count):
        pressure[e] = joint.preload[e] + value[0, e]


@compiled
def _settle(
    joint: JointKernel,
    kept: Kept,
    free_gap: Array,
    now: Moving,
    found: Array,
    value: Array,
    moved: Array,
    tangent: Array,
) -> tuple[bool, float, int]:
    """The kept inverse first, then Newton's method: whether it is solved, residual, iterations."""
    found[:] = now.gap + now.change
    try:
        solved, residual, iterations = settle_near(
            joint.springs,
            joint.compliance,
            joint.columns,
            joint.laws,
            free_gap,
            now.slip,
            joint.tolerance,
            kept.anchor,
            found,
            value,
            moved,
            tangent,
        )
    except Exception:  # a singular tangent
        solved, residual, iterations = False, np.nan, 0
    if solved:
        return True, residual, iterations
    kept.anchor.about[MADE] = 0
    found[:] = now.gap + now.change
    return _newton(joint, free_gap, now.slip, now.gap, found, value, moved, tangent)


@compiled
def march_steps(
    heat: HeatStep,
    joint: JointKernel,
    kept: Kept,
    inputs: Array,
    now: Moving,
    record: Record,
    watched: Watched,
) -> tuple[int, int]:
    """March through inputs (n, k + l) into `record`, in place.

    Returns
    -------
    taken : int
        Steps that are recorded.
    why : int
        `THROUGH`; `SNAPS`: the next step's gap equations have no near solution, and `now` is what
        it goes on from; `LOOSE`: the last step taken is to be looked at by `Watch.check`.
    """
    count, thermal = now.pressure.size, heat.drive.shape[1]
    value, moved, tangent = np.empty((3, count)), np.empty((2, count)), np.empty((6, count))
    found, flow, conducted = np.empty((3, count)), np.empty(count), np.empty(count)
    amplitudes = np.empty_like(now.amplitudes)
    for k in range(len(inputs)):
        amplitudes[:] = now.amplitudes
        _drive(heat, amplitudes, inputs[k])
        _conduct(joint, now.pressure, conducted)
        jump = np.dot(joint.jump, amplitudes)
        _flow(heat.joint_influence, conducted - joint.held, jump, kept, flow)
        amplitudes -= np.dot(heat.influence, flow)
        free_gap = np.dot(joint.gap, amplitudes)
        for i in range(joint.loaded.shape[1]):
            free_gap += inputs[k, thermal + i] * joint.loaded_gap[:, i]
        solved, residual, iterations = _settle(
            joint, kept, free_gap, now, found, value, moved, tangent
        )
        if not solved:
            return k, SNAPS
        now.amplitudes[:] = amplitudes
        _take(
            joint,
            found,
            value,
            moved,
            now.gap,
            now.slip,
            now.pressure,
            now.change,
            record.remainder[k],
        )
        displacement = np.dot(joint.free, amplitudes) + np.dot(joint.moved, record.remainder[k])
        for i in range(joint.loaded.shape[1]):
            displacement += inputs[k, thermal + i] * joint.loaded[:, i]
        record.displacement[k] = displacement
        _note(record, k, now, kept, conducted, flow, residual, iterations)
        if not surely_held(watched, now.pressure, tangent):
            return k + 1, LOOSE
    return len(inputs), THROUGH


@compiled
def _note(
    record: Record,
    k: int,
    now: Moving,
    kept: Kept,
    conducted: Array,
    flow: Array,
    residual: float,
    iterations: int,
) -> None:
    """Copy what a step has come to into row k of the record."""
    record.amplitudes[k] = now.amplitudes
    record.gap[k] = now.gap
    record.slip[k] = now.slip
    record.pressure[k] = now.pressure
    record.change[k] = now.change
    record.conducted[k] = conducted
    record.heat_flow[k] = flow
    record.residual[k] = residual
    record.iterations[k] = iterations
    record.anchor[k, 6] = kept.conducted
    if kept.anchor.about[MADE] == 1:
        record.anchor[k, :6] = kept.anchor.tangent
    else:
        record.anchor[k, :6] = 0.0
