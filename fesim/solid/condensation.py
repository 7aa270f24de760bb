"""Static condensation on the joints: linear parts are solved once in advance (docs/march.md).

Thermal: A0 = M/dt + K + H is factorised; W = A0^-1 B^T and S = B W carry the joint's heat flows.
Elastic: C = G Kr^-1 G^T carries the tractions to the gaps, S_T = G Kr^-1 F the temperatures, and
the same rows serve every displacement probe. Kr has reference springs at the joint, which constrain
a body supported only by the joint; `fesim.joint.gap` subtracts them from the law. It is never
assembled: `fesim.solid.substructures` factorises body by body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from fesim.solid.elasticity import ElasticOperators
from fesim.solid.heat import HeatOperators
from fesim.solid.joint_operators import JointOperators
from fesim.solid.linear_solver import Factor, checked_solve, factorise
from fesim.solid.substructures import (
    FactorisedStructure,
    TieCondensation,
    condense_ties,
    factorised_structure,
    tie_rows,
)
from thermojoint.artefacts.arrays import Array

#: `ThermalCondensation.model` of nodal temperatures.
FULL = "full"


@dataclass(frozen=True)
class HeatBalance:
    """Heat balance summed over all nodes: in = stored + convected.

    Heat enters by the inputs and at the h held unknowns. There it is the residual of their rows:
    after T - before T_before - drive u + flow j.

    Attributes
    ----------
    stored, convected : ndarray, shape (n,)
        Column sums of M (J/K) and H (W/K).
    entering : ndarray, shape (k,)
        Column sums of P, W per unit of each input.
    after, before : scipy.sparse.csr_array, shape (h, n)
        Held rows of A0 and of M/dt, W/K.
    drive : ndarray, shape (h, k)
        Held rows of P.
    flow : scipy.sparse.csr_array, shape (h, m)
        Held rows of B^T.
    """

    stored: Array
    convected: Array
    entering: Array
    after: csr_array | Array
    before: csr_array | Array
    drive: Array
    flow: csr_array


@dataclass(frozen=True, eq=False)
class ThermalCondensation:
    """One implicit Euler step of the heat equation, reduced to m joint heat flows.

    The unknowns are nodal temperatures, or the amplitudes of a reduced model's modes.

    Attributes
    ----------
    factor : Factor
        A0 = M/dt + K + H, W/K.
    capacity_rate : scipy.sparse.csr_array, shape (n, n)
        M/dt, W/K; zero for the held unknowns.
    inputs : ndarray, shape (n, k)
        Right-hand side per unit of each input; for the held unknowns their temperature.
    jump, mean : scipy.sparse.csr_array, shape (m, n)
        B, and the mean temperature of both sides of each contact element.
    influence : ndarray, shape (n, m)
        W = A0^-1 B^T, K/W; zero for the held unknowns.
    joint_influence : ndarray, shape (m, m)
        S = B W, K/W.
    balance : HeatBalance
        Heat balance of a step.
    step : float
        dt, s.
    model : str
        Kind of the unknowns: ``"full"``, or the digest of a reduced model's basis.
    """

    factor: Factor
    capacity_rate: csr_array
    inputs: Array
    jump: csr_array | Array
    mean: csr_array | Array
    influence: Array
    joint_influence: Array
    balance: HeatBalance
    step: float
    model: str = FULL


@dataclass(frozen=True)
class ElasticCondensation:
    """Gaps and probes as linear functions of temperature and traction.

    Attributes
    ----------
    compliance : ndarray, shape (3 m, 3 m)
        C, gap per joint force, m/N.
    thermal_gap : ndarray, shape (3 m, n_heat)
        S_T, m/K.
    probe_compliance : ndarray, shape (k, 3 m)
        Probe displacement per joint force, m/N.
    probe_thermal : ndarray, shape (k, n_heat)
        Probe displacement per temperature, m/K.
    reference : ndarray, shape (3 m,)
        Stiffness of the reference springs, Pa/m.
    area : ndarray, shape (3 m,)
        Area of the contact element of each gap component, m2.
    """

    compliance: Array
    thermal_gap: Array
    probe_compliance: Array
    probe_thermal: Array
    reference: Array
    area: Array


@dataclass(frozen=True)
class LoadInfluence:
    """Influence of l mechanical loads on gaps and probes, at factor one without joint forces.

    Attributes
    ----------
    gap : ndarray, shape (3 m, l)
        m, with the reference springs across the joints.
    probes : ndarray, shape (k, l)
        m.
    """

    gap: Array
    probes: Array


@dataclass(frozen=True)
class DisplacementField:
    """Full displacement field on demand (for snapshots).

    Attributes
    ----------
    structure : FactorisedStructure
        Its pieces, without springs across the joints.
    ties : scipy.sparse.csr_array, shape (q, n)
        E: G, and the unknowns with anchors.
    condensed : TieCondensation
        On these ties.
    gap : scipy.sparse.csr_array, shape (3 m, n)
        G.
    area : ndarray, shape (3 m,)
        Area of each gap component, m2.
    """

    structure: FactorisedStructure
    ties: csr_array
    condensed: TieCondensation
    gap: csr_array
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
            Those on held unknowns move nothing.
        what : str
            Name for the error message.

        Raises
        ------
        ConvergenceError
            A solve left a residual.
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
        Rows that give each probed displacement.
    solver : str, optional
        See `fesim.solid.linear_solver.factorise`.
    """
    area = np.tile(joints.area, 3)
    shape = elastic.thermal_load.shape
    structure = factorised_structure(elastic.pieces(), joints.gap, area * reference, shape, solver)
    condensed = condense_ties(
        structure.substructures, joints.gap, area * reference, csr_array(probes), shape[1]
    )
    return (
        elastic_condensation(condensed, joints, reference),
        displacement_field(structure, condensed, joints),
    )


def elastic_condensation(
    condensed: TieCondensation, joints: JointOperators, reference: Array
) -> ElasticCondensation:
    """Return the condensation for time stepping from that on ties; see `condense_elasticity`."""
    count = joints.gap.shape[0]
    return ElasticCondensation(
        compliance=np.ascontiguousarray(condensed.compliance[:count, :count]),
        thermal_gap=condensed.thermal[:count],
        probe_compliance=np.ascontiguousarray(condensed.probe_compliance[:, :count]),
        probe_thermal=condensed.probe_thermal,
        reference=reference,
        area=np.tile(joints.area, 3),
    )


def displacement_field(
    structure: FactorisedStructure, condensed: TieCondensation, joints: JointOperators
) -> DisplacementField:
    """Return the displacements of a factorised and condensed structure."""
    ties = tie_rows(joints.gap, structure.substructures)
    return DisplacementField(structure, ties, condensed, joints.gap, np.tile(joints.area, 3))


def condense_loads(field: DisplacementField, forces: Array, probes: csr_array) -> LoadInfluence:
    """Condense mechanical loads on the joints with the same factorisations.

    Parameters
    ----------
    field : DisplacementField
        The factorised structure.
    forces : ndarray, shape (n, l)
        `fesim.solid.forces.nodal_forces`.
    probes : scipy.sparse array, shape (k, n)
        Rows that give each probed displacement.
    """
    moved = field.respond(forces, "mechanical loads")
    return LoadInfluence(field.gap @ moved, probes @ moved)
