"""Structure, materials, laws and loads of a case, checked before any finite-element work."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fesim.case.axis_section import AxisSection
from fesim.case.joint_sections import JointSection
from fesim.case.schema import Case, not_reducible
from fesim.joint.law import JointLaw
from fesim.setup.bolts import bolts_of, first_forces
from fesim.setup.constraints import checked_constraints, fixed_surfaces
from fesim.setup.initial_temperature import read_initial_temperature
from fesim.setup.laws import joint_laws
from fesim.setup.loads import (
    heat_sources,
    held_profiles,
    march_inputs,
    mechanical_loads,
)
from fesim.setup.soundness import check_sound
from fesim.setup.structure import body_materials, build_structure, candidate_probes, measured_points
from fesim.solid.bolts import Bolt
from fesim.solid.rigid_motions import Constraints
from meshes.pairing import PairedJoint, pair_joint
from meshes.structure import Probe, Structure
from meshes.travel import sliding
from meshes.wall import face_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name

#: A dense matrix of all joints has (three times this) squared numbers: 2.6 GB.
MOST_IN_ALL = 6_000


@dataclass(frozen=True)
class Parts:
    """Checked contents of a case, before any finite-element work."""

    #: Structure with all probes of the case.
    structure: Structure
    #: In the order of the contact elements.
    joints: tuple[PairedJoint, ...]
    #: Temperature probes: the named ones and the candidates.
    probes: dict[str, Probe]
    #: Checked constraints of the bodies.
    constraints: Constraints
    #: The law of each joint and its number of contact elements.
    laws: list[tuple[JointLaw, int]]
    #: In the order of the case.
    bolts: list[Bolt]


def make_parts(case: Case) -> Parts:
    """Build and check the parts of a case without finite elements: quick, and finds most mistakes.

    Raises
    ------
    InputError
        A name does not exist in the structure, a history is invalid, parts do not match, or a body
        is not constrained.
    """
    structure = build_structure(case)
    check_names(case, structure)
    if (reason := not_reducible(case)) is not None:  # a copy of a case may be changed
        raise InputError(reason)
    march_inputs(case)  # finds invalid histories before the factorisation
    joints = paired_joints(case, structure)
    check_sound(case, structure, joints)
    probes = {
        name: probe for name, probe in structure.probes.items() if name in case.probes
    } | candidate_probes(case, structure)
    if not probes:
        raise InputError("probes: the case names no temperature probe; add [probes.NAME]")
    laws = joint_laws(case, structure, body_materials(case, structure), joints)
    bolts = bolts_of(case, structure)
    first_forces(case)
    constraints = checked_constraints(case, structure, joints, bolts)
    return Parts(structure, joints, probes, constraints, laws, bolts)


def paired_joints(
    case: Case, structure: Structure, most: int = MOST_IN_ALL
) -> tuple[PairedJoint, ...]:
    """Pair the sides of every joint of a case, in the order of the contact elements.

    Raises
    ------
    InputError
        The sides of a joint do not match, or there are more than `most` contact elements.
    """
    joints = tuple(_paired(case, structure, name, section) for name, section in case.joints.items())
    count = sum(len(joint.area) for joint in joints)
    if count > most:
        raise InputError(
            f"joints: {count} contact elements in all, and {most} at most: each dense "
            "matrix of the joints would take gigabytes; lower along or across"
        )
    return joints


def _paired(case: Case, structure: Structure, name: str, section: JointSection) -> PairedJoint:
    joint = pair_joint(structure, name, section.along, section.across)
    if section.axis is None:
        return joint
    return sliding(joint, unit_direction(case.axes[section.axis]))


def unit_direction(axis: AxisSection) -> Array:
    """Unit vector of an axis, shape (3,)."""
    return np.array(axis.direction) / np.linalg.norm(axis.direction)


def _check_walls(case: Case) -> None:
    """Refuse heat and loads on rigid walls, which have no unknowns, and names of their faces.

    Whether a wall has a temperature follows from its name.
    """
    joints = {f"joints.{name}": [one.side_a, one.side_b] for name, one in case.joints.items()}
    held = {"held_temperatures": list(case.held_temperatures)}
    for where, places in (joints | held).items():
        for name in case.walls:
            if face_of(name) in places:
                raise InputError(
                    f"{where}: {face_of(name)!r} is the face of a wall; name the wall, {name!r}"
                )
    sources = {f"sources.{name}": [one.body, one.surface] for name, one in case.sources.items()}
    loads = {
        f"loads.{name}": [*(one.bodies or []), one.surface] for name, one in case.loads.items()
    }
    for where, places in (sources | loads).items():
        for name in case.walls:
            if not {name, face_of(name)}.isdisjoint(places):
                raise InputError(
                    f"{where}: {name!r} is a rigid wall, whose temperature and place are given; "
                    "name what it faces"
                )


def check_names(case: Case, structure: Structure) -> None:
    """Raise InputError if a support, load or material of the case has an unknown name."""
    body_materials(case, structure)
    surfaces: dict[str, Iterable[str]] = {
        "convection_W_m2K": case.convection_W_m2K,
        "radiation": case.radiation,
        **{f"cavities.{name}.surfaces": one.surfaces for name, one in case.cavities.items()},
        "supports": [*fixed_surfaces(case), *case.supports.symmetry],
        "supports.springs": case.supports.springs,
        "held_temperatures": case.held_temperatures,
    }
    for where, names in surfaces.items():
        for name in names:
            structure.surface(name, where)
    _check_walls(case)
    heat_sources(case, structure)
    held_profiles(case)
    read_initial_temperature(case)
    mechanical_loads(case, structure)
    points = {
        "output.stress_probes": case.output.stress_probes,
        "displacement": measured_points(case),
    }
    for where, probes in points.items():
        for name in probes:
            if name not in structure.probes:
                raise unknown_name("probe", name, structure.probes, where)
