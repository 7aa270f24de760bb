"""What a response says of a moving axis: positions, displacements asked for, lines, its drive."""

from __future__ import annotations

import numpy as np

from fesim.axes.line import line_over
from fesim.axes.mapping import displaced_at
from fesim.axes.positioning import (
    Screw,
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


def mapped(ready: MovingSetup, track: Track) -> Array:
    """Return the displacement probes (n, k, p) of each step at each position asked for.

    Last at that where a drive is set right, if there is one.
    """
    steps = [track.step(at) for at in range(len(track))]
    positions = [*ready.asked, *_zero(ready)]
    return np.array(
        [[displaced_at(ready.moving, step, float(at)) for at in positions] for step in steps]
    )


def _zero(ready: MovingSetup) -> list[float]:
    """Position at which a drive is set right, m, if there is one."""
    drive = ready.drive
    return [] if drive is None or drive.zero is None else [drive.zero]


def course_values(
    ready: MovingSetup, times: np.ndarray, track: Track, there: Array
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray | list[str]]]:
    """Return variables and coordinates of a response.

    Parameters
    ----------
    ready : MovingSetup
        The set-up.
    times : ndarray, shape (n,)
        s.
    track : Track
        Steps that end at these times.
    there : ndarray, shape (n, k, p)
        By `mapped`.
    """
    count = len(DIRECTIONS)
    position = ready.course(times)
    values, coords = _drive_values(ready, track, position, there)
    there = there[:, : ready.asked.size]
    displaced, asked = track.displacement[:, :count], there[..., :count]
    if "positioning_error" in values:
        displaced = displaced + values["positioning_error"] * ready.carried
        asked = asked + values["asked_positioning_error"][:, 0, :, None] * ready.carried
    line = line_over(ready.asked, asked, ready.reference)
    values |= {
        "displacement": displaced,
        "axis_position": position[:, None],
        "running_heat": track.inputs[:, -1:],
        "asked_position": ready.asked[None],
        "asked_displacement": asked[:, None],
        "reference_position": np.array([ready.reference]),
        "line_offset": line.offset[:, None],
        "line_slope": line.slope[:, None],
        "line_left": line.left[:, None],
    }
    if ready.turned:
        turned = slice(count, 2 * count)
        values["rotation"] = track.displacement[:, turned]
        values["asked_rotation"] = there[:, None, :, turned]
    return values, coords | {"moving_axis": [ready.name]}


def _drive_values(
    ready: MovingSetup, track: Track, position: Array, there: Array
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray | list[str]]]:
    """Variables and coordinates of a drive, at positions (n,); none without one."""
    drive = ready.drive
    if drive is None:
        return {}, {}
    elsewhere = np.array([*ready.asked, *_zero(ready)])
    places = np.hstack([position[:, None], np.tile(elsewhere, (len(track), 1))])
    probes = np.concatenate([track.displacement[:, None], there], axis=1)
    seats = seated(drive, probes)
    error = np.array(
        [positioning_error(drive, *one) for one in zip(track.drive, places, seats, strict=True)]
    )
    if drive.zero is not None:
        error = error[:, :-1] - error[:, -1:]
    values = {"positioning_error": error[:, :1], "asked_positioning_error": error[:, None, 1:]}
    if drive.scale is not None:
        values["scale_temperature"] = track.drive[:, -1:]
    if drive.screw is None:
        return values, {}
    return values | _screw_values(drive.screw, track.drive, seats[:, 0]), {
        "station": np.arange(1, station_positions(drive.screw).size + 1)
    }


def _screw_values(screw: Screw, states: Array, seats: Array) -> dict[str, np.ndarray]:
    """Variables of a screw in states (n, d) with seats (n, 3)."""
    pulled = [screw_tension(screw, *one) for one in zip(states, seats, strict=True)]
    return {
        "station_position": station_positions(screw)[None],
        "screw_temperature": screw_temperature(screw, states)[:, None],
        "screw_tension": np.array(pulled)[:, None],
    }
