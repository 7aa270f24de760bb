"""What learning from a log takes for a fault, for independent and for known.

How sensors are chosen and the factor on the covariance were found on splits of one measured log,
which flatter them (``python -m benchmarks.measured_machine``, docs/measured-machines.md). The tests
of learning check the limits of faults one at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Thinning:
    """How a log becomes a table of bounded size.

    Attributes
    ----------
    interval : float
        Shortest interval, s.
    most_rows : int
        A longer log has longer intervals.
    spike, neighbours, least_spike : float
        A value is a spike if it is above, or below, the median of so many neighbours on either side
        by this many times their usual distance, and by more than the last, K.
    """

    interval: float = 60.0
    most_rows: int = 100_000
    spike: float = 12.0
    neighbours: int = 4
    least_spike: float = 0.5


@dataclass(frozen=True)
class Cleaning:
    """Which sensors are left out, and which logs are refused.

    Attributes
    ----------
    shortest : float
        A log tells nothing of relaxations of an hour if it is shorter, s.
    still, still_length : float
        A sensor that stays within this has not moved, K; a displacement, m.
    stuck, missing : float
        A sensor is left out if it is stuck for this share of the log, or if more than this is
        missing.
    spikes : float
        More spikes than this share of the samples are a fault.
    moved, usual : float
        A jump within one interval, K, and how many usual changes it is.
    side : int
        Rows on either side by which a jump is told from a spike.
    jump : float
        A displacement that jumps by this share of its range has lost its zero.
    possible : (float, float)
        No thermometer of a machine tool reads beyond, K.
    """

    shortest: float = 3.0 * 3600.0
    still: float = 0.1
    still_length: float = 0.5e-6
    stuck: float = 0.1
    missing: float = 0.2
    spikes: float = 1e-2
    moved: float = 1.0
    usual: float = 15.0
    side: int = 20
    jump: float = 0.15
    possible: tuple[float, float] = (200.0, 600.0)


@dataclass(frozen=True)
class Fitting:
    """How weights are fitted, over blocks of time held out.

    Attributes
    ----------
    hours, fewest, most : float
        Blocks inside a fit: so many hours each, at least and at most so many.
    independent : float
        Time over which errors are one error, s.
    margin : float
        What is left out of the fit beside a block that is held out, s.
    priors : tuple of float
        Weights of the prior that a fit is a mean over, um2.
    sharpness : float
        A structure counts by this power of its mean square error.
    noise : float
        Errors below are measured noise, um.
    """

    hours: float = 2.5
    fewest: int = 6
    most: int = 24
    independent: float = 3600.0
    margin: float = 1800.0
    priors: tuple[float, ...] = (0.1, 1.0)
    sharpness: float = 2.0
    noise: float = 0.1


@dataclass(frozen=True)
class Judging:
    """How the whole is judged, and the band made.

    Attributes
    ----------
    blocks : int
        Blocks on which the whole procedure is judged: all of it is done without each.
    open : float
        What the log leaves open in the weights is taken as so much more: structures that are alike,
        and errors that last longer than an hour, make it look smaller. Without it the band held too
        few samples on rolling origins of a measured log.
    within : float
        Share of the errors that lies within the band.
    """

    blocks: int = 4
    open: float = 4.0
    within: float = 0.95


@dataclass(frozen=True)
class Rules:
    """All that learning goes by."""

    thinning: Thinning = field(default_factory=Thinning)
    cleaning: Cleaning = field(default_factory=Cleaning)
    fitting: Fitting = field(default_factory=Fitting)
    judging: Judging = field(default_factory=Judging)
