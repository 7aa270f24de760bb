"""Blocks of contact elements: one inverse each, and the equilibria and marches of a whole one."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from bars import surface_law
from random_joints import TIGHT, problem_of, settled, structure_stiffness

from benchmarks.performance.pillar import pillar_case
from fesim.joint.blocks import (
    WHOLE,
    blocks_of,
    coupling,
    one_block,
    part_of,
    side_by_side,
    unknowns_of,
)
from fesim.joint.frozen_tangent import FROZEN, frozen_tangents
from fesim.joint.gap import solve_gap
from fesim.march.kernel import new_kept, step_kernel
from fesim.march.settling import initial_state
from fesim.march.stepping import march_along, plainly_staggered, staggered
from fesim.setup.loads import march_inputs
from fesim.setup.machine import set_up

#: Contact elements of the joints, in all more than what stays whole.
COUNTS = (40, 30, 40)
TOTAL = sum(COUNTS)
JOINTS = np.split(np.arange(TOTAL), np.cumsum(COUNTS)[:-1])


def coupled_problem(seed, size, friction, tied=()):
    """Joints of a random structure each, with springs of the given stiffness, N/m, between them."""
    rng, stiffness = np.random.default_rng(seed), np.zeros((3 * TOTAL, 3 * TOTAL))
    for joint in JOINTS:
        rows = unknowns_of(joint, TOTAL)
        stiffness[np.ix_(rows, rows)] = structure_stiffness(rng, joint.size, floating=False)
    for a, b, spring in tied:
        one, other = (unknowns_of(JOINTS[k][:30], TOTAL) for k in (a, b))
        stiffness[one, one] += spring
        stiffness[other, other] += spring
        stiffness[one, other] -= spring
        stiffness[other, one] -= spring
    problem, compliance = problem_of(stiffness, friction)
    return problem, compliance @ (stiffness @ (size * rng.uniform(-1.0, 1.0, 3 * TOTAL)))


#: Each joint between a piece and the next one, of which the first stands on the ground.
CHAIN = np.zeros((TOTAL, 4))
for number, elements in enumerate(JOINTS):
    CHAIN[elements, number], CHAIN[elements, number + 1] = -1.0, 1.0
STANDING = np.eye(6, 24)


def divided(problem):
    return blocks_of(problem, COUNTS, CHAIN, STANDING)


def test_there_are_tests_of_several_blocks():
    assert TOTAL > WHOLE


def test_joints_that_do_not_feel_each_other_are_blocks():
    blocks = divided(coupled_problem(1, 1e-6, 0.3)[0])
    np.testing.assert_array_equal(blocks.starts, [0, *np.cumsum(COUNTS)])
    np.testing.assert_array_equal(blocks.elements, np.arange(TOTAL))


def test_joints_that_are_tied_together_are_one_block():
    problem, _ = coupled_problem(1, 1e-6, 0.3, tied=[(0, 2, 1e12)])
    blocks = divided(problem)
    assert blocks.starts.tolist() == [0, 80, 110]
    np.testing.assert_array_equal(blocks.elements, np.concatenate([JOINTS[k] for k in (0, 2, 1)]))
    for block in range(2):
        elements, springs, compliance, columns = part_of(blocks, block)
        rows = unknowns_of(elements, TOTAL)
        np.testing.assert_array_equal(columns, compliance.T)
        np.testing.assert_array_equal(springs, problem.springs[rows])
        np.testing.assert_array_equal(compliance, problem.compliance[np.ix_(rows, rows)])


def test_few_contact_elements_are_one_block():
    problem, _ = coupled_problem(1, 1e-6, 0.3)
    few = unknowns_of(np.arange(WHOLE), TOTAL)
    compliance = problem.compliance[np.ix_(few, few)]
    own = replace(problem, springs=problem.springs[few], compliance=compliance)
    hung = CHAIN[:WHOLE], STANDING
    assert blocks_of(own, (40, 30, WHOLE - 70), *hung).starts.size == 2
    assert blocks_of(problem, (TOTAL,), CHAIN, STANDING).starts.size == 2


def test_joints_of_a_chain_lie_on_no_loop():
    assert len(set(side_by_side(JOINTS, CHAIN, STANDING))) == 3


def test_joints_that_hold_a_body_side_by_side_are_together():
    rails = CHAIN.copy()
    rails[JOINTS[2]] = CHAIN[JOINTS[1][0]]
    first, second, third = side_by_side(JOINTS, rails, STANDING)
    assert first != second
    assert second == third


def test_a_chain_that_ends_on_the_ground_again_is_a_loop():
    both_ends = np.vstack([STANDING, np.eye(6, 24, 18)])
    assert len(set(side_by_side(JOINTS, CHAIN, both_ends))) == 1
    middle = np.vstack([STANDING, np.eye(6, 24, 12)])
    first, second, third = side_by_side(JOINTS, CHAIN, middle)
    assert first == second != third


def test_a_bolt_beside_a_joint_closes_a_loop():
    bolt = np.zeros((1, 24))
    bolt[0, [0, 12]] = 1.0, -1.0  # over two joints
    first, second, third = side_by_side(JOINTS, CHAIN, np.vstack([STANDING, bolt]))
    assert first == second != third


def test_the_coupling_is_the_norm_of_what_joints_do_to_each_other():
    problem, _ = coupled_problem(2, 1e-6, 0.3, tied=[(0, 1, 1e10)])
    a, b = (unknowns_of(JOINTS[k], TOTAL) for k in (0, 1))
    scaled = np.sqrt(np.outer(problem.springs[a], problem.springs[b]))
    exact = np.linalg.norm(scaled * problem.compliance[np.ix_(a, b)], 2)
    assert coupling(problem.springs, problem.compliance, a, b) == pytest.approx(exact, rel=0.05)
    assert 0.0 < exact < 1.0


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("spring", [0.0, 1e9, 3e9])
def test_a_sweep_over_blocks_finds_the_equilibrium_of_the_plain_method(seed, spring):
    tied = [(0, 1, spring), (1, 2, spring)] if spring else []
    problem, thermal_gap = coupled_problem(seed, 1e-7, 0.15, tied)
    zero, blocks = np.zeros((3, TOTAL)), divided(problem)
    assert blocks.starts.size == 4
    theirs = solve_gap(problem, thermal_gap, zero[1:], zero, TIGHT)
    given = problem, [(surface_law(0.15), TOTAL)], thermal_gap, zero[1:], zero
    found, residual, gap, slip = settled(*given, frozen_tangents(blocks))
    assert found
    assert residual <= TIGHT
    left = problem.residual(gap, problem.law(gap, zero[1:]), thermal_gap)
    assert np.abs(left).max() <= 2.0 * TIGHT
    np.testing.assert_allclose(gap, theirs.gap, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(slip, theirs.traction.slip, rtol=1e-9, atol=1e-13)


def test_the_reach_bounds_the_gaps_of_all_tractions_that_stay_below_the_springs():
    problem, _ = coupled_problem(2, 1e-7, 0.15)
    blocks, compliance = divided(problem), problem.compliance
    share = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 3 * TOTAL))
    assert np.abs(share * problem.springs @ compliance.T).max() <= blocks.reach
    worst = np.argmax(np.abs(compliance) @ problem.springs)
    most = compliance[worst] @ (np.sign(compliance[worst]) * problem.springs)
    np.testing.assert_allclose(most, blocks.reach, rtol=1e-12)


def test_only_the_frozen_tangent_of_a_joint_that_changes_is_updated():
    problem, thermal_gap = coupled_problem(3, 1e-7, 0.15)
    blocks, zero = divided(problem), np.zeros((3, TOTAL))
    tangents, laws = frozen_tangents(blocks), [(surface_law(0.15), TOTAL)]
    own = np.zeros_like(thermal_gap)
    own[unknowns_of(JOINTS[1], TOTAL)] = thermal_gap[unknowns_of(JOINTS[1], TOTAL)]
    gap, slip = zero, zero[1:]
    for factor in np.linspace(0.0, 8.0, 40):
        driven = problem, laws, factor * own, slip, gap, tangents
        solved, _, gap, slip = settled(*driven, tolerance=1e-13)
        assert solved
    assert tangents.every.about[1, FROZEN] > 2
    assert tangents.every.about[[0, 2], FROZEN].tolist() == [1, 1]


def test_one_block_holds_all_rows_in_their_order():
    compliance = np.arange(144.0).reshape(12, 12)
    columns = np.ascontiguousarray(compliance.T)
    blocks = one_block(np.arange(12.0), compliance, columns)
    assert blocks.elements.tolist() == [0, 1, 2, 3]
    assert blocks.starts.tolist() == [0, 4]
    for given, whole in zip(part_of(blocks, 0)[2:], (compliance, columns), strict=True):
        np.testing.assert_array_equal(given, whole)


@pytest.fixture(scope="module")
def pillar(tmp_path_factory):
    """Six blocks with 20 contact elements in each of five joints, and the inputs of 60 steps."""
    case = pillar_case(tmp_path_factory.mktemp("pillar"), 5, 4, 5)
    return set_up(case).machine, march_inputs(case).at(2.0 * np.arange(1, 61))


def marched(machine, inputs, start=None, advance=staggered):
    return list(march_along(machine, inputs, advance, start or initial_state(machine)))


def plainly(machine, inputs):
    """Displacements of a march without blocks, frozen tangents and machine code."""
    contact = replace(machine.contact)
    vars(contact)["settle"] = partial(solve_gap, contact.gap_problem)
    steps = marched(replace(machine, contact=contact), inputs, advance=plainly_staggered)
    return np.vstack([track.displacement for track in steps])


def test_a_machine_of_many_joints_marches_in_blocks_as_it_does_plainly(pillar):
    machine, inputs = pillar
    assert step_kernel(machine).blocks.starts.tolist() == [0, 20, 40, 60, 80, 100]
    found = np.vstack([track.displacement for track in marched(machine, inputs)])
    plain = plainly(machine, inputs)
    assert np.abs(plain).max() > 1e-6
    np.testing.assert_allclose(found, plain, rtol=0.0, atol=1e-12)


def test_plain_steps_take_over_where_sweeps_fail_and_f_transposed_is_not_stored(
    pillar, monkeypatch
):
    """Fifty times the heat; as with many contact elements."""
    monkeypatch.setattr("fesim.joint.blocks.MANY", 0)
    machine, inputs = pillar
    strong = inputs[:20] * np.array([50.0, 1.0])
    kernel, start = step_kernel(machine), initial_state(machine)
    assert not kernel.machine.joint.columns.size
    _, taken, _ = kernel.run(new_kept(kernel.machine, kernel.blocks), start, strong)
    assert taken < len(strong)
    found = np.vstack([track.displacement for track in marched(machine, strong)])
    np.testing.assert_allclose(found, plainly(machine, strong), rtol=0.0, atol=1e-12)


def test_steps_that_are_settled_one_by_one_go_in_blocks_too(pillar):
    machine, inputs = pillar
    contact, sized = machine.contact, {"rtol": 0.0, "atol": 1e-12}
    zero, driven = np.zeros((3, 100)), inputs[:12]
    for step in marched(machine, driven)[0].temperature:
        opened = contact.elastic.thermal_gap @ step
        found = contact.settle(opened, zero[1:], zero)
        plain = solve_gap(contact.gap_problem, opened, zero[1:], zero)
        assert found.residual <= contact.tolerance
        np.testing.assert_allclose(found.gap, plain.gap, **sized)
        np.testing.assert_allclose(found.traction.slip, plain.traction.slip, **sized)


def test_a_march_in_blocks_goes_on_from_a_saved_state_with_the_same_bits(pillar):
    machine, inputs = pillar
    (whole,) = marched(machine, inputs)
    state = whole.step(24).state
    (rest,) = marched(machine, inputs[25:], state)
    np.testing.assert_array_equal(rest.displacement, whole.displacement[25:])
    np.testing.assert_array_equal(rest.frozen, whole.frozen[25:])
