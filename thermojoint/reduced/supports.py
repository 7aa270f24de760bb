"""Elastic operators of a machine whose fixed supports give way, for any stiffness of the supports.

On springs, a surface s that the case fixes has displacements u = B v. With Psi the displacements of
the whole machine that these cause (static modes; Craig and Bampton 1968), G the gaps, D the probes
and F the loads of temperatures, its operators are those of the fixed machine plus one term each:

    C = C0 + G Psi Q (G Psi)^T,    S_T = S_T0 + G Psi Q Psi^T F,
    Q = (Psi^T K Psi + sum k_s M_s)^-1,

and likewise with D; k_s is the stiffness of the springs and M_s that of springs of 1 N/m in B. This
is exact if B spans all displacements of the surfaces. Here it has polynomials of degree `DEGREE`,
so that the number of solves does not depend on the mesh; the error is in docs/joint-aware.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fesim.case.schema import Case
from fesim.setup.discretised import displacement_rows
from fesim.setup.machine import Setup
from fesim.solid.condensation import ElasticCondensation
from fesim.solid.elasticity import DIRECTIONS, beds_under, held_unknowns
from thermojoint.artefacts.arrays import Array, Flags

#: Degree of the polynomials, and singular values of them that are rounding.
DEGREE, ROUNDING = 8, 1e-9
#: N/m of springs that give way by 1 um/kN.
STIFFNESS = 1e9


@dataclass(frozen=True, eq=False)
class Supports:
    """s fixed supports, as springs on b modes of their surfaces."""

    #: Of the surfaces.
    names: tuple[str, ...]
    #: With the supports fixed.
    fixed: ElasticCondensation
    #: Shape (b, b): Psi^T K Psi, N/m.
    stiffness: Array
    #: Shape (s, b, b): of the springs of each surface at 1 um/kN, N/m.
    beds: Array
    #: Shape (3 m, b), (k, b): gaps and probes of the modes, m/m.
    gap: Array
    probes: Array
    #: Shape (b, r): Psi^T F on the machine's modes, N/K.
    heat: Array

    def elastic(self, gives: Sequence[float]) -> ElasticCondensation:
        """Return the operators of the machine with supports that give way, um/kN, (s,)."""
        springs = np.tensordot(1.0 / np.asarray(gives), self.beds, axes=1)
        factor = cho_factor(self.stiffness + springs)
        by_force, by_heat = cho_solve(factor, self.gap.T), cho_solve(factor, self.heat)
        return replace(
            self.fixed,
            compliance=self.fixed.compliance + self.gap @ by_force,
            thermal_gap=self.fixed.thermal_gap + self.gap @ by_heat,
            probe_compliance=self.fixed.probe_compliance + self.probes @ by_force,
            probe_thermal=self.fixed.probe_thermal + self.probes @ by_heat,
        )

    def with_probes(self, probes: Sequence[int]) -> Supports:
        """Return the supports with some of the probes."""
        fixed = self.fixed.with_probes(probes)
        return replace(self, fixed=fixed, probes=self.probes[probes])


def supports_of(case: Case, setup: Setup) -> Supports:
    """Return the fixed supports of a case without loads, bolts and axes, on its set-up's modes.

    Raises
    ------
    ConvergenceError
        A solve left a residual.
    """
    assert setup.modes is not None  # reduce_machine needs them
    structure, spaces, field = setup.structure, setup.spaces, setup.field
    names = tuple(case.supports.fixed)
    kept = np.ones(spaces.displacement_size, dtype=bool)
    kept[held_unknowns(structure, spaces, list(case.walls), dict(case.supports.symmetry))] = False
    own = np.hstack([_polynomials(setup, name, kept) for name in names])
    stiffness, reference = field.structure.held_stiffness, setup.machine.contact.elastic
    ties = (reference.area * reference.reference)[:, None]
    moved = field.gap @ own
    forces = stiffness.T @ own + field.gap.T @ (ties * moved)
    modes = own - field.respond(forces, "give of the supports")
    gap = field.gap @ modes
    reaction = own.T @ (stiffness @ modes) + moved.T @ (ties * gap)
    one = STIFFNESS / structure.symmetry_factor
    beds = [beds_under(structure, spaces, {name: (one, one, one)}) for name in names]
    return Supports(
        names,
        reference,
        0.5 * (reaction + reaction.T),
        np.array([own.T @ (bed @ own) for bed in beds]),
        gap,
        displacement_rows(case, structure, spaces) @ modes,
        (field.structure.thermal_load.T @ modes).T @ setup.modes.basis,
    )


def _polynomials(setup: Setup, name: str, kept: Flags) -> Array:
    """Orthonormal displacements (n, b) of a surface, polynomials where unknowns are `kept`."""
    displacement = setup.spaces.displacement
    nodes = displacement.get_dofs(setup.structure.surface(name, "supports")).all()
    places = displacement.doflocs[:, nodes]
    places = places - places.mean(axis=1, keepdims=True)
    places = places / np.abs(places).max()
    powers = np.array([p for p in product(range(DEGREE + 1), repeat=3) if sum(p) <= DEGREE])
    values = np.prod(places.T[:, None, :] ** powers, axis=2)
    columns = []
    for direction in range(len(DIRECTIONS)):
        unknowns = len(DIRECTIONS) * nodes + direction
        basis, sizes, _ = np.linalg.svd(kept[unknowns, None] * values, full_matrices=False)
        basis = basis[:, sizes > ROUNDING * sizes[0]]
        columns.append(np.zeros((kept.size, basis.shape[1])))
        columns[-1][unknowns] = basis
    return np.hstack(columns)
