"""What a case asks of a solver, in SI, without any choice of how to solve it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fesim.case.schema import Case, step_count
from fesim.joint.law import JointLaw
from fesim.setup.laws import joint_law
from fesim.setup.loads import heat_sources, thermal_inputs
from fesim.setup.structure import body_materials, build_structure
from fesim.solid.materials import Material
from meshes.pairing import PairedJoint, outward_areas, pair_joint
from meshes.structure import Structure
from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Problem:
    """One structure with one joint under constant loads."""

    #: Mesh and names.
    structure: Structure
    #: Of every body.
    materials: dict[str, Material]
    joint: PairedJoint
    #: Its contact elements along and across each patch.
    grid: tuple[int, int]
    law: JointLaw
    #: Surface to heat transfer coefficient, W/(m2 K); ambient is at 0.
    convection: dict[str, float]
    #: Surface to the heat flux that enters there from time 0 on, W/m2.
    fluxes: dict[str, float]
    #: Surface to its temperature from time 0 on, K.
    held: dict[str, float]
    #: Surfaces held in all directions.
    fixed: list[str]
    #: Surface to the direction it is held in.
    symmetry: dict[str, str]
    #: Time step, s.
    step: float
    #: Number of time steps.
    steps: int


def problem_of(case: Case) -> Problem:
    """Return the problem of a case.

    Raises `InputError`: the case has more than one joint, springs, a body source, an ambient
    history or a load that changes in time: the decks do not have these.
    """
    if len(case.joints) != 1:
        raise InputError("against_calculix: the case has several joints; decks are made for one")
    if case.supports.springs:
        raise InputError("against_calculix: the case has springs; remove supports.springs")
    if case.ambient is not None:
        raise InputError("against_calculix: the case has an ambient history; remove [ambient]")
    structure = build_structure(case)
    materials = body_materials(case, structure)
    ((name, section),) = case.joints.items()
    if section.along is None or section.across is None:
        raise InputError(f"against_calculix: [joints.{name}] needs along and across")
    grid = section.along, section.across
    joint = pair_joint(structure, name, *grid)
    steps = step_count(case.march)
    loads = _constant_loads(case, steps)
    fluxes: dict[str, float] = {}
    shares = heat_sources(case, structure)
    for share, power in zip(shares, loads[: len(shares)], strict=True):
        if share.surface is None:
            raise InputError("against_calculix: a source heats a body; give it a surface")
        fluxes[share.surface] = share.power * power / area_of(structure, share.surface)
    return Problem(
        structure=structure,
        materials=materials,
        joint=joint,
        grid=grid,
        law=joint_law(section, structure, materials, joint),
        convection=dict(case.convection_W_m2K),
        fluxes=fluxes,
        held=dict(zip(case.held_temperatures, loads[len(shares) + 1 :], strict=True)),
        fixed=list(case.supports.fixed),
        symmetry=dict(case.supports.symmetry),
        step=case.march.step_s,
        steps=steps,
    )


def area_of(structure: Structure, surface: str) -> float:
    """Area of a named surface, m2."""
    vectors = outward_areas(structure.mesh, structure.surface(surface))
    return float(np.linalg.norm(vectors, axis=1).sum())


def _constant_loads(case: Case, steps: int) -> list[float]:
    inputs = thermal_inputs(case)
    first, *rest = (inputs(case.march.step_s * index) for index in range(1, steps + 1))
    if any((each != first).any() for each in rest):
        raise InputError('against_calculix: a load changes in time; give kind = "step"')
    return [float(value) for value in first]
