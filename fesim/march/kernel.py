"""Data of a condensed machine for the JIT-compiled march, if supported.

Supported are reduced thermal models, the joint laws of `fesim.joint.compiled_gap`, and conductances
that follow Eq. 11 or are fixed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fesim.joint.blocks import Blocks, columns_for, part_of
from fesim.joint.compiled_gap import compile_gap
from fesim.joint.conductance import FixedConductance
from fesim.joint.frozen_tangent import (
    MADE,
    block_tangent,
    freeze_tangent,
    frozen_tangents,
    put_tangents,
)
from fesim.joint.law import JointLaw, PowerLawConductance
from fesim.joint.loosening import UNWATCHED, Watched, watch_work
from fesim.march.compiled_march import (
    FROZEN_CONDUCTED,
    FROZEN_TANGENT,
    LOOSE,
    Kept,
    MarchKernel,
    Moving,
    Record,
    march_steps,
)
from fesim.march.compiled_step import HeatStep, JointKernel, JointState, joint_work
from fesim.march.contact import ContactProblem
from fesim.march.joint_flows import freeze_flows, new_flows
from fesim.march.machine import CondensedMachine, State
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True, eq=False)
class StepKernel:
    """Compiled functions and data for the time integration of a machine."""

    #: Data of its heat step and its joints.
    machine: MarchKernel
    #: Weakly coupled blocks of contact elements.
    blocks: Blocks

    def run(self, kept: Kept, state: State, inputs: Array) -> tuple[Record, int, bool]:
        """March from a state through inputs (n, k + l).

        Parameters
        ----------
        kept : Kept
            Factors of the march, written in place; recomputed if they do not match the state.
        state : State
            State to continue from.
        inputs : ndarray, shape (n, k + l)
            Inputs of each step.

        Returns
        -------
        record : Record
            Records of the steps taken.
        taken : int
            Their number: fewer than n if the next one has no equilibrium nearby.
        loose : bool
            Whether a body may have come loose in the last one.
        """
        if not np.array_equal(_frozen(kept), state.frozen):
            self._make(kept, state.frozen)
        joint = (state.gap, state.slip, state.pressure, state.change)
        temperature, differences, *own = (
            np.array(array, dtype=np.float64, order="C")
            for array in (state.temperature, state.differences, *joint)
        )
        now = Moving(temperature, JointState(*own), differences)
        record = new_record(len(inputs), now, len(self.machine.joint.free))
        driven = np.ascontiguousarray(inputs, dtype=np.float64)
        taken, why = march_steps(self.machine, kept, driven, now, record)
        return Record._make(column[:taken] for column in record), taken, why == LOOSE

    def _make(self, kept: Kept, frozen: Array) -> None:
        """Compute the stored factors, which the frozen tangent (7, m) of a `State` determines."""
        kept.tangents.every.about[:, MADE] = 0
        for k in range(self.blocks.starts.size - 1):
            block = part_of(self.blocks, k)
            tangent = frozen[FROZEN_TANGENT, block.elements]
            if tangent.any():
                own = block_tangent(kept.tangents, k)
                own.tangent[:] = tangent
                freeze_tangent(own, block)
        conducted = np.ascontiguousarray(frozen[FROZEN_CONDUCTED])
        kept.flows.conducted[:] = 0.0
        if conducted.any():
            freeze_flows(self.machine.heat.joint_influence, conducted, kept.flows)


def _frozen(kept: Kept) -> Array:
    """The frozen tangent (7, m) of the stored factors, as in `State`."""
    stored = np.empty((7, kept.flows.conducted.size))
    put_tangents(kept.tangents, stored[FROZEN_TANGENT])
    stored[FROZEN_CONDUCTED] = kept.flows.conducted
    return stored


def new_kept(machine: MarchKernel, blocks: Blocks) -> Kept:
    """Return the factors and work arrays of a new march."""
    return Kept(
        frozen_tangents(blocks),
        new_flows(blocks.elements.size),
        joint_work(machine.joint),
        watch_work(machine.watched),
    )


def new_record(steps: int, now: Moving, axes: int) -> Record:
    """Return storage for a number of steps."""
    count = now.joint.pressure.size
    return Record(
        amplitudes=np.empty((steps, now.amplitudes.size)),
        gap=np.empty((steps, 3, count)),
        slip=np.empty((steps, 2, count)),
        pressure=np.empty((steps, count)),
        change=np.empty((steps, 3, count)),
        differences=np.empty((steps, *now.differences.shape)),
        frozen=np.empty((steps, 7, count)),
        conducted=np.empty((steps, count)),
        heat_flow=np.empty((steps, count)),
        displacement=np.empty((steps, axes)),
        remainder=np.empty((steps, 3 * count)),
        residual=np.empty(steps),
        iterations=np.empty(steps, dtype=np.int64),
    )


def step_kernel(machine: CondensedMachine) -> StepKernel | None:
    """Return the compiled march of a machine, or None if it is not supported."""
    thermal = machine.thermal
    if not machine.contact.count or thermal.factor.solver != "diagonal":
        return None
    contact = machine.contact
    joint = sprung_kernel(contact, np.asarray(thermal.jump), np.zeros(contact.count))
    if joint is None:
        return None
    diagonal = thermal.factor.matrix.diagonal()
    heat = HeatStep(
        decay=thermal.capacity_rate.diagonal() / diagonal,
        drive=owned(thermal.inputs / diagonal[:, None]),
        influence=owned(thermal.influence),
        joint_influence=owned(thermal.joint_influence),
    )
    return StepKernel(MarchKernel(heat, joint, watched_in(contact)), contact.blocks)


def watched_in(contact: ContactProblem) -> Watched:
    """Return the data for the detection of loose bodies."""
    return UNWATCHED if contact.watch is None else contact.watch.watched


def joint_kernel(contact: ContactProblem, jump: Array, held: Array) -> JointKernel | None:
    """Return the joint data of a machine for the kernels, or None if a law is not built in.

    Parameters
    ----------
    contact : ContactProblem
        The joints of a machine.
    jump : ndarray, shape (m, r)
        Temperature jump at every contact element, K.
    held : ndarray, shape (m,)
        Conductance times area that the modes include, W/K.
    """
    joint = sprung_kernel(contact, jump, held)
    if joint is None:
        return None
    at_rest = contact.gap_problem.at_rest
    return joint._replace(
        columns=owned(contact.gap_problem.columns),
        gap=owned(at_rest(joint.gap)),
        loaded_gap=owned(at_rest(joint.loaded_gap)),
        change=np.zeros_like(joint.change),
    )


def sprung_kernel(contact: ContactProblem, jump: Array, held: Array) -> JointKernel | None:
    """`joint_kernel` with the gaps of the condensation's springs, for `march_steps`.

    J0^-1 S_T of many modes takes as long as many steps, and a step with frozen tangents needs a
    product with F anyway. F transposed is not stored for many contact elements in several blocks.
    """
    elastic = contact.elastic
    solver = compile_gap(contact.gap_problem, contact.laws)
    conductance = _conductance_table(contact.laws, elastic.area)
    if solver is None or conductance is None:
        return None
    problem, loads = solver.problem, contact.loads
    unloaded = np.zeros((len(problem.springs), 0)), np.zeros((len(elastic.probe_thermal), 0))
    loaded_gap, loaded = unloaded if loads is None else (loads.gap, loads.probes)
    return JointKernel(
        jump=owned(jump),
        held=owned(held),
        conductance=conductance,
        laws=owned(solver.laws),
        springs=owned(problem.springs),
        compliance=owned(problem.compliance),
        columns=columns_for(problem, contact.blocks),
        gap=owned(elastic.thermal_gap),
        loaded_gap=owned(loaded_gap),
        change=owned(problem.change),
        preload=owned(contact.preload),
        reference=owned(elastic.reference),
        moved=owned(elastic.probe_compliance * elastic.area),
        free=owned(elastic.probe_thermal),
        loaded=owned(loaded),
        tolerance=contact.tolerance,
    )


def owned(values: Array) -> Array:
    """Return values as a contiguous array, the layout for which kernels are compiled."""
    return np.ascontiguousarray(values, dtype=np.float64)


def _conductance_table(laws: Sequence[tuple[JointLaw, int]], area: Array) -> Array | None:
    """Rows of `JointKernel.conductance`, or None if one is neither a power law nor fixed."""
    rows, start = [np.empty((0, 3))], 0
    for law, count in laws:
        power, table = law.conductance, np.empty((count, 3))
        if law.gap is not None:
            return None
        if isinstance(power, PowerLawConductance):
            table[:, 0], table[:, 1:] = power.factor, (power.hardness, power.exponent)
        elif isinstance(power, FixedConductance):
            table[:, 0], table[:, 1:] = power.value, (1.0, 0.0)
        else:
            return None
        table[:, 0] *= area[start : start + count]
        rows.append(table)
        start += count
    return np.concatenate(rows)
