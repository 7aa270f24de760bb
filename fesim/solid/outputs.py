"""Reactions and stresses at points, condensed as linear functions of the state of a step.

An output is o = c_u u + c_T T + c_z r + c_f phi with displacement u, temperature T, the joints'
remainder r = z + k g and load factors phi. With the adjoint y = Kr^-1 c_u of each output, solved
once, no displacement field is needed: o = (c_T + y F) T + (c_z + y G^T A) r + (c_f + y f) phi.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, vstack

from fesim.solid.condensation import DisplacementField
from fesim.solid.heat import convection_form, surface_basis
from fesim.solid.spaces import Spaces
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class OutputRows:
    """c_u, c_T, c_z and c_f of o outputs, side by side."""

    #: Shape (o, n).
    displacement: csr_array
    #: Shape (o, n_heat).
    temperature: csr_array
    #: Shape (o, 3 m).
    remainder: Array
    #: Shape (o, l).
    loads: Array


@dataclass(frozen=True)
class MechanicalOutputs:
    """Outputs as linear functions of a step."""

    #: Shape (o, n): per K, or per amplitude of a reduced model.
    temperature: Array
    #: Shape (o, 3 m): per Pa.
    remainder: Array
    #: Shape (o, l): per unit of each load factor.
    loads: Array

    def of(self, temperature: Array, remainder: Array, factors: Array) -> Array:
        """Return the outputs (o,) of a step."""
        outputs = self.temperature @ temperature + self.remainder @ remainder
        return np.asarray(outputs + self.loads @ factors)


def condense_outputs(
    field: DisplacementField, rows: OutputRows, forces: Array
) -> MechanicalOutputs:
    """Solve the adjoints of outputs; `forces` (n, l) are the nodal forces of the loads, N."""
    adjoint = field.respond(rows.displacement.toarray().T, "mechanical outputs")
    load = field.structure.thermal_load
    return MechanicalOutputs(
        temperature=(load.T @ adjoint).T + rows.temperature.toarray(),
        remainder=(field.gap @ adjoint).T * field.area + rows.remainder,
        loads=adjoint.T @ forces + rows.loads,
    )


def stacked(rows: Sequence[OutputRows]) -> OutputRows:
    """Stack the rows of several outputs."""
    return OutputRows(
        csr_array(vstack([row.displacement for row in rows])),
        csr_array(vstack([row.temperature for row in rows])),
        np.vstack([row.remainder for row in rows]),
        np.vstack([row.loads for row in rows]),
    )


class Supports(NamedTuple):
    """Supported surfaces."""

    #: Surfaces and their constrained directions; unknowns on two of them belong to the first.
    held: Sequence[tuple[str, Sequence[int]]]
    #: Surfaces and the stiffness of the springs under them along x, y and z, N/m.
    springs: Sequence[tuple[str, tuple[float, float, float]]]


def reaction_rows(
    structure: Structure,
    spaces: Spaces,
    field: DisplacementField,
    reference: Array,
    forces: Array,
    supports: Supports,
) -> OutputRows:
    """Rows of the reactions of supports on the structure, N: x, y and z of each.

    The reaction is the residual of equilibrium, K u - F T - f phi - G^T A z, at a constrained
    unknown.

    Parameters
    ----------
    structure, spaces
        Mesh and spaces.
    field : DisplacementField
        The factorised structure.
    reference : ndarray, shape (3 m,)
        Stiffness of the reference springs, Pa/m.
    forces : ndarray, shape (n, l)
        Nodal forces of the loads, N.
    supports : Supports
        Supports; the held ones come first.
    """
    held = supports.held
    size = spaces.displacement_size
    chosen = np.zeros((3 * len(held), size))
    taken = np.zeros(size, dtype=bool)
    for k, (name, directions) in enumerate(held):
        dofs: NDArray[np.int64] = spaces.displacement.get_dofs(
            structure.surface(name, "supports")
        ).all()
        for i in directions:
            own = 3 * dofs + i
            chosen[3 * k + i, own[~taken[own]]] = 1.0
            taken[own] = True
    sums = csr_array(chosen)
    lacking = sums @ field.gap.T @ diags_array(field.area)
    known = field.structure
    # z is the remainder minus the forces of the reference springs.
    fixed = OutputRows(
        csr_array(sums @ known.held_stiffness + lacking @ diags_array(reference) @ field.gap),
        csr_array(-(sums @ known.thermal_load)),
        -lacking.toarray(),
        -(sums @ forces),
    )
    return stacked([fixed, _spring_rows(structure, spaces, fixed, supports.springs)])


def _spring_rows(
    structure: Structure,
    spaces: Spaces,
    like: OutputRows,
    springs: Sequence[tuple[str, tuple[float, float, float]]],
) -> OutputRows:
    rows = np.zeros((3 * len(springs), spaces.displacement_size))
    for k, (name, stiffness) in enumerate(springs):
        bed = csr_array(
            convection_form.assemble(surface_basis(structure, spaces.displacement, name))
        )
        share = np.asarray(bed.sum(axis=0)).ravel() / bed.sum()
        for i in range(3):
            rows[3 * k + i, i::3] = -stiffness[i] * share
    return _on_displacements(csr_array(rows), like)


def _on_displacements(rows: csr_array, like: OutputRows) -> OutputRows:
    """Rows that depend on displacements only, with the widths of `like`."""
    count = rows.shape[0]
    return OutputRows(
        rows,
        csr_array((count, like.temperature.shape[1])),
        np.zeros((count, like.remainder.shape[1])),
        np.zeros((count, like.loads.shape[1])),
    )


def with_stresses(reactions: OutputRows, moved: csr_array, heated: csr_array) -> OutputRows:
    """Add rows of stresses (`fesim.solid.stress.stress_rows`) below those of reactions."""
    return stacked([reactions, replace(_on_displacements(moved, reactions), temperature=heated)])
