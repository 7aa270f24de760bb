"""Manufactured solutions: orders of convergence of the elements and the time integration.

A smooth field is chosen; the corresponding heat or force is applied to the body, and its values are
prescribed on the boundary. The error in L2 decreases like h^order with mesh refinement.

Theoretical orders (h is the element size):

- temperature of first order: 2;
- displacement of second order: 3, its stress: 2;
- displacement under a thermal strain: 2. The temperature is of first order, its error of order h^2
  does not change sign within an element, and thus the displacement inherits the order 2;
- implicit Euler: 1 in the time step.

Meshes are refined by halving a smoothly bent grid. Serendipity elements lose an order on meshes
that remain distorted under refinement (Arnold, Boffi & Falk, Math. Comp. 71, 2002).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from skfem import CellBasis, DiscreteField, LinearForm
from skfem.assembly.form.form import FormExtraParams

from fesim.march.heat_step import heat_step
from fesim.solid.elasticity import elastic_operators
from fesim.solid.heat import ThermalLoads, heat_operators
from fesim.solid.spaces import Spaces, make_spaces
from fesim.solid.stress import stress_at, stress_rows
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.nafems_heat import NO_JOINT, alone
from thermojoint.verification.solving import solve_given
from thermojoint.verification.structures import ELEMENTS, IRON, bent, block, box_grid

#: Elements along each edge of the cube, from coarse to fine.
HEAT_MESHES = (4, 8, 16)
ELASTIC_MESHES = (4, 6, 8)
#: Numbers of time steps to the time at which errors are compared.
TIME_STEPS = (50, 100, 200)
#: Largest deviation of an observed order from theory.
WITHIN = 0.1
#: Degree of polynomials for which the quadrature of the errors is exact.
FINE = 7


@dataclass(frozen=True)
class Wave:
    """A field a sin(k . x + phase) with known derivatives."""

    #: Shape (c,): a, in the unit of the field; three components for a displacement, one for a
    #: temperature.
    amplitude: Array
    #: Shape (3,): k, 1/m.
    number: Array
    phase: float = 0.4

    def value(self, x: Array) -> Array:
        """Field at points (3, ...), shape (c, ...)."""
        return np.multiply.outer(self.amplitude, np.sin(self._argument(x)))

    def gradient(self, x: Array) -> Array:
        """Derivative of component i by x_j, shape (c, 3, ...)."""
        outer = np.multiply.outer(self.amplitude, self.number)
        return np.multiply.outer(outer, np.cos(self._argument(x)))

    def _argument(self, x: Array) -> Array:
        return np.tensordot(self.number, x, axes=1) + self.phase


TEMPERATURE = Wave(np.array([30.0]), np.array([2.0, -1.6, 1.1]))
DISPLACEMENT = Wave(np.array([1.0e-5, -0.6e-5, 0.8e-5]), np.array([1.3, 1.8, -1.5]))


def checks() -> Iterator[Check]:
    """Check the orders of the elements and of the time scheme."""
    for kind, (low, high) in ELEMENTS.items():
        errors = [heat_error(bent_cube(kind, count)) for count in HEAT_MESHES]
        yield _order(f"heat, {low}", "order of the temperature", HEAT_MESHES, errors, 2.0)
        cubes = [bent_cube(kind, count) for count in ELASTIC_MESHES]
        cold = [elastic_errors(cube, rise=0.0) for cube in cubes]
        warm = [elastic_errors(cube, rise=1.0) for cube in cubes]
        for name, computed, theory in (
            (f"elasticity, {high}", cold, (3.0, 2.0)),
            (f"thermoelasticity, {high} with {low}", warm, (2.0, 2.0)),
        ):
            quantities = ("order of the displacement", "order of the stress")
            for at, (quantity, order) in enumerate(zip(quantities, theory, strict=True)):
                series = [pair[at] for pair in computed]
                yield _order(name, quantity, ELASTIC_MESHES, series, order)
    yield _order(
        "implicit Euler", "order in the time step", TIME_STEPS, time_errors(TIME_STEPS), 1.0
    )


def _order(
    name: str, quantity: str, refinement: Sequence[float], errors: list[float], theory: float
) -> Check:
    """Check the slope between the two finest of a series."""
    observed = -np.log(errors[-1] / errors[-2]) / np.log(refinement[-1] / refinement[-2])
    return order_of(quantity).check(name, theory, observed, scale=1.0)


def order_of(quantity: str) -> Quantity:
    """Return an order of convergence as a quantity; its error is a difference of orders."""
    return Quantity(quantity, "1", WITHIN, "theory; difference of orders")


def bent_cube(kind: str, count: int) -> Structure:
    """Return a cube of 1 m with `count` cells along each edge, bent smoothly inside."""

    def move(x: Array) -> Array:
        wave = np.prod(np.sin(np.pi * x), axis=0)
        return 0.08 * wave * np.array([[1.0], [-0.7], [0.5]])

    return block(bent(box_grid(kind, (count, count, count), (1.0, 1.0, 1.0)), move))


@LinearForm
def body_load(v: DiscreteField, w: FormExtraParams) -> Array:
    """(f, v) with a density f at the quadrature points."""
    return w["density"] * v


def heat_error(structure: Structure) -> float:
    """Relative error in L2 of the temperature under the heat k |q|^2 T of the wave."""
    basis = make_spaces(structure.mesh).heat
    heat = heat_operators(structure, basis, {"block": IRON}, ThermalLoads())
    fine = CellBasis(structure.mesh, basis.elem, intorder=FINE)
    x = np.asarray(fine.global_coordinates())
    exact = TEMPERATURE.value(x)[0]
    density = IRON.conductivity * (TEMPERATURE.number @ TEMPERATURE.number) * exact
    outside = basis.get_dofs(structure.mesh.boundary_facets()).all()
    given = TEMPERATURE.value(basis.doflocs[:, outside])[0]
    computed = solve_given(
        heat.conduction, body_load.assemble(fine, density=density), outside, given, "heat"
    )
    return _relative_l2(fine.dx, np.asarray(fine.interpolate(computed)) - exact, exact)


def elastic_errors(structure: Structure, rise: float) -> tuple[float, float]:
    """Relative errors in L2 of displacement and stress, the temperature scaled by `rise`."""
    spaces = make_spaces(structure.mesh)
    materials = {"block": IRON}
    elastic = elastic_operators(structure, spaces, materials, [], {})
    lam, mu = IRON.lame
    bulk = (3.0 * lam + 2.0 * mu) * IRON.expansion * rise
    fine = CellBasis(structure.mesh, spaces.elastic.elem, intorder=FINE)
    x = np.asarray(fine.global_coordinates())
    k, d = DISPLACEMENT.number, DISPLACEMENT.amplitude
    # -div(lambda tr e I + 2 mu e) of d sin(k.x), and the contribution of the thermal stress.
    force = np.multiply.outer(
        (lam + mu) * (k @ d) * k + mu * (k @ k) * d, DISPLACEMENT.value(x)[0] / d[0]
    )
    force = force + bulk * TEMPERATURE.gradient(x)[0]
    temperature = rise * TEMPERATURE.value(spaces.heat.doflocs)[0]
    load = np.stack([body_load.assemble(fine, density=part) for part in force], axis=1).ravel()
    nodes = spaces.elastic.get_dofs(structure.mesh.boundary_facets()).all()
    given = (3 * nodes[:, None] + np.arange(3)).ravel()
    values = DISPLACEMENT.value(spaces.elastic.doflocs[:, nodes]).T.ravel()
    computed = solve_given(
        elastic.stiffness, load + elastic.thermal_load @ temperature, given, values, "elasticity"
    )
    exact = DISPLACEMENT.value(x)
    moved = np.stack([np.asarray(fine.interpolate(part)) for part in computed.reshape(-1, 3).T])
    return (
        _relative_l2(fine.dx, moved - exact, exact),
        _stress_error(structure, spaces, computed, temperature, rise),
    )


def _stress_error(
    structure: Structure, spaces: Spaces, displacement: Array, temperature: Array, rise: float
) -> float:
    """Relative error in L2 of the recovered stress, by the stiffness's own quadrature."""
    x = np.asarray(spaces.elastic.global_coordinates())
    cells, count = x.shape[1:]
    lam, mu = IRON.lame
    rows = stress_rows(
        structure, spaces, {"block": IRON}, x.reshape(3, -1), np.repeat(np.arange(cells), count)
    )
    computed = stress_at(rows, displacement, temperature)
    gradient = DISPLACEMENT.gradient(x.reshape(3, -1)).transpose(2, 0, 1)
    strain = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    strain = strain - IRON.expansion * rise * np.multiply.outer(
        TEMPERATURE.value(x.reshape(3, -1))[0], np.eye(3)
    )
    trace = np.trace(strain, axis1=1, axis2=2)
    exact = lam * np.multiply.outer(trace, np.eye(3)) + 2.0 * mu * strain
    return _relative_l2(spaces.elastic.dx.ravel(), (computed - exact).T, exact.T)


def _relative_l2(weights: Array, error: Array, exact: Array) -> float:
    return float(np.sqrt((weights * error**2).sum() / (weights * exact**2).sum()))


def time_errors(counts: Sequence[int]) -> list[float]:
    """Relative errors at time 1 of a mode that decays like exp(-t), for each number of steps.

    The mode is an eigenvector of the discrete heat equation, so that only the time step has an
    error.
    """
    structure = block(box_grid("hexahedra", (6, 1, 1), (0.1, 0.02, 0.02)))
    basis = make_spaces(structure.mesh).heat
    heat = heat_operators(structure, basis, {"block": IRON}, ThermalLoads({"x0": 200.0}))
    matrix = (heat.conduction + heat.convection).toarray()
    rates, modes = eigh(matrix, heat.capacity.toarray())
    mode, unit = modes[:, 1], 1.0 / rates[1]
    errors = []
    for count in counts:
        thermal = alone(heat, unit / count)
        temperature = mode
        for _ in range(count):
            temperature, _ = heat_step(thermal, temperature, np.zeros(1), NO_JOINT)
        exact = np.exp(-1.0) * mode
        errors.append(float(np.linalg.norm(temperature - exact) / np.linalg.norm(exact)))
    return errors
