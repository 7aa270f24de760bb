"""The adaptive march: second order, its limit, its errors, and what it does not depend on."""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from bars import assemble, surface_law, two_bars
from hypothesis import given, settings
from hypothesis import strategies as st
from reduced_bars import bars_of, modes_of, on_modes

from fesim.batch.summary import figures_of
from fesim.case.history import Histories, History, common_knots
from fesim.case.schema import case_from_data
from fesim.march import adaptive, compiled_adaptive
from fesim.march.adaptive import march_adaptively
from fesim.march.exponential import phi_functions as real_phi_functions
from fesim.march.settling import initial_state
from fesim.march.state_file import load_state, save_state
from fesim.march.step_control import (
    LONGEST,
    SHORTEST,
    Pace,
    Tolerance,
    next_pace,
    rung,
    shorter,
    until,
)
from fesim.march.stepping import iterated, march_along
from fesim.march.track import joined
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.models.filters.phi import phi_functions
from thermojoint.paper.summary import convergence, result_lines

#: Heat that turns, so that the joint slides, sticks, and slides back: times, s, and W.
TURNS, WATTS = (0.0, 40.0, 60.0, 120.0), (0.0, 1800.0, -1800.0, 1200.0)
END = 120.0
LOOSE = Tolerance(1e3, 1e9, np.inf)


@pytest.fixture(scope="module")
def bars():
    built = bars_of()
    modes = modes_of(built)
    return on_modes(built, modes), modes.rates


def driven(times=TURNS):
    times = np.unique(np.concatenate([times, TURNS]))
    return Histories(times, np.column_stack([np.interp(times, TURNS, WATTS), 0.0 * times]))


def marched(bars, drive, times, tolerance):
    """The track and the effort of a march from rest."""
    machine, rates = bars
    start = initial_state(machine, drive(0.0))
    parts = list(march_adaptively(machine, rates, drive, times, tolerance, start))
    return joined([track for track, _ in parts]), parts[-1][1].effort


def by_steps_of(bars, length):
    """The displacement at the turns of a march whose steps end at every multiple of a length."""
    return marched(bars, driven(np.arange(0.0, END, length)), np.array(TURNS[1:]), LOOSE)[0]


def test_weights_are_those_of_the_filters():
    decay = np.concatenate([np.zeros(1), np.geomspace(1e-12, 1e4, 200)])
    _, *expected = phi_functions(-decay + 0j)
    for mine, theirs in zip(real_phi_functions(decay), expected, strict=False):
        np.testing.assert_allclose(mine, theirs.real, rtol=4e-15)


def test_the_error_falls_with_the_square_of_the_step(bars):
    """With friction that slides to and fro; half the step leaves a quarter of the error or less."""
    found = [by_steps_of(bars, length).displacement for length in (8.0, 4.0, 2.0, 1.0)]
    sizes = [np.abs(coarse - fine).max() for coarse, fine in pairwise(found)]
    assert sizes[-1] < 1e-8 < sizes[0]
    for coarse, fine in pairwise(sizes):
        assert fine < coarse / 3.5


def test_the_limit_is_that_of_iterated_steps(bars):
    """Extrapolated from two lengths; each of them alone is off by twenty times as much."""
    found = []
    for length in (2.0, 1.0):
        built = bars_of(length)
        machine = on_modes(built, modes_of(built, length), length)
        inputs = np.array([driven()(end) for end in length * np.arange(1.0, END / length + 1.0)])
        track = joined(list(march_along(machine, inputs, iterated, initial_state(machine))))
        found.append(track.displacement[(np.array(TURNS[1:]) / length).astype(int) - 1])
    limit = 2.0 * found[1] - found[0]
    ours = by_steps_of(bars, 0.5).displacement
    assert np.abs(ours - limit).max() < 0.05 * np.abs(found[1] - found[0]).max()


@pytest.mark.parametrize("wanted", [1e-7, 1e-8])
def test_the_error_is_below_the_tolerance_and_the_estimate_says_so(bars, wanted):
    exact = by_steps_of(bars, 0.5).displacement
    track, effort = marched(bars, driven(), np.array(TURNS[1:]), Tolerance(wanted, 1.0))
    error = np.abs(track.displacement - exact).max()
    assert error < wanted
    assert error < 2.0 * effort.displacement < 4.0 * wanted
    assert effort.rejected > 0
    assert np.abs(track.heat_balance).max() < 1e-12


def test_changes_below_the_tolerances_are_followed_to_a_part_of_themselves(bars):
    def faint(times=TURNS):
        drive = driven(times)
        return Histories(drive.times, 1e-4 * drive.values)

    times = np.array(TURNS[1:])
    exact = marched(bars, faint(np.arange(0.0, END, 0.5)), times, LOOSE)[0].temperature
    found = marched(bars, faint(), times, Tolerance(1e-6, 1.0))[0].temperature
    unruled = marched(bars, faint(), times, Tolerance(1e-6, 1.0, np.inf))[0].temperature
    size = np.abs(exact).max()
    assert np.abs(found - exact).max() < 1e-3 * size
    assert np.abs(unruled - exact).max() > 1e-3 * size


def test_nothing_depends_on_the_times_that_are_asked_for(bars):
    tolerance = Tolerance(1e-7, 1.0)
    seldom, _ = marched(bars, driven(), np.array([END]), tolerance)
    often, _ = marched(bars, driven(), np.linspace(0.0, END, 98)[1:], tolerance)
    for name in ("temperature", "displacement", "slip", "pressure", "heat_flow"):
        assert np.array_equal(getattr(seldom, name)[-1], getattr(often, name)[-1])


def test_between_its_steps_the_march_is_as_good_as_at_their_ends(bars):
    times = np.linspace(0.0, END, 61)[1:]
    exact = marched(bars, driven(np.arange(0.0, END, 0.5)), times, LOOSE)[0].displacement
    found, effort = marched(bars, driven(), times, Tolerance(1e-6, 1.0))
    assert effort.longest > 3.0 * times[0]
    assert np.abs(found.displacement - exact).max() < 1e-7


def test_a_tolerance_that_no_step_meets_is_an_error(bars):
    with pytest.raises(ConvergenceError, match=r"step to t = .*tolerance_um"):
        marched(bars, driven(), np.array([END]), Tolerance(1e-27, 1.0))


@settings(max_examples=40)
@given(st.floats(1e-3, 1e6), st.floats(1e-9, 1e9), st.floats(1e-9, 1e3))
def test_steps_stay_on_their_ladder_and_never_pass_a_knot(length, error, left):
    pace = Pace(rung(length), 0.5)
    assert SHORTEST <= pace.length <= LONGEST
    assert pace.length <= max(length * (1.0 + 1e-6), SHORTEST)
    assert shorter(pace, pace.length, 1.0 + error).length < max(pace.length, 1.01 * SHORTEST)
    longer = next_pace(pace, pace.length, min(error, 1.0), 0.0).length
    assert SHORTEST <= longer <= 5.0 * pace.length
    step = until(pace.length, left)
    assert 0.0 < step <= min(pace.length, left)
    assert step == left or step <= 0.5 * left


knots = st.lists(st.integers(-5, 40), min_size=1, max_size=8, unique=True).map(sorted)


@settings(max_examples=40)
@given(st.lists(st.tuples(knots, st.integers(0, 2**31)), min_size=1, max_size=3))
def test_common_knots_lose_nothing_of_a_history(drawn):
    histories = [
        History(np.array(times, float), np.random.default_rng(seed).choice(2, len(times)) * 1.0)
        for times, seed in drawn
    ]
    times = common_knots(histories)
    together = Histories(times, np.column_stack([history(times) for history in histories]))
    for time in np.linspace(0.0, 45.0, 46):
        expected = [float(history(np.array(time))) for history in histories]
        np.testing.assert_allclose(together(time), expected, atol=1e-14)


@pytest.fixture(scope="module")
def adaptive_case(coarse_data):
    march = coarse_data["march"] | {"thermal": "reduced", "method": "adaptive", "step_s": 20.0}
    return case_from_data(coarse_data | {"march": march}, "adaptive case", Path())


def test_a_case_is_marched_adaptively_and_says_so(adaptive_case):
    setup = set_up(adaptive_case)
    response = simulate(adaptive_case, setup=setup).response
    assert response["time"].to_numpy().tolist() == [0.0, 20.0, 40.0, 60.0]
    lines = result_lines(response, figures_of(response))
    assert lines[-1].startswith(f"Steps: {response.attrs['march_steps']} of 0.055 to ")
    assert convergence(response).steps == response.attrs["march_steps"] > 3
    fixed = adaptive_case.replace(march={"method": "fixed", "coupling": "iterated"})
    other = simulate(fixed, setup=setup).response
    off = np.abs(response["displacement"] - other["displacement"]).max()
    assert 1e-9 < off < 1e-6


@pytest.mark.parametrize("plainly", [False, True])
def test_a_march_goes_on_from_a_saved_state_to_the_bit(adaptive_case, tmp_path, plainly):
    """Its last step passes the time of the state, and is taken again.

    Sums over several inputs are those of the steps before, too.
    """
    (tmp_path / "hall.csv").write_text("time_s,ambient_degC\n0,20\n50,21.3\n90,20.7\n300,22\n")
    hall = {"ambient": {"file": str(tmp_path / "hall.csv")}}
    half, longer = (
        adaptive_case.replace(march={"duration_min": end}, **hall) for end in (1.0, 6.0)
    )
    setup = set_up(longer)
    by = {"return_value": None} if plainly else {"wraps": adaptive._compiled}
    with patch.object(adaptive, "_compiled", **by):
        whole = simulate(longer, setup=setup, accuracy=False)
        first = simulate(half, setup=setup, accuracy=False)
        save_state(first.state, half, tmp_path / "half.npz")
        start = load_state(tmp_path / "half.npz", longer)
        rest = simulate(longer, setup=setup, start=start, accuracy=False)
    together = whole.response.sel(time=rest.response["time"])
    for name in ("temperature", "displacement", "slip", "opening", "pressure", "heat_flow"):
        assert np.array_equal(rest.response[name], together[name])
    assert rest.response.attrs["march_steps"] == whole.response.attrs["march_steps"]
    assert np.array_equal(rest.state.course, whole.state.course)


@pytest.mark.parametrize(
    ("before", "after", "together"),
    [
        ("0,1", "0,3", "0,1\n1800,1\n1800.001,3"),
        # A log that has grown since: nothing tells them apart before it ended.
        ("0,1\n1680,1", "0,1\n1680,1\n1920,4", "0,1\n1800,1\n1800.001,2.5\n1920,4"),
    ],
    ids=["from the start on", "from shortly before the state on"],
)
def test_other_heat_acts_from_the_time_of_the_state_on(
    adaptive_case, tmp_path, before, after, together
):
    """It acted from the start of the step in which that time is, minutes before."""

    def case_of(rows, minutes):
        file = tmp_path / f"{minutes:g}-{len(rows)}.csv"
        file.write_text(f"time_s,heat_input\n{rows}\n")
        heat = {"kind": "sampled", "file": str(file)}
        return adaptive_case.replace(heat_input=heat, march={"duration_min": minutes})

    setup, half, longer = set_up(adaptive_case), case_of(before, 30.0), case_of(after, 60.0)
    first = simulate(half, setup=setup, accuracy=False)
    assert first.state.course[0] < 1790.0
    save_state(first.state, half, tmp_path / "half.npz")
    start = load_state(tmp_path / "half.npz", longer)
    rest = simulate(longer, setup=setup, start=start, accuracy=False).response
    whole = simulate(case_of(together, 60.0), setup=setup, accuracy=False).response
    off = np.abs(rest["displacement"] - whole["displacement"].sel(time=rest["time"]))
    assert float(off.max()) < 2e-8
    assert rest.attrs["march_steps"] > first.response.attrs["march_steps"]


def test_a_load_that_jumps_is_followed_as_one_that_is_given_on_its_way(adaptive_case, tmp_path):
    """In one step weak joints were off by 0.09 um, estimated as 0.0001 um, or it was an error."""
    file = tmp_path / "cutting.csv"
    load = {"surface": "bearings", "force_N": [-2000.0, 1000.0, 0.0], "file": str(file)}
    weak = {
        joint: {"friction_coefficient": 0.3, "preload_MPa": 0.2} for joint in adaptive_case.joints
    }
    setup = None
    for force in (8.0, -8.0):
        found = []
        for pieces in (1, 16):
            shares = np.linspace(0.0, 1.0, pieces + 1).tolist()
            rows = [f"{30.0 + 1e-3 * share!r},{force * (1.5 * share - 0.5)!r}" for share in shares]
            file.write_text("\n".join(["time_s,factor", *rows]) + "\n")
            case = adaptive_case.replace(loads={"cutting": load}, joints=weak)
            setup = setup or set_up(case)
            found.append(simulate(case, setup=setup, accuracy=False).response["displacement"])
        assert np.abs(found[0] - found[1]).max() < 5e-9
    # No time is between these.
    file.write_text(f"time_s,factor\n30,-4\n{np.nextafter(30.0, 31.0)!s},8\n")
    at_once = simulate(case.replace(), setup=setup, accuracy=False).response
    assert np.isfinite(at_once["displacement"]).all()


@pytest.mark.parametrize(("starts", "lasts"), [(0.0, 1e-3), (0.0, 0.2), (40.0, 0.0)])
def test_a_held_temperature_that_jumps_at_a_joint_is_followed(starts, lasts):
    """It was an error: heat flows faster at first than steps of 0.055 s can tell."""
    bars, law = two_bars(left=(40, 1, 1), right=(2, 1, 1)), surface_law(preload=50e6)
    built = assemble(bars, law=law, fixed=["left_end", "right_end"], held=["joint.b"])
    modes = modes_of(built)
    machine = on_modes(built, modes)
    times = np.array([40.0, 40.3, 41.0, END])
    given = [0.0] if lasts == 0.0 else [0.0, 40.0, 40.0 + lasts]

    def found(knots, tolerance, plainly=False):
        knots = np.unique(np.concatenate([given, knots]))
        held = np.interp(knots, given, [starts, starts, 40.0][: len(given)])
        drive = Histories(knots, np.column_stack([0.0 * held, held]))
        by = {"return_value": None} if plainly else {"wraps": adaptive._compiled}
        with patch.object(adaptive, "_compiled", **by):
            return marched((machine, modes.rates), drive, times, tolerance)

    after = np.geomspace(1e-5, END - given[-1], 600)
    exact, _ = found(np.append(given[-1] + after, np.linspace(40.0, given[-1], 30)), LOOSE)
    track, effort = found([], Tolerance(1e-8, 0.1))
    assert np.abs(track.displacement - exact.displacement).max() < 1e-8
    assert np.abs(track.temperature - exact.temperature).max() < 0.1
    assert effort.steps < 2000
    plain, other = found([], Tolerance(1e-8, 0.1), plainly=True)
    assert abs(effort.steps - other.steps) < 0.01 * other.steps  # rounding may choose another rung
    np.testing.assert_allclose(track.displacement, plain.displacement, rtol=0, atol=1e-10)


def test_both_marches_take_the_same_steps(bars):
    """Friction turns, rows are asked for within steps, and nothing is left to the plain march."""
    times, tolerance = np.linspace(0.0, END, 31)[1:], Tolerance(3e-7, 1.0)
    found, effort = marched(bars, driven(), times, tolerance)
    with patch.object(adaptive, "_compiled", return_value=None):
        plain, other = marched(bars, driven(), times, tolerance)
    assert (effort.steps, effort.rejected) == (other.steps, other.rejected)
    for name in ("displacement", "gap"):
        np.testing.assert_allclose(getattr(found, name), getattr(plain, name), rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.slip, plain.slip, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.pressure, plain.pressure, rtol=1e-6)
    assert found.residual.max() <= bars[0].contact.tolerance


@pytest.mark.parametrize(
    ("march", "says"),
    [
        ({"method": "fixed", "tolerance_um": 0.1}, "belong to method"),
        ({"method": "adaptive", "thermal": "full"}, "integrates modes"),
        ({"method": "adaptive", "coupling": "iterated"}, "agree by themselves; leave it out"),
    ],
)
def test_keys_that_do_not_go_together_are_refused(adaptive_case, march, says):
    with pytest.raises(InputError, match=says):
        adaptive_case.replace(march=march)


def test_no_sweep_leaves_a_joint_that_opens_a_pressure_below_zero():
    """It would have no conductance: eight of twenty random days of 8 h ended there."""
    rng, count = np.random.default_rng(1), 400
    work = SimpleNamespace(
        contact=np.zeros((7, count)),
        gap=np.zeros((5, 3, count)),
        sweeps=np.array([compiled_adaptive.HEAVIEST, np.inf, 0.0]),
        turn=np.zeros(1, dtype=np.int64),
    )
    work.contact[compiled_adaptive.VALUE] = 10.0 ** rng.uniform(-9.0, 8.0, count)
    preload, scale = rng.uniform(1e5, 1e7, (2, count))
    opened = SimpleNamespace(value=-np.stack([preload] * 3), gap=np.zeros((3, count)))
    machine = compiled_adaptive.Sweeping(preload, scale, 0.0)
    swept = getattr(compiled_adaptive._swept, "py_func", compiled_adaptive._swept)
    assert swept(machine, work, opened, np.zeros((3, count))) == compiled_adaptive.SWEEP
    assert (work.contact[compiled_adaptive.VALUE] >= 0.0).all()
