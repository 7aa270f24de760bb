"""Set-up of the condensed machine of a case."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from hashlib import sha256

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
    at_step,
    outputs_of,
    project_elasticity,
    project_heat,
    shortest,
    thermal_modes,
)
from fesim.march.settling import initial_state
from fesim.march.softening import Acting, lifted
from fesim.march.start_field import start_field
from fesim.setup.bolts import first_forces
from fesim.setup.constraints import check_constrained
from fesim.setup.discretised import (
    Discretised,
    discretised,
    elastic_structure,
    load_forces,
    relative_rows,
)
from fesim.setup.laws import joint_laws
from fesim.setup.mesh_errors import (
    DualHeat,
    HeatErrors,
    MeshErrors,
    StressErrors,
    dual_rows,
    heat_errors,
    stress_errors,
    variable_errors,
)
from fesim.setup.outputs import asks_for_outputs, mechanical_outputs
from fesim.setup.parts import Parts, make_parts
from fesim.setup.soundness import check_laws, check_stands, explained_by_size, suspicions
from fesim.setup.structure import body_materials
from fesim.setup.temperature_dependence import (
    growth,
    modulus_factors,
    variable_heat,
)
from fesim.solid.bolts import bolt_springs
from fesim.solid.condensation import (
    DisplacementField,
    ElasticCondensation,
    LoadInfluence,
    ThermalCondensation,
    condense_heat,
    condense_loads,
    elastic_condensation,
)
from fesim.solid.friction_heat import friction_heat
from fesim.solid.materials import Material
from fesim.solid.outputs import MechanicalOutputs
from fesim.solid.reduction import reduce_heat
from fesim.solid.rigid_motions import Constraints
from fesim.solid.spaces import Spaces
from fesim.solid.substructures import TieCondensation
from fesim.solid.variable_stiffness import VariableStiffness, soft_bodies
from meshes.pairing import PairedJoint
from meshes.structure import Probe, Structure
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import InputError

#: Factors of structures with fewer displacement unknowns than this are kept in memory together.
SMALL = 150_000


@dataclass(frozen=True, repr=False)
class Setup(Described):
    """A condensed case.

    Attributes
    ----------
    case : Case
        Case of the condensation; others may differ in loads and in the length of the march.
    structure : Structure
        Structure with all probes of the case.
    spaces : Spaces
        Finite-element spaces.
    joints : tuple of PairedJoint
        In the order of the contact elements.
    machine : CondensedMachine
        Its displacement probes are the relative displacement along x, y and z.
    make_field : callable
        Returns `field`, which is factorised on the first call.
    probes : dict of str to Probe
        Temperature probes: the named ones and the candidates.
    probe_rows : scipy.sparse.csr_array or ndarray, shape (probes, n_heat)
        Their rows on nodal temperatures or on the amplitudes of the reduced model.
    modes : ThermalModes or None
        The reduced thermal model; None for the full one.
    constraints : Constraints
        Constraints of the bodies.
    forces : ndarray, shape (n, l + b)
        Nodal forces of the mechanical loads at factor one, then of the bolts per N, N.
    outputs : MechanicalOutputs or None
        Forces and stresses, if requested; functions of `acting`.
    bolts : Bolts or None
        The bolts, if there are any.
    materials : dict of str to Material
        Material of every body.
    make_thermal : callable
        From the length of a step (s) to the heat step of that length, on the same unknowns.
    make_mesh_errors : callable
        From the machine before its bolts are tightened and the length of a march (s) to rows of the
        mesh errors; None if the structure is too large for them.
    """

    case: Case
    structure: Structure
    spaces: Spaces
    joints: tuple[PairedJoint, ...]
    machine: CondensedMachine
    make_field: Callable[[], DisplacementField]
    probes: dict[str, Probe]
    probe_rows: csr_array | NDArray[np.float64]
    modes: ThermalModes | None
    constraints: Constraints
    forces: NDArray[np.float64]
    outputs: MechanicalOutputs | None
    bolts: Bolts | None
    materials: dict[str, Material]
    make_thermal: Callable[[float], ThermalCondensation]
    make_mesh_errors: Callable[[CondensedMachine, float], MeshErrors | None]

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

    def at_step(self, step: float) -> Setup:
        """Return the same set-up for steps of another length.

        Parameters
        ----------
        step : float
            New length, s.
        """
        thermal = self.machine.thermal
        if step != thermal.step:
            thermal = self.make_thermal(step)
        return replace(self, machine=replace(self.machine, thermal=thermal))

    def nodal_temperature(self, state: State) -> NDArray[np.float64]:
        """Temperature above the initial ambient at every unknown of `spaces.heat`, K.

        Parameters
        ----------
        state : State
            State in a march of this set-up.
        """
        return state.temperature if self.modes is None else self.modes.basis @ state.temperature

    def bolt_forces(self, step: Step) -> NDArray[np.float64]:
        """Force of each bolt, shape (b,), N.

        Parameters
        ----------
        step : Step
            Step of a march of this set-up.
        """
        if self.bolts is None:
            return np.empty(0)
        factors = load_factors(self.machine, step.inputs)
        return self.bolts.force.of(step.state.temperature, step.remainder, factors)

    def acting(self, step: Step) -> NDArray[np.float64]:
        """Factors of the loads and forces (N) of the bolts, shape (l + b,), as for `forces`.

        Parameters
        ----------
        step : Step
            Step of a march of this set-up.
        """
        pulls = self.bolt_forces(step)
        factors = load_factors(self.machine, step.inputs)
        return np.concatenate([factors[: self.forces.shape[1] - pulls.size], pulls])

    def displacement(self, step: Step) -> NDArray[np.float64]:
        """Displacement at every unknown, shape (n,), m; relative to the state after tightening.

        Parameters
        ----------
        step : Step
            Step of a march of this set-up.
        """
        if self.machine.stiffness is not None:
            return self.deformation(step)
        acting, remainder = self.acting(step), step.remainder
        if self.machine.assembly is not None:
            acting = acting - self.machine.assembly.factors[:-1]
            remainder = remainder - self.machine.assembly.remainder
        temperature = self.machine.strained(self.nodal_temperature(step.state))
        return self.field.solve(temperature, remainder, self.forces @ acting)

    def deformation(self, step: Step) -> NDArray[np.float64]:
        """Displacement relative to the force-free state, shape (n,), m: that of the stresses.

        Parameters
        ----------
        step : Step
            Step of a march of this set-up.
        """
        temperature = self.nodal_temperature(step.state)
        strained = self.machine.strained(temperature)
        if self.machine.stiffness is not None:
            acting = Acting(temperature, strained, self.acting(step))
            return lifted(self.machine.stiffness, acting, lambda _: step.remainder).moved
        return self.field.solve(strained, step.remainder, self.forces @ self.acting(step))


@dataclass(frozen=True)
class CacheKeys:
    """Keys of a case in the cache; None if a mesh file has changed since it was read."""

    heat: str | None
    elasticity: str | None


def set_up(case: Case) -> Setup:
    """Build, check and condense the parts of a case; warn about bodies that touch without a joint.

    Parameters
    ----------
    case : Case
        Its heat input is not used: one set-up serves any number of heat inputs.

    Raises
    ------
    InputError
        A name does not exist in the structure, parts do not match, a body is not constrained, or
        the case has axes.
    """
    check_stands(case)
    before = thermal_key(case)
    parts = make_parts(case)
    for line in suspicions(parts.structure, parts.joints):
        warnings.warn(line, stacklevel=2)
    with explained_by_size(parts.structure):
        return _condensed(case, parts, cache_keys(case, before))


def _condensed(case: Case, parts: Parts, keys: CacheKeys) -> Setup:
    """Condense checked parts."""
    whole = discretised(case, parts)
    forces = load_forces(whole)
    condensed, field, stress = _condensed_elasticity(whole, keys, forces)
    loads = _loads(whole, keys, field, forces)
    outputs = _outputs(whole, keys, field, forces)
    modes = _modes(whole, keys, condensed)
    full = partial(condense_heat, whole.heat, whole.operators, solver=case.march.solver)
    step = case.march.step_s
    thermal = (
        full(step) if modes is None else project_heat(whole.heat, whole.operators, step, modes)
    )
    machine = _machine(whole, condensed, loads, modes, thermal)
    machine = replace(machine, stiffness=_variable_stiffness(whole, field, forces))
    errors = partial(_mesh_errors, DualHeat(whole), keys, condensed, stress)
    bolts = None
    if parts.bolts:
        ends = whole.ends.toarray() if modes is None else whole.ends @ modes.basis
        ties = bolt_springs(parts.bolts, ends)
        machine, bolts = tightened(tuple(case.bolts), machine, ties, first_forces(case))
    if outputs is not None and modes is not None:
        outputs = replace(outputs, temperature=outputs.temperature @ modes.basis)
    return Setup(
        case=case,
        structure=parts.structure,
        spaces=whole.spaces,
        joints=parts.joints,
        machine=machine,
        make_field=field,
        probes=parts.probes,
        probe_rows=whole.rows if modes is None else whole.rows @ modes.basis,
        modes=modes,
        constraints=parts.constraints,
        forces=forces,
        outputs=outputs,
        bolts=bolts,
        materials=whole.materials,
        make_thermal=full if modes is None else partial(at_step, thermal),
        make_mesh_errors=lru_cache(maxsize=1)(errors),
    )


def cache_keys(case: Case, before: str) -> CacheKeys:
    """Return the cache keys; `before` is the thermal key from before the meshes were read."""
    # A mesh file may have been rewritten in the meantime.
    digest = cache(file_digest)
    if thermal_key(case, digest) != before:
        return CacheKeys(None, None)
    return CacheKeys(before, elasticity_key(case, digest))


def _condensed_elasticity(
    whole: Discretised, keys: CacheKeys, forces: NDArray[np.float64]
) -> tuple[ElasticCondensation, Callable[[], DisplacementField], StressErrors | None]:
    """Condense the structure; its displacement field is factorised on demand.

    Mesh errors are computed while its factors exist.
    """
    case = whole.case
    if case.displacement is None:
        return _undeformed(whole), _no_field, None
    solid, rows = elastic_structure(whole), relative_rows(whole)
    # The factors are stored if loads, outputs or snapshots need them again; all at once only if
    # they are small.
    soft = modulus_factors(case, whole.materials)
    again = case.loads or case.bolts or case.output.snapshots_s or asks_for_outputs(case) or soft
    together = again or whole.spaces.displacement_size <= SMALL

    def condense() -> TieCondensation:
        pieces = solid.factorised.substructures if together else solid.one_by_one()
        return solid.condense(pieces, rows)

    tied = remembered(TieCondensation, keys.elasticity, condense)
    field, errors = cache(partial(solid.field, tied)), None
    if together:
        errors = remembered(
            StressErrors,
            keys.elasticity,
            lambda: stress_errors(whole, field(), forces),
            also=f"off under {load_patterns(case)}",
        )
    if not again:
        field = cache(lambda: elastic_structure(whole).field(tied))
    return elastic_condensation(tied, whole.operators.area, whole.springs), field, errors


def _undeformed(whole: Discretised) -> ElasticCondensation:
    """Joints without change and no displacement: nothing is assembled or factorised."""
    area, heat = np.tile(whole.operators.area, 3), int(whole.spaces.heat.N)
    return ElasticCondensation(
        compliance=np.zeros((area.size, area.size)),
        thermal_gap=np.zeros((area.size, heat)),
        probe_compliance=np.zeros((0, area.size)),
        probe_thermal=np.zeros((0, heat)),
        reference=whole.springs,
        area=area,
    )


def _no_field() -> DisplacementField:
    raise InputError("the case asks for heat alone; add [displacement] to have it deform")


def _loads(
    whole: Discretised,
    keys: CacheKeys,
    field: Callable[[], DisplacementField],
    forces: NDArray[np.float64],
) -> LoadInfluence | None:
    """Influence of loads and bolts on gaps and probes."""
    if not forces.shape[1]:
        return None
    return remembered(
        LoadInfluence,
        keys.elasticity,
        lambda: condense_loads(field(), forces, relative_rows(whole)),
        also=f"under {load_patterns(whole.case)}",
    )


def _outputs(
    whole: Discretised,
    keys: CacheKeys,
    field: Callable[[], DisplacementField],
    forces: NDArray[np.float64],
) -> MechanicalOutputs | None:
    """Forces and stresses, if requested."""
    case = whole.case
    if not asks_for_outputs(case):
        return None
    return remembered(
        MechanicalOutputs,
        keys.elasticity,
        lambda: mechanical_outputs(whole, field(), forces),
        also=f"under {load_patterns(case)} gives {asked(case)}",
    )


def _modes(
    whole: Discretised, keys: CacheKeys, condensed: ElasticCondensation
) -> ThermalModes | None:
    """The reduced thermal model, if the case uses one."""
    march = whole.case.march
    if march.thermal != "reduced":
        return None
    # Mean temperatures of the contact elements with slip heating: the dual of their heat.
    rubbed = whole.operators.mean[np.flatnonzero(_counted(whole))]
    return remembered(
        ThermalModes,
        keys.heat,
        lambda: thermal_modes(
            whole.heat,
            whole.operators,
            outputs_of(condensed, csr_array(vstack([whole.rows, whole.ends, rubbed]))),
            march.step_s,
            partial(reduce_heat, solver=march.solver),
            whole.warm,
        ),
        also=f"from {shortest(march.step_s)!r} s",
    )


def _counted(whole: Discretised) -> NDArray[np.float64]:
    """Weight (m,) of the frictional heat of contact elements: 1 with slip heating, else 0."""
    joints, sections = whole.parts.joints, whole.case.joints
    each = [float(sections[joint.name].slip_heating) for joint in joints]
    return np.repeat(each, [len(joint.area) for joint in joints])


def _machine(
    whole: Discretised,
    condensed: ElasticCondensation,
    loads: LoadInfluence | None,
    modes: ThermalModes | None,
    thermal: ThermalCondensation,
) -> CondensedMachine:
    """The condensed machine before its bolts are tightened."""
    case, parts, heat = whole.case, whole.parts, whole.heat
    elastic = condensed if modes is None else project_elasticity(condensed, modes)
    constraints = None if case.displacement is None else parts.constraints
    counted = _counted(whole)
    return CondensedMachine(
        thermal,
        ContactProblem(elastic, parts.laws, constraints=constraints, loads=loads),
        start=start_field(heat, whole.warm, modes),
        variable=variable_heat(
            case, parts.structure, whole.spaces.heat, whole.materials, parts.joints, heat
        ),
        growth=growth(case, parts.structure, whole.spaces.heat),
        friction=friction_heat(thermal, counted) if counted.any() else None,
    )


def _variable_stiffness(
    whole: Discretised, field: Callable[[], DisplacementField], forces: NDArray[np.float64]
) -> VariableStiffness | None:
    """Correction of the stiffness for temperature-dependent moduli."""
    factors = modulus_factors(whole.case, whole.materials)
    if not factors or whole.case.displacement is None:
        return None
    bodies = soft_bodies(whole.parts.structure, whole.spaces, whole.materials, factors)
    return VariableStiffness(bodies, field, relative_rows(whole), forces)


def _mesh_errors(
    dual: DualHeat,
    keys: CacheKeys,
    condensed: ElasticCondensation,
    stress: StressErrors | None,
    machine: CondensedMachine,
    duration: float,
) -> MeshErrors | None:
    """Rows of the mesh errors in a march (s), with joints in their state at preload."""
    if stress is None:
        return None
    conductance = machine.conductance_in(initial_state(replace(machine, assembly=None)))
    rows = dual_rows(condensed, machine.contact)
    given = sha256(rows.tobytes() + conductance.tobytes()).hexdigest()
    heat = remembered(
        HeatErrors,
        keys.heat,
        lambda: heat_errors(dual, rows, conductance, duration),
        also=f"off by {given} in {duration!r} s",
    )
    return MeshErrors(heat, variable_errors(dual, heat.beyond), stress)


def with_laws(setup: Setup, case: Case) -> Setup:
    """Return the set-up of a case that differs only in its loads, bolt forces and joint laws.

    The condensation is reused, as it depends on none of them.

    Raises
    ------
    InputError
        Without the friction of the first case, a body is not constrained; or the laws or the
        ambient are refused as by `set_up`.
    """
    check_laws(case, setup.joints)
    materials = body_materials(case, setup.structure)
    laws = joint_laws(case, setup.structure, materials, setup.joints)
    check_constrained(case, setup.constraints, setup.joints)
    if setup.bolts is None:
        return replace(setup, case=case, machine=setup.machine.with_laws(laws))
    names, loose, springs = setup.bolts.names, setup.bolts.loose, setup.bolts.springs
    machine, bolts = tightened(names, loose.with_laws(laws), springs, first_forces(case))
    return replace(setup, case=case, machine=machine, bolts=bolts)
