"""The set-up as it was: one stiffness, form by form, one factor, all right-hand sides at once.

What `fesim.solid.substructures` and `fesim.solid.element_matrices` must agree with, and what they
are measured against. The reduced thermal model is the same on both sides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, kron
from skfem import BilinearForm, CellBasis, DiscreteField
from skfem.assembly.form.form import FormExtraParams

from fesim.case.schema import Case
from fesim.march.reduced import ThermalModes, outputs_of, thermal_modes
from fesim.setup.constraints import fixed_surfaces
from fesim.setup.elastic import reference_springs
from fesim.setup.loads import heat_sources, held_profiles
from fesim.setup.parts import make_parts
from fesim.setup.structure import body_materials, measured_points
from fesim.solid.condensation import ElasticCondensation
from fesim.solid.elasticity import ElasticOperators, held_unknowns
from fesim.solid.heat import ThermalLoads, cell_field, heat_operators
from fesim.solid.joint_operators import JointOperators, joint_operators
from fesim.solid.linear_solver import checked_solve, factorise
from fesim.solid.materials import Material
from fesim.solid.spaces import Spaces, make_spaces, probe_rows
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array


@BilinearForm
def gradient_product(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> NDArray[np.float64]:
    """(value d_i v, d_j u): the products that isotropic elasticity is made of."""
    return w["value"] * v.grad[w["i"]] * u.grad[w["j"]]


@BilinearForm
def expansion_form(u: DiscreteField, v: DiscreteField, w: FormExtraParams) -> NDArray[np.float64]:
    """(value u, d_i v): the thermal stress of a temperature u against the strain of v."""
    return w["value"] * u * v.grad[w["i"]]


def plain_operators(
    structure: Structure,
    spaces: Spaces,
    materials: dict[str, Material],
    fixed: list[str],
    symmetry: dict[str, str],
) -> ElasticOperators:
    """Assemble the whole stiffness; as `fesim.solid.elasticity.elastic_operators`."""
    basis: CellBasis = spaces.elastic
    lame = {name: m.lame for name, m in materials.items()}
    first = cell_field(structure, {name: lam for name, (lam, _) in lame.items()}, basis)
    shear = cell_field(structure, {name: mu for name, (_, mu) in lame.items()}, basis)
    bulk = cell_field(
        structure,
        {n: (3.0 * lame[n][0] + 2.0 * lame[n][1]) * m.expansion for n, m in materials.items()},
        basis,
    )
    lam, mu = (
        [
            [gradient_product.assemble(basis, value=value, i=i, j=j) for j in range(3)]
            for i in range(3)
        ]
        for value in (first, shear)
    )
    laplacian = mu[0][0] + mu[1][1] + mu[2][2]
    blocks = {(i, j): lam[i][j] + mu[j][i] for i in range(3) for j in range(3)}
    for i in range(3):
        blocks[i, i] = blocks[i, i] + laplacian
    heat = basis.with_element(spaces.heat.elem)
    loads = {(i, 0): expansion_form.assemble(heat, basis, value=bulk, i=i) for i in range(3)}
    size = spaces.displacement_size
    held = held_unknowns(structure, spaces, fixed, symmetry)
    return ElasticOperators(
        _interleave(blocks, (size, size), columns=3),
        _interleave(loads, (size, int(heat.N)), columns=1),
        np.setdiff1d(np.arange(size), held),
        spaces.displacement.doflocs.T,
    )


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


def plain_condensation(
    elastic: ElasticOperators,
    joints: JointOperators,
    reference: Array,
    probes: csr_array,
    solver: str | None = None,
) -> ElasticCondensation:
    """Condense the whole at once; as `fesim.solid.condensation.condense_elasticity`."""
    free = elastic.free
    gap, rows = csr_array(joints.gap[:, free]), probes[:, free]
    area = np.tile(joints.area, 3)
    springs = gap.T @ diags_array(area * reference) @ gap
    factor = factorise(elastic.stiffness[free][:, free] + springs, "stiffness", solver)
    outputs = np.vstack([gap.toarray(), rows.toarray()])
    influence = checked_solve(factor, outputs.T, "elastic condensation")
    thermal = (elastic.thermal_load[free].T @ influence).T
    count = gap.shape[0]
    compliance = gap @ influence[:, :count]
    return ElasticCondensation(
        compliance=0.5 * (compliance + compliance.T),
        thermal_gap=np.ascontiguousarray(thermal[:count]),
        probe_compliance=rows @ influence[:, :count],
        probe_thermal=np.ascontiguousarray(thermal[count:]),
        reference=reference,
        area=area,
    )


def plain_set_up(case: Case) -> tuple[ElasticCondensation, ThermalModes]:
    """Set a case up as `fesim.setup.machine.set_up`, but for the elastic structure."""
    parts = make_parts(case)
    structure, joints = parts.structure, parts.joints
    materials = body_materials(case, structure)
    spaces = make_spaces(structure.mesh)
    operators = joint_operators(joints, spaces)
    loads = ThermalLoads(case.convection_W_m2K, heat_sources(case, structure), held_profiles(case))
    heat = heat_operators(structure, spaces.heat, materials, loads, joints)
    symmetry: dict[str, str] = {**case.supports.symmetry}
    elastic = plain_operators(structure, spaces, materials, fixed_surfaces(case), symmetry)
    springs = reference_springs(structure, materials, joints)
    measured = {name: structure.probes[name] for name in measured_points(case)}
    scalar = probe_rows(spaces.displacement, structure, measured)
    relative = scalar[[0]] - scalar[[1]] if len(measured) == 2 else scalar
    probes = csr_array(kron(relative, eye_array(3)))
    condensed = plain_condensation(elastic, operators, springs, probes)
    rows = probe_rows(spaces.heat, structure, parts.probes)
    return condensed, thermal_modes(heat, operators, outputs_of(condensed, rows), case.march.step_s)
