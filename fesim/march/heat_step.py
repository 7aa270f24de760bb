"""One implicit Euler step of the condensed heat equation, and its balance."""

from __future__ import annotations

import numpy as np

from artefacts.arrays import Array
from fesim.solid.condensation import ThermalCondensation

#: Heat flows below this part of the heat held, in each step, are none.
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
        At the start, K.
    inputs : ndarray, shape (k,)
        Sources, W; ambient and held surfaces, K.
    joint : ndarray, shape (m,)
        Conductance times area of each contact element, W/K.
    lost : ndarray, shape (n,), optional
        Further heat that leaves each node, W; zero where temperatures are held.

    Returns
    -------
    temperature : ndarray, shape (n,)
        At the end, K.
    heat_flow : ndarray, shape (m,)
        Across the joint from side a to side b, W.
    """
    right_side = thermal.capacity_rate @ temperature + thermal.inputs @ inputs
    alone = thermal.factor.solve(right_side if lost is None else right_side - lost)
    system = joint[:, None] * thermal.joint_influence
    system.flat[:: len(joint) + 1] += 1.0
    heat_flow = np.linalg.solve(system, joint * (thermal.jump @ alone))
    after: Array = alone - thermal.influence @ heat_flow
    return after, np.asarray(heat_flow, dtype=np.float64)


def heat_balance(
    thermal: ThermalCondensation,
    before: Array,
    after: Array,
    inputs: Array,
    heat_flow: Array,
    lost: tuple[float, Array] | None = None,
) -> float:
    """(in - stored - convected) over one step, relative to the largest of the three.

    What enters at one held surface and leaves at another counts as entering, and what one part of
    the structure stores at the cost of another counts as stored: neither counts as nothing. Where
    everything has come to rest all three are rounding: then it is relative to `AT_REST` of the heat
    that the structure holds, in each step. `lost` is what leaves the nodes besides, W: of all
    together, and of each held unknown (h,).
    """
    sums, step = thermal.balance, thermal.step
    held = sums.after @ after - sums.before @ before - sums.drive @ inputs + sums.flow @ heat_flow
    given = float(sums.entering @ inputs)
    change = (after - before) / step
    stored = float(sums.stored @ change)
    convected = float(sums.convected @ after)
    if lost is not None:
        convected, held = convected + lost[0], held + lost[1]
    moved, holding = (float(np.abs(sums.stored) @ np.abs(part)) for part in (change, after / step))
    largest = max(abs(given), float(np.abs(held).sum()), moved, abs(convected), AT_REST * holding)
    return (given + float(held.sum()) - stored - convected) / largest if largest > 0.0 else 0.0
