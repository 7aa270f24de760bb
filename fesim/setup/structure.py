"""The structure of a case: its mesh with all names, materials and probes, in SI."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np

from fesim.case.schema import CandidatesSection, Case, MeshSection, MillingMachineSection
from fesim.case.thermal_sections import MaterialSection
from fesim.solid.materials import Material
from fesim.solid.spaces import cells_at
from meshes.exchange import read_structure
from meshes.milling_machine import MillingMachineDimensions, box_milling_machine
from meshes.structure import Probe, Structure
from meshes.units import UNITS
from meshes.wall import face_of, with_wall
from thermojoint.artefacts.errors import InputError, shown_point, unknown_name
from thermojoint.artefacts.settings.toml import as_key

#: A larger number of possible sensors than this is probably a mistake of the unit.
MOST_CANDIDATES = 100_000


def build_structure(case: Case) -> Structure:
    """Build or read the structure, with the probes and joints of the case."""
    section = case.structure
    probes = {
        name: Probe(_metres(probe.position_mm), probe.body) for name, probe in case.probes.items()
    }
    if isinstance(section, MillingMachineSection):
        known = {field.name for field in fields(MillingMachineDimensions)}
        for name in section.dimensions_mm:
            if name not in known:
                raise unknown_name("dimension", name, known, "structure.dimensions_mm")
        lengths = {name: 1e-3 * value for name, value in section.dimensions_mm.items()}
        joint_size = section.joint_element_size_mm
        structure = box_milling_machine(
            MillingMachineDimensions(**lengths),
            element_size=1e-3 * section.element_size_mm,
            joint_element_size=None if joint_size is None else 1e-3 * joint_size,
            half=section.half,
            probes=probes,
        )
    else:
        structure = read_structure(section.file, UNITS[section.unit])
    for name, wall in case.walls.items():
        structure = with_wall(structure, name, wall.faces)
    sides = structure.joints
    joints = {}
    for name, joint in case.joints.items():
        if joint.side_a is not None and joint.side_b is not None:
            joints[name] = (_side(case, joint.side_a), _side(case, joint.side_b))
        elif name in sides:
            joints[name] = sides[name]
        else:
            raise unknown_name("joint", name, sides, "joints")
    unused = set(sides) - set(joints)
    if unused:
        name = min(unused)
        raise InputError(
            f"joints: the structure's joint {name!r} has no section; add [joints.{as_key(name)}]"
        )
    if isinstance(section, MeshSection):
        structure = replace(structure, symmetry_factor=section.symmetry_factor)
    return replace(structure, joints=joints, probes=structure.probes | probes)


def _side(case: Case, name: str) -> str:
    """Return the surface for the name of a surface or a wall in a joint."""
    return face_of(name) if name in case.walls else name


def material_of(section: MaterialSection) -> Material:
    """Return a material without its factors."""
    return Material(
        conductivity=section.conductivity_W_mK,
        density=section.density_kg_m3,
        heat_capacity=section.heat_capacity_J_kgK,
        youngs_modulus=1e9 * section.youngs_modulus_GPa,
        poisson_ratio=section.poisson_ratio,
        expansion=section.expansion_1_K,
    )


def body_materials(case: Case, structure: Structure) -> dict[str, Material]:
    """Material of every body."""
    made = {name: material_of(section) for name, section in case.materials.items()}
    for body, material in case.bodies.items():
        structure.body(body, "bodies")
        if material not in made:
            raise unknown_name("material", material, made, f"bodies.{body}")
    for body in structure.bodies:
        if body not in case.bodies:
            raise InputError(
                f'bodies: body {body!r} has no material; add {as_key(body)} = "MATERIAL"'
            )
    return {body: made[case.bodies[body]] for body in structure.bodies}


def candidate_probes(case: Case, structure: Structure) -> dict[str, Probe]:
    """Possible sensors: lattice points of each ``[[candidates]]`` box that lie in its body.

    A candidate is named after its position in mm, e.g. ``s575_700_150``, and also after its body if
    the boxes are in more than one: ``s575_700_150_column``.

    Raises
    ------
    InputError
        A box refers to a body that does not exist, has too many points, or none in its body.
    """
    probes: dict[str, Probe] = {}
    several = len({section.body for section in case.candidates}) > 1
    for number, section in enumerate(case.candidates, 1):
        cells = structure.body(section.body, "candidates.body")
        if math.prod(_lattice_counts(section)) > MOST_CANDIDATES:
            raise InputError(
                f"candidates: more than {MOST_CANDIDATES} lattice points; raise spacing_mm"
            )
        lattice = _lattice(section)
        at = cells_at(structure.mesh, 1e-3 * np.array(lattice), cells)
        if not (at >= 0).any():
            raise InputError(
                f"candidates: no lattice point of box {number} lies in body {section.body!r}; move "
                "the box, or reduce its spacing_mm"
            )
        for point, cell in zip(lattice, at, strict=True):
            if cell >= 0:
                name = "s" + "_".join(f"{value:g}" for value in point)
                probes[f"{name}_{section.body}" if several else name] = Probe(
                    _metres(point), section.body
                )
    return probes


def body_of_candidate(name: str) -> str | None:
    """Return the body in the name of a candidate; None if there is none."""
    parts = name.split("_", 3)
    return parts[3] if name.startswith("s") and len(parts) > 3 else None


def _lattice(section: CandidatesSection) -> list[tuple[float, float, float]]:
    counts = _lattice_counts(section)
    axes = [
        np.linspace(low, high, count) if count > 1 else np.array([low])
        for low, high, count in zip(section.low_mm, section.high_mm, counts, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return [(float(x), float(y), float(z)) for x, y, z in grid]


def _lattice_counts(section: CandidatesSection) -> list[int]:
    return [
        max(2, round(min((high - low) / section.spacing_mm, 1e9)) + 1) if high > low else 1
        for low, high in zip(section.low_mm, section.high_mm, strict=True)
    ]


def _metres(point: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = (1e-3 * value for value in point)
    return x, y, z


def measured_points(case: Case) -> list[str]:
    """Return the point whose displacement is recorded, and its reference point if there is one."""
    if case.displacement is None:
        return []
    point, origin = case.displacement.point, case.displacement.relative_to
    return [point] if origin is None else [point, origin]


def displacement_of(case: Case) -> str:
    """Return a readable description of the displaced and the reference point."""
    names, section = measured_points(case), case.displacement
    if section is not None and section.tool_mm is not None:
        names[0] = f"a tool's tip, {shown_point(section.tool_mm)} mm from {names[0]},"
    return " relative to ".join(names)
