"""Check of samples against the calibrated range."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from estimator.interface import Status
from thermojoint.models.parameters import Span

#: A value is beyond the calibrated range if it exceeds it by more than this fraction of the range.
SLACK = 0.05
#: An unknown past has died out to 5 % after this many of a model's slowest time constants.
SETTLING = 3.0
#: After a pause of more than this, s, and than this many nominal intervals, the past is unknown.
PAUSE, INTERVALS = 600.0, 3.0


@dataclass(frozen=True)
class Settling:
    """Unsettled time after a start on a warm machine, for estimators without a covariance.

    Such an estimator starts as if the machine were cold. A machine is warm if a sensor at the joint
    reads more than `SLACK` of its calibrated range above the ambient; those near the source may do
    so within a sample.
    """

    #: Calibrated ranges.
    span: Span
    #: Sensors at the joint.
    sensors: tuple[str, ...]
    #: Slowest time constant of the model, s; limited to the calibrated duration.
    slowest: float
    #: Sampling interval, s.
    nominal: float

    @property
    def duration(self) -> float:
        """Time after which an unknown past no longer has an effect, s."""
        return SETTLING * min(self.slowest, self.span.duration_s)

    @property
    def longest_pause(self) -> float:
        """Longest interval between samples after which the past is still known, s."""
        return max(PAUSE, INTERVALS * self.nominal)

    @property
    def cold(self) -> dict[str, float]:
        """Largest rise of each sensor of a machine that counts as cold, K."""
        ranges = ((name, self.span.temperatures[name]) for name in self.sensors)
        return {name: SLACK * max(abs(low), abs(high)) for name, (low, high) in ranges}

    def until(self, last: float, before: float, time: float, values: Mapping[str, float]) -> float:
        """Return the time up to which an estimator is unsettled, s; NaN if it never was.

        Parameters
        ----------
        last : float
            Time of the previous sample, s; NaN before the first.
        before : float
            Result of this function at the previous sample, s.
        time : float
            Time of the sample, s.
        values : mapping
            Channel to its value, K.
        """
        if time - last <= self.longest_pause:
            return before
        warm = any(abs(values[name]) > limit for name, limit in self.cold.items())
        return time + self.duration if warm else math.nan


def status_of(
    span: Span, elapsed: float, values: Mapping[str, float], heat: float | None = None
) -> Status:
    """Return the status of an estimate with respect to the calibrated range.

    `elapsed` is the time since the start of the run, s; `values` map channels to temperatures, K.
    """
    status = Status.OK
    if elapsed > (1.0 + SLACK) * span.duration_s:
        status |= Status.BEYOND_TIME
    if heat is not None and _beyond(heat, span.heat):
        status |= Status.BEYOND_HEAT
    if any(_beyond(value, span.temperatures[name]) for name, value in values.items()):
        status |= Status.BEYOND_TEMPERATURE
    return status


def with_slack(span: tuple[float, float]) -> tuple[float, float]:
    """Return a calibrated range widened by `SLACK`."""
    low, high = span
    slack = SLACK * (high - low)
    return low - slack, high + slack


def _beyond(value: float, span: tuple[float, float]) -> bool:
    low, high = with_slack(span)
    return not low <= value <= high
