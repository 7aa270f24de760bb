"""Heat step of contact elements that pass several places of another body within the step.

At every moment the jump of a contact element is a combination b of rows R of the temperatures: its
own, less those of the places below it. With L the time means of the products b b^T, weighted with
the conductances, the heat that leaves the rows is q = L R T. With S = R A0^-1 R^T the implicit
Euler step is (1 + L S) q = L R y, T = y - A0^-1 R^T q, where y is the step without joints
(docs/moving-axes.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.march.heat_step import heat_balance
from fesim.march.secant_step import HeatTaken
from fesim.solid.condensation import ThermalCondensation
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of m contact elements, then of the places that they may touch: q in all."""

    #: Shape (q, n): R: mean temperature of each row, K; its jump for a contact element that does
    #: not move.
    temperature: Array
    #: Shape (q, n): R A0^-1, K/W: temperature response to heat that enters each row.
    influence: Array
    #: Shape (q, q): R A0^-1 R^T, K/W.
    joint_influence: Array


class Touches(NamedTuple):
    """Contacts in a step: l products of the row coefficients of contact elements."""

    #: Shape (l,): contact element of each product.
    element: NDArray[np.int64]
    #: Shape (l,): rows that are multiplied.
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    #: Shape (l,): mean of the product of their coefficients over the step.
    mean: Array


@dataclass(frozen=True, eq=False)
class Passing:
    """Rows, and the contacts between them in a step."""

    rows: Rows
    touches: Touches
    #: Shape (q,): frictional heat of motion that enters each row, W.
    rubbed: Array

    @cached_property
    def used(self) -> NDArray[np.int64]:
        """Indices of the contact elements, then of the other rows that they touch."""
        count = 1 + int(self.touches.element.max(initial=-1))
        return np.union1d(np.arange(count), self.touches.first)

    @cached_property
    def between(self) -> Touches:
        """The products, with indices among the used rows."""
        ends = self.touches.first, self.touches.second
        first, second = (np.searchsorted(self.used, at) for at in ends)
        return self.touches._replace(first=first, second=second)

    @cached_property
    def influence(self) -> Array:
        """S of the used rows."""
        return self.rows.joint_influence[np.ix_(self.used, self.used)]


def exchange(touches: Touches, joint: Array, size: int) -> Array:
    """Return L (q, q), W/K, of contact elements with conductances times areas (m,), on q rows."""
    at = touches.first * size + touches.second
    weights = touches.mean * joint[touches.element]
    return np.asarray(np.bincount(at, weights, size * size).reshape(size, size))


def leaving(exchanged: Array, influence: Array, alone: Array) -> Array:
    """Return the heat q that leaves the rows, W, (q,): (1 + L S) q = L R y.

    Parameters
    ----------
    exchanged : ndarray, shape (q, q)
        L, W/K, from `exchange`, or the part of it that y does not include yet.
    influence : ndarray, shape (q, q)
        S, K/W.
    alone : ndarray, shape (q,)
        R y: the rows after the step without joints, K.
    """
    system = exchanged @ influence
    system.flat[:: len(system) + 1] += 1.0
    return np.asarray(np.linalg.solve(system, exchanged @ alone))


def pass_heat(
    thermal: ThermalCondensation, passing: Passing, temperature: Array, inputs: Array, joint: Array
) -> HeatTaken:
    """Take one step of the heat equation.

    Parameters
    ----------
    thermal : ThermalCondensation
        The condensed step; its influence of the joints is not used.
    passing : Passing
        Contacts in the step.
    temperature : ndarray, shape (n,)
        Temperatures at the start, K.
    inputs : ndarray, shape (k,)
        Sources, W; ambient and held surfaces, K.
    joint : ndarray, shape (m,)
        Conductance times area of each contact element, W/K.
    """
    # Imported here because it loads a compiler, as in `fesim.march.contact.gap_solver`.
    from fesim.march.picked import product_of, sum_of

    rows, used = passing.rows, passing.used
    rubbed = passing.rubbed[used]
    alone = thermal.factor.solve(thermal.capacity_rate @ temperature + thermal.inputs @ inputs)
    warm = product_of(rows.temperature, used, alone) + passing.influence @ rubbed
    exchanged = exchange(passing.between, joint, used.size)
    left = leaving(exchanged, passing.influence, warm)
    after: Array = alone + sum_of(rows.influence, used, rubbed - left)
    flow = left[: len(joint)]
    return HeatTaken(after, flow, heat_balance(thermal, temperature, after, inputs, flow), 0.0)
