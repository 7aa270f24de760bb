"""States before any sample: of a machine at rest, and of one with an unknown past."""

from __future__ import annotations

import numpy as np

from estimator import sensor_faults
from estimator.joint_aware import displacement_readings, fault_isolation
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_state import KNOWN, UNKNOWN, ObserverState
from thermojoint.artefacts.arrays import Array


def at_rest(observer: Observer) -> ObserverState:
    """Return the state of a machine at rest at ambient temperature."""
    return _before_any_sample(observer, observer.known_start, KNOWN)


def unknown_past(observer: Observer) -> ObserverState:
    """Return the state of a machine with an unknown past."""
    return _before_any_sample(observer, observer.unknown_start, UNKNOWN)


def _before_any_sample(observer: Observer, factor: Array, slip_knowledge: float) -> ObserverState:
    """State before any sample with a covariance factor (n + p + 1, k)."""
    model, size, ways = observer.model, observer.system.size, len(observer.model.ways)
    unseen, drives = np.array(np.nan), model.modes.drives
    start = np.zeros(size)
    start[size - model.first.size - 1 : -1] = model.first
    if slip_knowledge == KNOWN:
        start[: model.modes.start.size] = model.modes.start
    return ObserverState(
        time=unseen,
        begun=unseen,
        slip_knowledge=np.array(slip_knowledge),
        linear=start,
        loads=model.modes.factors,
        **observer.physics.at_rest()._asdict(),
        covariance_factor=factor,
        errors=np.zeros(len(observer.rows)),
        drive=np.zeros(0) if drives is None else drives.cold,
        odometer=np.full(ways, np.nan),
        power_heat=np.zeros(len(model.powers)),
        watch=sensor_faults.new_watch(len(observer.system.rows), observer.thresholds.faults),
        model_error=displacement_readings.unknown(sum(model.band.shared), len(model.axes)),
        pending=fault_isolation.none(size),
        steps=np.array(0.0),
        odometer_age=np.zeros(ways),
        away=np.zeros(2 * ways),
        back=np.zeros(2 * ways),
        position_away=np.zeros(len(model.positions)),
        position_back=np.zeros(len(model.positions)),
    )
