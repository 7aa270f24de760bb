"""Frozen tangent of the gap equations, with exact low-rank corrections (Woodbury).

A Newton step solves (I - dT F) y = what is lacking, with dT = T + k0 nonzero only in the pressures
and in the shears of contact elements that slide (`fesim.joint.compiled_gap`). The inverse is made
at an anchor and kept. Where a contact element has begun to stick, slide or open since, its three
rows are corrected exactly (Woodbury's formula); what has merely drifted is left to the iteration.

All that is kept follows from the anchor: a march that goes on from a saved one gives the same bits.
Blocks of contact elements (`fesim.joint.blocks`) have an anchor each, one behind the other.

Start at `correct`, which says the formula. That an anchor, wherever it is, changes nothing of the
equilibrium is a test of `tests/fesim/joint/test_modified_newton.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled
from fesim.joint.blocks import Block, Blocks
from fesim.joint.compiled_gap import ALONG, lacking, lacking_rows, lacking_system
from thermojoint.artefacts.arrays import Array

#: A contact element whose tangent differs from that of the anchor by this part of its stiffness at
#: rest is corrected exactly.
CHANGED = 0.05
#: Contact elements corrected at once: a part of all of them, at least so few, at most so many.
SHARE, FEWEST, MOST = 8, 4, 32

#: Places in `FrozenTangent.about`.
MADE, ROWS, ANCHORED = 0, 1, 2


class FrozenTangent(NamedTuple):
    """The tangent that was inverted, and what is kept of it; storage that is written in place.

    Attributes
    ----------
    tangent : ndarray, shape (6, m)
        Of the law there: entries 00, 10, 20, 11, 12, 22.
    about : ndarray of int, shape (3,)
        Whether the inverse is made, how many rows it has, how often it was made.
    rows, place : ndarray of int, shape (3 m,)
        Rows of the inverse, and where each row stands in it; -1 where it does not.
    inverse : ndarray, shape (9 m^2,)
        (I - dT F)^-1 on these rows, row after row.
    slot : ndarray of int, shape (m,)
        Where the columns of a contact element are kept; -1 for nowhere.
    element : ndarray of int, shape (s,)
        Whose columns a slot keeps; -1 for nobody's.
    columns, moved : ndarray, shape (s, 3, 3 m)
        Three columns of the inverse of each, and F times them.
    """

    tangent: Array
    about: NDArray[np.int64]
    rows: NDArray[np.int64]
    place: NDArray[np.int64]
    inverse: Array
    slot: NDArray[np.int64]
    element: NDArray[np.int64]
    columns: Array
    moved: Array


class FrozenTangents(NamedTuple):
    """The anchors of b blocks.

    Attributes
    ----------
    blocks : Blocks
        They stay as they are.
    every : FrozenTangent
        The storage of all: its arrays are flat, one block behind the other; `about` is (b, 3).
    begins : ndarray of int, shape (4, b + 1)
        Where each block begins: in contact elements, in slots, in contact elements squared and in
        slots times contact elements.
    """

    blocks: Blocks
    every: FrozenTangent
    begins: NDArray[np.int64]


def frozen_tangents(blocks: Blocks) -> FrozenTangents:
    """Return anchors of blocks of contact elements that are nowhere yet."""
    counts = np.diff(blocks.starts)
    slots = np.minimum(np.clip(counts // SHARE, FEWEST, MOST), np.maximum(counts, 1))
    every, kept = int(counts.sum()), 9 * int((slots * counts).sum())
    storage = FrozenTangent(
        tangent=np.zeros(6 * every),
        about=np.zeros((counts.size, 3), dtype=np.int64),
        rows=np.zeros(3 * every, dtype=np.int64),
        place=np.full(3 * every, -1),
        inverse=np.empty(9 * int((counts * counts).sum())),
        slot=np.full(every, -1),
        element=np.full(int(slots.sum()), -1),
        columns=np.zeros(kept),
        moved=np.zeros(kept),
    )
    begins = np.zeros((4, blocks.starts.size), dtype=np.int64)
    np.cumsum([counts, slots, counts * counts, slots * counts], axis=1, out=begins[:, 1:])
    return FrozenTangents(blocks, storage, begins)


@compiled
def block_tangent(anchors: FrozenTangents, block: int) -> FrozenTangent:
    """The anchor of one block, in the storage of all."""
    first, slot, square, kept = anchors.begins[:, block]
    last, end, squared, next_kept = anchors.begins[:, block + 1]
    count, slots, own = last - first, end - slot, slice(9 * kept, 9 * next_kept)
    return FrozenTangent(
        anchors.every.tangent[6 * first : 6 * last].reshape(6, count),
        anchors.every.about[block],
        anchors.every.rows[3 * first : 3 * last],
        anchors.every.place[3 * first : 3 * last],
        anchors.every.inverse[9 * square : 9 * squared],
        anchors.every.slot[first:last],
        anchors.every.element[slot:end],
        anchors.every.columns[own].reshape(slots, 3, 3 * count),
        anchors.every.moved[own].reshape(slots, 3, 3 * count),
    )


@compiled
def put_tangents(anchors: FrozenTangents, into: Array) -> None:
    """Put the tangents of the anchors that are made into `found` (6, m), zero for the others."""
    elements = anchors.blocks.elements
    for block in range(anchors.begins.shape[1] - 1):
        first, last = anchors.begins[0, block], anchors.begins[0, block + 1]
        at, made = 6 * first, anchors.every.about[block, MADE] == 1
        for i in range(6):
            for k in range(first, last):
                into[i, elements[k]] = anchors.every.tangent[at] if made else 0.0
                at += 1


class Lacking(NamedTuple):
    """What the law's tractions lack of those that the gaps were made with, in one iteration.

    Attributes
    ----------
    tangent : ndarray, shape (6, m)
        Of the law there.
    lack : ndarray, shape (3 m,)
        Pa.
    least : float
        What a contact element that sticks lacks is left alone up to this, a gap in m.
    """

    tangent: Array
    lack: Array
    least: float


class Correction(NamedTuple):
    """Newton's step: y, tractions (3 m,), Pa, and F y, gaps (3 m,), m; written in place."""

    step: Array
    shift: Array


@compiled
def freeze_tangent(anchor: FrozenTangent, block: Block) -> None:
    """Invert the tangent that stands in an anchor."""
    size = lacking_rows(block.springs, anchor.tangent, anchor.rows)
    anchor.place[:] = -1
    for k in range(size):
        anchor.place[anchor.rows[k]] = k
    matrix = np.empty((size, size))
    lacking_system(block.springs, block.compliance, anchor.tangent, anchor.rows, matrix)
    anchor.inverse[: size * size] = np.linalg.inv(matrix).ravel()
    anchor.slot[:] = -1
    anchor.element[:] = -1
    anchor.about[MADE], anchor.about[ROWS] = 1, size
    anchor.about[ANCHORED] += 1


@compiled
def add_product(columns: Array, factors: Array, total: Array) -> None:
    """Add the sum of the rows of `columns`, each by its factor, to `total`; factors may be zero.

    Four rows at a time: what they add to is read and written once for them.
    """
    size, count, rows = total.size, 0, np.empty(4, dtype=np.int64)
    for j in range(factors.size):
        if factors[j] == 0.0:
            continue
        rows[count] = j
        count += 1
        if count == 4:
            count = 0
            p, q, r, s = factors[rows[0]], factors[rows[1]], factors[rows[2]], factors[rows[3]]
            a, b, c, d = columns[rows[0]], columns[rows[1]], columns[rows[2]], columns[rows[3]]
            for i in range(size):
                total[i] += p * a[i] + q * b[i] + r * c[i] + s * d[i]
    for k in range(count):
        factor, row = factors[rows[k]], columns[rows[k]]
        for i in range(size):
            total[i] += factor * row[i]


@compiled
def _solve_frozen(anchor: FrozenTangent, right_side: Array, solution: Array) -> None:
    """The rows of the inverse times `right_side`, and zero elsewhere, into `found` (3 m,)."""
    size = anchor.about[ROWS]
    own = np.empty(size)
    for k in range(size):
        own[k] = right_side[anchor.rows[k]]
    solved = np.dot(anchor.inverse[: size * size].reshape(size, size), own)
    solution[:] = 0.0
    for k in range(size):
        solution[anchor.rows[k]] = solved[k]


@compiled
def _changed(
    anchor: FrozenTangent, springs: Array, now: Lacking, changed: NDArray[np.int64]
) -> int:
    """Put the contact elements to be corrected into `found`; return how many, or -1: too many."""
    tangent, lack, least = now.tangent, now.lack, now.least
    count, number = tangent.shape[1], 0
    for e in range(count):
        first, second = count + e, 2 * count + e
        # A row outside the inverse lacks something only while its element goes from sliding on.
        # One that has slipped before has its rounding in every iteration, too.
        lacks = max(abs(lack[first]), abs(lack[second])) > least * springs[first]
        differs = anchor.place[first] < 0 and lacks
        for k in range(6):
            scale = CHANGED * (springs[e] if k < ALONG else springs[first])
            differs = differs or abs(tangent[k, e] - anchor.tangent[k, e]) > scale
        if differs:
            if number == changed.size:
                return -1
            changed[number] = e
            number += 1
    return number


@compiled
def _keep_columns(
    anchor: FrozenTangent, block: Block, changed: NDArray[np.int64], number: int
) -> None:
    """See to it that each of the contact elements has its columns of the inverse in a slot."""
    springs, columns = block.springs, block.columns
    count = anchor.slot.size
    needed = np.zeros(count, dtype=np.bool_)
    for k in range(number):
        needed[changed[k]] = True
    own, free = np.empty(3 * count), 0
    for k in range(number):
        e = changed[k]
        if anchor.slot[e] >= 0:
            continue
        while anchor.element[free] >= 0 and needed[anchor.element[free]]:
            free += 1
        if anchor.element[free] >= 0:
            anchor.slot[anchor.element[free]] = -1
        anchor.slot[e], anchor.element[free] = free, e
        for i in range(3):
            row = i * count + e
            kept, moved = anchor.columns[free, i], anchor.moved[free, i]
            at = anchor.place[row]
            if at >= 0:
                kept[:] = 0.0
                size = anchor.about[ROWS]
                for j in range(size):
                    kept[anchor.rows[j]] = anchor.inverse[j * size + at]
            else:
                for j in range(anchor.about[ROWS]):
                    other = anchor.rows[j]
                    normal, along, across = lacking(springs, anchor.tangent, other)
                    f = other % count
                    own[other] = (
                        normal * columns[row, f]
                        + along * columns[row, count + f]
                        + across * columns[row, 2 * count + f]
                    )
                _solve_frozen(anchor, own, kept)
                kept[row] = 1.0
            moved[:] = 0.0
            add_product(columns, kept, moved)


@compiled
def correct(anchor: FrozenTangent, block: Block, now: Lacking, correction: Correction) -> bool:
    """Newton's step for what is lacking; False: too much changed.

    With E = dT - dT_anchor of the changed contact elements (rows P) and A the system at the anchor:
    (A - P E F_P) y = lack, so y = A^-1 lack + A^-1 P (I - E F_P A^-1 P)^-1 E F_P A^-1 lack.
    """
    springs, tangent, lack = block.springs, now.tangent, now.lack
    step, shift = correction.step, correction.shift
    count = tangent.shape[1]
    changed = np.empty(anchor.element.size, dtype=np.int64)
    number = _changed(anchor, springs, now, changed)
    if number < 0:
        return False
    _keep_columns(anchor, block, changed, number)
    _solve_frozen(anchor, lack, step)
    shift[:] = 0.0
    add_product(block.columns, step, shift)
    factors, width = np.zeros(3 * number), 3 * number
    for k in range(number):
        for i in range(1, 3):
            row = i * count + changed[k]
            if anchor.place[row] < 0:
                factors[3 * k + i] = lack[row]
    _combine(anchor, changed, factors, correction)
    if number == 0:
        return True
    system = np.empty((width, width))
    for k in range(number):
        e = changed[k]
        for i in range(3):
            row = i * count + e
            here, then = lacking(springs, tangent, row), lacking(springs, anchor.tangent, row)
            first, second, third = here[0] - then[0], here[1] - then[1], here[2] - then[2]
            factors[3 * k + i] = (
                first * shift[e] + second * shift[count + e] + third * shift[2 * count + e]
            )
            for other in range(number):
                for j in range(3):
                    moved = anchor.moved[anchor.slot[changed[other]], j]
                    system[3 * k + i, 3 * other + j] = -(
                        first * moved[e] + second * moved[count + e] + third * moved[2 * count + e]
                    )
            system[3 * k + i, 3 * k + i] += 1.0
    factors[:] = np.linalg.solve(system, factors)
    _combine(anchor, changed, factors, correction)
    return True


@compiled
def _combine(
    anchor: FrozenTangent, changed: NDArray[np.int64], factors: Array, correction: Correction
) -> None:
    """Add the kept columns, each by its factor, to the step, and F times them to the shift."""
    step, shift = correction.step, correction.shift
    for k in range(factors.size):
        if factors[k] != 0.0:
            at = anchor.slot[changed[k // 3]]
            step += factors[k] * anchor.columns[at, k % 3]
            shift += factors[k] * anchor.moved[at, k % 3]
