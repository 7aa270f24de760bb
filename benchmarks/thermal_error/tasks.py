"""The tasks: training data of a method, and unseen runs for its validation."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.thermal_error.faults import FAULTS
from benchmarks.thermal_error.making import FAULTY, LEVELS, check
from benchmarks.thermal_error.plants import NAMES, STRUCTURAL
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.log_file import read_log

#: The measured machine: 23 h of a spindle test at 15 s, CAIVIAC/FL_THERMAL on GitHub,
#: data/data.xlsx, MIT licence: the first half of its rows, columns renamed, rounded to 4 decimals.
MEASURED_SHA256 = "549cd09de09fab254f90109b51975eebf27b5c848a9f4eec1589b3825ba639cf"
#: Where its log is split: a method learns on one side and is judged on the other.
SPLIT = 0.6
#: These machines are also started warm, and read twice a day.
HARD = (FAULTY, *STRUCTURAL)
#: A warm start is this part into the day, and judged from this long after it, s.
WARM, SETTLED = 0.5, 1200.0
#: Parts of the day at which the displacement is read.
READ = (0.25, 0.75)


@dataclass(frozen=True, eq=False)
class Task:
    """One row of the leaderboard for each method."""

    name: str
    #: With everything.
    training: Log
    #: With everything; a method is given `as_given(task)`. Its clock is zero where the machine was
    #: cold.
    test: Log
    #: Samples of the test at which the method is given the displacement.
    read: tuple[int, ...] = ()
    #: The method is judged from this long after the test's begin, s.
    settled: float = 0.0


def as_given(task: Task) -> Log:
    """Return the test as a method sees it: its lengths are NaN unless read, or left out."""
    if not task.read:
        return without_displacement(task.test)
    values = task.test.values.copy()
    hidden = np.setdiff1d(np.arange(len(values)), task.read)
    lengths = [task.test.index(name) for name in task.test.of("length")]
    values[hidden[:, None], lengths] = np.nan
    return replace(task.test, values=values)


def without_displacement(log: Log) -> Log:
    """Return a log without its lengths."""
    kept = [k for k, column in enumerate(log.columns) if column.quantity != "length"]
    columns = tuple(log.columns[k] for k in kept)
    return replace(log, columns=columns, values=log.values[:, kept])


def simulated(folder: Path, plants: tuple[str, ...] = NAMES) -> Iterator[Task]:
    """Yield the tasks of the simulated machines, all of one unseen day.

    As it is, with faults, begun in its middle on a warm machine, and with readings.

    Parameters
    ----------
    folder : Path
        Where `making.make` wrote the data.
    plants : tuple of str
        Of which machines.

    Raises
    ------
    InputError
        A file is missing or is not the frozen one.
    """
    for plant in plants:
        names = [f"{plant}-train-step-{level:g}" for level in LEVELS] + [f"{plant}-train-day"]
        training = read_log([check(folder, name) for name in names])
        tests = ["day", *(FAULTS if plant == FAULTY else ())]
        for name in tests:
            test = read_log([check(folder, f"{plant}-test-{name}")])
            yield Task(f"{plant}, {name}", training, test)
        if plant in HARD:
            day = read_log([check(folder, f"{plant}-test-day")])
            count = len(day.times)
            warm = day.part(slice(round(WARM * count), count))
            yield Task(f"{plant}, warm", training, warm, settled=SETTLED)
            read = tuple(round(part * count) for part in READ)
            yield Task(f"{plant}, two readings", training, day, read)


def measured(path: Path) -> Iterator[Task]:
    """Yield the tasks of the measured machine: learn the first 60 %, then the last 60 %.

    Raises
    ------
    InputError
        It is not the file of this benchmark.
    """
    found = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "no file"
    if found != MEASURED_SHA256:
        raise InputError(
            f"{path}: is not the measured log of this benchmark (SHA-256 {found[:12]}...); see "
            "docs/thermal-error-benchmark.md for where it comes from"
        )
    log = read_log([path])
    yield from splits(log, "measured")


def splits(log: Log, name: str) -> Iterator[Task]:
    """Yield both tasks of a log that is split in time, never shuffled."""
    count = len(log.times)
    first = round(SPLIT * count)
    yield Task(f"{name}, last 40 %", log.part(slice(0, first)), log.part(slice(first, count)))
    begin = count - first
    yield Task(f"{name}, first 40 %", log.part(slice(begin, count)), log.part(slice(0, begin)))


def actual(task: Task) -> dict[str, np.ndarray]:
    """Return column to displacement of the test, m, shape (k,)."""
    return {name: task.test.at(name) for name in task.test.of("length")}
