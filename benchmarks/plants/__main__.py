"""Judge every estimator on plants drawn at random.

    python -m benchmarks.plants --out plants.json       # 100 plants, about 40 minutes

A model on a 50/25 mm mesh, plants on 40/20 mm with eleven parameters, sensor offsets and noise
drawn, each calibrated from its own steps of 0.5, 1 and 2 and once more with a cool-down of 4 h.
With `--family films` the plants have the case's parameters but uneven films instead; those of
`--family structural` differ from any machine that the model can be, and are also observed with ten
sensors (use `--estimator joint-aware --estimator baselines`); with `--days 5` they are calibrated
with 1, 2 and 5 recorded days as well.
Each plant has a file of its own beside the result; stopped in any way, the same command goes on
from there.
"""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from benchmarks.plants.drawing import FAMILIES, Plant
from benchmarks.plants.estimating import ESTIMATORS
from benchmarks.plants.judging import judge_plant
from benchmarks.plants.preparing import difference_from_new_set_up, prepared
from benchmarks.plants.summary import summary_of, table_of
from benchmarks.study import case_file, options_of, write_json

#: Plants that are compared with machines set up anew: no case says two films of one surface.
CHECKED = {"parameters": 3, "films": 0, "structural": 0}

#: From a plant to all that it says.
Judge = Callable[[Plant], dict[str, Any]]


def main(arguments: list[str] | None = None) -> None:
    """Run what is not finished, then judge all of it."""
    parser = options_of(__doc__, "plants.json")
    parser.add_argument("--family", choices=list(FAMILIES), default="parameters")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--days", type=int, default=0)
    parser.add_argument("--estimator", action="append", choices=list(ESTIMATORS), default=[])
    parser.add_argument("--case", type=Path, default=case_file("reference"))
    options = parser.parse_args(arguments)
    case, machines = prepared(options.case, more=options.family == "structural")
    drawn, sensors = FAMILIES[options.family], machines.model.sensor_names
    plants = [drawn(case, sensors, options.seed, number) for number in range(options.count)]
    folder = options.out.with_suffix(f".{options.family}-{options.seed}")
    judge = partial(judge_plant, wanted=tuple(options.estimator or ESTIMATORS), days=options.days)
    kept = partial(_kept, partial(judge, machines), folder)
    found = list(track(_judged(kept, plants, options.workers), "plants", len(plants)))
    rows = [row for one in found for row in one["rows"]]
    checked = {
        str(plant.number): difference_from_new_set_up(options.case, machines.plant, plant)
        for plant in plants[: CHECKED[options.family]]
    }
    summary = summary_of(rows)
    content = {
        "family": options.family,
        "seed": options.seed,
        "rows": rows,
        "summary": summary,
        "difference_from_new_set_up_um": checked,
        "plants": [{name: one[name] for name in ("plant", "factors", "offset_K")} for one in found],
        "calibrations": [row for one in found for row in one["calibrations"]],
    }
    write_json(options.out, content)
    console = Console(width=140)
    console.print(table_of(summary))
    console.print(f"plants on the study's modes against new set-ups, step 3.0, µm: {checked}")


def _judged(judge: Judge, plants: list[Plant], workers: int) -> Iterator[dict[str, Any]]:
    """Yield what every plant says, in their order."""
    with multiprocessing.get_context("fork").Pool(workers) as pool:
        yield from pool.imap(judge, plants)


def _kept(judge: Judge, folder: Path, plant: Plant) -> dict[str, Any]:
    """Return what a plant says, from its file where there is one."""
    path = folder / f"{plant.number:03d}.json"
    if path.is_file():
        kept: dict[str, Any] = json.loads(path.read_text("utf-8"))
        return kept
    found = judge(plant)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(path, found)
    return found


if __name__ == "__main__":
    main()
