"""What a control will receive: offsets in every cycle, from an estimate that stands in a file."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.units import MICRO
from thermojoint.compensation.offsets.output import at_zero, cycle, followed, offsets_of
from thermojoint.compensation.offsets.settings import Settings
from thermojoint.compensation.offsets.usable import usable

_TOTAL, _BAND, _UNIT = "total_", "band_", "_um"


class Row(NamedTuple):
    """One row of an estimate.

    Attributes
    ----------
    time : float
        s.
    displacement, band : ndarray, shape (axes,)
        m; NaN where the cell is empty.
    status : str
        In words.
    """

    time: float
    displacement: Array
    band: Array
    status: str


class Cycle(NamedTuple):
    """What a control receives in one cycle.

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


def read_estimate(lines: Iterable[str], where: str) -> tuple[tuple[str, ...], list[Row]]:
    """Return the axes and the rows of an estimate of any estimator.

    Parameters
    ----------
    lines : iterable of str
        A CSV with the columns ``time_s``, ``total_AXIS_um``, ``band_AXIS_um`` and ``status``; the
        bands may be missing, other columns are ignored.
    where : str
        Name of the file, for error messages.

    Raises
    ------
    InputError
        A column is missing, a value is no number, time does not increase, or there is no row.
    """
    reader = csv.reader(lines)
    try:
        table = [(reader.line_num, row) for row in reader if row]
    except csv.Error as error:
        raise InputError(f"{where}: not readable as CSV ({error}); mend the file") from error
    header = [name.strip().lstrip("\ufeff") for name in table[0][1]] if table else []
    axes = tuple(
        name[len(_TOTAL) : -len(_UNIT)]
        for name in header
        if name.startswith(_TOTAL) and name.endswith(_UNIT)
    )
    if not axes or "time_s" not in header or "status" not in header:
        raise InputError(
            f"{where}: no estimate, columns {', '.join(header) or 'none'}; give what "
            "`thermojoint estimate` writes"
        )
    rows: list[Row] = []
    for number, row in table[1:]:
        line = f"{where}, line {number}"
        if len(row) != len(header):
            raise InputError(f"{line}: {len(row)} values, expected {len(header)}; mend the row")
        cells = dict(zip(header, row, strict=True))
        time = _number(cells["time_s"], line)
        last = rows[-1].time if rows else -math.inf
        if not last < time < math.inf:
            raise InputError(
                f"{line}: time {time:g} s does not come after {last:g} s; drop or re-order it"
            )
        totals, bands = (
            MICRO
            * np.array([_number(cells.get(f"{part}{axis}{_UNIT}", ""), line) for axis in axes])
            for part in (_TOTAL, _BAND)
        )
        rows.append(Row(time, totals, bands, cells["status"].strip()))
    if not rows:
        raise InputError(f"{where}: holds no row; give an estimate of some length")
    return axes, rows


def preview(settings: Settings, axes: Sequence[str], rows: Sequence[Row]) -> Iterator[Cycle]:
    """Yield what the control receives, in every cycle from the first to the last estimate.

    Parameters
    ----------
    settings : Settings
        The compensation output.
    axes : sequence of str
        Of the estimates.
    rows : sequence of Row
        The estimates, one or more.

    Raises
    ------
    InputError
        An axis that a control's axis follows is not among those of the estimate.
    """
    for name in settings.output.estimated:
        if name not in axes:
            raise unknown_name("axis", name, axes, "axes: the estimate has")
    times = np.array([row.time for row in rows])
    state = at_zero(settings.output)
    # The last cycle may come after the last estimate by a rounding, not before it.
    count = math.floor((times[-1] - times[0]) / settings.cycle + 1e-9) + 1
    used_before = False
    for index in range(count):
        time = float(times[0] + index * settings.cycle)
        row = rows[int(np.searchsorted(times, time * (1.0 + 1e-12), side="right")) - 1]
        used = usable(settings.trust, time - row.time, row.band, row.status)
        target = followed(settings.output, axes, row.displacement) if used else None
        state = cycle(settings.output, state, time, target)
        used_before |= math.isnan(state.unusable_since)
        yield Cycle(
            time,
            offsets_of(settings.output, state),
            _named(settings, state.unusable_since, time) if used_before else "wait",
        )


def header(settings: Settings) -> list[str]:
    """Return the columns of a preview."""
    return ["time_s", *(f"offset_{name}_um" for name in settings.output.names), "state"]


def row_of(settings: Settings, one: Cycle) -> list[str]:
    """Return one cycle as text, in the order of `header`."""
    digits = max(0, -math.floor(math.log10(settings.output.resolution / MICRO) + 1e-9))
    values = (f"{value / MICRO:.{digits + 2}f}" for value in one.offsets)
    return [f"{one.time:.9g}", *values, one.state]


def _named(settings: Settings, since: float, time: float) -> str:
    if math.isnan(since):
        return "follow"
    return "freeze" if time - since <= settings.output.freeze_time else "decay"


def _number(text: str, line: str) -> float:
    try:
        return float(text) if text.strip() else math.nan
    except ValueError:
        raise InputError(f"{line}: {text!r} is no number; mend the row") from None
