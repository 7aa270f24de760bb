"""Elastic operators: stiffness, thermal load and supports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from skfem import BilinearForm, DiscreteField
from skfem.assembly.form.form import FormExtraParams

from fesim.solid.heat import cell_field, film_form, surface_basis
from fesim.solid.materials import Material
from fesim.solid.spaces import Spaces
from meshes.structure import Structure

DIRECTIONS = ("x", "y", "z")


@dataclass(frozen=True)
class ElasticOperators:
    """Thermoelastic equilibrium K u = F T, supports not yet removed.

    Attributes
    ----------
    stiffness : scipy.sparse.csr_array, shape (n, n)
        K, N/m.
    thermal_load : scipy.sparse.csr_array, shape (n, n_heat)
        F, N/K: forces of a temperature field that is held from expanding.
    free : ndarray of int
        Unknowns that no support holds.
    """

    stiffness: csr_array
    thermal_load: csr_array
    free: NDArray[np.int64]


@BilinearForm
def gradient_product(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> NDArray[np.float64]:
    """(value d_i v, d_j u): the products that isotropic elasticity is made of."""
    return w["value"] * v.grad[w["i"]] * u.grad[w["j"]]


@BilinearForm
def expansion_form(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> NDArray[np.float64]:
    """(value u, d_i v): the thermal stress of a temperature u against the strain of v."""
    return w["value"] * u * v.grad[w["i"]]


def elastic_operators(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    fixed: list[str],
    symmetry: dict[str, str],
    springs: Mapping[str, tuple[float, float, float]] | None = None,
) -> ElasticOperators:
    """Assemble the elastic operators.

    Parameters
    ----------
    structure : Structure
        Mesh and names.
    spaces : Spaces
        Displacement and temperature spaces.
    materials : dict
        Body name to its material.
    fixed : list of str
        Surfaces held in all directions.
    symmetry : dict
        Surface name to the direction ("x", "y" or "z") it is held in.
    springs : mapping, optional
        Surface name to the stiffness in x, y and z of the springs it stands on, N/m in all, spread
        evenly over the surface.
    """
    basis = spaces.elastic
    lame = {name: m.lame for name, m in materials.items()}
    first = cell_field(structure, {name: lam for name, (lam, _) in lame.items()}, basis)
    shear = cell_field(structure, {name: mu for name, (_, mu) in lame.items()}, basis)
    bulk = cell_field(
        structure,
        {n: (3.0 * lame[n][0] + 2.0 * lame[n][1]) * m.expansion for n, m in materials.items()},
        basis,
    )
    # sigma = lambda tr(e) I + 2 mu e, written with scalar products of derivatives: the vector
    # form would repeat each of them for every pair of components.
    lam = [
        [gradient_product.assemble(basis, value=first, i=i, j=j) for j in range(3)]
        for i in range(3)
    ]
    mu = [
        [gradient_product.assemble(basis, value=shear, i=i, j=j) for j in range(3)]
        for i in range(3)
    ]
    laplacian = mu[0][0] + mu[1][1] + mu[2][2]
    blocks = {(i, j): lam[i][j] + mu[j][i] for i in range(3) for j in range(3)}
    for i in range(3):
        blocks[i, i] = blocks[i, i] + laplacian
    for name, stiffness in (springs or {}).items():
        bed = csr_array(film_form.assemble(surface_basis(structure, basis, name)))
        for i in range(3):
            blocks[i, i] = blocks[i, i] + stiffness[i] / bed.sum() * bed
    size = spaces.displacement_size
    stiffness = _interleave(blocks, (size, size), columns=3)
    loads = {
        (i, 0): expansion_form.assemble(spaces.heat_on_elastic, basis, value=bulk, i=i)
        for i in range(3)
    }
    load = _interleave(loads, (size, int(spaces.heat_on_elastic.N)), columns=1)
    held = _held(structure, spaces, fixed, symmetry)
    return ElasticOperators(stiffness, load, np.setdiff1d(np.arange(size), held))


def _interleave(
    blocks: dict[tuple[int, int], csr_array], shape: tuple[int, int], columns: int
) -> csr_array:
    """Put block (i, j) at rows 3 r + i and columns `columns` c + j."""
    rows, cols, values = [], [], []
    for (i, j), block in blocks.items():
        entries = coo_array(block)
        rows.append(3 * entries.row.astype(np.int64) + i)
        cols.append(columns * entries.col.astype(np.int64) + j)
        values.append(entries.data)
    index = (np.concatenate(rows), np.concatenate(cols))
    return csr_array(coo_array((np.concatenate(values), index), shape=shape))


def _held(
    structure: Structure, spaces: Spaces, fixed: list[str], symmetry: dict[str, str]
) -> NDArray[np.int64]:
    held = [np.empty(0, dtype=np.int64)]
    for name in fixed:
        dofs = spaces.elastic.get_dofs(structure.surface(name, "supports")).all()
        held.extend(3 * dofs + i for i in range(3))
    for name, direction in symmetry.items():
        dofs = spaces.elastic.get_dofs(structure.surface(name, "supports")).all()
        held.append(3 * dofs + DIRECTIONS.index(direction))
    return np.unique(np.concatenate(held))
