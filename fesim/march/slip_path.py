"""Slip of the joints over a long step, extrapolated from the same step in halves.

A step's return mapping goes straight from the slip at its start to that at its end. If the slip
turns or the pressure changes within the step, this is implicit Euler along the path: the error is
of first order in the length of the pieces. One piece and two give second-order slip.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fesim.joint.gap import Equilibrium
from fesim.march.machine import CondensedMachine, State
from fesim.march.settling import loaded_gap, settle_along
from thermojoint.artefacts.arrays import Array

#: Estimated relative error of the extrapolation (docs/march.md): where the same contact elements
#: slide in both halves of a step, and where others do.
SMOOTH, ABRUPT = 1.0 / 32.0, 1.0 / 4.0
#: Fraction of a step to the temperature unknowns (n,) and the inputs (k + l,) after it.
Course = Callable[[float], tuple[Array, Array]]


@dataclass(frozen=True)
class SlipPath:
    """Start values for settling the end of a step."""

    #: Shape (2, m): slip whose return mapping leads to the extrapolated slip, m.
    origin: Array
    #: Shape (3, m): extrapolated gaps, m.
    gap: Array
    #: Estimated relative error of the extrapolation.
    doubt: float


def slip_path(
    machine: CondensedMachine, state: State, course: Course, whole: State
) -> SlipPath | None:
    """Extrapolate the end of a step; None if nothing slides or a joint snaps in it.

    Raises
    ------
    ConvergenceError
        A half of the step has no equilibrium.
    """
    halves = _halves(machine, state, course, whole.gap - state.gap)
    if halves is None:
        return None
    middle, end = halves
    # A contact element may slide and stick again: the end of the step alone does not show it.
    if np.array_equal(end.slip, state.slip) and np.array_equal(whole.slip, state.slip):
        return None
    gap, slip = 2.0 * end.gap - whole.gap, 2.0 * end.slip - whole.slip
    slid = (middle.slip != state.slip).any(axis=0)
    slides = (end.slip != middle.slip).any(axis=0)
    doubt = SMOOTH if np.array_equal(slid, slides) else ABRUPT
    return SlipPath(origin(state.slip, whole.gap, gap, slip, slides), gap, doubt)


def origin(begun: Array, once: Array, gap: Array, slip: Array, slides: Array) -> Array:
    """Return the slip (2, m) from which the return mapping at given gaps leads to a given slip.

    In a sliding contact element friction is at its limit, and only the direction of the shear is
    free: its trial is as long as in one piece. In a sticking one the slip does not change.

    Parameters
    ----------
    begun : ndarray, shape (2, m)
        Slip before, m.
    once : ndarray, shape (3, m)
        Gaps at the end of the step taken in one piece, m.
    gap, slip : ndarray, shapes (3, m) and (2, m)
        Gaps and slip to be reached, m.
    slides : ndarray of bool, shape (m,)
        Contact elements that slide at these gaps.
    """
    held, tried = np.hypot(*(gap[1:] - slip)), np.hypot(*(once[1:] - begun))
    longer = np.divide(tried, held, out=np.ones_like(held), where=slides & (held > 0.0))
    return np.asarray(gap[1:] - longer * (gap[1:] - slip))


def settled_at(
    machine: CondensedMachine, state: State, unknowns: Array, inputs: Array
) -> tuple[Equilibrium, int]:
    """Settle the joints at given temperatures and loads; arguments and result as `settle_along`."""
    opened = loaded_gap(machine, machine.strained(unknowns), inputs)
    return settle_along(machine.contact, state, opened)


def _halves(
    machine: CondensedMachine, state: State, course: Course, turn: Array
) -> list[State] | None:
    """The ends of both halves of a step whose gaps change by about `turn` (3, m)."""
    ends, begun = [], state.gap
    for share in (0.5, 1.0):
        state = replace(state, change=begun + share * turn - state.gap)
        settled, cuts = settled_at(machine, state, *course(share))
        if cuts:
            return None
        state = replace(state, gap=settled.gap, slip=settled.traction.slip)
        ends.append(state)
    return ends
