"""Two bars end to end with a joint between them: the structures that closed forms exist for."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from fesim.joint.law import Friction, JointLaw, SurfaceNormalLaw, power_law_conductance
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine
from fesim.setup.elastic import reference_springs
from fesim.solid.condensation import (
    DisplacementField,
    ThermalCondensation,
    condense_elasticity,
    condense_heat,
)
from fesim.solid.elasticity import ElasticOperators, elastic_operators
from fesim.solid.heat import HeatOperators, HeatSource, ThermalLoads, heat_operators
from fesim.solid.joint_operators import JointOperators, joint_operators
from fesim.solid.spaces import Spaces, make_spaces, probe_rows
from meshes.box_grid import put_side_by_side
from meshes.pairing import PairedJoint, pair_joint
from meshes.structure import Probe, Structure
from thermojoint.verification.structures import IRON, box_grid
from thermojoint.verification.structures import STEEL as STEEL

WIDTH, DEPTH = 0.06, 0.04
AREA = WIDTH * DEPTH
LEFT, RIGHT = 0.10, 0.15

ROLLERS = {"left_end": "x", "right_end": "x", "bottom": "y", "back": "z"}


def bar_mesh(start, length, divisions, tetrahedra=False, width=WIDTH):
    kind = "tetrahedra" if tetrahedra else "hexahedra"
    return box_grid(kind, divisions, (length, width, DEPTH), (start, 0.0, 0.0))


def two_bars(left=(3, 3, 2), right=(4, 3, 2), tetrahedra=False, right_width=WIDTH):
    """Bodies left and right along x; they touch at x = LEFT and share no node."""
    first = bar_mesh(0.0, LEFT, left, tetrahedra)
    second = bar_mesh(LEFT, RIGHT, right, tetrahedra, right_width)
    mesh, cells = put_side_by_side([first, second])
    facets = mesh.boundary_facets()
    x, y, z = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    on_left = mesh.f2t[0, facets] < first.nelements
    near = {
        "left_end": x < 1e-9,
        "right_end": x > LEFT + RIGHT - 1e-9,
        "joint.a": on_left & (x > LEFT - 1e-9),
        "joint.b": ~on_left & (x < LEFT + 1e-9),
        "bottom": y < 1e-9,
        "top": y > WIDTH - 1e-9,
        "back": z < 1e-9,
    }
    surfaces = {name: facets[mask] for name, mask in near.items()}
    surfaces["left_top"] = facets[near["top"] & on_left]
    middle = (right_width / 2, DEPTH / 2)
    return Structure(
        mesh=mesh,
        bodies=dict(zip(("left", "right"), cells, strict=True)),
        surfaces=surfaces,
        joints={"joint": ("joint.a", "joint.b")},
        probes={
            "start": Probe((0.0, *middle), "left"),
            "left_face": Probe((LEFT, *middle), "left"),
            "right_face": Probe((LEFT, *middle), "right"),
            "end": Probe((LEFT + RIGHT, *middle), "right"),
        },
    )


def shifted(structure, bodies, shift):
    """The structure with some bodies moved by a shift (3,), m; without probes."""
    points = structure.mesh.p.copy()
    cells = np.concatenate([structure.bodies[name] for name in bodies])
    points[:, np.unique(structure.mesh.t[:, cells])] += np.array(shift)[:, None]
    return replace(structure, mesh=type(structure.mesh)(points, structure.mesh.t), probes={})


def surface_law(friction=0.6, preload=4.41e6, conductivity=47.0):
    normal = SurfaceNormalLaw(1.961e9, 1.25e-6, preload)
    stiffness = 0.844 * -float(normal.slope(np.zeros(1))[0])
    conductance = power_law_conductance(1.45, 0.985, 0.14, 1.25e-6, conductivity, 1.961e9)
    return JointLaw(normal, Friction(friction, stiffness), conductance)


@dataclass(frozen=True)
class HeatParts:
    """Two bars' heat operators before and after condensation."""

    structure: Structure
    spaces: Spaces
    joints: list[PairedJoint]
    heat: HeatOperators
    operators: JointOperators
    thermal: ThermalCondensation

    @property
    def left_nodes(self):
        """Which nodes belong to the left bar."""
        nodes = np.zeros(self.spaces.heat.N, dtype=bool)
        nodes[np.unique(self.structure.mesh.t[:, self.structure.bodies["left"]])] = True
        return nodes


def conduct(
    structure,
    *,
    materials=(IRON, IRON),
    convection=None,
    sources=None,
    held=(),
    grid=(3, 2),
    step=2.0,
    solver=None,
):
    """Condense the heat equation of two bars."""
    by_body = dict(zip(("left", "right"), materials, strict=True))
    spaces = make_spaces(structure.mesh)
    joints = [pair_joint(structure, "joint", *grid)]
    operators = joint_operators(joints, spaces)
    given = [HeatSource(power, surface=name) for name, power in (sources or {}).items()]
    heat = heat_operators(
        structure,
        spaces.heat,
        by_body,
        ThermalLoads(convection or {}, given, dict.fromkeys(held)),
        joints,
    )
    return HeatParts(
        structure, spaces, joints, heat, operators, condense_heat(heat, operators, step, solver)
    )


@dataclass(frozen=True)
class Bars:
    """Two bars' operators before condensation, and the condensed machine made of them."""

    parts: HeatParts
    elastic: ElasticOperators
    probes: csr_array
    machine: CondensedMachine
    field: DisplacementField


def assemble(
    structure,
    *,
    materials=(IRON, IRON),
    law=None,
    fixed=(),
    symmetry=None,
    springs=1.0,
    solver=None,
    **heat,
):
    """Condense two bars. Displacement probes: x, y, z of "end", then of "left_face"."""
    law = surface_law() if law is None else law
    parts = conduct(structure, materials=materials, solver=solver, **heat)
    by_body = dict(zip(("left", "right"), materials, strict=True))
    spaces, operators = parts.spaces, parts.operators
    elastic = elastic_operators(structure, spaces, by_body, list(fixed), symmetry or {})
    chosen = {name: structure.probes[name] for name in ("end", "left_face")}
    probes = on_every_direction(probe_rows(spaces.elastic, structure, chosen))
    laws = [(law, len(operators.area))]
    reference = springs * reference_springs(structure, by_body, parts.joints)
    condensed, field = condense_elasticity(elastic, operators, reference, probes, solver)
    machine = CondensedMachine(parts.thermal, ContactProblem(condensed, laws))
    return Bars(parts, elastic, probes, machine, field)


def on_every_direction(rows):
    """Rows on the scalar space, turned into x, y and z of each on interleaved unknowns."""
    dense = rows.toarray()
    return csr_array(np.kron(dense, np.eye(3)))


def level(thermal, value):
    """Inputs of a march in which every source has the same level and the ambient is steady."""
    inputs = np.full(thermal.inputs.shape[1], value)
    inputs[-1] = 0.0
    return inputs


def driven(machine, history):
    """Inputs in time: every source follows one history."""
    return lambda time: level(machine.thermal, history(np.array([time]))[0])


def with_tolerance(machine, tolerance):
    """The machine with another largest residual of its gap equations, m."""
    return replace(machine, contact=replace(machine.contact, gap_tolerance=tolerance))
