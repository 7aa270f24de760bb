"""Bodies whose modulus depends on temperature: correction of constant stiffness.

sigma = f(T) C (eps - alpha theta I), with the strain eps from the stress-free state at the initial
ambient, Poisson's ratio constant and f a factor on the modulus at the present temperature. The
factorised stiffness has the middle m of the factor. The difference is a load,

    r(T, u) = -sum over bodies of the integral of grad v : (f(T) - m) C (eps(u) - alpha theta I),

and K u = F T + G^T A z + r(T, u) is solved by iteration, without another factorisation. In the
energy norm of K the iteration contracts at least by (max f - min f)/(max f + min f); Anderson's
method (1965) converges faster.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fesim.solid.condensation import DisplacementField
from fesim.solid.element_matrices import cell_gradients, reference_shapes
from fesim.solid.materials import Material
from fesim.solid.spaces import Spaces
from fesim.solid.temperature_factor import TemperatureFactor
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True, eq=False)
class SoftBody:
    """Cells of a body whose modulus has a factor."""

    #: Factor on its modulus.
    factor: TemperatureFactor
    #: Lame's constants and (3 lambda + 2 mu) alpha at the middle of the factor, Pa, Pa/K.
    constants: tuple[float, float, float]
    #: Shape (c,): its cells.
    cells: NDArray[np.int64]
    #: Shapes (c, f) and (c, g): displacement nodes and temperature unknowns of its cells.
    nodes: NDArray[np.int64]
    corners: NDArray[np.int64]
    #: Shape (g, q): temperature shape functions at the quadrature points.
    shapes: Array
    #: Shapes (c, f, 3 q) and (c, q): gradients of the displacement shape functions there, 1/m, and
    #: weights, m3.
    gradient: Array
    volume: Array

    def relative(self, temperature: Array) -> Array:
        """Return f/m, the modulus relative to that of the factorised stiffness."""
        value = np.interp(temperature, self.factor.rises, self.factor.values)
        return np.asarray(value / self.factor.middle)

    def load(self, temperature: Array, strained: Array, moved: Array) -> Array:
        """Nodal forces r (c, f, 3), N, at displacements (nodes, 3) (`VariableStiffness.load`)."""
        cells = len(self.nodes)
        lame, shear, bulk = self.constants
        slope = (self.gradient.transpose(0, 2, 1) @ moved[self.nodes]).reshape(cells, 3, -1, 3)
        stress = shear * (slope + slope.transpose(0, 3, 2, 1))
        pressed = lame * np.einsum("ciqi->cq", slope) - bulk * (
            strained[self.corners] @ self.shapes
        )
        for i in range(3):
            stress[:, i, :, i] += pressed
        lacking = self.relative(temperature[self.corners] @ self.shapes) - 1.0
        stress *= (lacking * self.volume)[:, None, :, None]
        return np.asarray(-(self.gradient @ stress.reshape(cells, -1, 3)))


@dataclass(frozen=True, eq=False)
class VariableStiffness:
    """Correction of the factorised stiffness of a structure."""

    #: Bodies with a factor.
    bodies: tuple[SoftBody, ...]
    #: The factorised structure.
    field: Callable[[], DisplacementField]
    #: Shape (k, n): rows of the displacement probes.
    probes: csr_array
    #: Shape (n, l): nodal forces of the mechanical loads at factor one, N.
    forces: Array

    def load(self, temperature: Array, strained: Array, moved: Array) -> Array:
        """Return r(T, u), shape (n,), N.

        Parameters
        ----------
        temperature : ndarray, shape (n_heat,)
            T, K, which determines the modulus.
        strained : ndarray, shape (n_heat,)
            theta, K, which expands the bodies.
        moved : ndarray, shape (n,)
            u, m, relative to the stress-free state.
        """
        total, nodal = np.zeros(len(moved)), moved.reshape(-1, 3)
        for body in self.bodies:
            forces = body.load(temperature, strained, nodal)
            for i in range(3):
                total[i::3] += np.bincount(body.nodes.ravel(), forces[..., i].ravel(), len(nodal))
        return total

    def relative(self, corners: Array) -> Array:
        """Return the modulus at the corners of all cells from their temperatures (g, cells), K."""
        found = np.ones(corners.shape)
        for body in self.bodies:
            found[:, body.cells] = body.relative(corners[:, body.cells])
        return found


def soft_bodies(
    structure: Structure,
    spaces: Spaces,
    materials: Mapping[str, Material],
    factors: Mapping[str, TemperatureFactor],
) -> tuple[SoftBody, ...]:
    """Return the bodies with a factor on their modulus; `factors` are by their names.

    `materials` are those of every body, with the modulus at the middle of its factor.
    """
    basis, heat = spaces.displacement, spaces.heat
    points = spaces.quadrature[0]
    shapes, _ = reference_shapes(heat.elem, points, len(heat.element_dofs))
    found = []
    for name, factor in factors.items():
        cells, material = structure.bodies[name], materials[name]
        batches = cell_gradients(basis.mesh, basis.elem, spaces.quadrature, cells)
        parts = [part for _, part in batches]
        gradient = np.concatenate([part.gradient for part in parts])
        lame, shear = material.lame
        found.append(
            SoftBody(
                factor,
                (lame, shear, (3.0 * lame + 2.0 * shear) * material.expansion),
                cells,
                basis.element_dofs[:, cells].T.astype(np.int64),
                heat.element_dofs[:, cells].T.astype(np.int64),
                shapes,
                gradient.reshape(*gradient.shape[:2], -1),
                np.concatenate([part.volume for part in parts]),
            )
        )
    return tuple(found)
