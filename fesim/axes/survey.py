"""Equilibria of joints at many places in one thermal state, in one JIT-compiled sweep.

The gap equations g = g_T + C A [z(g) + k g] at a place have C, g_T and the rows of the probes
interpolated there, as in `fesim.axes.guideway`. The places differ little, so Newton's method
factorises its Jacobian, in single precision, once for many of them (a chord method), and starts
from the gaps of earlier places: without the unrestrained rows, a place costs the interpolation and
some products of that size. It is factorised again when convergence becomes slow.

`survey` is an alternative to `fesim.march.settling.settle_along`, which finds the same equilibria
one by one and takes over if this does not converge; `tests/fesim/axes/test_survey.py` compares
both.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.axes.corner_table import CornerTable, CornerTables
from fesim.jit import compiled, compiled_part
from fesim.joint.compiled_gap import Trial, evaluate_in_place, lacking, largest
from fesim.joint.gap import SHORTEST_STEP
from fesim.joint.in_place import fill, put
from fesim.joint.linear_system import factorise_single, solve_again
from fesim.march.contact import ContactProblem
from thermojoint.artefacts.arrays import Array

#: Most iterations at a place, and most factorisations of its Jacobian.
MAX_ITERATIONS, MOST_MOVES = 60, 10
#: If an iteration leaves more than this fraction, it is repeated with a new Jacobian.
SLOW = 0.5
#: If more iterations than this are expected at the present rate, a new factorisation is cheaper.
WORTH = 2.0
#: Residual of an accepted state, relative to the tolerance, as `fesim.joint.modified_newton`.
LEFT = 0.01
#: A residual below this fraction of that is accepted at any correction: if only sliding friction
#: holds a body, picometres along its path are below rounding.
SLIDES = 1e-3
#: No part of the first correction may be left. Named, since literals are compiled separately.
EXACT = 0.0
#: Number of earlier places among which near ones are looked for.
BACK = 512


class Pads(NamedTuple):
    """The joints: m contact elements with h restrained rows."""

    #: Shape (h,): index of these rows among the 3 m gaps.
    held: NDArray[np.int64]
    #: Shape (j + 1,): start of those of each group of contact elements.
    begin: NDArray[np.int64]
    #: Shape (m, 7): as in `fesim.joint.compiled_gap.CompiledGap`.
    laws: Array
    #: Shape (2, m): irreversible slip before, m.
    slip: Array
    #: Shape (3 m,): k of the condensation, Pa/m, and areas, m2.
    springs: Array
    area: Array
    #: Largest residual accepted, m.
    tolerance: float


def pads_of(tables: CornerTables, contact: ContactProblem, laws: Array, slip: Array) -> Pads:
    """Return the joints of a machine whose combinations are in `tables`; others as in `Pads`."""
    elastic = contact.elastic
    own = elastic.reference, elastic.area, contact.tolerance
    return Pads(tables.held, tables.begin, laws, slip, *own)


class Survey(NamedTuple):
    """Results at n places, written in place."""

    #: Shape (n, p): displacement probes, m.
    displacement: Array
    #: Shape (n,): largest error of the gaps, from Newton's correction, m; NaN without convergence.
    residual: Array
    #: Shape (n, h): gaps, m.
    gap: Array


@compiled_part
def unpacked(packed: Array, into: Array) -> None:
    """Unpack C (h, h) from its upper triangle."""
    size, at = into.shape[0], 0
    for i in range(size):
        row, own = into[i], packed[at : at + size - i]
        for j in range(own.size):
            row[i + j] = own[j]
        at += size - i
    # Separate from the rows above, which are copied in storage order.
    for i in range(size):
        row = into[i]
        for j in range(i):
            row[j] = into[j, i]


@compiled
def grown(table: CornerTable, pads: Pads, alone: Array, free: Array) -> None:
    """Write thermal gaps, then probes, without contact into `free` (k, h + p).

    Parameters
    ----------
    table : CornerTable
        The combinations.
    pads : Pads
        The joints.
    alone : ndarray, shape (3 m + 3 n + a + p,)
        Untied thermal displacements of pads, stations, anchors and probes.
    free : ndarray, shape (k, h + p)
        Output.
    """
    count, held = pads.laws.shape[0], pads.held
    size, probes, anchors = held.size, table.probes.shape[1], table.anchored.shape[2]
    stations = (alone.size - 3 * count - anchors - probes) // 3
    untied, pulled, drawn = np.empty(size), np.empty(size), np.empty(size)
    whole = np.empty((size, size))
    for k in range(table.place.shape[0]):
        for i in range(size):
            direction, e = divmod(held[i], count)
            untied[i] = alone[held[i]]
            if table.place[k, e] >= 0:
                untied[i] += alone[3 * count + direction * stations + table.place[k, e]]
            pulled[i] = pads.area[held[i]] * pads.springs[held[i]] * untied[i]
        unpacked(table.compliance[k], whole)
        np.dot(whole, pulled, drawn)
        for i in range(size):
            free[k, i] = untied[i] - drawn[i]
        for i in range(probes):
            total = alone[alone.size - probes + i]
            for j in range(size):
                total -= table.probes[k, i, j] * pulled[j]
            free[k, size + i] = total
        for i in range(size + probes):
            for j in range(anchors):
                free[k, i] += table.anchored[k, i, j] * alone[3 * (count + stations) + j]


@compiled_part
def mixed(parts: Array, touched: NDArray[np.int64], weight: Array, into: Array) -> None:
    """Write the weighted sum of the touched rows of (k, n) into (n,)."""
    first = True
    for c in range(touched.size):
        if weight[c] == 0.0:
            continue
        row, share = parts[touched[c]], weight[c]
        if first:
            for i in range(into.size):
                into[i] = share * row[i]
        else:
            for i in range(into.size):
                into[i] += share * row[i]
        first = False


@compiled_part
def _jacobian(pads: Pads, here: Here, ends: tuple[int, int], columns: NDArray[np.float32]) -> None:
    """Write 1 - C A (T + k) of some restrained rows, in column order."""
    count, held, compliance = pads.laws.shape[0], pads.held, here.compliance
    first, last = ends
    where = np.full(3 * count, -1)
    for j in range(first, last):
        where[held[j]] = j
    for j in range(first, last):
        part, e = divmod(held[j], count)
        into = columns[j - first]
        fill(into, 0.0)
        for row in range(3):
            i = where[row * count + e]
            entry = lacking(pads.springs, here.trial.tangent, row * count + e)[part]
            if i < 0 or entry == 0.0:
                continue
            entry *= pads.area[held[j]]
            own = compliance[i, first:last]  # C is symmetric.
            for k in range(own.size):
                into[k] -= entry * own[k]
        into[j - first] += 1.0


@compiled_part
def _guess(places: Array, found: Survey, at: int, into: Array) -> None:
    """Extrapolate gaps from earlier places, if there are any, into (h,)."""
    first, least = -1, math.inf
    for other in range(max(0, at - BACK), at):
        if math.isnan(found.residual[other]):
            continue
        away = 0.0
        for a in range(places.shape[1]):
            away += (places[at, a] - places[other, a]) ** 2
        if away <= least:
            first, least = other, away
    if first < 0:
        return
    second, nearest = -1, 0.01 * least
    for other in range(max(0, at - BACK), at):
        if math.isnan(found.residual[other]):
            continue
        away = 0.0
        for a in range(places.shape[1]):
            away += (2.0 * places[first, a] - places[at, a] - places[other, a]) ** 2
        if away < nearest:
            second, nearest = other, away
    for i in range(into.size):
        into[i] = found.gap[first, i]
        if second >= 0:
            into[i] += found.gap[first, i] - found.gap[second, i]


class Here(NamedTuple):
    """The gap equations at one place, and work arrays."""

    #: Shape (h, h): C, m/N.
    compliance: Array
    #: Shape (h + p,): g_T, m, then the probes without contact, m.
    free: Array
    #: Shapes (h h,) and (h,): factors of the Jacobian there or nearby, and their pivots; (h,):
    #: right side and solution with them; (1,): number of parts in which they are factorised.
    factors: NDArray[np.float32]
    pivots: NDArray[np.int32]
    solved: NDArray[np.float32]
    parts: NDArray[np.int64]
    #: Shape (h,): g, m; A (z + k g), N; g - g_T - C A (z + k g), m; Newton's correction, m; g and
    #: correction before a step.
    gap: Array
    force: Array
    residual: Array
    correction: Array
    before: Array
    step: Array
    #: All gaps.
    trial: Trial


@compiled_part
def _corrected(pads: Pads, here: Here, anew: int) -> tuple[float, float]:
    """Newton's correction at the gaps, with a Jacobian factorised in `anew` parts, or a stored one.

    Returns its largest entry, and the norm of the residual, m.
    """
    flat, value, held = here.trial.gap.reshape(-1), here.trial.value.reshape(-1), pads.held
    for i in range(held.size):
        flat[held[i]] = here.gap[i]
    evaluate_in_place(pads.laws, pads.slip, here.trial)
    for i in range(held.size):
        at = held[i]
        here.force[i] = pads.area[at] * (value[at] + pads.springs[at] * here.gap[i])
    np.dot(here.compliance, here.force, here.residual)
    for i in range(held.size):
        here.residual[i] = here.gap[i] - here.free[i] - here.residual[i]
        here.solved[i] = here.residual[i]
    if anew > 0:
        here.parts[0] = anew
    at = 0
    for part in range(here.parts[0]):
        first, last = pads.begin[part], pads.begin[part + 1]
        if here.parts[0] == 1:
            last = held.size
        size = last - first
        columns = here.factors[at : at + size * size].reshape(size, size)
        pivots, solved = here.pivots[first:last], here.solved[first:last]
        if anew > 0:
            _jacobian(pads, here, (first, last), columns)
            factorise_single(columns, pivots, solved)
        else:
            solve_again(columns, pivots, solved)
        at += size * size
    for i in range(held.size):
        here.correction[i] = here.solved[i]
    return largest(here.correction), math.sqrt(here.residual @ here.residual)


@compiled_part
def _iterations_left(before: float, after: float, enough: float) -> float:
    """Number of further iterations until `enough` is left, at the present rate."""
    if after <= enough or after >= before:
        return 0.0
    return math.log(enough / after) / math.log(after / before)


@compiled_part
def settle_here(pads: Pads, here: Here, made: bool, share: float) -> tuple[float, int]:
    """Settle from the gaps, with stored factors if `made`: error left, m, or NaN; iterations.

    A fraction `share` of the first correction may be left. The factors are computed again if many
    more iterations would follow, or if a step leaves too much; as a whole if factors in parts do
    not suffice. Then the step is shortened until the residual falls, as in
    `fesim.joint.gap.solve_gap`. At a kink of the law no length may suffice, and a full step is
    taken.
    """
    kept, groups = 0, pads.begin.size - 1
    (left, norm), moves, fresh = _corrected(pads, here, kept if made else groups), 0, not made
    enough = max(LEFT * pads.tolerance, share * left)
    for iteration in range(MAX_ITERATIONS):
        if left <= enough or norm <= SLIDES * LEFT * pads.tolerance:
            return left, iteration
        put(here.gap, here.before)
        put(here.correction, here.step)
        length = 1.0
        while True:
            for i in range(here.gap.size):
                here.gap[i] = here.before[i] - length * here.step[i]
            after, rest = _corrected(pads, here, kept)
            # Factors in parts omit the coupling between groups of contact elements.
            apart = fresh and here.parts[0] > 1
            newton = fresh and not apart
            falls = rest <= (1.0 - 1e-4 * length) * norm if newton else after <= SLOW * left
            if falls:
                old = (
                    not fresh
                    and moves < MOST_MOVES
                    and _iterations_left(left, after, enough) > WORTH
                )
                left, norm, fresh = after, rest, old
                if old:
                    (left, norm), moves = _corrected(pads, here, groups), moves + 1
                break
            length /= 2.0
            if newton and length >= SHORTEST_STEP:
                continue
            if moves == MOST_MOVES:
                return math.nan, iteration
            for i in range(here.gap.size):
                here.gap[i] = here.before[i] - (here.step[i] if newton else 0.0)
            if apart:
                groups = 1
            (left, norm), moves, fresh = _corrected(pads, here, groups), moves + 1, True
            break
    return math.nan, MAX_ITERATIONS


@compiled_part
def probe(here: Here, moved: Array, into: Array) -> None:
    """Displacement of the probes (p,), from that per joint force (p h,)."""
    size = here.gap.size
    for i in range(into.size):
        total = here.free[size + i]
        for j in range(size):
            total += moved[i * size + j] * here.force[j]
        into[i] = total


def new_here(held: NDArray[np.int64], probes: int, trial: Trial) -> Here:
    """Return work arrays for the restrained rows (h,) and p probes, at the gaps of a trial."""
    size, single = held.size, np.float32
    storage: list[Any] = [np.zeros((size, size)), np.zeros(size + probes)]
    storage += [np.zeros(size * size, single), np.zeros(size, np.int32), np.zeros(size, single)]
    storage.append(np.zeros(1, np.int64))
    storage += [trial.gap.reshape(-1)[held], *(np.zeros(size) for _ in range(5)), trial]
    return Here(*storage)


@compiled
def settle_all(
    table: CornerTable,
    pads: Pads,
    free: Array,
    around: tuple[Array, NDArray[np.int64], Array],
    here: Here,
    found: Survey,
) -> None:
    """Settle at one place after the other, into `found`.

    Parameters
    ----------
    table : CornerTable
        The combinations.
    pads : Pads
        The joints.
    free : ndarray, shape (k, h + p)
        Result of `grown`.
    around : tuple of ndarray
        Places (n, axes), m, index of the combinations around each (n, c), and their weights (n, c).
    here : Here
        Work arrays, with the gaps at the positions of the axes.
    found : Survey
        Output; its residuals are NaN on entry.
    """
    places, touched, weights = around
    size, probes = pads.held.size, table.probes.shape[1]
    packed, moved = np.empty(table.compliance.shape[1]), np.empty(probes * size)
    by_probe, made = table.probes.reshape(-1, probes * size), False
    origin = here.gap.copy()
    fill(here.trial.gap, 0.0)
    for at in range(places.shape[0]):
        mixed(table.compliance, touched[at], weights[at], packed)
        mixed(free, touched[at], weights[at], here.free)
        unpacked(packed, here.compliance)
        _guess(places, found, at, here.gap)
        found.residual[at], _ = settle_here(pads, here, made, EXACT)
        if math.isnan(found.residual[at]):
            put(origin, here.gap)
            found.residual[at], _ = settle_here(pads, here, False, EXACT)
        made = not math.isnan(found.residual[at])
        mixed(by_probe, touched[at], weights[at], moved)
        for i in range(size):
            found.gap[at, i] = here.gap[i]
        probe(here, moved, found.displacement[at])
