"""Elastic structure of a case, factorised as a whole if needed repeatedly, else piece by piece."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from fesim.setup.laws import element_means
from fesim.solid.condensation import DisplacementField, displacement_field
from fesim.solid.elasticity import ElasticPiece
from fesim.solid.joint_operators import JointOperators
from fesim.solid.materials import Material, by_cell
from fesim.solid.substructures import (
    FactorisedStructure,
    Substructure,
    TieCondensation,
    factorised_structure,
    substructures,
    tied,
    untied,
)
from meshes.pairing import PairedJoint
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class ElasticStructure:
    """Pieces of a case and the springs across its joints."""

    #: Assembles the pieces one after the other.
    pieces: Callable[[], Iterator[ElasticPiece]]
    #: Gap rows G and areas.
    joints: JointOperators
    #: Shape (3 m,): stiffness of the reference springs, Pa/m.
    reference: Array
    #: Numbers of displacement and temperature unknowns.
    shape: tuple[int, int]
    #: See `fesim.solid.linear_solver.factorise`.
    solver: str | None

    @property
    def springs(self) -> Array:
        """Reference springs (3 m,), N/m."""
        return self.reference * np.tile(self.joints.area, 3)

    @cached_property
    def factorised(self) -> FactorisedStructure:
        """All pieces at once."""
        return factorised_structure(
            self.pieces(), self.joints.gap, self.springs, self.shape, self.solver
        )

    def one_by_one(self) -> Iterator[Substructure]:
        """Yield the pieces, factorised one after the other and not stored."""
        return substructures(self.pieces(), self.joints.gap, self.springs, self.solver)

    def condense(self, each: Iterable[Substructure], probes: csr_array) -> TieCondensation:
        """Condense the pieces on joints and displacement probes (k, n)."""
        return tied(untied(each, self.joints.gap, self.springs, probes, self.shape[1]))

    def field(self, condensed: TieCondensation) -> DisplacementField:
        """Return full displacements on demand."""
        return displacement_field(self.factorised, condensed, self.joints)


def reference_springs(
    structure: Structure, materials: dict[str, Material], joints: Sequence[PairedJoint]
) -> Array:
    """Reference springs (3 m,) as stiff as the softer body behind a contact element, Pa/m.

    They do not depend on the joint's law, so that one condensation serves every law. Their modulus
    is the harmonic mean of the two: with much stiffer springs, rounding would hide the compliance.
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
