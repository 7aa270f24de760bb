"""Thermoelasticity against closed forms: free expansion, bending, contact between walls."""

from dataclasses import replace

import numpy as np
import pytest
from bars import IRON, LEFT, RIGHT, ROLLERS, STEEL, assemble, surface_law, two_bars
from scipy.optimize import brentq
from skfem import FacetBasis, MeshHex, MeshTet

from fesim.joint.gap import TOLERANCE, solve_gap
from fesim.joint.law import NORMAL
from fesim.solid.elasticity import elastic_operators
from fesim.solid.heat import flux_form
from fesim.solid.linear_solver import factorise
from fesim.solid.materials import Material
from fesim.solid.spaces import make_spaces, probe_rows
from meshes.structure import Probe, Structure

MESHES = {
    "matching": two_bars(left=(2, 3, 2), right=(3, 3, 2)),
    "not matching": two_bars(left=(2, 3, 2), right=(2, 4, 3)),
    "tetrahedra": two_bars(left=(2, 2, 2), right=(3, 3, 2), tetrahedra=True),
}


def block(kind, shift=0.0):
    """A 0.3 x 0.2 x 0.1 m block, nodes inside shifted at random by a share of the spacing."""
    lines = [np.linspace(0.0, 0.3, 4), np.linspace(0.0, 0.2, 4), np.linspace(0.0, 0.1, 4)]
    mesh = (MeshHex if kind == "hexahedra" else MeshTet).init_tensor(*lines)
    size = np.array([[0.3], [0.2], [0.1]])
    inside = ((mesh.p > 1e-9) & (mesh.p < size - 1e-9)).all(axis=0)
    points = mesh.p.copy()
    random = np.random.default_rng(4).uniform(-1.0, 1.0, (3, inside.sum()))
    points[:, inside] += shift * (size / 3) * random
    mesh = type(mesh)(points, mesh.t)
    facets = mesh.boundary_facets()
    x, y, z = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    return Structure(
        mesh,
        bodies={"block": np.arange(mesh.nelements)},
        surfaces={
            "left": facets[x < 1e-9],
            "bottom": facets[y < 1e-9],
            "back": facets[z < 1e-9],
        },
    )


def operators_of(structure, fixed=(), symmetry=None, material=IRON):
    spaces = make_spaces(structure.mesh)
    materials = dict.fromkeys(structure.bodies, material)
    return spaces, elastic_operators(structure, spaces, materials, list(fixed), symmetry or {})


def solve(elastic, load):
    free = elastic.free
    displacement = np.zeros(load.shape)
    displacement[free] = factorise(elastic.stiffness[free][:, free], "stiffness").solve(load[free])
    return displacement


@pytest.mark.parametrize("kind", ["hexahedra", "tetrahedra"])
def test_a_rigid_motion_takes_no_force(kind):
    spaces, elastic = operators_of(block(kind, shift=0.2))
    turn = np.array([[0.0, -1.0, 2.0], [1.0, 0.0, -3.0], [-2.0, 3.0, 0.0]])
    motion = (turn @ spaces.elastic.doflocs + np.array([[1.0], [-2.0], [0.5]])).T.ravel()
    scale = np.abs(elastic.stiffness.data).max()
    np.testing.assert_allclose(elastic.stiffness @ motion, 0.0, atol=1e-12 * scale)


@pytest.mark.parametrize("kind", ["hexahedra", "tetrahedra"])
def test_a_linear_temperature_bends_a_free_block_without_stress(kind):
    """T = c y: u = alpha c (x y, (y^2 - x^2 - z^2) / 2, y z)."""
    spaces, elastic = operators_of(block(kind))
    c = 40.0
    x, y, z = spaces.elastic.doflocs
    bent = IRON.expansion * c * np.array([x * y, 0.5 * (y**2 - x**2 - z**2), y * z])
    load = elastic.thermal_load @ (c * spaces.heat.doflocs[1])
    residual = elastic.stiffness @ bent.T.ravel() - load
    assert np.abs(residual).max() <= 1e-9 * np.abs(load).max()


def cantilever(length, height, along, tetrahedra=False):
    """One element thick and one wide, in bending about z."""
    width = 0.5 * height
    lines = [np.linspace(0.0, length, along + 1), np.array([0.0, height]), np.array([0.0, width])]
    mesh = (MeshTet if tetrahedra else MeshHex).init_tensor(*lines)
    facets = mesh.boundary_facets()
    x = mesh.p[0, mesh.facets[:, facets]].mean(axis=0)
    surfaces = {"root": facets[x < 1e-9], "tip": facets[x > length - 1e-9]}
    structure = Structure(mesh, {"beam": np.arange(mesh.nelements)}, surfaces)
    return structure, width


@pytest.mark.parametrize(("tetrahedra", "within"), [(False, 0.01), (True, 0.02)])
@pytest.mark.parametrize("slenderness", [10.0, 40.0])
def test_a_cantilever_one_element_thick_does_not_lock(slenderness, tetrahedra, within):
    """Tip force: w = F L^3 / (3 E I) + F L / (kappa G A) (Timoshenko)."""
    height, force = 0.05, 1000.0
    length = slenderness * height
    structure, width = cantilever(length, height, along=20, tetrahedra=tetrahedra)
    spaces, elastic = operators_of(structure, fixed=["root"])
    on_tip = FacetBasis(
        structure.mesh, spaces.elastic.elem, facets=structure.surfaces["tip"], intorder=4
    )
    shear = flux_form.assemble(on_tip)
    load = np.zeros(spaces.displacement_size)
    load[1::3] = force * shear / shear.sum()
    tip = probe_rows(
        spaces.elastic, structure, {"tip": Probe((length, height / 2, width / 2), "beam")}
    )
    deflection = (tip @ solve(elastic, load)[1::3])[0]
    e, nu = IRON.youngs_modulus, IRON.poisson_ratio
    inertia = width * height**3 / 12.0
    kappa = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu)
    modulus = e / (2.0 * (1.0 + nu))
    expected = force * length**3 / (3.0 * e * inertia) + force * length / (
        kappa * modulus * width * height
    )
    assert deflection == pytest.approx(expected, rel=within)


@pytest.mark.parametrize("mesh", MESHES)
def test_gaps_are_openings_and_slips_along_and_across(mesh):
    """Moving the right bar by x opens the joint; y is along its longer side, z across."""
    made = assemble(MESHES[mesh], fixed=["left_end", "right_end"])
    x = made.parts.spaces.elastic.doflocs[0]
    dofs = np.unique(made.parts.spaces.elastic.element_dofs[:, MESHES[mesh].bodies["right"]])
    assert x[dofs].min() == pytest.approx(LEFT)
    for axis in range(3):
        displacement = np.zeros(made.parts.spaces.displacement_size)
        displacement[3 * dofs + axis] = 1.0
        gaps = (made.field.gap @ displacement).reshape(3, -1)
        expected = np.zeros_like(gaps)
        expected[axis] = np.sign(gaps[axis])
        np.testing.assert_allclose(gaps, expected, rtol=0.0, atol=1e-12)
        assert np.abs(expected[axis]).min() == 1.0
        assert axis > 0 or (expected[0] == 1.0).all()


def settle(made, temperature):
    """Equilibrium of the joint at a temperature field, and the displacement field there."""
    machine = made.machine
    elastic = machine.contact.elastic
    zero = np.zeros((3, machine.contact.count))
    found = solve_gap(
        machine.contact.gap_problem, elastic.thermal_gap @ temperature, zero[1:], zero, 1e-16
    )
    remainder = found.traction.value.ravel() + elastic.reference * found.gap.ravel()
    probes = elastic.probe_thermal @ temperature + elastic.probe_compliance @ (
        elastic.area * remainder
    )
    return found, remainder, probes


def stacked_opening(second, rise, law):
    """Solve g = (p(g) - p0) (L1/E1 + L2/E2) - rise (a1 L1 + a2 L2)."""
    compliance = LEFT / IRON.youngs_modulus + RIGHT / second.youngs_modulus
    expansion = rise * (LEFT * IRON.expansion + RIGHT * second.expansion)

    def misfit(opening):
        excess = law.normal.pressure(np.array([opening]))[0] - law.preload
        return opening + expansion - excess * compliance

    return brentq(misfit, -1e-4, 1e-4, xtol=1e-18, rtol=1e-14)


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize(("second", "friction"), [(IRON, 0.6), (STEEL, 0.0)])
def test_bars_between_walls_press_evenly_on_their_joint(mesh, second, friction):
    """Contact patch test: E alpha dT in series with the joint's own nonlinear stiffness.

    Two materials widen differently, so there the joint must be free of friction.
    """
    law = surface_law(friction)
    made = assemble(MESHES[mesh], materials=(IRON, second), law=law, symmetry=ROLLERS)
    for rise in (-30.0, -1.0, 0.5, 20.0):
        found, _, probes = settle(made, np.full(made.parts.spaces.heat.N, rise))
        opening = stacked_opening(second, rise, law)
        pressure = law.normal.pressure(np.array([opening]))[0]
        assert (pressure > law.preload) == (rise > 0.0)
        np.testing.assert_allclose(found.gap[0], opening, rtol=1e-8, atol=1e-14)
        np.testing.assert_allclose(found.traction.value[0] + law.preload, pressure, rtol=1e-7)
        np.testing.assert_allclose(found.traction.value[1:], 0.0, atol=1e-6 * law.preload)
        # The left face moves by what its bar expands less what the joint presses it back.
        moved = LEFT * (IRON.expansion * rise - (pressure - law.preload) / IRON.youngs_modulus)
        assert probes[3] == pytest.approx(moved, rel=1e-7, abs=1e-14)
        assert probes[0] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("ratio", [1.0, 1e3, 1e6, 1e9])
def test_an_accepted_residual_bounds_gap_and_pressure_however_stiff_one_body_is(ratio):
    """Any residual r within the tolerance means an error of J^-1 r in the gaps."""
    law = surface_law(0.0)
    second = replace(IRON, youngs_modulus=ratio * IRON.youngs_modulus)
    made = assemble(MESHES["matching"], materials=(IRON, second), law=law, symmetry=ROLLERS)
    problem, elastic = made.machine.contact.gap_problem, made.machine.contact.elastic
    zero = np.zeros((3, made.machine.contact.count))
    for rise in (-30.0, 20.0):
        hot = np.full(made.parts.spaces.heat.N, rise)
        found = solve_gap(problem, elastic.thermal_gap @ hot, zero[1:], zero)
        worst = np.abs(np.linalg.inv(problem.jacobian(found.traction))).sum(axis=1) * TOLERANCE
        stiffness = np.abs(found.traction.tangent[NORMAL])
        assert worst.max() < 1e-11
        assert (stiffness * worst[: stiffness.size]).max() < 1e-6 * law.preload
        pressure = law.normal.pressure(np.array([stacked_opening(second, rise, law)]))
        off = np.abs(found.traction.value[0] + law.preload - pressure)
        assert off.max() < 2e-6 * law.preload


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("springs", [0.2, 10.0])
def test_a_body_that_only_the_joint_holds_follows_it(mesh, springs):
    """Nothing pushes the right bar: it expands freely and the joint stays at its preload."""
    made = assemble(
        MESHES[mesh],
        symmetry={"left_end": "x", "bottom": "y", "back": "z"},
        springs=springs,
    )
    alone = assemble(MESHES[mesh], fixed=["left_end"], springs=springs)
    rise = 10.0
    found, _, probes = settle(made, np.full(made.parts.spaces.heat.N, rise))
    np.testing.assert_allclose(
        found.traction.value, 0.0, atol=1e-6 * made.machine.contact.preload[0]
    )
    np.testing.assert_allclose(found.gap, 0.0, atol=1e-14)
    assert probes[0] == pytest.approx(IRON.expansion * rise * (LEFT + RIGHT), rel=1e-8, abs=0.0)
    # Held by the root alone, the cold left bar and the hot right one: no net force crosses.
    hot_right = np.where(alone.parts.left_nodes, 0.0, rise)
    found, _, _ = settle(alone, hot_right)
    forces = found.traction.value * alone.parts.operators.area
    np.testing.assert_allclose(forces.sum(axis=1), 0.0, atol=1e-7 * np.abs(forces).max())


@pytest.mark.parametrize(
    "change",
    [
        {"conductivity": 0.0},
        {"density": -7200.0},
        {"youngs_modulus": np.nan},
        {"heat_capacity": np.inf},
        {"poisson_ratio": 0.5},
        {"expansion": np.nan},
    ],
)
def test_impossible_materials_are_refused(change):
    (name,) = change
    with pytest.raises(ValueError, match=f"material: {name}") as caught:
        Material(**(vars(IRON) | change))
    assert "\n" not in str(caught.value)
