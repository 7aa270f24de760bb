"""Starts on a warm machine whose past is unknown: error and band, with four sensors and more.

    python -m benchmarks.warm_start --out warm.json [--family films] [--seed 2] [--count 2]
                                    [--more rear --more "table bottom"]

The plants of `benchmarks.plants`, calibrated from steps, and from steps and a cool-down; an
estimator starts 2, 4 and 6 h after the beginning of their day and is judged from 20 min on.
`--more` adds sensors of `benchmarks.plants.preparing.MORE` to the four. Table in
docs/joint-aware.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.plants.drawing import FAMILIES
from benchmarks.plants.judging import CALIBRATIONS, SETTLED, with_sensors
from benchmarks.probing import Plants, calibrated, drawn
from benchmarks.study import options_of, write_rows
from estimator.interface import follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.readings import samples_in
from thermojoint.artefacts.response import columns_of
from thermojoint.artefacts.units import MEGA
from thermojoint.models.sensors import ROLES

#: Starts after the beginning of the day, and how long each is followed, s.
STARTS, FOLLOWED = (7200.0, 14400.0, 21600.0), 7200.0


def rows(plants: Plants, more: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield the figures of every start of every plant and calibration."""
    names = (*ROLES, *more)
    model = with_sensors(plants.machines.model, names)
    for plant in plants.drawn:
        for label in CALIBRATIONS:
            estimator, day = calibrated(plants.machines, model, plant, label)
            samples = np.array(list(samples_in(day, names)))
            actual = columns_of(day, "displacement", estimator.axes)
            for start in STARTS:
                times = samples[:, 0] - start
                kept = (times >= 0.0) & (times <= FOLLOWED)
                yield {
                    "plant": plant.number,
                    "calibration": label,
                    "sensors": len(names),
                    "start_h": start / 3600.0,
                } | figures(estimator, samples[kept], actual[kept])


def figures(estimator: JointAware, samples: np.ndarray, actual: np.ndarray) -> dict[str, Any]:
    """Return the figures of one start."""
    found = [one for _, one in follow(estimator, samples.tolist(), estimator.warm_state())]
    size = MEGA * np.abs(np.array([one.displacement for one in found]) - actual)
    band = MEGA * np.array([one.band for one in found])
    late = samples[:, 0] >= samples[0, 0] + SETTLED
    return {
        "max_um": size[late].max(axis=0).round(2).tolist(),
        "half_band_um": band[late][0].round(1).tolist(),
        "inside_percent": (100.0 * np.mean(size <= band, axis=0)).round(1).tolist(),
    }


def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its rows."""
    parser = options_of(__doc__, "warm.json")
    parser.add_argument("--family", choices=list(FAMILIES), default="films")
    parser.add_argument("--count", type=int, default=2)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--more", action="append", default=[])
    options = parser.parse_args(arguments)
    plants = drawn(options.family, options.seed, options.count)
    write_rows(rows(plants, options.more), options.out)


if __name__ == "__main__":
    main()
