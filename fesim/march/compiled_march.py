"""JIT-compiled time integration with staggered steps and frozen tangents.

Nothing is factorised anew in a step as long as what is kept serves: for the gap equations that of
`fesim.joint.modified_newton`, for the joint heat flows that of `fesim.march.joint_flows`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.joint.anchor import MADE, Anchors, put_tangents
from fesim.joint.blocks import Blocks
from fesim.joint.loosening import Watched, surely_held
from fesim.joint.modified_newton import settle_near
from fesim.machine_code import compiled
from fesim.march.compiled_step import (
    HeatStep,
    JointKernel,
    conduct,
    drive,
    settle_by_newton,
    take,
)
from fesim.march.joint_flows import Flows, solve_flows
from thermojoint.artefacts.arrays import Array

#: Why a march stopped: it is through; a joint has no equilibrium near; a body may have come loose.
THROUGH, SNAPS, LOOSE = range(3)


class Moving(NamedTuple):
    """State between two steps, updated in place; shapes as in `fesim.march.machine.State`."""

    amplitudes: Array
    gap: Array
    slip: Array
    pressure: Array
    change: Array


class Kept(NamedTuple):
    """Inverses that are kept from step to step, written in place.

    Attributes
    ----------
    blocks : Blocks
        Of contact elements that hardly feel each other; they stay as they are.
    anchors : Anchors
        Of the gap equations, block by block.
    flows : Flows
        Of the joint heat flows.
    """

    blocks: Blocks
    anchors: Anchors
    flows: Flows


class Record(NamedTuple):
    """Records of n steps; shapes begin with n, then as in `Step` and `State`.

    Attributes
    ----------
    conducted : ndarray, shape (n, m)
        Conductance times area, W/K.
    anchor : ndarray, shape (n, 7, m)
        As in `fesim.march.machine.State`.
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
    iterations: NDArray[np.int64]


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
            joint.columns,
            kept.blocks,
            joint.laws,
            free_gap,
            now.slip,
            joint.tolerance,
            kept.anchors,
            found,
            value,
            moved,
            tangent,
        )
    except Exception:  # a singular tangent
        solved, residual, iterations = False, np.nan, 0
    if solved:
        return True, residual, iterations
    kept.anchors.every.about[:, MADE] = 0
    found[:] = now.gap + now.change
    return settle_by_newton(joint, free_gap, now.slip, now.gap, found, value, moved, tangent)


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
        drive(heat, amplitudes, inputs[k])
        conduct(joint, now.pressure, conducted)
        jump = np.dot(joint.jump, amplitudes)
        solve_flows(heat.joint_influence, conducted - joint.held, jump, kept.flows, flow)
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
        take(
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
    record.anchor[k, 6] = kept.flows.conducted
    put_tangents(kept.anchors, kept.blocks.elements, record.anchor[k, :6])
