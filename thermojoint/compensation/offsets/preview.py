"""Preview of the offsets in every control cycle, from a table of estimates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from estimator.estimate_table import Row
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import unknown_name
from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.output import at_zero, cycle, followed, mode_of, offsets_of
from thermojoint.compensation.offsets.settings import Settings
from thermojoint.compensation.offsets.usable import usable


class Cycle(NamedTuple):
    """Offsets of one cycle.

    Attributes
    ----------
    time : float
        s.
    offsets : ndarray, shape (control's axes,)
        m.
    state : str
        ``follow``, ``freeze``, or ``decay``; ``wait`` before the first usable estimate.
    """

    time: float
    offsets: Array
    state: str


def preview(settings: Settings, axes: Sequence[str], rows: Sequence[Row]) -> Iterator[Cycle]:
    """Yield the offsets that the control receives, in every cycle of the estimates.

    Parameters
    ----------
    settings : Settings
        The compensation output.
    axes : sequence of str
        Axes of the estimates.
    rows : sequence of Row
        Estimates, one or more.

    Raises
    ------
    InputError
        The estimate lacks an axis that is followed.
    """
    for name in settings.output.estimated:
        if name not in axes:
            raise unknown_name("axis", name, axes, "axes: the estimate has")
    times = np.array([row.time for row in rows])
    state = at_zero(settings.output)
    # Rounding must not drop the last cycle.
    count = math.floor((times[-1] - times[0]) / settings.cycle + 1e-9) + 1
    for index in range(count):
        time = float(times[0] + index * settings.cycle)
        row = rows[int(np.searchsorted(times, time * (1.0 + 1e-12), side="right")) - 1]
        used = usable(settings.trust, time - row.time, row.band, row.status)
        target = followed(settings.output, axes, row.displacement) if used else None
        state = cycle(settings.output, state, time, target)
        yield Cycle(time, offsets_of(settings.output, state), mode_of(settings.output, state).value)


def header(settings: Settings) -> list[str]:
    """Return the columns of a preview."""
    return ["time_s", *(f"offset_{name}_um" for name in settings.output.names), "state"]


def row_of(settings: Settings, cycle: Cycle) -> list[str]:
    """Return one cycle as text, in the order of `header`."""
    digits = max(0, -math.floor(math.log10(settings.output.resolution / MICRO) + 1e-9))
    values = (f"{value / MICRO:.{digits + 2}f}" for value in cycle.offsets)
    # Fifteen digits, as in the table of estimates: seconds since 1970.
    return [f"{cycle.time:.15g}", *values, cycle.state]
