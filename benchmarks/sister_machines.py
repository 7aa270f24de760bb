"""Learned models of machines of one design, from few readings; and of one machine over a year.

    python -m benchmarks.thermal_error make --data thermal_error_data
    python -m benchmarks.sister_machines --data thermal_error_data --out sisters.json

The machines are those of `benchmarks.thermal_error`: each is learned from its training, and
transferred to each of the others by readings of its training day, evenly from a quarter of the day
on. Judged free-running on the test day, in µm rms along x/y: the sister's model as it is, learned
like the sister, learned like all other machines (those beside the sister learned like it), from the
readings alone with the sister's features, and the machine's own model, learned from everything.

The year: preload, friction, heat and film of the reference machine change month by month
(`aged`); it runs one day a month. Learned before, it is followed as it is, with readings twice a
day, and learned every month like the month before, or alone, from the readings of one day; judged
on the day of the next month.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from benchmarks.plants import driving
from benchmarks.plants.drawing import Plant
from benchmarks.plants.responding import answers
from benchmarks.study import options_of, write_json
from benchmarks.thermal_error import drives, tasks
from benchmarks.thermal_error.making import LEVELS, TRAIN_DAY
from benchmarks.thermal_error.plants import (
    AXES,
    NAMES,
    PLACES,
    PLANT_MM,
    logged,
    machine_data,
)
from calibrate.learning.learn import learn
from calibrate.learning.rules import Rules
from calibrate.learning.structures import sizes
from calibrate.learning.transfer import learn_like
from estimator.columns import samples_of
from estimator.interface import follow
from estimator.learned.estimator import Learned
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.log import Log, joined
from thermojoint.artefacts.units import MEGA
from thermojoint.frames import log_from_frame
from thermojoint.models.learned import LearnedModel
from thermojoint.reduced.machine import ReducedMachine, along, reduce_machine

COLUMNS = tuple(f"{axis}_um" for axis in AXES)
COUNTS = (6, 12, 24)
#: Readings of a day in the year's study, and the part of a day before the first reading.
OF_A_DAY, FIRST = 12, 0.25
#: Sisters beside the first are learned from so many readings.
MANY = 48
MONTHS, MONTH = 12, 30.0 * 86400.0


def aged(month: int) -> dict[str, float]:
    """Return factors on the case's parameters: bolts loosen, bearings heat more, air changes."""
    part = month / MONTHS
    return {
        "preload": 1.0 - 0.3 * part,
        "friction": 1.0 - 0.2 * part,
        "heat": 1.0 + 0.15 * part,
        "film": 1.0 + 0.3 * math.sin(2.0 * math.pi * part),
    }


def sparse(day: Log, count: int) -> Log:
    """Return a day whose displacement was read so many times."""
    values, first = day.values.copy(), FIRST * len(day.times)
    read = first + (np.arange(count) + 0.5) / count * (len(values) - first)
    hidden = np.setdiff1d(np.arange(len(values)), read.astype(int))
    values[hidden[:, None], [day.index(name) for name in COLUMNS]] = np.nan
    return replace(day, values=values)


def without_weights(sister: LearnedModel) -> LearnedModel:
    """Return the features of a sister with the prior of learning without one."""
    rules = Rules()
    spread = np.diag((sizes(sister.features, rules.features) / MEGA) ** 2)
    covariance = tuple(tuple(map(float, row)) for row in spread)
    nothing = tuple([0.0] * len(spread))
    channels = tuple(
        replace(channel, zero=0.0, weights=nothing, covariance=covariance)
        for channel in sister.channels
    )
    return replace(sister, channels=channels)


def errors_of(model: LearnedModel, day: Log) -> Array:
    """Return rms errors of a free run through a day, µm, shape (axes,)."""
    estimator = Learned(model)
    samples = samples_of(model.columns, [day])
    found = [one for _, one in follow(estimator, samples, estimator.initial_state())]
    return rms(np.array([one.displacement for one in found]), day)


def rms(estimate: Array, day: Log) -> Array:
    """Return the rms error of an estimate of a day, µm, shape (axes,)."""
    actual = np.stack([day.at(name) for name in COLUMNS], axis=1)
    return np.asarray(MEGA * np.sqrt(np.mean((estimate - actual) ** 2, axis=0)))


def like(days: Log, count: int, sisters: Sequence[LearnedModel]) -> LearnedModel:
    """Return the model learned from so many readings of a day."""
    return learn_like([sparse(days, count)], COLUMNS, sisters)


def transfers(data: Path) -> Iterator[dict[str, Any]]:
    """Yield the errors of every way, for every sister and machine."""
    of = {name: next(iter(tasks.simulated(data, (name,)))) for name in NAMES}
    days = {name: list(task.training.runs())[-1] for name, task in of.items()}
    own = {name: learn(task.training.runs(), COLUMNS) for name, task in of.items()}
    for sister, model in own.items():
        others = {name: like(days[name], MANY, [model]) for name in NAMES if name != sister}
        for name in others:
            test = of[name].test
            fleet = [model, *(one for other, one in others.items() if other != name)]
            ways = {
                "as it is": errors_of(model, test),
                "own, everything": errors_of(own[name], test),
            }
            for count in COUNTS:
                ways |= {
                    f"like it, {count}": errors_of(like(days[name], count, [model]), test),
                    f"like all, {count}": errors_of(like(days[name], count, fleet), test),
                    f"alone, {count}": errors_of(
                        like(days[name], count, [without_weights(model)]), test
                    ),
                }
            yield {"sister": sister, "machine": name} | {
                way: error.round(2).tolist() for way, error in ways.items()
            }


def run_of(machine: ReducedMachine, month: int, drive: drives.Drive, seed: int) -> Log:
    """Return what a logger reads of the machine in a month."""
    plant = Plant(month, aged(month), np.zeros(len(PLACES)), seed)
    inputs = driving.Drive(
        drives.heat_input(drive.rpm)[1:], drive.ambient[1:] - drives.AMBIENT_DEGC
    )
    (answer,) = answers(machine, plant, {"run": inputs}).values()
    columns = logged(drive, answer.temperature, answer.displacement, seed)
    return log_from_frame(pd.DataFrame(columns))


def year() -> Iterator[dict[str, Any]]:
    """Yield the errors of every way, month by month."""
    case = case_from_data(machine_data(PLANT_MM, {}, "reduced"), "reference", Path())
    machine = along(reduce_machine(case, set_up(case), tuple(PLACES)), AXES)
    begun = [run_of(machine, 0, drives.step(level), k) for k, level in enumerate(LEVELS)]
    before = run_of(machine, 0, drives.day(TRAIN_DAY), 10)
    first = learn(joined([*begun, before]).runs(), COLUMNS)
    read, monthly = Learned(first), first
    state = read.initial_state()
    for month in range(1, MONTHS + 1):
        monthly = like(before, OF_A_DAY, [monthly])
        alone = like(before, OF_A_DAY, [without_weights(first)])
        day = run_of(machine, month, drives.day(100 + month), 100 + month)
        twice = [day.at(name) for name in COLUMNS]
        due = [round(part * len(day.times)) for part in tasks.READ]
        estimates = np.zeros((len(day.times), len(COLUMNS)))
        for k, (time, *values) in enumerate(samples_of(first.columns, [day])):
            readings = [one[k] if k in due else math.nan for one in twice]
            state, one = read.sample(state, month * MONTH + time, [*values, *readings])
            estimates[k] = one.displacement
        ways = {
            "as learned before": errors_of(first, day),
            "read twice a day": rms(estimates, day),
            f"like the month before, {OF_A_DAY}": errors_of(monthly, day),
            f"alone, {OF_A_DAY}": errors_of(alone, day),
        }
        yield {"month": month} | {way: error.round(2).tolist() for way, error in ways.items()}
        before = day


def main(arguments: list[str] | None = None) -> None:
    """Run both studies and write their rows."""
    parser = options_of(__doc__, "sisters.json")
    parser.add_argument("--data", type=Path, default=Path("thermal_error_data"))
    options = parser.parse_args(arguments)
    rows: dict[str, list[dict[str, Any]]] = {"year": [], "transfers": []}
    with threadpool_limits(limits=1):
        for name, found in (("year", year()), ("transfers", transfers(options.data))):
            for row in found:
                print(json.dumps(row), flush=True)
                rows[name].append(row)
    for name, part in rows.items():
        for way in part[0]:
            if isinstance(part[0][way], list):
                every = np.array([row[way] for row in part])
                mean = np.exp(np.log(every).mean(axis=0)).round(2)
                worst = every.max(axis=0)
                print(f"{name}, {way}: geometric mean {mean.tolist()}, largest {worst.tolist()}")
    write_json(options.out, rows)


if __name__ == "__main__":
    main()
