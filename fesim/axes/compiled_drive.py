"""JIT-compiled steps of ball screws and scales, as in `fesim.axes.positioning`.

Screws of all axes are stored in arrays of one shape; cells without a screw have no effect.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.axes.axis import Axis, parts_of
from fesim.axes.ball_screw import SHORTEST
from fesim.axes.compiled_passing import Ways
from fesim.jit import compiled_part
from fesim.joint.in_place import fill
from fesim.march.compiled_exponential import phi
from thermojoint.artefacts.arrays import Array

#: Columns of `Drives.numbers`.
(
    _CAPACITY,
    _SURFACE,
    _NUT,
    _LENGTH,
    _MOTOR,
    _STILL,
    _ADDED,
    _SPEED,
    _EXPONENT,
    _TOWARDS,
    _NUT_AT,
) = range(11)


class Drives(NamedTuple):
    """Drives of a axes, whose screws have n cells at most."""

    #: Shape (a, 2): start of the state of each, and its number of cells.
    state: NDArray[np.int64]
    #: Shape (a, 11): parameters of each screw, as in `fesim.axes.ball_screw`: heat capacity and
    #: surface of a cell; heat and length of the nut; heat of the motor; the film; direction, and
    #: position of the nut with the axis at zero, m from the fixed bearing along the axis.
    numbers: Array
    #: Shapes (a, 2): at its ends: sinks, W/K; fractions that reach the cells; bearings, J per m.
    sinks: Array
    reaching: Array
    bearings: Array
    #: Shapes (a, n + 1), (a, n) and (a, n, n): edges; rates; modes, and the same transposed.
    edges: Array
    rates: Array
    modes: Array
    rows: Array
    #: Shape (a, 3): frictional heat not taken up by the screw, J per m of travel; input of
    #: its surfaces.
    spared: Array
    column: NDArray[np.int64]
    #: Shape (a, 3, r): rows of the temperatures of these surfaces.
    temperature: Array
    #: Shape (a,): index of a scale in the state, -1 without one; lag, s; whether it follows a
    #: probe.
    scale: NDArray[np.int64]
    lag: Array
    follows: NDArray[np.bool_]
    #: Shape (a, r): row of that probe.
    followed: Array
    #: Index of the ambient among the inputs.
    ambient: int


class DriveWork(NamedTuple):
    """Work arrays of n cells."""

    heat: Array
    before: Array
    driven: Array
    mean: Array
    change: Array
    #: Shape (2,): mean heat at both ends, W.
    ends: Array


def drives_of(axes: Sequence[Axis], size: int) -> Drives:
    """Return the drives of axes of a machine with `size` amplitudes."""
    count, parts = len(axes), parts_of(axes)
    screws = [None if axis.drive is None else axis.drive.screw for axis in axes]
    most = max([1, *(screw.made.conduction.rates.size for screw in screws if screw is not None)])
    ends = count, 2
    drives = Drives(
        state=np.array([[part.start, 0] for part in parts]),
        numbers=np.ones((count, 11)),
        sinks=np.zeros(ends),
        reaching=np.zeros(ends),
        bearings=np.zeros(ends),
        edges=np.zeros((count, most + 1)),
        rates=np.zeros((count, most)),
        modes=np.zeros((count, most, most)),
        rows=np.zeros((count, most, most)),
        spared=np.zeros((count, 3)),
        column=np.full((count, 3), -1),
        temperature=np.zeros((count, 3, size)),
        scale=np.full(count, -1),
        lag=np.zeros(count),
        follows=np.zeros(count, dtype=np.bool_),
        followed=np.zeros((count, size)),
        ambient=next((axis.drive.ambient for axis in axes if axis.drive is not None), 0),
    )
    for a, (axis, screw, part) in enumerate(zip(axes, screws, parts, strict=True)):
        if (drive := axis.drive) is None:
            continue
        if drive.scale is not None:
            drives.scale[a], drives.lag[a] = part.stop - 1, drive.scale.lag
            if drive.followed is not None:
                drives.follows[a], drives.followed[a] = True, drive.followed
        if screw is None:
            continue
        along, heat, film = screw.made.conduction, screw.made.heat, screw.made.film
        cells = along.rates.size
        drives.state[a, 1] = cells
        drives.numbers[a] = (
            *(along.capacity, along.surface, heat.nut, heat.nut_length, heat.motor),
            *(film.still, film.added, film.speed, film.exponent),
            *(screw.towards, screw.nut - screw.start),
        )
        drives.sinks[a], drives.reaching[a] = along.sinks, along.reaching
        drives.bearings[a] = heat.bearings
        drives.edges[a, : cells + 1], drives.rates[a, :cells] = along.edges, along.rates
        drives.modes[a, :cells, :cells] = along.modes
        drives.rows[a, :cells, :cells] = along.modes.T
        drives.spared[a], drives.column[a] = screw.spared, drive.surfaces.column
        drives.temperature[a] = drive.surfaces.temperature
    return drives


def drive_work(drives: Drives) -> DriveWork:
    """Return work arrays."""
    cells = drives.rates.shape[1]
    return DriveWork(*(np.zeros(size) for size in (*(5 * [cells]), 2)))


@compiled_part
def _below(distance: float, length: float) -> float:
    """`fesim.axes.ball_screw._below`."""
    inside = min(max(distance + 0.5 * length, 0.0), length)
    return inside * inside / (2.0 * length) + max(distance - 0.5 * length, 0.0)


@compiled_part
def _rub(drives: Drives, ways: Ways, step: int, a: int, work: DriveWork) -> tuple[float, float]:
    """Compute the mean heat of cells and ends in a step; return the mean film and the travel."""
    numbers, cells, edges = drives.numbers[a], drives.state[a, 1], drives.edges[a]
    begin, end = ways.start[a, step], ways.start[a, step + 1]
    whole, film, way = ways.times[end] - ways.times[begin], 0.0, 0.0
    more, least = ways.more[a, step], 0.0
    for k in range(begin, end):
        least += abs(ways.positions[k + 1] - ways.positions[k])
    # `fesim.axes.ball_screw.moved_so_far`.
    stands = more > 0.0 and least < SHORTEST
    times = 1.0
    if more > 0.0:
        times = (least + more) / (SHORTEST if stands else least)
    fill(work.heat, 0.0)
    for k in range(begin, end):
        time = ways.times[k + 1] - ways.times[k]
        first, second = ways.positions[k], ways.positions[k + 1]
        if stands:
            share = 0.5 * SHORTEST * time / whole
            first, second = 0.5 * (first + second) - share, 0.5 * (first + second) + share
        gone = times * abs(second - first)
        way += gone
        film += time * (gone / time / numbers[_SPEED]) ** numbers[_EXPONENT]
        first, second = (
            numbers[_TOWARDS] * (first + numbers[_NUT_AT]),
            numbers[_TOWARDS] * (second + numbers[_NUT_AT]),
        )
        low, high = min(first, second), max(first, second)
        length, passed = numbers[_LENGTH], 0.0
        for i in range(cells + 1):
            after = _below(edges[i] - low, length) - _below(edges[i] - high, length)
            if i > 0:
                work.heat[i - 1] += times * numbers[_NUT] / whole * (after - passed)
            passed = after
    for k in range(2):
        work.ends[k] = (numbers[_MOTOR] if k == 0 else 0.0) + drives.bearings[a, k] * way / whole
    return numbers[_STILL] + numbers[_ADDED] * film / whole, way


@compiled_part
def warm_screw(
    drives: Drives,
    taken: tuple[Ways, int],
    work: DriveWork,
    amplitudes: Array,
    now: Array,
    inputs: Array,
) -> None:
    """Take a step of every screw: its temperatures in `now` (d,), its heat among the inputs.

    Parameters
    ----------
    drives : Drives
        The screws.
    taken : tuple of Ways and int
        Travel of the axes, and index of the step.
    work : DriveWork
        Work arrays.
    amplitudes : ndarray, shape (r,)
        Amplitudes of the machine at the start.
    now : ndarray, shape (d,)
        State of the drives, in place, K.
    inputs : ndarray, shape (k,)
        Inputs of the step, in place.
    """
    ways, step = taken
    air = inputs[drives.ambient]
    for a in range(len(drives.numbers)):
        first, cells = drives.state[a]
        if cells == 0:
            continue
        numbers = drives.numbers[a]
        film, way = _rub(drives, ways, step, a, work)
        whole = ways.times[ways.start[a, step + 1]] - ways.times[ways.start[a, step]]
        felt = np.zeros(2)
        for k in range(2):
            if drives.column[a, k + 1] >= 0:
                felt[k] = np.dot(drives.temperature[a, k + 1], amplitudes) - air
            at = (cells - 1) * k
            work.heat[at] += drives.reaching[a, k] * work.ends[k] + drives.sinks[a, k] * felt[k]
        for i in range(work.heat.size):
            work.heat[i] /= numbers[_CAPACITY]
            work.mean[i] = now[first + i] - air if i < cells else 0.0
        np.dot(drives.rows[a], work.mean, work.before)
        np.dot(drives.rows[a], work.heat, work.driven)
        for i in range(work.heat.size):
            rate = drives.rates[a, i] + film * numbers[_SURFACE] / numbers[_CAPACITY]
            one, two, _ = phi(rate * whole)
            before, driven = work.before[i], work.driven[i]
            work.change[i] = whole * one * (driven - rate * before)
            work.before[i] = one * before + whole * two * driven
        np.dot(drives.modes[a], work.change, work.driven)
        for i in range(cells):
            now[first + i] += work.driven[i]
        for k in range(3):
            if drives.column[a, k] < 0:
                continue
            heat = drives.spared[a, k] * way / whole
            if k > 0:
                mean = np.dot(drives.modes[a, (cells - 1) * (k - 1)], work.before)
                heat += drives.sinks[a, k - 1] * (mean - felt[k - 1])
                heat += (1.0 - drives.reaching[a, k - 1]) * work.ends[k - 1]
            inputs[drives.column[a, k]] = heat


@compiled_part
def warm_scale(
    drives: Drives, length: float, before: Array, after: Array, air: float, now: Array
) -> None:
    """Take a step of every scale; `before` and `after` are amplitudes (r,) at its start and end."""
    for a in range(drives.scale.size):
        at = drives.scale[a]
        if at < 0:
            continue
        start, end = air, air
        if drives.follows[a]:
            start, end = np.dot(drives.followed[a], before), np.dot(drives.followed[a], after)
        if drives.lag[a] == 0.0:
            now[at] = end
            continue
        share = length / drives.lag[a]
        one, _, _ = phi(share)
        stays = math.exp(-share)
        now[at] = start + (now[at] - start) * stays + (end - start) * (1.0 - one)
