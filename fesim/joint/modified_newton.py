"""Modified Newton method for the gap equations with a frozen tangent over many steps.

Unknown: the tractions w = z(g) + k0 g missing in the springs, with g = J0^-1 g_T + F w. Since
J0^-1 g_T = g_T + F (k - k0) g_T, both terms need one product with F. A Newton step solves
(I - dT F) y = z(g) + k0 g - w with the factors of a frozen tangent (`fesim.joint.frozen_tangent`),
which is updated when convergence is slow. With several blocks of contact elements it is replaced by
a Gauss-Seidel sweep over the blocks, each with its own frozen tangent.

Start at `settle_near`; first read `fesim.joint.gap`, the plain solution of the same equations.
`tests/fesim/joint/test_modified_newton.py` compares the equilibria of random joints with those of
`solve_gap`, `tests/fesim/march/test_reduced_march.py` the march with that of `plainly_staggered`.
"""

from __future__ import annotations

import math

import numpy as np

from fesim.jit import compiled, compiled_part
from fesim.joint.blocks import Block, Blocks, columns_for, part_of
from fesim.joint.compiled_gap import (
    CompiledGap,
    GapKernel,
    Trial,
    evaluate_in_place,
    lacking,
    largest,
    trial_at,
)
from fesim.joint.frozen_tangent import (
    MADE,
    FrozenTangent,
    FrozenTangents,
    Lacking,
    add_product,
    block_tangent,
    correct,
    forget,
    freeze_tangent,
    frozen_tangents,
)
from fesim.joint.gap import Equilibrium
from fesim.joint.in_place import add, fill, put
from fesim.joint.law import Traction
from thermojoint.artefacts.arrays import Array

#: Most iterations of a step, and most updates of the tangent in it.
MAX_ITERATIONS, MOST_MOVES = 40, 4
#: If an iteration leaves more than this fraction of the residual, the tangent is updated.
SLOW = 0.3
#: After a step with more iterations than this the tangent is updated in the next one.
PATIENCE = 8
#: Residual of an accepted state, relative to the tolerance: the last iterations of Newton's own
#: method leave as little, and friction remembers the residual.
LEFT = 0.01
#: Relative error of gaps in single precision.
SINGLE = float(np.finfo(np.float32).eps)

#: Outcome of a correction: too much has changed; the frozen tangent was sufficient; it was updated.
_FAILED, _CORRECTED, _MOVED = range(3)


@compiled_part
def _correct_or_move(
    frozen: FrozenTangent,
    block: Block,
    now: Lacking,
    stale: bool,
    may_move: bool,
    step: Array,
) -> int:
    """`correct`, after updating the tangent if it is stale or too much has changed."""
    move = stale or frozen.about[MADE] == 0
    while True:
        if move:
            if not may_move:
                return _FAILED
            put(now.tangent, frozen.tangent)
            freeze_tangent(frozen, block)
        if correct(frozen, block, now, step):
            return _MOVED if move else _CORRECTED
        if move:
            return _FAILED
        move = True


@compiled_part
def _sweep(tangents: FrozenTangents, now: Lacking, most: float, may_move: bool) -> int:
    """One sweep over the blocks, into the step and shift of the work arrays.

    Blocks with a residual above `most`, a gap in m, update their tangent.
    """
    tangent, lack = now.tangent, now.lack
    count, outcome = tangent.shape[1], _CORRECTED
    storage = tangents.iteration
    step, shift, part = storage.step, storage.shift, storage.part
    fill(step, 0.0)
    fill(shift, 0.0)
    for k in range(tangents.blocks.starts.size - 1):
        block = part_of(tangents.blocks, k)
        elements, springs, size = block.elements, block.springs, block.elements.size
        own_tangent = storage.tangent[: 6 * size].reshape(6, size)
        own_now = Lacking(own_tangent, storage.own_lack[: 3 * size], now.least)
        own_step = storage.own_step[: 3 * size]
        largest_gap = 0.0
        for j in range(size):
            e = elements[j]
            for i in range(6):
                own_now.tangent[i, j] = tangent[i, e]
            for i in range(3):
                row, at = i * count + e, i * size + j
                largest_gap = max(largest_gap, abs(lack[row]) / springs[at])
                normal, along, across = lacking(springs, own_now.tangent, at)
                own_now.lack[at] = (
                    lack[row]
                    + normal * shift[e]
                    + along * shift[count + e]
                    + across * shift[2 * count + e]
                )
        outcome_of = _correct_or_move(
            block_tangent(tangents, k), block, own_now, largest_gap > most, may_move, own_step
        )
        if outcome_of == _FAILED:
            return _FAILED
        outcome = max(outcome, outcome_of)
        fill(part, 0.0)
        for i in range(3):
            for j in range(size):
                part[i * count + elements[j]] = own_step[i * size + j]
        add(part, step)
        add_product(tangents.blocks.between, part, shift)
    return outcome


@compiled_part
def _lack(springs: Array, trial: Trial, rest: Array, force: Array, lack: Array) -> float:
    """Write z(g) + k0 g + rest - force into `lack`; return its largest entry as a gap, m."""
    gap, value = trial.gap, trial.value
    count, size = gap.shape[1], 0.0
    for i in range(3):
        for e in range(count):
            at = i * count + e
            lack[at] = value[i, e] + springs[at] * gap[i, e] + rest[at] - force[at]
            if springs[at] == 0.0:  # a gap without traction
                continue
            length = abs(lack[at]) / springs[at]
            if not length <= 1e300:
                return math.inf
            size = max(size, length)
    return size


@compiled
def settle_near(
    kernel: GapKernel,
    tangents: FrozenTangents,
    free_gap: Array,
    rest: Array,
    slip: Array,
    trial: Trial,
) -> tuple[bool, float, int]:
    """Iterate from the gaps of a trial; return success, residual and iterations.

    J0^-1 g_T is given as `free_gap` + F `rest`, (3 m,), m and Pa: g_T and (k - k0) g_T, or
    J0^-1 g_T and zero. Other arguments as in `fesim.joint.compiled_gap.solve_in_place`. An accepted
    state has a residual g - J0^-1 g_T - F (z(g) + k0 g) within the tolerance. For several blocks an
    upper bound is returned if that suffices: a product with F takes a seventh of a step.
    """
    springs, tolerance, gap = kernel.springs, kernel.tolerance, trial.gap
    compliance = kernel.compliance
    flat, storage = gap.reshape(-1), tangents.iteration
    force, lack, step, shift = storage.force, storage.lack, storage.step, storage.shift
    evaluate_in_place(kernel.laws, slip, trial)
    fill(step, 0.0)
    _lack(springs, trial, rest, step, force)
    # Not block 0: a literal has another type, and all callees would be compiled twice.
    last = tangents.blocks.starts.size - 2
    np.dot(compliance, force, flat)
    add(free_gap, flat)
    moves, before, corrected, least = 0, math.inf, math.inf, 0.1 * LEFT * tolerance
    # Sum of the gap changes in single precision since then.
    rounded = 0.0
    now = Lacking(trial.tangent, lack, least)
    whole, whole_tangent = part_of(tangents.blocks, last), block_tangent(tangents, last)
    for iteration in range(MAX_ITERATIONS):
        evaluate_in_place(kernel.laws, slip, trial)
        size = _lack(springs, trial, rest, force, lack)
        if size == math.inf:
            return False, size, iteration
        left = corrected * size <= LEFT * tolerance * before if iteration > 0 else False
        if left or size <= least:
            if SINGLE * rounded > LEFT * tolerance:
                np.dot(compliance, force, flat)
                add(free_gap, flat)
                rounded = 0.0
                continue
            if last == 0:
                np.dot(compliance, lack, shift)
                residual = largest(shift)
            else:
                residual = size * tangents.blocks.reach
                if residual > tolerance:
                    fill(shift, 0.0)
                    add_product(tangents.blocks.between, lack, shift)
                    residual = largest(shift)
            if residual <= tolerance and np.spacing(largest(gap)) <= tolerance:
                if iteration > PATIENCE:
                    forget(tangents)
                return True, residual, iteration
        may_move = moves < MOST_MOVES
        if last == 0:
            stale = size > SLOW * before
            outcome = _correct_or_move(whole_tangent, whole, now, stale, may_move, step)
            np.dot(compliance, step, shift)
        else:
            outcome = _sweep(tangents, now, SLOW * before, may_move)
            rounded += largest(shift)
        if outcome == _FAILED:
            return False, size, iteration
        moves += outcome == _MOVED
        add(step, force)
        add(shift, flat)
        before, corrected = size, largest(shift)
    return False, before, MAX_ITERATIONS


def solve_in_blocks(
    solver: CompiledGap,
    blocks: Blocks,
    thermal_gap: Array,
    slip: Array,
    guess: Array,
    tolerance: float,
) -> Equilibrium:
    """Find the gaps by sweeps over blocks, without frozen tangents of earlier steps.

    Newton's method is used if that fails; arguments and errors as `fesim.joint.gap.solve_gap`.
    """
    problem, trial = solver.problem, trial_at(guess)
    kernel = solver.kernel(columns_for(problem, blocks), tolerance)
    rest = problem.change * thermal_gap
    try:
        found = settle_near(kernel, frozen_tangents(blocks), thermal_gap, rest, slip, trial)
    except np.linalg.LinAlgError:
        found = False, math.inf, 0
    solved, residual, iterations = found
    if not solved:
        return solver.solve(thermal_gap, slip, guess, tolerance)
    traction = Traction(trial.value, trial.tangent, trial.moved)
    return Equilibrium(trial.gap, traction, residual, iterations)
