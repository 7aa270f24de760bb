"""Heat operators: capacity, conduction, convection and inputs.

Temperatures are above the initial ambient. The inputs are columns of one matrix (`InputLayout`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array
from skfem import BilinearForm, CellBasis, DiscreteField, FacetBasis, LinearForm
from skfem.assembly.basis import AbstractBasis
from skfem.assembly.form.form import FormExtraParams
from skfem.helpers import dot, grad

from fesim.solid.materials import Material, by_cell
from fesim.solid.spaces import interpolation
from meshes.covered import cover_of
from meshes.pairing import PairedJoint
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array, OfPosition
from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class HeatSource:
    """A heated region: one surface, or the volume of one body."""

    #: Heat that enters the meshed part at input 1, W.
    power: float
    #: Exactly one of the two is given.
    surface: str | None = None
    body: str | None = None
    #: From position (3, n), m, to the relative heat density (n,), not negative; the total remains
    #: `power`. None: uniform.
    weight: OfPosition | None = None


@dataclass(frozen=True)
class ThermalLoads:
    """Convection, heat sources and prescribed temperatures of a structure."""

    #: Surface name to its convection coefficient, W/(m2 K).
    convection: Mapping[str, float] = field(default_factory=dict)
    sources: Sequence[HeatSource] = ()
    #: Surface with prescribed temperature to a position-dependent factor on it; None: uniform.
    #: Where two surfaces meet, the first one applies.
    held: Mapping[str, OfPosition | None] = field(default_factory=dict)


@dataclass(frozen=True)
class InputLayout:
    """Indices of the inputs: sources, then the ambient, then held surfaces."""

    #: Number of heat sources, W each.
    sources: int
    #: Number of surfaces with prescribed temperature, K each.
    held: int

    @property
    def count(self) -> int:
        """Number of inputs."""
        return self.ambient + 1 + self.held

    @property
    def source_columns(self) -> slice:
        """The sources, in the order of the case."""
        return slice(0, self.sources)

    @property
    def ambient(self) -> int:
        """The ambient above its initial temperature, K."""
        return self.sources

    @property
    def held_columns(self) -> slice:
        """The held surfaces, in the order of the case."""
        return slice(self.ambient + 1, self.count)

    @property
    def temperature_columns(self) -> slice:
        """All inputs that are temperatures, K: the ambient and the held surfaces."""
        return slice(self.ambient, self.count)


@dataclass(frozen=True)
class HeatOperators:
    """Semi-discrete heat equation M dT/dt + (K + H) T = P u(t), joints not included."""

    #: Shape (n, n): M (J/K, lumped), K and H (W/K).
    capacity: csr_array
    conduction: csr_array
    convection: csr_array
    #: Shape (n, k): P: nodal heat per unit of each input: of the sources (W), of the ambient above
    #: the initial one (W/K); zero for the held surfaces.
    inputs: Array
    #: Shape (h,): unknowns with prescribed temperature; their rows of the equation do not hold.
    held: NDArray[np.int64]
    #: Shape (h, k): their temperature per unit of each input.
    held_inputs: Array
    #: Order of the inputs.
    layout: InputLayout


@BilinearForm
def capacity_form(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> Array:
    """Heat stored: (rho c_p u, v)."""
    return w["value"] * u * v


@BilinearForm
def conduction_form(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> Array:
    """Fourier's law: (k grad u, grad v)."""
    return w["value"] * dot(grad(u), grad(v))


@BilinearForm
def convection_form(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> Array:
    """Newton's law of cooling: (h u, v) on a surface."""
    return u * v


@LinearForm
def flux_form(v: DiscreteField, w: FormExtraParams) -> Array:
    """Heat of density one, on a surface or in a volume."""
    return 1.0 * v


@LinearForm
def weighted_flux_form(v: DiscreteField, w: FormExtraParams) -> Array:
    """Heat or mass of a given density, on a surface or in a volume: (q, v)."""
    return w["value"] * v


def cell_field(structure: Structure, values: dict[str, float], basis: CellBasis) -> DiscreteField:
    """Field that is constant on each body, on the quadrature points of `basis`."""
    return DiscreteField(np.broadcast_to(by_cell(structure, values)[:, None], basis.dx.shape))


def heat_operators(
    structure: Structure,
    basis: CellBasis,
    materials: dict[str, Material],
    loads: ThermalLoads,
    joints: Sequence[PairedJoint] = (),
) -> HeatOperators:
    """Assemble the heat operators on a temperature space, from the material of every body.

    Surfaces do not convect where joints cover them.

    Raises
    ------
    InputError
        The weight of a source is zero everywhere on the mesh.
    """
    stored = {name: m.density * m.heat_capacity for name, m in materials.items()}
    conducted = {name: m.conductivity for name, m in materials.items()}
    consistent = capacity_form.assemble(basis, value=cell_field(structure, stored, basis))
    # Lumped: with a consistent capacity, temperatures next to a sudden source fall below ambient.
    capacity = diags_array(np.asarray(consistent.sum(axis=1)).ravel(), format="csr")
    conduction = conduction_form.assemble(basis, value=cell_field(structure, conducted, basis))
    convection = csr_array((basis.N, basis.N))
    for name, coefficient in loads.convection.items():
        convection = convection + coefficient * convection_matrix(structure, basis, name, joints)
    layout = InputLayout(len(loads.sources), len(loads.held))
    inputs = np.zeros((basis.N, layout.count))
    for column, source in enumerate(loads.sources):
        load = _heat_load(structure, basis, source)
        inputs[:, column] = source.power * load / load.sum()
    inputs[:, layout.ambient] = np.asarray(convection.sum(axis=1)).ravel()
    nodes, pattern = _held_unknowns(structure, basis, loads.held, layout)
    return HeatOperators(
        csr_array(capacity),
        csr_array(conduction),
        csr_array(convection),
        inputs,
        nodes,
        pattern,
        layout,
    )


def convection_matrix(
    structure: Structure, basis: CellBasis, surface: str, joints: Sequence[PairedJoint]
) -> csr_array:
    """(u, v) on the part of a surface that no joint covers, shape (n, n), m2.

    Completely covered facets are left out. For the others the integral over the covered part, from
    the quadrature points of the joint, is subtracted.
    """
    facets = structure.surface(surface, "heat operators")
    cover = cover_of(structure, surface, joints)
    free = np.flatnonzero(cover.share < 1.0)
    if not free.size:
        return csr_array((basis.N, basis.N))
    on = _facet_basis(structure, basis, facets[free])
    matrix = csr_array(convection_form.assemble(on))
    partly = cover.share[cover.facet] < 1.0
    if not partly.any():
        return matrix
    # The joint treats facets as plane; it covers the same fraction of a curved one.
    curved = np.ones(len(facets))
    curved[free] = on.dx.sum(axis=1) / cover.area[free]
    weights = (curved[cover.facet] * cover.weights)[partly]
    at = interpolation(basis, cover.points[:, partly], cover.cell[partly])
    return csr_array(matrix - at.T @ diags_array(weights) @ at)


def _heat_load(structure: Structure, basis: CellBasis, source: HeatSource) -> Array:
    """Relative share of each unknown in a source, shape (n,)."""
    on = _heated(structure, basis, source)
    if source.weight is None:
        return np.asarray(flux_form.assemble(on))
    points = np.asarray(on.global_coordinates())
    weight = source.weight(points.reshape(3, -1)).reshape(points.shape[1:])
    load = np.asarray(weighted_flux_form.assemble(on, value=DiscreteField(weight)))
    if not load.sum() > 0.0:
        where = source.surface or source.body
        raise InputError(f"sources: the profile on {where!r} is zero everywhere; correct it")
    return load


def _heated(structure: Structure, basis: CellBasis, source: HeatSource) -> AbstractBasis:
    if source.surface is not None:
        return surface_basis(structure, basis, source.surface)
    cells = structure.body(source.body or "", "heat operators")
    order = 2 * basis.elem.maxdeg
    return CellBasis(structure.mesh, basis.elem, basis.mapping, elements=cells, intorder=order)


def _held_unknowns(
    structure: Structure,
    basis: CellBasis,
    held: Mapping[str, OfPosition | None],
    layout: InputLayout,
) -> tuple[NDArray[np.int64], Array]:
    """Unknowns (h,) on the held surfaces, and their temperature (h, k) per unit of each input."""
    on = [basis.get_dofs(structure.surface(name, "heat operators")).all() for name in held]
    number = np.repeat(np.arange(len(on)), [len(part) for part in on])
    nodes, first = np.unique(np.concatenate([np.empty(0, np.int64), *on]), return_index=True)
    pattern = np.zeros((nodes.size, layout.count))
    for surface, profile in enumerate(held.values()):
        own = number[first] == surface
        factor = 1.0 if profile is None else profile(basis.doflocs[:, nodes[own]])
        pattern[own, layout.held_columns.start + surface] = factor
    return nodes, pattern


def surface_basis(structure: Structure, basis: CellBasis, surface: str) -> FacetBasis:
    """Return the basis of the same element on the facets of a named surface."""
    return _facet_basis(structure, basis, structure.surface(surface, "heat operators"))


def _facet_basis(structure: Structure, basis: CellBasis, facets: NDArray[np.int64]) -> FacetBasis:
    order = 2 * basis.elem.maxdeg
    return FacetBasis(structure.mesh, basis.elem, basis.mapping, facets=facets, intorder=order)
