"""JIT-compiled march of a machine on one axis: the plain steps of `physics`, one after the other.

A step solves for the heat that leaves pads and stations beyond the part that the modes include,
then the gap equations with the elasticity interpolated between two aligned positions. Their springs
are those of the condensation, with none in the shear of contact elements without friction, which
therefore have no unknown. Springs of the joint at its preload, as in `fesim.joint.gap`, would have
no other advantage.

Start at `march_along`; `tests/thermojoint/reduced/test_guided_march.py` compares it with the plain
steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.axes.compiled_occupation import add_shares, place_of
from fesim.axes.guideway import Guideway
from fesim.jit import compiled, compiled_part
from fesim.joint.blocks import one_block
from fesim.joint.frozen_tangent import forget
from fesim.joint.in_place import fill, put
from fesim.joint.linear_system import solve
from fesim.joint.loosening import UNWATCHED
from fesim.march.compiled_march import Kept, MarchKernel, settle
from fesim.march.compiled_step import (
    HeatStep,
    JointKernel,
    JointState,
    JointWork,
    conduct,
    displace,
    drive,
    settle_by_newton,
    take,
)
from fesim.march.contact import Laws
from fesim.march.kernel import new_kept, owned
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.axes_march import Record


class Aligned(NamedTuple):
    """Elasticity at k aligned positions; rows as in `ElasticCondensation`."""

    #: Shape (k,): evenly spaced, ascending, m.
    positions: Array
    #: Shape (k, m): row of the station under each contact element; -1 for none.
    place: NDArray[np.int64]
    #: Shape (k, 3 m, 3 m): C A: gap per traction, m/Pa.
    compliance: Array
    #: Shape (k, 3 m, r): S_T, m/K.
    gap: Array
    #: Shape (k, axes, 3 m): D_C A, m/Pa.
    moved: Array
    #: Shape (k, axes, r): D_T, m/K.
    free: Array
    #: Shapes (s,) and (3 m - s,): gaps whose traction is always zero, and the others.
    smooth: NDArray[np.int64]
    rough: NDArray[np.int64]
    #: Shape (3 m,): springs of the condensation, Pa/m.
    reference: Array


class Guided(NamedTuple):
    """Data of a march along an axis, with steps of one length."""

    #: Its influences are those of the guideway's q rows.
    heat: HeatStep
    #: Shape (q, r): R, K.
    rows: Array
    #: Shape (q, q): L0, W/K, which the modes include, and I - L0 S.
    held: Array
    without: Array
    #: Shape (m,): heat of running friction per pressure and metre of travel in a step, W/(Pa m).
    running: Array
    #: Elasticity.
    aligned: Aligned


class There(NamedTuple):
    """Elasticity at the position of the axis; written in place."""

    #: Its compliance, `columns`, `moved` and `free` are those there; its `gap` is not used.
    joint: JointKernel
    #: Shape (k,): of the aligned positions.
    weights: Array
    #: Shape (s, s): smooth gaps without springs, per those with the condensation's.
    freed: Array
    #: Shape (3 m - s, s): effect of the smooth gaps' springs on the others, per gap.
    coupled: Array
    #: Shapes (3 m,), (2, s) and (3 m - s,): storage of gaps, m.
    partly: Array
    apart: Array
    others: Array
    #: Shape (axes,): with the joint in equilibrium there, m.
    displacement: Array


class Passed(NamedTuple):
    """Storage of the heat step; its content is not used afterwards."""

    #: Shapes (k,), (k,) and (k - 1,): shares of a way, as in `fesim.axes.occupation`.
    mean: Array
    square: Array
    product: Array
    #: Shape (m,): conductance times area, W/K.
    conducted: Array
    #: Shape (q,): heat of friction, W, the rows without joints, K, and what they would exchange, W.
    rubbed: Array
    warm: Array
    right: Array
    #: Shape (q, q): I + (L - L0) S.
    system: Array
    #: Shape (r,): amplitudes due to heat of the rows.
    drawn: Array


class Steps(NamedTuple):
    """Storage of a march."""

    #: Of the joints.
    kept: Kept
    #: At the end of a step.
    there: There
    #: In a step.
    passed: Passed


class Guiding(NamedTuple):
    """State between two steps, updated in place: amplitudes (r,), K, and the joint."""

    amplitudes: Array
    joint: JointState


def aligned_elasticity(way: Guideway, laws: Laws) -> Aligned:
    """Return the elasticity of a guideway with one axis, of joints with these laws."""
    (positions,), (place,) = way.stations.positions, way.stations.place
    each = [way.elastic_at((at,)) for at in positions.tolist()]
    slides = np.concatenate([np.full(n, law.friction.coefficient <= 0.0) for law, n in laws])
    smooth = np.concatenate([np.zeros(slides.size, dtype=bool), slides, slides])
    return Aligned(
        owned(positions),
        np.ascontiguousarray(np.where(place < 0, -1, place + way.stations.count)),
        owned(np.array([one.compliance * one.area for one in each])),
        owned(np.array([one.thermal_gap for one in each])),
        owned(np.array([one.probe_compliance * one.area for one in each])),
        owned(np.array([one.probe_thermal for one in each])),
        np.flatnonzero(smooth),
        np.flatnonzero(~smooth),
        owned(way.first.reference),
    )


def guided(heat: HeatStep, way: Guideway, held: Array, aligned: Aligned, length: float) -> Guided:
    """Return the data of a march.

    Parameters
    ----------
    heat : HeatStep
        Of its steps.
    way : Guideway
        On the modes.
    held : ndarray, shape (q, q)
        L0, W/K.
    aligned : Aligned
        Of the guideway.
    length : float
        Of a step, s.
    """
    without = np.eye(len(held)) - held @ heat.joint_influence
    return Guided(heat, owned(way.temperature), held, without, way.running / length, aligned)


def there_of(aligned: Aligned, joint: JointKernel) -> There:
    """Return storage for the joint of a machine."""
    _, axes, modes = aligned.free.shape
    stops, size = aligned.positions.size, aligned.reference.size
    smooth, rough = aligned.smooth.size, aligned.rough.size
    springs = aligned.reference.copy()
    springs[aligned.smooth] = 0.0
    now = joint._replace(
        springs=springs,
        compliance=np.empty((size, size)),
        columns=np.empty((size, size)),
        gap=np.empty((0, 0)),
        moved=np.empty((axes, size)),
        free=np.empty((axes, modes)),
    )
    shapes = [stops, (smooth, smooth), (rough, smooth), size, (2, smooth), rough, axes]
    return There(now, *map(np.empty, shapes))


def new_steps(guide: Guided, there: There) -> Steps:
    """Return storage for a march."""
    joint, (rows, modes) = there.joint, guide.rows.shape
    stops, count = there.weights.size, joint.preload.size
    blocks = one_block(joint.springs, joint.compliance, joint.columns)
    sizes = [stops, stops, stops - 1, count, rows, rows, rows]
    storage = [*map(np.empty, sizes), np.empty((rows, rows)), np.empty(modes)]
    passed = Passed(*storage)
    return Steps(new_kept(MarchKernel(guide.heat, joint, UNWATCHED), blocks), there, passed)


@compiled
def occupy(positions: Array, start: float, end: float, passed: Passed) -> None:
    """Set the shares of a uniform way, as `fesim.axes.occupation.even`."""
    fill(passed.mean, 0.0)
    fill(passed.square, 0.0)
    fill(passed.product, 0.0)
    add_shares(positions, (start, end), 1.0, passed.mean, passed.square, passed.product)


@compiled_part
def _mix(weights: Array, each: Array, into: Array) -> None:
    """The mean of arrays (k, a, b) with weights (k,), into one (a, b)."""
    fill(into, 0.0)
    for k in range(weights.size):
        if weights[k] != 0.0:
            for i in range(into.shape[0]):
                for j in range(into.shape[1]):
                    into[i, j] += weights[k] * each[k, i, j]


@compiled_part
def _stand(aligned: Aligned, there: There, at: float) -> None:
    """Set the elasticity at a position, m."""
    place = place_of(aligned.positions, at)
    below = min(math.floor(place), aligned.positions.size - 2)
    fill(there.weights, 0.0)
    there.weights[below], there.weights[below + 1] = below + 1.0 - place, place - below
    _mix(there.weights, aligned.compliance, there.joint.compliance)
    _mix(there.weights, aligned.moved, there.joint.moved)
    _mix(there.weights, aligned.free, there.joint.free)
    if aligned.smooth.size:
        _free_smooth(aligned, there)
    for i in range(aligned.reference.size):
        for j in range(aligned.reference.size):
            there.joint.columns[j, i] = there.joint.compliance[i, j]


@compiled_part
def _free_smooth(aligned: Aligned, there: There) -> None:
    """Remove the springs of smooth gaps, as `fesim.joint.gap` does with others."""
    compliance, springs = there.joint.compliance, aligned.reference
    smooth, rough, coupled = aligned.smooth, aligned.rough, there.coupled
    system, across = np.empty((smooth.size, smooth.size)), np.empty((smooth.size, rough.size))
    for i in range(smooth.size):
        for j in range(smooth.size):
            system[i, j] = -compliance[smooth[i], smooth[j]] * springs[smooth[j]]
        system[i, i] += 1.0
        for j in range(rough.size):
            across[i, j] = compliance[smooth[i], rough[j]]
            coupled[j, i] = compliance[rough[j], smooth[i]] * springs[smooth[i]]
    put(np.linalg.inv(system), there.freed)
    moved = np.dot(there.freed, across)
    more = np.dot(coupled, moved)
    for j in range(rough.size):
        for i in range(smooth.size):
            compliance[smooth[i], rough[j]] = moved[i, j]
        for i in range(rough.size):
            compliance[rough[i], rough[j]] += more[i, j]
    for i in range(springs.size):
        for j in range(smooth.size):
            compliance[i, smooth[j]] = 0.0


@compiled_part
def _open(aligned: Aligned, there: There, amplitudes: Array, free_gap: Array) -> None:
    """The gaps (3 m,) without contact."""
    fill(free_gap, 0.0)
    for k in range(there.weights.size):
        if there.weights[k] != 0.0:
            np.dot(aligned.gap[k], amplitudes, there.partly)
            for row in range(free_gap.size):
                free_gap[row] += there.weights[k] * there.partly[row]
    smooth, rough, apart = aligned.smooth, aligned.rough, there.apart
    for i in range(smooth.size):
        apart[0, i] = free_gap[smooth[i]]
    np.dot(there.freed, apart[0], apart[1])
    np.dot(there.coupled, apart[1], there.others)
    for i in range(smooth.size):
        free_gap[smooth[i]] = apart[1, i]
    for i in range(rough.size):
        free_gap[rough[i]] += there.others[i]


@compiled_part
def _settle_anew(there: There, work: JointWork, now: JointState) -> bool:
    """Whether Newton's method settles the joint, without changes of gaps elsewhere as a guess."""
    put(now.gap, work.trial.gap)
    return settle_by_newton(there.joint, work.free_gap, now, work.trial, work.newton)[0]


@compiled_part
def _take(there: There, work: JointWork, amplitudes: Array, now: JointState, none: Array) -> None:
    """The joint's new state, and the displacement; `none` are the factors of no loads."""
    take(there.joint, work.trial, now, work.remainder)
    displace(there.joint, work.moved, amplitudes, none, work.remainder, there.displacement)


@compiled
def settle_at(
    aligned: Aligned, there: There, work: JointWork, amplitudes: Array, now: JointState, at: float
) -> bool:
    """Settle the joint at a position, m, in place; return whether there is an equilibrium near."""
    _stand(aligned, there, at)
    _open(aligned, there, amplitudes, work.free_gap)
    if not _settle_anew(there, work, now):
        return False
    _take(there, work, amplitudes, now, np.empty(0))
    return True


@compiled_part
def _add_row(factor: float, row: int, source: Array, into: int, passed: Passed) -> None:
    """Add a product of rows to L S and to L R y."""
    passed.right[into] += factor * passed.warm[row]
    for j in range(source.shape[1]):
        passed.system[into, j] += factor * source[row, j]


@compiled_part
def _exchange(guide: Guided, passed: Passed) -> None:
    """I + (L - L0) S and (L - L0) R y."""
    place, influence, mean = guide.aligned.place, guide.heat.joint_influence, passed.mean
    put(guide.without, passed.system)
    np.dot(guide.held, passed.warm, passed.right)
    for row in range(passed.right.size):
        passed.right[row] = -passed.right[row]
    for e in range(passed.conducted.size):
        each = passed.conducted[e]
        _add_row(each, e, influence, e, passed)
        if place[0, e] < 0:
            continue
        for k in range(mean.size):
            if mean[k] == 0.0:
                continue
            at = place[k, e]
            _add_row(-each * mean[k], at, influence, e, passed)
            _add_row(-each * mean[k], e, influence, at, passed)
            _add_row(each * passed.square[k], at, influence, at, passed)
            if k + 1 < mean.size and passed.product[k] != 0.0:
                above, product = place[k + 1, e], each * passed.product[k]
                _add_row(product, above, influence, at, passed)
                _add_row(product, at, influence, above, passed)


@compiled_part
def _rub(guide: Guided, passed: Passed, pressure: Array, way: float) -> None:
    """The heat of friction of each row, W: one half of each contact element's enters a side."""
    place, rubbed = guide.aligned.place, passed.rubbed
    fill(rubbed, 0.0)
    for e in range(pressure.size):
        half = 0.5 * guide.running[e] * pressure[e] * way
        rubbed[e] += half
        if place[0, e] >= 0:
            for k in range(passed.mean.size):
                rubbed[place[k, e]] += half * passed.mean[k]


@compiled_part
def _pass_heat(guide: Guided, passed: Passed, amplitudes: Array) -> None:
    """Add the effect of friction heat and of the exchange of rows to amplitudes without them."""
    np.dot(guide.rows, amplitudes, passed.warm)
    np.dot(guide.heat.joint_influence, passed.rubbed, passed.right)
    for row in range(passed.warm.size):
        passed.warm[row] += passed.right[row]
    _exchange(guide, passed)
    left = solve(passed.system, passed.right)
    for row in range(left.size):
        passed.rubbed[row] -= left[row]
    np.dot(guide.heat.influence, passed.rubbed, passed.drawn)
    for r in range(amplitudes.size):
        amplitudes[r] += passed.drawn[r]


@compiled
def march_along(guide: Guided, steps: Steps, inputs: Array, now: Guiding, record: Record) -> int:
    """March through inputs, into a record.

    Parameters
    ----------
    guide : Guided
        The machine.
    steps : Steps
        Its storage, by `new_steps`.
    inputs : ndarray, shape (n, k + 3)
        Heat and temperatures of each step, then the axis's positions at its start and end, and its
        travel, m.
    now : Guiding
        Amplitudes and joints, in place.
    record : Record
        After each step; its temperatures of drives are not written.

    Returns
    -------
    int
        Number of steps taken: fewer than n if the next one has no equilibrium near; `now` is then
        the state before it.
    """
    kept, there, passed = steps
    heat, aligned, known = guide.heat, guide.aligned, guide.heat.drive.shape[1]
    amplitudes, none, at = np.empty_like(now.amplitudes), np.empty(0), math.nan
    for n in range(len(inputs)):
        start, end = inputs[n, known], inputs[n, known + 1]
        put(now.amplitudes, amplitudes)
        drive(heat, amplitudes, inputs[n])
        conduct(there.joint, now.joint.pressure, passed.conducted)
        occupy(aligned.positions, start, end, passed)
        _rub(guide, passed, now.joint.pressure, inputs[n, known + 2])
        _pass_heat(guide, passed, amplitudes)
        elsewhere = end != at
        if elsewhere:
            _stand(aligned, there, end)
            forget(kept.tangents)
        _open(aligned, there, amplitudes, kept.work.free_gap)
        if elsewhere:
            solved = _settle_anew(there, kept.work, now.joint)
        else:
            solved = settle(there.joint, kept, now.joint, now.joint.change)[0]
        if not solved:
            return n
        at = end
        put(amplitudes, now.amplitudes)
        _take(there, kept.work, amplitudes, now.joint, none)
        put(amplitudes, record.amplitudes[n])
        put(there.displacement, record.probes[n])
        put(now.joint.gap, record.gap[n])
        put(now.joint.slip, record.slip[n])
        put(now.joint.pressure, record.pressure[n])
        put(now.joint.change, record.change[n])
    return len(inputs)
