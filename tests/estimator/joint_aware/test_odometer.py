"""An odometer tells of the way between samples, which positions do not show, and of its heat."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from exported import SANITISED, as_in_python, needs_gcc, selftest, written
from in_process import run
from matiec import needs_matiec, selftest_by_both
from moving_knee import SCREW, STEEL, moving
from observed import assert_goes_on, estimates, observer
from unseen_motion import assert_function_block

from calibrate.joint_aware.calibration import machine_of
from calibrate.joint_aware.measured_runs import runs_of
from calibrate.joint_aware.misfit import physics_with, searched
from calibrate.joint_aware.readings import run_in
from estimator.exporting import export_program
from estimator.interface import Status
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.joint_aware.model_file import read_observer, write_observer
from estimator.lines import here
from estimator.states import completed
from fesim.axes.axis import gone_along
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import column_named
from thermojoint.reduced.machine import along
from thermojoint.reduced.physics import simulate_known

SENSORS = ("bearing", "guide")
STEP = 10.0
#: In every step of ten seconds up by 100 mm and down again, for ten minutes; then it stands.
COURSE = [(5.0 * k, 100.0 * (k % 2)) for k in range(121)]
#: The column of the odometer in a sample, time included.
WAY = 5


def responding(folder, rows, drive):
    data = {"odometer": True} | ({"ball_screw": SCREW} if drive else {})
    knee = moving(folder, rows).replace(axes={"y": data}, materials={"steel": STEEL})
    # As heavy a friction as a guide can have, and no other heat than that.
    knee = knee.replace(
        march={"duration_min": 15.0, "step_s": STEP},
        joints={"knee": {"running_friction_coefficient": 0.2}},
        heat_input={"kind": "step", "level": 0.05},
    )
    response = simulate(knee, accuracy=False).response
    return along(machine_of(knee, SENSORS), ["x", "y"]), response


@pytest.fixture(scope="module", params=[False, True], ids=["", "screw"])
def moved(request, tmp_path_factory):
    """The machine, with a screw and without, and its response."""
    return responding(tmp_path_factory.mktemp("odometer"), COURSE, request.param)


@pytest.fixture(scope="module")
def counting(moved):
    machine, response = moved
    return observer(machine, {"run": response})


@pytest.fixture(scope="module")
def samples(counting, moved):
    return np.array(list(KIND.response(counting.model, moved[1])))


def blind(estimator):
    axes = tuple(replace(axis, odometer=False) for axis in estimator.model.moving_axes)
    return replace(estimator, model=replace(estimator.model, moving_axes=axes))


def told_its_heat(estimator, samples, response):
    """Displacements of an estimator that is told the heat of the source, and no temperature."""
    state, found = estimator.initial_state(), []
    for row, power in zip(samples, response["source_power"].to_numpy(), strict=True):
        estimator.parts.views(state)["linear"][-2:] = *power, 0.0
        state, one = estimator.sample(state, row[0], [np.nan] * 3 + row[4:].tolist())
        found.append(one)
    return here(estimator.axes, estimator.details, found)[0]


def test_the_way_of_an_axis_is_what_it_goes_there_and_back(moved):
    _, response = moved
    way = response["axis_way"].to_numpy()[:, 0]
    assert way == pytest.approx(0.2 * np.minimum(np.arange(way.size), 60))
    assert (response["axis_position"].to_numpy() == 0.0).all()


def test_what_an_odometer_counts_heats_the_guide_and_the_screw(counting, samples, moved):
    """Heat of a way that is spread otherwise along the guide: not the simulator's, but near."""
    _, response = moved
    actual = response["displacement"].sel(axis=["x", "y"]).to_numpy()
    without = told_its_heat(blind(counting), np.delete(samples, WAY, axis=1), response)
    error = np.abs(told_its_heat(counting, samples, response) - actual).max(axis=0)
    missed = np.abs(without - actual).max(axis=0)
    assert missed.max() > 1e-6
    assert error.max() < 0.25 * missed.max()


def test_a_run_is_fitted_with_the_way_that_it_records(moved):
    machine, response = moved
    run, without = (
        run_in(one, machine, "run") for one in (response, response.drop_vars("axis_way"))
    )
    assert run.gone[:, 0] == pytest.approx(np.diff(response["axis_way"].to_numpy()[:, 0]))
    assert (without.gone == 0.0).all()
    physics = physics_with(machine, {})
    warm, cold = (
        simulate_known(physics, run.inputs, run.length, gone)[0][-1] for gone in (run.gone, None)
    )
    sensed = response["temperature"].sel(probe=list(SENSORS)).to_numpy()[-1]
    assert np.abs(sensed - warm).max() < 0.25 * np.abs(sensed - cold).max()


def test_a_calibration_goes_by_positions_where_an_odometer_jumps_ahead(moved):
    """A control restored its count: half a kilometre in ten seconds is no way."""
    machine, response = moved
    way = response["axis_way"].copy()
    way[40:] += 500.0
    run, jumped = (run_in(one, machine, "run") for one in (response, response.assign(axis_way=way)))
    kept = np.arange(len(run.gone)) != 39
    assert jumped.gone[kept] == pytest.approx(run.gone[kept])
    assert jumped.gone[39, 0] == 0.0


def test_a_search_in_longer_steps_has_the_way_too(moved):
    """Positions at the samples are all the same, as if the axis stood."""
    machine, response = moved
    run, physics = run_in(response, machine, "run"), physics_with(machine, {})
    (coarse,) = searched(machine, [run], len(run.inputs) // 2)
    (fine, _), (joined, _) = (
        simulate_known(physics, one.inputs, one.length, one.gone) for one in (run, coarse)
    )
    assert coarse.length == 2.0 * run.length
    assert joined[-1] == pytest.approx(fine[-1], rel=0.02)


@pytest.mark.filterwarnings("ignore:log. no ambient_degC")
def test_a_run_of_a_log_has_the_way_that_the_control_counts(moved, tmp_path):
    _, response = moved
    case = moving(tmp_path, COURSE).replace(axes={"y": {"odometer": True}})
    names = ("heat_W", "bearing_degC", "guide_degC", "y_pos_mm", "y_way_m", "x_um")
    sensed = 20.0 + response["temperature"].sel(probe=list(SENSORS)).to_numpy()
    way, none = response["axis_way"].to_numpy(), np.zeros((response.sizes["time"], 1))
    values = np.hstack([response["source_power"], sensed, none, way, none])
    columns = tuple(column_named(name) for name in names)
    log = Log(response["time"].to_numpy(), columns, values, (0,))
    found = runs_of(log, case, ["x_um"])["run 1"]
    assert np.array_equal(found["axis_way"], way)
    unread = replace(log, columns=columns[:4] + columns[5:], values=np.delete(values, 4, axis=1))
    with pytest.raises(InputError, match="y_way"):
        runs_of(unread, case, ["x_um"])


def test_the_command_takes_a_log_with_an_odometer(counting, samples, tmp_path):
    """It counts 12 m, which no displacement is."""
    write_observer(counting.model, tmp_path / "model.h5")
    rows = samples.copy()
    rows[:, 4:] *= 1e3
    head = "time_s,bearing_K,guide_K,ambient_K,y_pos_mm,y_way_mm"
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=head, comments="")
    given = tmp_path / "model.h5", tmp_path / "log.csv", "--out", tmp_path / "e.csv"
    assert run("estimate", *given) == 0
    read = np.genfromtxt(tmp_path / "e.csv", delimiter=",", names=True, dtype=None, encoding=None)
    last = estimates(counting, samples.tolist())[1][-1]
    assert read["x_um"][-1] == pytest.approx(1e6 * last.displacement[0], abs=1e-3)


@pytest.mark.parametrize("unread", [np.nan, -1.0, 1e12, np.inf])
def test_without_a_reading_only_positions_tell(counting, samples, unread):
    rows = samples.copy()
    rows[:, WAY] = unread
    _, found = estimates(counting, rows.tolist())
    _, alone = estimates(blind(counting), np.delete(samples, WAY, axis=1).tolist())
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_array_equal(one.displacement, other.displacement)
    assert all(one.missing == ("y_way",) for one in found)
    assert all(Status.READING_MISSING in one.status for one in found)


def test_an_odometer_may_begin_anew_and_miss_samples(counting, samples):
    """What was gone meanwhile counts at the next reading; what no axis can go, never."""
    rows = samples.copy()
    rows[20:, WAY] -= rows[20, WAY]
    rows[40:, WAY] += 1e6
    _, whole = estimates(counting, samples.tolist())
    _, found = estimates(counting, rows.tolist())
    # Two ways of ninety are lost.
    lost = whole[-1].displacement - found[-1].displacement
    assert 0.0 < np.abs(lost).max() < 0.1 * np.abs(whole[-1].displacement).max()
    rows = samples.copy()
    rows[30:33, WAY] = np.nan
    _, found = estimates(counting, rows.tolist())
    assert found[-1].displacement == pytest.approx(whole[-1].displacement, rel=1e-2)


def quick(samples, speed, away):
    """Samples of an axis as fast as `speed`, m/s, whose odometer is away in a slice of them."""
    rows = samples.copy()
    rows[:, WAY] = speed * rows[:, 0]
    rows[away, WAY] = np.nan
    return rows


def test_what_an_axis_went_while_its_odometer_was_away_has_the_whole_time(counting, samples):
    """Eight steps at 2 m/s are 180 m: more than an axis goes in one step, not more than it can."""
    found, whole = (
        estimates(counting, quick(samples, 2.0, away).tolist())[1]
        for away in (slice(30, 38), slice(0))
    )
    assert found[-1].displacement == pytest.approx(whole[-1].displacement, rel=0.02)


def swinging(estimator, away, speed, anew):
    """Samples, and those with an odometer away for some, in which its axis goes at a speed, m/s."""
    count = 60 + away + 180
    gone = np.full((count, 1), 0.02 * STEP)
    gone[60 : 60 + away] = speed * STEP
    inputs = np.column_stack([np.full(count, 0.05) * estimator.model.power, np.zeros((count, 2))])
    read, _ = simulate_known(estimator.observer.physics, inputs, STEP, gone)
    rows = np.column_stack([read, np.zeros((count, 2)), np.cumsum(gone)])
    rows[:, :2] += 0.03 * np.random.default_rng(1).standard_normal((count, 2))
    rows = np.column_stack([STEP * np.arange(count), rows])
    without = rows.copy()
    without[60 + away :, WAY] -= anew * rows[60 + away, WAY]
    without[60 : 60 + away, WAY] = np.nan
    return rows, without


@pytest.mark.parametrize(
    "away", [30, *(pytest.param(count, marks=pytest.mark.long) for count in (90, 360))]
)
@pytest.mark.parametrize(("speed", "anew"), [(0.02, False), (0.02, True), (0.0, False)])
def test_the_band_has_the_way_that_an_odometer_has_not_told(counting, away, speed, anew):
    """The axis goes on as before, or stands; then the odometer tells it, or was set anew."""
    rows, without = swinging(counting, away, speed, anew)
    every = [estimates(counting, each.tolist())[1] for each in (rows, without)]
    whole, found = (
        [here(counting.axes, counting.details, one)[0], np.array([each.band for each in one])]
        for one in every
    )
    unsettled = np.array([Status.UNSETTLED in one.status for one in every[1]])
    missed, band = np.abs(found[0] - whole[0]), found[1]
    for phase in (slice(60, 60 + away), slice(60 + away, 120 + away), slice(120 + away, None)):
        assert (missed[phase] <= band[phase]).mean() >= 0.95
    assert (band[:60] == whole[1][:60]).all()
    assert not unsettled[:60].any()
    assert unsettled[60:][(band > 2.0 * whole[1])[60:].any(axis=1)].all()
    if speed == 0.0:
        assert (band[-1] < 0.5 * band[59 + away]).all()
    else:
        assert (missed.max(axis=0) > 2.0 * whole[1].max(axis=0)).any()


def test_a_model_without_speeds_has_the_band_that_it_had(counting, samples):
    known = replace(counting.model.calibrated, speeds=())
    old = replace(counting, model=replace(counting.model, calibrated=known))
    rows = samples.copy()
    rows[20:30, WAY] = np.nan
    new, before = (estimates(one, rows.tolist())[1] for one in (counting, old))
    assert all((one.band == other.band).all() for one, other in zip(new[:20], before, strict=False))
    assert (new[29].band > before[29].band).all()


def test_a_state_from_before_odometers_could_be_away_goes_on(counting, samples):
    state, _ = estimates(counting, samples[:40].tolist())
    begins = next(at.start for name, at, _ in counting.parts.parts if name == "odometer_age")
    old = completed(state[:begins], counting.initial_state())
    np.testing.assert_array_equal(old, state)


def test_a_calibration_says_that_an_axis_turns_between_samples(moved):
    machine, response = moved
    to_and_fro = 0.1 * (np.arange(response.sizes["time"])[:, None] % 3 == 0)
    turning = response.assign(axis_position=response["axis_position"].copy(data=to_and_fro))
    unseen = replace(machine.guide.axes[0], odometer=False)
    without = replace(machine, guide=replace(machine.guide, axes=(unseen,)))
    with pytest.warns(UserWarning, match=r"run: axis 'y' turns back after .* set odometer = true"):
        run_in(turning, without, "run")
    with warnings.catch_warnings(action="error"):
        run_in(turning, machine, "run")
        run_in(response, without, "run")


def test_a_run_whose_axis_leaves_its_stroke_is_refused(moved):
    """As with positions from another zero: the fit put the axis at the end of its stroke."""
    machine, response = moved
    shifted = response["axis_position"] + 0.2005
    run_in(response.assign(axis_position=shifted), machine, "run")
    shifted[7:] += 0.15
    with pytest.raises(InputError, match=r"run: axis 'y' is at 350.5 mm at 70 s.* -100 to 200 mm"):
        run_in(response.assign(axis_position=shifted), machine, "run")


def test_an_axis_that_goes_straight_needs_none(tmp_path):
    machine, response = responding(tmp_path, [(0, 0), (60, 0), (90, 200), (300, -100)], True)
    made = observer(machine, {"run": response})
    rows = np.array(list(KIND.response(made.model, response)))
    assert rows[:, WAY] == pytest.approx(gone_along(rows[:, 4:5])[:, 0])
    _, found = estimates(made, rows.tolist())
    _, alone = estimates(blind(made), np.delete(rows, WAY, axis=1).tolist())
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_allclose(one.displacement, other.displacement, rtol=0.0, atol=1e-13)
    # One that stands while its axis moves, or counts in another unit, tells nothing.
    standing = rows.copy()
    standing[:, WAY] *= 1e-3
    _, found = estimates(made, standing.tolist())
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_allclose(one.displacement, other.displacement, rtol=0.0, atol=1e-13)
    moves = np.append(False, np.diff(rows[:, 4]) != 0.0)
    assert [bool(one.missing) for one in found] == moves.tolist()
    assert (found[-1].band > 2.0 * alone[-1].band).all()
    # Back after some samples, it does not count again what the positions have told.
    rows[7:20, WAY] = np.nan
    _, found = estimates(made, rows.tolist())
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_allclose(one.displacement, other.displacement, rtol=0.0, atol=1e-13)


def test_file_log_and_service_know_the_odometer(counting, samples, tmp_path):
    write_observer(counting.model, tmp_path / "model.h5")
    found = JointAware(read_observer(tmp_path / "model.h5"))
    assert found.model.ways == ("y_way",)
    assert found.model.calibrated.speeds == pytest.approx((0.02,))
    intake = KIND.intake(found.model, True)
    assert intake.names[3:5] == ("y_pos_mm", "y_way_mm")
    given, _ = intake.convert([1.0, 2.0, 0.5, 100.0, 7000.0, np.nan, np.nan], 0.0)
    assert given[:5] == pytest.approx([1.0, 2.0, 0.5, 0.1, 7.0])
    assert_goes_on(found, samples.tolist())


@needs_gcc
def test_its_programs_know_the_odometer(counting, samples, tmp_path):
    """Also where it is not read, where it stands, and where it is set anew."""
    rows = samples.copy()
    rows[30:, WAY] -= rows[30, WAY]
    program = export_program(counting, name="m", samples=rows.tolist())
    figures = selftest(written(program, tmp_path), "m", "-O1", *SANITISED)
    assert figures["state"] == program.state
    rows[10:13, WAY] = np.nan
    # It stands while its axis moves.
    rows[70:75, 4] = 0.02 * np.arange(5)
    rows[70:75, WAY] = rows[70, WAY]
    got = as_in_python(program, counting, rows.tolist(), tmp_path)
    _, there = estimates(counting, rows.tolist())
    bands = np.array([one.band for one in there])
    assert np.array([list(one.band) for one in got]) == pytest.approx(bands, rel=1e-9)
    assert (bands[12] > bands[9]).all()
    python, unsettled = (
        np.array([bool(one.status & Status.UNSETTLED) for one in each]) for each in (there, got)
    )
    assert (python == unsettled).all()
    assert python[12]
    assert not python[9]
    # A screw that grows by 45 mm, as none does, to a few millionths.
    rows = quick(samples, 2.0, slice(30, 38)).tolist()
    as_in_python(program, counting, rows, tmp_path / "quick", 1e-7)


@pytest.mark.long
@needs_gcc
@needs_matiec
def test_its_function_blocks_know_the_odometer(counting, samples, tmp_path):
    program = export_program(counting, name="m", samples=samples.tolist())
    selftest_by_both(program, tmp_path)
    # It stands while its axis moves.
    rows = samples.copy()
    rows[70:75, 4] = 0.02 * np.arange(5)
    rows[70:75, WAY] = rows[70, WAY]
    assert_function_block(program, counting, rows, tmp_path)
