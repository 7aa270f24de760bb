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
    """

    #: Thresholds of sensor fault detection.
    faults: sensor_faults.Thresholds = field(default_factory=sensor_faults.Thresholds)
    #: Properties of displacement readings.
    probe: DisplacementProbe = field(default_factory=DisplacementProbe)
    #: A reading is implausible beyond the calibrated range by more than this, K; above it also by
    #: this multiple of the range.
    room: float = 60.0
    further: float = 3.0
    #: Upper bound for the noise of a thermometer, K; the filter's own value includes model error.
    thermometer: float = 0.05
    #: Admissible jumps of the heat: up to this multiple of the largest calibrated heat, with a
    #: tolerance relative to it on either side.
    heat_jump: float = 1.5
    heat_jump_slack: float = 0.05
    #: Heat beyond this multiple of the largest calibrated heat, of either sign, is implausible: an
    #: estimate is bad, and a power that corresponds to it is not used.
    implausible_heat: float = 5.0
    #: An odometer beyond this, m, or below zero is not used; no axis is faster than this, m/s: an
    #: odometer that reports more was reset.
    farthest: float = 1e9
    fastest: float = 10.0
    #: A jump is judged after this time, s, and this many samples.
    decided: float = 12.0
    samples: int = 3
    #: Columns of the covariance factor that move the readings by less than this fraction of their
    #: noise are dropped.
    forgotten: float = 1e-3
    #: A constant sampling interval of several steps leaves some variance of the displacement; a
    #: start or a gap has no effect while it leaves less than this multiple of it.
    settled: float = 4.0
    #: The joint is tracked once the displacement is known to this, m (warm starts after 2, 4 and 6
    #: h, docs/joint-aware.md).
    followable: float = 1e-6
    #: Share of the lasting errors that counts when the past is known: then only the heat of some
    #: minutes is unknown, and not a field that may have built up over hours. Of 1, 0.3, 0.1 and
    #: 0.03 on four random plants (docs/faulty-sensors.md) all but the last keep every band, and 0.1
    #: and 0.3 have the smallest errors.
    doubt_of_heat: float = 0.2
    #: The same when the past is unknown. Of 1, 0.5, 0.3 and 0.1 on warm starts after 2, 4 and 6 h
    #: (docs/joint-aware.md, on the initial state), 0.1 was off by twice as much.
    doubt_of_past: float = 0.3
    #: Where the past is unknown, readings that the model reproduces poorly have unknown errors with
    #: this correlation time, s: their standard deviation is this fraction of the model's share of
    #: the lasting ones (docs/joint-aware.md, on warm starts).
    start_error: float = 1.0 / 16.0
    start_error_lasts: float = 7200.0
    #: The covariance factor neglects that the machine is nonlinear: the displacement has this many
    #: times its standard deviation (warm starts after 2, 4 and 6 h, docs/joint-aware.md).
    doubt: float = 3.0
    #: Tolerated change of the ambient without a flag, K.
    ambient: float = 10.0
    #: Without any thermometer for longer than this, s, an estimate is bad: the heat is unknown. As
    #: in a learned model, whose temperatures drift with this time constant.
    lost: float = 1800.0
    #: Most steps between two samples; after a longer gap they are longer.
    most_steps: int = 2000


#: The default thresholds.
USUAL = Thresholds()
