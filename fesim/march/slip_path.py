"""Slip of the joints over a long step, extrapolated from the same step in pieces.

A step's return mapping goes straight from the slip at its start to that at its end. Where the slip
turns or the pressure changes on the way, this is implicit Euler along the path: its error falls
with the first power of the number of pieces. Two and three pieces give the slip of second order,
the whole step and two pieces another one to compare it with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fesim.joint.gap import Equilibrium
from fesim.march.machine import CondensedMachine, State
from fesim.march.settling import loaded_gap, settle_along
from thermojoint.artefacts.arrays import Array

#: Share of a step to the temperature unknowns (n,) and the inputs (k + l,) after it.
Course = Callable[[float], tuple[Array, Array]]


@dataclass(frozen=True)
class SlipPath:
    """Slip at the end of a step.

    Attributes
    ----------
    slip : ndarray, shape (2, m)
        Of second order, m.
    error : ndarray, shape (2, m)
        Its estimated error, m.
    """

    slip: Array
    error: Array


def slip_path(
    machine: CondensedMachine, state: State, course: Course, whole: State
) -> SlipPath | None:
    """Extrapolate the slip at the end of a step; None if nothing slides or a joint snaps in it.

    Raises
    ------
    ConvergenceError
        A piece of the step has no equilibrium.
    """
    two = _in_pieces(machine, state, course, whole.gap, 2)
    # A contact element may slide and stick again: the end of the step alone does not show it.
    if two is None or (np.array_equal(two, state.slip) and np.array_equal(whole.slip, state.slip)):
        return None
    three = _in_pieces(machine, state, course, whole.gap, 3)
    if three is None:
        return None
    slip = 3.0 * three - 2.0 * two
    # Of an error a/n + b/n^2 of n pieces, b/6 is left in this and b/2 in the other extrapolation.
    return SlipPath(slip, 0.5 * (slip - (2.0 * two - whole.slip)))


def settled_at(
    machine: CondensedMachine, state: State, unknowns: Array, inputs: Array
) -> tuple[Equilibrium, int]:
    """Settle the joints at given temperatures and loads; arguments and result as `settle_along`."""
    grown = machine.contact.elastic.thermal_gap @ machine.strained(unknowns)
    return settle_along(machine.contact, state, loaded_gap(machine, grown, inputs))


def _in_pieces(
    machine: CondensedMachine, state: State, course: Course, end: Array, pieces: int
) -> Array | None:
    """Slip at the end of a step in pieces; the first guess goes straight to the gaps `end`."""
    state = replace(state, change=(end - state.gap) / pieces)
    for piece in range(1, pieces + 1):
        settled, cuts = settled_at(machine, state, *course(piece / pieces))
        if cuts:
            return None
        change = settled.gap - state.gap
        state = replace(state, gap=settled.gap, slip=settled.traction.slip, change=change)
    return state.slip
