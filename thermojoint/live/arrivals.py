"""Readings of one machine at one time, as delivered by a reader."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

#: No source calls a reading so.
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
    told : sequence of float or None
        One for each of its readings; None: not told, NaN: said to be missing.
    came : float
        When it arrived, s since 1970.
    position : JSON value
        How far the source was read with it; None for a source that cannot be read again from there.
    kept : callable or None
        Called once nothing of it can be lost any more.
    """

    machine: str
    time: float
    told: Sequence[float | None]
    came: float
    position: Any = None
    kept: Callable[[], None] | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """Something that a reader noticed: an event of the service.

    Attributes
    ----------
    kind : str
        E.g. ``malformed``.
    text : str
        What and where, in one line.
    machine : str or None
        If it is of one.
    """

    kind: str
    text: str
    machine: str | None = None
