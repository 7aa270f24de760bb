"""Readings of one machine at one time, as delivered by a reader."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

#: Name of a reading that no source has.
NEVER = "\0"


@dataclass(frozen=True, slots=True)
class Arrival:
    """Readings of one machine at one time."""

    #: Its name.
    machine: str
    #: By the source's clock, s since 1970.
    time: float
    #: One for each of its readings; None: did not come, NaN: reported as missing.
    readings: Sequence[float | None]
    #: When it arrived, s since 1970.
    came: float
    #: Read position of the source after it; None for a source that cannot be read again.
    position: Any = None
    #: Called once it is stored.
    kept: Callable[[], None] | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """Event reported by a reader."""

    #: E.g. ``malformed``.
    kind: str
    #: What happened and where, in one line.
    text: str
    #: The machine that it concerns, if it is one.
    machine: str | None = None
