"""Patch tests: fields that every element must reproduce, on distorted meshes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.optimize import brentq

from fesim.joint.law import JointLaw
from fesim.march.contact import ContactProblem
from fesim.solid.elasticity import elastic_operators
from fesim.solid.heat import ThermalLoads, heat_operators
from fesim.solid.spaces import Spaces, make_spaces
from fesim.solid.stress import stress_at, stress_rows
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.rods import between_rollers
from thermojoint.verification.series import law_at
from thermojoint.verification.solving import solve_given
from thermojoint.verification.structures import (
    ELEMENTS,
    IRON,
    LEFT,
    RIGHT,
    SECTION,
    block,
    box_grid,
    shaken,
    two_bars,
)

TOLERANCE = 1e-9
#: Largest displacement of inner nodes, relative to the spacing.
SHAKE = 0.2
UNITS = {"temperature": "K", "displacement": "m", "stress": "Pa", "contact pressure": "Pa"}


def heat_checks() -> Iterator[Check]:
    """A linear temperature, prescribed on the boundary, is exact inside."""
    for kind, (element, _) in ELEMENTS.items():
        structure = shaken_block(kind)
        basis = make_spaces(structure.mesh).heat
        heat = heat_operators(structure, basis, {"block": IRON}, ThermalLoads())
        exact = np.array([3.0, 20.0, -50.0, 40.0]) @ np.vstack([np.ones(basis.N), basis.doflocs])
        outside = basis.get_dofs(structure.mesh.boundary_facets()).all()
        computed = solve_given(
            heat.conduction, np.zeros(basis.N), outside, exact[outside], "heat patch"
        )
        yield worst(
            f"heat patch test, {element}",
            "temperature",
            computed,
            exact,
            "linear temperature",
            scale=float(np.ptp(exact)),
        )


def elastic_checks() -> Iterator[Check]:
    """A uniform strain, prescribed on the boundary; a uniform expansion without stress."""
    strain = 1e-4 * np.array([[1.0, 0.4, -0.3], [0.4, -0.7, 0.5], [-0.3, 0.5, 0.2]])
    lam, mu = IRON.lame
    stress = lam * np.trace(strain) * np.eye(3) + 2.0 * mu * strain
    for kind, (_, element) in ELEMENTS.items():
        structure = shaken_block(kind)
        spaces = make_spaces(structure.mesh)
        materials = {"block": IRON}
        elastic = elastic_operators(
            structure, spaces, materials, [], {"x0": "x", "y0": "y", "z0": "z"}
        )
        exact = (strain @ spaces.elastic.doflocs).T.ravel()
        outside = spaces.elastic.get_dofs(structure.mesh.boundary_facets()).all()
        given = (3 * outside[:, None] + np.arange(3)).ravel()
        load = np.zeros(exact.size)
        computed = solve_given(elastic.stiffness, load, given, exact[given], "elastic patch")
        cold = np.zeros(spaces.heat.N)
        name = f"elastic patch test, {element}"
        yield worst(name, "displacement", computed, exact, "uniform strain")
        yield worst(
            name,
            "stress",
            stress_inside(structure, spaces, computed, cold),
            np.broadcast_to(stress, (structure.mesh.nelements, 3, 3)),
            "uniform strain",
        )
        rise = 20.0
        hot = np.full(spaces.heat.N, rise)
        held = np.setdiff1d(np.arange(exact.size), elastic.free)
        free = (IRON.expansion * rise * spaces.elastic.doflocs).T.ravel()
        computed = solve_given(
            elastic.stiffness, elastic.thermal_load @ hot, held, 0.0, "expansion patch"
        )
        name = f"expansion patch test, {element}"
        yield worst(name, "displacement", computed, free, "u = alpha T x")
        yield worst(
            name,
            "stress",
            stress_inside(structure, spaces, computed, hot),
            np.zeros((structure.mesh.nelements, 3, 3)),
            "none; relative to E alpha T",
            scale=IRON.youngs_modulus * IRON.expansion * rise,
        )


def contact_checks() -> Iterator[Check]:
    """Two hot bars between walls press uniformly on a joint with non-matching meshes."""
    rise, law = 20.0, law_at(4.41e6)
    pressure = wall_pressure(rise, law)
    for kind in ELEMENTS:
        structure = shaken_bars(kind)
        materials = {"left": IRON, "right": IRON}
        spaces, operators, condensed, field = between_rollers(structure, materials, (3, 2))
        count = len(operators.area)
        hot = np.full(spaces.heat.N, rise)
        zero = np.zeros((3, count))
        # Far below the march's tolerance: 1e-16 m change the pressure of the joint by 1e-10.
        contact = ContactProblem(condensed, [(law, count)], 1e-16)
        settled = contact.settle(condensed.thermal_gap @ hot, zero[1:], zero)
        name = f"contact patch test, non-matching {kind}"
        source = "bars and joint in series"
        found = settled.traction.value[0] + law.preload
        yield worst(name, "contact pressure", found, np.full_like(found, pressure), source)
        remainder = settled.traction.value.ravel() + condensed.reference * settled.gap.ravel()
        moved = field.solve(hot, remainder)
        # The field belongs to the pressure above the preload.
        along = np.zeros((3, 3))
        along[0, 0] = law.preload - pressure
        yield worst(
            name,
            "stress",
            stress_inside(structure, spaces, moved, hot),
            np.broadcast_to(along, (structure.mesh.nelements, 3, 3)),
            source,
        )


def wall_pressure(rise: float, law: JointLaw) -> float:
    """Pressure, Pa: g + alpha dT L = (p(g) - p0) L / E, since walls hold the ends of both bars."""
    length = LEFT + RIGHT

    def misfit(opening: float) -> float:
        excess = float(law.normal.pressure(np.array([opening]))[0]) - law.preload
        return opening + IRON.expansion * rise * length - excess * length / IRON.youngs_modulus

    opening = brentq(misfit, -1e-4, 1e-4, xtol=1e-20, rtol=1e-15)
    return float(law.normal.pressure(np.array([opening]))[0])


def shaken_block(kind: str) -> Structure:
    """Return a block of 3 x 3 x 3 cells (or that times six), its inner nodes moved."""
    return block(shaken(box_grid(kind, (3, 3, 3), (0.3, 0.2, 0.1)), SHAKE, seed=4))


def shaken_bars(kind: str) -> Structure:
    """Return two bars whose meshes do not match, with moved nodes inside."""
    return two_bars(
        shaken(box_grid(kind, (3, 3, 2), (LEFT, *SECTION)), SHAKE, seed=5),
        shaken(box_grid(kind, (3, 4, 3), (RIGHT, *SECTION), (LEFT, 0.0, 0.0)), SHAKE, seed=6),
    )


def stress_inside(
    structure: Structure, spaces: Spaces, displacement: Array, temperature: Array
) -> Array:
    """Stress at the mean of each cell's corners, shape (cells, 3, 3), Pa; all bodies of iron."""
    mesh = structure.mesh
    rows = stress_rows(
        structure,
        spaces,
        dict.fromkeys(structure.bodies, IRON),
        mesh.p[:, mesh.t].mean(axis=1),
        np.arange(mesh.nelements),
    )
    return stress_at(rows, displacement, temperature)


def worst(
    name: str, quantity: str, computed: Array, exact: Array, source: str, scale: float = 0.0
) -> Check:
    """Check the largest error of a field, relative to `scale` or to the largest exact value."""
    at = np.unravel_index(int(np.argmax(np.abs(computed - exact))), computed.shape)
    compared = Quantity(quantity, UNITS[quantity], TOLERANCE, source)
    return compared.check(name, exact[at], computed[at], scale or float(np.abs(exact).max()))
