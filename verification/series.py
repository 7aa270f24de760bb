"""Two bars in series through a joint: q = dT / (L1/k1 + 1/h_c(p) + L2/k2), by one long step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from fesim.joint.law import (
    Friction,
    JointLaw,
    SurfaceNormalLaw,
    exact_conductance,
    harmonic_conductivity,
)
from fesim.joint.operators import joint_operators
from fesim.march.stepping import CondensedMachine, march, staggered
from fesim.setup.machine import reference_springs
from fesim.solid.condensation import condense_elasticity, condense_heat
from fesim.solid.elasticity import elastic_operators
from fesim.solid.heat import heat_operators
from fesim.solid.spaces import make_spaces
from meshes.pairing import pair_joint
from meshes.structure import Structure
from verification.check import Check
from verification.structures import IRON, LEFT, RIGHT, SECTION, STEEL, bars

#: Temperatures of the ends, K.
HOT, COLD = 100.0, 20.0
#: Pressures of the joint, Pa.
PRESSURES = (0.1e6, 1.0e6, 4.41e6, 40.0e6)
ROUGHNESS, SLOPE, HARDNESS = 1.25e-6, 0.14, 1.961e9
#: So long an implicit Euler step ends in the steady state, s.
FOREVER = 1e15

MESHES = {
    "matching hexahedra": ("hexahedra", (3, 3, 2), (4, 3, 2)),
    "non-matching hexahedra": ("hexahedra", (3, 3, 2), (2, 4, 3)),
    "matching tetrahedra": ("tetrahedra", (2, 2, 2), (3, 2, 2)),
    "non-matching tetrahedra": ("tetrahedra", (2, 2, 2), (3, 3, 2)),
}


def law_at(pressure: float) -> JointLaw:
    """Return a joint of iron on steel at a preload (Pa), with the conductance of the CMY model."""
    normal = SurfaceNormalLaw(HARDNESS, ROUGHNESS, pressure)
    ends = (np.array([m.conductivity]) for m in (IRON, STEEL))
    conductivity = float(harmonic_conductivity(*ends)[0])
    conductance = exact_conductance(SLOPE, ROUGHNESS, conductivity, HARDNESS)
    return JointLaw(normal, Friction(0.6, 1e12), conductance)


def steady_machine(structure: Structure) -> CondensedMachine:
    """Two bars between rollers with held ends, one step of which leads to the steady state.

    The bars do not expand, so that the joint keeps its preload.
    """
    materials = {"left": replace(IRON, expansion=0.0), "right": replace(STEEL, expansion=0.0)}
    spaces = make_spaces(structure.mesh)
    joints = [pair_joint(structure, "joint", 3, 2)]
    operators = joint_operators(joints, spaces)
    heat = heat_operators(structure, spaces.heat, materials, {}, [], ["x0", "x1"])
    rollers = {"x0": "x", "x1": "x", "y0": "y", "z0": "z"}
    elastic = elastic_operators(structure, spaces, materials, [], rollers)
    springs = reference_springs(structure, materials, joints)
    no_probes = csr_array((0, spaces.displacement_size))
    condensed, _ = condense_elasticity(elastic, operators, springs, no_probes)
    thermal = condense_heat(heat, operators, FOREVER)
    return CondensedMachine(thermal, condensed, [(law_at(PRESSURES[0]), len(joints[0].area))])


def checks() -> Iterator[Check]:
    """Heat flow through the two bars on every mesh at every pressure."""
    area = SECTION[0] * SECTION[1]
    # Inputs: the ambient, then the two held ends.
    inputs = np.array([0.0, HOT, COLD])
    for mesh, (kind, left, right) in MESHES.items():
        cold = steady_machine(bars(kind, left, right))
        for pressure in PRESSURES:
            law = law_at(pressure)
            machine = replace(cold, laws=[(law, cold.contacts)])
            step = next(march(machine, lambda _: inputs, staggered))
            contact = float(law.conductance(np.array([pressure]))[0])
            resistance = LEFT / IRON.conductivity + 1.0 / contact + RIGHT / STEEL.conductivity
            yield Check(
                name=f"two bars, {mesh}, {1e-6 * pressure:g} MPa: heat flow",
                quantity="heat flow",
                unit="W",
                reference=area * (HOT - COLD) / resistance,
                computed=float(step.heat_flow.sum()),
                tolerance=1e-6,
                source="closed form",
            )
