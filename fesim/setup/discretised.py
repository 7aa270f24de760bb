"""A case as finite elements, before anything is condensed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, kron, vstack

from fesim.case.schema import Case
from fesim.setup.constraints import fixed_surfaces
from fesim.setup.elastic import ElasticStructure, reference_springs
from fesim.setup.initial_temperature import initial_temperature
from fesim.setup.loads import (
    heat_sources,
    held_profiles,
    mechanical_loads,
    spring_stiffnesses,
)
from fesim.setup.parts import Parts
from fesim.setup.structure import body_materials, measured_points
from fesim.setup.temperature_dependence import (
    reference_coefficients,
    reference_materials,
    reference_moduli,
)
from fesim.solid.bolts import stretch_rows, temperature_rows
from fesim.solid.elasticity import DIRECTIONS, elastic_pieces
from fesim.solid.forces import nodal_forces
from fesim.solid.heat import HeatOperators, ThermalLoads, heat_operators
from fesim.solid.joint_operators import JointOperators, joint_operators
from fesim.solid.materials import Material
from fesim.solid.rotation import rotation_rows
from fesim.solid.spaces import Spaces, make_spaces, probe_rows
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MILLI


@dataclass(frozen=True)
class Discretised:
    """A case as finite elements, before anything is condensed."""

    #: The case.
    case: Case
    #: Structure, joints, bolts, probes.
    parts: Parts
    #: Material of every body, with a temperature-dependent modulus at its middle.
    materials: dict[str, Material]
    #: Finite-element spaces.
    spaces: Spaces
    operators: JointOperators
    #: Heat operators of the structure.
    heat: HeatOperators
    #: Shape (n,): initial temperatures, if they differ from the ambient.
    warm: Array | None
    #: Shape (3 m,): reference springs, Pa/m.
    springs: Array
    #: Rows of the bolts' stretch, and of the temperatures at their ends.
    stretch: csr_array
    ends: csr_array
    #: Rows of the temperature probes.
    rows: csr_array


def discretised(case: Case, parts: Parts) -> Discretised:
    """Create spaces and operators of a case whose parts are checked."""
    structure, joints = parts.structure, parts.joints
    materials = reference_moduli(case, body_materials(case, structure))
    spaces = make_spaces(structure.mesh)
    return Discretised(
        case=case,
        parts=parts,
        materials=materials,
        spaces=spaces,
        operators=joint_operators(joints, spaces),
        heat=heat_operators(
            structure,
            spaces.heat,
            reference_materials(case, materials),
            thermal_loads(case, structure),
            joints,
        ),
        warm=initial_temperature(case, structure, spaces.heat),
        springs=reference_springs(structure, materials, joints),
        stretch=stretch_rows(spaces.displacement, parts.bolts),
        ends=temperature_rows(spaces.heat, parts.bolts),
        rows=probe_rows(spaces.heat, structure, parts.probes),
    )


def elastic_structure(whole: Discretised) -> ElasticStructure:
    """Return the elastic structure of a case; nothing is assembled yet."""
    case, structure = whole.case, whole.parts.structure
    return ElasticStructure(
        lambda: elastic_pieces(
            structure,
            whole.spaces,
            whole.materials,
            fixed_surfaces(case),
            dict(case.supports.symmetry),
            spring_stiffnesses(case, structure),
        ),
        whole.operators,
        whole.springs,
        (whole.spaces.displacement_size, int(whole.spaces.heat.N)),
        case.march.solver,
    )


def thermal_loads(case: Case, structure: Structure) -> ThermalLoads:
    """Return the convection, sources and held temperatures of a case."""
    return ThermalLoads(
        reference_coefficients(case), heat_sources(case, structure), held_profiles(case)
    )


def relative_rows(whole: Discretised) -> csr_array:
    """Rows of the displacement probe along x, y and z, then of the bolts' stretch."""
    if not measured_points(whole.case):
        return whole.stretch
    probes = displacement_rows(whole.case, whole.parts.structure, whole.spaces)
    return csr_array(vstack([probes, whole.stretch]))


def displacement_rows(case: Case, structure: Structure, spaces: Spaces) -> csr_array:
    """Rows of the displacement probe of a case along x, y and z.

    For a rotation w of the point, the tip of a rigid tool at r from it moves by w x r in addition.
    """
    point, *origin = (
        probe_rows(spaces.displacement, structure, {name: structure.probes[name]})
        for name in measured_points(case)
    )
    relative = point - origin[0] if origin else point
    moved = kron(relative, np.eye(len(DIRECTIONS)), format="csr")
    section = case.displacement
    if section is None or section.tool_mm is None or section.tool_within_mm is None:
        return moved
    turned = rotation_rows(structure, spaces, section.point, MILLI * section.tool_within_mm)
    lever = np.cross(np.eye(len(DIRECTIONS)), MILLI * np.array(section.tool_mm)).T
    return csr_array(moved + csr_array(lever) @ turned)


def load_forces(whole: Discretised) -> Array:
    """Nodal forces of the mechanical loads at factor one, then of the bolts per N: (n, l + b)."""
    structure, loads = whole.parts.structure, mechanical_loads(whole.case, whole.parts.structure)
    acting = nodal_forces(structure, whole.spaces, whole.materials, loads)
    return np.hstack([acting, -whole.stretch.toarray().T])
