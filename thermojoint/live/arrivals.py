"""Readings of one machine at one time, as delivered by a reader."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

#: Name of a reading that no source delivers.
ABSENT = "\0"


@dataclass(frozen=True, slots=True)
class Arrival:
    """Readings of one machine at one time."""

    machine: str
    #: Time by the source's clock, s since 1970.
    time: float
    #: One value for each of its readings; None if not delivered, NaN if reported as missing.
    readings: Sequence[float | None]
    #: Time at which the service received them, s since 1970.
    received_at: float
    #: Read position of the source after it; None for a source that cannot be read again.
    position: Any = None
    #: Called once the arrival is stored.
    acknowledge: Callable[[], None] | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """Event reported by a reader."""

    #: E.g. ``malformed``.
    kind: str
    #: Description and place of the event, in one line.
    text: str
    #: The machine concerned, if it is a single one.
    machine: str | None = None
