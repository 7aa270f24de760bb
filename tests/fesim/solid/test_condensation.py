"""The condensed march against one that solves for every unknown and refactorises every time."""

import gc
import weakref

import numpy as np
import pytest
from bars import IRON, STEEL, assemble, conduct, driven, surface_law, two_bars

from benchmarks.performance.plain_set_up import plain_condensation
from fesim.case.history import triangle_history
from fesim.march.stepping import iterated, march
from fesim.solid import linear_solver, substructures
from thermojoint.artefacts.errors import InputError

STEP, COUNT = 2.0, 25


def heated_bars(friction, **changes):
    """Heated on the top of the left bar, so that the joint turns, slides and partly opens."""
    given = {
        "law": surface_law(friction),
        "convection": {"bottom": 50.0},
        "sources": {"left_top": 400.0},
        "fixed": ["left_end", "right_end"],
        "grid": (3, 2),
        "step": STEP,
    }
    return assemble(two_bars(left=(2, 3, 1), right=(2, 2, 1)), **(given | changes))


def test_field_on_demand_has_the_gaps_and_probes_of_the_march():
    made = heated_bars(0.1)
    history = triangle_history(2.0, 60.0)
    for step, _ in zip(
        march(made.machine, driven(made.machine, history), iterated), range(5), strict=False
    ):
        field = made.field.solve(step.state.temperature, step.remainder)
        gaps = (made.field.gap @ field).reshape(3, -1)
        np.testing.assert_allclose(gaps, step.state.gap, rtol=0.0, atol=2e-11)
        np.testing.assert_allclose(made.probes @ field, step.displacement, rtol=0.0, atol=1e-15)
        held = np.setdiff1d(np.arange(field.size), made.elastic.free)
        np.testing.assert_array_equal(field[held], 0.0)


def test_condensed_matrices_are_what_they_are_called():
    made = heated_bars(0.6)
    thermal, heat, jump = made.machine.thermal, made.parts.heat, made.parts.operators.jump
    matrix = (heat.capacity / STEP + heat.conduction + heat.convection).toarray()
    influence = np.linalg.solve(matrix, jump.toarray().T)
    np.testing.assert_allclose(thermal.influence, influence, rtol=0.0, atol=1e-12 * influence.max())
    np.testing.assert_allclose(thermal.joint_influence, jump @ influence, rtol=1e-9, atol=1e-12)
    elastic, free = made.elastic, made.elastic.free
    gap = made.parts.operators.gap[:, free].toarray()
    condensed = made.machine.contact.elastic
    springs = gap.T @ ((condensed.area * condensed.reference)[:, None] * gap)
    whole = np.linalg.inv(elastic.stiffness[free][:, free].toarray() + springs)
    load = elastic.thermal_load[free].toarray()
    probes = made.probes[:, free].toarray()
    for ours, theirs in (
        (condensed.compliance, gap @ whole @ gap.T),
        (condensed.thermal_gap, gap @ whole @ load),
        (condensed.probe_compliance, probes @ whole @ gap.T),
        (condensed.probe_thermal, probes @ whole @ load),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-9 * np.abs(theirs).max())


def test_both_solvers_condense_to_the_same_machine():
    pytest.importorskip("pypardiso")
    one, other = (heated_bars(0.6, solver=solver) for solver in ("pardiso", "superlu"))
    for name in ("compliance", "thermal_gap", "probe_compliance", "probe_thermal"):
        first, second = (getattr(made.machine.contact.elastic, name) for made in (one, other))
        np.testing.assert_allclose(first, second, rtol=0.0, atol=1e-10 * np.abs(first).max())


def test_the_step_length_changes_the_heat_equation_only():
    two, four = (
        conduct(two_bars(), convection={"bottom": 50.0}, sources={"left_top": 1.0}, step=step)
        for step in (2.0, 4.0)
    )
    np.testing.assert_allclose(
        two.thermal.capacity_rate.toarray(), 2.0 * four.thermal.capacity_rate.toarray(), rtol=1e-14
    )
    np.testing.assert_allclose(two.thermal.balance.stored, four.thermal.balance.stored, rtol=1e-14)


SUPPORTS = {
    "both held": {"fixed": ["left_end", "right_end"]},
    "one held by the joint": {"fixed": ["left_end"]},
    "one held by the joint but for sliding": {
        "symmetry": {"left_end": "x", "bottom": "y", "back": "z"}
    },
}


@pytest.mark.parametrize("tetrahedra", [False, True])
@pytest.mark.parametrize("supports", SUPPORTS.values(), ids=SUPPORTS)
def test_pieces_tied_by_springs_are_the_whole_structure(supports, tetrahedra):
    structure = two_bars(left=(2, 3, 1), right=(2, 2, 1), tetrahedra=tetrahedra)
    made = assemble(structure, materials=(IRON, STEEL), **supports)
    ours, joints = made.machine.contact.elastic, made.parts.operators
    plain = plain_condensation(made.elastic, joints, ours.reference, made.probes)
    for name in ("compliance", "thermal_gap", "probe_compliance", "probe_thermal"):
        one, other = getattr(ours, name), getattr(plain, name)
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-10 * np.abs(other).max())
    assert len(made.field.structure.substructures) == 2


def test_a_body_that_its_supports_hold_has_no_anchors():
    anchored = {
        name: [one.anchored.size for one in heated(supports).field.structure.substructures]
        for name, supports in SUPPORTS.items()
    }
    assert anchored["both held"] == [0, 0]
    assert anchored["one held by the joint"] == [0, 9]
    assert anchored["one held by the joint but for sliding"][0] == 0


def heated(supports):
    return assemble(two_bars(left=(2, 3, 1), right=(2, 2, 1)), **supports)


def test_bodies_that_nothing_holds_are_refused():
    with pytest.raises(InputError, match=r"stiffness.*free to move"):
        heated({"fixed": []})


def test_columns_are_solved_a_few_at_a_time(monkeypatch):
    whole = heated(SUPPORTS["one held by the joint"]).machine.contact.elastic
    monkeypatch.setattr(substructures, "AT_ONCE", 2000)
    parts = heated(SUPPORTS["one held by the joint"]).machine.contact.elastic
    for name in ("compliance", "thermal_gap", "probe_thermal"):
        one, other = getattr(parts, name), getattr(whole, name)
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-11 * np.abs(other).max())


def test_a_factor_is_gone_before_the_next_one_is_made(monkeypatch):
    made = heated(SUPPORTS["both held"])
    alive, most = weakref.WeakSet(), []

    def factorise(*given):
        gc.collect()
        factor = linear_solver.factorise_upper(*given)
        alive.add(factor.solve)
        most.append(len(alive))
        return factor

    monkeypatch.setattr(substructures, "factorise_upper", factorise)
    gap, springs = (
        made.field.gap,
        made.machine.contact.elastic.area * made.machine.contact.elastic.reference,
    )
    each = substructures.substructures(made.elastic.pieces(), gap, springs)
    heat = made.parts.spaces.heat.N
    found = substructures.tied(substructures.untied(each, gap, springs, made.probes, heat))
    assert most == [1, 1]
    np.testing.assert_allclose(
        found.compliance, made.machine.contact.elastic.compliance, rtol=0.0, atol=1e-20
    )
