"""The two machines of a study: the model's, and that of the plants on a mesh of their own."""

from __future__ import annotations

import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.plants.drawing import Plant
from benchmarks.plants.driving import Drive
from benchmarks.plants.judging import Machines
from benchmarks.plants.responding import answers
from fesim.case.schema import Case, case_from_data
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.models.sensors import ROLES
from thermojoint.reduced.loosened import loosening_of
from thermojoint.reduced.machine import ReducedMachine, along, reduce_machine

#: Element sizes of the bodies and of the joint, mm.
MODEL, PLANT = (50.0, 25.0), (40.0, 20.0)
#: The half structure's plane of symmetry moves along these.
AXES = ("x", "y")
#: In mm: on the source, below it, and in the strips; not chosen by any error.
PLACES = {
    "a": (550.0, 650.0, 100.0),
    "b": (550.0, 450.0, 125.0),
    "T1": (625.0, 450.0, 87.5),
    "T2": (625.0, 700.0, 87.5),
}
#: Six more, by body: on the column's rear, top and foot, on the table and below it, on the screw.
MORE = {
    "rear": ("column", (0.0, 600.0, 150.0)),
    "top": ("column", (300.0, 1150.0, 150.0)),
    "foot": ("column", (600.0, 100.0, 150.0)),
    "table top": ("table", (1050.0, 750.0, 150.0)),
    "table bottom": ("table", (1050.0, 350.0, 150.0)),
    "screw": ("screw", (725.0, 175.0, 225.0)),
}


def machine_data(path: Path, sizes: tuple[float, float], more: bool = False) -> dict[str, Any]:
    """Return a case on a mesh, with the sensors of the study; `more` adds those of `MORE`."""
    data = tomllib.loads(path.read_text("utf-8"))
    data["structure"] |= {"element_size_mm": sizes[0], "joint_element_size_mm": sizes[1]}
    data["candidates"] = []
    data["probes"] = {name: {"position_mm": list(PLACES[name]), "body": "column"} for name in ROLES}
    if more:
        data["probes"] |= {
            name: {"position_mm": list(place), "body": body} for name, (body, place) in MORE.items()
        }
    data["heat_input"] = {"kind": "step", "level": 3.0}
    data["march"] |= {"thermal": "reduced", "duration_min": 1.0}
    return data


def prepared(path: Path, more: bool = False) -> tuple[Case, Machines]:
    """Return the case and what every plant needs: two set-ups, with four sensors or with `more`."""
    data = [machine_data(path, sizes, more) for sizes in (MODEL, PLANT)]
    cases = [case_from_data(one, str(path), path.parent) for one in data]
    setups = [set_up(case) for case in cases]
    model, plant = (
        along(reduce_machine(case, setup, tuple(case.probes)), AXES)
        for case, setup in zip(cases, setups, strict=True)
    )
    places = simulate(cases[1], setup=setups[1]).response
    loosening = loosening_of(cases[0], setups[0])
    return cases[0], Machines(model, plant, places.sel(axis=list(AXES)), loosening, data[1])


def with_parameters(data: dict[str, Any], factors: dict[str, float]) -> dict[str, Any]:
    """Return a case's data with the parameters of a plant."""
    found = deepcopy(data)
    for section in found["joints"].values():
        section["friction_coefficient"] *= factors["friction"]
        section["preload_MPa"] *= factors["preload"]
        section["roughness_um"] *= factors["roughness"]
        section["tangential_stiffness_ratio"] *= factors["tangential ratio"]
    for material in found["materials"].values():
        material["conductivity_W_mK"] *= factors["conduction"]
        material["heat_capacity_J_kgK"] *= factors["capacity"]
        material["youngs_modulus_GPa"] *= factors["modulus"]
        material["expansion_1_K"] *= factors["expansion"]
    found["convection_W_m2K"] = {
        name: factors["film"] * value for name, value in found["convection_W_m2K"].items()
    }
    for source in found["sources"].values():
        source["reference_power_W"] *= factors["heat"]
    return found


def difference_from_new_set_up(path: Path, machine: ReducedMachine, plant: Plant) -> float:
    """Return the error of a plant on the study's modes against a new set-up, µm, in a step of 3."""
    data = with_parameters(machine_data(path, PLANT), plant.factors)
    data["march"]["duration_min"] = 35.0
    case = case_from_data(data, str(path), path.parent)
    anew = (
        simulate(case, setup=set_up(case)).response["displacement"].sel(axis=list(AXES)).to_numpy()
    )
    heat = np.full(len(anew) - 1, 3.0)
    (here,) = answers(machine, plant, {"step": Drive(heat, np.zeros(heat.size))}).values()
    return float(1e6 * np.abs(here.displacement - anew).max())
