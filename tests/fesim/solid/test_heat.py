"""Heat conduction through bodies, films and joints against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from bars import AREA, DEPTH, IRON, LEFT, STEEL, WIDTH, conduct, level, two_bars
from skfem import FacetBasis, MeshHex, MeshTet

from fesim.march.heat_step import heat_balance, heat_step
from fesim.solid.heat import HeatSource, ThermalLoads, flux_form, heat_operators
from fesim.solid.spaces import make_spaces
from meshes.structure import Structure

FOREVER = 1e15  # s: so long an implicit Euler step ends in the steady state
MESHES = {
    "matching": two_bars(left=(3, 3, 2), right=(4, 3, 2)),
    "not matching": two_bars(left=(3, 3, 2), right=(2, 4, 3)),
    "tetrahedra": two_bars(left=(2, 2, 2), right=(3, 3, 2), tetrahedra=True),
}


def block(kind):
    """A block of two materials meeting at x = 0.5 on shared nodes; nodes inside are shifted."""
    lines = [np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 4), np.linspace(0.0, 1.0, 4)]
    mesh = (MeshHex if kind == "hexahedra" else MeshTet).init_tensor(*lines)
    inside = (np.abs(mesh.p - 0.5) < 0.49).all(axis=0) & (np.abs(mesh.p[0] - 0.5) > 0.1)
    points = mesh.p.copy()
    points[:, inside] += np.random.default_rng(1).uniform(-0.04, 0.04, (3, inside.sum()))
    mesh = type(mesh)(points, mesh.t)
    centres = mesh.p[0, mesh.t].mean(axis=0)
    cells = np.arange(mesh.nelements)
    facets = mesh.boundary_facets()
    middle = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    return Structure(
        mesh,
        bodies={"left": cells[centres < 0.5], "right": cells[centres > 0.5]},
        surfaces={
            "all": facets,
            "hot": facets[middle[0] > 1.0 - 1e-9],
            "cold": facets[middle[0] < 1e-9],
        },
    )


@pytest.mark.parametrize("kind", ["hexahedra", "tetrahedra"])
def test_two_conductivities_in_series_share_the_flux(kind):
    """A temperature with a kink at the interface, in balance with the flux through the ends."""
    structure = block(kind)
    basis = make_spaces(structure.mesh).heat
    heat = heat_operators(structure, basis, {"left": IRON, "right": STEEL}, ThermalLoads())
    flux = 1000.0
    x = basis.doflocs[0]
    temperature = flux * (
        np.minimum(x, 0.5) / IRON.conductivity + np.maximum(x - 0.5, 0.0) / STEEL.conductivity
    )

    def through(name):
        return flux * flux_form.assemble(
            FacetBasis(structure.mesh, basis.elem, facets=structure.surfaces[name])
        )

    np.testing.assert_allclose(
        heat.conduction @ temperature, through("hot") - through("cold"), atol=1e-11 * flux
    )


@pytest.mark.parametrize("kind", ["hexahedra", "tetrahedra"])
def test_operators_hold_the_energy(kind):
    """Conduction makes no heat, the capacity is the body's, films and sources are what is said."""
    structure = block(kind)
    basis = make_spaces(structure.mesh).heat
    convection, source = {"all": 6.0, "hot": 4.0}, HeatSource(90.0, surface="cold")
    heat = heat_operators(
        structure, basis, {"left": IRON, "right": STEEL}, ThermalLoads(convection, [source])
    )
    np.testing.assert_allclose(heat.conduction.sum(axis=0), 0.0, atol=1e-12 * IRON.conductivity)
    stored = [m.density * m.heat_capacity for m in (IRON, STEEL)]
    assert heat.capacity.sum() == pytest.approx(0.5 * sum(stored), rel=1e-12)
    assert heat.convection.sum() == pytest.approx(6.0 * 6.0 + 4.0, rel=1e-12)
    assert heat.inputs[:, 0].sum() == pytest.approx(90.0, rel=1e-12)
    assert (heat.inputs[:, 0] >= 0.0).all()
    for matrix in (heat.capacity, heat.conduction, heat.convection):
        np.testing.assert_allclose((matrix - matrix.T).toarray(), 0.0, atol=1e-9)


@pytest.mark.parametrize("mesh", MESHES)
def test_joint_takes_from_one_side_what_it_gives_to_the_other(mesh):
    made = conduct(MESHES[mesh], convection={"left_end": 10.0})
    jump = made.operators.jump
    np.testing.assert_allclose(jump.sum(axis=1), 0.0, atol=1e-13)
    assert made.operators.area.sum() == pytest.approx(AREA, rel=1e-12, abs=0.0)
    one_side = made.left_nodes.astype(float)
    np.testing.assert_allclose(jump @ one_side, 1.0, rtol=1e-12)


def test_jump_is_the_mean_over_each_contact_element_also_where_they_differ_in_size():
    """Side b lacks a quarter: half of the last contact element, a quarter of the middle one."""
    bars = two_bars(right=(4, 2, 2))
    side = bars.surfaces["joint.b"]
    _, y, z = bars.mesh.p[:, bars.mesh.facets[:, side]].mean(axis=1)
    kept = side[(y < WIDTH / 2) | (z < DEPTH / 2)]
    made = conduct(
        replace(bars, surfaces=bars.surfaces | {"joint.b": kept}),
        convection={"left_end": 1.0},
        grid=(3, 1),
    )
    share = np.array([1.0, 0.75, 0.5])
    np.testing.assert_allclose(made.operators.area, share * AREA / 3, rtol=1e-9)
    y = made.spaces.heat.doflocs[1]
    middles = WIDTH * np.array([1 / 6, (5 / 12 + 0.5 * 7 / 12) / 1.5, 5 / 6])
    left = made.left_nodes
    jump = made.operators.jump
    np.testing.assert_allclose(jump @ np.where(left, y, 0.0), middles, rtol=1e-9)
    np.testing.assert_allclose(jump @ np.where(left, 0.0, y), -middles, rtol=1e-9)


def test_an_uneven_joint_conducts_where_it_is_pressed():
    """Contact elements 1 and 3 of three carry all the heat when 2 is open."""
    made = conduct(
        MESHES["not matching"],
        convection={"left_end": 1e-3, "right_end": 500.0},
        sources={"left_end": 10.0},
        grid=(3, 1),
        step=FOREVER,
    )
    conductance = np.array([2000.0, 0.0, 2000.0]) * made.operators.area
    _, flow = heat_step(
        made.thermal, np.zeros(made.spaces.heat.N), level(made.thermal, 1.0), conductance
    )
    assert flow.sum() == pytest.approx(10.0, rel=1e-3)  # less what the left film takes
    assert flow[[0, 2]].min() > 1.0
    assert abs(flow[1]) < 1e-12 * flow.sum()


@pytest.mark.parametrize("mesh", ["matching", "not matching"])
def test_nothing_gets_colder_when_heat_comes_in(mesh):
    """Steps far shorter than the time heat takes through an element: no undershoot."""
    made = conduct(
        MESHES[mesh], convection={"right_end": 50.0}, sources={"left_end": 10.0}, step=0.5
    )
    temperature = np.zeros(made.spaces.heat.N)
    joint = 18806.0 * made.operators.area
    for _ in range(20):
        before = temperature
        temperature, _ = heat_step(made.thermal, before, level(made.thermal, 1.0), joint)
        assert (temperature - before).min() >= -1e-12 * temperature.max()


def test_the_ambient_carries_a_body_along():
    """A body that nothing heats ends at the temperature of the air around it."""
    made = conduct(
        MESHES["matching"], convection={"right_end": 50.0, "left_end": 6.0}, step=FOREVER
    )
    joint = 18806.0 * made.operators.area
    warm, flow = heat_step(made.thermal, np.zeros(made.spaces.heat.N), np.array([7.0]), joint)
    np.testing.assert_allclose(warm, 7.0, rtol=1e-9)
    np.testing.assert_allclose(flow, 0.0, atol=1e-9)


def test_heat_through_held_surfaces_is_in_the_balance():
    made = conduct(MESHES["not matching"], convection={"top": 80.0}, held=["left_end"], step=5.0)
    joint = 18806.0 * made.operators.area
    before, inputs = np.zeros(made.spaces.heat.N), np.array([2.0, 50.0])
    for _ in range(10):
        after, flow = heat_step(made.thermal, before, inputs, joint)
        assert abs(heat_balance(made.thermal, before, after, inputs, flow)) < 1e-12
        before = after


def test_heat_in_a_volume_raises_the_whole_body_evenly_at_first():
    source = HeatSource(12.0, body="left")
    structure, basis = MESHES["matching"], make_spaces(MESHES["matching"].mesh).heat
    heat = heat_operators(
        structure, basis, {"left": IRON, "right": STEEL}, ThermalLoads(sources=[source])
    )
    assert heat.inputs[:, 0].sum() == pytest.approx(12.0, rel=1e-12)
    rate = heat.inputs[:, 0] / heat.capacity.diagonal()
    body = np.unique(structure.mesh.t[:, structure.bodies["left"]])
    expected = 12.0 / (LEFT * AREA * IRON.density * IRON.heat_capacity)
    np.testing.assert_allclose(rate[body], expected, rtol=1e-12)
    assert np.count_nonzero(rate) == body.size
