"""The gap equations by a modified Newton method: one factor serves many iterations and steps.

Unknown: the tractions w = z(g) + k0 g that the springs lack, with g = J0^-1 g_T + F w. A Newton
step solves (I - dT F) y = z(g) + k0 g - w, where dT = T + k0 is nonzero only in the pressures and
in the shears of contact elements that slide (`fesim.joint.compiled_gap`). The inverse is made at an
anchor and kept. Where a contact element has begun to stick, slide or open since, its three rows are
corrected exactly (Woodbury's formula); what has merely drifted is left to the iteration. Where that
converges badly the anchor is moved.

All that is kept follows from the anchor: a march that goes on from a saved one gives the same bits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artefacts.arrays import Array
from fesim.joint.compiled_gap import (
    evaluate_in_place,
    lacking,
    lacking_rows,
    lacking_system,
    largest,
)
from fesim.machine_code import compiled

#: A contact element whose tangent differs from that of the anchor by this part of its stiffness at
#: rest is corrected exactly.
CHANGED = 0.05
#: Contact elements corrected at once: a part of all of them, at least so few, at most so many.
SHARE, FEWEST, MOST = 8, 4, 32
#: Iterations of a step, and how often its anchor is moved, at most.
MAX_ITERATIONS, MAX_ANCHORS = 40, 4
#: An iteration that leaves more than this of what was lacking moves the anchor.
SLOW = 0.3
#: After a step of more iterations than this the anchor is moved in the next.
PATIENCE = 8
#: What is left to correct when a state is accepted, of the tolerance: the last iterations of
#: Newton's own method leave as little, and friction remembers what is left.
LEFT = 0.01

#: Places in `Anchor.about`.
MADE, ROWS, ANCHORED = 0, 1, 2


class Anchor(NamedTuple):
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


def new_anchor(count: int) -> Anchor:
    """Return an anchor for `count` contact elements that is nowhere yet."""
    slots, unknowns = min(max(count // SHARE, FEWEST), MOST, max(count, 1)), 3 * count
    return Anchor(
        tangent=np.zeros((6, count)),
        about=np.zeros(3, dtype=np.int64),
        rows=np.zeros(unknowns, dtype=np.int64),
        place=np.full(unknowns, -1),
        inverse=np.empty(unknowns * unknowns),
        slot=np.full(count, -1),
        element=np.full(slots, -1),
        columns=np.zeros((slots, 3, unknowns)),
        moved=np.zeros((slots, 3, unknowns)),
    )


@compiled
def make_anchor(anchor: Anchor, springs: Array, compliance: Array) -> None:
    """Invert the tangent that stands in an anchor."""
    size = lacking_rows(springs, anchor.tangent, anchor.rows)
    anchor.place[:] = -1
    for k in range(size):
        anchor.place[anchor.rows[k]] = k
    matrix = np.empty((size, size))
    lacking_system(springs, compliance, anchor.tangent, anchor.rows, matrix)
    anchor.inverse[: size * size] = np.linalg.inv(matrix).ravel()
    anchor.slot[:] = -1
    anchor.element[:] = -1
    anchor.about[MADE], anchor.about[ROWS] = 1, size
    anchor.about[ANCHORED] += 1


@compiled
def _add_product(columns: Array, factors: Array, total: Array) -> None:
    """F y is added to `total`; most of y may be zero."""
    for j in range(factors.size):
        factor = factors[j]
        if factor != 0.0:
            column = columns[j]
            for i in range(total.size):
                total[i] += factor * column[i]


@compiled
def _solve_at_anchor(anchor: Anchor, right_side: Array, found: Array) -> None:
    """The rows of the inverse times `right_side`, and zero elsewhere, into `found` (3 m,)."""
    size = anchor.about[ROWS]
    own = np.empty(size)
    for k in range(size):
        own[k] = right_side[anchor.rows[k]]
    solved = np.dot(anchor.inverse[: size * size].reshape(size, size), own)
    found[:] = 0.0
    for k in range(size):
        found[anchor.rows[k]] = solved[k]


@compiled
def _changed(
    anchor: Anchor,
    springs: Array,
    tangent: Array,
    lack: Array,
    least: float,
    found: NDArray[np.int64],
) -> int:
    """Put the contact elements to be corrected into `found`; return how many, or -1: too many."""
    count, number = tangent.shape[1], 0
    for e in range(count):
        first, second = count + e, 2 * count + e
        # A row outside the inverse lacks something only while its element goes from sliding on.
        # One that has slipped before has its rounding in every iteration, too.
        lacks = max(abs(lack[first]), abs(lack[second])) > least * springs[first]
        differs = anchor.place[first] < 0 and lacks
        for k in range(6):
            scale = CHANGED * (springs[e] if k < 3 else springs[first])
            differs = differs or abs(tangent[k, e] - anchor.tangent[k, e]) > scale
        if differs:
            if number == found.size:
                return -1
            found[number] = e
            number += 1
    return number


@compiled
def _keep_columns(
    anchor: Anchor, springs: Array, columns: Array, changed: NDArray[np.int64], number: int
) -> None:
    """See to it that each of the contact elements has its columns of the inverse in a slot."""
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
                _solve_at_anchor(anchor, own, kept)
                kept[row] = 1.0
            moved[:] = 0.0
            _add_product(columns, kept, moved)


@compiled
def _correct(
    anchor: Anchor,
    springs: Array,
    columns: Array,
    tangent: Array,
    lack: Array,
    least: float,
    step: Array,
    shift: Array,
) -> bool:
    """Newton's step for what is lacking: y into `step`, F y into `shift`; False: too much changed.

    What a contact element that sticks lacks is left alone up to `least`, a gap in m.

    With E = dT - dT_anchor of the changed contact elements (rows P) and A the system at the anchor:
    (A - P E F_P) y = lack, so y = A^-1 lack + A^-1 P (I - E F_P A^-1 P)^-1 E F_P A^-1 lack.
    """
    count = tangent.shape[1]
    changed = np.empty(anchor.element.size, dtype=np.int64)
    number = _changed(anchor, springs, tangent, lack, least, changed)
    if number < 0:
        return False
    _keep_columns(anchor, springs, columns, changed, number)
    _solve_at_anchor(anchor, lack, step)
    shift[:] = 0.0
    _add_product(columns, step, shift)
    factors, width = np.zeros(3 * number), 3 * number
    for k in range(number):
        for i in range(1, 3):
            row = i * count + changed[k]
            if anchor.place[row] < 0:
                factors[3 * k + i] = lack[row]
    _combine(anchor, changed, factors, step, shift)
    if number == 0:
        return True
    system = np.empty((width, width))
    for k in range(number):
        e = changed[k]
        for i in range(3):
            row = i * count + e
            now, then = lacking(springs, tangent, row), lacking(springs, anchor.tangent, row)
            first, second, third = now[0] - then[0], now[1] - then[1], now[2] - then[2]
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
    _combine(anchor, changed, factors, step, shift)
    return True


@compiled
def _combine(
    anchor: Anchor, changed: NDArray[np.int64], factors: Array, step: Array, shift: Array
) -> None:
    """Add the kept columns, each by its factor, to `step`, and F times them to `shift`."""
    for k in range(factors.size):
        if factors[k] != 0.0:
            at = anchor.slot[changed[k // 3]]
            step += factors[k] * anchor.columns[at, k % 3]
            shift += factors[k] * anchor.moved[at, k % 3]


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
    compliance: Array,
    columns: Array,
    laws: Array,
    free_gap: Array,
    slip: Array,
    tolerance: float,
    anchor: Anchor,
    gap: Array,
    value: Array,
    moved: Array,
    tangent: Array,
) -> tuple[bool, float, int]:
    """Iterate from `gap`, in place: whether it is solved, the residual and the iterations.

    Arguments as in `fesim.joint.compiled_gap.solve_in_place`; `columns` is F transposed. What is
    accepted has a residual g - J0^-1 g_T - F (z(g) + k0 g) within the tolerance.
    """
    unknowns, flat = springs.size, gap.reshape(-1)
    force, lack = np.zeros(unknowns), np.empty(unknowns)
    step, shift = np.empty(unknowns), np.empty(unknowns)
    evaluate_in_place(laws, gap, slip, value, moved, tangent)
    _lack(springs, gap, value, np.zeros(unknowns), force)
    flat[:] = free_gap
    _add_product(columns, force, flat)
    anchors, before, corrected, least = 0, math.inf, math.inf, 0.1 * LEFT * tolerance
    for iteration in range(MAX_ITERATIONS):
        evaluate_in_place(laws, gap, slip, value, moved, tangent)
        size = _lack(springs, gap, value, force, lack)
        if size == math.inf:
            return False, size, iteration
        left = corrected * size <= LEFT * tolerance * before if iteration > 0 else False
        if left or size <= least:
            shift[:] = 0.0
            _add_product(columns, lack, shift)
            residual = largest(shift)
            if residual <= tolerance and np.spacing(largest(gap)) <= tolerance:
                if iteration > PATIENCE:
                    anchor.about[MADE] = 0
                return True, residual, iteration
        good = anchor.about[MADE] == 1 and size <= SLOW * before
        if not good or not _correct(anchor, springs, columns, tangent, lack, least, step, shift):
            if anchors == MAX_ANCHORS:
                return False, size, iteration
            anchors += 1
            anchor.tangent[:] = tangent
            make_anchor(anchor, springs, compliance)
            if not _correct(anchor, springs, columns, tangent, lack, least, step, shift):
                return False, size, iteration
        force += step
        flat += shift
        before, corrected = size, largest(shift)
    return False, before, MAX_ITERATIONS
