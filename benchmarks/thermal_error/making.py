"""The benchmark's data, simulated again and compared with the frozen hashes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.thermal_error import drives, freezing
from benchmarks.thermal_error.faults import FAULTS
from benchmarks.thermal_error.plants import NAMES, PLANTS, driven, driven_unlike, set_up_plant
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.files import write_text

#: Hash and borders of every file, kept in the repository.
FROZEN = Path(__file__).with_name("frozen.json")
#: Levels of the steps that calibrate; seeds of the days that train and that test.
LEVELS = (0.5, 1.0, 2.0)
TRAIN_DAY, TEST_DAY = 11, 12
#: Only this machine is tested with faults.
FAULTY = "reference"

Columns = dict[str, Array]


def runs_of(plant: str) -> Iterator[tuple[str, Columns]]:
    """Yield name and columns of every file of a plant: its steps, its days, its faults."""
    runs = {f"{plant}-train-step-{level:g}": drives.step(level) for level in LEVELS}
    days = {f"{plant}-train-day": TRAIN_DAY, f"{plant}-test-day": TEST_DAY}
    runs |= {name: drives.day(seed) for name, seed in days.items()}
    number = list(NAMES).index(plant)
    if plant not in PLANTS:
        yield from driven_unlike(plant, runs, 10 * number).items()
        return
    data, setup = set_up_plant(plant)
    for k, (name, drive) in enumerate(runs.items()):
        # The days' noise has had these seeds since the data were frozen.
        columns = driven(data, setup, drive, 10 * number + k + 2 * (name in days))
        yield name, columns
    if plant == FAULTY:
        for fault, put in FAULTS.items():
            yield f"{plant}-test-{fault}", put(columns)


def make(folder: Path, say: Callable[[str], None], plants: tuple[str, ...] = NAMES) -> list[str]:
    """Write every file and return the names of those that are not the frozen ones.

    Parameters
    ----------
    folder : Path
        Gets one CSV for each file.
    say : callable
        Told of every file.
    plants : tuple of str
        Of which machines.
    """
    frozen = read_frozen()
    other = []
    for plant in plants:
        for name, columns in runs_of(plant):
            if name not in frozen:
                raise InputError(f"{name}: not among the frozen data; run with --freeze")
            text = freezing.as_csv(columns, frozen[name]["borders"])
            write_text(folder / f"{name}.csv", text)
            same = freezing.digest(text) == frozen[name]["sha256"]
            say(f"{name}: {'as frozen' if same else 'DIFFERS from the frozen data'}")
            other += [] if same else [name]
    return other


def freeze(folder: Path, say: Callable[[str], None], plants: tuple[str, ...] = NAMES) -> None:
    """Write every file, and freeze hashes and borders: for those who keep the benchmark."""
    frozen = dict(read_frozen())
    for plant in plants:
        for name, columns in runs_of(plant):
            gaps = {
                column: freezing.widest_gap(values, freezing.grid_of(column))
                for column, values in columns.items()
            }
            borders = {column: middle for column, (middle, _) in gaps.items()}
            text = freezing.as_csv(columns, borders)
            write_text(folder / f"{name}.csv", text)
            frozen[name] = {"sha256": freezing.digest(text), "borders": borders}
            least = min(gap / freezing.grid_of(column) for column, (_, gap) in gaps.items())
            say(f"{name}: frozen, {least:.1e} of a grid cell between any value and a border")
    write_text(FROZEN, json.dumps(frozen, indent=1) + "\n")


def read_frozen() -> Mapping[str, Any]:
    """Return name of a file to its hash and the borders of its columns."""
    return dict(json.loads(FROZEN.read_text("utf-8"))) if FROZEN.is_file() else {}


def check(folder: Path, name: str) -> Path:
    """Return the path of a file of the benchmark, if it is the frozen one.

    Raises
    ------
    InputError
        It is missing, or differs.
    """
    path = folder / f"{name}.csv"
    remedy = f"make the data: python -m benchmarks.thermal_error make --data {folder}"
    if not path.is_file():
        raise InputError(f"{path}: no such file; {remedy}")
    if freezing.digest(path.read_text("utf-8")) != read_frozen()[name]["sha256"]:
        raise InputError(f"{path}: is not the frozen file of this benchmark; {remedy}")
    return path
