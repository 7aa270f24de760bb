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
    """Slip at the end of a step."""

    #: Shape (2, m): of second order, m.
    slip: Array
    #: Shape (2, m): its estimated error, m.
    error: Array
    #: Shape (3, m): gaps there, extrapolated like the slip, m.
    gap: Array


def slip_path(
    machine: CondensedMachine, state: State, course: Course, whole: State
) -> SlipPath | None:
    """Extrapolate the slip at the end of a step; None if nothing slides or a joint snaps in it.

    Raises
    ------
    ConvergenceError
        A piece of the step has no equilibrium.
    """
    turn = whole.gap - state.gap
    pieces = _in_pieces(machine, state, course, lambda share: state.gap + share * turn, 2)
    if pieces is None:
        return None
    middle, twice, two = pieces[0].gap, pieces[1].gap, pieces[1].slip
    # A contact element may slide and stick again: the end of the step alone does not show it.
    if np.array_equal(two, state.slip) and np.array_equal(whole.slip, state.slip):
        return None
    # Of an error a/n of n pieces a third is left.
    last = twice + (twice - whole.gap) / 3.0
    bend = 4.0 * (middle - 0.5 * (state.gap + last))

    def bent(share: float) -> Array:
        straight = state.gap + share * (last - state.gap)
        return np.asarray(straight + share * (1.0 - share) * bend)

    pieces = _in_pieces(machine, state, course, bent, 3)
    if pieces is None:
        return None
    three = pieces[2].slip
    slip = 3.0 * three - 2.0 * two
    # Of an error a/n + b/n^2 of n pieces, b/6 is left in this and b/2 in the other extrapolation.
    gap = 3.0 * pieces[2].gap - 2.0 * twice
    return SlipPath(slip, 0.5 * (slip - (2.0 * two - whole.slip)), gap)


def settled_at(
    machine: CondensedMachine, state: State, unknowns: Array, inputs: Array
) -> tuple[Equilibrium, int]:
    """Settle the joints at given temperatures and loads; arguments and result as `settle_along`."""
    grown = machine.contact.elastic.thermal_gap @ machine.strained(unknowns)
    return settle_along(machine.contact, state, loaded_gap(machine, grown, inputs))


def _in_pieces(
    machine: CondensedMachine,
    state: State,
    course: Course,
    guess: Callable[[float], Array],
    pieces: int,
) -> list[State] | None:
    """The ends of the pieces of a step, whose gaps are guessed by their share of it."""
    ends = []
    for piece in range(1, pieces + 1):
        share = piece / pieces
        state = replace(state, change=guess(share) - state.gap)
        settled, cuts = settled_at(machine, state, *course(share))
        if cuts:
            return None
        state = replace(state, gap=settled.gap, slip=settled.traction.slip)
        ends.append(state)
    return ends
