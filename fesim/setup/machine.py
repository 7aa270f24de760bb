"""Set-up of the condensed machine of a case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from fesim.cache import remembered
from fesim.case.identity import (
    asked,
    elasticity_key,
    file_digest,
    load_patterns,
    thermal_key,
)
from fesim.case.schema import Case
from fesim.march.assembly import Bolts, tightened
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine, State, Step, load_factors
from fesim.march.reduced import (
    ThermalModes,
    project_elasticity,
    project_heat,
    shortest,
    thermal_modes,
)
from fesim.march.start_field import start_field
from fesim.setup.bolts import first_forces
from fesim.setup.constraints import start_closed, with_friction
from fesim.setup.elastic import elastic_structure, pieces_to_condense
from fesim.setup.initial_temperature import initial_temperature
from fesim.setup.laws import element_means, joint_laws
from fesim.setup.loads import (
    heat_sources,
    held_profiles,
    mechanical_loads,
)
from fesim.setup.outputs import asks_for_outputs, mechanical_outputs
from fesim.setup.parts import Parts, make_parts
from fesim.setup.structure import body_materials, measured_points
from fesim.setup.temperature_dependence import (
    growth,
    reference_coefficients,
    reference_materials,
    variable_heat,
)
from fesim.solid.bolts import bolt_springs, stretch_rows, temperature_rows
from fesim.solid.condensation import (
    DisplacementField,
    ElasticCondensation,
    LoadInfluence,
    condense_heat,
    condense_loads,
    elastic_condensation,
)
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.forces import nodal_forces
from fesim.solid.heat import HeatOperators, by_cell, heat_operators
from fesim.solid.joint_operators import JointOperators, joint_operators
from fesim.solid.materials import Material
from fesim.solid.outputs import MechanicalOutputs
from fesim.solid.rigid_motions import Constraints, check_held
from fesim.solid.spaces import Spaces, make_spaces, probe_rows
from fesim.solid.substructures import TieCondensation
from meshes.pairing import PairedJoint
from meshes.structure import Probe, Structure
from thermojoint.artefacts.display import Described


@dataclass(frozen=True, repr=False)
class Setup(Described):
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
    holds : Constraints
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
    holds: Constraints
    forces: NDArray[np.float64]
    outputs: MechanicalOutputs | None
    bolts: Bolts | None
    materials: dict[str, Material]

    def _facts(self) -> dict[str, str]:
        return {
            "bodies": ", ".join(self.structure.bodies),
            "nodes": str(self.structure.mesh.nvertices),
            "contact elements": str(sum(joint.area.size for joint in self.joints)),
            "probes": ", ".join(self.probes),
        }

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


@dataclass(frozen=True)
class _Whole:
    """A case as finite elements, before anything is condensed.

    Attributes
    ----------
    case : Case
        Where it comes from.
    parts : Parts
        Structure, joints, bolts, probes.
    materials : dict of str to Material
        Of every body.
    spaces : Spaces
        Finite-element spaces.
    operators : JointOperators
        Of the joints.
    heat : HeatOperators
        Of the structure.
    warm : ndarray, shape (n,), or None
        Temperatures at the start, if these are not the ambient's.
    springs : ndarray, shape (3 m,)
        Reference springs, Pa/m.
    stretch, ends : scipy.sparse.csr_array
        Of the bolts: rows of their stretch, and of the temperatures at their ends.
    rows : scipy.sparse.csr_array
        Of the temperature probes.
    """

    case: Case
    parts: Parts
    materials: dict[str, Material]
    spaces: Spaces
    operators: JointOperators
    heat: HeatOperators
    warm: NDArray[np.float64] | None
    springs: NDArray[np.float64]
    stretch: csr_array
    ends: csr_array
    rows: csr_array


@dataclass(frozen=True)
class _Keys:
    """Under which a condensation is remembered; None where a mesh file has changed meanwhile."""

    heat: str | None
    elasticity: str | None


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
    keys = _keys(case, before)
    whole = _discretised(case, parts)
    condensed, field = _condensed_elasticity(whole, keys)
    forces = _nodal_forces(whole)
    loads = _loads(whole, keys, field, forces)
    outputs = _outputs(whole, keys, field, forces)
    modes = _modes(whole, keys, condensed)
    machine = _machine(whole, condensed, loads, modes)
    bolts = None
    if parts.bolts:
        ends = whole.ends.toarray() if modes is None else whole.ends @ modes.basis
        ties = bolt_springs(parts.bolts, ends)
        machine, bolts = tightened(tuple(case.bolts), machine, ties, first_forces(case))
    if outputs is not None and modes is not None:
        outputs = replace(outputs, temperature=outputs.temperature @ modes.basis)
    return Setup(
        structure=parts.structure,
        spaces=whole.spaces,
        joints=parts.joints,
        machine=machine,
        make_field=field,
        probes=parts.probes,
        probe_rows=whole.rows if modes is None else whole.rows @ modes.basis,
        modes=modes,
        holds=parts.holds,
        forces=forces,
        outputs=outputs,
        bolts=bolts,
        materials=whole.materials,
    )


def _keys(case: Case, before: str) -> _Keys:
    """Keys of what is remembered; `before` is the thermal one from before the meshes were read."""
    # A mesh file that somebody writes just now is not to be taken for the one before.
    digest = cache(file_digest)
    if thermal_key(case, digest) != before:
        return _Keys(None, None)
    return _Keys(before, elasticity_key(case, digest))


def _discretised(case: Case, parts: Parts) -> _Whole:
    """Make spaces and operators."""
    structure, joints = parts.structure, parts.joints
    materials = body_materials(case, structure)
    spaces = make_spaces(structure.mesh)
    return _Whole(
        case=case,
        parts=parts,
        materials=materials,
        spaces=spaces,
        operators=joint_operators(joints, spaces),
        heat=heat_operators(
            structure,
            spaces.heat,
            reference_materials(case, materials),
            reference_coefficients(case),
            heat_sources(case, structure),
            list(case.held_temperatures),
            joints,
            held_profiles(case),
        ),
        warm=initial_temperature(case, structure, spaces.heat),
        springs=reference_springs(structure, materials, joints),
        stretch=stretch_rows(spaces.displacement, parts.bolts),
        ends=temperature_rows(spaces.heat, parts.bolts),
        rows=probe_rows(spaces.heat, structure, parts.probes),
    )


def _relative(whole: _Whole) -> csr_array:
    """Rows of the displacement probes, then of the bolts' stretch."""
    probes = _relative_rows(whole.case, whole.parts.structure, whole.spaces)
    return csr_array(vstack([probes, whole.stretch]))


def _condensed_elasticity(
    whole: _Whole, keys: _Keys
) -> tuple[ElasticCondensation, Callable[[], DisplacementField]]:
    """Condense the structure; what gives its displacement field is factorised on demand."""
    case = whole.case
    solid = elastic_structure(
        case, whole.parts.structure, whole.spaces, whole.materials, whole.operators, whole.springs
    )
    tied = remembered(
        TieCondensation,
        keys.elasticity,
        lambda: solid.condense(pieces_to_condense(case, solid), _relative(whole)),
    )
    condensed = elastic_condensation(tied, whole.operators, whole.springs)
    return condensed, cache(partial(solid.field, tied))


def _nodal_forces(whole: _Whole) -> NDArray[np.float64]:
    """Nodal forces of the mechanical loads at factor one, then of the bolts per N."""
    structure, loads = whole.parts.structure, mechanical_loads(whole.case, whole.parts.structure)
    acting = nodal_forces(structure, whole.spaces, whole.materials, loads)
    return np.hstack([acting, -whole.stretch.toarray().T])


def _loads(
    whole: _Whole,
    keys: _Keys,
    field: Callable[[], DisplacementField],
    forces: NDArray[np.float64],
) -> LoadInfluence | None:
    """What the loads and bolts do to gaps and probes."""
    if not forces.shape[1]:
        return None
    return remembered(
        LoadInfluence,
        keys.elasticity,
        lambda: condense_loads(field(), forces, _relative(whole)),
        also=f"under {load_patterns(whole.case)}",
    )


def _outputs(
    whole: _Whole,
    keys: _Keys,
    field: Callable[[], DisplacementField],
    forces: NDArray[np.float64],
) -> MechanicalOutputs | None:
    """Forces and stresses, if the case asks for them."""
    case = whole.case
    if not asks_for_outputs(case):
        return None
    return remembered(
        MechanicalOutputs,
        keys.elasticity,
        lambda: mechanical_outputs(
            case,
            whole.parts.structure,
            whole.spaces,
            whole.materials,
            field(),
            whole.springs,
            forces,
        ),
        also=f"under {load_patterns(case)} gives {asked(case)}",
    )


def _modes(whole: _Whole, keys: _Keys, condensed: ElasticCondensation) -> ThermalModes | None:
    """The reduced thermal model, if the case marches on one."""
    march = whole.case.march
    if march.thermal != "reduced":
        return None
    return remembered(
        ThermalModes,
        keys.heat,
        lambda: thermal_modes(
            whole.heat,
            whole.operators,
            condensed,
            csr_array(vstack([whole.rows, whole.ends])),
            march.step_s,
            march.solver,
            whole.warm,
        ),
        also=f"from {shortest(march.step_s)!r} s",
    )


def _machine(
    whole: _Whole,
    condensed: ElasticCondensation,
    loads: LoadInfluence | None,
    modes: ThermalModes | None,
) -> CondensedMachine:
    """What marches, its bolts not yet tight."""
    case, parts, heat = whole.case, whole.parts, whole.heat
    step = case.march.step_s
    if modes is None:
        thermal, elastic = condense_heat(heat, whole.operators, step, case.march.solver), condensed
    else:
        thermal = project_heat(heat, whole.operators, step, modes)
        elastic = project_elasticity(condensed, modes)
    return CondensedMachine(
        thermal,
        ContactProblem(elastic, parts.laws, holds=parts.holds, loads=loads),
        start=start_field(heat, whole.warm, modes),
        variable=variable_heat(
            case, parts.structure, whole.spaces.heat, whole.materials, parts.joints, heat
        ),
        growth=growth(case, parts.structure, whole.spaces.heat),
    )


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
        return replace(setup, machine=setup.machine.with_laws(laws))
    names, loose, springs = setup.bolts.names, setup.bolts.loose, setup.bolts.springs
    machine, bolts = tightened(names, loose.with_laws(laws), springs, first_forces(case))
    return replace(setup, machine=machine, bolts=bolts)


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
