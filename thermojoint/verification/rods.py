"""Two one-dimensional rods in line between walls, meshed and assembled."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.sparse import csr_array

from fesim.joint.law import Friction, JointLaw
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine
from fesim.setup.elastic import reference_springs
from fesim.solid.condensation import (
    DisplacementField,
    ElasticCondensation,
    condense_elasticity,
    condense_heat,
)
from fesim.solid.elasticity import elastic_operators
from fesim.solid.heat import HeatOperators, ThermalLoads, heat_operators
from fesim.solid.joint_operators import JointOperators, joint_operators
from fesim.solid.materials import Material
from fesim.solid.spaces import Spaces, make_spaces
from meshes.pairing import pair_joint
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.verification.structures import box_grid, two_bars

#: Width and depth of a rod, m; without influence, as there is no lateral contraction.
SECTION = (0.1, 0.1)
#: No motion along the joint.
NO_FRICTION = Friction(0.0, 1e12)


@dataclass(frozen=True)
class Rods:
    """Two rods in line along x, ready to be condensed for any time step."""

    #: Heat conduction in both rods; the inputs are the ambient and the held surfaces.
    heat: HeatOperators
    #: Joint of the rods: one contact element.
    operators: JointOperators
    #: Both rods between walls.
    elastic: ElasticCondensation
    law: JointLaw
    #: Shape (n,): coordinates of the temperature unknowns, m; those of the second rod start at
    #: `second`.
    x: Array
    #: Number of the first unknown of the second rod.
    second: int

    def machine(self, step: float) -> CondensedMachine:
        """Condense for a time step (s)."""
        thermal = condense_heat(self.heat, self.operators, step)
        return CondensedMachine(thermal, ContactProblem(self.elastic, [(self.law, 1)]))


def between_rollers(
    structure: Structure, materials: dict[str, Material], grid: tuple[int, int]
) -> tuple[Spaces, JointOperators, ElasticCondensation, DisplacementField]:
    """Condense two bars on rollers, their joint in contact elements of a grid; no probes."""
    spaces = make_spaces(structure.mesh)
    joints = [pair_joint(structure, "joint", *grid)]
    operators = joint_operators(joints, spaces)
    rollers = {"x0": "x", "x1": "x", "y0": "y", "z0": "z"}
    elastic = elastic_operators(structure, spaces, materials, [], rollers)
    springs = reference_springs(structure, materials, joints)
    no_probes = csr_array((0, spaces.displacement_size))
    return spaces, operators, *condense_elasticity(elastic, operators, springs, no_probes)


def rods(
    materials: tuple[Material, Material],
    lengths: tuple[float, float],
    elements: tuple[int, int],
    law: JointLaw,
    held: list[str],
) -> Rods:
    """Mesh, assemble and condense two rods between walls; `held` surfaces have a prescribed T."""
    first, second = (
        box_grid("hexahedra", (count, 1, 1), (length, *SECTION), (start, 0.0, 0.0))
        for count, length, start in zip(elements, lengths, (0.0, lengths[0]), strict=True)
    )
    structure = two_bars(first, second)
    by_body = dict(zip(("left", "right"), materials, strict=True))
    spaces, operators, condensed, _ = between_rollers(structure, by_body, (1, 1))
    heat = heat_operators(structure, spaces.heat, by_body, ThermalLoads(held=dict.fromkeys(held)))
    return Rods(heat, operators, condensed, law, spaces.heat.doflocs[0], first.p.shape[1])
