"""Condensed machine with the modes of the reduced thermal model.

T = V a + E u with the modes V on the free unknowns and the held surfaces E, whose temperatures are
inputs. Every operator of the march is multiplied by [V, E] once; the march is the same.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, diags_array

from fesim.one_thread import one_dense_thread
from fesim.solid.condensation import (
    ElasticCondensation,
    ThermalCondensation,
    eliminate_held,
    heat_sums,
)
from fesim.solid.heat import HeatOperators
from fesim.solid.joint_operators import JointOperators
from fesim.solid.linear_solver import Factor
from fesim.solid.reduction import HeatSystem, ReducedHeat, reduce_heat
from thermojoint.artefacts.arrays import Array

#: Typical inputs of a march: total heat, W; ambient and held surfaces, K.
USUAL_POWER, USUAL_RISE = 1000.0, 10.0
#: Tolerances at these inputs: temperature, K; gap, m; displacement, m.
TEMPERATURE_ERROR, GAP_ERROR, DISPLACEMENT_ERROR = 2e-4, 1e-10, 4e-10
#: Times that the reduced model resolves, s: at least a step of this length, and the steady state.
SHORTEST, LONGEST = 1.0, 1e6
#: Up to this many contact elements, dense products are cheaper than the sparse factors.
FEW = 200

#: Arguments: the heat equation, and the shortest and longest time of interest, s.
Reduce = Callable[[HeatSystem, float, float], ReducedHeat]


@dataclass(frozen=True)
class ThermalModes:
    """Modes of a reduced temperature field."""

    #: Shape (n, r + s): [V, E]: nodal temperatures of each mode, then of each of the s held
    #: surfaces at 1 K.
    basis: Array
    #: Shape (r,): decay rates of the modes, 1/s.
    rates: Array
    #: Largest error of an output, relative to its tolerance.
    error: float

    @property
    def digest(self) -> str:
        """Digest of the basis: amplitudes are meaningful with the same basis only."""
        return hashlib.sha256(np.ascontiguousarray(self.basis).tobytes()).hexdigest()


def thermal_modes(
    heat: HeatOperators,
    joints: JointOperators,
    outputs: Array,
    step: float,
    reduce: Reduce = reduce_heat,
    start: Array | None = None,
) -> ThermalModes:
    """Find the modes that the joints, gaps and probes of a march need.

    Parameters
    ----------
    heat : HeatOperators
    joints : JointOperators
    outputs : ndarray, shape (q, n)
        Outputs of the temperatures other than the joints' jumps, by `outputs_of`.
    step : float
        Time step, s.
    reduce : callable, optional
        Reduces the heat equation: `reduce_heat`, or `reduce_apart` with other modes.
    start : ndarray, shape (n,), optional
        Initial nodal temperatures, K; a field smaller than `USUAL_RISE` is scaled up to it.

    Raises
    ------
    ConvergenceError
        The error cannot be reduced to the tolerance.
    """
    size = heat.inputs.shape[0]
    free = np.setdiff1d(np.arange(size), heat.held)
    system = csr_array(heat.conduction + heat.convection)
    surfaces = _held_surfaces(heat)
    usual = np.full(heat.inputs.shape[1], USUAL_POWER)
    usual[heat.layout.temperature_columns] = USUAL_RISE
    drives = usual * (heat.inputs - system[:, heat.held] @ heat.held_inputs)
    flows = USUAL_POWER / max(len(joints.area), 1) * joints.jump.toarray().T
    outputs = np.vstack([joints.jump.toarray() / TEMPERATURE_ERROR, outputs])
    reduced = HeatSystem(
        heat.capacity.diagonal()[free],
        csr_array(system[free][:, free]),
        np.hstack([drives, flows])[free],
        outputs[:, free],
        np.empty((free.size, 0)) if start is None else _usual_field(start[free]),
    )
    with one_dense_thread() if len(joints.area) <= FEW else nullcontext():
        reduction = reduce(reduced, shortest(step), LONGEST)
    basis = np.zeros((size, reduction.rates.size + surfaces.shape[1]))
    basis[free, : reduction.rates.size] = reduction.basis
    basis[:, reduction.rates.size :] = surfaces
    return ThermalModes(basis, reduction.rates, reduction.error)


def outputs_of(elastic: ElasticCondensation, probes: csr_array) -> Array:
    """Return probes (p, n), gaps and displacements as rows of the temperatures, shape (q, n).

    Each row is divided by its tolerance.
    """
    return np.vstack(
        [
            probes.toarray() / TEMPERATURE_ERROR,
            elastic.thermal_gap / GAP_ERROR,
            elastic.probe_thermal / DISPLACEMENT_ERROR,
        ]
    )


def shortest(step: float) -> float:
    """Return the shortest time (s) that the modes of a march with some step (s) resolve."""
    return min(step, SHORTEST)


def project_heat(
    heat: HeatOperators, joints: JointOperators, step: float, modes: ThermalModes
) -> ThermalCondensation:
    """Return one implicit Euler step of length `step` (s) on the modes, which is diagonal."""
    _, inputs = eliminate_held(heat, step)
    sums = heat_sums(heat, joints, step)
    count = modes.rates.size
    held = heat.layout.held
    diagonal = np.concatenate([1.0 / step + modes.rates, np.ones(held)])
    jump = joints.jump @ modes.basis
    influence, joint_influence = _influences(
        jump, np.append(1.0 / diagonal[:count], np.zeros(held))
    )
    projected = np.vstack([modes.basis[:, :count].T @ inputs, np.zeros((held, inputs.shape[1]))])
    # A held surface's amplitude is its input.
    projected[count:, heat.layout.held_columns] = np.eye(held)
    return ThermalCondensation(
        factor=diagonal_factor(diagonal),
        capacity_rate=diags_array(
            np.concatenate([np.full(count, 1.0 / step), np.zeros(held)]), format="csr"
        ),
        inputs=projected,
        jump=jump,
        mean=joints.mean @ modes.basis,
        influence=influence,
        joint_influence=joint_influence,
        balance=replace(
            sums,
            stored=sums.stored @ modes.basis,
            convected=sums.convected @ modes.basis,
            after=sums.after @ modes.basis,
            before=sums.before @ modes.basis,
        ),
        step=step,
        model=modes.digest,
    )


def project_elasticity(elastic: ElasticCondensation, modes: ThermalModes) -> ElasticCondensation:
    """Return gaps and probes as functions of the modes."""
    return replace(
        elastic,
        thermal_gap=elastic.thermal_gap @ modes.basis,
        probe_thermal=elastic.probe_thermal @ modes.basis,
    )


def project_start(heat: HeatOperators, modes: ThermalModes, start: Array) -> Array:
    """Return the amplitudes (r + s,) of nodal temperatures (n,), K; those of held surfaces zero.

    V^T M T0: the modes are orthonormal in the heat capacity, and contain T0 by construction.
    """
    count = modes.rates.size
    amplitudes = np.zeros(modes.basis.shape[1])
    # The modes are zero where temperatures are held.
    amplitudes[:count] = modes.basis[:, :count].T @ (heat.capacity.diagonal() * start)
    return amplitudes


def _usual_field(start: Array) -> Array:
    """The field, shape (n, 1), of the size of `USUAL_RISE` or more; none if it is zero."""
    largest = float(np.abs(start).max(initial=0.0))
    if not largest:
        return np.empty((len(start), 0))
    return max(1.0, USUAL_RISE / largest) * start[:, None]


def _held_surfaces(heat: HeatOperators) -> Array:
    """Nodal temperatures of each held surface at 1 K, shape (n, s)."""
    surfaces = np.zeros((heat.inputs.shape[0], heat.layout.held))
    surfaces[heat.held] = heat.held_inputs[:, heat.layout.held_columns]
    return surfaces


def at_step(thermal: ThermalCondensation, step: float) -> ThermalCondensation:
    """Return the heat step of another length on the same modes, as `project_heat` would.

    Parameters
    ----------
    thermal : ThermalCondensation
        Result of `project_heat`.
    step : float
        Length of the step, s.
    """
    rate, ratio = thermal.capacity_rate.diagonal(), thermal.step / step
    diagonal = thermal.factor.matrix.diagonal() + (ratio - 1.0) * rate
    sums = thermal.balance
    after = sums.after + (ratio - 1.0) * sums.before
    return replace(
        with_diagonal(thermal, diagonal, ratio * rate),
        balance=replace(sums, after=after, before=ratio * sums.before),
        step=step,
    )


def with_diagonal(
    thermal: ThermalCondensation, diagonal: Array, kept: Array
) -> ThermalCondensation:
    """Return a heat step on the modes with another diagonal of A0, as for another length.

    Parameters
    ----------
    thermal : ThermalCondensation
        Result of `project_heat`.
    diagonal, kept : ndarray, shape (r + s,)
        Diagonals of A0, and of the factor of the unknowns at the start of the step; the latter is
        zero for held ones.
    """
    influence, joint_influence = _influences(np.asarray(thermal.jump), (kept > 0.0) / diagonal)
    return replace(
        thermal,
        factor=diagonal_factor(diagonal),
        capacity_rate=diags_array(kept, format="csr"),
        influence=influence,
        joint_influence=joint_influence,
    )


def _influences(jump: Array, weights: Array) -> tuple[Array, Array]:
    """W (r + s, m) and S (m, m) from jumps B (m, r + s) and the inverse of A0, zero if held."""
    # A product with its own transpose takes half as long as one with another matrix.
    half = jump * np.sqrt(weights)
    return np.multiply(jump.T, weights[:, None], order="C"), half @ half.T


def diagonal_factor(diagonal: Array) -> Factor:
    """Return the factorisation of a diagonal matrix, given by its diagonal (n,)."""
    inverse = 1.0 / diagonal

    def solve(right_side: Array) -> Array:
        return (right_side.T * inverse).T

    return Factor(diags_array(diagonal, format="csr"), solve, "diagonal")
