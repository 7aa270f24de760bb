"""Tables of an exported machine with moving axes: the arithmetic that depends on the positions.

Heat conduction is that of `thermojoint.reduced.physics` with a way, contact that of
`fesim.axes.survey`: rows apart, tied at the aligned positions around a place, interpolated there.
Then the springs of the condensation are exchanged for those of sticking joints, gap by gap, so
that only normal pressure and sliding are left to Newton's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.export.program import (
    Compared,
    Operations,
    Table,
    Variable,
    identifier,
    listed,
    solving,
)
from estimator.interface import Estimate
from estimator.joint_aware.driven_program import TERMS, driven
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.sample_values import OVERTRAVEL
from fesim.axes.axis import gone_along
from fesim.axes.corner_table import CornerTable
from fesim.axes.guideway import Guideway
from fesim.axes.occupation import STILL
from fesim.march.compiled_step import JointKernel
from fesim.march.kernel import joint_kernel
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.reduced.machine import MovingAxis
from thermojoint.reduced.physics import Physics, heat_step

#: Status bit that no estimator in Python has: a part of the lines is from an earlier sample.
LINE_HELD = 1 << 12
#: Largest tables of combinations of aligned positions, numbers: 32 MB in double precision.
MOST = 4_000_000
#: Tolerance of the gap equations relative to that of Python, whose sweep over positions stops at a
#: hundredth of its tolerance.
CLOSER = 1e-3
#: Tolerance of the self-test, relative to the largest displacement: both programs solve the joints
#: anew at every position, to a tolerance.
RELATIVE = 1e-7


class Placed(NamedTuple):
    """Data for a template that depend on the positions, or of a machine without moving axes."""

    #: Numbers and tables.
    values: dict[str, Any]
    tables: list[Table]
    #: Tables of integers.
    indices: list[Table]
    #: Numbers of the state beyond those of a machine without moving axes.
    state: int
    #: Operations of a sample, usually and at most, without Newton's method.
    usual: Operations
    worst: Operations


@lru_cache(maxsize=8)
def kernel_of(physics: Physics) -> JointKernel | None:
    """Return the data of the joints, with axes or without; None for laws that are not compiled."""
    if physics.modes.way is None:
        return physics.kernel
    return joint_kernel(physics.contact, np.zeros((physics.contacts, 0)), physics.held)


def guided(estimator: JointAware, kernel: JointKernel) -> Placed:
    """Return the additional data of the program of a machine with moving axes.

    Raises
    ------
    InputError
        It has too many combinations of aligned positions.
    """
    model, physics = estimator.model, estimator.observer.physics
    way = physics.modes.way
    assert way is not None  # asked for on an axis only
    counts = [len(positions) for positions in way.stations.positions]
    corners, tables = list(product(*map(range, counts))), physics.tables
    if len(corners) * tables.each > MOST:
        raise InputError(
            f"export: {len(corners)} combinations of aligned positions have "
            f"{len(corners) * tables.each} numbers, more than {MOST}; take longer stations, or run "
            "it with 'thermojoint estimate'"
        )
    packed, held = tables.table(corners), tables.held
    values, asked = _lines(estimator)
    springs = _springs(kernel)
    area = np.tile(way.elastic.ties.area, 3)
    # They follow the modulus, as `ElasticCondensation.strained`.
    ties = way.elastic.modulus * way.elastic.ties.reference
    grown, below = _grown(way, held)
    heat = heat_step(model.modes, model.step)
    missing = np.eye(len(physics.held_exchange)) - physics.held_exchange @ heat.joint_influence
    first = np.concatenate([[0], np.cumsum(counts)])
    ends = np.array([one[[0, -1]] for one in way.stations.positions])
    exchanged = (area * (ties - springs))[held]
    rides = np.full(physics.contacts, -1)
    for axis, riding in enumerate(way.stations.riding):
        rides[riding] = axis
    count = physics.contacts
    drives = driven(model)
    probes = len(model.modes.elastic.probe_thermal)
    more = drives.step + drives.place.times(len(model.axes) * (1 + values["asked"]))
    sizes = _Sizes(
        count,
        len(model.axes),
        probes,
        model.modes.rates.size,
        len(counts),
        way.stations.size,
        int(first[-1]),
        held.size,
        int(np.count_nonzero(exchanged)),
        len(grown),
        packed.anchored.shape[2],
        values["asked"],
    )
    passed = np.vstack(
        [np.where(of_axis < 0, 0, of_axis + count) for of_axis in way.stations.place]
    )
    return Placed(
        values
        | {
            "moving": len(counts),
            "drives": drives.drives,
            "cells": max((drive["cells"] for drive in drives.drives), default=0),
            "heated": drives.heated,
            "felt": drives.felt,
            "seats": probes - len(model.axes),
            "terms": TERMS,
            "line_held": LINE_HELD,
            "counts": counts,
            "pairs": _pairs(estimator),
            "rows": way.stations.size,
            "stops": int(first[-1]),
            "corners": len(corners),
            "held": held.size,
            "triangle": held.size * (held.size + 1) // 2,
            "anchors": packed.anchored.shape[2],
            "grown": len(grown),
            "still": STILL,
            "overtravel": OVERTRAVEL,
        },
        [
            Table("rows_of", "Sides of the joints and stations, K.", model.modes.jump),
            Table(
                "spent", "Amplitudes per W of a row, relative to the row.", model.step * heat.decay
            ),
            Table("row_influence", "Rows per W of the rows, K/W.", heat.joint_influence),
            Table("exchanged", "What the modes have of the exchange, W/K.", physics.held_exchange),
            Table("not_exchanged", "One less that times the influence.", missing),
            Table("running", "Heat of running friction, W per Pa and m.", way.running / model.step),
            Table("ends", "First and last aligned position, m.", ends),
            Table("place_before", "Before the first sample, m.", model.modes.factors),
            Table("grown_of", "Pads, stations, anchors, probes apart, m per mode.", grown),
            Table("pull", "Springs of the ties, N/m.", (area * ties)[held]),
            Table("loosened", "... less those of a joint that sticks, N/m.", exchanged),
            Table("area", "Of a tie, m2.", area[held]),
            Table("springs", "Of a joint that sticks, Pa/m.", springs),
            Table("compliance_at", "Of ties at aligned positions, m/N.", packed.compliance),
            Table("probes_at", "Displacement per force of the ties there, m/N.", packed.probes),
            Table("anchored_at", "Ties and displacement per anchor there.", _anchored(packed)),
            *asked,
            *drives.tables,
        ],
        [
            Table("first_stop", "First aligned position of every axis.", first),
            Table("rides", "Axis that a contact element rides on, or -1.", rides),
            Table("passed", "Row of the station below it.", passed),
            Table("tie", "Gap of every tie.", held),
            Table("station_of", "What the station below a tie adds to it, or -1.", below),
            Table("asked_axis", "Axis of every position asked for.", _asked_axes(estimator)),
        ],
        _state(sizes) + drives.state,
        _operations(sizes, 2) + more,
        _operations(sizes, max(counts)) + more,
    )


class _Sizes(NamedTuple):
    """Sizes that determine the costs."""

    contacts: int
    axes: int
    #: Of the displacement: axes, and seats of drives.
    probes: int
    modes: int
    moving: int
    rows: int
    stops: int
    held: int
    #: Ties whose spring is exchanged.
    exchanged: int
    grown: int
    anchors: int
    asked: int


def _state(of: _Sizes) -> int:
    """Number of values of the state beyond those of a machine without moving axes."""
    kept = 2 * of.moving + of.asked * (3 * of.contacts + of.axes) - 3 * of.contacts
    frame = (of.held + of.probes) * (of.held + 1) + 3 * of.held + 1
    room = 2 * of.contacts + 9 * of.contacts**2 + frame + of.grown + 3 * of.rows + 3 * of.stops
    return kept + room + max(0, of.rows**2 - 9 * of.contacts**2)


def _operations(of: _Sizes, stops: int) -> Operations:
    """Operations of a sample in which each contact element passes `stops` stations."""
    touches = of.contacts * (1 + 3 * stops + 2 * (stops - 1))
    heat = 2 * of.rows * of.modes + 2 * of.rows**2 + touches * (of.rows + 2) + of.modes
    heat += of.grown * of.modes + of.contacts * (3 + stops)
    frame = (of.held + of.probes) * (of.held + 1)
    tied = 2 * of.held**2 + 2 * of.held * (2 + of.probes) + (of.held + of.probes) * of.anchors
    place = 2**of.moving * (tied + 4 * of.moving) + of.exchanged * frame + 2 * of.held**2
    place += of.axes * ((1 + of.probes - of.axes) * 2 * of.held + of.modes) + 10 * of.moving
    ways = Operations(8 * of.stops, 16 * of.stops, 4 * of.stops, of.contacts)
    places = Operations(place, place, of.held + of.moving).times(1 + of.asked)
    return Operations(heat, heat + 2 * of.modes) + solving(of.rows) + ways + places


def _anchored(packed: CornerTable) -> Array:
    """Ties and probes per anchor; a column of zeros where there is none."""
    corners, rows, anchors = packed.anchored.shape
    return packed.anchored if anchors else np.zeros((corners, rows, 1))


def _springs(kernel: JointKernel) -> Array:
    """Springs of a sticking joint (3 m,), Pa/m; those in shear are zero without friction."""
    count = kernel.preload.size
    springs = kernel.reference.copy()
    springs[count:] = np.tile(np.where(kernel.laws[:, 5] > 0.0, kernel.laws[:, 6], 0.0), 2)
    return springs


def _grown(way: Guideway, held: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Thermal displacement of ties, stations, anchors, probes, (g, r); stations below (k, h)."""
    ties, count = way.elastic.ties, way.stations.count
    direction, element = np.divmod(held, count)
    below = np.vstack(
        [
            np.where(
                place[:, element] < 0,
                -1,
                3 * count + direction * ties.stations + place[:, element],
            )
            for place in way.stations.place
        ]
    )
    used = np.unique(below[below >= 0])
    others = np.arange(ties.guided, len(ties.compliance))
    compact = np.where(below < 0, -1, held.size + np.searchsorted(used, below))
    return way.elastic.thermal[np.concatenate([held, used, others])], compact


def _asked_axes(estimator: JointAware) -> NDArray[np.int64]:
    counts = [axis.asked.size for axis in estimator.model.moving_axes]
    return np.append(np.repeat(np.arange(len(counts)), counts), list(_zeros(estimator))).astype(int)


def _zeros(estimator: JointAware) -> dict[int, float]:
    """Zero positions, m, of axes whose drives stand on seats: the last of the positions asked."""
    drives = estimator.model.modes.drives
    assert drives is not None  # with axes
    return drives.seated_zeros


def _lines(estimator: JointAware) -> tuple[dict[str, Any], list[Table]]:
    """Positions asked for, and weights of their displacements in lines of `fesim.axes.line`."""
    offset, slope = list[Array](), list[Array]()
    moving = estimator.model.moving_axes
    for axis in moving:
        arm = axis.asked - axis.asked.mean()
        slope.append(arm / (arm @ arm))
        offset.append(1.0 / arm.size + (axis.reference - axis.asked.mean()) * slope[-1])
    ends = np.cumsum([0, *(axis.asked.size for axis in moving)]).tolist()
    sloped, strokes = estimator.model.sloped, estimator.model.strokes
    zeros = _zeros(estimator)
    places = [*(axis.asked for axis in moving), np.array(list(zeros.values()))]
    values = {
        "asked": ends[-1] + len(zeros),
        "zeros": [(ends[-1] + z, a) for z, a in enumerate(zeros)],
        "asked_of": [(start, end) for start, end in pairwise(ends)],
        "sloped": [(estimator.axes.index(axis), at) for axis, at in sloped.items()],
        "strokes": [(one.reference, one.high - one.low) for one in strokes.values()],
        "line_of": [sloped.get(axis, -1) for axis in estimator.axes],
        "several": len(moving) > 1,
    }
    tables = [
        Table("asked_at", "Positions asked for, m.", np.concatenate(places)),
        Table("asked_offset", "Their parts of K0.", np.concatenate(offset)),
        Table("asked_slope", "... and of the slope, 1/m.", np.concatenate(slope)),
    ]
    return values, tables


def _pairs(estimator: JointAware) -> list[str]:
    """Displacements along every moving axis."""
    moving = [identifier(axis.name) for axis in estimator.model.moving_axes]
    return [f"{identifier(axis)}_{one}" for axis in estimator.axes for one in moving]


def outputs(estimator: JointAware) -> tuple[Variable, ...]:
    """Return the outputs of lines: see `JointAware.details`."""
    model = estimator.model
    axes, sloped = list(map(identifier, model.axes)), list(map(identifier, model.sloped))
    pairs = _pairs(estimator) if len(model.moving_axes) > 1 else []
    return (
        *listed("here", "m", axes),
        *listed("here_band", "m", axes),
        *listed("slope", "m/m", sloped),
        *listed("slope_band", "m/m", sloped),
        *listed("P0", "m", sloped),
        *listed("along_K0", "m", pairs),
        *listed("along_slope", "m/m", pairs),
    )


def compared(estimator: JointAware) -> tuple[Compared, ...]:
    """Return those that the self-test compares; slopes by their effect over the stroke."""
    model = estimator.model
    lengths = {
        f"slope_{identifier(axis)}": stroke.high - stroke.low
        for axis, stroke in model.strokes.items()
    }
    return tuple(
        Compared(one, lengths[one.name], LINE_HELD) if one.name in lengths else Compared(one)
        for one in outputs(estimator)
        if one.name in lengths or one.name in {f"here_{identifier(axis)}" for axis in model.axes}
    )


def compared_in(estimator: JointAware, estimate: Estimate) -> Array:
    """Return their values in an estimate in Python, m."""
    at = {channel.name: k for k, channel in enumerate(estimator.details)}
    strokes = estimator.model.strokes
    here = [
        estimate.details[at[f"{axis}_here"]] if axis in strokes else estimate.displacement[k]
        for k, axis in enumerate(estimator.axes)
    ]
    slopes = [
        (stroke.high - stroke.low) * estimate.details[at[f"{axis}_slope"]]
        for axis, stroke in strokes.items()
    ]
    return np.array(here + slopes)


def ways(places: Array) -> Array:
    """Return odometer readings at positions (samples, x), m, with motion between samples too."""
    every = np.arange(len(places))[:, None]
    more = 0.02 * np.mod(every + np.arange(places.shape[1]), 5) * (np.mod(every, 60) > 20)
    return 3.0 + gone_along(places) + np.cumsum(more, axis=0)


def course(axes: Sequence[MovingAxis], samples: int) -> Array:
    """Return positions (samples, x), m: axes stop, pass stations in a step, and reverse."""
    found = np.empty((samples, len(axes)))
    for k, axis in enumerate(axes):
        part = np.mod(np.arange(samples) + 7 * k, 48 + 10 * k)
        share = np.clip(part / 6.0, 0.0, 1.0) - np.clip((part - 24.0) / 7.0, 0.0, 1.0)
        # It rests at another place every time.
        far = 1.0 - 0.4 * np.mod(0.3 * (np.arange(samples) // (48 + 10 * k)), 1.0)
        low, high = axis.asked.min(), axis.asked.max()
        found[:, k] = low + (high - low) * share * far
    return found
