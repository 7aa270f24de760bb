"""The streaming estimator against convolution with the whole history (Eq. 5)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np

from benchmarks.performance.cases import calibrated
from benchmarks.performance.convolution import Blocks, Collapsed
from benchmarks.performance.timing import Row, medians
from estimator.fchs.stream import initial_state, run, step
from thermojoint.artefacts.arrays import Array
from thermojoint.models.assembly import Assembly, assemble
from thermojoint.models.sensors import readings, roles_in

#: Sampling interval and the two lengths of a run, s.
INTERVAL, SHORT, LONG = 2.0, 2100.0, 86400.0
#: Error of the pole fit of the long run; the usual one needs more poles there than are tried.
LONG_TOLERANCE = 1e-5
REPEATS = 20


@dataclass(frozen=True)
class Measured:
    """Readings of the sensors, one row for each sample: delta T, T1, T2 ..., K."""

    values: Array

    def row(self, index: int) -> list[float]:
        """Sample `index` (from 0); the last one holds on for ever."""
        found: list[float] = self.values[min(index, len(self.values) - 1)].tolist()
        return found


def rows() -> Iterator[Row]:
    """Yield the rows of the estimator, with the calibrated equal-heights machine."""
    found, responses = calibrated()
    model, response = found.model, responses["step-2.0"]
    seen = readings(response, tuple(model.linear.direct), roles_in(response, model))
    measured = Measured(np.column_stack((seen.delta_T, seen.temperatures))[1:])
    short = assemble(model, INTERVAL, SHORT)
    yield from per_sample(short, measured, round(SHORT / INTERVAL), REPEATS)
    long = assemble(model, INTERVAL, LONG, LONG_TOLERANCE)
    yield from growth(long, measured, few=round(SHORT / INTERVAL), repeats=REPEATS)


def per_sample(estimator: Assembly, measured: Measured, count: int, repeats: int) -> Iterator[Row]:
    """Yield mean and 99.9th percentile of a sample, against convolution with `count` samples."""
    samples = [measured.row(i) for i in range(count)]
    given = np.array(samples)
    times = INTERVAL * np.arange(1, count + 1)
    exact = run(estimator, times, given[:, 0], given[:, 1:])[0].total[-1]
    blocks, collapsed = Blocks(estimator, count), Collapsed(estimator, count)
    errors = []
    for other in (blocks, collapsed):
        for row in samples:
            linear, nonlinear = other.sample(row[0], row[1:])
        errors.append(float(np.abs((linear + nonlinear) / exact - 1.0).max()))
    mine: list[Array] = []
    theirs: list[Array] = []
    least: list[Array] = []
    for _ in range(repeats):
        mine.append(stream_times(estimator, measured, count)[1:])
        for other, found in ((blocks, theirs), (collapsed, least)):
            found.append(_last_sample_times(other, samples[-1], count, count))
    minutes = INTERVAL * count / 60.0
    note = (
        f"a sample of the stream ({estimator.n_state} states), matrix of the interval made before, "
        f"against {{}} at t = {minutes:g} min ({count} samples); displacements agree to {{:.0e}}; "
        f"{repeats} runs"
    )
    by_blocks = note.format("convolution block by block, kernels tabulated", errors[0])
    at_once = note.format("one convolution kernel for all blocks together", errors[1])
    for name, of in (("per-sample", np.mean), ("percentile", _percentile)):
        text = by_blocks + ("; 99.9th percentile of all" if of is _percentile else "; means")
        yield _row(f"estimator-{name}", of, mine, theirs, text)
    yield _row("estimator-collapsed", np.mean, mine, least, at_once + "; means")


def _row(
    name: str, of: Callable[[Array], np.floating], ours: list[Array], other: list[Array], note: str
) -> Row:
    if of is _percentile:  # a run has too few samples for it
        first, second = float(of(np.concatenate(ours))), float(of(np.concatenate(other)))
        return Row(name, first, second, second / first, "µs", note)
    pairs = [(float(of(one)), float(of(two))) for one, two in zip(ours, other, strict=True)]
    return Row(name, *medians(pairs), "µs", note)


def growth(
    estimator: Assembly,
    measured: Measured,
    few: int,
    repeats: int,
    many: int = round(LONG / INTERVAL),
) -> Iterator[Row]:
    """Yield the last `few` of `many` samples of a run against its first, and a convolution."""
    ends, starts, convolved = [], [], []
    blocks = Blocks(estimator, many)
    for _ in range(repeats):
        # The first sample of all makes the matrix of the interval.
        times = stream_times(estimator, measured, many)[1:]
        ends.append(times[-few:])
        starts.append(times[:few])
        convolved.append(_last_sample_times(blocks, measured.row(many), many, few))
    hours = INTERVAL * many / 3600.0
    yield _row(
        "estimator-growth",
        np.mean,
        ends,
        starts,
        f"the last {few} samples of {hours:g} h ({many} samples, {estimator.n_state} states, poles "
        f"fitted to {LONG_TOLERANCE:g}) against the first {few} of the same run; means; {repeats} "
        "runs",
    )
    yield _row(
        "estimator-24-hours",
        np.mean,
        ends,
        convolved,
        f"the same against convolution block by block at t = {hours:g} h; means; {repeats} runs",
    )


def stream_times(estimator: Assembly, measured: Measured, count: int) -> Array:
    """Return the time of each of `count` samples, µs."""
    state = initial_state(estimator)
    found = np.empty(count)
    for i in range(count):
        row, time = measured.row(i), INTERVAL * (i + 1)
        begun = perf_counter_ns()
        state, _ = step(estimator, state, time, *row)
        found[i] = perf_counter_ns() - begun
    return 1e-3 * found


def _last_sample_times(
    other: Blocks | Collapsed, row: list[float], count: int, calls: int
) -> Array:
    """Return the times of sample `count`, taken again and again, µs."""
    found = np.empty(calls)
    for i in range(calls):
        other.count = count - 1
        begun = perf_counter_ns()
        other.sample(row[0], row[1:])
        found[i] = perf_counter_ns() - begun
    return 1e-3 * found


def _percentile(times: Array) -> np.floating:
    return np.percentile(times, 99.9)
