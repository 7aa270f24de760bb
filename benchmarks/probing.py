"""How many readings of the displacement keep a band: asked for by the estimator, or at intervals.

    python -m benchmarks.probing --out probing.json [--family films] [--seed 2] [--count 2]
        [--sensors 4] [--calibration steps] [--days 1]
    python -m benchmarks.probing --log LOG.csv --displacement disp1_um --out probing.json

Without a log: the plants of `benchmarks.plants`, calibrated from steps, and from steps and a
cool-down, through their day of 8 h. The axis that `next_reading` names is read as soon as it is due
(noise 0.5 um), and not again within the interval; beside it stand no readings and as many at equal
intervals, of one axis after the other, and readings of all axes at fixed intervals, also on further
days with heat of their own, between which the machine cools. With a log: the learned model of its
first 60 % on the rest, where the displacements are read whose band is above the limit. Tables in
docs/faulty-sensors.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from threadpoolctl import threadpool_limits

from benchmarks.plants.drawing import FAMILIES, Plant
from benchmarks.plants.judging import (
    CALIBRATIONS,
    Machines,
    exact_answers,
    judged_run,
    shown,
    with_sensors,
)
from benchmarks.plants.preparing import prepared
from benchmarks.study import case_file, options_of, write_rows
from calibrate.joint_aware.calibration import Effort, calibrate_machine
from calibrate.joint_aware.physics_fit import Search
from calibrate.learning.learn import learn
from estimator.columns import samples_of
from estimator.interface import READING_NOISE, Estimate, Estimator, Status
from estimator.joint_aware.displacement_readings import later
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.next_reading import next_reading
from estimator.joint_aware.observer_state import unpacked
from estimator.joint_aware.readings import samples_in
from estimator.learned.estimator import Learned
from estimator.rows import interval_score
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.log_file import read_log
from thermojoint.artefacts.response import columns_of
from thermojoint.artefacts.units import MEGA, MICRO
from thermojoint.reduced.machine import ReducedMachine

#: Limits of the band, m, and shortest intervals between requests, s.
LIMITS, INTERVALS = (2.0 * MICRO, 3.0 * MICRO), (1800.0, 7200.0)
#: Intervals at which all axes are read, and the time between two days, s.
EVERY, NIGHT = (4 * 3600.0, 2 * 3600.0, 3600.0, 1800.0), 16 * 3600.0
#: Within this an estimate is meant to be, m.
WANTED = 2.0 * MICRO
#: Share of a log that is learned from; every so many of its samples are judged.
LEARNED, STRIDE = 0.6, 4

#: (state, estimate, time s) to the axes to be read in the next sample.
Policy = Callable[[Array, Estimate, float], Sequence[int]]


class Run(NamedTuple):
    """A run: samples (time and values without readings), and the displacement (n, axes), m."""

    samples: list[tuple[float, ...]]
    actual: Array


def asked_for(estimator: JointAware, limit: float, interval: float) -> Policy:
    """Return the policy of reading what the estimator asks for."""
    last = -math.inf

    def policy(state: Array, estimate: Estimate, time: float) -> Sequence[int]:
        nonlocal last
        if time - last < interval or not (estimate.band > limit).any():
            return ()
        asked = next_reading(estimator, state, limit)
        if asked is None or asked.due > 0.0:
            return ()
        last = time
        return (estimator.axes.index(asked.axis),)

    return policy


def above(limit: float, interval: float) -> Policy:
    """Return the policy of reading every axis whose band is above a limit."""
    last = -math.inf

    def policy(state: Array, estimate: Estimate, time: float) -> Sequence[int]:
        nonlocal last
        axes = np.flatnonzero(estimate.band > limit).tolist()
        if time - last < interval or not axes:
            return ()
        last = time
        return axes

    return policy


def at_intervals(times: Array, count: int, turns: Sequence[Sequence[int]]) -> Policy:
    """Return the policy of so many readings, evenly over a run, of some axes in turn."""
    due = list(np.linspace(times[0], times[-1], 2 * count + 1)[1::2])
    axes = cycle(turns)

    def policy(state: Array, estimate: Estimate, time: float) -> Sequence[int]:
        if not due or time < due[0]:
            return ()
        due.pop(0)
        return next(axes)

    return policy


def followed(estimator: Estimator, run: Run, policy: Policy) -> dict[str, Any]:
    """Return the figures of a run; each time at which something is read counts once."""
    return followed_from(estimator.initial_state(), estimator, run, policy)[0]


def followed_from(
    state: Array, estimator: Estimator, run: Run, policy: Policy
) -> tuple[dict[str, Any], Array]:
    """Return the figures of a run, and the state after it."""
    rng = np.random.default_rng(1)
    axes, count, refusals = len(estimator.axes), 0, 0
    probed, read = np.full(axes, math.nan), list[int]()
    error, band = np.zeros_like(run.actual), np.zeros_like(run.actual)
    for k, (time, *values) in enumerate(run.samples):
        state, estimate = estimator.sample(state, time, [*values, *probed.tolist()])
        error[k], band[k] = estimate.displacement - run.actual[k], estimate.band
        probed, last = np.full(axes, math.nan), min(k + 1, len(run.samples) - 1)
        # A reading that is refused is repeated at once.
        refused = Status.READING_REFUSED in estimate.status
        refusals += refused
        read = read if refused else list(policy(state, estimate, time))
        probed[read] = run.actual[last, read] + READING_NOISE * rng.normal(size=len(read))
        count += bool(read)
    size = np.abs(error)
    figures = {
        "readings": count,
        "refused": refusals,
        "max_um": (MEGA * size.max(axis=0)).round(2).tolist(),
        "p90_um": (MEGA * np.quantile(size, 0.9, axis=0)).round(2).tolist(),
        "within_percent": round(100.0 * float(np.mean(size.max(axis=1) <= WANTED)), 1),
        "inside_percent": (100.0 * np.mean(size <= band, axis=0)).round(1).tolist(),
        "half_band_um": (MEGA * band.mean(axis=0)).round(2).tolist(),
        "interval_score_um": [
            round(MEGA * float(interval_score(size[:, a], band[:, a])), 2) for a in range(axes)
        ],
    }
    return figures, state


class Plants(NamedTuple):
    """The machines of a study and the plants that are drawn from them."""

    machines: Machines
    drawn: list[Plant]


def drawn(family: str, seed: int, count: int) -> Plants:
    """Return the first plants of a family, with ten sensors."""
    case, machines = prepared(case_file("reference"), more=True)
    draw, names = FAMILIES[family], machines.model.sensor_names
    return Plants(machines, [draw(case, names, seed, number) for number in range(count)])


@threadpool_limits.wrap(limits=1)
def calibrated(
    machines: Machines, model: ReducedMachine, plant: Plant, label: str
) -> tuple[JointAware, xr.Dataset]:
    """Return the estimator of a plant that is calibrated like `CALIBRATIONS`, and its day."""
    exact = exact_answers(machines, plant)
    responses = shown(machines, plant, exact, CALIBRATIONS[label])
    loosening = machines.loosening
    found = calibrate_machine(
        model, responses, effort=Effort(Search(starts=0)), loosening=lambda: loosening
    )
    return JointAware(found.model), judged_run(machines, plant, exact, "day")[0]


def further_days(machines: Machines, plant: Plant, count: int) -> list[xr.Dataset]:
    """Return days of a plant with other heat, doors and noise than its own."""
    others = [replace(plant, seed=plant.seed + k) for k in range(1, count + 1)]
    return [
        judged_run(machines, other, exact_answers(machines, other), "day")[0] for other in others
    ]


def plant_rows(
    plants: Plants, sensors: int, labels: Sequence[str], days: int
) -> Iterator[dict[str, Any]]:
    """Yield the figures of every plant, calibration, limit and interval."""
    model = with_sensors(plants.machines.model, plants.machines.model.sensor_names[:sensors])
    for plant in plants.drawn:
        others = further_days(plants.machines, plant, days - 1)
        for label in labels:
            estimator, day = calibrated(plants.machines, model, plant, label)
            runs = [
                Run(
                    list(samples_in(one, model.sensor_names)),
                    columns_of(one, "displacement", estimator.axes),
                )
                for one in (day, *others)
            ]
            about = {"plant": plant.number, "calibration": label}
            turns = [(axis,) for axis in range(len(estimator.axes))]
            asking = partial(asked_for, estimator)
            for row in chain(compared(estimator, runs[0], asking, turns), regular(estimator, runs)):
                yield about | row


def regular(estimator: JointAware, days: Sequence[Run]) -> Iterator[dict[str, Any]]:
    """Yield the figures of days one after the other, with readings of all axes at intervals."""
    for every in (math.inf, *EVERY):
        name = f"all axes every {every / 3600.0:g} h" if math.isfinite(every) else "none"
        state = estimator.initial_state()
        for k, run in enumerate(days):
            times = np.array([sample[0] for sample in run.samples])
            count = round(float(np.ptp(times)) / every)
            policy = at_intervals(times, count, [range(len(estimator.axes))])
            figures, state = followed_from(state, estimator, run, policy)
            state = next_morning(estimator, state)
            yield {"policy": name, "day": k + 1} | figures


def next_morning(estimator: JointAware, state: Array) -> Array:
    """Return the state of a machine that has cooled overnight, which keeps what was read."""
    evening, cold = (unpacked(one, estimator.parts) for one in (state, estimator.initial_state()))
    known = later(evening.model_error, NIGHT, estimator.precomputed.forgetting)
    return cold._replace(model_error=known).flat()


def log_rows(path: Path, displacements: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield the figures of a measured machine."""
    log = read_log([path])
    cut = int(LEARNED * len(log.times))
    model = learn([log.part(slice(0, cut))], displacements, 4)
    rest = log.part(slice(cut, len(log.times), STRIDE))
    estimator = Learned(model)
    samples = list(samples_of(model.columns, [rest]))
    run = Run(samples, np.stack([rest.at(name) for name in estimator.axes], axis=1))
    yield from compared(estimator, run, above, [range(len(estimator.axes))])


def compared(
    estimator: Estimator,
    run: Run,
    asking: Callable[[float, float], Policy],
    turns: Sequence[Sequence[int]],
) -> Iterator[dict[str, Any]]:
    """Yield figures without readings, with those asked for, and with as many at intervals."""
    times = np.array([sample[0] for sample in run.samples])
    yield {"policy": "none"} | followed(estimator, run, lambda *_: ())
    for limit in LIMITS:
        for interval in INTERVALS:
            name = f"above {MEGA * limit:g} um, {interval / 60.0:g} min apart"
            asked = followed(estimator, run, asking(limit, interval))
            yield {"policy": name} | asked
            if asked["readings"]:
                evenly = at_intervals(times, asked["readings"], turns)
                yield {"policy": f"as many as {name}"} | followed(estimator, run, evenly)


def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its rows."""
    parser = options_of(__doc__, "probing.json")
    parser.add_argument("--family", choices=list(FAMILIES), default="films")
    parser.add_argument("--count", type=int, default=2)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--sensors", type=int, default=4)
    parser.add_argument("--calibration", choices=list(CALIBRATIONS), action="append", default=[])
    parser.add_argument("--days", type=int, default=1)
    parser.add_argument("--log", type=Path)
    parser.add_argument("--displacement", action="append", default=[])
    options = parser.parse_args(arguments)
    if options.log:
        rows = log_rows(options.log, options.displacement)
    else:
        plants = drawn(options.family, options.seed, options.count)
        labels = options.calibration or list(CALIBRATIONS)
        rows = plant_rows(plants, options.sensors, labels, options.days)
    write_rows(rows, options.out)


if __name__ == "__main__":
    main()
