"""Thresholds of the observer, each with the study that determined it."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimator import sensor_faults
from estimator.joint_aware.displacement_readings import DisplacementProbe


@dataclass(frozen=True)
class Thresholds:
    """Thresholds at which an observer changes its behaviour.

    Unless another study is named, it is ``python -m benchmarks.sensor_faults``, which checks them
    together (docs/faulty-sensors.md).

    Attributes
    ----------
    faults : sensor_faults.Thresholds
        Thresholds of sensor fault detection.
    probe : DisplacementProbe
        Properties of displacement readings.
    room, further : float
        A reading is implausible beyond the calibrated range by more than this, K; above it also by
        this multiple of the range.
    thermometer : float
        Upper bound for the noise of a thermometer, K; the filter's own value includes model error.
    onset, onset_slack : float
        Admissible jumps of the heat: up to this multiple of the largest calibrated heat, with a
        tolerance relative to it on either side.
    decided, samples : float
        A jump is judged after this time, s, and this many samples.
    forgotten : float
        Columns of the covariance factor that move the readings by less than this fraction of their
        noise are dropped.
    followable : float
        The joint is tracked once the displacement is known to this, m (warm starts after 2, 4 and 6
        h, docs/joint-aware.md).
    doubt_of_heat : float
        Share of the lasting errors that counts when the past is known: then only the heat of some
        minutes is unknown, and not a field that may have built up over hours. Of 1, 0.3, 0.1 and
        0.03 on four random plants (docs/faulty-sensors.md) all but the last keep every band, and
        0.1 and 0.3 have the smallest errors.
    doubt_of_past : float
        The same when the past is unknown. Of 1, 0.5, 0.3 and 0.1 on warm starts after 2, 4 and 6 h
        (docs/joint-aware.md, on the initial state), 0.1 was off by twice as much.
    doubt : float
        The covariance factor ignores reading errors that last for hours: the displacement is this
        many times less certain than it says (warm starts after 2, 4 and 6 h, which were off by up
        to 2.6 times the band, docs/joint-aware.md).
    ambient : float
        Tolerated change of the ambient without a flag, K.
    lost : float
        Without any thermometer for longer than this, s, an estimate is bad: the heat may have been
        anything meanwhile. As a learned model, whose temperatures wander with this time constant.
    most_steps : int
        Most steps between two samples; after a longer gap they are longer.
    """

    faults: sensor_faults.Thresholds = field(default_factory=sensor_faults.Thresholds)
    probe: DisplacementProbe = field(default_factory=DisplacementProbe)
    room: float = 60.0
    further: float = 3.0
    thermometer: float = 0.05
    onset: float = 1.5
    onset_slack: float = 0.05
    decided: float = 12.0
    samples: int = 3
    forgotten: float = 1e-3
    followable: float = 1e-6
    doubt_of_heat: float = 0.2
    doubt_of_past: float = 0.3
    doubt: float = 3.0
    ambient: float = 10.0
    lost: float = 1800.0
    most_steps: int = 2000


#: The default thresholds.
USUAL = Thresholds()
