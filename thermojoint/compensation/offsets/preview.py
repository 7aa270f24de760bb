"""Preview of the offsets in every control cycle, from a table of estimates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from estimator.estimate_table import Row, strokes_of
from estimator.interface import SILENT
from estimator.quality import reasons_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MICRO, MILLI
from thermojoint.compensation.offsets.output import (
    at_zero,
    band_along,
    cycle,
    followed,
    mode_of,
    offsets_of,
    slopes_of,
)
from thermojoint.compensation.offsets.settings import Settings, check_axes, with_slopes
from thermojoint.compensation.offsets.usable import usable

#: More cycles than this, tens of gigabytes of rows, indicate a wrong unit.
MOST_CYCLES = 1e9


class Cycle(NamedTuple):
    """Offsets of one cycle."""

    #: Time, s.
    time: float
    #: Shape (control's axes,): m.
    offsets: Array
    #: Shape (slopes,): slopes (m/m) and reference positions (m) of the axes with a slope.
    slopes: Array
    references: Array
    #: ``follow``, ``freeze``, or ``decay``; ``wait`` before the first usable estimate.
    state: str


def preview(
    settings: Settings, axes: Sequence[str], rows: Sequence[Row], where: str = "settings"
) -> Iterator[Cycle]:
    """Yield the offsets that the control receives, in every cycle of the estimates.

    Parameters
    ----------
    settings : Settings
        The compensation output.
    axes : sequence of str
        Axes of the estimates.
    rows : sequence of Row
        Estimates, one or more.
    where : str, optional
        Name of the settings, for messages.

    Raises
    ------
    InputError
        There is no row, the estimate lacks an axis, a position or a slope that is followed, or the
        cycles are too many to write.
    """
    if not rows:
        raise InputError(f"{where}: no rows; give estimates")
    check_axes(settings, (*axes, *rows[0].places), where)
    output = with_slopes(settings, strokes_of(axes, rows), where).output
    references = np.array([one.reference for one in output.slopes])
    times, heard = np.array([row.time for row in rows]), heard_by(rows)
    state = at_zero(output)
    # Rounding errors must not drop the last cycle.
    cycles = float(times[-1] - times[0]) / settings.cycle + 1e-9
    if cycles > MOST_CYCLES:
        raise InputError(
            f"cycle_s {settings.cycle:g}: more than {MOST_CYCLES:.0e} cycles in the "
            f"{times[-1] - times[0]:g} s of the estimates; make it longer"
        )
    count = math.floor(cycles) + 1
    for index in range(count):
        time = float(times[0] + index * settings.cycle)
        at = time + 1e-12 * abs(time)
        k = int(np.searchsorted(times, at, side="right")) - 1
        row = rows[k]
        band = band_along(output, axes, row.band, row.lines)
        used = usable(settings.trust, time - float(heard[k]), band, row.status)
        seen = row.displacement, row.lines, row.places
        target = followed(output, axes, *seen) if used else None
        state = cycle(output, state, time, target)
        offsets, slopes = offsets_of(output, state), slopes_of(output, state)
        yield Cycle(time, offsets, slopes, references, mode_of(output, state).value)


def heard_by(rows: Sequence[Row]) -> Array:
    """Return the time of the last estimate from any reading at each of some rows, s.

    The first row counts as one: as in the service, silence begins with the run.
    """
    heard = [(rows[0] if SILENT in reasons_of(row.status) else row).time for row in rows]
    return np.maximum.accumulate(heard)


def header(settings: Settings) -> list[str]:
    """Return the columns of a preview; with a slope the offset is K0."""
    return [
        "time_s",
        *(f"offset_{name}_um" for name in settings.output.names),
        *(f"slope_{name}_um_per_m" for name in settings.slopes),
        *(f"P0_{name}_mm" for name in settings.slopes),
        "state",
    ]


def row_of(settings: Settings, cycle: Cycle) -> list[str]:
    """Return one cycle as text, in the order of `header`."""
    step = settings.output.resolution / MICRO
    offsets = (_text(value / MICRO, step) for value in cycle.offsets)
    slopes = (
        _text(value / MICRO, section.resolution_um_per_m)
        for value, section in zip(cycle.slopes, settings.slopes.values(), strict=True)
    )
    references = (f"{value / MILLI:.9g}" for value in cycle.references)
    # Fifteen digits, as in the table of estimates: times may be seconds since 1970.
    return [f"{cycle.time:.15g}", *offsets, *slopes, *references, cycle.state]


def _text(value: float, step: float) -> str:
    """Return a value as text with two digits more than its step."""
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value:.{digits + 2}f}"
