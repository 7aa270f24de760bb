"""Modified Newton method for the gap equations with a frozen tangent over many steps.

Unknown: the tractions w = z(g) + k0 g that the springs lack, with g = J0^-1 g_T + F w. A Newton
step solves (I - dT F) y = z(g) + k0 g - w by the inverse of an anchor (`fesim.joint.anchor`), which
is moved where the iteration converges badly. With several blocks of contact elements a sweep over
them, each by its own anchor with what those before it have moved (Gauss and Seidel), stands for it.
"""

from __future__ import annotations

import math

import numpy as np

from fesim.joint.anchor import (
    MADE,
    Anchor,
    Anchors,
    add_product,
    block_anchor,
    correct,
    make_anchor,
)
from fesim.joint.blocks import Blocks, part_of
from fesim.joint.compiled_gap import evaluate_in_place, lacking, largest
from fesim.machine_code import compiled
from thermojoint.artefacts.arrays import Array

#: Iterations of a step, and how often anchors are moved in it, at most.
MAX_ITERATIONS, MAX_ANCHORS = 40, 4
#: An iteration that leaves more than this of what was lacking moves the anchor.
SLOW = 0.3
#: After a step of more iterations than this the anchor is moved in the next.
PATIENCE = 8
#: What is left to correct when a state is accepted, of the tolerance: the last iterations of
#: Newton's own method leave as little, and friction remembers what is left.
LEFT = 0.01

#: What became of a correction: too much has changed for it; the anchor served; it was moved.
_FAILED, _CORRECTED, _MOVED = range(3)


@compiled
def _correct_or_move(
    anchor: Anchor,
    springs: Array,
    compliance: Array,
    columns: Array,
    tangent: Array,
    lack: Array,
    least: float,
    stale: bool,
    may_move: bool,
    step: Array,
    shift: Array,
) -> int:
    """`correct`, by an anchor that is moved before if it is stale, or if too much changed."""
    move = stale or anchor.about[MADE] == 0
    while True:
        if move:
            if not may_move:
                return _FAILED
            anchor.tangent[:] = tangent
            make_anchor(anchor, springs, compliance)
        if correct(anchor, springs, columns, tangent, lack, least, step, shift):
            return _MOVED if move else _CORRECTED
        if move:
            return _FAILED
        move = True


@compiled
def _sweep(
    blocks: Blocks,
    anchors: Anchors,
    columns: Array,
    tangent: Array,
    lack: Array,
    least: float,
    most: float,
    may_move: bool,
    step: Array,
    shift: Array,
) -> int:
    """One sweep over the blocks: y into `step`, F y into `shift`.

    The anchor of a block is moved whose own lack is above `most`, a gap in m.
    """
    count, outcome = tangent.shape[1], _CORRECTED
    step[:] = 0.0
    shift[:] = 0.0
    for block in range(blocks.starts.size - 1):
        elements, springs, compliance, own_columns = part_of(blocks, block)
        size = elements.size
        own_tangent, own_lack = np.empty((6, size)), np.empty(3 * size)
        own_step, own_shift, stale = np.empty(3 * size), np.empty(3 * size), False
        for k in range(size):
            e = elements[k]
            for i in range(6):
                own_tangent[i, k] = tangent[i, e]
            for i in range(3):
                row, own = i * count + e, i * size + k
                stale = stale or abs(lack[row]) > most * springs[own]
                normal, along, across = lacking(springs, own_tangent, own)
                own_lack[own] = (
                    lack[row]
                    + normal * shift[e]
                    + along * shift[count + e]
                    + across * shift[2 * count + e]
                )
        found = _correct_or_move(
            block_anchor(anchors, block),
            springs,
            compliance,
            own_columns,
            own_tangent,
            own_lack,
            least,
            stale,
            may_move,
            own_step,
            own_shift,
        )
        if found == _FAILED:
            return _FAILED
        outcome = max(outcome, found)
        own_part = np.zeros(3 * count)
        for i in range(3):
            for k in range(size):
                own_part[i * count + elements[k]] = own_step[i * size + k]
        step += own_part
        add_product(columns, own_part, shift)
    return outcome


@compiled
def _lack(springs: Array, gap: Array, value: Array, force: Array, lack: Array) -> float:
    """z(g) + k0 g - w into `lack`; return its largest entry in gaps, m."""
    count, size = gap.shape[1], 0.0
    for i in range(3):
        for e in range(count):
            at = i * count + e
            lack[at] = value[i, e] + springs[at] * gap[i, e] - force[at]
            one = abs(lack[at]) / springs[at]
            if not one <= 1e300:
                return math.inf
            size = max(size, one)
    return size


@compiled
def settle_near(
    springs: Array,
    columns: Array,
    blocks: Blocks,
    laws: Array,
    free_gap: Array,
    slip: Array,
    tolerance: float,
    anchors: Anchors,
    gap: Array,
    value: Array,
    moved: Array,
    tangent: Array,
) -> tuple[bool, float, int]:
    """Iterate from `gap`, in place: whether it is solved, the residual and the iterations.

    Arguments as in `fesim.joint.compiled_gap.solve_in_place`; `columns` is F transposed, `anchors`
    are those of the blocks. What is accepted has a residual g - J0^-1 g_T - F (z(g) + k0 g) within
    the tolerance.
    """
    unknowns, flat = springs.size, gap.reshape(-1)
    force, lack = np.zeros(unknowns), np.empty(unknowns)
    step, shift = np.empty(unknowns), np.empty(unknowns)
    evaluate_in_place(laws, gap, slip, value, moved, tangent)
    _lack(springs, gap, value, np.zeros(unknowns), force)
    flat[:] = free_gap
    add_product(columns, force, flat)
    moves, before, corrected, least = 0, math.inf, math.inf, 0.1 * LEFT * tolerance
    one, first, whole = blocks.starts.size == 2, block_anchor(anchors, 0), part_of(blocks, 0)[2]
    for iteration in range(MAX_ITERATIONS):
        evaluate_in_place(laws, gap, slip, value, moved, tangent)
        size = _lack(springs, gap, value, force, lack)
        if size == math.inf:
            return False, size, iteration
        left = corrected * size <= LEFT * tolerance * before if iteration > 0 else False
        if left or size <= least:
            shift[:] = 0.0
            add_product(columns, lack, shift)
            residual = largest(shift)
            if residual <= tolerance and np.spacing(largest(gap)) <= tolerance:
                if iteration > PATIENCE:
                    anchors.every.about[:, MADE] = 0
                return True, residual, iteration
        if one:
            outcome = _correct_or_move(
                first,
                springs,
                whole,
                columns,
                tangent,
                lack,
                least,
                size > SLOW * before,
                moves < MAX_ANCHORS,
                step,
                shift,
            )
        else:
            outcome = _sweep(
                blocks,
                anchors,
                columns,
                tangent,
                lack,
                least,
                SLOW * before,
                moves < MAX_ANCHORS,
                step,
                shift,
            )
        if outcome == _FAILED:
            return False, size, iteration
        moves += outcome == _MOVED
        force += step
        flat += shift
        before, corrected = size, largest(shift)
    return False, before, MAX_ITERATIONS
