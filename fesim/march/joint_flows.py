"""Joint heat flows of a step, (I + diag(c) S) j = diag(c) jump, with frozen factors.

S is the temperature jump per W at each contact element, c the conductance times area. The factors,
in single precision, belong to other conductances and precondition GMRES (Saad & Schultz 1986): a
few products with S and solutions with the factors replace a factorisation in every step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled, compiled_part
from fesim.joint.compiled_gap import largest
from fesim.joint.in_place import add, fill, put
from fesim.joint.linear_system import factorise_single, solve, solve_again
from fesim.march.compiled_step import flow_system
from fesim.march.extrapolation import differ, extrapolate
from fesim.march.machine import FURTHER
from fesim.one_thread import MANY
from thermojoint.artefacts.arrays import Array

#: Largest residual of the flows, relative to the right-hand side.
TOLERANCE = 1e-13
#: Iterations after which the factors are computed again. For 100 to 1 000 contact elements this
#: costs about as much as 20 iterations.
PATIENCE = 8
#: Largest number of restarts: the recurrence of GMRES only estimates the residual.
LOOKS = 4


class Equations(NamedTuple):
    """(I + diag(beyond) S) j = driving, in W: S (m, m), K/W; beyond (m,), W/K; driving (m,), W."""

    joint_influence: Array
    beyond: Array
    driving: Array


class Krylov(NamedTuple):
    """Work arrays of GMRES for up to k directions."""

    #: Shape (k + 1, m): orthonormal residuals.
    basis: Array
    #: Shape (k, m): directions: the residuals, preconditioned.
    along: Array
    #: Shape (k + 1, k): triangular factor of the Hessenberg matrix.
    triangle: Array
    #: Shape (2, k): cosine and sine of each Givens rotation.
    turn: Array
    #: Shape (k + 1,): rotated residual, W.
    left: Array


class Flows(NamedTuple):
    """Factors that are reused from step to step, and work arrays; written in place."""

    #: Shape (m,): conductances times areas of the factors, W/K; zero before the first.
    conducted: Array
    #: Shapes (m, m) and (m,): I + diag(conducted) S, factorised in column order.
    factors: NDArray[np.float32]
    pivots: NDArray[np.int32]
    #: Shape (m,): work array: right side, then solution with the factors.
    solved: NDArray[np.float32]
    #: Shape (m,): work array: conductance times area times temperature jump, W.
    driving: Array
    #: Shapes (m,), (m,) and (3, m): flows of the last step, NaN before the first, their change in
    #: it, and their differences of order 2 to 4, W; recorded for `MANY` contact elements or more.
    last: Array
    change: Array
    further: Array
    #: Work arrays of GMRES.
    krylov: Krylov


def new_flows(count: int) -> Flows:
    """Return storage for the factors of `count` contact elements, not computed yet."""
    krylov = Krylov(
        basis=np.empty((PATIENCE + 1, count)),
        along=np.empty((PATIENCE, count)),
        triangle=np.empty((PATIENCE + 1, PATIENCE)),
        turn=np.empty((2, PATIENCE)),
        left=np.empty(PATIENCE + 1),
    )
    return Flows(
        conducted=np.zeros(count),
        factors=np.empty((count, count), dtype=np.float32),
        pivots=np.empty(count, dtype=np.int32),
        solved=np.empty(count, dtype=np.float32),
        driving=np.empty(count),
        last=np.full(count, np.nan),
        change=np.zeros(count),
        further=np.zeros((FURTHER, count)),
        krylov=krylov,
    )


@compiled
def freeze_flows(joint_influence: Array, beyond: Array, flows: Flows) -> None:
    """Compute the factors for conductances times areas (m,), W/K."""
    put(beyond, flows.conducted)
    for f in range(beyond.size):
        for e in range(beyond.size):
            # S is symmetric, and read in storage order.
            flows.factors[f, e] = beyond[e] * joint_influence[f, e]
        flows.factors[f, f] += 1.0
    fill(flows.solved, 1.0)
    factorise_single(flows.factors, flows.pivots, flows.solved)


@compiled
def solve_flows(
    joint_influence: Array, beyond: Array, jump: Array, flows: Flows, flow: Array
) -> None:
    """Solve for the joint heat flows (m,), W, into `flow`; `beyond` is c, W/K, `jump` in K."""
    for e in range(beyond.size):
        flows.driving[e] = beyond[e] * jump[e]
    equations = Equations(joint_influence, beyond, flows.driving)
    if not flows.conducted.any():
        freeze_flows(joint_influence, beyond, flows)
    solved = False
    for attempt in range(2):
        _guess(flows, flow)
        solved = _improve(equations, flows, flow)
        if solved:
            break
        if attempt == 0:
            freeze_flows(joint_influence, beyond, flows)
    if not solved:
        # Too nearly singular for factors in single precision.
        system = np.empty((beyond.size, beyond.size))
        flow_system(joint_influence, beyond, system)
        put(solve(system, flows.driving), flow)
    if flow.size >= MANY:
        _remember(flows, flow)


@compiled_part
def _remember(flows: Flows, flow: Array) -> None:
    """Record the flows of a step and their differences."""
    last, change, before = flows.last, flows.change, flows.driving
    if not math.isnan(last[0]):
        put(change, before)
        for e in range(flow.size):
            change[e] = flow[e] - last[e]
        differ(before, change, flows.further)
    put(flow, last)


@compiled_part
def _guess(flows: Flows, flow: Array) -> None:
    """Put a first guess of the flows into `flow`.

    For `MANY` contact elements or more it extrapolates the flows of the last steps. A march resumed
    from a saved state lacks them: its flows then agree to `TOLERANCE`, while those of fewer
    elements are bit-identical.
    """
    if flow.size < MANY or math.isnan(flows.last[0]):
        _precondition(flows, flows.driving, flow)
        return
    extrapolate(flows.change, flows.further, flow)
    add(flows.last, flow)


@compiled_part
def _improve(equations: Equations, flows: Flows, flow: Array) -> bool:
    """Whether preconditioned GMRES converges from a guess in the allowed iterations."""
    driving, lack = equations.driving, flows.krylov.basis[0]
    enough = TOLERANCE * largest(driving)
    taken = 0
    for _ in range(LOOKS):
        _apply(equations, flow, lack)
        for e in range(flow.size):
            lack[e] = driving[e] - lack[e]
        if largest(lack) <= enough:
            return True
        if taken == len(flows.krylov.along):
            break
        taken = _least(equations, flows, enough, flow)
    return False


@compiled_part
def _precondition(flows: Flows, right_side: Array, solution: Array) -> None:
    """Solve with the factors."""
    put(right_side, flows.solved)
    solve_again(flows.factors, flows.pivots, flows.solved)
    put(flows.solved, solution)


@compiled_part
def _apply(equations: Equations, flow: Array, into: Array) -> None:
    """Write (I + diag(c) S) j into `into` (m,)."""
    np.dot(equations.joint_influence, flow, into)
    for e in range(flow.size):
        into[e] = flow[e] + equations.beyond[e] * into[e]


@compiled_part
def _least(equations: Equations, flows: Flows, enough: float, flow: Array) -> int:
    """Minimise the residual, `basis[0]`; return the number of directions used (GMRES).

    Givens rotations keep the Hessenberg matrix triangular as the orthonormal basis grows.
    """
    basis, along, triangle, turn, left = flows.krylov
    most, count = along.shape
    left[0] = math.sqrt(np.dot(basis[0], basis[0]))
    for e in range(count):
        basis[0, e] /= left[0]
    taken = 0
    while taken < most and abs(left[taken]) > 0.5 * enough:
        k, vector = taken, basis[taken + 1]
        _precondition(flows, basis[k], along[k])
        _apply(equations, along[k], vector)
        for i in range(k + 1):
            part = np.dot(vector, basis[i])
            triangle[i, k] = part
            for e in range(count):
                vector[e] -= part * basis[i, e]
        size = math.sqrt(np.dot(vector, vector))
        for i in range(k):
            upper, lower = triangle[i, k], triangle[i + 1, k]
            triangle[i, k] = turn[0, i] * upper + turn[1, i] * lower
            triangle[i + 1, k] = turn[0, i] * lower - turn[1, i] * upper
        length = math.sqrt(triangle[k, k] * triangle[k, k] + size * size)
        if length == 0.0:
            break
        turn[0, k], turn[1, k] = triangle[k, k] / length, size / length
        triangle[k, k] = length
        left[k + 1] = -turn[1, k] * left[k]
        left[k] *= turn[0, k]
        taken += 1
        if size == 0.0:
            break
        for e in range(count):
            vector[e] /= size
    for k in range(taken - 1, -1, -1):
        for j in range(k + 1, taken):
            left[k] -= triangle[k, j] * left[j]
        left[k] /= triangle[k, k]
        for e in range(count):
            flow[e] += left[k] * along[k, e]
    return taken
