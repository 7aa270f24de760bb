"""Estimate after a sample that was processed: displacement, band, status, and channels left out."""

from __future__ import annotations

import numpy as np

from estimator.interface import Estimate, Status
from estimator.joint_aware import band
from estimator.joint_aware.axis_lines import lines_along
from estimator.joint_aware.displacement_readings import mean_of
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_state import ObserverState
from estimator.joint_aware.precomputed import Precomputed
from estimator.joint_aware.sample_processing import Processed, results_of
from estimator.joint_aware.sample_values import SampleValues
from estimator.span import SLACK
from thermojoint.artefacts.arrays import Array, Flags

Names = tuple[str, ...]


def estimate_of(
    data: Precomputed, processed: Processed, time: float, read: SampleValues
) -> Estimate:
    """Return the estimate after a sample with some values at a time (s)."""
    observer, after = data.observer, processed.after
    _, relaxed, means = results_of(observer, processed)
    since = float(after.time - after.begun)
    parts = observer.model_error(relaxed, processed.slip_knowledge, means, since)
    usual, left = band.variances(observer, parts, after.model_error, after.covariance_factor)
    unread = band.of_unreported_motion(data, after)
    unread = unread + band.of_missing_loads(observer, after, read.factors)
    half = band.WIDTH * np.sqrt(usual + left) + band.of_pending_jump(observer, after) + unread
    # Estimated from displacement readings, and from innovations.
    error = parts @ mean_of(after.model_error) + observer.displacement_by(means)
    moved, line = processed.displacement + error, np.empty(0)
    if observer.model.moving_axes:
        unplaced = np.isnan(read.factors[-len(observer.model.moving_axes) :])
        lines = lines_along(observer, processed, error, half, unplaced)
        unread = unread + lines.band_here - half
        moved, half, line = lines.displacement, lines.band, lines.details
    unsettled = observer.unsettled(left, usual, processed.often)
    unsettled |= bool((unread > band.WIDENED * band.WIDTH * np.sqrt(usual)).any())
    missing, distrusted = _left_out(data, read, processed.accepted)
    status = _beyond(data, processed, time, read.temperatures)
    for holds, flag in (
        (missing, Status.READING_MISSING),
        (distrusted, Status.SENSOR_DISTRUSTED),
        (processed.refused, Status.READING_REFUSED),
        (unsettled, Status.UNSETTLED),
        ((missing or distrusted) and _lost(observer, after, time), Status.READINGS_LOST),
    ):
        if holds:
            status |= flag
    inputs = after.linear[observer.system.decay.size :]
    pressure = after.pressure if after.pressure.size else np.array([np.nan])
    return Estimate(
        time=time,
        displacement=moved,
        band=half,
        status=status,
        details=np.concatenate([inputs, [pressure.min(), pressure.max()], line]),
        missing=missing,
        distrusted=distrusted,
    )


def _left_out(data: Precomputed, read: SampleValues, accepted: Flags) -> tuple[Names, Names]:
    """Missing channels, and channels that are present but excluded."""
    *given, _ = read
    empty = np.isnan(np.concatenate(given))
    if accepted.all() and not empty.any():
        return (), ()
    names = [channel.name for channel in data.channels[: empty.size]]
    excluded = zip(names, ~empty[: accepted.size] & ~accepted, strict=False)
    return (
        tuple(name for name, gone in zip(names, empty, strict=True) if gone),
        tuple(name for name, bad in excluded if bad),
    )


def _beyond(data: Precomputed, processed: Processed, time: float, readings: Array) -> Status:
    """Status bits for values outside the calibrated range."""
    observer, after, status = data.observer, processed.after, Status.OK
    calibrated, power = observer.model.calibrated, observer.model.power
    if time - float(after.begun) > (1.0 + SLACK) * calibrated.duration_s:
        status |= Status.BEYOND_TIME
    heat = after.linear[observer.heat] / power
    if heat.max() > (1.0 + SLACK) * calibrated.heat or heat.min() < -SLACK * calibrated.heat:
        status |= Status.BEYOND_HEAT
    if np.abs(heat).max() > observer.thresholds.implausible_heat * calibrated.heat:
        status |= Status.READINGS_LOST
    low, high = data.calibrated_readings
    if (processed.accepted & ((readings < low) | (readings > high))).any():
        status |= Status.BEYOND_TEMPERATURE
    return status


def _lost(observer: Observer, after: ObserverState, time: float) -> bool:
    """Whether every thermometer has been missing or distrusted for too long."""
    count = len(observer.model.sensors)
    read = np.where(after.watch.distrusted > 0.0, np.nan, after.watch.read)[:count]
    last = np.fmax.reduce(read, initial=float(after.begun))
    return bool(time - last > observer.thresholds.lost)
