"""Stress recovered at points from displacement and temperature."""

import numpy as np
import pytest
from skfem import MeshHex, MeshTet

from fesim.snapshots import point_means, points_of_bodies
from fesim.solid.materials import Material
from fesim.solid.spaces import make_spaces
from fesim.solid.stress import corner_stresses, stress_at, stress_rows, stress_tensors
from meshes.structure import Structure

IRON = Material(47.0, 7200.0, 500.0, 104e9, 0.27, 13.7e-6)
STEEL = Material(16.0, 7800.0, 460.0, 200e9, 0.31, 11.0e-6)


@pytest.fixture(params=[MeshHex, MeshTet])
def halves(request):
    """A unit cube of two bodies that meet at x = 0.5 on shared nodes."""
    mesh = request.param.init_tensor(*[np.linspace(0.0, 1.0, 3)] * 3)
    x = mesh.p[0, mesh.t].mean(axis=0)
    cells = np.arange(mesh.nelements)
    structure = Structure(mesh, {"left": cells[x < 0.5], "right": cells[x > 0.5]}, {})
    return structure, make_spaces(mesh)


def stresses(halves, displacement, temperature):
    """Stress at the middle of every cell; left of iron, right of steel."""
    structure, spaces = halves
    mesh = structure.mesh
    rows = stress_rows(
        structure,
        spaces,
        {"left": IRON, "right": STEEL},
        mesh.p[:, mesh.t].mean(axis=1),
        np.arange(mesh.nelements),
    )
    return stress_at(rows, displacement, temperature)


def test_a_heated_body_that_cannot_move_is_pressed_from_all_sides(halves):
    structure, spaces = halves
    found = stresses(halves, np.zeros(spaces.displacement_size), np.full(spaces.heat.N, 30.0))
    for body, material in (("left", IRON), ("right", STEEL)):
        e, nu, alpha = material.youngs_modulus, material.poisson_ratio, material.expansion
        pressed = -e * alpha * 30.0 / (1.0 - 2.0 * nu)
        for stress in found[structure.bodies[body]]:
            np.testing.assert_allclose(stress, pressed * np.eye(3), atol=1e-9 * abs(pressed))


def test_at_a_shared_face_each_cell_has_the_stress_of_its_own_body(halves):
    """Stretched along x with all contraction held: sigma_xx = (lambda + 2 mu) e."""
    structure, spaces = halves
    mesh = structure.mesh
    strain = 1e-4
    displacement = np.zeros(spaces.displacement_size)
    displacement[::3] = strain * spaces.elastic.doflocs[0]
    point = np.array([[0.5], [0.25], [0.25]])
    for body, material in (("left", IRON), ("right", STEEL)):
        cells = structure.bodies[body]
        near = np.linalg.norm(mesh.p[:, mesh.t[:, cells]].mean(axis=1) - point, axis=0)
        rows = stress_rows(
            structure, spaces, {"left": IRON, "right": STEEL}, point, cells[[np.argmin(near)]]
        )
        stress = stress_at(rows, displacement, np.zeros(spaces.heat.N))
        lam, mu = material.lame
        assert stress[0, 0, 0] == pytest.approx((lam + 2.0 * mu) * strain, rel=1e-10)
        assert stress[0, 1, 1] == pytest.approx(lam * strain, rel=1e-10)


def test_a_rigid_motion_has_no_stress_and_shear_gives_twice_mu(halves):
    structure, spaces = halves
    x, y, z = spaces.elastic.doflocs
    turned = np.stack([-y, x, np.zeros_like(z)], axis=1).ravel() * 1e-3 + 0.02
    cold = np.zeros(spaces.heat.N)
    assert np.abs(stresses(halves, turned, cold)).max() <= 1e-9 * IRON.youngs_modulus * 1e-3
    sheared = np.stack([1e-4 * y, np.zeros_like(y), np.zeros_like(y)], axis=1).ravel()
    found = stresses(halves, sheared, cold)[structure.bodies["left"]]
    np.testing.assert_allclose(found[:, 0, 1], 1e-4 * IRON.lame[1], rtol=1e-9)
    np.testing.assert_allclose(found[:, 0, 1], found[:, 1, 0], rtol=1e-12)


def test_corner_stresses_are_exact_where_displacements_are(halves):
    """A bent field of second order, and a temperature of first: each body has its own stress."""
    structure, spaces = halves
    materials = {"left": IRON, "right": STEEL}
    x, y, z = spaces.elastic.doflocs
    field = 1e-3 * np.stack([x * y + z**2, x**2 - y * z, z * x + y], axis=1)
    rise = 10.0 + 5.0 * spaces.heat.doflocs[0] - 3.0 * spaces.heat.doflocs[2]
    found = corner_stresses(structure, spaces, materials, field.ravel(), rise)
    mesh = structure.mesh
    for corner, nodes in enumerate(mesh.t):
        x, y, z = mesh.p[:, nodes]
        slopes = 1e-3 * np.array([[y, x, 2 * z], [2 * x, -z, -y], [z, 0 * x + 1.0, x]])
        for name, material in materials.items():
            own = structure.bodies[name]
            lam, mu = material.lame
            strain = 0.5 * (slopes + slopes.swapaxes(0, 1))[:, :, own]
            grown = (3.0 * lam + 2.0 * mu) * material.expansion * rise[nodes[own]]
            pressed = lam * np.trace(strain) - grown
            exact = 2.0 * mu * strain + np.eye(3)[:, :, None] * pressed
            got = np.moveaxis(stress_tensors(found[corner, own]), 0, -1)
            np.testing.assert_allclose(got, exact, atol=1e-9 * np.abs(exact).max())


def test_bodies_that_share_nodes_have_points_of_their_own(halves):
    structure, _ = halves
    node, corners = points_of_bodies(structure)
    count = structure.mesh.nvertices
    np.testing.assert_array_equal(node[:count], np.arange(count))
    # Nine nodes at x = 0.5.
    assert len(node) == count + 9
    np.testing.assert_array_equal(node[corners], structure.mesh.t)
    left, right = (np.unique(corners[:, cells]) for cells in structure.bodies.values())
    assert not np.intersect1d(left, right).size
    assert np.union1d(left, right).size == len(node)


def test_the_mean_at_a_point_is_that_of_its_cells():
    corners = np.array([[0, 1], [1, 2]])
    values = np.array([[[1.0, 10.0], [3.0, 30.0]], [[5.0, 50.0], [7.0, 70.0]]])
    expected = [[1.0, 10.0], [4.0, 40.0], [7.0, 70.0]]
    np.testing.assert_allclose(point_means(corners, values), expected)
