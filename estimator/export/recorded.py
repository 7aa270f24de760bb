"""Samples for the self-test of a program: recorded, or a generated duty cycle."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from estimator.interface import Estimate, Estimator, Status, follow
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

#: Samples at the nominal interval that a duty cycle starts with, and the later intervals in
#: multiples of it.
EVEN, INTERVALS = 400, (15.0, 40.0, 0.5, 77.0)
#: Length of the duty cycle and of the gap in its middle, s.
DAY, GAP = 86400.0, 3600.0
#: Period of the load, its on-time as a fraction of it, and the time constant of the machine, s.
PERIOD, ON, FOLLOWS = 7200.0, 0.6, 1800.0
#: Marks a missing reading in a self-test: outside the range that a program accepts.
MISSING = -1e31
#: Maximum number of compiled-in samples.
MOST = 5000


@dataclass(frozen=True, eq=False)
class Recorded:
    """Samples and the estimates for them."""

    #: Shape (n, 1 + channels): interval since the previous sample (nominal for the first), s, and
    #: readings, `MISSING` where there is none.
    samples: Array
    #: Shape (n, axes + lines): displacements, then the other compared values, m.
    compared: Array
    #: Status words.
    words: tuple[int, ...]
    #: Where the samples come from.
    origin: str


def recorded(
    estimator: Estimator,
    lines: Callable[[Estimate], Array],
    samples: Iterable[Sequence[float]],
    interval: float,
    origin: str,
) -> Recorded:
    """Return at most `MOST` samples with the estimates, starting from the initial state.

    Samples are time, s, and a value of each channel; the first has the given interval, s. In
    addition to the displacements, the values that `lines` returns for an estimate are compared, m.

    Raises
    ------
    InputError
        A sample is unusable, or there are none.
    """
    rows, shifts, words = [], [], []
    last = math.nan
    kept = list(islice(samples, MOST))
    states = follow(estimator, kept, estimator.initial_state())
    for sample, (_, estimate) in zip(kept, states, strict=True):
        rows.append((interval if math.isnan(last) else sample[0] - last, *sample[1:]))
        shifts.append(np.concatenate([estimate.displacement, lines(estimate)]))
        words.append(int(estimate.status))
        last = sample[0]
    if not rows:
        raise InputError(f"{origin}: no samples; give at least one")
    readings = np.nan_to_num(np.array(rows), nan=MISSING)
    return Recorded(readings, np.array(shifts), tuple(words), origin)


def even(samples: Iterable[Sequence[float]], step: float, origin: str) -> Iterator[Sequence[float]]:
    """Yield samples, which must be evenly spaced and complete.

    Raises
    ------
    InputError
        A sample is late or lacks a reading.
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
    """Refuse samples for which an exported program would differ from Python.

    Raises
    ------
    InputError
        There is such a sample.
    """
    known = sum(status.value for status in statuses)
    for row, word in enumerate(kept.words):
        if word & ~known:
            raise InputError(
                f"{kept.origin}: sample {row} is one that the exported program judges otherwise "
                f"({Status(word).words}); give another log for the self-test, or leave --samples "
                "out"
            )


def duty_cycle(ranges: Sequence[tuple[float, float]], interval: float) -> Array:
    """Return samples (n, 1 + channels) of an intermittent load in the calibrated ranges.

    They last a day, or, at short intervals, are the first `MOST` samples of one. The nominal
    interval is in s.
    """
    steps = [interval] * EVEN
    elapsed, gap = EVEN * interval, False
    while elapsed < DAY and len(steps) < MOST:
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
