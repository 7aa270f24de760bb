"""The joint heat flows of a step: (I + diag(c) S) j = diag(c) jump, by an inverse that is kept.

S are the temperature jumps per W of each contact element, c the conductances times areas. The
inverse was made at other conductances; GMRES (Saad & Schultz 1986) takes it as its preconditioner,
so that a few products with S and with it replace a factorisation in every step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from artefacts.arrays import Array
from fesim.joint.compiled_gap import largest
from fesim.machine_code import compiled
from fesim.march.compiled_step import flow_system

#: The flows are iterated until their equations lack no more than this part of what drives them.
TOLERANCE = 1e-13
#: The inverse is made anew after this many iterations, and one more for so many elements, but after
#: so many at most: it costs as much as some iterations for each.
PATIENCE, FOR_EACH, MOST = 8, 16, 40
#: GMRES knows what is lacking from its own recurrence; then it is looked at, and taken up again.
LOOKS = 3


class Flows(NamedTuple):
    """An inverse that is kept from step to step, written in place.

    Attributes
    ----------
    conducted : ndarray, shape (m,)
        Conductance times area at which it was made, W/K; zero at first.
    inverse : ndarray, shape (m, m)
        (I + diag(conducted) S)^-1.
    """

    conducted: Array
    inverse: Array


def new_flows(count: int) -> Flows:
    """Return an inverse for `count` contact elements that is not made yet."""
    return Flows(np.zeros(count), np.zeros((count, count)))


@compiled
def invert(joint_influence: Array, beyond: Array, flows: Flows) -> None:
    """Make the inverse anew, for conductances times areas (m,), W/K."""
    flows.inverse[:] = np.linalg.inv(flow_system(joint_influence, beyond))
    flows.conducted[:] = beyond


@compiled
def solve_flows(
    joint_influence: Array, beyond: Array, jump: Array, flows: Flows, flow: Array
) -> None:
    """Solve for the joint heat flows (m,), W, into `flow`; `beyond` is c, W/K, `jump` in K."""
    driving = beyond * jump
    enough = TOLERANCE * largest(driving)
    if not flows.conducted.any():
        invert(joint_influence, beyond, flows)
    for attempt in range(2):
        if _improve(joint_influence, beyond, driving, enough, flows.inverse, flow):
            return
        if attempt == 0:
            invert(joint_influence, beyond, flows)


@compiled
def _improve(
    joint_influence: Array,
    beyond: Array,
    driving: Array,
    enough: float,
    inverse: Array,
    flow: Array,
) -> bool:
    """Whether GMRES, preconditioned by an inverse, finds the flows within the patience."""
    most = min(PATIENCE + beyond.size // FOR_EACH, MOST)
    basis, along = np.empty((most + 1, beyond.size)), np.empty((most, beyond.size))
    flow[:] = np.dot(inverse, driving)
    for _ in range(LOOKS):
        lack = driving - flow - beyond * np.dot(joint_influence, flow)
        if largest(lack) <= enough:
            return True
        taken, weights = _least(joint_influence, beyond, inverse, lack, enough, basis, along)
        for k in range(taken):
            flow += weights[k] * along[k]
        if taken == most:
            break
    lack = driving - flow - beyond * np.dot(joint_influence, flow)
    return bool(largest(lack) <= enough)


@compiled
def _least(
    joint_influence: Array,
    beyond: Array,
    inverse: Array,
    lack: Array,
    enough: float,
    basis: Array,
    along: Array,
) -> tuple[int, Array]:
    """How many directions GMRES took into `along`, and by how much of each least is lacking.

    Its residuals' orthonormal `basis` is turned to a triangle by Givens rotations as it grows.
    """
    most = along.shape[0]
    triangle, turn = np.zeros((most + 1, most)), np.zeros((2, most))
    left = np.zeros(most + 1)
    left[0] = math.sqrt(lack @ lack)
    basis[0] = lack / left[0]
    taken = 0
    while taken < most and abs(left[taken]) > 0.5 * enough:
        k = taken
        along[k] = np.dot(inverse, basis[k])
        found = along[k] + beyond * np.dot(joint_influence, along[k])
        for i in range(k + 1):
            triangle[i, k] = found @ basis[i]
            found -= triangle[i, k] * basis[i]
        size = math.sqrt(found @ found)
        for i in range(k):
            upper, lower = triangle[i, k], triangle[i + 1, k]
            triangle[i, k] = turn[0, i] * upper + turn[1, i] * lower
            triangle[i + 1, k] = turn[0, i] * lower - turn[1, i] * upper
        length = math.hypot(triangle[k, k], size)
        if length == 0.0:
            break
        turn[0, k], turn[1, k] = triangle[k, k] / length, size / length
        triangle[k, k] = length
        left[k + 1] = -turn[1, k] * left[k]
        left[k] *= turn[0, k]
        taken += 1
        if size == 0.0:
            break
        basis[taken] = found / size
    weights = np.zeros(most)
    for k in range(taken - 1, -1, -1):
        total = left[k]
        for j in range(k + 1, taken):
            total -= triangle[k, j] * weights[j]
        weights[k] = total / triangle[k, k]
    return taken, weights
