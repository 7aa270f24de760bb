"""Thresholds of learning: faults, independence and prior knowledge.

The selection of sensors and the factor on the covariance were determined on splits of one measured
log and are therefore optimistic for it (``python -m benchmarks.measured_machine``,
docs/measured-machines.md). The tests of learning check the fault limits one at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from thermojoint.models.learned import POSSIBLE


@dataclass(frozen=True)
class Thinning:
    """Averaging of a log to a table of bounded size."""

    #: Shortest interval, s.
    interval: float = 60.0
    #: Most rows of a table: longer logs have longer intervals.
    most_rows: int = 100_000
    #: Mean times of uneven samples vary by up to this factor around the interval.
    uneven: float = 1.5
    #: A value is a spike if it is above, or below, the medians of `neighbours` values on either
    #: side by `spike` times their usual distance and by `least_spike`, K, beside one step of its
    #: display (at most `coarsest_display`); a displacement by `least_spike_length`, m. These grow
    #: with the interval of a slower log, since the machine warms up between its samples.
    spike: float = 12.0
    neighbours: int = 4
    least_spike: float = 0.5
    coarsest_display: float = 1.0
    least_spike_length: float = 5e-6
    #: Where a drive changes by this part of its largest value, a displacement has no spike but one
    #: that is further outside the range of the others than this is wide.
    changed: float = 0.1
    #: A speed is a spike if it is above this multiple of every speed that was held, the median of
    #: `held` values, in at most the share `seldom` of the samples.
    beyond_held: float = 4.0
    held: int = 5
    seldom: float = 1e-2


@dataclass(frozen=True)
class Cleaning:
    """Exclusion of sensors and refusal of logs."""

    #: A shorter log, s, or time with readings of a displacement, contains no information on
    #: relaxations of an hour.
    shortest: float = 3.0 * 3600.0
    #: A longer interval between samples, s, is more than half of the slowest relaxation.
    coarsest: float = 3600.0
    #: Fewer rows, or readings of a displacement, cannot be held out block by block.
    fewest: int = 48
    #: A sensor within this range has not moved, K; a displacement, m.
    still: float = 0.1
    still_length: float = 0.5e-6
    #: Without a drive, one temperature must have this standard deviation, K.
    warms: float = 0.5
    #: A sensor is excluded if it stays within `unchanged`, K (rounding of its display), for this
    #: fraction of the log and for this time, s, in which it should move by `shown` steps of its
    #: display according to the others.
    stuck: float = 0.1
    shortest_stuck: float = 1800.0
    unchanged: float = 1e-9
    shown: float = 2.0
    #: A sensor is excluded if more than this is missing.
    missing: float = 0.2
    #: Displacements share sensors if they are read together in this part of the rows.
    together: float = 0.9
    #: More spikes than this share of the samples are a fault.
    spikes: float = 1e-2
    #: A jump within one interval, K, as a multiple of usual changes; these are at least the
    #: resolution of a thermometer, K.
    moved: float = 1.0
    usual: float = 15.0
    least_usual: float = 1e-3
    #: Rows on either side used to distinguish a jump from a spike; number of changes examined.
    side: int = 20
    candidates: int = 5
    #: A jump persists by this part of its size, between the medians of both sides.
    lasting: float = 0.7
    #: A displacement that jumps by this fraction of its range has lost its zero.
    jump: float = 0.15
    #: It has not, but is not read, where it jumps from or to one value more often than this.
    stretches: int = 5
    #: Longest interval for these limits of jumps, s; for a longer one they grow with it, since the
    #: machine moves between samples.
    pace: float = 600.0
    #: A drive that varies by less than this part of its largest value has no identifiable effect.
    constant: float = 1e-3
    #: Levels of a speed differ by this part of the largest; below `stopped` the spindle stands; a
    #: level held in fewer than this share of the rows is a ramp.
    level: float = 0.1
    stopped: float = 0.05
    seldom: float = 0.02
    #: A drive that changes by this part of its largest value explains a jump within so many rows,
    #: and so does a gap of so many intervals.
    stepped: float = 0.02
    beside: int = 2
    gap: float = 2.5
    #: Temperatures of a machine tool lie within this range, K.
    possible: tuple[float, float] = POSSIBLE


@dataclass(frozen=True)
class Features:
    """Features on which a displacement may depend."""

    #: Relaxations of a temperature, in addition to itself, and of a heat, s.
    slow: tuple[float, ...] = (3600.0, 7200.0)
    heat: tuple[float, ...] = (900.0, 5400.0)
    #: Heat of a bearing as a power of the speed; a power or load counts as heat directly.
    exponents: tuple[float, ...] = (1.0, 1.5, 2.0)
    #: Relaxations slower than this fraction of the run are not observable in it.
    slowest_share: float = 1.0 / 3.0
    #: A priori size of a weight, um: per kelvin (steel over half a metre), and of the largest heat.
    gain: float = 5.0
    heat_gain: float = 20.0
    #: A priori size of the constant part of a slope, um at the end of the stroke: hardly any.
    slope_gain: float = 200.0
    #: Time for which heat from before a run has an effect, s (twice the slowest relaxation of a
    #: heat), and the largest fraction of the run discarded for it.
    before: float = 10800.0
    given_up: float = 0.2
    #: A run that starts below this fraction of the largest drive starts at rest.
    standstill: float = 0.02


@dataclass(frozen=True)
class Fitting:
    """Fitting of weights with held-out blocks of time."""

    #: Blocks inside a fit: duration in hours, least and largest number.
    hours: float = 2.5
    fewest: int = 6
    most: int = 24
    #: Correlation time of errors, s.
    independent: float = 3600.0
    #: Gap between a held-out block and the fit, s.
    margin: float = 1800.0
    #: Prior weights over which a fit is averaged, um2.
    priors: tuple[float, ...] = (0.1, 1.0)
    #: A structure is weighted by this power of its mean square error.
    sharpness: float = 2.0
    #: Errors below this are measurement noise, um.
    noise: float = 0.1
    #: Candidates of the baseline `ridge`, for standardised temperatures; held-out blocks decide.
    penalties: tuple[float, ...] = tuple(10.0 ** (0.5 * k) for k in range(-10, 3))


@dataclass(frozen=True)
class Judging:
    """Validation of the whole procedure, and its band."""

    #: Number of blocks; the whole procedure is repeated without each of them.
    blocks: int = 4
    #: Factor on the variance of the weights, which is too small because structures are similar and
    #: errors last longer than an hour. Without it the band contained too few samples on rolling
    #: origins of a measured log.
    open: float = 4.0
    #: Fraction of the errors that lies within the band.
    within: float = 0.95
    #: A model must have less than this fraction of the mean's error.
    useful: float = 0.9
    #: A displacement drifts at least as much as a probe resolves, um.
    least_drift: float = 0.05
    #: A speed that was left out is worth a warning if the error there grows by this factor.
    costly: float = 1.5


@dataclass(frozen=True)
class Moving:
    """Readings along an axis that a log must have for a slope."""

    #: Distance between the outermost positions, m.
    shortest: float = 0.02
    #: An hour shows the slope if it was read over this fraction of that distance.
    half: float = 0.5
    #: Number of such hours needed.
    hours: int = 3
    #: Share of all hours with readings; with fewer the model is flagged.
    share: float = 0.5


@dataclass(frozen=True)
class Transfer:
    """Learning from few readings with the models of other machines as prior."""

    #: Standard deviations of a weight between machines, relative to it, that are averaged over.
    relative: tuple[float, ...] = (0.03, 0.1, 0.3, 1.0)
    #: Sizes of the drift relative to the sisters', that are averaged over: their held-out error is
    #: that of a shorter log.
    drifts: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0)
    #: A reading so many standard deviations from what the others let expect, and so many times
    #: further from the sisters' estimate than is usual, is left out.
    misread: float = 8.0
    #: Fewer readings are refused; of more than `most`, that number is used, evenly.
    fewest: int = 4
    most: int = 300


@dataclass(frozen=True)
class Rules:
    """All rules of learning."""

    thinning: Thinning = field(default_factory=Thinning)
    cleaning: Cleaning = field(default_factory=Cleaning)
    features: Features = field(default_factory=Features)
    fitting: Fitting = field(default_factory=Fitting)
    judging: Judging = field(default_factory=Judging)
    moving: Moving = field(default_factory=Moving)
    transfer: Transfer = field(default_factory=Transfer)
