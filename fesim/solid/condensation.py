"""Static condensation on the joints: linear parts are solved once in advance (docs/march.md).

Thermal: A0 = M/dt + K + H is factorised; W = A0^-1 B^T and S = B W contain the joint's heat flows.
Elastic: C = G Kr^-1 G^T maps tractions to gaps, S_T = G Kr^-1 F temperatures to gaps, and the same
rows serve every displacement probe. Kr includes reference springs at the joint, which constrain a
body supported only by the joint; `fesim.joint.gap` subtracts them from the law. Kr is never
assembled: `fesim.solid.substructures` factorises body by body.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, diags_array

from fesim.solid.elasticity import ElasticOperators
from fesim.solid.heat import HeatOperators
from fesim.solid.joint_operators import JointOperators
from fesim.solid.linear_solver import Factor, checked_solve, factorise
from fesim.solid.substructures import (
    FactorisedStructure,
    TieCondensation,
    factorised_structure,
    tie_rows,
    tied,
    untied,
)
from thermojoint.artefacts.arrays import Array

#: `ThermalCondensation.model` of nodal temperatures.
FULL = "full"


@dataclass(frozen=True)
class HeatBalance:
    """Heat balance summed over all nodes: in = stored + convected.

    Heat enters through the inputs and at the h held unknowns, where it is the residual of their
    rows: after T - before T_before - drive u + flow j.
    """

    #: Shape (n,): column sums of M (J/K) and H (W/K).
    stored: Array
    convected: Array
    #: Shape (k,): column sums of P, W per unit of each input.
    entering: Array
    #: Shape (h, n): held rows of A0 and of M/dt, W/K.
    after: csr_array | Array
    before: csr_array | Array
    #: Shape (h, k): held rows of P.
    drive: Array
    #: Shape (h, m): held rows of B^T.
    flow: csr_array


@dataclass(frozen=True, eq=False)
class ThermalCondensation:
    """One implicit Euler step of the heat equation, reduced to m joint heat flows.

    The unknowns are nodal temperatures, or the amplitudes of a reduced model's modes.
    """

    #: A0 = M/dt + K + H, W/K.
    factor: Factor
    #: Shape (n, n): M/dt, W/K; zero for the held unknowns.
    capacity_rate: csr_array
    #: Shape (n, k): right-hand side per unit of each input; for the held unknowns, their
    #: temperature.
    inputs: Array
    #: Shape (m, n): B, and the mean temperature of both sides of each contact element.
    jump: csr_array | Array
    mean: csr_array | Array
    #: Shape (n, m): W = A0^-1 B^T, K/W; zero for the held unknowns.
    influence: Array
    #: Shape (m, m): S = B W, K/W.
    joint_influence: Array
    #: Heat balance of a step.
    balance: HeatBalance
    #: dt, s.
    step: float
    #: Kind of the unknowns: ``"full"``, or the digest of a reduced model's basis.
    model: str = FULL


@dataclass(frozen=True)
class ElasticCondensation:
    """Gaps and probes as linear functions of temperature and traction."""

    #: Shape (3 m, 3 m): C, gap per joint force, m/N.
    compliance: Array
    #: Shape (3 m, n_heat): s_T, m/K.
    thermal_gap: Array
    #: Shape (k, 3 m): probe displacement per joint force, m/N.
    probe_compliance: Array
    #: Shape (k, n_heat): probe displacement per temperature, m/K.
    probe_thermal: Array
    #: Shape (3 m,): stiffness of the reference springs, Pa/m.
    reference: Array
    #: Shape (3 m,): area of the contact element of each gap component, m2.
    area: Array

    def strained(self, modulus: float, expansion: float) -> ElasticCondensation:
        """Return it with factors on elastic modulus and thermal expansion."""
        return replace(
            self,
            compliance=self.compliance / modulus,
            thermal_gap=expansion * self.thermal_gap,
            probe_compliance=self.probe_compliance / modulus,
            probe_thermal=expansion * self.probe_thermal,
            reference=modulus * self.reference,
        )

    def turned(self, rows: Callable[[Array], Array]) -> ElasticCondensation:
        """Return it on other temperatures; `rows` transforms rows (..., n_heat)."""
        return replace(
            self, thermal_gap=rows(self.thermal_gap), probe_thermal=rows(self.probe_thermal)
        )

    def with_probes(self, probes: Sequence[int]) -> ElasticCondensation:
        """Return it with some of its probes."""
        return replace(
            self,
            probe_compliance=self.probe_compliance[probes],
            probe_thermal=self.probe_thermal[probes],
        )


@dataclass(frozen=True)
class LoadInfluence:
    """Influence of l mechanical loads on gaps and probes, at factor one without joint forces."""

    #: Shape (3 m, l): with the reference springs across the joints, m.
    gap: Array
    #: Shape (k, l): probes, m.
    probes: Array


@dataclass(frozen=True)
class DisplacementField:
    """Full displacement field on demand (for snapshots)."""

    #: Its pieces, without springs across the joints.
    structure: FactorisedStructure
    #: Shape (q, n): E: G, and the unknowns with anchors.
    ties: csr_array
    #: Condensation on these ties.
    condensed: TieCondensation
    #: Shape (3 m, n): G.
    gap: csr_array
    #: Shape (3 m,): area of each gap component, m2.
    area: Array

    def solve(self, temperature: Array, remainder: Array, forces: Array | None = None) -> Array:
        """Displacement, shape (n,), of a temperature field and the joint law's remainder (3 m,).

        `forces` (n,), N, are those of mechanical loads.
        """
        load = self.structure.thermal_load @ temperature + self.gap.T @ (self.area * remainder)
        return self.respond(load if forces is None else load + forces, "displacement field")

    def respond(self, forces: Array, what: str) -> Array:
        """Displacements Kr^-1 f, shape (n,) or (n, k), of nodal forces of that shape, N.

        Parameters
        ----------
        forces : ndarray
            Forces on held unknowns have no effect.
        what : str
            Name for the error message.

        Raises
        ------
        ConvergenceError
            A solve left too large a residual.
        """
        springs = self.condensed.springs
        apart = self._apart(forces, what)
        untied = self.ties @ apart
        moved = untied - self.condensed.compliance @ (springs * untied.T).T
        return apart - self._apart(self.ties.T @ (springs * moved.T).T, what)

    def _apart(self, forces: Array, what: str) -> Array:
        """Displacements without the springs of the ties, piece by piece."""
        displacements = np.zeros(forces.shape)
        for substructure in self.structure.substructures:
            displacements[substructure.unknowns] = checked_solve(
                substructure.factor, forces[substructure.unknowns], what
            )
        return displacements


def condense_heat(
    heat: HeatOperators, joints: JointOperators, step: float, solver: str | None = None
) -> ThermalCondensation:
    """Factorise one implicit Euler step of length `step` (s) and condense it on the joints."""
    system, inputs = eliminate_held(heat, step)
    factor = factorise(system, "heat equation", solver)
    free = _free_unknowns(heat)
    influence = checked_solve(
        factor, (joints.jump @ diags_array(free)).toarray().T, "heat condensation"
    )
    return ThermalCondensation(
        factor=factor,
        capacity_rate=csr_array(diags_array(free) @ heat.capacity / step),
        inputs=inputs,
        jump=joints.jump,
        mean=joints.mean,
        influence=influence,
        joint_influence=joints.jump @ influence,
        balance=heat_sums(heat, joints, step),
        step=step,
    )


def eliminate_held(heat: HeatOperators, step: float) -> tuple[csr_array, Array]:
    """Return A0 (n, n) and the right-hand sides (n, k) with the held unknowns eliminated.

    Their rows prescribe their temperature; their influence on neighbours is on the right-hand side,
    so the matrix remains symmetric.
    """
    system = csr_array(heat.capacity / step + heat.conduction + heat.convection)
    free = _free_unknowns(heat)
    inputs = free[:, None] * (heat.inputs - system[:, heat.held] @ heat.held_inputs)
    inputs[heat.held] = heat.held_inputs
    keep = diags_array(free)
    return csr_array(keep @ system @ keep + diags_array(1.0 - free)), inputs


def heat_sums(heat: HeatOperators, joints: JointOperators, step: float) -> HeatBalance:
    """Return the heat balance of a step of length `step` (s)."""
    rate = csr_array(heat.capacity / step)
    system = csr_array(rate + heat.conduction + heat.convection)
    return HeatBalance(
        stored=np.asarray(heat.capacity.sum(axis=0)).ravel(),
        convected=np.asarray(heat.convection.sum(axis=0)).ravel(),
        entering=heat.inputs.sum(axis=0),
        after=system[heat.held],
        before=rate[heat.held],
        drive=heat.inputs[heat.held],
        flow=csr_array(joints.jump[:, heat.held].T),
    )


def _free_unknowns(heat: HeatOperators) -> Array:
    free = np.ones(heat.inputs.shape[0])
    free[heat.held] = 0.0
    return free


def condense_elasticity(
    elastic: ElasticOperators,
    joints: JointOperators,
    reference: Array,
    probes: csr_array,
    solver: str | None = None,
) -> tuple[ElasticCondensation, DisplacementField]:
    """Condense the elastic structure on the joints.

    Parameters
    ----------
    elastic : ElasticOperators
        K, F and the free unknowns.
    joints : JointOperators
        G and areas.
    reference : ndarray, shape (3 m,)
        Stiffness of the reference springs, Pa/m: positive, of the order of the joint's own.
    probes : scipy.sparse array, shape (k, n)
        Rows of the probed displacements.
    solver : str, optional
        See `fesim.solid.linear_solver.factorise`.
    """
    area = np.tile(joints.area, 3)
    shape = elastic.thermal_load.shape
    structure = factorised_structure(elastic.pieces(), joints.gap, area * reference, shape, solver)
    condensed = tied(
        untied(structure.substructures, joints.gap, area * reference, csr_array(probes), shape[1])
    )
    return (
        elastic_condensation(condensed, joints.area, reference),
        displacement_field(structure, condensed, joints),
    )


def elastic_condensation(
    condensed: TieCondensation, area: Array, reference: Array
) -> ElasticCondensation:
    """Return the condensation for time stepping from that on ties; see `condense_elasticity`."""
    count = reference.size
    return ElasticCondensation(
        compliance=np.ascontiguousarray(condensed.compliance[:count, :count]),
        thermal_gap=condensed.thermal[:count],
        probe_compliance=np.ascontiguousarray(condensed.probe_compliance[:, :count]),
        probe_thermal=condensed.probe_thermal,
        reference=reference,
        area=np.tile(area, 3),
    )


def displacement_field(
    structure: FactorisedStructure, condensed: TieCondensation, joints: JointOperators
) -> DisplacementField:
    """Return the displacements of a factorised and condensed structure."""
    ties = tie_rows(joints.gap, structure.substructures)
    return DisplacementField(structure, ties, condensed, joints.gap, np.tile(joints.area, 3))


def condense_loads(field: DisplacementField, forces: Array, probes: csr_array) -> LoadInfluence:
    """Condense mechanical loads on the joints with the same factorisations.

    `forces` (n, l), N, are from `fesim.solid.forces.nodal_forces`; `probes` (k, n) are the rows of
    the probed displacements.
    """
    moved = field.respond(forces, "mechanical loads")
    return LoadInfluence(field.gap @ moved, probes @ moved)
