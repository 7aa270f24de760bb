"""Running period of a test: the whole record, or from the first to the last motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log_record import PAUSE
from thermojoint.standards.iso230_3.record import Record

#: A shorter gap in the readings hides no extreme of a machine that warms up, s.
_BRIDGED = 300.0


class Period(NamedTuple):
    """From `begin` to `end`, s."""

    begin: float
    end: float

    @property
    def length(self) -> float:
        """Duration, s."""
        return self.end - self.begin


def whole(record: Record) -> Period:
    """Return the period of the whole record."""
    return Period(float(record.times[0]), float(record.times[-1]))


def running(times: Array, drive: Array) -> Period:
    """Return the period from the first to the last motion.

    Stops in between, as in a spectrum of speeds, are included; a pause of the record before the
    first motion is not.

    Parameters
    ----------
    times : ndarray, shape (n,)
        s.
    drive : ndarray, shape (n,)
        Speed or heat input of the interval that ends at the sample; NaN means no motion.

    Raises
    ------
    InputError
        There is no motion.
    """
    moving = np.flatnonzero(np.nan_to_num(drive) != 0.0)
    if not moving.size:
        raise InputError("drive: zero throughout; name the column of the speed, or give the period")
    first = int(moving[0])
    if first > 0 and times[first] - times[first - 1] <= _longest_bridged(times):
        first -= 1
    return Period(float(times[first]), float(times[moving[-1]]))


def _longest_bridged(times: Array) -> float:
    """Longest time between readings, s, that is no gap: `PAUSE` usual intervals, or `_BRIDGED`."""
    return max(_BRIDGED, PAUSE * float(np.median(np.diff(times))))


def runs_at_first(record: Record, period: Period) -> bool:
    """Return whether the drive of a record moves in the first sample of a period already."""
    if record.drive is None:
        return False
    return bool(np.nan_to_num(record.drive[np.searchsorted(record.times, period.begin)]) != 0.0)


def longest_unread(record: Record, period: Period) -> dict[Period, list[str]]:
    """Return the longest gap in the readings of each channel that may hide an extreme, by its time.

    A gap is longer than `PAUSE` usual intervals and than `_BRIDGED`, and lies in the period.
    """
    least = _longest_bridged(record.times)
    found: dict[Period, list[str]] = {}
    for channels in record.channels.values():
        for name, values in channels.items():
            times = record.times[np.isfinite(values)]
            inside = (times[1:] > period.begin) & (times[:-1] < period.end)
            gaps = np.where(inside, np.diff(times), 0.0)
            if gaps.max(initial=0.0) > least:
                at = int(gaps.argmax())
                found.setdefault(Period(float(times[at]), float(times[at + 1])), []).append(name)
    return found


def asked_for(record: Record, usual: Period, begin: float | None, end: float | None) -> Period:
    """Return a period with the start and end (s) given by the user in place of those detected.

    Raises
    ------
    InputError
        The period ends before it starts, or lies outside the record.
    """
    period = Period(usual.begin if begin is None else begin, usual.end if end is None else end)
    first, last = whole(record)
    if not first <= period.begin < period.end <= last:
        raise InputError(
            f"period: {period.begin / 60.0:g} to {period.end / 60.0:g} min, the record has "
            f"{first / 60.0:g} to {last / 60.0:g} min; give a period within it"
        )
    return period
