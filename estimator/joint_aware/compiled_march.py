"""The step of `physics` in machine code, and a march of such steps without the interpreter.

The same arithmetic as `physics.conduct` and `physics.settle_joint`: heat with the joint of the last
step, then the gap equations by the solver of `fesim.joint.compiled_gap`. What the kernels cannot
do, a conductance that is no power law or a joint that snaps, is left to the plain step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from artefacts.arrays import Array
from fesim.joint.compiled_gap import compile_gap, solve_in_place
from fesim.joint.law import PowerLawConductance
from fesim.machine_code import compiled
from fesim.march.stepping import CondensedMachine


class HeatStep(NamedTuple):
    """Implicit Euler of one length; shapes as in `reduced_machine.Modes`.

    Attributes
    ----------
    decay : ndarray, shape (r,)
        Of the amplitudes.
    drive : ndarray, shape (r, s + 1)
        Amplitudes per W of each source and K of the ambient.
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
    springs, compliance : ndarray, shapes (3 m,) and (3 m, 3 m)
        k0 and F of the gap problem.
    gap : ndarray, shape (3 m, r)
        J0^-1 S_T: gaps of the joint that sticks at its preload, m.
    preload : ndarray, shape (m,)
        Pa.
    reference : ndarray, shape (3 m,)
        k, Pa/m.
    moved : ndarray, shape (axes, 3 m)
        D_C A: displacement per traction, m/Pa.
    free : ndarray, shape (axes, r)
        D_T, m.
    tolerance : float
        Of the gap equations, m.
    """

    jump: Array
    held: Array
    conductance: Array
    laws: Array
    springs: Array
    compliance: Array
    gap: Array
    preload: Array
    reference: Array
    moved: Array
    free: Array
    tolerance: float


@compiled
def conduct_step(
    heat: HeatStep, joint: JointKernel, amplitudes: Array, inputs: Array, pressure: Array
) -> None:
    """Advance the amplitudes (r,) by one step, in place: `physics.conduct`."""
    count = pressure.size
    for k in range(amplitudes.size):
        total = heat.decay[k] * amplitudes[k]
        for i in range(inputs.size):
            total += heat.drive[k, i] * inputs[i]
        amplitudes[k] = total
    system, flow = np.empty((count, count)), np.dot(joint.jump, amplitudes)
    for e in range(count):
        factor, hardness, exponent = joint.conductance[e]
        beyond = factor * (pressure[e] / hardness) ** exponent - joint.held[e]
        flow[e] *= beyond
        for f in range(count):
            system[e, f] = beyond * heat.joint_influence[e, f]
        system[e, e] += 1.0
    amplitudes -= np.dot(heat.influence, np.linalg.solve(system, flow))


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
    free_gap = np.dot(joint.gap, amplitudes)
    found = gap + change
    outcome = 1
    for attempt in range(2):
        if attempt == 1:
            found[:] = gap
        try:
            outcome = solve_in_place(
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
            )[0]
        except Exception:  # a singular tangent: machine code knows no other name for it
            outcome = 1
        if outcome == 0:
            break
    if outcome != 0:
        return outcome
    remainder = np.empty(3 * count)
    for i in range(3):
        for e in range(count):
            change[i, e] = found[i, e] - gap[i, e]
            gap[i, e] = found[i, e]
            remainder[i * count + e] = value[i, e] + joint.reference[i * count + e] * found[i, e]
    slip[:] = moved
    for e in range(count):
        pressure[e] = joint.preload[e] + value[0, e]
    displacement[:] = np.dot(joint.free, amplitudes) + np.dot(joint.moved, remainder)
    return 0


@compiled
def march_steps(
    heat: HeatStep,
    joint: JointKernel,
    inputs: Array,
    amplitudes: Array,
    gap: Array,
    slip: Array,
    pressure: Array,
    change: Array,
    history: Array,
    displacement: Array,
) -> int:
    """March through inputs (n, s + 1) into `history` (n, r) and `displacement` (n, axes), in place.

    Returns the number of steps taken; where it is less than n, the heat of the next step is
    conducted already and its gap equations have no near solution.
    """
    for k in range(len(inputs)):
        conduct_step(heat, joint, amplitudes, inputs[k], pressure)
        history[k] = amplitudes
        if settle_step(joint, amplitudes, gap, slip, pressure, change, displacement[k]) != 0:
            return k
    return len(inputs)


def joint_kernel(machine: CondensedMachine, jump: Array, held: Array) -> JointKernel | None:
    """Return what the kernels need of a machine, or None if a law of it is none they know.

    Parameters
    ----------
    machine : CondensedMachine
        Its gap equations; what it says of heat is not asked.
    jump : ndarray, shape (m, r)
        Temperature jump at every contact element, K.
    held : ndarray, shape (m,)
        Conductance times area that the modes hold, W/K.
    """
    elastic = machine.elastic
    solver = compile_gap(machine.gap_problem, machine.laws)
    conductance = _conductance_table(machine)
    if solver is None or conductance is None:
        return None
    problem = solver.problem

    def own(values: Array) -> Array:
        # Machine code is made for one layout: contiguous.
        return np.ascontiguousarray(values, dtype=np.float64)

    return JointKernel(
        jump=own(jump),
        held=own(held),
        conductance=conductance,
        laws=own(solver.laws),
        springs=own(problem.springs),
        compliance=own(problem.compliance),
        gap=own(problem.exchange @ elastic.thermal_gap),
        preload=own(machine.preload),
        reference=own(elastic.reference),
        moved=own(elastic.probe_compliance * elastic.area),
        free=own(elastic.probe_thermal),
        tolerance=machine.gap_tolerance,
    )


def _conductance_table(machine: CondensedMachine) -> Array | None:
    """Rows of `JointKernel.conductance`, or None if one is no power law."""
    table, start = np.empty((machine.contacts, 3)), 0
    for law, count in machine.laws:
        one, at = law.conductance, slice(start, start + count)
        if not isinstance(one, PowerLawConductance):
            return None
        table[at, 0] = one.factor * machine.elastic.area[at]
        table[at, 1:] = one.hardness, one.exponent
        start += count
    return table
