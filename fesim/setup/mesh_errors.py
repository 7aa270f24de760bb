"""Mesh errors of a case's displacement: rows on temperatures, tractions and loads.

With the dual solutions of the displacement (`fesim.solid.recovery`) they take six right-hand sides
in addition to the condensation, one more per contact element if these are few, and two products in
a march.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array
from skfem import CellBasis

from fesim.case.schema import secant_sections
from fesim.march.contact import ContactProblem
from fesim.march.heat_step import joint_heat_flow
from fesim.march.machine import Step
from fesim.setup.constraints import fixed_surfaces
from fesim.setup.discretised import Discretised, relative_rows, thermal_loads
from fesim.setup.temperature_dependence import reference_materials, variable_heat
from fesim.solid.condensation import DisplacementField, ElasticCondensation, eliminate_held
from fesim.solid.elasticity import DIRECTIONS
from fesim.solid.element_matrices import reference_shapes
from fesim.solid.heat import HeatOperators, capacity_form, cell_field, heat_operators
from fesim.solid.joint_operators import jumps
from fesim.solid.linear_solver import Factor, checked_solve, factorise
from fesim.solid.materials import Material
from fesim.solid.recovery import stress_error_rows
from fesim.solid.round_faces import shape_error_rows
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MEGA

#: Most contact elements whose answers to heat are computed once for all laws: more of them take
#: longer than the factor of another law.
FEW = 64


@dataclass(frozen=True)
class StressErrors:
    """Displacement error due to the displacement mesh, along three axes."""

    #: Shape (3, n_heat): per temperature, m/K.
    temperature: Array
    #: Shape (3, 3 m): per traction, m/Pa.
    remainder: Array
    #: Shape (3, l + b): per factor of each load and N of each bolt, m.
    forces: Array


@dataclass(frozen=True)
class HeatErrors:
    """Displacement error due to the temperature mesh, along three axes."""

    #: Shape (3, n_heat): per temperature, m/K.
    temperature: Array
    #: Shape (3, n_heat): per rate of temperature, m s/K.
    rising: Array
    #: Shape (3, k): per unit of each input, m.
    inputs: Array
    #: Shape (3, m): per heat flow through each contact element, m/W.
    flow: Array
    #: Shape (n_high, 3): part of the second-order dual temperatures that is not of first order,
    #: m/W.
    beyond: Array

    def on(self, basis: Array) -> HeatErrors:
        """Return the rows on the amplitudes of modes (n_heat, r)."""
        return replace(self, temperature=self.temperature @ basis, rising=self.rising @ basis)

    def of(self, step: Step, begun: Array, time: float) -> Array:
        """Errors (3,), m, of a step that ends at a time, s, for a uniform rise from `begun`."""
        warm, inputs = step.state.temperature, step.inputs[: self.inputs.shape[1]]
        found = self.temperature @ warm + self.rising @ (warm - begun) / time
        return np.asarray(found + self.inputs @ inputs + self.flow @ step.heat_flow)


@dataclass(frozen=True)
class MeshErrors:
    """Displacement errors due to the meshes of temperatures and displacements."""

    #: Due to the temperature mesh.
    heat: HeatErrors
    #: Temperature-dependent part of the former: from nodal temperatures at the start and at a time
    #: (n_heat,), that time (s), and inputs (k + l,) to errors (3,), m.
    variable: Callable[[Array, Array, float, Array], Array] | None
    #: Due to the displacement mesh.
    stress: StressErrors


def stress_errors(whole: Discretised, field: DisplacementField, forces: Array) -> StressErrors:
    """Return the rows of a case from the displacements (n,) under its probes' rows and `forces`."""
    structure, axes = whole.parts.structure, len(DIRECTIONS)
    duals = field.respond(relative_rows(whole)[:axes].toarray().T, "displacement's dual")
    free = _free_facets(whole)
    given = structure, whole.spaces, whole.materials
    moved, heated = stress_error_rows(*given, free, duals)
    pressed = _pressed(whole, free, forces.shape[1])
    reshaped, warmed, loaded = shape_error_rows(*given, pressed, duals)
    answers = field.respond(moved + reshaped, "displacement's dual")
    return StressErrors(
        (heated + warmed + field.structure.thermal_load.T @ answers).T,
        (field.gap @ answers).T * field.area,
        answers.T @ forces + loaded.T,
    )


def _free_facets(whole: Discretised) -> NDArray[np.int64]:
    """Boundary facets without support, joint or load."""
    loaded = [load.surface for load in whole.case.loads.values() if load.surface is not None]
    return np.setdiff1d(whole.parts.structure.mesh.boundary_facets(), _touched(whole, loaded))


def _touched(whole: Discretised, others: Sequence[str]) -> NDArray[np.int64]:
    """Facets of supports, joints and other surfaces."""
    case, structure = whole.case, whole.parts.structure
    supports = [*fixed_surfaces(case), *case.supports.symmetry, *case.supports.springs]
    touched = [structure.surface(name, "supports") for name in (*supports, *others)]
    touched += [side for joint in whole.parts.joints for side in (joint.facets_a, joint.facets_b)]
    return np.concatenate([np.empty(0, dtype=np.int64), *touched])


def _pressed(
    whole: Discretised, free: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], Array]:
    """Facets without traction or with pressures only, and their pressures (f, count), Pa."""
    structure, loads = whole.parts.structure, list(whole.case.loads.values())
    others = [load.surface for load in loads if load.pressure_MPa is None and load.surface]
    under = [
        np.empty(0, dtype=np.int64)
        if load.pressure_MPa is None
        else structure.surface(load.surface or "", "loads")
        for load in loads
    ]
    facets = np.union1d(free, np.concatenate([np.empty(0, dtype=np.int64), *under]))
    facets = np.setdiff1d(facets, _touched(whole, others))
    pressure = np.zeros((len(facets), count))
    for column, (load, own) in enumerate(zip(loads, under, strict=True)):
        pressure[np.isin(facets, own), column] = MEGA * (load.pressure_MPa or 0.0)
    return facets, pressure


def dual_rows(condensed: ElasticCondensation, contact: ContactProblem) -> Array:
    """Return the displacement per nodal temperature, (3, n_heat), m/K, with sticking joints."""
    problem, axes = contact.gap_problem, len(DIRECTIONS)
    closing = condensed.probe_compliance[:axes] * (condensed.area * problem.change)
    closing = closing + (closing @ problem.compliance) * problem.change
    return np.asarray(condensed.probe_thermal[:axes] + closing @ condensed.thermal_gap)


@dataclass(frozen=True, eq=False)
class DualHeat:
    """The second-order heat equation of a case's duals, assembled when it is first needed.

    Without what joints conduct, so that cases with other laws share it.
    """

    #: The case on its meshes.
    whole: Discretised

    @cached_property
    def space(self) -> CellBasis:
        """Second-order functions."""
        # Of a copy, because it is large and not needed again.
        return replace(self.whole.spaces).elastic

    @cached_property
    def materials(self) -> dict[str, Material]:
        """Materials at reference conditions."""
        return reference_materials(self.whole.case, self.whole.materials)

    @cached_property
    def operators(self) -> HeatOperators:
        """Operators of second order, with a lumped capacity."""
        case, parts = self.whole.case, self.whole.parts
        loads = thermal_loads(case, parts.structure)
        return heat_operators(parts.structure, self.space, self.materials, loads, parts.joints)

    @cached_property
    def capacity(self) -> csr_array:
        """Capacity that is not lumped, (n_high, n_high), J/K."""
        stored = {name: m.density * m.heat_capacity for name, m in self.materials.items()}
        field = cell_field(self.whole.parts.structure, stored, self.space)
        return csr_array(capacity_form.assemble(self.space, value=field))

    @cached_property
    def lifted(self) -> csr_array:
        """First-order functions at the second-order unknowns, (n_high, n_low)."""
        return _lifted(self.whole.spaces.heat, self.space)

    @cached_property
    def density(self) -> Factor:
        """Factor of the capacity of first-order functions."""
        mass, solver = self.lifted.T @ self.capacity @ self.lifted, self.whole.case.march.solver
        return factorise(csr_array(mass), "density of the heat's dual", solver)

    @property
    def heat(self) -> HeatOperators:
        """Operators whose capacity is not lumped."""
        return replace(self.operators, capacity=self.capacity)

    @cached_property
    def jump(self) -> csr_array:
        """Temperature jump of each contact element, (m, n_high)."""
        return jumps(self.whole.parts.joints, self.whole.spaces.displacement)

    @cached_property
    def apart(self) -> Callable[[float], _Apart]:
        """From the length of a march, s, to the step of that length without joint conduction."""
        solver = self.whole.case.march.solver
        return lru_cache(maxsize=1)(partial(_apart, self.heat, self.jump, solver))


@dataclass(frozen=True)
class _Apart:
    """One step of the second-order heat equation without what the joints conduct."""

    #: A0 = M/dt + K + H, W/K.
    factor: Factor
    #: Shape (n_high, m): A0^-1 B^T, K/W; zero for the held unknowns.
    influence: Array
    #: Shape (m, m): B A0^-1 B^T, K/W.
    joint_influence: Array


def _apart(heat: HeatOperators, jump: csr_array, solver: str | None, duration: float) -> _Apart:
    factor = factorise(eliminate_held(heat, duration)[0], "heat's dual", solver)
    driven = jump.toarray().T
    driven[heat.held] = 0.0
    influence = checked_solve(factor, driven, "heat's dual")
    return _Apart(factor, influence, jump @ influence)


def heat_errors(dual: DualHeat, rows: Array, conducts: Array, duration: float) -> HeatErrors:
    """Return the errors from `dual_rows`, with given joint conductances (m,), W/(m2 K).

    The dual temperatures are of second order, after one step of the length of the march,
    `duration`, s. Their difference from first order multiplies the residual of the heat equation
    (Becker & Rannacher 2001).
    """
    whole, fine, capacity, lifted = dual.whole, dual.operators, dual.capacity, dual.lifted
    low = whole.spaces.heat
    lost = csr_array(fine.conduction + fine.convection)
    # Rows are integrals of a density, here per heat capacity: the same with second-order
    # functions.
    density = checked_solve(dual.density, rows.T, "density of the heat's dual")
    driven = capacity @ (lifted @ density)
    driven[fine.held] = 0.0
    duals = _duals(dual, driven, whole.operators.area * conducts, duration)
    first = np.zeros((int(low.N), duals.shape[1]))
    first[low.nodal_dofs[0]] = duals[dual.space.nodal_dofs[0]]
    beyond = duals - lifted @ first
    lumped = whole.heat.capacity @ first - lifted.T @ (capacity @ (lifted @ first))
    return HeatErrors(
        temperature=-(lifted.T @ (lost @ beyond)).T,
        rising=(lumped - lifted.T @ (capacity @ beyond)).T,
        inputs=beyond.T @ fine.inputs,
        flow=-(dual.jump @ beyond).T,
        beyond=beyond,
    )


def _duals(dual: DualHeat, driven: Array, joint: Array, duration: float) -> Array:
    """Dual temperatures (n_high, 3) for conductances times areas `joint` (m,), W/K.

    A few joint conductances are of low rank: all laws on a set-up share a factor.
    """
    if len(joint) <= FEW:
        apart = dual.apart(duration)
        alone = checked_solve(apart.factor, driven, "heat's dual")
        flow = joint_heat_flow(apart.joint_influence, joint, dual.jump @ alone)
        return np.asarray(alone - apart.influence @ flow)
    through = csr_array(dual.jump.T @ diags_array(joint) @ dual.jump)
    joined = replace(dual.heat, conduction=csr_array(dual.heat.conduction + through))
    system, _ = eliminate_held(joined, duration)
    factor = factorise(system, "heat's dual", dual.whole.case.march.solver)
    return checked_solve(factor, driven, "heat's dual")


def variable_errors(
    dual: DualHeat, beyond: Array
) -> Callable[[Array, Array, float, Array], Array] | None:
    """Return `MeshErrors.variable` of a case; `beyond` is that of its `HeatErrors`."""
    case, parts = dual.whole.case, dual.whole.parts
    if not secant_sections(case):
        return None
    lifted = dual.lifted
    terms = variable_heat(
        case, parts.structure, dual.space, dual.materials, parts.joints, dual.operators
    )

    def variable(begun: Array, warm: Array, time: float, inputs: Array) -> Array:
        assert terms is not None
        there = lifted @ warm
        retained = terms.retained(lifted @ begun, there) / time
        return np.asarray(-beyond.T @ (terms.lost(there, inputs) + retained))

    return variable


def _lifted(low: CellBasis, high: CellBasis) -> csr_array:
    """First-order functions at the second-order unknowns, shape (n_high, n_low)."""
    places = np.asarray(high.elem.doflocs).T
    shapes, _ = reference_shapes(low.elem, places, len(low.element_dofs))
    at, first = np.unique(high.element_dofs, return_index=True)
    function, cell = np.divmod(first, high.element_dofs.shape[1])
    columns, values = low.element_dofs[:, cell], shapes[:, function]
    index = (np.tile(at, len(columns)), columns.ravel())
    return csr_array((values.ravel(), index), shape=(int(high.N), int(low.N)))
