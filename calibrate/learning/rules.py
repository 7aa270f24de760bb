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
    """Averaging of a log to a table of bounded size.

    Attributes
    ----------
    interval : float
        Shortest interval, s.
    most_rows : int
        Longer logs have longer intervals.
    uneven : float
        Mean times of uneven samples vary by up to this factor around the interval.
    spike, neighbours, least_spike : float
        A value is a spike if it is above, or below, the medians of `neighbours` values on either
        side by `spike` times their usual distance and by `least_spike`, K. The latter grows with
        the interval of a slower log, since the machine warms up between its samples.
    """

    interval: float = 60.0
    most_rows: int = 100_000
    uneven: float = 1.5
    spike: float = 12.0
    neighbours: int = 4
    least_spike: float = 0.5


@dataclass(frozen=True)
class Cleaning:
    """Exclusion of sensors and refusal of logs.

    Attributes
    ----------
    shortest : float
        A shorter log, s, contains no information on relaxations of an hour.
    coarsest : float
        A longer interval between samples, s, is more than half of the slowest relaxation.
    fewest : int
        Fewer rows cannot be held out block by block.
    still, still_length : float
        A sensor within this range has not moved, K; a displacement, m.
    warms : float
        Without a drive, one temperature must have this standard deviation, K.
    stuck, shortest_stuck, unchanged : float
        A sensor is excluded if it stays within `unchanged`, K (rounding of what it shows), for this
        fraction of the log and for this time, s.
    missing, displacement_missing : float
        A sensor is excluded, a displacement refused, if more than this is missing.
    spikes : float
        More spikes than this share of the samples are a fault.
    moved, usual, least_usual : float
        A jump within one interval, K, as a multiple of usual changes; these are at least the
        resolution of a thermometer, K.
    side, candidates : int
        Rows on either side used to distinguish a jump from a spike; largest changes looked at.
    lasting : float
        A jump remains by this part of its size between the medians of both sides.
    jump : float
        A displacement that jumps by this fraction of its range has lost its zero.
    pace : float
        Longest interval for these limits of jumps, s; for a longer one they grow with it, since the
        machine moves between samples.
    constant : float
        A drive that varies by less than this part of its largest value has no identifiable effect.
    level, stopped, seldom : float
        Levels of a speed differ by this part of the largest; below `stopped` the spindle stands;
        a level held in fewer than this share of the rows is a ramp.
    stepped, beside, gap : float
        A drive that changes by this part of its largest value explains a jump within so many rows,
        and so does a gap of so many intervals.
    possible : (float, float)
        Temperatures of a machine tool lie within this range, K.
    """

    shortest: float = 3.0 * 3600.0
    coarsest: float = 3600.0
    fewest: int = 48
    still: float = 0.1
    still_length: float = 0.5e-6
    warms: float = 0.5
    stuck: float = 0.1
    shortest_stuck: float = 1800.0
    unchanged: float = 1e-9
    missing: float = 0.2
    displacement_missing: float = 0.5
    spikes: float = 1e-2
    moved: float = 1.0
    usual: float = 15.0
    least_usual: float = 1e-3
    side: int = 20
    candidates: int = 5
    lasting: float = 0.7
    jump: float = 0.15
    pace: float = 600.0
    constant: float = 1e-3
    level: float = 0.1
    stopped: float = 0.05
    seldom: float = 0.02
    stepped: float = 0.02
    beside: int = 2
    gap: float = 2.5
    possible: tuple[float, float] = POSSIBLE


@dataclass(frozen=True)
class Features:
    """Features on which a displacement may depend.

    Attributes
    ----------
    slow, heat : tuple of float
        Relaxations of a temperature, in addition to itself, and of a heat, s.
    exponents : tuple of float
        Heat of a bearing as a power of the speed; a power or load counts as heat directly.
    slowest_share : float
        Relaxations slower than this fraction of the run are not observable in it.
    gain, heat_gain : float
        A priori size of a weight, um: per kelvin (steel over half a metre), and of the largest
        heat.
    slope_gain : float
        A priori size of the constant part of a slope, um at the end of the stroke: hardly any.
    before, given_up : float
        Time for which heat from before a run has an effect, s (twice the slowest relaxation of a
        heat), and the largest fraction of the run discarded for it.
    standstill : float
        A run that starts below this fraction of the largest drive starts at rest.
    """

    slow: tuple[float, ...] = (3600.0, 7200.0)
    heat: tuple[float, ...] = (900.0, 5400.0)
    exponents: tuple[float, ...] = (1.0, 1.5, 2.0)
    slowest_share: float = 1.0 / 3.0
    gain: float = 5.0
    heat_gain: float = 20.0
    slope_gain: float = 200.0
    before: float = 10800.0
    given_up: float = 0.2
    standstill: float = 0.02


@dataclass(frozen=True)
class Fitting:
    """Fitting of weights with held-out blocks of time.

    Attributes
    ----------
    hours, fewest, most : float
        Blocks inside a fit: duration in hours, least and largest number.
    independent : float
        Correlation time of errors, s.
    margin : float
        Gap between a held-out block and the fit, s.
    priors : tuple of float
        Prior weights over which a fit is averaged, um2.
    sharpness : float
        A structure is weighted by this power of its mean square error.
    noise : float
        Errors below this are measurement noise, um.
    penalties : tuple of float
        Candidates of the baseline `ridge`, for standardised temperatures; held-out blocks decide.
    """

    hours: float = 2.5
    fewest: int = 6
    most: int = 24
    independent: float = 3600.0
    margin: float = 1800.0
    priors: tuple[float, ...] = (0.1, 1.0)
    sharpness: float = 2.0
    noise: float = 0.1
    penalties: tuple[float, ...] = tuple(10.0 ** (0.5 * k) for k in range(-10, 3))


@dataclass(frozen=True)
class Judging:
    """Validation of the whole procedure, and its band.

    Attributes
    ----------
    blocks : int
        Number of blocks; the whole procedure is repeated without each of them.
    open : float
        Factor on the variance of the weights, which similar structures, and errors that last longer
        than an hour, make too small. Without it the band contained too few samples on rolling
        origins of a measured log.
    within : float
        Fraction of the errors that lies within the band.
    useful : float
        A model must have less than this fraction of the mean's error.
    least_drift : float
        A displacement drifts at least as much as a probe resolves, um.
    costly : float
        A speed that was left out is worth a warning if the error there grows by this factor.
    """

    blocks: int = 4
    open: float = 4.0
    within: float = 0.95
    useful: float = 0.9
    least_drift: float = 0.05
    costly: float = 1.5


@dataclass(frozen=True)
class Moving:
    """What a log must have read along an axis for a slope.

    Attributes
    ----------
    shortest : float
        Distance between the outermost positions, m.
    half : float
        An hour shows the slope if it was read over this fraction of that distance.
    hours : float
        Number of such hours needed.
    share : float
        Share of all hours with readings; with fewer the model is flagged.
    """

    shortest: float = 0.02
    half: float = 0.5
    hours: int = 3
    share: float = 0.5


@dataclass(frozen=True)
class Transfer:
    """Learning from few readings with the models of other machines as prior.

    Attributes
    ----------
    relative : tuple of float
        Standard deviations of a weight between machines, relative to it, that are averaged over.
    drifts : tuple of float
        Sizes of the drift relative to the sisters', that are averaged over: their held-out error is
        that of a shorter log.
    fewest, most : int
        Fewer readings are refused; of more, as many evenly.
    """

    relative: tuple[float, ...] = (0.03, 0.1, 0.3, 1.0)
    drifts: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0)
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
