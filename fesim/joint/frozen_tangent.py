"""Frozen tangent of the gap equations, with exact low-rank corrections (Woodbury).

A Newton step solves (I - dT F) y = lack, with dT = T + k0 nonzero only in the pressures and in the
shears of sliding contact elements (`fesim.joint.compiled_gap`). The matrix is factorised at one
state, in single precision, and kept: the frozen tangent. If a contact element has since begun to
stick, slide or open, its three rows are corrected exactly (Woodbury's formula); drift is left to
the iteration, whose residuals are in double precision.

Everything stored follows from the frozen tangent: a march resumed from a saved one is
bit-identical. Each block of contact elements (`fesim.joint.blocks`) has its own.

Start at `correct`, which contains the formula. `tests/fesim/joint/test_modified_newton.py` tests
that the frozen tangent does not affect the equilibrium.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled, compiled_part
from fesim.joint.blocks import Block, Blocks
from fesim.joint.compiled_gap import lacking, lacking_entries, lacking_rows, lacking_system
from fesim.joint.in_place import fill, put
from fesim.joint.law import ALONG
from fesim.joint.linear_system import factorise_single, solve, solve_again
from thermojoint.artefacts.arrays import Array

#: A contact element is corrected exactly if its tangent differs from the frozen one by this
#: fraction of its stiffness at rest.
CHANGED = 0.05
#: Contact elements corrected at once: a fraction of all, with a minimum and a maximum.
SHARE, FEWEST, MOST = 16, 4, 8

#: Indices of `FrozenTangent.about`.
MADE, ROWS, FROZEN = 0, 1, 2


class Scratch(NamedTuple):
    """Work arrays of one correction, large enough for any block; not used afterwards."""

    #: Shape (MOST,): contact elements to be corrected.
    changed: NDArray[np.int64]
    #: Shape (m,): whether the columns of a contact element are needed.
    needed: NDArray[np.bool_]
    #: Shape (3 m,): right side of the frozen system, then its solution.
    solved: NDArray[np.float32]
    #: Shapes (3 MOST,) and (9 MOST^2,): Woodbury's system and its right side.
    factors: Array
    system: Array


class FrozenTangent(NamedTuple):
    """A frozen tangent, its factors and its corrections, written in place."""

    #: Shape (6, m): tangent of the law, as in `fesim.joint.law.Traction`.
    tangent: Array
    #: Shape (3,): whether the factors exist, their number of rows, how often they were computed.
    about: NDArray[np.int64]
    #: Shape (3 m,): rows of the system, and index of each row in it; -1 for none.
    rows: NDArray[np.int64]
    place: NDArray[np.int64]
    #: Shapes (9 m^2,) and (3 m,): I - dT F on these rows, factorised in column order.
    factors: NDArray[np.float32]
    pivots: NDArray[np.int32]
    #: Shape (m,): slot of the stored columns of a contact element; -1 for none.
    slot: NDArray[np.int64]
    #: Shape (s,): contact element of a slot's columns; -1 for none.
    element: NDArray[np.int64]
    #: Shape (s, 3, 3 m): three columns of the inverse for each, Pa.
    columns: Array
    #: Shape (s, 3, s, 3): gaps of each slot's contact element due to each slot's columns, m.
    moved: Array
    #: Work arrays, shared by all blocks.
    scratch: Scratch


class Iteration(NamedTuple):
    """Work arrays of the iteration over all blocks; not used after a step."""

    #: Shape (3 m,): tractions, Pa, and gaps, m: the unknown, its residual, its correction, the
    #: resulting gaps, and the correction by one block.
    force: Array
    lack: Array
    step: Array
    shift: Array
    part: Array
    #: Shape (6 m,): tangent of the law, in one block.
    tangent: Array
    #: Shape (3 m,): residual and correction in one block.
    own_lack: Array
    own_step: Array


class FrozenTangents(NamedTuple):
    """The frozen tangents of b blocks."""

    #: Blocks of contact elements.
    blocks: Blocks
    #: Storage of all blocks: flat arrays, one block after another; `about` is (b, 3). A block's
    #: tangent is (6, n) as in `fesim.joint.law.Traction`; in one (6, m) array the elements of a
    #: block would not be contiguous, and would be copied in every iteration.
    every: FrozenTangent
    #: Shape (5, b + 1): start of each block: in contact elements, in slots, in contact elements
    #: squared, in slots times contact elements and in slots squared.
    begins: NDArray[np.int64]
    #: Work arrays of the iteration.
    iteration: Iteration


def frozen_tangents(blocks: Blocks) -> FrozenTangents:
    """Return storage for the frozen tangents of blocks, initially without any."""
    counts = np.diff(blocks.starts)
    slots = np.minimum(np.clip(counts // SHARE, FEWEST, MOST), np.maximum(counts, 1))
    every = int(counts.sum())
    storage = FrozenTangent(
        tangent=np.zeros(6 * every),
        about=np.zeros((counts.size, 3), dtype=np.int64),
        rows=np.zeros(3 * every, dtype=np.int64),
        place=np.full(3 * every, -1),
        factors=np.empty(9 * int((counts * counts).sum()), dtype=np.float32),
        pivots=np.empty(3 * every, dtype=np.int32),
        slot=np.full(every, -1),
        element=np.full(int(slots.sum()), -1),
        columns=np.zeros(9 * int((slots * counts).sum())),
        moved=np.zeros(9 * int((slots * slots).sum())),
        scratch=Scratch(
            changed=np.empty(MOST, dtype=np.int64),
            needed=np.empty(every, dtype=np.bool_),
            solved=np.empty(3 * every, dtype=np.float32),
            factors=np.empty(3 * MOST),
            system=np.empty(9 * MOST * MOST),
        ),
    )
    size = 3 * every
    iteration = Iteration(*(np.empty(n) for n in [size] * 5 + [2 * size] + [size] * 2))
    begins = np.zeros((5, blocks.starts.size), dtype=np.int64)
    sizes = [counts, slots, counts * counts, slots * counts, slots * slots]
    np.cumsum(sizes, axis=1, out=begins[:, 1:])
    return FrozenTangents(blocks, storage, begins, iteration)


@compiled
def block_tangent(tangents: FrozenTangents, block: int) -> FrozenTangent:
    """The frozen tangent of one block, as views of the common storage."""
    first, slot, square, column, move = tangents.begins[:, block]
    last, end, next_square, next_column, next_move = tangents.begins[:, block + 1]
    count, slots = last - first, end - slot
    return FrozenTangent(
        tangents.every.tangent[6 * first : 6 * last].reshape(6, count),
        tangents.every.about[block],
        tangents.every.rows[3 * first : 3 * last],
        tangents.every.place[3 * first : 3 * last],
        tangents.every.factors[9 * square : 9 * next_square],
        tangents.every.pivots[3 * first : 3 * last],
        tangents.every.slot[first:last],
        tangents.every.element[slot:end],
        tangents.every.columns[9 * column : 9 * next_column].reshape(slots, 3, 3 * count),
        tangents.every.moved[9 * move : 9 * next_move].reshape(slots, 3, slots, 3),
        tangents.every.scratch,
    )


@compiled
def put_tangents(tangents: FrozenTangents, into: Array) -> None:
    """Write the existing frozen tangents into `into` (6, m), zero for the others."""
    elements = tangents.blocks.elements
    for block in range(tangents.begins.shape[1] - 1):
        first, last = tangents.begins[0, block], tangents.begins[0, block + 1]
        at, made = 6 * first, tangents.every.about[block, MADE] == 1
        for i in range(6):
            for k in range(first, last):
                into[i, elements[k]] = tangents.every.tangent[at] if made else 0.0
                at += 1


@compiled
def forget(tangents: FrozenTangents) -> None:
    """Mark the factors of all blocks as missing."""
    for block in range(tangents.every.about.shape[0]):
        tangents.every.about[block, MADE] = 0


class Lacking(NamedTuple):
    """Difference of the law's tractions from those used for the gaps, in one iteration."""

    #: Shape (6, m): tangent of the law.
    tangent: Array
    #: Shape (3 m,): the difference, Pa.
    lack: Array
    #: Gap, m, up to which a sticking contact element is not corrected.
    least: float


@compiled
def freeze_tangent(frozen: FrozenTangent, block: Block) -> None:
    """Factorise the system of a frozen tangent."""
    size = lacking_rows(block.springs, frozen.tangent, frozen.rows)
    fill(frozen.place, -1)
    for k in range(size):
        frozen.place[frozen.rows[k]] = k
    matrix = frozen.factors[: size * size].reshape(size, size)
    entries, unknown = np.empty((3, size)), frozen.scratch.solved[:size]
    lacking_entries(block.springs, frozen.tangent, frozen.rows, entries)
    lacking_system(block.columns, entries, frozen.rows, matrix)
    fill(unknown, 1.0)
    factorise_single(matrix, frozen.pivots[:size], unknown)
    fill(frozen.slot, -1)
    fill(frozen.element, -1)
    frozen.about[MADE], frozen.about[ROWS] = 1, size
    frozen.about[FROZEN] += 1


@compiled_part
def add_product(columns: NDArray[np.floating], factors: Array, total: Array) -> None:
    """Add the sum of the rows of `columns`, each times its factor, to `total`; factors may be zero.

    Four rows at a time: the total is read and written once for all four.
    """
    size, count = total.size, 0
    first, second, third = 0, 0, 0
    for m in range(factors.size):
        if factors[m] == 0.0:
            continue
        count += 1
        if count == 1:
            first = m
        elif count == 2:
            second = m
        elif count == 3:
            third = m
        else:
            count = 0
            p, q, r, s = factors[first], factors[second], factors[third], factors[m]
            a, b, c, d = columns[first], columns[second], columns[third], columns[m]
            for i in range(size):
                total[i] += p * a[i] + q * b[i] + r * c[i] + s * d[i]
    for k in range(count):
        row = first if k == 0 else second if k == 1 else third
        factor, values = factors[row], columns[row]
        for i in range(size):
            total[i] += factor * values[i]


@compiled_part
def _solve_frozen(frozen: FrozenTangent, right_side: Array, solution: Array) -> None:
    """Write the frozen system's solution for `right_side` into `solution`, zero elsewhere."""
    size = frozen.about[ROWS]
    solved = frozen.scratch.solved[:size]
    for k in range(size):
        solved[k] = right_side[frozen.rows[k]]
    factors = frozen.factors[: size * size].reshape(size, size)
    solve_again(factors, frozen.pivots[:size], solved)
    fill(solution, 0.0)
    for k in range(size):
        solution[frozen.rows[k]] = solved[k]


@compiled_part
def _changed(
    frozen: FrozenTangent, springs: Array, now: Lacking, changed: NDArray[np.int64]
) -> int:
    """Write the elements to be corrected into `changed`; return their number, -1: too many."""
    tangent, lack, least = now.tangent, now.lack, now.least
    count, number = tangent.shape[1], 0
    for e in range(count):
        first, second = count + e, 2 * count + e
        # A row outside the system can only have a residual while its element keeps sliding.
        lacks = max(abs(lack[first]), abs(lack[second])) > least * springs[first]
        differs = frozen.place[first] < 0 and lacks
        for k in range(6):
            scale = CHANGED * (springs[e] if k < ALONG else springs[first])
            differs = differs or abs(tangent[k, e] - frozen.tangent[k, e]) > scale
        if differs:
            if number == changed.size:
                return -1
            changed[number] = e
            number += 1
    return number


@compiled_part
def _keep_columns(
    frozen: FrozenTangent, block: Block, changed: NDArray[np.int64], number: int
) -> None:
    """Store these contact elements' columns of the inverse in slots, unless already stored."""
    springs, columns = block.springs, block.columns
    count = frozen.slot.size
    needed = frozen.scratch.needed[:count]
    for e in range(count):
        needed[e] = False
    for k in range(number):
        needed[changed[k]] = True
    free = 0
    for k in range(number):
        e = changed[k]
        if frozen.slot[e] >= 0:
            continue
        while frozen.element[free] >= 0 and needed[frozen.element[free]]:
            free += 1
        if frozen.element[free] >= 0:
            frozen.slot[frozen.element[free]] = -1
        frozen.slot[e], frozen.element[free] = free, e
        for i in range(3):
            row = i * count + e
            kept = frozen.columns[free, i]
            fill(kept, 0.0)
            inside = frozen.place[row] >= 0
            # The solution replaces the right side.
            if inside:
                kept[row] = 1.0
            else:
                for j in range(frozen.about[ROWS]):
                    other = frozen.rows[j]
                    normal, along, across = lacking(springs, frozen.tangent, other)
                    f = other % count
                    kept[other] = (
                        normal * columns[row, f]
                        + along * columns[row, count + f]
                        + across * columns[row, 2 * count + f]
                    )
            _solve_frozen(frozen, kept, kept)
            if not inside:
                kept[row] = 1.0
        for other in range(frozen.element.size):
            if frozen.element[other] >= 0:
                _move(frozen, block.compliance, other, free)
                _move(frozen, block.compliance, free, other)


@compiled_part
def _move(frozen: FrozenTangent, compliance: Array, slot: int, by: int) -> None:
    """Store the gaps of a slot's contact element due to the columns of another slot."""
    for i in range(3):
        row = compliance[i * frozen.slot.size + frozen.element[slot]]
        for j in range(3):
            frozen.moved[slot, i, by, j] = np.dot(row, frozen.columns[by, j])


@compiled_part
def correct(frozen: FrozenTangent, block: Block, now: Lacking, step: Array) -> bool:
    """Newton's step y (3 m,), Pa, for the residual, in place; False: too much has changed.

    With E = dT - dT_frozen of the changed contact elements (rows P) and A the frozen system:
    (A - P E F_P) y = lack, so y = A^-1 lack + A^-1 P (I - E F_P A^-1 P)^-1 E F_P A^-1 lack.
    """
    springs, tangent, lack = block.springs, now.tangent, now.lack
    count = tangent.shape[1]
    changed = frozen.scratch.changed[: frozen.element.size]
    number = _changed(frozen, springs, now, changed)
    if number < 0:
        return False
    _keep_columns(frozen, block, changed, number)
    _solve_frozen(frozen, lack, step)
    factors = frozen.scratch.factors[: 3 * number]
    fill(factors, 0.0)
    for k in range(number):
        for i in range(1, 3):
            row = i * count + changed[k]
            if frozen.place[row] < 0:
                factors[3 * k + i] = lack[row]
    _combine(frozen, changed, factors, step)
    if number > 0:
        _follow_change(frozen, block, tangent, changed[:number], step)
    return True


@compiled_part
def _follow_change(
    frozen: FrozenTangent, block: Block, tangent: Array, changed: NDArray[np.int64], step: Array
) -> None:
    """Add the second term of `correct` to A^-1 lack."""
    springs, count, width = block.springs, tangent.shape[1], 3 * changed.size
    factors = frozen.scratch.factors[:width]
    system = frozen.scratch.system[: width * width].reshape(width, width)
    for k in range(changed.size):
        e = changed[k]
        own = frozen.moved[frozen.slot[e]]
        opening = np.dot(block.compliance[e], step)
        along = np.dot(block.compliance[count + e], step)
        across = np.dot(block.compliance[2 * count + e], step)
        for i in range(3):
            row = i * count + e
            here, then = lacking(springs, tangent, row), lacking(springs, frozen.tangent, row)
            first, second, third = here[0] - then[0], here[1] - then[1], here[2] - then[2]
            factors[3 * k + i] = first * opening + second * along + third * across
            for other in range(changed.size):
                slot = frozen.slot[changed[other]]
                for j in range(3):
                    system[3 * k + i, 3 * other + j] = -(
                        first * own[0, slot, j] + second * own[1, slot, j] + third * own[2, slot, j]
                    )
            system[3 * k + i, 3 * k + i] += 1.0
    put(solve(system, factors), factors)
    _combine(frozen, changed, factors, step)


@compiled_part
def _combine(
    frozen: FrozenTangent, changed: NDArray[np.int64], factors: Array, step: Array
) -> None:
    """Add the stored columns, each times its factor, to the step."""
    for k in range(factors.size):
        if factors[k] != 0.0:
            column = frozen.columns[frozen.slot[changed[k // 3]], k % 3]
            for i in range(step.size):
                step[i] += factors[k] * column[i]
