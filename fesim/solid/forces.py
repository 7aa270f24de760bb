"""Nodal forces of mechanical loads: surface tractions and weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from skfem import CellBasis, DiscreteField, LinearForm
from skfem.assembly.form.form import FormExtraParams

from fesim.solid.heat import cell_field, flux_form, surface_basis, weighted_flux_form
from fesim.solid.materials import Material
from fesim.solid.spaces import Spaces
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class SurfaceForce:
    """A force distributed uniformly over a surface."""

    #: Surface on which it acts.
    surface: str
    #: Force on the meshed part, N.
    force: Vector


@dataclass(frozen=True)
class SurfacePressure:
    """A pressure on a surface, against its outward normal."""

    #: Surface on which it acts.
    surface: str
    #: Pressure, Pa.
    pressure: float


@dataclass(frozen=True)
class BodyForce:
    """The weight of bodies, or their inertial force."""

    #: Bodies on which it acts.
    bodies: tuple[str, ...]
    #: Acceleration, m/s2: (0, 0, -9.81) is gravity if z points up.
    acceleration: Vector


Load = SurfaceForce | SurfacePressure | BodyForce


@LinearForm
def pressure_form(v: DiscreteField, w: FormExtraParams) -> Array:
    """Force of a unit pressure along direction i: (-n_i, v)."""
    return -w.n[w["i"]] * v


def nodal_forces(
    structure: Structure, spaces: Spaces, materials: dict[str, Material], loads: Sequence[Load]
) -> Array:
    """Return the nodal forces (n, l) of l loads at factor one, N; unknown 3 i + c is direction c.

    Of the bodies' materials, only the densities are used.
    """
    nodal = np.zeros((spaces.displacement_size, len(loads)))
    for column, load in enumerate(loads):
        for i, part in enumerate(_by_direction(structure, spaces.elastic, materials, load)):
            nodal[i::3, column] = part
    return nodal


def _by_direction(
    structure: Structure, basis: CellBasis, materials: dict[str, Material], load: Load
) -> list[Array]:
    if isinstance(load, SurfaceForce):
        spread = flux_form.assemble(surface_basis(structure, basis, load.surface))
        return [component * spread / spread.sum() for component in load.force]
    if isinstance(load, SurfacePressure):
        on = surface_basis(structure, basis, load.surface)
        return [load.pressure * pressure_form.assemble(on, i=i) for i in range(3)]
    density = {name: m.density if name in load.bodies else 0.0 for name, m in materials.items()}
    mass = weighted_flux_form.assemble(basis, value=cell_field(structure, density, basis))
    return [component * mass for component in load.acceleration]
