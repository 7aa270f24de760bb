"""Thresholds of the observer, each with the study that gave it."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimator import sensor_faults
from estimator.joint_aware.displacement_readings import Touch


@dataclass(frozen=True)
class Thresholds:
    """Where an observer changes what it does.

    Where no other study is named it is ``python -m benchmarks.sensor_faults``, which checks them
    together (docs/faulty-sensors.md).

    Attributes
    ----------
    faults : sensor_faults.Thresholds
        When a channel is distrusted.
    touch : Touch
        How a reading of the displacement is taken.
    room, further : float
        A reading is impossible further than this beyond the calibrated ones, K; above them also by
        this many times their range.
    thermometer : float
        Noise of a thermometer, K, at most; the filter's own holds what the model errs by, too.
    onset, onset_slack : float
        The heat may jump to this many times the largest calibrated, and a part of that more or
        below 0.
    decided, samples : float
        A jump is judged after this long, s, and this many samples.
    forgotten : float
        Excess columns that tell the readings less than this part of their noise are dropped.
    followable : float
        The joint is followed from when the displacement is known to this, m (warm starts after 2, 4
        and 6 h, docs/joint-aware.md).
    doubt_of_heat : float
        Part of what lasts in the readings that counts where the past is known: unknown is then the
        heat of some minutes, and no field that may have been there for hours. Of 1, 0.3, 0.1 and
        0.03 on four drawn plants (docs/faulty-sensors.md) all but the last hold every band, and
        0.1 and 0.3 have the smallest errors.
    doubt : float
        The excess columns forget what the readings err by for hours: the displacement is so many
        times less certain than they say (warm starts after 2, 4 and 6 h, which were off by up to
        2.6 times the band, docs/joint-aware.md).
    ambient : float
        The ambient may change by this much without a word, K.
    most_steps : int
        Steps between two samples at most; after a longer silence they are longer.
    """

    faults: sensor_faults.Thresholds = field(default_factory=sensor_faults.Thresholds)
    touch: Touch = field(default_factory=Touch)
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
    doubt: float = 3.0
    ambient: float = 10.0
    most_steps: int = 2000


#: Those that are used where nobody names others.
USUAL = Thresholds()
