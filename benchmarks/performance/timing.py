"""Medians of repeated runs, two things in turn, so that a machine that slows down slows both."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class Row:
    """One line of ``bench.json``."""

    #: Compared quantity.
    name: str
    #: Medians, in `unit`.
    ours: float
    other: float
    #: How many times less ours is, or how many times more where it is a rate; median of the ratios
    #: run by run where both were repeated.
    ratio: float
    #: Of ours and other.
    unit: str
    #: Measured quantity, number of runs, and scaling.
    note: str


@dataclass(frozen=True)
class Skipped:
    """A row that cannot be measured on this machine, and why."""

    name: str
    reason: str


#: Tells the time, s.
Clock = Callable[[], float]


def seconds(call: Callable[[], object], clock: Clock = time.perf_counter) -> float:
    """Time of one call, s; wall time unless another clock is given."""
    begun = clock()
    call()
    return clock() - begun


def paired(
    ours: Callable[[], object],
    other: Callable[[], object],
    repeats: int,
    clock: Clock = time.perf_counter,
) -> tuple[float, float, float]:
    """Time two calls in turn; return both medians (s) and the median of other / ours."""
    return medians([(seconds(ours, clock), seconds(other, clock)) for _ in range(repeats)])


def medians(pairs: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """Return the medians of ours and of the other's, and the median of other / ours."""
    return (
        median(one for one, _ in pairs),
        median(two for _, two in pairs),
        median(two / one for one, two in pairs),
    )
