"""Bolts as springs between two places of a structure, part of its condensation (docs/bolts.md).

A bolt's ends move apart by e = Q u, the mean displacement of its head minus that of its thread
along its axis. The bolt force is f = F + k_b (e - e_0 - alpha L T_b), with nodal forces -Q^T f.
With the elongation due to joints, heat and loads only, e_free = e + C_bb f, this is
f = D (F / k_b - e_0 + e_free - alpha L T_b), D = (1/k_b + C_bb)^-1. The system remains linear, and
gaps and probes change by those of unit bolt forces times f. Only D is factorised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, kron, vstack
from skfem import CellBasis

from fesim.solid.condensation import ElasticCondensation, LoadInfluence
from fesim.solid.outputs import MechanicalOutputs
from fesim.solid.spaces import interpolation
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class Patch:
    """Contact area of a bolt's end: points that share its force."""

    #: Shape (3, q): positions, m.
    points: Array
    #: Shape (q,): cell of each point.
    cells: NDArray[np.int64]
    #: Shape (q,): share of each point; together 1.
    weights: Array

    @property
    def centre(self) -> Array:
        """Point of action of the force, m, shape (3,)."""
        return self.points @ self.weights

    def mean(self, basis: CellBasis) -> csr_array:
        """Row (1, n) of the mean of a scalar field."""
        rows = np.zeros(len(self.weights), dtype=np.int64)
        return interpolation(basis, self.points, self.cells, rows, self.weights, 1)


@dataclass(frozen=True)
class Bolt:
    """A bolt."""

    #: Its ends.
    head: Patch
    thread: Patch
    #: Unit vector from thread to head, shape (3,).
    axis: Array
    #: k_b, N/m.
    stiffness: float
    #: alpha L: free elongation per K of its mean temperature, m/K.
    growth: float


@dataclass(frozen=True)
class BoltSprings:
    """Spring constants of b bolts."""

    #: Shape (b,): 1/k_b, m/N.
    flexibility: Array
    #: Shape (b, n): free elongation of each per K of nodal temperature, or per amplitude of a
    #: reduced model, m.
    growth: Array


def stretch_rows(basis: CellBasis, bolts: Sequence[Bolt]) -> csr_array:
    """Return Q (b, n): elongation of each bolt per displacement; unknown 3 i + c: direction c."""
    rows = [
        kron(bolt.head.mean(basis) - bolt.thread.mean(basis), bolt.axis[None, :]) for bolt in bolts
    ]
    return csr_array(vstack([csr_array((0, 3 * int(basis.N))), *rows]))


def temperature_rows(basis: CellBasis, bolts: Sequence[Bolt]) -> csr_array:
    """Return rows (b, n) of the mean temperature of both ends of each bolt."""
    rows = [0.5 * (bolt.head.mean(basis) + bolt.thread.mean(basis)) for bolt in bolts]
    return csr_array(vstack([csr_array((0, int(basis.N))), *rows]))


def bolt_springs(bolts: Sequence[Bolt], means: Array) -> BoltSprings:
    """Return b bolts as springs.

    `means` (b, n) are their `temperature_rows`, or those times the basis of a reduced model.
    """
    flexibility = np.array([1.0 / bolt.stiffness for bolt in bolts])
    growth = np.array([[bolt.growth] for bolt in bolts])
    return BoltSprings(flexibility, growth * means)


def fastened(
    elastic: ElasticCondensation,
    loads: LoadInfluence,
    springs: BoltSprings,
    start: Array,
) -> tuple[ElasticCondensation, LoadInfluence, MechanicalOutputs]:
    """Add b bolts to a condensation.

    Parameters
    ----------
    elastic : ElasticCondensation
        Condensation without bolts; its last b probes are the bolts' `stretch_rows`.
    loads : LoadInfluence
        Its last b columns are unit forces of the bolts.
    springs : BoltSprings
        Spring constants.
    start : ndarray, shape (k + b,)
        Values of the probes of `elastic` after tightening, m: the reference of displacements and
        stretches.

    Returns
    -------
    tuple of ElasticCondensation, LoadInfluence, MechanicalOutputs
        Condensation with k probes; influence of the loads, of the prescribed bolt forces (N), and
        of a last factor that is always 1, the reference state; bolt forces as functions of a step.
    """
    bolts = springs.flexibility.size
    probes, given = len(start) - bolts, loads.gap.shape[1] - bolts
    apart = -loads.probes[probes:, given:]
    stiffness = np.linalg.inv(np.diag(springs.flexibility) + 0.5 * (apart + apart.T))
    by_force = stiffness @ elastic.probe_compliance[probes:]
    by_heat = stiffness @ (elastic.probe_thermal[probes:] - springs.growth)
    by_length = np.hstack(
        [loads.probes[probes:, :given], np.diag(springs.flexibility), -start[probes:, None]]
    )
    by_factor = np.asarray(stiffness @ by_length, dtype=np.float64)
    pulled, moved = loads.gap[:, given:], loads.probes[:probes, given:]
    compliance = elastic.compliance + pulled @ by_force
    counted = np.hstack(
        [loads.probes[:probes, :given], np.zeros((probes, bolts)), -start[:probes, None]]
    )
    return (
        ElasticCondensation(
            compliance=0.5 * (compliance + compliance.T),
            thermal_gap=elastic.thermal_gap + pulled @ by_heat,
            probe_compliance=elastic.probe_compliance[:probes] + moved @ by_force,
            probe_thermal=elastic.probe_thermal[:probes] + moved @ by_heat,
            reference=elastic.reference,
            area=elastic.area,
        ),
        LoadInfluence(
            gap=np.pad(loads.gap[:, :given], ((0, 0), (0, bolts + 1))) + pulled @ by_factor,
            probes=counted + moved @ by_factor,
        ),
        MechanicalOutputs(by_heat, by_force * elastic.area, by_factor),
    )
