"""Displacement readings requested by an estimator: asked, taken, postponed, withdrawn.

All times are times of samples, so that a replay requests readings at the same samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, NamedTuple

from estimator.intake import axis_name
from estimator.interface import NextReading
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MEGA


@dataclass(frozen=True)
class RequestLimits:
    """Conditions for requesting readings."""

    #: Largest half-width of the band, m.
    limit: float
    #: Shortest time between two requests, s.
    interval: float
    #: Function of the estimator's state that returns the reading to take, or None.
    next_reading: Callable[[Array], NextReading | None]


class ReadingRequest(NamedTuple):
    """The present request of a machine, or its last one."""

    #: Axis to be read; empty without a request.
    axis: str = ""
    #: Time of the last request, s since 1970.
    since: float = math.nan
    #: Half-width of the axis's band at that time, and expected half-width after a reading, m.
    band: float = math.nan
    narrowed: float = math.nan
    #: No request before this time, s since 1970.
    not_before: float = -math.inf
    #: ``asked``, or how the last request ended: ``taken``, ``postponed``, ``withdrawn``; empty
    #: before the first.
    outcome: str = ""

    @property
    def text(self) -> str:
        """The request, or its outcome, as a sentence."""
        if not self.axis:
            return self.outcome
        return (
            f"{self.axis}: the band of {MEGA * self.band:.2g} um would narrow to "
            f"{MEGA * self.narrowed:.2g} um"
        )

    @property
    def content(self) -> dict[str, Any] | None:
        """The request for JSON; None without a request."""
        if not self.axis:
            return None
        return {
            "axis": self.axis,
            "since_s": self.since,
            "band_um": round(MEGA * self.band, 4),
            "narrowed_um": round(MEGA * self.narrowed, 4),
        }


def after_sample(
    limits: RequestLimits,
    request: ReadingRequest,
    instant: float,
    read: Collection[str],
    band: Array,
    state: Array,
) -> ReadingRequest:
    """Return the request after a sample, taken at an instant (s since 1970).

    `read` are the axes whose displacement was read in it; `band`, shape (axes,), are the
    half-widths after it, m, and `state` is the estimator's state after it.
    """
    if request.axis in read:
        return ended(limits, request, instant, "taken")
    wide = bool((band > limits.limit).any())
    if not request.axis and (not wide or instant < request.not_before):
        return request
    reading = limits.next_reading(state) if wide else None
    if reading is None or reading.due > 0.0:
        return ended(limits, request, instant, "withdrawn") if request.axis else request
    if request.axis:
        return request
    axis = axis_name(reading.axis)
    return ReadingRequest(
        axis, instant, reading.band, reading.narrowed, request.not_before, "asked"
    )


def ended(
    limits: RequestLimits, request: ReadingRequest, instant: float, outcome: str
) -> ReadingRequest:
    """End the request, and suppress further ones for some time."""
    return request._replace(axis="", not_before=instant + limits.interval, outcome=outcome)
