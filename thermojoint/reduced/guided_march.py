"""JIT-compiled march of a machine on one axis: the plain steps of `physics`, one after the other.

A step solves for the heat that leaves pads and stations beyond what the modes have of it, then the
gap equations with the elasticity interpolated between two aligned positions. Their springs are
those of the condensation: those of the joint at its preload would need an inverse at every position
(`fesim.joint.gap`).

Start at `march_along`; `tests/thermojoint/reduced/test_guided_march.py` compares it with the plain
steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.axes.guideway import Guideway
from fesim.axes.occupation import STILL
from fesim.jit import compiled, compiled_part
from fesim.joint.blocks import one_block
from fesim.joint.frozen_tangent import forget
from fesim.joint.in_place import fill, put
from fesim.joint.linear_system import solve
from fesim.joint.loosening import UNWATCHED
from fesim.march.compiled_march import Kept, MarchKernel, Moving, settle
from fesim.march.compiled_step import (
    HeatStep,
    JointKernel,
    JointState,
    conduct,
    displace,
    drive,
    settle_by_newton,
    take,
)
from fesim.march.kernel import new_kept, owned
from thermojoint.artefacts.arrays import Array


class Aligned(NamedTuple):
    """Elasticity at k aligned positions; rows as in `ElasticCondensation`.

    Attributes
    ----------
    positions : ndarray, shape (k,)
        Evenly spaced, ascending, m.
    place : ndarray of int, shape (k, m)
        Row of the station under each contact element; -1 for none.
    compliance, columns : ndarray, shape (k, 3 m, 3 m)
        C A and its transpose: gap per traction, m/Pa.
    gap : ndarray, shape (k, 3 m, r)
        S_T, m/K.
    moved : ndarray, shape (k, axes, 3 m)
        D_C A, m/Pa.
    free : ndarray, shape (k, axes, r)
        D_T, m/K.
    """

    positions: Array
    place: NDArray[np.int64]
    compliance: Array
    columns: Array
    gap: Array
    moved: Array
    free: Array


class Guided(NamedTuple):
    """Data of a march along an axis, with steps of one length.

    Attributes
    ----------
    heat : HeatStep
        Its influences are those of the guideway's q rows.
    rows : ndarray, shape (q, r)
        R, K.
    held, without : ndarray, shape (q, q)
        L0, W/K, which the modes have, and I - L0 S.
    running : ndarray, shape (m,)
        Heat of running friction per pressure and metre of way in a step, W/(Pa m).
    aligned : Aligned
        Elasticity.
    """

    heat: HeatStep
    rows: Array
    held: Array
    without: Array
    running: Array
    aligned: Aligned


class Here(NamedTuple):
    """Where the axis stands and what it has passed in a step; written in place.

    Attributes
    ----------
    joint : JointKernel
        Its compliance, `columns`, `moved` and `free` are those here; its `gap` is not used.
    mean, square, product : ndarray, shapes (k,), (k,) and (k - 1,)
        Shares, as in `fesim.axes.occupation`.
    weights : ndarray, shape (k,)
        Of the aligned positions at the end of the step.
    conducted : ndarray, shape (m,)
        Conductance times area, W/K.
    rubbed, warm, right : ndarray, shape (q,)
        Heat of friction, W, the rows without joints, K, and what they would exchange, W.
    system : ndarray, shape (q, q)
        I + (L - L0) S.
    drawn : ndarray, shape (r,)
        Amplitudes that heat of the rows gives.
    partly : ndarray, shape (3 m,)
        Gaps at one aligned position, m.
    """

    joint: JointKernel
    mean: Array
    square: Array
    product: Array
    weights: Array
    conducted: Array
    rubbed: Array
    warm: Array
    right: Array
    system: Array
    drawn: Array
    partly: Array


def aligned_elasticity(way: Guideway) -> Aligned:
    """Return the elasticity of a guideway with one axis, whole, for the march."""
    (positions,), (place,) = way.stations.positions, way.stations.place
    each = [way.elastic[k,] for k in range(len(positions))]
    compliance = np.array([one.compliance * one.area for one in each])
    return Aligned(
        owned(positions),
        np.ascontiguousarray(np.where(place < 0, -1, place + way.stations.count)),
        compliance,
        owned(compliance.transpose(0, 2, 1)),
        owned(np.array([one.thermal_gap for one in each])),
        owned(np.array([one.probe_compliance * one.area for one in each])),
        owned(np.array([one.probe_thermal for one in each])),
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


def here_at_first(guide: Guided, joint: JointKernel, springs: Array) -> tuple[Here, Kept]:
    """Return storage for a march with joints, of which `springs` (3 m,) are the condensation's."""
    aligned, (rows, modes) = guide.aligned, guide.rows.shape
    axes, stops, count = len(aligned.free[0]), aligned.positions.size, joint.preload.size
    linear = owned(springs), *(np.array(each[0]) for each in aligned[2:4])
    now = joint._replace(
        springs=linear[0],
        compliance=linear[1],
        columns=linear[2],
        gap=np.empty((0, 0)),
        moved=np.empty((axes, 3 * count)),
        free=np.empty((axes, modes)),
    )
    sizes = [stops, stops, stops - 1, stops, count, rows, rows, rows]
    storage = [*map(np.zeros, sizes), np.empty((rows, rows)), np.empty(modes), np.empty(3 * count)]
    here = Here(now, *storage)
    return here, new_kept(MarchKernel(guide.heat, now, UNWATCHED), one_block(*linear))


@compiled_part
def _place(positions: Array, at: float) -> float:
    """As in `fesim.axes.occupation`."""
    last = positions.size - 1
    place = (at - positions[0]) / (positions[last] - positions[0]) * last
    nearest = float(round(place))
    if abs(place - nearest) <= STILL:
        place = nearest
    return min(max(place, 0.0), float(last))


@compiled
def occupy(positions: Array, start: float, end: float, here: Here) -> None:
    """Put the shares of an even way, `fesim.axes.occupation.even`, and the weights at its end."""
    first, second = _place(positions, start), _place(positions, end)
    fill(here.mean, 0.0)
    fill(here.square, 0.0)
    fill(here.product, 0.0)
    fill(here.weights, 0.0)
    low, high, most = min(first, second), max(first, second), positions.size - 2
    begin = low
    while True:
        stop = min(math.floor(begin) + 1.0, high)
        part = (stop - begin) / (high - low) if high > low else 1.0
        below = min(math.floor(begin), most)
        a, b = begin - below, stop - below
        once, twice = part * (a + b) / 2.0, part * (a * a + a * b + b * b) / 3.0
        here.mean[below] += part - once
        here.mean[below + 1] += once
        here.square[below] += part - 2.0 * once + twice
        here.square[below + 1] += twice
        here.product[below] += once - twice
        begin = stop
        if begin >= high:
            break
    below = min(math.floor(second), most)
    here.weights[below], here.weights[below + 1] = below + 1.0 - second, second - below


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
def _stand(aligned: Aligned, here: Here) -> None:
    """The elasticity here."""
    _mix(here.weights, aligned.compliance, here.joint.compliance)
    _mix(here.weights, aligned.columns, here.joint.columns)
    _mix(here.weights, aligned.moved, here.joint.moved)
    _mix(here.weights, aligned.free, here.joint.free)


@compiled_part
def _settle(joint: JointKernel, kept: Kept, now: JointState, elsewhere: bool) -> bool:
    """Whether the joint settles; where it stands elsewhere now, no frozen tangent serves."""
    if not elsewhere:
        return settle(joint, kept, now)[0]
    forget(kept.tangents)
    put(now.gap, kept.work.trial.gap)
    work = kept.work
    return settle_by_newton(joint, work.free_gap, now, work.trial, work.newton)[0]


@compiled_part
def _add_row(factor: float, row: int, source: Array, into: int, here: Here, warm: Array) -> None:
    """Add a product of rows to L S and to L R y."""
    here.right[into] += factor * warm[row]
    for j in range(source.shape[1]):
        here.system[into, j] += factor * source[row, j]


@compiled_part
def _exchange(guide: Guided, here: Here) -> None:
    """I + (L - L0) S and (L - L0) R y."""
    place, influence, warm = guide.aligned.place, guide.heat.joint_influence, here.warm
    put(guide.without, here.system)
    np.dot(guide.held, warm, here.right)
    for row in range(warm.size):
        here.right[row] = -here.right[row]
    for e in range(here.conducted.size):
        each = here.conducted[e]
        _add_row(each, e, influence, e, here, warm)
        if place[0, e] < 0:
            continue
        for k in range(here.mean.size):
            if here.mean[k] == 0.0:
                continue
            at, mean = place[k, e], each * here.mean[k]
            _add_row(-mean, at, influence, e, here, warm)
            _add_row(-mean, e, influence, at, here, warm)
            _add_row(each * here.square[k], at, influence, at, here, warm)
            if k + 1 < here.mean.size and here.product[k] != 0.0:
                above, product = place[k + 1, e], each * here.product[k]
                _add_row(product, above, influence, at, here, warm)
                _add_row(product, at, influence, above, here, warm)


@compiled_part
def _rub(guide: Guided, here: Here, pressure: Array, way: float) -> None:
    """The heat of friction of each row, W: one half of each contact element's enters a side."""
    fill(here.rubbed, 0.0)
    for e in range(pressure.size):
        half = 0.5 * guide.running[e] * pressure[e] * way
        here.rubbed[e] += half
        if guide.aligned.place[0, e] >= 0:
            for k in range(here.mean.size):
                here.rubbed[guide.aligned.place[k, e]] += half * here.mean[k]


@compiled
def march_along(
    guide: Guided, kept: Kept, here: Here, inputs: Array, now: Moving, record: tuple[Array, Array]
) -> int:
    """March through inputs; into a record of amplitudes (n, r) and displacements (n, axes).

    Parameters
    ----------
    guide : Guided
        The machine.
    kept, here
        By `here_at_first`.
    inputs : ndarray, shape (n, k + 2)
        Heat and temperatures of each step, then the axis's positions at its start and end, m.
    now : Moving
        Amplitudes and joints, in place.
    record : tuple of ndarray, shapes (n, r) and (n, axes)
        Amplitudes and displacement, m, after each step.

    Returns
    -------
    int
        Number of steps taken: fewer than n if the next one has no equilibrium near; `now` is before
        it then.
    """
    heat, known, joint = guide.heat, guide.heat.drive.shape[1], here.joint
    amplitudes, none = np.empty_like(now.amplitudes), np.empty(0)
    free_gap, remainder = kept.work.free_gap, kept.work.remainder
    at = math.nan
    for n in range(len(inputs)):
        start, end = inputs[n, known], inputs[n, known + 1]
        occupy(guide.aligned.positions, start, end, here)
        put(now.amplitudes, amplitudes)
        drive(heat, amplitudes, inputs[n])
        conduct(joint, now.joint.pressure, here.conducted)
        np.dot(guide.rows, amplitudes, here.warm)
        _rub(guide, here, now.joint.pressure, abs(end - start))
        np.dot(heat.joint_influence, here.rubbed, here.right)
        for row in range(here.warm.size):
            here.warm[row] += here.right[row]
        _exchange(guide, here)
        left = solve(here.system, here.right)
        for row in range(left.size):
            here.rubbed[row] -= left[row]
        np.dot(heat.influence, here.rubbed, here.drawn)
        for r in range(amplitudes.size):
            amplitudes[r] += here.drawn[r]
        if end != at:
            _stand(guide.aligned, here)
        fill(free_gap, 0.0)
        for k in range(here.weights.size):
            if here.weights[k] != 0.0:
                np.dot(guide.aligned.gap[k], amplitudes, here.partly)
                for row in range(free_gap.size):
                    free_gap[row] += here.weights[k] * here.partly[row]
        if not _settle(joint, kept, now.joint, end != at):
            return n
        at = end
        put(amplitudes, now.amplitudes)
        take(joint, kept.work.trial, now.joint, remainder)
        displace(joint, kept.work.moved, amplitudes, none, remainder, record[1][n])
        put(amplitudes, record[0][n])
    return len(inputs)
