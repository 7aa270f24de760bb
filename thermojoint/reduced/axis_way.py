"""Ways of moving axes between two samples of their positions.

Positions alone show the least of a way. What an axis has gone beyond it, there and back, an
odometer tells: running friction heats with all of it. Where on the guide that was is not known, so
heat is spread over the way between the positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from fesim.axes.guideway import Place


class Way(NamedTuple):
    """What x axes do between two samples."""

    #: Positions from which to which they move evenly, m.
    start: Place
    end: Place
    #: How far each of them has gone, m: at least from one to the other.
    gone: Place


def way_between(start: Sequence[float], end: Sequence[float], gone: Sequence[float] = ()) -> Way:
    """Return a way between positions (x,), m, and by as much as odometers tell (x,), if they do."""
    least = [abs(after - before) for before, after in zip(start, end, strict=True)]
    whole = [max(pair) for pair in zip(least, gone, strict=True)] if len(gone) else least
    return Way(tuple(start), tuple(end), tuple(whole))
