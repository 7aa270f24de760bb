"""Results of moving axes in a response: positions, requested displacements, lines, drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fesim.axes.axis import gone, parts_of, place_of
from fesim.axes.guideway import Place
from fesim.axes.line import line_over
from fesim.axes.mapping import seen_from
from fesim.axes.positioning import (
    Drive,
    positioning_error,
    screw_temperature,
    screw_tension,
    seated,
    station_positions,
)
from fesim.axes.setup import MovingSetup
from fesim.march.track import Track
from fesim.solid.elasticity import DIRECTIONS
from thermojoint.artefacts.arrays import Array

Values = dict[str, np.ndarray]


class Mapped(NamedTuple):
    """Displacement probes at other positions than those of the axes, at the ends of steps."""

    #: Shape (n, c, p): of n steps, at the c positions of `elsewhere`.
    asked: Array
    #: Shape (t, v, p): at the points of the volume, at the t requested times among the steps.
    volume: Array
    #: Shape (t, v): largest error of the gaps there, m.
    residual: Array


def mapped(ready: MovingSetup, track: Track) -> Mapped:
    """Return the displacement probes of each step at other positions of the axes."""
    steps = [track.step(at) for at in range(len(track))]
    stands = [_stands(ready, step.state.index) for step in steps]
    asked = [
        seen_from(ready.moving, step, elsewhere(ready, at)).displacement
        for step, at in zip(steps, stands, strict=True)
    ]
    points, surveyed = [tuple(at) for at in ready.volume.places.tolist()], _surveyed(ready, track)
    volume = [seen_from(ready.moving, steps[at], points) for at in surveyed]
    shape = (surveyed.size, len(points))
    return Mapped(
        np.array(asked),
        np.reshape([one.displacement for one in volume], (*shape, track.displacement.shape[1])),
        np.reshape([one.residual for one in volume], shape),
    )


def _stands(ready: MovingSetup, index: int) -> Place:
    """Position of the axes after a number of steps, m."""
    return place_of(ready.axes, index * ready.moving.machine.thermal.step)


def _surveyed(ready: MovingSetup, track: Track) -> np.ndarray:
    """Steps of a track at which the volume is requested."""
    return np.flatnonzero(np.isin(track.index, ready.volume.steps))


def elsewhere(ready: MovingSetup, stands: Place) -> list[Place]:
    """Return the further positions at which a step is evaluated, with the axes at `stands`, m.

    One axis after the other is at its requested positions, then one after the other at the position
    at which the error of its drive is zero; the others stay.
    """
    asked = [(a, float(at)) for a, axis in enumerate(ready.axes) for at in axis.asked]
    return [(*stands[:a], at, *stands[a + 1 :]) for a, at in [*asked, *_set_right(ready)]]


def _set_right(ready: MovingSetup) -> list[tuple[int, float]]:
    """Axes whose drive has a zero position, and that position, m."""
    drives = [(a, axis.drive) for a, axis in enumerate(ready.axes)]
    return [(a, drive.zero) for a, drive in drives if drive is not None and drive.zero is not None]


def course_values(
    ready: MovingSetup, times: np.ndarray, track: Track, there: Mapped
) -> tuple[Values, dict[str, np.ndarray | list[str]]]:
    """Return variables and coordinates of a response.

    Parameters
    ----------
    ready : MovingSetup
        The set-up.
    times : ndarray, shape (n,)
        Times, s.
    track : Track
        Steps that end at these times.
    there : Mapped
        Result of `mapped`.
    """
    count, axes = len(DIRECTIONS), ready.axes
    stands = [_stands(ready, index) for index in track.index]
    positions = np.array(stands)
    places = np.array([[at, *elsewhere(ready, at)] for at in stands])
    probes = np.concatenate([track.displacement[:, None], there.asked], axis=1)
    errors = _errors(ready, track.drive, places, probes)
    zeros = _zeros(ready, errors)
    errors = errors - zeros
    carried = np.array([axis.carried for axis in axes])
    displaced = probes[..., :count] + errors @ carried
    asked = _by_axis(ready, displaced)
    lines = [
        line_over(axis.asked, one[:, : axis.asked.size], axis.reference)
        for axis, one in zip(axes, asked, strict=True)
    ]
    values: Values = {
        "displacement": displaced[:, 0],
        "axis_position": positions,
        "axis_way": np.stack([gone(axis, times) for axis in axes], axis=1),
        "running_heat": track.inputs[:, -len(axes) :],
        "asked_position": np.array(_even([axis.asked for axis in axes])),
        "asked_displacement": np.stack(asked, axis=1),
        "reference_position": np.array([axis.reference for axis in axes]),
        "line_offset": np.stack([line.offset for line in lines], axis=1),
        "line_slope": np.stack([line.slope for line in lines], axis=1),
        "line_left": np.stack([line.left for line in lines], axis=1),
    }
    coords: dict[str, np.ndarray | list[str]] = {"moving_axis": [axis.name for axis in axes]}
    if any(axis.drive is not None for axis in axes):
        own = [one[..., a] for a, one in enumerate(_by_axis(ready, errors))]
        values["positioning_error"] = errors[:, 0]
        values["asked_positioning_error"] = np.stack(own, axis=1)
        driven, stations = _drive_values(ready, track.drive, probes[:, 0])
        values, coords = values | driven, coords | stations
    if ready.turned:
        turned = slice(count, 2 * count)
        values["rotation"] = track.displacement[:, turned]
        values["asked_rotation"] = np.stack(_by_axis(ready, probes[..., turned]), axis=1)
    at = _surveyed(ready, track)
    if at.size:
        values |= _volume_values(ready, track.drive[at], zeros[at], there.volume)
        values["volume_gap_residual"] = there.residual
        coords["survey"] = times[at]
    return values, coords


def _volume_values(ready: MovingSetup, states: Array, zeros: Array, probes: Array) -> Values:
    """Variables at the points of the volume (v, a), from probes (t, v, p) in states (t, d)."""
    count, places = len(DIRECTIONS), ready.volume.places
    at = np.broadcast_to(places, (len(states), *places.shape))
    errors = _errors(ready, states, at, probes) - zeros
    carried = np.array([axis.carried for axis in ready.axes])
    values = {
        "volume_position": places,
        "volume_displacement": probes[..., :count] + errors @ carried,
    }
    return values | ({"volume_rotation": probes[..., count : 2 * count]} if ready.turned else {})


def _by_axis(ready: MovingSetup, values: Array) -> list[Array]:
    """Values at the requested positions of each axis, of (n, 1 + c, ...) at all positions."""
    ends = 1 + np.cumsum([axis.asked.size for axis in ready.axes])
    return _even(np.split(values, [1, *ends], axis=1)[1:-1], axis=1)


def _even(parts: Sequence[Array], axis: int = 0) -> list[Array]:
    """Pad arrays to equal length along an axis by repeating their last values."""
    most = max(part.shape[axis] for part in parts)
    return [
        np.take(part, np.minimum(np.arange(most), part.shape[axis] - 1), axis) for part in parts
    ]


def _errors(ready: MovingSetup, states: Array, places: Array, probes: Array) -> Array:
    """Positioning errors (n, c, a) in states (n, d) at places (n, c, a) with probes (n, c, p).

    The errors at the zero positions of the drives are not subtracted yet.
    """
    errors = np.zeros(places.shape)
    for a, (axis, part) in enumerate(zip(ready.axes, parts_of(ready.axes), strict=True)):
        if (drive := axis.drive) is not None:
            seats = seated(drive, probes)
            errors[..., a] = positioning_error(drive, states[:, part], places[..., a], seats)
    return errors


def _zeros(ready: MovingSetup, errors: Array) -> Array:
    """Errors (n, 1, a) of each axis at its zero position, from all errors (n, 1 + c, a)."""
    zeros, there = np.zeros((len(errors), 1, len(ready.axes))), _set_right(ready)
    for k, (a, _) in enumerate(there, errors.shape[1] - len(there)):
        zeros[:, 0, a] = errors[:, k, a]
    return zeros


def _drive_values(
    ready: MovingSetup, states: Array, probes: Array
) -> tuple[Values, dict[str, np.ndarray | list[str]]]:
    """Variables and coordinates of drives in states (n, d), with probes (n, p); 0 without one."""
    drives = [axis.drive for axis in ready.axes]
    own = [states[:, part] for part in parts_of(ready.axes)]
    values: Values = {}
    if any(drive is not None and drive.scale is not None for drive in drives):
        values["scale_temperature"] = np.stack(
            [
                state[:, -1]
                if drive is not None and drive.scale is not None
                else np.zeros(len(state))
                for drive, state in zip(drives, own, strict=True)
            ],
            axis=1,
        )
    if not any(drive is not None and drive.screw is not None for drive in drives):
        return values, {}
    each = [_screw_values(drive, state, probes) for drive, state in zip(drives, own, strict=True)]
    places, warm, pulled = zip(*each, strict=True)
    values["station_position"] = np.stack(_even(places))
    values["screw_temperature"] = np.stack(_even(warm, axis=1), axis=1)
    values["screw_tension"] = np.stack(pulled, axis=1)
    return values, {"station": np.arange(1, values["station_position"].shape[1] + 1)}


def _screw_values(drive: Drive | None, states: Array, probes: Array) -> tuple[Array, Array, Array]:
    """Cells (k,), m, their temperatures (n, k), K, and tension (n,), N, of an axis's screw."""
    count = len(states)
    if drive is None or (screw := drive.screw) is None:
        return np.zeros(1), np.zeros((count, 1)), np.zeros(count)
    pulled = screw_tension(screw, states, seated(drive, probes))
    return station_positions(screw), screw_temperature(screw, states), pulled
