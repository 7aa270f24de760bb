"""Estimates as rows of a table, units in the names of the columns; displacements in µm."""

from __future__ import annotations

from estimator.interface import Channel, Estimate, Estimator
from thermojoint.artefacts.units import MEGA


def header(estimator: Estimator) -> list[str]:
    """Return the columns: time, what the estimator says of its own, δ, its band, the status."""
    return [
        "time_s",
        *(_column(channel) for channel in estimator.details),
        *(f"{part}_{axis}_um" for part in ("total", "band") for axis in estimator.axes),
        "status",
    ]


def row(estimator: Estimator, estimate: Estimate) -> list[str]:
    """Return one estimate as text, in the order of `header`; empty where there is no band."""
    scales = (MEGA if channel.unit == "m" else 1.0 for channel in estimator.details)
    values = [
        estimate.time,
        *(scale * value for scale, value in zip(scales, estimate.details, strict=True)),
        *(MEGA * estimate.displacement),
        *(MEGA * estimate.band),
    ]
    texts = (f"{float(value):.9g}" if value == value else "" for value in values)
    return [*texts, estimate.words]


def _column(channel: Channel) -> str:
    suffix = {"m": "_um", "1": ""}.get(channel.unit, f"_{channel.unit}")
    return f"{channel.name}{suffix}"
