"""Positions that a control does not deliver for a while, on a machine whose axes go on moving.

    python -m benchmarks.missing_positions [--plant 1] [--seed 3] --out missing-positions.json

Plant, model and day are those of `benchmarks.three_axes_day`, with the drives fitted. In the day of
8 h the position of one axis, or those of all, are missing for some minutes, from each full hour on
from the second to the sixth. For the displacement at the present position, against the plant, the
table has the largest error, the largest half-band and the coverage meanwhile, and in the hour
after, beside those of the same samples with positions. Table in docs/moving-axes.md.
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.moving_axis import errors_of, estimates_of
from benchmarks.study import options_of, write_json
from benchmarks.three_axes_day import RUNS, SENSORS, STEP, model_case, plant_of, response_of
from calibrate.joint_aware.calibration import calibrate_joint_aware
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.lines import here
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.response import columns_of

HOUR = 3600.0
#: Minutes without positions, hours at which they begin, and axes.
AWAY, BEGINS, AXES = (1.0, 5.0, 30.0), (2, 3, 4, 5, 6), ("x", "y", "z", "xyz")


def without(estimator: JointAware, samples: Array, axes: str, minutes: float) -> Array:
    """Return the samples without the positions of some axes for some minutes of each hour."""
    found, model = samples.copy(), estimator.model
    first = 1 + len(model.sensors) + 1 + len(model.loads)
    columns = [first + k for k, axis in enumerate(model.moving_axes) if axis.name in axes]
    for begin in BEGINS:
        times = samples[:, 0] - begin * HOUR
        away = np.flatnonzero((times >= 0.0) & (times < 60.0 * minutes))
        found[away[:, None], columns] = np.nan
    return found


def phases(times: Array, minutes: float) -> dict[str, Flags]:
    """Return flags of the samples meanwhile and afterwards, until the next hour."""
    hours = np.floor(times / HOUR)
    counts = np.isin(hours, BEGINS)
    meanwhile = counts & (times - hours * HOUR < 60.0 * minutes)
    return {"meanwhile": meanwhile, "after": counts & ~meanwhile}


def rows_of(rng: np.random.Generator, number: int, folder: Path) -> list[dict[str, Any]]:
    """Return the rows of a plant."""
    case, plant = model_case(folder), plant_of(rng, number)
    responses = {run: response_of(plant, rng, run, folder) for run in RUNS}
    day = responses.pop("day")
    estimator = JointAware(calibrate_joint_aware(case, responses, SENSORS).model)
    samples = np.array(list(KIND.response(estimator.model, day)))
    actual = columns_of(day, "displacement", estimator.axes)
    rows = []
    for axes, minutes in [("", 0.0), *((axes, one) for axes in AXES for one in AWAY)]:
        given = without(estimator, samples, axes, minutes)
        made = estimates_of(estimator, given.tolist())
        moved, band = here(estimator.axes, estimator.details, made)
        for phase, at in phases(samples[:, 0], minutes).items():
            if at.any():
                found = errors_of(moved[at], band[at], actual[at])
                row = {"missing": axes, "minutes": minutes, "phase": phase}
                row["largest_band_um"] = (1e6 * band[at].max(axis=0)).round(1).tolist()
                rows.append(row | found)
                print(json.dumps(rows[-1]), flush=True)
    return rows


def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its rows."""
    parser = options_of(__doc__, "missing-positions.json")
    parser.add_argument("--plant", type=int, default=1)
    parser.add_argument("--seed", type=int, default=3)
    options = parser.parse_args(arguments)
    with TemporaryDirectory() as folder:
        rng = np.random.default_rng((options.seed, options.plant))
        write_json(options.out, {"step_s": STEP, "rows": rows_of(rng, options.plant, Path(folder))})


if __name__ == "__main__":
    main()
