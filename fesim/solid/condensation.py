"""Condensation on the joint: everything linear is solved once, before the march (docs/march.md).

Thermal: A0 = M/dt + K + H is factorised; W = A0^-1 B^T and S = B W carry the joint's heat flows.
Elastic: C = G Kr^-1 G^T carries the tractions to the gaps, S_T = G Kr^-1 F the temperatures, and
the same rows serve every displacement probe. Kr has reference springs at the joint, which hold a
body that only the joint carries; `fesim.joint.gap` takes them out of the law again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from artefacts.arrays import Array
from fesim.joint.operators import JointOperators
from fesim.solid.elasticity import ElasticOperators
from fesim.solid.heat import HeatOperators
from fesim.solid.linear_solver import Factor, checked_solve, factorise

#: The unknowns of the full model: nodal temperatures.
FULL = "full"


@dataclass(frozen=True)
class HeatBalance:
    """What enters, is stored and leaves, summed over all nodes: in = stored + convected.

    Heat enters by the inputs and at the h held unknowns. There it is what their rows of the
    equation lack: after T - before T_before - drive u + flow j.

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


@dataclass(frozen=True)
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
        What closes the books of a step.
    step : float
        dt, s.
    model : str
        What the unknowns are: ``"full"``, or the digest of a reduced model's basis.
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
    """What l mechanical loads do to gaps and probes, at factor one and with no force in the joints.

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
    factor : Factor
        Kr on the free unknowns.
    operators : ElasticOperators
        F and the free unknowns.
    gap : scipy.sparse.csr_array, shape (3 m, n)
        G.
    area : ndarray, shape (3 m,)
        Area of each gap component, m2.
    """

    factor: Factor
    operators: ElasticOperators
    gap: csr_array
    area: Array

    def solve(self, temperature: Array, remainder: Array, forces: Array | None = None) -> Array:
        """Displacement, shape (n,), of a temperature field and the joint law's remainder (3 m,).

        `forces` (n,), N, are those of mechanical loads.
        """
        load = self.operators.thermal_load @ temperature + self.gap.T @ (self.area * remainder)
        if forces is not None:
            load = load + forces
        free = self.operators.free
        displacement = np.zeros(self.operators.stiffness.shape[0])
        displacement[free] = self.factor.solve(load[free])
        return displacement


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
    """Return A0 (n, n) and the right-hand sides (n, k) with the held unknowns taken out.

    Their rows say that they have their given temperature; what they send to their neighbours is on
    the right-hand side. So the matrix stays symmetric.
    """
    system = csr_array(heat.capacity / step + heat.conduction + heat.convection)
    free = _free_unknowns(heat)
    inputs = free[:, None] * (heat.inputs - system[:, heat.held] @ heat.held_inputs)
    inputs[heat.held] = heat.held_inputs
    keep = diags_array(free)
    return csr_array(keep @ system @ keep + diags_array(1.0 - free)), inputs


def heat_sums(heat: HeatOperators, joints: JointOperators, step: float) -> HeatBalance:
    """Return what closes the books of a step of length `step` (s)."""
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
    field = displacement_field(elastic, joints, reference, solver)
    return condense_field(field, reference, probes), field


def displacement_field(
    elastic: ElasticOperators, joints: JointOperators, reference: Array, solver: str | None = None
) -> DisplacementField:
    """Factorise the elastic structure with its reference springs; as for `condense_elasticity`."""
    free = elastic.free
    gap = csr_array(joints.gap[:, free])
    area = np.tile(joints.area, 3)
    springs = gap.T @ diags_array(area * reference) @ gap
    factor = factorise(elastic.stiffness[free][:, free] + springs, "stiffness", solver)
    return DisplacementField(factor, elastic, joints.gap, area)


def condense_field(
    field: DisplacementField, reference: Array, probes: csr_array
) -> ElasticCondensation:
    """Condense the factorised structure on the joints; as for `condense_elasticity`."""
    elastic = field.operators
    gap, rows = csr_array(field.gap[:, elastic.free]), probes[:, elastic.free]
    outputs = np.vstack([gap.toarray(), rows.toarray()])
    influence = checked_solve(field.factor, outputs.T, "elastic condensation")
    load = elastic.thermal_load[elastic.free]
    thermal = (load.T @ influence).T
    count = gap.shape[0]
    joint_influence = influence[:, :count]
    compliance = gap @ joint_influence
    return ElasticCondensation(
        # Symmetric by reciprocity; rounding is taken out so that it is symmetric to the last bit.
        compliance=0.5 * (compliance + compliance.T),
        thermal_gap=np.ascontiguousarray(thermal[:count]),
        probe_compliance=rows @ joint_influence,
        probe_thermal=np.ascontiguousarray(thermal[count:]),
        reference=reference,
        area=field.area,
    )


def condense_loads(field: DisplacementField, forces: Array, probes: csr_array) -> LoadInfluence:
    """Condense mechanical loads on the joints by the same factor.

    Parameters
    ----------
    field : DisplacementField
        The factorised structure.
    forces : ndarray, shape (n, l)
        `fesim.solid.forces.nodal_forces`.
    probes : scipy.sparse array, shape (k, n)
        Rows that give each probed displacement.
    """
    free = field.operators.free
    moved = checked_solve(field.factor, np.ascontiguousarray(forces[free]), "mechanical loads")
    return LoadInfluence(field.gap[:, free] @ moved, probes[:, free] @ moved)
