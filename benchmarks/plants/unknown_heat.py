"""What it is worth that an observer estimates heat which no source brings.

    python -m benchmarks.plants.unknown_heat --seed 5 --count 4 --out unknown-heat.json

Plants of the structural family, each with ten thermometers and with four of them, calibrated by
steps and a cool-down, as `benchmarks.plants.ablation` does: errors of a day and of a step without
and with that heat, and whether a calibration would choose it.
"""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from threadpoolctl import threadpool_limits

from benchmarks.plants.ablation import STEP, Fitted, fitted, largest_errors, on_steps_of
from benchmarks.plants.drawing import Plant, draw_unlike
from benchmarks.plants.judging import Machines, exact_answers
from benchmarks.plants.preparing import prepared
from benchmarks.plants.responding import Answer
from benchmarks.study import case_file, options_of, write_rows
from calibrate.joint_aware.assembling import UNKNOWN, observer_from_rest, seen_heat
from estimator.joint_aware.filter_design import Noise

#: Numbers of thermometers, the first ones of the study.
SENSORS = (10, 4)


def main(arguments: list[str] | None = None) -> None:
    """Print a row for every plant and number of thermometers, and write them."""
    write_plants(options_of(__doc__, "unknown-heat.json"), _rows, arguments)


def write_plants(
    parser: ArgumentParser,
    rows: Callable[[int, int], Iterator[dict[str, Any]]],
    arguments: list[str] | None,
) -> None:
    """Print and write the rows of so many plants of a seed, by what is given to a command."""
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--count", type=int, default=4)
    options = parser.parse_args(arguments)
    with threadpool_limits(limits=1):
        write_rows(rows(options.seed, options.count), options.out)


def _rows(seed: int, count: int) -> Iterator[dict[str, Any]]:
    case, machines = prepared(case_file("reference"), more=True)
    machines = on_steps_of(machines, STEP)
    for number in range(count):
        plant = draw_unlike(case, machines.model.sensor_names, seed, number)
        exact = exact_answers(machines, plant)
        for sensors in SENSORS:
            own = fitted(machines, plant, exact, sensors)
            chosen = seen_heat(*own) > 0.0
            about = {"plant": number, "sensors": sensors, "doubt": own.fit.doubt, "chosen": chosen}
            yield about | errors_of(own, machines, plant, exact)


def errors_of(
    own: Fitted, machines: Machines, plant: Plant, exact: Mapping[str, Answer]
) -> dict[str, Any]:
    """Return the largest errors of the observer of a fit without and with unknown heat, um."""
    machine, fit, known, _ = own
    heat = UNKNOWN * float(machine.power.mean())
    noises = {"without": Noise(), "with": Noise(unknown_heat=heat)}
    return {
        name: largest_errors(observer_from_rest(machine, fit, known, noise), machines, plant, exact)
        for name, noise in noises.items()
    }


if __name__ == "__main__":
    main()
