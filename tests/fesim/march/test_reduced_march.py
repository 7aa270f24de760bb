"""The march on the reduced thermal model: the full march within the error it records."""

import copy
from dataclasses import fields, replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from bars import driven, level, surface_law, with_tolerance
from reduced_bars import bars_of, modes_of, on_modes, warmed
from repository import ROOT

from fesim.case.history import step_history
from fesim.case.schema import case_from_data, read_case
from fesim.joint.gap import TOLERANCE
from fesim.march import iteration
from fesim.march.alternation import suspected
from fesim.march.ensemble import march_many
from fesim.march.half_step import halved
from fesim.march.iteration import Sweeps, iterated_step
from fesim.march.kernel import step_kernel
from fesim.march.reduced import (
    DISPLACEMENT_ERROR,
    TEMPERATURE_ERROR,
)
from fesim.march.settling import initial_state
from fesim.march.state_file import load_state, save_state
from fesim.march.stepping import (
    iterated,
    march,
    march_along,
    plainly_staggered,
    staggered,
)
from fesim.march.track import joined
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from fesim.snapshots import structure_snapshot
from fesim.solid.condensation import condense_heat
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.console import out
from thermojoint.paper.printing import show_convergence
from thermojoint.paper.report import ReportData, report_html
from thermojoint.paper.summary import convergence

FLANGE = ROOT / "examples/bolted_flange/case.toml"


def edited(data, folder=Path(), **sections):
    """The case with keys of its sections set; a section of a kind is replaced as a whole."""
    data = copy.deepcopy(data)
    for name, value in sections.items():
        data[name] = value if "kind" in value else data.get(name, {}) | value
    return case_from_data(data, "case", folder)


def of_order(case, thermal):
    return case.model_copy(update={"march": case.march.model_copy(update={"thermal": thermal})})


@pytest.fixture(scope="module")
def reduced_case(coarse_case):
    return of_order(coarse_case, "reduced")


@pytest.fixture(scope="module")
def reduced_setup(reduced_case):
    return set_up(reduced_case)


def test_a_step_halved_is_the_step_of_half_the_length():
    """Held surfaces, whose balance depends on the step, among its unknowns."""
    case = read_case(ROOT / "examples/two_rods/case.toml")
    shorter = case.march.model_copy(update={"step_s": 0.5 * case.march.step_s})
    found = halved(set_up(case).machine).thermal
    expected = set_up(case.model_copy(update={"march": shorter})).machine.thermal
    assert found.step == expected.step
    ones = np.ones(len(found.influence))

    def parts(thermal):
        sums, solved = thermal.balance, thermal.factor.solve(ones)
        kept = thermal.capacity_rate @ ones
        return thermal.influence, thermal.joint_influence, solved, kept, sums.after, sums.before

    for one, other in zip(parts(found), parts(expected), strict=True):
        size = np.abs(other).max(initial=0.0)
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14 * size)


def test_a_step_that_does_not_settle_is_accelerated_then_taken_in_halves(
    reduced_setup, monkeypatch
):
    """Halves are those of a march of half the step under the same heat; their balance is kept."""
    machine = reduced_setup.machine
    inputs = driven(machine, step_history(1200.0))
    first = next(march(machine, inputs, iterated))
    monkeypatch.setattr(iteration, "UNSETTLED", 1)
    accelerated = next(march(machine, inputs, iterated))
    np.testing.assert_allclose(accelerated.displacement, first.displacement, rtol=1e-7)
    monkeypatch.setattr(iteration, "ACCELERATED", 1)
    monkeypatch.setattr(iteration, "HALVINGS", 1)
    monkeypatch.setattr(iteration, "SNAPS", 0.0)
    divided = next(march(machine, inputs, iterated))
    monkeypatch.undo()
    two = list(islice(march(halved(machine), inputs, iterated), 2))
    np.testing.assert_array_equal(divided.displacement, two[1].displacement)
    np.testing.assert_array_equal(divided.state.gap, two[1].state.gap)
    assert divided.state.index == first.state.index == 1
    assert abs(divided.heat_balance) <= 1e-12
    assert 0.0 < np.abs(divided.displacement - first.displacement).max() < 1e-7


def test_iterated_steps_that_alternate_and_hardly_decay_are_divided_from_then_on(reduced_setup):
    machine = reduced_setup.machine
    inputs = driven(machine, step_history(1200.0))
    iterating = replace(initial_state(machine), parts=1)
    first = next(march(machine, inputs, staggered, iterating)).state
    moved = first.turning[0]

    def after(last):
        turned = np.array([-last * moved, np.ones_like(moved), np.zeros_like(moved)])
        return next(march(machine, inputs, staggered, replace(iterating, turning=turned))).state

    assert first.parts == after(2.0).parts == 1
    assert after(1.0).parts == 2
    divided = next(march(machine, inputs, staggered, replace(iterating, parts=4)))
    quarters = list(islice(march(halved(halved(machine)), inputs, iterated), 4))
    np.testing.assert_allclose(divided.displacement, quarters[-1].displacement, rtol=1e-9)
    assert divided.state.parts == 4


def test_where_a_joint_snaps_between_two_conductances_the_closest_sweep_is_taken(reduced_setup):
    machine = reduced_setup.machine
    start, inputs = initial_state(machine), driven(machine, step_history(10.0))(2.0)
    settled = iterated_step(machine, start, inputs)
    with pytest.raises(ConvergenceError, match="in-step iteration"):
        iterated_step(machine, start, inputs, Sweeps(1, (), 0, 1e-12))
    closest = iterated_step(machine, start, inputs, Sweeps(1, (), 0, 1e-2))
    assert (settled.cuts, closest.cuts) == (0, 1)
    np.testing.assert_allclose(closest.displacement, settled.displacement, rtol=1e-2)


def both(case, full=None, reduced=None):
    """The responses of the full and of the reduced march."""
    return (
        simulate(of_order(case, "full"), setup=full).response,
        simulate(of_order(case, "reduced"), setup=reduced).response,
    )


def assert_equal_within_the_recorded_error(full, reduced):
    """Allowed at 1 kW; the heat, the ambient and the joint's own flows drive the modes here."""
    error = reduced.attrs["reduction_error"]
    assert 0.0 < error <= 1.0
    drive = float(np.abs(full["source_power"]).sum("source").max()) / 1e3
    drive += float(np.abs(full["ambient"]).max()) / 10.0
    allowed = error * max(drive, 1.0)

    def off(name):
        return float(np.abs(full[name] - reduced[name]).max())

    assert off("temperature") <= allowed * TEMPERATURE_ERROR
    assert off("displacement") <= allowed * DISPLACEMENT_ERROR
    assert off("pressure") <= 1e-5 * float(full["pressure"].max())
    assert off("opening") <= 1e-10
    assert off("slip") <= 1e-10
    assert float(np.abs(reduced["heat_balance"]).max()) <= 1e-11
    assert float(reduced["gap_residual"].max()) <= 1e-12


@pytest.mark.parametrize(
    ("heat_input", "slides"),
    [
        ({"kind": "step", "level": 3.0}, True),
        ({"kind": "triangle", "peak": 2.0, "duration_min": 4.0}, False),
        ({"kind": "step", "level": -1.0}, True),
    ],
    ids=["step", "triangle", "cooling"],
)
def test_the_reference_machine_marches_as_with_the_full_model(
    coarse_data, coarse_setup, reduced_setup, heat_input, slides
):
    """A joint that sticks or slides, convection outside."""
    case = edited(coarse_data, heat_input=heat_input, march={"duration_min": 6.0})
    full, reduced = both(case, coarse_setup, reduced_setup)
    assert_equal_within_the_recorded_error(full, reduced)
    assert float(np.abs(full["displacement"]).max()) > 1e-6
    assert (float(np.abs(full["slip"]).max()) > 1e-8) == slides


def test_sources_held_surfaces_and_the_ambient_each_with_its_history(coarse_data, tmp_path):
    (tmp_path / "drive.csv").write_text("time_s,heat_input\n0,0\n20,1\n60,-0.5\n")
    (tmp_path / "air.csv").write_text("time_s,ambient_degC\n0,20\n30,25\n60,18\n")
    (tmp_path / "oil.csv").write_text("time_s,rise_K\n0,0\n10,6\n40,6\n60,2\n")
    case = edited(
        coarse_data,
        tmp_path,
        sources={
            "drive": {
                "body": "screw",
                "reference_power_W": 80.0,
                "heat_input": {"kind": "sampled", "file": "drive.csv"},
            }
        },
        ambient={"file": "air.csv"},
        held_temperatures={"screw_foot": {"file": "oil.csv"}, "column_base": {"rise_K": 3.0}},
        joints={"knee": coarse_data["joints"]["knee"] | {"friction_coefficient": 0.1}},
        probes={"foot": {"position_mm": [1025.0, 0.0, 250.0], "body": "screw"}},
        march={"duration_min": 2.0, "coupling": "iterated"},
    )
    full, reduced = both(case)
    assert_equal_within_the_recorded_error(full, reduced)
    foot = reduced["temperature"].sel(probe="foot")
    np.testing.assert_allclose(foot.sel(time=[10, 40, 50, 120]), [6.0, 6.0, 4.0, 2.0], rtol=1e-12)


@pytest.mark.long
def test_several_joints_springs_and_a_warming_hall():
    """The bolted flange of the examples: three joints of different preload and friction."""
    case = read_case(FLANGE)
    short = case.model_copy(update={"march": case.march.model_copy(update={"duration_min": 2.0})})
    full, reduced = both(short)
    assert_equal_within_the_recorded_error(full, reduced)
    assert len(set(full["contact_joint"].to_numpy())) == 3


# --- two bars, by hand ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bars():
    return bars_of()


@pytest.fixture(scope="module")
def modes(bars):
    return modes_of(bars)


def heated(machine, count, advance=staggered):
    """300 W, then none, then 300 W are drawn off."""

    def inputs(time):
        return level(machine.thermal, 300.0 * float(np.sign(np.sin(time / 60.0))))

    return list(islice(march(machine, inputs, advance), count))


@pytest.mark.parametrize("friction", [0.0, 0.05, 0.3])
def test_machine_code_takes_the_steps_of_the_plain_march(friction):
    """To 1e-12 m in every step; the residual that it tells is the true one."""
    bars = bars_of(friction=friction)
    machine = on_modes(bars, modes_of(bars))
    inputs, start = warmed(100), initial_state(machine)
    assert step_kernel(machine) is not None
    ours = joined(list(march_along(machine, inputs, staggered, start)))
    strict = with_tolerance(machine, 1e-16)
    theirs = joined(list(march_along(strict, inputs, plainly_staggered, start)))
    for name in ("gap", "slip", "displacement"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.heat_flow, theirs.heat_flow, rtol=0, atol=1e-6)
    assert np.abs(ours.heat_balance).max() <= 1e-11
    assert not ours.cuts.any()
    problem, elastic = machine.contact.gap_problem, machine.contact.elastic
    slip = np.zeros((2, machine.contact.count))
    for step in (ours.step(at) for at in range(len(ours))):
        traction = machine.contact.traction(step.state.gap, slip)
        warm = elastic.thermal_gap @ step.state.temperature
        true = np.abs(problem.residual(step.state.gap, traction, warm)).max()
        assert true <= TOLERANCE
        assert step.residual == pytest.approx(true, abs=1e-17)
        slip = step.state.slip
    changes = np.abs(np.diff(ours.slip, axis=0)).max(axis=1) > 1e-12
    assert changes.any()
    if friction:
        assert not changes.all()


@pytest.mark.parametrize("cut", [1, 37, 64])
def test_machine_code_goes_on_bit_for_bit_from_a_state(bars, modes, cut):
    machine, inputs = on_modes(bars, modes), warmed(100)
    whole = joined(list(march_along(machine, inputs, staggered, initial_state(machine))))
    saved = copy.deepcopy(whole.step(cut - 1).state)
    again = on_modes(bars, modes)
    rest = joined(list(march_along(again, inputs[cut:], staggered, saved)))
    for field in fields(rest):
        if field.name != "model":
            ours, theirs = getattr(rest, field.name), getattr(whole, field.name)[cut:]
            np.testing.assert_array_equal(ours, theirs, err_msg=field.name)
    one_by_one = march(again, lambda time: inputs[round(time / 2.0) - 1], staggered)
    for at, step in zip(range(100), one_by_one, strict=False):
        np.testing.assert_array_equal(step.state.gap, whole.gap[at])
        np.testing.assert_array_equal(step.displacement, whole.displacement[at])


def test_heat_on_and_off_leaves_steps_that_machine_code_has_taken_as_they_are(bars, modes):
    """Increments turn with the heat: where the gain is small, no step is marched again."""
    machine = on_modes(bars, modes)
    inputs = warmed(100) * (np.arange(100) % 2)[:, None]
    track = next(march_along(machine, inputs, staggered, initial_state(machine)))
    assert suspected(track.turning[:-1]).any()
    assert len(track) == len(inputs)
    strict = with_tolerance(machine, 1e-16)
    theirs = joined(list(march_along(strict, inputs, plainly_staggered, initial_state(machine))))
    np.testing.assert_allclose(track.gap, theirs.gap, rtol=0, atol=1e-12)


def test_many_marches_are_those_of_one_after_another(bars, modes):
    """Other friction, preload and heat in each; a law of the user's own is marched plainly."""
    machine = on_modes(bars, modes)
    count = machine.contact.count
    own = replace(surface_law(0.3), conductance=lambda pressure: 0.01 * pressure)
    laws = [[(surface_law(0.1), count)], [(surface_law(0.3, 2e6), count)], [(own, count)]]
    rows = np.vstack([np.zeros((1, 2)), warmed(50)])
    inputs = np.array([scale * rows for scale in (1.0, 0.7, 0.5)])
    found = march_many(machine, laws, inputs)
    assert found.shape == (3, 51, len(machine.contact.elastic.probe_thermal))
    np.testing.assert_allclose(found[:, 0], 0.0, atol=1e-20)
    for one, given, displacement in zip(laws, inputs, found, strict=True):
        plain = machine.with_laws(one)
        steps = march(plain, lambda t, rows=given: rows[round(t / 2.0)], plainly_staggered)
        expected = np.array([step.displacement for step in islice(steps, 50)])
        np.testing.assert_allclose(displacement[1:], expected, rtol=0.0, atol=1e-12)
    with pytest.raises(InputError, match="give one for each"):
        march_many(machine, laws[:2], inputs)


@pytest.mark.parametrize("step", [1.0, 5.0, 30.0])
@pytest.mark.parametrize("advance", [staggered, iterated])
def test_the_same_modes_serve_a_march_of_any_step(bars, modes, step, advance):
    parts = bars.parts
    thermal = condense_heat(parts.heat, parts.operators, step)
    full = heated(replace(bars.machine, thermal=thermal), 40, advance)
    reduced = heated(on_modes(bars, modes, step), 40, advance)
    for one, other in zip(full, reduced, strict=True):
        allowed = modes.error * DISPLACEMENT_ERROR
        np.testing.assert_allclose(other.displacement, one.displacement, rtol=0, atol=allowed)
        np.testing.assert_allclose(other.state.pressure, one.state.pressure, rtol=0, atol=1e3)
        assert abs(other.heat_balance) < 1e-11
    assert max(step.state.pressure.max() for step in full) > 1e7


# --- what a user sees ----------------------------------------------------------------------------


@pytest.mark.long
def test_contact_elements_multiply_and_the_modes_do_not(coarse_data, reduced_setup):
    knee = coarse_data["joints"]["knee"] | {"along": 18, "across": 6}
    case = edited(coarse_data, joints={"knee": knee}, march={"thermal": "reduced"})
    finer = set_up(case)
    assert finer.machine.contact.count == 4 * reduced_setup.machine.contact.count == 108
    assert finer.modes.rates.size < 1.2 * reduced_setup.modes.rates.size
    assert finer.modes.error <= 1.0


def test_fields_come_back_at_any_time(coarse_data, coarse_setup, reduced_setup):
    """Nodes that no output looks at are as near as those that one does."""
    case = edited(coarse_data, heat_input={"kind": "step", "level": 3.0})
    fields, snapshots = [], []
    for thermal, setup in (("full", coarse_setup), ("reduced", reduced_setup)):
        temperatures, last = [], []

        def keep(step, setup=setup, temperatures=temperatures, last=last):
            temperatures.append(setup.nodal_temperature(step.state))
            last[:] = [step]

        simulate(of_order(case, thermal), setup=setup, on_step=keep)
        fields.append(np.array(temperatures))
        snapshots.append(structure_snapshot(setup, last[0]))
    full, reduced = fields
    assert full.shape == reduced.shape == (30, coarse_setup.spaces.heat.N)
    assert np.abs(full - reduced).max() < 1e-3 < 1.0 < np.abs(full).max()
    one, other = (snapshot.point_data for snapshot in snapshots)
    np.testing.assert_allclose(other["temperature_K"], one["temperature_K"], rtol=0, atol=1e-3)
    np.testing.assert_allclose(other["displacement_m"], one["displacement_m"], rtol=0, atol=1e-9)
    assert np.abs(one["displacement_m"]).max() > 1e-6


def test_a_response_says_which_thermal_model_it_had(coarse_response, reduced_case, reduced_setup):
    assert coarse_response.attrs["thermal_model"] == "full"
    assert coarse_response.attrs["thermal_modes"] == 0
    found = simulate(reduced_case, setup=reduced_setup).response.attrs
    assert found["thermal_model"] == "reduced"
    assert found["thermal_modes"] == reduced_setup.modes.rates.size
    assert found["thermal_unknowns"] == reduced_setup.spaces.heat.N > found["thermal_modes"]
    assert 0.0 < found["reduction_error"] == reduced_setup.modes.error <= 1.0


def test_the_summary_and_the_report_print_the_rank_and_the_error(
    coarse_response, reduced_case, reduced_setup, capsys
):
    rows = {
        "whole": convergence(coarse_response),
        "reduced": convergence(simulate(reduced_case, setup=reduced_setup).response),
    }
    said = (
        f"reduced to {reduced_setup.modes.rates.size} modes, "
        f"error {reduced_setup.modes.error:.2g} of the allowed 0.2 mK and 0.4 nm"
    )
    show_convergence(out(), rows)
    printed = capsys.readouterr().out
    assert "Thermal model: full." in printed
    assert f"Thermal model: {said}." in printed
    page = report_html(ReportData("title", [], convergence=rows))
    assert f"<td>{said}</td>" in page
    assert "<td>full</td>" in page


def test_reduced_is_what_a_case_gets_that_does_not_say(coarse_data):
    silent = copy.deepcopy(coarse_data)
    del silent["march"]["thermal"]
    assert case_from_data(silent, "case", Path()).march.thermal == "reduced"


# --- going on ------------------------------------------------------------------------------------


def test_a_reduced_march_goes_on_bit_for_bit_from_its_saved_state(
    coarse_data, reduced_setup, tmp_path
):
    def case_of(minutes):
        return edited(
            coarse_data,
            heat_input={"kind": "triangle", "peak": 2.0, "duration_min": 1.5},
            march={"duration_min": minutes, "thermal": "reduced"},
        )

    whole = simulate(case_of(2.0), setup=reduced_setup)
    first = simulate(case_of(1.0), setup=reduced_setup)
    save_state(first.state, case_of(1.0), tmp_path / "half.npz")
    start = load_state(tmp_path / "half.npz", case_of(2.0))
    second = simulate(case_of(2.0), setup=reduced_setup, start=start)
    for name, values in whole.response.data_vars.items():
        if "time" in values.dims:
            joined = np.concatenate([first.response[name], second.response[name]])
            np.testing.assert_array_equal(joined, values)
    for name, value in vars(whole.state).items():
        np.testing.assert_array_equal(getattr(second.state, name), value)


def test_amplitudes_of_another_basis_are_refused(
    coarse_case, coarse_setup, reduced_case, reduced_setup, coarse_data
):
    """Amplitudes mean nothing but with their own modes; nodal temperatures are no amplitudes."""
    source = coarse_data["sources"]["bearings"] | {"surface": "screw_foot"}
    elsewhere = edited(coarse_data, march={"thermal": "reduced"}, sources={"bearings": source})
    state = simulate(reduced_case, setup=reduced_setup).state
    nodal = simulate(coarse_case, setup=coarse_setup).state
    for other, setup, start in (
        (elsewhere, set_up(elsewhere), state),
        (reduced_case, reduced_setup, nodal),
        (coarse_case, coarse_setup, state),
    ):
        with pytest.raises(InputError, match="another reduced thermal model") as caught:
            simulate(other.replace(march={"duration_min": 2.0}), setup=setup, start=start)
        assert "\n" not in str(caught.value)
