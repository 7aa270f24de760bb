"""Check of samples against the calibrated range."""

from __future__ import annotations

from collections.abc import Mapping

from estimator.interface import Status
from thermojoint.models.parameters import Span

#: A value is beyond what was calibrated if it is so by more than this part of the calibrated range.
SLACK = 0.05


def status_of(
    span: Span, elapsed: float, values: Mapping[str, float], heat: float | None = None
) -> Status:
    """Return how far an estimate can be trusted.

    Parameters
    ----------
    span : Span
        What the calibration has seen.
    elapsed : float
        Time since the run began, s.
    values : mapping
        Channel to its value, K.
    heat : float, optional
        Heat input; an estimator that knows none leaves it out.
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
    """Return the lowest and highest value that are not beyond a calibrated range."""
    low, high = span
    slack = SLACK * (high - low)
    return low - slack, high + slack


def _beyond(value: float, span: tuple[float, float]) -> bool:
    low, high = with_slack(span)
    return not low <= value <= high
