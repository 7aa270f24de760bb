"""What a response says of a moving axis: positions, displacements asked for, lines."""

from __future__ import annotations

import numpy as np

from fesim.axes.mapping import displaced_at, line_over
from fesim.axes.setup import MovingSetup
from fesim.march.track import Track
from fesim.solid.elasticity import DIRECTIONS
from thermojoint.artefacts.arrays import Array


def mapped(ready: MovingSetup, track: Track) -> Array:
    """Return the displacement probes (n, k, p) of each step at each position asked for."""
    steps = [track.step(at) for at in range(len(track))]
    return np.array(
        [[displaced_at(ready.moving, step, float(at)) for at in ready.asked] for step in steps]
    )


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
    line = line_over(ready.asked, there[..., :count], ready.reference)
    values = {
        "axis_position": ready.course(times)[:, None],
        "running_heat": track.inputs[:, -1:],
        "asked_position": ready.asked[None],
        "asked_displacement": there[:, None, :, :count],
        "reference_position": np.array([ready.reference]),
        "line_offset": line.offset[:, None],
        "line_slope": line.slope[:, None],
        "line_left": line.left[:, None],
    }
    if there.shape[2] > count:
        values["rotation"] = track.displacement[:, count:]
        values["asked_rotation"] = there[:, None, :, count:]
    return values, {"moving_axis": [ready.name]}
