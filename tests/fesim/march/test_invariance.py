"""What holds for every structure and every run, whatever the numbers."""

from dataclasses import replace
from itertools import islice

import numpy as np
from bars import IRON, STEEL, assemble, driven, surface_law, two_bars
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fesim.case.history import sampled_history
from fesim.march.stepping import iterated, march, staggered

STEP, COUNT = 2.0, 12

divisions = st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(1, 2))
coupling = st.sampled_from([staggered, iterated])
#: Heat in W, at the ends of equal times.
levels = st.lists(st.integers(-400, 400).map(float), min_size=2, max_size=4)

#: A gap is solved to 1e-12 m; sliding makes more of it. The joint has up to 4e13 Pa/m.
GAP, PRESSURE = 1e-11, 400.0


@st.composite
def machines(draw):
    """Two bars between walls, any mesh, materials, friction and preload."""
    structure = two_bars(draw(divisions), draw(divisions), tetrahedra=draw(st.booleans()))
    law = surface_law(
        friction=draw(st.sampled_from([0.0, 0.15, 0.6, 1.0])),
        preload=draw(st.floats(0.2e6, 15e6)),
    )
    material = st.sampled_from([IRON, STEEL])
    return {
        "structure": structure,
        "materials": (draw(material), draw(material)),
        "law": law,
        "convection": {"bottom": draw(st.floats(0.0, 200.0))},
        "sources": {"left_top": 1.0},
        "fixed": ["left_end", "right_end"],
        "grid": (draw(st.integers(1, 3)), draw(st.integers(1, 2))),
        "step": STEP,
    }


def assembled(given):
    return assemble(**given)


def histories(values):
    return sampled_history(np.linspace(0.0, STEP * COUNT, len(values)), np.array(values))


def run(made, values, advance, start=None, count=COUNT):
    marching = march(made.machine, driven(made.machine, histories(values)), advance, start)
    return list(islice(marching, count))


@given(machines(), levels, coupling)
@settings(max_examples=15, deadline=None)
def test_heat_is_neither_made_nor_lost_and_no_joint_pulls(parts, values, advance):
    made = assembled(parts)
    machine = made.machine
    for step in run(made, values, advance):
        assert abs(step.heat_balance) <= 1e-8
        assert step.residual <= 1e-11
        pressure = step.state.pressure
        assert pressure.min() >= 0.0
        assert (machine.contact.conductance(pressure)[pressure == 0.0] == 0.0).all()
        # Heat goes down the jump, and none crosses a joint that was open.
        jump = machine.thermal.jump @ step.state.temperature
        area = machine.contact.elastic.area[: machine.contact.count]
        scale = np.abs(step.heat_flow).max()
        expected = step.conductance * area * jump
        np.testing.assert_allclose(step.heat_flow, expected, atol=1e-7 * scale + 1e-9)
        assert (np.abs(step.heat_flow[step.conductance == 0.0]) <= 1e-12 * scale).all()


@given(machines())
@settings(max_examples=8, deadline=None)
def test_the_compliance_is_reciprocal_and_gives_way_to_every_load(parts):
    """Betti, to the rounding of two solves that the condensation takes out; energy is positive."""
    made = assembled(parts)
    rows = made.parts.operators.gap.toarray()
    influence = made.field.respond(rows.T, "rows")
    compliance = rows @ influence
    largest = np.abs(compliance).max()
    np.testing.assert_allclose(compliance, compliance.T, atol=1e-10 * largest)
    np.testing.assert_allclose(
        made.machine.contact.elastic.compliance, compliance, atol=1e-10 * largest
    )
    assert np.linalg.eigvalsh(made.machine.contact.elastic.compliance).min() > 0.0


def turned(structure, rotation, shift):
    mesh = structure.mesh
    points = rotation.apply(mesh.p.T).T + shift[:, None]
    probes = {
        name: replace(probe, position=tuple(rotation.apply(probe.position) + shift))
        for name, probe in structure.probes.items()
    }
    return replace(structure, mesh=type(mesh)(points, mesh.t), probes=probes)


@given(machines(), levels, st.integers(0, 2**32 - 1))
@settings(max_examples=8, deadline=None)
def test_a_turned_structure_does_the_same(parts, values, seed):
    random = np.random.default_rng(seed)
    rotation, shift = Rotation.random(random_state=random), random.uniform(-1.0, 1.0, 3)
    here = run(assembled(parts), values, staggered)
    there = run(
        assembled(parts | {"structure": turned(parts["structure"], rotation, shift)}),
        values,
        staggered,
    )
    # Turned, contact elements may be counted from the other end.
    last, other = here[-1], there[-1]
    size = np.abs(last.state.temperature).max()
    np.testing.assert_allclose(
        other.state.temperature, last.state.temperature, atol=1e-7 * size + 1e-9
    )
    np.testing.assert_allclose(
        np.sort(other.state.pressure), np.sort(last.state.pressure), rtol=1e-5, atol=PRESSURE
    )
    moved = last.displacement.reshape(-1, 3)
    np.testing.assert_allclose(
        other.displacement.reshape(-1, 3),
        rotation.apply(moved),
        atol=1e-6 * np.abs(moved).max() + GAP,
    )


def renumbered(structure, seed):
    """The same structure with nodes and cells in another order."""
    random = np.random.default_rng(seed)
    mesh = structure.mesh
    node, cell = random.permutation(mesh.p.shape[1]), random.permutation(mesh.nelements)
    new_node = np.argsort(node)
    other = type(mesh)(mesh.p[:, node], new_node[mesh.t[:, cell]])
    new_cell = np.argsort(cell)

    def facets_of(facets):
        corners = np.sort(new_node[mesh.facets[:, facets]], axis=0)
        place = {tuple(column): i for i, column in enumerate(np.sort(other.facets, axis=0).T)}
        return np.array([place[tuple(column)] for column in corners.T])

    return replace(
        structure,
        mesh=other,
        bodies={name: np.sort(new_cell[cells]) for name, cells in structure.bodies.items()},
        surfaces={name: facets_of(facets) for name, facets in structure.surfaces.items()},
    )


@given(machines(), levels, st.integers(0, 2**32 - 1))
@settings(max_examples=8, deadline=None)
def test_numbers_of_nodes_and_cells_mean_nothing(parts, values, seed):
    here = run(assembled(parts), values, staggered)[-1]
    other = assembled(parts | {"structure": renumbered(parts["structure"], seed)})
    there = run(other, values, staggered)[-1]
    np.testing.assert_allclose(there.state.pressure, here.state.pressure, rtol=1e-5, atol=PRESSURE)
    size = np.abs(here.displacement).max()
    np.testing.assert_allclose(there.displacement, here.displacement, atol=1e-6 * size + GAP)
    np.testing.assert_allclose(
        there.heat_flow, here.heat_flow, atol=1e-6 * np.abs(here.heat_flow).max() + 1e-6
    )


@given(machines(), levels, st.integers(1, COUNT - 1), coupling)
@settings(max_examples=8, deadline=None)
def test_a_run_cut_in_two_is_the_same_to_the_last_bit(parts, values, at, advance):
    made = assembled(parts)
    whole = run(made, values, advance)
    first = run(made, values, advance, count=at)
    rest = run(made, values, advance, start=first[-1].state, count=COUNT - at)
    for one, other in zip(whole, [*first, *rest], strict=True):
        np.testing.assert_array_equal(one.displacement, other.displacement)
        np.testing.assert_array_equal(one.state.temperature, other.state.temperature)
        np.testing.assert_array_equal(one.state.pressure, other.state.pressure)
