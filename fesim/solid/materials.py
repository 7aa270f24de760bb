"""Materials: linear, isotropic, constant; their properties in the cells of a structure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Material:
    """Properties of one material, SI."""

    #: k, W/(m K).
    conductivity: float
    #: rho, kg/m3.
    density: float
    #: c_p, J/(kg K).
    heat_capacity: float
    #: E, Pa.
    youngs_modulus: float
    #: nu, between -1 and 0.5.
    poisson_ratio: float
    #: Coefficient of linear thermal expansion, 1/K; may be zero.
    expansion: float

    def __post_init__(self) -> None:
        """Refuse unphysical values."""
        for name in ("conductivity", "density", "heat_capacity", "youngs_modulus"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"material: {name} is {value}; give a positive number in SI units")
        if not -1.0 < self.poisson_ratio < 0.5:
            raise InputError(
                f"material: poisson_ratio is {self.poisson_ratio}; it lies between -1 and 0.5"
            )
        if not np.isfinite(self.expansion):
            raise InputError(f"material: expansion is {self.expansion}; give a number in 1/K")

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé's lambda and mu, Pa."""
        e, nu = self.youngs_modulus, self.poisson_ratio
        return e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))


def by_cell(structure: Structure, values: dict[str, float]) -> Array:
    """Value of each cell's body, shape (cells,)."""
    cell_values = np.empty(structure.mesh.nelements)
    for name, cells in structure.bodies.items():
        cell_values[cells] = values[name]
    return cell_values


def elastic_constants(
    structure: Structure, materials: dict[str, Material]
) -> tuple[Array, Array, Array]:
    """Lamé's lambda and mu, Pa, and (3 lambda + 2 mu) alpha, Pa/K, of all cells, (cells,) each."""
    lame, shear = (
        by_cell(structure, {name: m.lame[i] for name, m in materials.items()}) for i in (0, 1)
    )
    expansion = by_cell(structure, {name: m.expansion for name, m in materials.items()})
    return lame, shear, (3.0 * lame + 2.0 * shear) * expansion
