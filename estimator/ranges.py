"""Calibrated ranges of a model, in readable form."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Range(NamedTuple):
    """Range of the calibration for one quantity."""

    #: Name of the quantity.
    name: str
    #: In `unit`.
    low: float
    high: float
    #: Of both; ``1`` if it has none.
    unit: str


def duration(seconds: float) -> Range:
    """Return the range of the time since the start of a run, min."""
    return Range("time since the start", 0.0, seconds / 60.0, "min")


def calibrated_ranges(
    seconds: float, heat: tuple[float, float], temperatures: Mapping[str, tuple[float, float]]
) -> tuple[Range, ...]:
    """Return the ranges of a calibration: its duration (s), heat input, and temperatures (K)."""
    return (
        duration(seconds),
        Range("heat", *heat, "of the reference"),
        *(Range(name, *span, "K") for name, span in temperatures.items()),
    )
