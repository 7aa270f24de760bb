"""One implicit Euler step of the condensed heat equation, and its balance."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from fesim.solid.condensation import ThermalCondensation
from thermojoint.artefacts.arrays import Array

#: Numbers in a cache line.
LINE = 8

#: Heat flows per step below this fraction of the stored heat count as zero.
AT_REST = 1e-6


def heat_step(
    thermal: ThermalCondensation,
    temperature: Array,
    inputs: Array,
    joint: Array,
    lost: Array | None = None,
) -> tuple[Array, Array]:
    """Implicit Euler on the condensed heat equation.

    Parameters
    ----------
    thermal : ThermalCondensation
        The condensed step.
    temperature : ndarray, shape (n,)
        Temperatures at the start, K.
    inputs : ndarray, shape (k,)
        Sources, W; ambient and held surfaces, K.
    joint : ndarray, shape (m,)
        Conductance times area of each contact element, W/K.
    lost : ndarray, shape (n,), optional
        Further heat lost by each node, W; zero where temperatures are held.

    Returns
    -------
    temperature : ndarray, shape (n,)
        Temperatures at the end, K.
    heat_flow : ndarray, shape (m,)
        Across the joint from side a to side b, W.
    """
    right_side = thermal.capacity_rate @ temperature + thermal.inputs @ inputs
    alone = thermal.factor.solve(right_side if lost is None else right_side - lost)
    heat_flow = joint_heat_flow(thermal.joint_influence, joint, thermal.jump @ alone)
    after: Array = alone - thermal.influence @ heat_flow
    return after, heat_flow


def joint_heat_flow(joint_influence: Array, joint: Array, jump: Array) -> Array:
    """Return the heat flows j of (I + diag(joint) S) j = diag(joint) jump.

    Parameters
    ----------
    joint_influence : ndarray, shape (m, m)
        S: temperature jump per heat flow, K/W.
    joint : ndarray, shape (m,)
        Conductance times area of each contact element, W/K.
    jump : ndarray, shape (m,) or (m, k)
        Temperature jumps without heat flow, K.

    Returns
    -------
    ndarray, shape (m,) or (m, k)
        W.
    """
    system = joint[:, None] * joint_influence
    system.flat[:: len(joint) + 1] += 1.0
    return np.asarray(np.linalg.solve(system, (joint * jump.T).T), dtype=np.float64)


def each(matrix: Array | csr_array, rows: Array) -> Array:
    """Return `matrix` times each row of (n, r), bit-identical for any number of rows.

    Parameters
    ----------
    matrix : ndarray or scipy.sparse.csr_array, shape (k, r) or (r,)
        Left factor.
    rows : ndarray, shape (n, r)
        Right factors.

    Returns
    -------
    ndarray, shape (n, k) or (n,)
    """
    if matrix.ndim == 2 and not matrix.shape[0]:  # No held surfaces: no rows to align.
        return np.zeros((len(rows), 0))
    if isinstance(matrix, np.ndarray):
        product = np.matmul(_aligned(np.atleast_2d(matrix)), _aligned(rows)[:, :, None])[:, :, 0]
        return np.asarray(product[:, 0] if matrix.ndim == 1 else product)
    return np.asarray((matrix @ rows.T).T)


def _aligned(rows: Array) -> Array:
    """Rows padded to whole cache lines: otherwise the rounding of a sum depends on its address."""
    count, size = rows.shape
    width = -(-size // LINE) * LINE
    storage = np.zeros(count * width + LINE)
    first = (-storage.ctypes.data % (8 * LINE)) // 8
    aligned = storage[first : first + count * width].reshape(count, width)
    aligned[:, :size] = rows
    return aligned


def heat_balance(
    thermal: ThermalCondensation,
    before: Array,
    after: Array,
    inputs: Array,
    heat_flow: Array,
    lost: tuple[float, Array] | None = None,
) -> float:
    """Return `heat_balances` of one step, from arrays without the first dimension."""
    others = None if lost is None else (np.array([lost[0]]), lost[1][None])
    whole = heat_balances(thermal, before[None], after[None], inputs[None], heat_flow[None], others)
    return float(whole[0])


def heat_balances(
    thermal: ThermalCondensation,
    before: Array,
    after: Array,
    inputs: Array,
    heat_flow: Array,
    lost: tuple[Array, Array] | None = None,
) -> Array:
    """(in - stored - convected) over each of n steps, relative to the largest of the three.

    For the scale, heat that passes from one held surface to another counts as entering, and heat
    that passes between parts of the structure as stored; otherwise they would cancel. In a steady
    state all three are rounding errors: then the scale is `AT_REST` of the stored heat per step.

    Parameters
    ----------
    thermal : ThermalCondensation
        The condensed step.
    before, after : ndarray, shape (n, r)
        Temperatures at the start and at the end of each step.
    inputs : ndarray, shape (n, k)
        Inputs of each step.
    heat_flow : ndarray, shape (n, m)
        Joint heat flows, W.
    lost : tuple of ndarray, shapes (n,) and (n, h), optional
        Further heat lost by the nodes, W: in total, and of each held unknown.

    Returns
    -------
    ndarray, shape (n,)
    """
    sums, step = thermal.balance, thermal.step
    held = each(sums.after, after) - each(sums.before, before)
    held += each(sums.flow, heat_flow) - each(sums.drive, inputs)
    given = each(sums.entering, inputs)
    change, size = (after - before) / step, np.abs(sums.stored)
    stored, convected = each(sums.stored, change), each(sums.convected, after)
    if lost is not None:
        convected, held = convected + lost[0], held + lost[1]
    enters = held.sum(axis=1)
    moved, holding = each(size, np.abs(change)), each(size, np.abs(after)) / step
    parts = [np.abs(given), np.abs(held).sum(axis=1), moved, np.abs(convected), AT_REST * holding]
    largest = np.max(parts, axis=0)
    left: Array = given + enters - stored - convected
    return np.divide(left, largest, out=np.zeros_like(left), where=largest > 0.0)
