"""Plants that differ from their model in structure: each is set up anew and marched step by step.

What happens outside the plant's parameters is added to its reduced model: a film for every part of
the surface, films that grow while a door is open, air that becomes warmer at the top, friction heat
in the table and in the base, conductivity and expansion that follow the mean temperature of the
thermometers, a preload that is uneven along the strips.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from benchmarks.plants.drawing import PARTS, Plant, Unlike
from benchmarks.plants.driving import Drive, switched
from benchmarks.plants.responding import Answer
from calibrate.joint_aware.misfit import basis_with, physics_with
from fesim.case.schema import case_from_data
from fesim.setup.machine import Setup, set_up
from fesim.solid.heat import convection_matrix
from thermojoint.reduced.machine import Joint, ReducedMachine, along, reduce_machine
from thermojoint.reduced.parameters import with_factors
from thermojoint.reduced.physics import Physics, conduct, settle_joint

#: How long friction heat and doors stay as they are, s; the air's warming by 63 %, s.
LASTS, WARMING = (1200.0, 5400.0), 7200.0
#: Runs longer than this see a door open, s.
LONG = 4.5 * 3600.0


def structural_answers(
    data: dict[str, Any], sensors: tuple[str, ...], plant: Plant, runs: dict[str, Drive]
) -> dict[str, Answer]:
    """Set up a plant and march it through runs.

    `data`: the case on the plants' mesh, with every sensor as a probe. `sensors`: those probes.
    `plant`: with differences in structure. `runs`: name to inputs.
    """
    assert plant.unlike is not None
    case = case_from_data(_with_structure(data, plant.unlike, sensors), "plant", Path())
    setup = set_up(case)
    machine = along(reduce_machine(case, setup, sensors), ("x", "y"))
    machine = _with_surroundings(machine, setup, plant.unlike)
    joints = _uneven(machine.joints, setup, plant.unlike.uneven)
    machine = replace(machine, joints=joints)
    physics = physics_with(machine, plant.factors)
    _, basis = basis_with(machine, plant.factors)
    film = basis.T @ with_factors(machine, plant.factors).convection @ basis
    physics = replace(physics, modes=replace(physics.modes, film=film))
    rngs = np.random.default_rng(plant.seed).spawn(len(runs))
    return {
        name: _marched(physics, machine, plant.unlike, drive, rng)
        for (name, drive), rng in zip(runs.items(), rngs, strict=True)
    }


def _with_structure(
    data: Mapping[str, Any], unlike: Unlike, sensors: tuple[str, ...]
) -> dict[str, Any]:
    """Return the case's data with the plant's geometry, laws, feet and sources."""
    wall = unlike.dimensions["wall"]
    lengths = data["structure"].get("dimensions_mm", {}) | unlike.dimensions
    (joint,) = data["joints"]
    normal, conductance = unlike.laws
    section = data["joints"][joint] | {
        "normal_law": normal,
        "conductance": {"law": conductance},
    }
    probes = {}
    for name, moved in zip(sensors, unlike.place, strict=True):
        x, y, z = data["probes"][name]["position_mm"]
        # On the top of a body along x and z, else along y and z; on the inside of the front wall.
        along_x = name.startswith(("top", "table"))
        x = 600.0 - wall if x == 550.0 else x + along_x * moved[0]
        place = [x, y + (not along_x) * moved[0], min(z + moved[1], 240.0)]
        probes[name] = data["probes"][name] | {"position_mm": place}
    unknown = {"reference_power_W": 1.0, "reading": "total"}
    return dict(data) | {
        "structure": data["structure"]
        | {"dimensions_mm": lengths | {"source_inset": max(50.0, wall)}},
        "joints": {joint: section},
        "probes": probes,
        "supports": on_feet(data["supports"], unlike.feet),
        "sources": data["sources"]
        | {"table": unknown | {"body": "table"}, "base": unknown | {"surface": "column_base"}},
    }


def on_feet(supports: Mapping[str, Any], feet: tuple[float, float]) -> dict[str, Any]:
    """Return the supports of a case on elastic feet, N/um (`Unlike.feet`)."""
    base, screw = ({"stiffness_N_um": [stiffness] * 3} for stiffness in feet)
    return {
        "symmetry": supports["symmetry"],
        "springs": {"column_base": base, "screw_foot": screw},
    }


def _with_surroundings(machine: ReducedMachine, setup: Setup, unlike: Unlike) -> ReducedMachine:
    """Return the machine with its films; warmer air at its top, per K there, is one more source."""
    assert setup.modes is not None
    basis, height = setup.modes.basis, setup.spaces.heat.doflocs[1]
    warmer = basis.T @ (_convection(setup, unlike.films) @ (height / height.max()))
    found = with_films(machine, setup, unlike.films)
    return replace(found, sources=np.column_stack([machine.sources, warmer]))


def with_films(machine: ReducedMachine, setup: Setup, films: Mapping[str, float]) -> ReducedMachine:
    """Return a machine with the films of a plant, W/(m2 K), and no film as a parameter."""
    assert setup.modes is not None
    basis, convection = setup.modes.basis, _convection(setup, films)
    return replace(
        machine,
        convection=basis.T @ (convection @ basis),
        ambient=basis.T @ (convection @ np.ones(len(basis))),
        films=(),
    )


def _convection(setup: Setup, films: Mapping[str, float]) -> csr_array:
    """Convection matrix of a plant's films on all parts of its surface, W/K."""
    structure = setup.structure
    outside, rear = structure.surfaces["exterior"], structure.surfaces["rear"]
    height = structure.mesh.p[1, structure.mesh.facets[:, outside]].mean(axis=0)
    top = height > height.max() - 1e-6
    table = np.isin(structure.mesh.f2t[0, outside], structure.bodies["column"], invert=True)
    of_rear = np.isin(outside, rear)
    parts = (~(top | table | of_rear), top & ~of_rear, table, of_rear)
    own = {f"{name} part": outside[part] for name, part in zip(PARTS, parts, strict=True)}
    own["interior part"] = structure.surfaces["interior"]
    named = replace(structure, surfaces=structure.surfaces | own)
    return csr_array(
        sum(
            film * convection_matrix(named, setup.spaces.heat, f"{name} part", setup.joints)
            for name, film in films.items()
        )
    )


def _uneven(joints: tuple[Joint, ...], setup: Setup, uneven: float) -> tuple[Joint, ...]:
    """Return the joints row by row, with a preload that is linear along the strips."""
    (joint,) = joints
    height = np.concatenate([one.centre for one in setup.joints])[:, 1]
    # From -1 at the lower end to 1 at the upper.
    place = 2.0 * (height - height.min()) / np.ptp(height) - 1.0
    found = []
    for value, group in groupby(range(place.size), key=lambda k: round(float(place[k]), 6)):
        rows = list(group)
        section = joint.section.model_copy(
            update={"preload_MPa": joint.section.preload_MPa * (1.0 + uneven * value)}
        )
        found.append(Joint(section, joint.conductivity[rows]))
    return tuple(found)


def _marched(
    physics: Physics,
    machine: ReducedMachine,
    unlike: Unlike,
    drive: Drive,
    rng: np.random.Generator,
) -> Answer:
    """March from rest with everything that the model does not know."""
    modes, length, count = physics.modes, machine.step, drive.heat.size
    times = length * np.arange(1.0, count + 1.0)
    unknown = [
        power * switched(rng, times, LASTS, (0.0, 1.0)) for power in unlike.friction.values()
    ]
    warmer = unlike.gradient * -np.expm1(-times / WARMING)
    inputs = np.column_stack([drive.heat * machine.power[0], *unknown, warmer, drive.ambient])
    opened = np.round(switched(rng, times, LASTS, (0.0, 1.0))) * (times[-1] > LONG)
    beyond = opened * (unlike.door - 1.0)
    conduction = np.diag(modes.rates) - modes.film
    conduction -= modes.jump.T @ (physics.held[:, None] * modes.jump)
    # The air that is warmer at the top, and the ambient.
    air = inputs[:, -2:] @ modes.drive[:, -2:].T
    amplitudes, joint = np.zeros(modes.rates.size), physics.at_rest()
    temperature = np.zeros((count + 1, len(modes.sensors)))
    displacement = np.zeros((count + 1, len(machine.axes)))
    for k, given in enumerate(inputs):
        mean = float(temperature[k].mean())
        more = -unlike.conduction * mean * (conduction @ amplitudes)
        more -= beyond[k] * (modes.film @ amplitudes - air[k])
        amplitudes = conduct(physics, amplitudes + length * more, given, joint, length)
        grown = amplitudes * (1.0 + unlike.expansion * mean)
        joint, displacement[k + 1] = settle_joint(physics, joint, grown, modes.factors)
        temperature[k + 1] = modes.sensors @ amplitudes
    kept = np.exp(-length / unlike.lag)
    for k in range(count):
        temperature[k + 1] = kept * temperature[k] + (1.0 - kept) * temperature[k + 1]
    return Answer(drive, temperature, displacement)
