"""The march: what every step must fulfil, and that it can be cut, stopped and continued."""

import copy
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
from bars import assemble, driven, surface_law, two_bars, with_tolerance
from scipy.spatial import cKDTree

from benchmarks.robustness import STEPS, marches
from fesim.case.history import step_history
from fesim.case.schema import case_from_data
from fesim.joint.gap import TOLERANCE
from fesim.joint.law import evaluate
from fesim.march.stepping import iterated, march, staggered
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts.errors import ConvergenceError

#: Heat of the whole machine at the reference step, W.
POWER = 590.0


def take(machine, history, count, advance=staggered, start=None):
    return list(islice(march(machine, driven(machine, history), advance, start), count))


def heated_bars(step=2.0, friction=0.3):
    return assemble(
        two_bars(left=(2, 3, 1), right=(2, 2, 1)),
        law=surface_law(friction),
        convection={"bottom": 50.0},
        sources={"left_top": 300.0},
        fixed=["left_end", "right_end"],
        step=step,
    ).machine


@pytest.fixture(scope="module")
def bars():
    return heated_bars()


@pytest.fixture(scope="module")
def hard_run(coarse_setup):
    """35 min at three times the reference heat."""
    return take(coarse_setup.machine, step_history(3.0 * POWER), 1050)


def test_every_step_balances_heat_and_closes_its_gaps(hard_run, coarse_setup):
    assert max(step.residual for step in hard_run) <= 1e-11
    assert max(abs(step.heat_balance) for step in hard_run) <= 1e-8
    # ... on a run in which the joint slides and its pressures more than halve and double.
    preload = coarse_setup.machine.contact.preload[0]
    last = hard_run[-1].state
    assert last.pressure.min() < 0.5 * preload
    assert last.pressure.max() > 2.0 * preload
    assert np.abs(last.slip).max() > 0.1e-6


def test_no_pressure_pulls_and_no_shear_exceeds_friction(hard_run, coarse_setup):
    machine = coarse_setup.machine
    for before, step in pairwise(hard_run):
        state = step.state
        assert state.pressure.min() >= 0.0
        shear = machine.contact.traction(state.gap, before.state.slip).value[1:]
        np.testing.assert_array_less(np.hypot(*shear), 0.6 * state.pressure * (1 + 1e-9) + 1e-6)


def test_every_joint_has_its_own_law(bars):
    """Contact elements 1-2 lubricated and lightly loaded, 3-6 as before."""
    other = surface_law(friction=0.05, preload=1e6)
    usual = bars.contact.laws[0][0]
    machine = bars.with_laws([(other, 2), (usual, 4)])
    np.testing.assert_array_equal(
        machine.contact.preload, [1e6, 1e6, 4.41e6, 4.41e6, 4.41e6, 4.41e6]
    )
    rng = np.random.default_rng(8)
    gap, slip = rng.uniform(-1e-6, 1e-6, (3, 6)), np.zeros((2, 6))
    together = machine.contact.traction(gap, slip)
    pressure = machine.contact.preload + together.value[0]
    for law, at in ((other, slice(0, 2)), (usual, slice(2, 6))):
        alone = evaluate(law, gap[:, at], slip[:, at])
        for ours, theirs in (
            (together.value[:, at], alone.value),
            (together.tangent[..., at], alone.tangent),
            (together.slip[:, at], alone.slip),
            (machine.contact.conductance(pressure)[at], law.conductance(pressure[at])),
        ):
            scale = np.abs(theirs).max()
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-12 * scale)
    steps = take(machine, step_history(1.0), 10)
    assert max(step.residual for step in steps) <= 1e-11
    assert max(abs(step.heat_balance) for step in steps) <= 1e-8


def test_time_is_the_step_index_times_the_step(hard_run, coarse_response):
    assert [step.state.index for step in hard_run] == list(range(1, 1051))
    np.testing.assert_allclose(coarse_response["time"], 2.0 * np.arange(31), rtol=1e-12)


def test_at_rest_nothing_happens(bars):
    for step in take(bars, step_history(0.0), 3):
        np.testing.assert_allclose(step.state.temperature, 0.0, atol=1e-12)
        np.testing.assert_allclose(step.displacement, 0.0, atol=1e-20)
        np.testing.assert_allclose(step.state.pressure, bars.contact.preload, rtol=1e-12)
        assert abs(step.heat_balance) <= 1e-12


def test_small_inputs_are_answered_in_proportion(bars):
    """The nonlinearity is of second order in the heat."""
    one, two, four = (
        np.array([s.displacement for s in take(bars, step_history(q), 10)])
        for q in (1e-3, 2e-3, 4e-3)
    )
    scale = np.abs(one).max()
    first, second = np.abs(two - 2 * one).max() / scale, np.abs(four - 2 * two).max() / scale
    assert first < 1e-3
    assert second == pytest.approx(4.0 * first, rel=0.1)


def test_iterated_coupling_agrees_with_itself(bars):
    for step in take(bars, step_history(1.0), 10, iterated):
        np.testing.assert_allclose(
            step.conductance, bars.contact.conductance(step.state.pressure), rtol=1e-7
        )


def test_staggered_uses_the_pressure_of_the_last_step(bars):
    steps = take(bars, step_history(1.0), 5)
    np.testing.assert_allclose(
        steps[0].conductance, bars.contact.conductance(bars.contact.preload), rtol=1e-12
    )
    for before, step in pairwise(steps):
        expected = bars.contact.conductance(before.state.pressure)
        np.testing.assert_allclose(step.conductance, expected, rtol=1e-12)


def test_a_march_does_not_change_the_state_it_starts_from(bars):
    start = take(bars, step_history(2.0), 3)[-1].state
    kept = copy.deepcopy(start)
    take(bars, step_history(2.0), 3, start=start)
    for name, value in vars(kept).items():
        np.testing.assert_array_equal(getattr(start, name), value)


def test_two_marches_of_one_machine_do_not_disturb_each_other(bars):
    alone = take(bars, step_history(1.0), 6)
    one, other = (march(bars, driven(bars, step_history(q)), staggered) for q in (1.0, 3.0))
    for expected in alone:
        found = next(one)
        next(other)
        np.testing.assert_array_equal(found.displacement, expected.displacement)


@pytest.mark.parametrize("advance", [staggered, iterated])
def test_a_step_out_of_reach_raises_and_yields_nothing(bars, advance, monkeypatch):
    monkeypatch.setattr("fesim.joint.relaxation.MAX_STEPS", 5)  # It would try for seconds.
    done = take(bars, step_history(1.0), 3, advance)
    strict = with_tolerance(bars, 0.0)
    marching = march(strict, driven(bars, step_history(1.0)), advance, done[-1].state)
    with pytest.raises(ConvergenceError, match=r"step to t = 8 s: gap equations") as caught:
        done.append(next(marching))
    assert "\n" not in str(caught.value)
    assert len(done) == 3
    assert list(marching) == []


def test_the_viscous_way_ends_where_newtons_method_does(monkeypatch):
    """Without friction the end does not depend on the way there."""
    machine = heated_bars(step=10.0, friction=0.0)
    whole = take(machine, step_history(1.0), 3)

    def never(thermal_gap, slip, guess):
        raise ConvergenceError("no way")

    monkeypatch.setitem(vars(machine.contact), "settle", never)
    for ours, theirs in zip(take(machine, step_history(1.0), 3), whole, strict=True):
        assert theirs.cuts == 0
        assert ours.cuts > 0
        assert ours.iterations > theirs.iterations
        assert ours.residual <= TOLERANCE
        np.testing.assert_allclose(ours.state.gap[0], theirs.state.gap[0], rtol=0.0, atol=1e-12)


def test_a_joint_of_high_friction_snaps_to_its_next_equilibrium(coarse_data):
    """Nothing is near when the branch ends, and no shorter step would bring it nearer."""
    data = copy.deepcopy(coarse_data)
    data["joints"]["knee"]["friction_coefficient"] = 10.0
    for material in data["materials"].values():
        material["heat_capacity_J_kgK"] = 120.0
    machine = set_up(case_from_data(data, "high friction", Path())).machine
    steps = take(machine, step_history(3.0 * POWER), 600)
    snaps = [step for step in steps if step.cuts > 0]
    assert snaps
    assert max(step.residual for step in steps) <= TOLERANCE
    jumps = [np.abs(step.state.change).max() for step in snaps]
    usual = np.median([np.abs(step.state.change).max() for step in steps])
    assert min(jumps) > 30.0 * usual


def test_pressure_and_heat_flow_that_drive_each_other_come_to_agree():
    """Marches in which no weight that Aitken's method finds leads to an agreement."""
    (drawn,) = marches(844, 1)
    assert drawn.case.march.coupling == "iterated"
    response = simulate(drawn.case).response
    assert response.sizes["time"] == STEPS + 1
    assert float(response["gap_residual"].max()) <= TOLERANCE
    assert float(np.abs(response["heat_balance"]).max()) <= 1e-8


def test_half_and_whole_machine_agree(coarse_data, coarse_setup):
    data = copy.deepcopy(coarse_data)
    data["structure"]["half"] = False
    data["supports"] = {"fixed": data["supports"]["fixed"]}
    setup = set_up(case_from_data(data, "whole", Path()))
    assert setup.machine.contact.count == 2 * coarse_setup.machine.contact.count
    places = setup.joints[0].centre
    mirrored = np.column_stack([places[:, :2], np.minimum(places[:, 2], 0.5 - places[:, 2])])
    # The contact element of the half model that each one of the whole model is or mirrors.
    apart, twin = cKDTree(coarse_setup.joints[0].centre).query(mirrored)
    assert apart.max() < 1e-9
    halves, wholes = (
        take(with_tolerance(one.machine, 1e-16), step_history(2.0 * POWER), 60)
        for one in (coarse_setup, setup)
    )
    for half, whole in zip(halves[::10], wholes[::10], strict=True):
        np.testing.assert_allclose(
            whole.displacement[:2], half.displacement[:2], rtol=1e-7, atol=1e-13
        )
        assert abs(whole.displacement[2]) < 1e-12
        np.testing.assert_allclose(whole.state.pressure, half.state.pressure[twin], rtol=1e-6)
        assert whole.heat_flow.sum() == pytest.approx(2.0 * half.heat_flow.sum(), rel=1e-6)
        np.testing.assert_allclose(
            setup.probe_rows @ whole.state.temperature,
            coarse_setup.probe_rows @ half.state.temperature,
            rtol=1e-8,
        )


def test_simulation_starts_at_rest_and_tells_its_progress(coarse_case, coarse_setup):
    seen, steps = [], []
    run = simulate(
        coarse_case,
        setup=coarse_setup,
        progress=lambda done, count: seen.append((done, count)),
        on_step=lambda step: steps.append(step.state.temperature.size),
    )
    assert seen == [(i, 30) for i in range(1, 31)]
    assert set(steps) == {coarse_setup.spaces.heat.N}
    for name in ("displacement", "temperature", "heat_flow", "slip", "opening"):
        np.testing.assert_array_equal(run.response[name][0], 0.0)
    np.testing.assert_allclose(run.response["pressure"][0], 4.41e6, rtol=1e-12)
