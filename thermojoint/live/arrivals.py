"""Readings of one machine at one time, as delivered by a reader."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

#: Name of a reading that no source has.
NEVER = "\0"


@dataclass(frozen=True, slots=True)
class Arrival:
    """Readings of one machine at one time.

    Attributes
    ----------
    machine : str
        Its name.
    time : float
        By the source's clock, s since 1970.
    readings : sequence of float or None
        One for each of its readings; None: did not come, NaN: reported as missing.
    came : float
        When it arrived, s since 1970.
    position : JSON value
        Read position of the source after it; None for a source that cannot be read again.
    kept : callable or None
        Called once it is stored.
    """

    machine: str
    time: float
    readings: Sequence[float | None]
    came: float
    position: Any = None
    kept: Callable[[], None] | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """Event reported by a reader.

    Attributes
    ----------
    kind : str
        E.g. ``malformed``.
    text : str
        What happened and where, in one line.
    machine : str or None
        The machine that it concerns, if it is one.
    """

    kind: str
    text: str
    machine: str | None = None
