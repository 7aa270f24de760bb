"""Heat operators: capacity, conduction, convection and sources. Temperatures are above ambient."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array
from skfem import BilinearForm, CellBasis, DiscreteField, FacetBasis, LinearForm
from skfem.assembly.form.form import FormExtraParams
from skfem.helpers import dot, grad

from fesim.materials import Material
from meshes.structure import Structure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeatOperators:
    """Semi-discrete heat equation M dT/dt + (K + H) T = b q(t), joints not included.

    Attributes
    ----------
    capacity, conduction, convection : scipy.sparse.csr_array, shape (n, n)
        M (J/K, lumped), K and H (W/K).
    source : ndarray, shape (n,)
        b: nodal heat at heat input 1, W.
    """

    capacity: csr_array
    conduction: csr_array
    convection: csr_array
    source: Array


@BilinearForm
def capacity_form(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> Array:
    """Heat stored: (rho c_p u, v)."""
    return w["value"] * u * v


@BilinearForm
def conduction_form(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> Array:
    """Fourier's law: (k grad u, grad v)."""
    return w["value"] * dot(grad(u), grad(v))


@BilinearForm
def film_form(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> Array:
    """Newton's law of cooling: (h u, v) on a surface."""
    return u * v


@LinearForm
def flux_form(v: DiscreteField, w: FormExtraParams) -> Array:
    """A uniform heat flux into a surface."""
    return 1.0 * v


def cell_field(structure: Structure, values: dict[str, float], basis: CellBasis) -> DiscreteField:
    """Field that is constant on each body, on the quadrature points of `basis`."""
    by_cell = np.empty(structure.mesh.nelements)
    for name, cells in structure.bodies.items():
        by_cell[cells] = values[name]
    return DiscreteField(np.broadcast_to(by_cell[:, None], basis.dx.shape))


def heat_operators(
    structure: Structure,
    basis: CellBasis,
    materials: dict[str, Material],
    films: dict[str, float],
    sources: dict[str, float],
) -> HeatOperators:
    """Assemble the heat operators.

    Parameters
    ----------
    structure : Structure
        Mesh and names.
    basis : skfem.CellBasis
        Temperature space.
    materials : dict
        Body name to its material.
    films : dict
        Surface name to its heat transfer coefficient, W/(m2 K).
    sources : dict
        Surface name to the heat that enters the meshed part through it at heat input 1, W; spread
        evenly over the surface.
    """
    stored = {name: m.density * m.heat_capacity for name, m in materials.items()}
    conducted = {name: m.conductivity for name, m in materials.items()}
    consistent = capacity_form.assemble(basis, value=cell_field(structure, stored, basis))
    # Lumped: a consistent capacity lets temperatures next to a sudden source undershoot ambient.
    capacity = diags_array(np.asarray(consistent.sum(axis=1)).ravel(), format="csr")
    conduction = conduction_form.assemble(basis, value=cell_field(structure, conducted, basis))
    convection = csr_array((basis.N, basis.N))
    for name, coefficient in films.items():
        on = _facet_basis(structure, basis, name)
        convection = convection + coefficient * csr_array(film_form.assemble(on))
    source = np.zeros(basis.N)
    for name, power in sources.items():
        load = flux_form.assemble(_facet_basis(structure, basis, name))
        source += power * load / load.sum()
    return HeatOperators(csr_array(capacity), csr_array(conduction), csr_array(convection), source)


def _facet_basis(structure: Structure, basis: CellBasis, surface: str) -> FacetBasis:
    facets = structure.surface(surface, "heat operators")
    return FacetBasis(structure.mesh, basis.elem, facets=facets, intorder=2 * basis.elem.maxdeg)
