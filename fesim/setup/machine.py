"""From a case to a machine ready to march."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from artefacts.errors import InputError, unknown_name
from artefacts.toml import as_key
from fesim.cache import remembered
from fesim.case.identity import (
    asked,
    elasticity_key,
    file_digest,
    load_patterns,
    thermal_key,
)
from fesim.case.schema import CandidatesSection, Case, MillingMachineSection, not_reducible
from fesim.joint.law import JointLaw
from fesim.joint.operators import joint_operators
from fesim.march.assembly import Bolts, tightened
from fesim.march.machine import CondensedMachine, State, Step, load_factors
from fesim.march.reduced import (
    ThermalModes,
    project_elasticity,
    project_heat,
    shortest,
    thermal_modes,
)
from fesim.march.start_field import start_field
from fesim.setup.bolts import bolts_of, first_forces
from fesim.setup.elastic import elastic_structure, pieces_to_condense
from fesim.setup.holds import checked_holds, fixed_surfaces, start_closed, with_friction
from fesim.setup.initial_temperature import initial_temperature, read_initial_temperature
from fesim.setup.laws import element_means, joint_laws
from fesim.setup.loads import (
    heat_sources,
    held_profiles,
    mechanical_loads,
    thermal_inputs,
)
from fesim.setup.outputs import asks_for_outputs, mechanical_outputs
from fesim.setup.temperature_dependence import (
    growth,
    reference_films,
    reference_materials,
    variable_heat,
)
from fesim.solid.bolts import Bolt, bolt_springs, stretch_rows, temperature_rows
from fesim.solid.condensation import (
    DisplacementField,
    LoadInfluence,
    condense_heat,
    condense_loads,
    elastic_condensation,
)
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.forces import nodal_forces
from fesim.solid.heat import by_cell, heat_operators
from fesim.solid.materials import Material
from fesim.solid.outputs import MechanicalOutputs
from fesim.solid.rigid_motions import Holds, check_held
from fesim.solid.spaces import Spaces, cells_at, make_spaces, probe_rows
from fesim.solid.substructures import TieCondensation
from meshes.exchange import read_structure
from meshes.milling_machine import MillingMachineDimensions, box_milling_machine
from meshes.pairing import PairedJoint, pair_joint
from meshes.structure import Probe, Structure
from meshes.units import UNITS
from meshes.wall import face_of, with_wall

#: More possible sensors than this are a slip of a unit.
MOST_CANDIDATES = 100_000
#: A dense matrix of all joints has (three times this) squared numbers: 2.6 GB.
MOST_IN_ALL = 6_000


@dataclass(frozen=True)
class Parts:
    """What a case is made of, before any finite element.

    Attributes
    ----------
    structure : Structure
        With all probes of the case.
    joints : tuple of PairedJoint
        In the order of the contact elements.
    probes : dict of str to Probe
        Temperature probes: those that the case names and its candidates.
    holds : Holds
        What holds the bodies; checked.
    laws : list of (JointLaw, int)
        The law of each joint and how many contact elements it has.
    bolts : list of Bolt
        In the case's order.
    """

    structure: Structure
    joints: tuple[PairedJoint, ...]
    probes: dict[str, Probe]
    holds: Holds
    laws: list[tuple[JointLaw, int]]
    bolts: list[Bolt]


@dataclass(frozen=True)
class Setup:
    """A condensed case.

    Attributes
    ----------
    structure : Structure
        With all probes of the case.
    spaces : Spaces
        Finite-element spaces.
    joints : tuple of PairedJoint
        In the order of the contact elements.
    machine : CondensedMachine
        What marches; its displacement probes are the relative displacement along x, y and z.
    make_field : callable
        Gives `field`; it is only factorised when somebody asks.
    probes : dict of str to Probe
        Temperature probes: those that the case names and its candidates.
    probe_rows : scipy.sparse.csr_array or ndarray, shape (probes, n_heat)
        Their rows, of nodal temperatures or of the reduced model's amplitudes.
    modes : ThermalModes or None
        The reduced thermal model; None if the march has the full one.
    holds : Holds
        What holds the bodies.
    forces : ndarray, shape (n, l + b)
        Nodal forces of the mechanical loads at factor one, then of the bolts per N, N.
    outputs : MechanicalOutputs or None
        Forces and stresses, if the case asks for them; of `acting`.
    bolts : Bolts or None
        The bolts, if there are any.
    materials : dict of str to Material
        Of every body.
    """

    structure: Structure
    spaces: Spaces
    joints: tuple[PairedJoint, ...]
    machine: CondensedMachine
    make_field: Callable[[], DisplacementField]
    probes: dict[str, Probe]
    probe_rows: csr_array | NDArray[np.float64]
    modes: ThermalModes | None
    holds: Holds
    forces: NDArray[np.float64]
    outputs: MechanicalOutputs | None
    bolts: Bolts | None
    materials: dict[str, Material]

    @property
    def field(self) -> DisplacementField:
        """Full displacements on demand."""
        return self.make_field()

    def nodal_temperature(self, state: State) -> NDArray[np.float64]:
        """Temperature above the initial ambient at every unknown of `spaces.heat`, K.

        Parameters
        ----------
        state : State
            Of a march of this set-up.
        """
        return state.temperature if self.modes is None else self.modes.basis @ state.temperature

    def bolt_forces(self, step: Step) -> NDArray[np.float64]:
        """Force of each bolt, shape (b,), N.

        Parameters
        ----------
        step : Step
            Of a march of this set-up.
        """
        if self.bolts is None:
            return np.empty(0)
        factors = load_factors(self.machine, step.inputs)
        return self.bolts.force.of(step.state.temperature, step.remainder, factors)

    def acting(self, step: Step) -> NDArray[np.float64]:
        """Factors of the loads and forces (N) of the bolts, shape (l + b,), as `forces` wants them.

        Parameters
        ----------
        step : Step
            Of a march of this set-up.
        """
        pulls = self.bolt_forces(step)
        factors = load_factors(self.machine, step.inputs)
        return np.concatenate([factors[: self.forces.shape[1] - pulls.size], pulls])

    def displacement(self, step: Step) -> NDArray[np.float64]:
        """Displacement at every unknown, shape (n,), m; with bolts from where they are just tight.

        Parameters
        ----------
        step : Step
            Of a march of this set-up.
        """
        acting, remainder = self.acting(step), step.remainder
        if self.machine.assembly is not None:
            acting = acting - self.machine.assembly.factors[:-1]
            remainder = remainder - self.machine.assembly.remainder
        temperature = self.machine.strained(self.nodal_temperature(step.state))
        return self.field.solve(temperature, remainder, self.forces @ acting)

    def deformation(self, step: Step) -> NDArray[np.float64]:
        """Displacement from the state without any force, shape (n,), m: what stresses come of.

        Parameters
        ----------
        step : Step
            Of a march of this set-up.
        """
        temperature = self.machine.strained(self.nodal_temperature(step.state))
        return self.field.solve(temperature, step.remainder, self.forces @ self.acting(step))


def set_up(case: Case) -> Setup:
    """Build, check and condense everything a case names.

    Parameters
    ----------
    case : Case
        Its heat input is not used: one set-up serves any number of them.

    Raises
    ------
    InputError
        A name does not exist in the structure, parts do not fit, or nothing holds a body.
    """
    before = thermal_key(case)
    parts = make_parts(case)
    # A mesh file that somebody writes just now is not to be taken for the one before.
    digest = cache(file_digest)
    heat_key = before if thermal_key(case, digest) == before else None
    key = None if heat_key is None else elasticity_key(case, digest)
    structure, joints = parts.structure, parts.joints
    materials = body_materials(case, structure)
    spaces = make_spaces(structure.mesh)
    stretch = stretch_rows(spaces.displacement, parts.bolts)
    relative = csr_array(vstack([_relative_rows(case, structure, spaces), stretch]))
    rows = probe_rows(spaces.heat, structure, parts.probes)
    ends = temperature_rows(spaces.heat, parts.bolts)

    operators = joint_operators(joints, spaces)
    heat = heat_operators(
        structure,
        spaces.heat,
        reference_materials(case, materials),
        reference_films(case),
        heat_sources(case, structure),
        list(case.held_temperatures),
        joints,
        held_profiles(case),
    )
    warm = initial_temperature(case, structure, spaces.heat)
    step, solver = case.march.step_s, case.march.solver
    springs = reference_springs(structure, materials, joints)

    solid = elastic_structure(case, structure, spaces, materials, operators, springs)
    tied = remembered(
        TieCondensation, key, lambda: solid.condense(pieces_to_condense(case, solid), relative)
    )
    condensed = elastic_condensation(tied, operators, springs)
    field = cache(partial(solid.field, tied))

    forces = np.hstack(
        [
            nodal_forces(structure, spaces, materials, mechanical_loads(case, structure)),
            -stretch.toarray().T,
        ]
    )
    loads = None
    if forces.shape[1]:
        loads = remembered(
            LoadInfluence,
            None if key is None else f"{key} under {load_patterns(case)}",
            lambda: condense_loads(field(), forces, relative),
        )
    outputs = None
    if asks_for_outputs(case):
        outputs = remembered(
            MechanicalOutputs,
            None if key is None else f"{key} under {load_patterns(case)} gives {asked(case)}",
            lambda: mechanical_outputs(
                case, structure, spaces, materials, field(), springs, forces
            ),
        )
    modes = None
    if case.march.thermal == "reduced":
        modes = remembered(
            ThermalModes,
            None if heat_key is None else f"{heat_key} from {shortest(step)!r} s",
            lambda: thermal_modes(
                heat, operators, condensed, csr_array(vstack([rows, ends])), step, solver, warm
            ),
        )
        thermal = project_heat(heat, operators, step, modes)
        elastic = project_elasticity(condensed, modes)
        if outputs is not None:
            outputs = replace(outputs, temperature=outputs.temperature @ modes.basis)
    else:
        thermal, elastic = condense_heat(heat, operators, step, solver), condensed
    machine = CondensedMachine(
        thermal,
        elastic,
        parts.laws,
        holds=parts.holds,
        loads=loads,
        start=start_field(heat, warm, modes),
        variable=variable_heat(case, structure, spaces.heat, materials, joints, heat),
        growth=growth(case, structure, spaces.heat),
    )
    bolts = None
    if parts.bolts:
        ties = bolt_springs(parts.bolts, ends.toarray() if modes is None else ends @ modes.basis)
        machine, bolts = tightened(tuple(case.bolts), machine, ties, first_forces(case))
    return Setup(
        structure=structure,
        spaces=spaces,
        joints=joints,
        machine=machine,
        make_field=field,
        probes=parts.probes,
        probe_rows=rows if modes is None else rows @ modes.basis,
        modes=modes,
        holds=parts.holds,
        forces=forces,
        outputs=outputs,
        bolts=bolts,
        materials=materials,
    )


def make_parts(case: Case) -> Parts:
    """Build and check what a case names, short of finite elements: quick, and finds most slips.

    Raises
    ------
    InputError
        A name does not exist in the structure, a history is bad, parts do not fit, or nothing
        holds a body.
    """
    structure = build_structure(case)
    check_names(case, structure)
    if (reason := not_reducible(case)) is not None:  # a copy of a case may be another
        raise InputError(reason)
    thermal_inputs(case)  # a bad history is found now, not after the factorisation
    joints = paired_joints(case, structure)
    probes = {
        name: probe for name, probe in structure.probes.items() if name in case.probes
    } | candidate_probes(case, structure)
    if not probes:
        raise InputError("probes: the case names no temperature probe; add [probes.NAME]")
    laws = joint_laws(case, structure, body_materials(case, structure), joints)
    bolts = bolts_of(case, structure)
    first_forces(case)
    holds = checked_holds(case, structure, joints, bolts)
    return Parts(structure, joints, probes, holds, laws, bolts)


def paired_joints(case: Case, structure: Structure) -> tuple[PairedJoint, ...]:
    """Pair the sides of every joint of a case, in the order of the contact elements.

    Raises
    ------
    InputError
        The sides of a joint do not fit, or there are more than `MOST_IN_ALL` contact elements.
    """
    joints = tuple(
        pair_joint(structure, name, section.along, section.across)
        for name, section in case.joints.items()
    )
    count = sum(len(joint.area) for joint in joints)
    if count > MOST_IN_ALL:
        raise InputError(
            f"joints: {count} contact elements in all, and {MOST_IN_ALL} at most: each dense "
            "matrix of the joints would take gigabytes; lower along or across"
        )
    return joints


def check_names(case: Case, structure: Structure) -> None:
    """Raise InputError if a support, load or material of the case names what is not there."""
    body_materials(case, structure)
    for name in case.convection_W_m2K:
        structure.surface(name, "convection_W_m2K")
    for name in case.radiation:
        structure.surface(name, "radiation")
    for cavity, section in case.cavities.items():
        for name in section.surfaces:
            structure.surface(name, f"cavities.{cavity}.surfaces")
    for name in [*fixed_surfaces(case), *case.supports.symmetry]:
        structure.surface(name, "supports")
    for name in case.supports.springs:
        structure.surface(name, "supports.springs")
    for name in case.held_temperatures:
        structure.surface(name, "held_temperatures")
    heat_sources(case, structure)
    held_profiles(case)
    read_initial_temperature(case)
    mechanical_loads(case, structure)
    for name in case.output.stress_probes:
        if name not in structure.probes:
            raise unknown_name("probe", name, structure.probes, "output.stress_probes")
    for name in measured_points(case):
        if name not in structure.probes:
            raise unknown_name("probe", name, structure.probes, "displacement")


def with_laws(setup: Setup, case: Case) -> Setup:
    """Return the set-up of a case that differs only in its loads, bolt forces and joint laws.

    Nothing is condensed again: none of them enters the condensation.

    Raises
    ------
    InputError
        Without the friction of the first case, nothing holds a body.
    """
    materials = body_materials(case, setup.structure)
    laws = joint_laws(case, setup.structure, materials, setup.joints)
    check_held(setup.holds, with_friction(case, setup.joints), start_closed(case, setup.joints))
    if setup.bolts is None:
        return replace(setup, machine=replace(setup.machine, laws=laws))
    names, loose, springs = setup.bolts.names, setup.bolts.loose, setup.bolts.springs
    machine, bolts = tightened(names, replace(loose, laws=laws), springs, first_forces(case))
    return replace(setup, machine=machine, bolts=bolts)


def build_structure(case: Case) -> Structure:
    """Build or read the structure, with the probes and joints that the case adds."""
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
    factor = (
        structure.symmetry_factor
        if isinstance(section, MillingMachineSection)
        else section.symmetry_factor
    )
    return Structure(
        mesh=structure.mesh,
        bodies=structure.bodies,
        surfaces=structure.surfaces,
        joints=joints,
        probes=structure.probes | probes,
        symmetry_factor=factor,
    )


def _side(case: Case, name: str) -> str:
    """Return the surface that a joint means by the name of a surface or a wall."""
    return face_of(name) if name in case.walls else name


def body_materials(case: Case, structure: Structure) -> dict[str, Material]:
    """Material of every body."""
    made = {
        name: Material(
            conductivity=section.conductivity_W_mK,
            density=section.density_kg_m3,
            heat_capacity=section.heat_capacity_J_kgK,
            youngs_modulus=1e9 * section.youngs_modulus_GPa,
            poisson_ratio=section.poisson_ratio,
            expansion=section.expansion_1_K,
        )
        for name, section in case.materials.items()
    }
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


def reference_springs(
    structure: Structure, materials: dict[str, Material], joints: Sequence[PairedJoint]
) -> NDArray[np.float64]:
    """Reference springs (3 m,) as stiff as the softer body is behind a contact element, Pa/m.

    They do not depend on the joint's law, so that one condensation serves every law. Their modulus
    is the harmonic mean of the two: beside much stiffer ones all that gives way would be rounding.
    """
    modulus = by_cell(structure, {name: m.youngs_modulus for name, m in materials.items()})
    each = [
        2.0
        / (
            1.0 / element_means(joint, modulus[joint.cells_a])
            + 1.0 / element_means(joint, modulus[joint.cells_b])
        )
        / np.sqrt(joint.area)
        for joint in joints
    ]
    return np.tile(np.concatenate([np.empty(0), *each]), 3)


def candidate_probes(case: Case, structure: Structure) -> dict[str, Probe]:
    """Possible sensors: lattice points of each ``[[candidates]]`` box that lie in its body.

    A candidate is called after its position in mm, e.g. ``s575_700_150``.
    """
    found: dict[str, Probe] = {}
    for section in case.candidates:
        cells = structure.body(section.body, "candidates.body")
        if math.prod(_lattice_counts(section)) > MOST_CANDIDATES:
            raise InputError(
                f"candidates: more than {MOST_CANDIDATES} lattice points; raise spacing_mm"
            )
        lattice = _lattice(section)
        at = cells_at(structure.mesh, 1e-3 * np.array(lattice), cells)
        for point, cell in zip(lattice, at, strict=True):
            if cell >= 0:
                name = "s" + "_".join(f"{value:g}" for value in point)
                found[name] = Probe(_metres(point), section.body)
    return found


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
    """Return the point whose displacement is recorded and the one it is measured from, if any."""
    point, origin = case.displacement.point, case.displacement.relative_to
    return [point] if origin is None else [point, origin]


def _relative_rows(case: Case, structure: Structure, spaces: Spaces) -> csr_array:
    names = measured_points(case)
    rows = probe_rows(
        spaces.displacement, structure, {name: structure.probes[name] for name in names}
    )
    relative = rows[[0]] - rows[[1]] if len(names) == 2 else rows
    at = relative.tocoo()
    shape = (1, spaces.displacement_size)
    return csr_array(
        vstack(
            [
                csr_array((at.data, (np.zeros(at.nnz, dtype=int), 3 * at.col + i)), shape=shape)
                for i in range(len(DIRECTIONS))
            ],
            format="csr",
        )
    )
