"""JIT-compiled time step of heat and joint on uncoupled modes.

The arithmetic of `fesim.march.stepping.staggered` for built-in laws: implicit Euler on modes,
conductances by Eq. 11 or fixed ones, the laws of `fesim.joint.compiled_gap`. These are single
steps; `fesim.march.compiled_march` takes one after another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fesim.jit import compiled, compiled_part
from fesim.joint.compiled_gap import (
    GapKernel,
    NewtonWork,
    Trial,
    newton_work,
    solve_in_place,
    trial_at,
)
from fesim.joint.in_place import add, put
from fesim.joint.linear_system import solve
from thermojoint.artefacts.arrays import Array


class HeatStep(NamedTuple):
    """Implicit Euler step of one length on r uncoupled modes."""

    #: Shape (r,): factors on the amplitudes.
    decay: Array
    #: Shape (r, k): amplitudes per unit of each input.
    drive: Array
    #: Shape (r, m): amplitudes per W across each contact element.
    influence: Array
    #: Shape (m, m): temperature jumps per W across each contact element, K/W.
    joint_influence: Array


class JointKernel(NamedTuple):
    """Joint data of a machine, independent of the step length."""

    #: Shape (m, r): temperature jump at every contact element, K.
    jump: Array
    #: Shape (m,): conductance times area that the modes include, W/K.
    held: Array
    #: Shape (m, 3): factor times area (W/K), hardness (Pa) and exponent of Eq. 11.
    conductance: Array
    #: Shape (m, 7): as in `fesim.joint.compiled_gap.CompiledGap`.
    laws: Array
    #: Shapes (3 m,) and (3 m, 3 m): k0, F and F transposed of the gap problem.
    springs: Array
    compliance: Array
    columns: Array
    #: Shapes (3 m, r) and (3 m, l): gaps due to heat and loads, m. Either J0^-1 S_T, of the joint
    #: sticking at its preload, and `change` is zero; or S_T, and `change` is k - k0, (3 m,), Pa/m.
    gap: Array
    loaded_gap: Array
    change: Array
    #: Shape (m,): preload, Pa.
    preload: Array
    #: Shape (3 m,): k, Pa/m.
    reference: Array
    #: Shape (axes, 3 m): d_C A: displacement per traction, m/Pa.
    moved: Array
    #: Shapes (axes, r) and (axes, l): d_T, and displacement per load, m.
    free: Array
    loaded: Array
    #: Largest residual of the gap equations, m.
    tolerance: float
    #: As in `GapKernel`.
    left: float = 0.0


class JointState(NamedTuple):
    """The joint after a step; attributes as in `fesim.march.machine.State`."""

    #: Shape (3, m): m.
    gap: Array
    #: Shape (2, m): m.
    slip: Array
    #: Shape (m,): Pa.
    pressure: Array
    #: Shape (3, m): m.
    change: Array


class HeatWork(NamedTuple):
    """Work arrays of a heat step with m contact elements; content is not used afterwards."""

    #: Shape (m,): conductance times area that the modes do not include, W/K, and times the
    #: temperature jump, W.
    beyond: Array
    driving: Array
    #: Shape (m, m): `flow_system`.
    system: Array
    #: Shape (r,): amplitudes removed by the joint heat flows.
    drawn: Array


class JointWork(NamedTuple):
    """Work arrays for settling m contact elements; content is not used afterwards."""

    #: Of the gap equations.
    trial: Trial
    #: Of their solution by Newton's method.
    newton: NewtonWork
    #: Shape (3 m,): J0^-1 g_T, m, or g_T and the tractions (k - k0) g_T, Pa; z + k g, Pa.
    free_gap: Array
    rest: Array
    remainder: Array
    #: Shape (axes,): displacement by the joint, m.
    moved: Array


def heat_work(joint: JointKernel) -> HeatWork:
    """Return work arrays for the heat steps of a machine."""
    count, modes = joint.jump.shape
    return HeatWork(np.empty(count), np.empty(count), np.empty((count, count)), np.empty(modes))


def joint_work(joint: JointKernel) -> JointWork:
    """Return work arrays for settling a joint."""
    size, axes = joint.springs.size, len(joint.free)
    trial, newton = trial_at(np.zeros((3, size // 3))), newton_work(size // 3)
    free_gap, rest, remainder = np.empty(size), np.zeros(size), np.empty(size)
    return JointWork(trial, newton, free_gap, rest, remainder, np.empty(axes))


@compiled_part
def drive(heat: HeatStep, amplitudes: Array, inputs: Array) -> None:
    """The amplitudes after a step without joint, in place."""
    for k in range(amplitudes.size):
        total = heat.decay[k] * amplitudes[k]
        for i in range(heat.drive.shape[1]):
            total += heat.drive[k, i] * inputs[i]
        amplitudes[k] = total


@compiled_part
def conduct(joint: JointKernel, pressure: Array, conducted: Array) -> None:
    """Conductance times area (m,), W/K, at pressures (m,), Pa."""
    for e in range(pressure.size):
        factor, hardness, exponent = joint.conductance[e]
        conducted[e] = factor * (pressure[e] / hardness) ** exponent


@compiled_part
def flow_system(joint_influence: Array, beyond: Array, system: Array) -> None:
    """Write I + diag(beyond) S, the matrix of the joint heat flows, into `system` (m, m)."""
    count = beyond.size
    for e in range(count):
        for f in range(count):
            system[e, f] = beyond[e] * joint_influence[e, f]
        system[e, e] += 1.0


@compiled
def conduct_step(
    heat: HeatStep,
    joint: JointKernel,
    work: HeatWork,
    amplitudes: Array,
    inputs: Array,
    pressure: Array,
) -> None:
    """Advance the amplitudes (r,) by one step, in place, at the conductance of pressures (m,).

    The only array allocated is the LAPACK solution, which Numba copies.
    """
    beyond, driving = work.beyond, work.driving
    drive(heat, amplitudes, inputs)
    conduct(joint, pressure, beyond)
    np.dot(joint.jump, amplitudes, driving)
    for e in range(beyond.size):
        beyond[e] -= joint.held[e]
        driving[e] *= beyond[e]
    flow_system(heat.joint_influence, beyond, work.system)
    np.dot(heat.influence, solve(work.system, driving), work.drawn)
    for k in range(amplitudes.size):
        amplitudes[k] -= work.drawn[k]


@compiled
def gap_kernel(joint: JointKernel) -> GapKernel:
    """The gap equations of a joint."""
    return GapKernel(
        joint.springs,
        joint.compliance,
        joint.columns,
        joint.laws,
        joint.tolerance,
        joint.left,
    )


@compiled_part
def add_loads(influence: Array, loads: Array, total: Array) -> None:
    """Add the effect of loads (l,) with influence (n, l) to a total (n,), in place."""
    for k in range(total.size):
        for i in range(loads.size):
            total[k] += influence[k, i] * loads[i]


@compiled
def settle_step(
    joint: JointKernel,
    work: JointWork,
    amplitudes: Array,
    loads: Array,
    now: JointState,
    displacement: Array,
) -> int:
    """Settle the joint under loads (l,) and write the displacement (axes,), in place.

    Returns 0, or 1 if there is no equilibrium nearby; then the joint is unchanged.
    """
    put(now.gap, work.trial.gap)
    add(now.change, work.trial.gap)
    np.dot(joint.gap, amplitudes, work.free_gap)
    add_loads(joint.loaded_gap, loads, work.free_gap)
    solved, _, _ = settle_by_newton(joint, work.free_gap, now, work.trial, work.newton)
    if not solved:
        return 1
    take(joint, work.trial, now, work.remainder)
    displace(joint, work.moved, amplitudes, loads, work.remainder, displacement)
    return 0


@compiled_part
def displace(
    joint: JointKernel,
    moved: Array,
    amplitudes: Array,
    loads: Array,
    remainder: Array,
    displacement: Array,
) -> None:
    """The displacement (axes,) due to amplitudes (r,), loads (l,) and z + k g (3 m,), in place.

    `moved` (axes,) is a work array.
    """
    np.dot(joint.free, amplitudes, displacement)
    np.dot(joint.moved, remainder, moved)
    add(moved, displacement)
    add_loads(joint.loaded, loads, displacement)


@compiled_part
def settle_by_newton(
    joint: JointKernel, free_gap: Array, now: JointState, trial: Trial, work: NewtonWork
) -> tuple[bool, float, int]:
    """Newton's method from the trial, then from the present gaps.

    Returns success, residual and iterations.
    """
    for attempt in range(2):
        if attempt == 1:
            put(now.gap, trial.gap)
        try:
            outcome, residual, iterations = solve_in_place(
                gap_kernel(joint), free_gap, now.slip, trial, work
            )
        except Exception:  # a singular tangent; compiled code cannot catch a narrower class
            outcome, residual, iterations = 1, np.nan, 0
        if outcome == 0:
            return True, residual, iterations
    return False, np.nan, 0


@compiled_part
def take(joint: JointKernel, trial: Trial, now: JointState, remainder: Array) -> None:
    """Copy a converged trial into the state of the joint, and z + k g into `remainder`."""
    opening, value, gap, change = trial.gap, trial.value, now.gap, now.change
    count = now.pressure.size
    for i in range(3):
        for e in range(count):
            change[i, e] = opening[i, e] - gap[i, e]
            gap[i, e] = opening[i, e]
            remainder[i * count + e] = value[i, e] + joint.reference[i * count + e] * opening[i, e]
    put(trial.moved, now.slip)
    for e in range(count):
        now.pressure[e] = joint.preload[e] + value[0, e]
