"""JIT-compiled heat step of pads that pass several places: `fesim.march.passing` for axes.

The temperatures of the touched rows solve (I + S L) T = w + S f, with w those without heat of the
rows and f the frictional heat; q = L T is the heat they lose. Each axis has its own pads and
stations, and a step transfers hardly any heat from one guide to another: the part of each axis is
factorised alone, and the influence of the others is added by iteration. If that does not converge,
the whole is one part.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.axes.compiled_occupation import add_shares
from fesim.axes.compiled_rows import add_row, add_rows, multiply
from fesim.axes.guideway import GuideStations
from fesim.axes.row_blocks import BodyRows, RowBlocks, row_blocks
from fesim.jit import compiled_part
from fesim.joint.compiled_gap import largest
from fesim.joint.frozen_tangent import add_product
from fesim.joint.in_place import fill
from fesim.joint.linear_system import factorise_columns, solve_again
from thermojoint.artefacts.arrays import Array, Flags

#: Limits of the iteration's error: in a step, relative to the warmest row; in a repetition that
#: only serves for the gain, relative to its initial error. Most iterations.
LEFT, ROUGHLY, MOST = 1e-10, 1e-2, 40
#: An iteration whose error, at the rate of the one before, is below this fraction of the limit is
#: the last one.
SURELY = 0.1


class Guides(NamedTuple):
    """Rows that m contact elements touch along a axes; p aligned positions of all axes together."""

    #: Shapes (p,) and (a + 1,): aligned positions, m, one axis after the other, and start of each
    #: axis.
    positions: Array
    first: NDArray[np.int64]
    #: Shape (p, m): row of the station under each contact element; undefined for those on another
    #: axis or on none.
    place: NDArray[np.int64]
    #: Shapes (m,) and (a + 2,): contact elements, grouped by axis, then those on no axis, and start
    #: of each of these groups.
    riding: NDArray[np.int64]
    group: NDArray[np.int64]
    #: Of q rows, twice, and of shape (q, q), once whole and once as rows: as in
    #: `fesim.march.passing.Rows`.
    temperature: RowBlocks
    influence: RowBlocks
    joint_influence: Array
    between: RowBlocks


class Ways(NamedTuple):
    """Travel of a axes in n steps, with t times between which it is uniform."""

    #: Shapes (t,): times, s, and positions, m.
    times: Array
    positions: Array
    #: Shape (a, n + 1): index of the start of each step among these; last, the end.
    start: NDArray[np.int64]
    #: Shape (a, n): travel of an axis in excess of that, to and fro, m.
    more: Array


class Passed(NamedTuple):
    """Contacts in a step, and work arrays; written in place."""

    #: Shapes (p,): shares of the aligned positions, as in `fesim.axes.occupation.Shares`.
    mean: Array
    square: Array
    both: Array
    #: Shape (a, 2): index of the first touched aligned position, and that after the last.
    reached: NDArray[np.int64]
    #: Shape (a,): travel, m.
    length: Array
    #: Shapes (q,) and (a + 2,): touched rows, group by group, and start of each group.
    rows: NDArray[np.int64]
    begin: NDArray[np.int64]
    #: Shapes (q,): index of a row among these, and whether it is touched.
    local: NDArray[np.int64]
    touched: Flags
    #: Shapes (q q,) and (q,): factors of I + L S of the groups, and their pivots.
    system: Array
    pivots: NDArray[np.int32]
    #: Shape (q,): frictional heat that enters the rows, W; their temperatures without and with the
    #: heat of the rows, K; heat lost by the exchange, and net heat that enters, W; work arrays.
    rubbed: Array
    warm: Array
    found: Array
    leaving: Array
    entering: Array
    net: Array
    lack: Array
    #: Shapes (q q,): S and L of some rows.
    near: Array
    passes: Array


def guides_of(stations: GuideStations, rows: BodyRows, joint_influence: Array) -> Guides:
    """Return the rows of a machine for compiled steps; `joint_influence` as in `Guides`."""
    count, groups = stations.count, stations.groups
    return Guides(
        np.concatenate(stations.positions),
        np.cumsum([0, *(one.size for one in stations.positions)]),
        np.ascontiguousarray(np.vstack(stations.place) + count),
        np.concatenate(groups),
        np.cumsum([0, *(one.size for one in groups)]),
        rows.temperature,
        rows.influence,
        np.ascontiguousarray(joint_influence),
        row_blocks(joint_influence),
    )


def new_passed(guides: Guides) -> Passed:
    """Return work arrays."""
    count, axes, size = guides.positions.size, guides.first.size - 1, len(guides.joint_influence)
    shares: list[Any] = [np.zeros(count) for _ in range(3)]
    whole = size * size
    of_rows: list[Any] = [np.zeros(size) for _ in range(7)]
    touched: list[Any] = [np.zeros(n, dtype=np.int64) for n in (size, axes + 2, size)]
    touched.append(np.zeros(size, dtype=np.bool_))
    factors: list[Any] = [np.zeros(whole), np.zeros(size, dtype=np.int32)]
    more: list[Any] = [*of_rows, np.zeros(whole), np.zeros(whole)]
    ways: list[Any] = [np.zeros((axes, 2), dtype=np.int64), np.zeros(axes)]
    return Passed(*shares, *ways, *touched, *factors, *more)


@compiled_part
def go(guides: Guides, ways: Ways, step: int, passed: Passed) -> None:
    """Compute the contacts of a step: shares, travel and touched rows."""
    fill(passed.mean, 0.0)
    fill(passed.square, 0.0)
    fill(passed.both, 0.0)
    fill(passed.touched, 0.0)
    size = 0
    for group in range(guides.group.size - 1):
        passed.begin[group] = size
        riding = guides.riding[guides.group[group] : guides.group[group + 1]]
        for e in riding:
            passed.rows[size], passed.local[e], passed.touched[e] = e, size, True
            size += 1
        if group == guides.first.size - 1:
            continue
        low, high = _go_along(guides, ways, step, group, passed)
        for k in range(low, high):
            for e in riding:
                at = guides.place[k, e]
                if not passed.touched[at]:
                    passed.rows[size], passed.local[at], passed.touched[at] = at, size, True
                    size += 1
    passed.begin[guides.group.size - 1] = size


@compiled_part
def _go_along(guides: Guides, ways: Ways, step: int, axis: int, passed: Passed) -> tuple[int, int]:
    """Compute shares and travel of an axis; return the range of positions that it touches."""
    low, high = guides.first[axis], guides.first[axis + 1]
    positions = guides.positions[low:high]
    mean, square, both = passed.mean[low:high], passed.square[low:high], passed.both[low:high]
    begin, end = ways.start[axis, step], ways.start[axis, step + 1]
    whole, length = ways.times[end] - ways.times[begin], ways.more[axis, step]
    for k in range(begin, end):
        way = ways.positions[k], ways.positions[k + 1]
        part = (ways.times[k + 1] - ways.times[k]) / whole
        add_shares(positions, way, part, mean, square, both)
        length += abs(way[1] - way[0])
    passed.length[axis] = length
    while passed.mean[low] == 0.0:
        low += 1
    while passed.mean[high - 1] == 0.0:
        high -= 1
    passed.reached[axis, 0], passed.reached[axis, 1] = low, high
    return low, high


@compiled_part
def rub(guides: Guides, passed: Passed, heat: Array) -> None:
    """Frictional heat of each row, W, from (m,) contact elements: one half enters each side."""
    fill(passed.rubbed, 0.0)
    for axis in range(guides.first.size - 1):
        for e in guides.riding[guides.group[axis] : guides.group[axis + 1]]:
            half = 0.5 * heat[e]
            passed.rubbed[e] += half
            for k in range(passed.reached[axis, 0], passed.reached[axis, 1]):
                passed.rubbed[guides.place[k, e]] += half * passed.mean[k]


@compiled_part
def _leave(guides: Guides, passed: Passed, conducted: Array) -> None:
    """Compute q = L T, and the net heat of the rows with friction."""
    found, leaving, last = passed.found, passed.leaving, guides.first.size - 1
    # Read once: each access to a named tuple's array changes its reference count.
    place, means, squares, boths = guides.place, passed.mean, passed.square, passed.both
    riding, groups, reached = guides.riding, guides.group, passed.reached
    fill(leaving, 0.0)
    for group in range(last + 1):
        for r in range(groups[group], groups[group + 1]):
            e = riding[r]
            own, each = found[e], conducted[e]
            given = each * own
            if group < last:
                low, high = reached[group, 0], reached[group, 1]
                for k in range(low, high):
                    at, mean = place[k, e], each * means[k]
                    given -= mean * found[at]
                    leaving[at] += each * squares[k] * found[at] - mean * own
                    if k + 1 < high:
                        above, both = place[k + 1, e], each * boths[k]
                        leaving[at] += both * found[above]
                        leaving[above] += both * found[at]
            leaving[e] += given
    for row in range(leaving.size):
        passed.entering[row] = passed.rubbed[row] - leaving[row]


@compiled_part
def _factorise(guides: Guides, passed: Passed, conducted: Array, first: int, after: int) -> None:
    """Solve some groups of rows alone, and keep the factors."""
    begin, end = passed.begin[first], passed.begin[after]
    system, near, found = _part(passed, begin, end)
    rows, influence, warm = passed.rows[begin:end], guides.joint_influence, passed.warm
    place, means, squares, boths = guides.place, passed.mean, passed.square, passed.both
    riding, groups, reached, local = guides.riding, guides.group, passed.reached, passed.local
    size, last = end - begin, guides.first.size - 1
    passes = passed.passes[: size * size].reshape(size, size)
    fill(passes, 0.0)
    for group in range(first, after):
        for r in range(groups[group], groups[group + 1]):
            e = riding[r]
            own, each = local[e] - begin, conducted[e]
            passes[own, own] += each
            if group == last:
                continue
            low, high = reached[group, 0], reached[group, 1]
            for k in range(low, high):
                at, mean = local[place[k, e]] - begin, each * means[k]
                passes[own, at] -= mean
                passes[at, own] -= mean
                passes[at, at] += each * squares[k]
                if k + 1 < high:
                    above, both = local[place[k + 1, e]] - begin, each * boths[k]
                    passes[at, above] += both
                    passes[above, at] += both
    for i in range(size):
        found[i] = warm[rows[i]]
        every, into = influence[rows[i]], near[i]
        for j in range(size):
            into[j] = every[rows[j]]
    for i in range(size):
        if passed.rubbed[rows[i]] != 0.0:
            add_row(passed.rubbed[rows[i]], near[i], found)
    fill(system, 0.0)
    for i in range(size):
        add_product(near, passes[i], system[i])
        system[i, i] += 1.0
    # In row order, I + L S is I + S L in column order: both are symmetric.
    factorise_columns(system, passed.pivots[begin:end], found)
    for i in range(size):
        passed.found[rows[i]] = found[i]


@compiled_part
def _part(passed: Passed, begin: int, end: int) -> tuple[Array, Array, Array]:
    """Work arrays for the factors of some rows, their S, and a right side."""
    size, total = end - begin, passed.begin[passed.begin.size - 1]
    at = begin * total
    system = passed.system[at : at + size * size].reshape(size, size)
    return system, passed.near[: size * size].reshape(size, size), passed.lack[begin:end]


@compiled_part
def _refine(guides: Guides, passed: Passed, conducted: Array, groups: int, again: bool) -> bool:
    """Whether iterations with the factors of `groups` parts of the rows converge to T and q."""
    rows, begin = passed.rows, passed.begin
    total = begin[begin.size - 1]
    before, enough = 0.0, LEFT * largest(passed.warm)
    for i in range(total):
        # Effect of the heat of the rows; the influence that the factors omit is part of it.
        before = max(before, abs(passed.found[rows[i]] - passed.warm[rows[i]]))
    for iteration in range(MOST):
        _leave(guides, passed, conducted)
        multiply(guides.between, passed.touched, passed.entering, passed.net)
        left = 0.0
        for i in range(total):
            at = rows[i]
            passed.lack[i] = passed.warm[at] + passed.net[at] - passed.found[at]
            left = max(left, abs(passed.lack[i]))
        if again and iteration == 0:
            enough, before = max(enough, ROUGHLY * left), np.inf
        if left <= enough:
            return True
        if not left <= before:
            return False
        for group in range(groups):
            ends = (begin[group], begin[group + 1]) if groups > 1 else (0, total)
            system, _, found = _part(passed, ends[0], ends[1])
            solve_again(system, passed.pivots[ends[0] : ends[1]], found)
        for i in range(total):
            passed.found[rows[i]] += passed.lack[i]
        if before < np.inf and left * left <= SURELY * enough * before:
            _leave(guides, passed, conducted)
            return True
        before = left
    return False


@compiled_part
def exchange(guides: Guides, passed: Passed, conducted: Array, again: bool) -> bool:
    """Solve for T and q, without new factors if `again`; return success.

    Parameters
    ----------
    guides : Guides
        The rows.
    passed : Passed
        Contacts of the step, and w.
    conducted : ndarray, shape (m,)
        Conductance times area of the contact elements, W/K.
    again : bool
        Whether `passed` contains factors and T for other conductances in the same step.
    """
    groups = passed.begin.size - 1
    if not again:
        for group in range(groups):
            _factorise(guides, passed, conducted, group, group + 1)
    if _refine(guides, passed, conducted, groups, again):
        return True
    _factorise(guides, passed, conducted, 0, groups)
    return _refine(guides, passed, conducted, 1, again)


@compiled_part
def enter(guides: Guides, passed: Passed, amplitudes: Array) -> None:
    """Add the effect of friction and exchange to amplitudes (r,) without them."""
    add_rows(guides.influence, passed.touched, passed.entering, amplitudes)


@compiled_part
def warm(guides: Guides, passed: Passed, amplitudes: Array) -> None:
    """Compute temperatures of the rows without their heat from amplitudes (r,)."""
    fill(passed.warm, 0.0)
    multiply(guides.temperature, passed.touched, amplitudes, passed.warm)
