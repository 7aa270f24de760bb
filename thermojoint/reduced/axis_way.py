"""Travel of moving axes between two samples of their positions.

Positions alone give a lower bound of the travel. An odometer also counts motion to and fro, which
causes friction heat as well. Its place on the guide is not known, so the heat is spread over the
way between the positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from fesim.axes.guideway import Place


class Way(NamedTuple):
    """Motion of x axes between two samples."""

    #: Positions between which they move uniformly, m.
    start: Place
    end: Place
    #: Travel of each of them, m: at least the distance of these positions.
    gone: Place


def way_between(start: Sequence[float], end: Sequence[float], gone: Sequence[float] = ()) -> Way:
    """Return a way between positions (x,), m, with the travel by odometers (x,), if any."""
    least = [abs(after - before) for before, after in zip(start, end, strict=True)]
    whole = [max(pair) for pair in zip(least, gone, strict=True)] if len(gone) else least
    return Way(tuple(start), tuple(end), tuple(whole))
