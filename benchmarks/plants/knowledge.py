"""What is left of the error of a day if something about a plant is known exactly.

    python -m benchmarks.plants.knowledge --seed 5 --count 4 --out knowledge.json

Plants of the structural family with ten thermometers, calibrated by steps and a cool-down, as
`benchmarks.plants.ablation` does. The case has fixed supports, or feet: those of the plant, or
`USUAL` ones. Known films are those of the plant; its heat is known if there is none beside that of
its sources, no open door and even air; the places of its sensors are known if they are those of the
case. Feet that are found are those of a second fit, with films of patches
(`thermojoint.reduced.loosened`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.plants.ablation import STEP, fitted, on_steps_of, without
from benchmarks.plants.drawing import Plant, draw_unlike
from benchmarks.plants.judging import Machines, exact_answers
from benchmarks.plants.preparing import AXES, MODEL, machine_data, prepared
from benchmarks.plants.responding import Answer
from benchmarks.plants.structural import on_feet, with_films
from benchmarks.plants.unknown_heat import errors_of, write_plants
from benchmarks.study import case_file, options_of
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from thermojoint.reduced.loosened import loosening_of
from thermojoint.reduced.machine import ReducedMachine, along, reduce_machine
from thermojoint.reduced.parameters import active

SENSORS = 10
#: Under the column and under the screw, N/um: about the middle of `benchmarks.plants.drawing.FOOT`.
USUAL = (1700.0, 1700.0)
#: A model whose feet, and films of patches, are found by its fit.
FOUND = (False, "found")
#: Whether a model has the films of the plant, and its feet.
MODELS = (*product((False, True), ("fixed", "usual", "known")), FOUND)
#: What a plant is without (`benchmarks.plants.ablation`), to the models that are fitted to it.
KNOWN = {
    "nothing": MODELS,
    "unknown heat, all three": MODELS,
    "places of sensors": (FOUND,),
    "lags and places of sensors": (FOUND,),
}


def main(arguments: list[str] | None = None) -> None:
    """Print a row for every plant and everything that may be known, and write them."""
    write_plants(options_of(__doc__, "knowledge.json"), _rows, arguments)


def _rows(seed: int, count: int) -> Iterator[dict[str, Any]]:
    path = case_file("reference")
    case, machines = prepared(path, more=True)
    machines = on_steps_of(machines, STEP)
    for number in range(count):
        plant = draw_unlike(case, machines.model.sensor_names, seed, number)
        for known, models in KNOWN.items():
            own = without(plant, known)
            exact = exact_answers(machines, own)
            for films, feet in models:
                told = replace(machines, model=_told(path, plant, films, feet))
                about = {"plant": number, "known": known, "films": films, "feet": feet}
                yield about | _errors(told, own, exact)


def _told(path: Path, plant: Plant, films: bool, feet: str) -> ReducedMachine:
    """Return the model of a case that has the films of a plant, and some feet."""
    assert plant.unlike is not None
    data = machine_data(path, MODEL, more=True)
    if feet in ("usual", "known"):
        own = USUAL if feet == "usual" else plant.unlike.feet
        data["supports"] = on_feet(data["supports"], own)
    case = case_from_data(data, str(path), path.parent)
    setup = set_up(case)
    machine = along(reduce_machine(case, setup, tuple(case.probes)), AXES)
    machine = with_films(machine, setup, plant.unlike.films) if films else machine
    if feet == "found":
        loosening = loosening_of(case, setup)
        assert loosening is not None
        machine = loosening.of(machine)
    return replace(machine, step=STEP)


def _errors(machines: Machines, plant: Plant, exact: Mapping[str, Answer]) -> dict[str, Any]:
    """Largest errors of the observer without and with unknown heat, um, and doubt of the fit."""
    model = machines.model
    # What is known exactly is no parameter.
    free = [one.name for one in active(model) if model.films or one.name != "film"]
    own = fitted(machines, plant, exact, SENSORS, free)
    return {"doubt": own.fit.doubt} | errors_of(own, machines, plant, exact)


if __name__ == "__main__":
    main()
