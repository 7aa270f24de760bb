"""What a model was calibrated for, as a person reads it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from estimator.fchs.estimator import Fchs
from estimator.interface import Estimator
from estimator.joint_aware.estimator import JointAware
from estimator.learned.estimator import Learned
from thermojoint.artefacts.quantities import column_named


class Range(NamedTuple):
    """Where a calibration has been.

    Attributes
    ----------
    name : str
        Of what.
    low, high : float
        In `unit`.
    unit : str
        Of both; ``1`` if it has none.
    """

    name: str
    low: float
    high: float
    unit: str


def ranges_of(estimator: Estimator) -> tuple[Range, ...]:
    """Return what an estimator was calibrated for; nothing for a kind that does not say."""
    if isinstance(estimator, JointAware):
        known = estimator.model.calibrated
        return _ranges(known.duration_s, (0.0, known.heat), known.temperatures)
    if isinstance(estimator, Fchs):
        span = estimator.assembly.model.span
        return _ranges(span.duration_s, span.heat, span.temperatures)
    if isinstance(estimator, Learned):
        model = estimator.model
        return (_duration(model.duration_s), *(_seen(*one) for one in model.spans.items()))
    return ()


def _ranges(
    duration: float, heat: tuple[float, float], temperatures: Mapping[str, tuple[float, float]]
) -> tuple[Range, ...]:
    return (
        _duration(duration),
        Range("heat", *heat, "of the reference"),
        *(Range(name, *span, "K") for name, span in temperatures.items()),
    )


def _duration(seconds: float) -> Range:
    return Range("time since the start", 0.0, seconds / 60.0, "min")


def _seen(name: str, span: tuple[float, float]) -> Range:
    """The range of a column of a log, in the column's own unit."""
    column = column_named(name)
    if column is None:
        return Range(name, *span, "1")
    low, high = column.from_si(np.array(span)).tolist()
    return Range(column.base, low, high, column.unit)
