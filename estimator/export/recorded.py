"""Samples for the self-test of a program: recorded, or a generated duty cycle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from estimator.interface import Estimator, Status, follow
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

#: Samples at the nominal interval that a duty cycle begins with; then intervals of so many of it.
EVEN, INTERVALS = 400, (15.0, 40.0, 0.5, 77.0)
#: Length of the duty cycle and of the gap in its middle, s.
DAY, GAP = 86400.0, 3600.0
#: One period of the load, the share of it that is on, and how fast the machine follows, s.
PERIOD, ON, FOLLOWS = 7200.0, 0.6, 1800.0
#: Most samples that are compiled in.
MOST = 5000


@dataclass(frozen=True, eq=False)
class Recorded:
    """Samples and what the estimator says of them.

    Attributes
    ----------
    samples : ndarray, shape (n, 1 + channels)
        Interval since the sample before (the nominal one at the first), s, and readings.
    displacement : ndarray, shape (n, axes)
        m.
    words : tuple of int
        Status of each.
    origin : str
        Where the samples come from.
    """

    samples: Array
    displacement: Array
    words: tuple[int, ...]
    origin: str


def recorded(
    estimator: Estimator, samples: Iterable[Sequence[float]], interval: float, origin: str
) -> Recorded:
    """Return samples with the estimates from the initial state on; not more than `MOST`.

    Parameters
    ----------
    estimator : Estimator
        Of any kind.
    samples : iterable of sequences
        Time, s, and a value of each channel.
    interval : float
        Of the first sample, s.
    origin : str
        Where they come from.

    Raises
    ------
    InputError
        A sample is unusable, or there is none.
    """
    rows, shifts, words = [], [], []
    last = math.nan
    kept = list(islice(samples, MOST))
    states = follow(estimator, kept, estimator.initial_state())
    for sample, (_, found) in zip(kept, states, strict=True):
        rows.append((interval if math.isnan(last) else sample[0] - last, *sample[1:]))
        shifts.append(found.displacement)
        words.append(int(found.status))
        last = sample[0]
    if not rows:
        raise InputError(f"{origin}: no samples; give at least one")
    return Recorded(np.array(rows), np.array(shifts), tuple(words), origin)


def even(samples: Iterable[Sequence[float]], step: float, origin: str) -> Iterator[Sequence[float]]:
    """Yield samples that come at every step, nothing missing.

    Raises
    ------
    InputError
        One is late or has a reading missing.
    """
    last = None
    for sample in samples:
        late = last is not None and abs(sample[0] - last - step) > 1e-6 * step
        if late or not all(map(math.isfinite, sample)):
            raise InputError(
                f"{origin}: the sample at {sample[0]:g} s is late or has a reading missing; for "
                f"the self-test give one every {step:g} s, or leave --samples out"
            )
        last = sample[0]
        yield sample


def check_answerable(kept: Recorded, statuses: Sequence[Status]) -> None:
    """Refuse samples of which Python says what no program of this kind does.

    Raises
    ------
    InputError
        There is one.
    """
    known = sum(one.value for one in statuses)
    for row, word in enumerate(kept.words):
        if word & ~known:
            raise InputError(
                f"{kept.origin}: sample {row} is one that the exported program judges otherwise "
                f"({Status(word).words}); give another log for the self-test, or leave --samples "
                "out"
            )


def duty_cycle(ranges: Sequence[tuple[float, float]], interval: float) -> Array:
    """Return a day of samples (n, 1 + channels): a load on and off, within what was calibrated.

    Parameters
    ----------
    ranges : sequence of tuple
        Least and largest value of every channel, in the order of a sample.
    interval : float
        Nominal, s.
    """
    steps = [interval] * EVEN
    elapsed, gap = EVEN * interval, False
    while elapsed < DAY:
        steps.append(interval * INTERVALS[len(steps) % len(INTERVALS)])
        if not gap and elapsed > 0.5 * DAY:
            steps[-1], gap = GAP, True
        elapsed += steps[-1]
    times = np.cumsum(steps)
    level, load = np.empty(times.size), 0.0
    for k, (time, step) in enumerate(zip(times, steps, strict=True)):
        on = float(time % PERIOD < ON * PERIOD)
        load += (on - load) * -math.expm1(-step / FOLLOWS)
        level[k] = load
    columns = [low + (high - low) * level for low, high in ranges]
    return np.column_stack((times, *columns))
