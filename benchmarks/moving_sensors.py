"""Sensors placed on a machine with a moving axis, on plants that are not its model: a day.

    python -m benchmarks.moving_sensors --out moving-sensors.json [--plants 1] [--sets 5]

The model is the shipped machine with a moving knee, the plants are those of
`benchmarks.moving_axis`: a finer mesh, other parameters, noise on every thermometer, a table that
moves at random. Candidates are a lattice on column and table. Four sensors by
`calibrate.placement`, chosen for the whole stroke, also beside a thermometer on the source, and for
its upper end alone, those of the case, and sets at random. With every set the model is calibrated
from steps of 0.5, 1 and 2 and a cool-down, and estimates a day of 8 h, free-running. Table in
docs/sensor-placement.md.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import xarray as xr

from benchmarks.moving_axis import (
    ELEMENTS,
    STEP,
    asked_by,
    errors_of,
    estimates_of,
    plant_of,
    responses_of,
)
from benchmarks.study import case_file, options_of, write_json
from calibrate.joint_aware.assembling import make_observer
from calibrate.joint_aware.calibration import calibrated_range, machine_of
from calibrate.joint_aware.misfit import fewer
from calibrate.joint_aware.physics_fit import SEARCH, fit_physics
from calibrate.joint_aware.readings import run_in
from calibrate.placement import plant_family
from calibrate.placement.joint_aware import place_sensors
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.lines import here
from fesim.axes.setup import set_up_axes
from fesim.case.schema import Case, read_case
from fesim.setup.structure import candidate_probes
from thermojoint.artefacts.response import columns_of
from thermojoint.artefacts.units import MEGA, MILLI
from thermojoint.reduced.machine import ReducedMachine, along

#: Corners of the lattices, mm, and their spacing.
BOXES = {
    "column": ([550.0, 350.0, 50.0], [650.0, 1050.0, 250.0]),
    "table": ([675.0, 350.0, 75.0], [825.0, 750.0, 275.0]),
}
SPACING = 100.0
#: The probe of the case on the source.
SOURCE = "bearing"
#: Sensors of a set; seed of the sets and the plants.
COUNT, SEED = 4, 2
CALIBRATION = ("0.5", "1", "2", "cool-down")


def with_candidates(case: Case) -> tuple[Case, list[str]]:
    """Return the case with its candidates as probes, and their names."""
    boxes = [
        {"body": body, "low_mm": low, "high_mm": high, "spacing_mm": SPACING}
        for body, (low, high) in BOXES.items()
    ]
    found = candidate_probes(
        case.replace(candidates=boxes),
        set_up_axes(case).setup.structure,
    )
    probes = {
        name: {"position_mm": [float(at) / MILLI for at in probe.position], "body": probe.body}
        for name, probe in found.items()
    }
    return case.replace(probes=probes), list(found)


def sets_of(
    machine: ReducedMachine, candidates: list[str], own: list[str], count: int
) -> tuple[dict[str, tuple[str, ...]], dict[str, list[float]]]:
    """Return the sets of sensors by how they were found, and the predicted band of each, um."""
    few = plant_family.fewer_modes(machine)
    family, every = plant_family.make_family(few), plant_family.filter_modes(few)
    seen, lattice = _among(every, family, candidates)
    beside, with_source = _among(every, family, [SOURCE, *candidates])
    axes = len(machine.axes)
    end = replace(lattice, displacement=lattice.displacement[:, -axes:], places=lattice.places[-1:])
    rng = np.random.default_rng(SEED)
    found = {
        "placed": place_sensors(seen, COUNT, family=lattice).chosen.names,
        "placed beside the source": place_sensors(
            beside, COUNT, [SOURCE], family=with_source
        ).chosen.names,
        "placed for the upper end": place_sensors(seen, COUNT, family=end).chosen.names,
        "those of the case": tuple(own),
    }
    for number in range(1, count + 1):
        drawn = rng.choice(candidates, size=COUNT, replace=False)
        found[f"at random {number}"] = tuple(map(str, drawn))
    bands = {
        how: (MEGA * place_sensors(every, COUNT, names, family).chosen.band).tolist()
        for how, names in found.items()
    }
    return found, bands


def _among(
    machine: ReducedMachine, family: plant_family.Family, names: list[str]
) -> tuple[ReducedMachine, plant_family.Family]:
    """The machine and the family with some of their candidates."""
    at = [machine.sensor_names.index(name) for name in names]
    return machine.with_sensors(names), replace(family, readings=family.readings[:, at])


def judged(
    machine: ReducedMachine, names: tuple[str, ...], responses: Mapping[str, xr.Dataset]
) -> dict[str, Any]:
    """Return the errors of a day by a set of sensors."""
    own = machine.with_sensors(names)
    runs = [fewer(run_in(responses[name], own, name)) for name in CALIBRATION]
    fit = fit_physics(own, runs, search=replace(SEARCH, starts=0))
    known = calibrated_range(own, {name: responses[name] for name in CALIBRATION})
    estimator, day = JointAware(make_observer(own, fit, known)), responses["day"]
    made = estimates_of(estimator, list(KIND.response(estimator.model, day)))
    moved, band = here(estimator.axes, estimator.details, made)
    wanted = day["asked_displacement"][:, 0].sel(axis=list(estimator.axes)).to_numpy()
    anywhere = np.abs(asked_by(estimator, made) - wanted).max(axis=(0, 1))
    found = errors_of(moved, band, columns_of(day, "displacement", estimator.axes))
    kept = ("size_um", "max_um", "rms_um")
    return {key: found[key] for key in kept} | {
        "anywhere_max_um": (MEGA * anywhere).round(2).tolist()
    }


def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its rows."""
    parser = options_of(__doc__, "moving-sensors.json")
    parser.add_argument("--plants", type=int, default=1)
    parser.add_argument("--sets", type=int, default=5)
    options = parser.parse_args(arguments)
    case = read_case(case_file("moving_knee")).replace(march={"step_s": STEP})
    own = list(case.probes)
    of_model, of_plant = ({"element_size_mm": size} for size in ELEMENTS)
    case, candidates = with_candidates(case.replace(structure=of_model))
    machine = along(machine_of(case, [*own, *candidates]), ["x", "y"])
    sets, bands = sets_of(machine, candidates, own, options.sets)
    rows: list[dict[str, Any]] = []
    for number in range(1, options.plants + 1):
        rng = np.random.default_rng((SEED, number))
        plant = plant_of(case, rng, number).replace(structure=of_plant)
        with TemporaryDirectory() as folder:
            responses = responses_of(plant, rng, Path(folder), STEP)
        responses = {name: one.drop_vars("axis_way") for name, one in responses.items()}
        for how, names in sets.items():
            row = {"plant": number, "how": how, "sensors": list(names), "band_um": bands[how]}
            rows.append(row | judged(machine, names, responses))
            print(json.dumps(rows[-1]), flush=True)
            write_json(options.out, rows)


if __name__ == "__main__":
    main()
