"""The joint-aware estimator of a machine with a moving axis: told its position, it follows it.

So does its program for a control.
"""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from exported import (
    PRECISIONS,
    SANITISED,
    as_in_python,
    compiled,
    counts,
    needs_gcc,
    needs_gxx,
    operations,
    selftest,
    written,
)
from in_process import run
from matiec import needs_matiec, selftest_by_both
from moving_knee import moving
from observed import assert_goes_on, estimates, observer
from unseen_motion import (
    assert_function_block,
    assert_held,
    course,
    rows_of,
    without_positions,
)

from calibrate.joint_aware.calibration import Effort, calibrate_joint_aware, machine_of
from calibrate.joint_aware.linear_joint import with_linear_joint
from calibrate.joint_aware.misfit import physics_with, searched
from calibrate.joint_aware.open_band import Drawing
from calibrate.joint_aware.physics_fit import Search
from calibrate.joint_aware.readings import run_in
from estimator.estimate_table import read_estimate
from estimator.export.program import Precision
from estimator.exporting import export_program
from estimator.interface import Status
from estimator.joint_aware import unreported_motion
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.joint_aware.model_file import fingerprint, read_observer, write_observer
from estimator.joint_aware.readings import samples_in
from estimator.kind import Cold, Options
from estimator.lines import Stroke, here, name_at
from estimator.probe_readings import with_probe_readings
from estimator.states import completed
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import column_named
from thermojoint.artefacts.response import write_response
from thermojoint.live.loaded_models import load_model
from thermojoint.live.machine_state import Times, initial_state, process_sample
from thermojoint.live.publication import as_json
from thermojoint.live.settings import ModelSection
from thermojoint.reduced.machine import along
from thermojoint.reduced.physics import simulate_known

#: (s, mm): stands, passes several stations in a step, stands between stations.
COURSE = [(0, 0), (60, 0), (90, 200), (240, 200), (270, -100), (480, 30), (510, 85), (1200, 85)]
SENSORS = ("bearing", "guide", "table")
#: The axis of the control that moves the knee.
SLOPED = """
rate_um_s = 5.0
largest_um = 500.0
[axes.Y]
follows = "y"
sign = -1
[axes.Y.slope]
resolution_um_per_m = 1.0
"""
#: A table of the control: the offset at two positions of the axis.
TABLE = """
oldest_s = 60.0
rate_um_s = 100.0
recover_s = 0.0
unusable = []
[axes.low]
follows = "x"
at_mm = -100.0
[axes.high]
follows = "x"
at_mm = 200.0
"""


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    knee = moving(tmp_path_factory.mktemp("course"), COURSE)
    return knee.replace(march={"duration_min": 20.0, "step_s": 10.0})


@pytest.fixture(scope="module")
def response(case):
    return simulate(case, accuracy=False).response


@pytest.fixture(scope="module")
def machine(case):
    return along(machine_of(case, SENSORS), ["x", "y"])


@pytest.fixture(scope="module")
def estimator(machine, response):
    return observer(machine, {"run": response})


@pytest.fixture(scope="module")
def samples(response):
    return list(samples_in(response, SENSORS, axes=["y"]))


def actual(response, name="displacement"):
    return response[name].sel(axis=["x", "y"]).to_numpy()


def detail(estimator, found, name):
    at = [channel.name for channel in estimator.details].index(name)
    return np.array([estimate.details[at] for estimate in found])


def test_the_reduced_machine_marches_as_the_simulator(machine, response):
    physics = physics_with(machine, {})
    sensed, moved = simulate_known(physics, run_in(response, machine, "run").inputs, machine.step)
    temperature = response["temperature"].sel(probe=list(SENSORS))[1:]
    # Gaps that are solved to 1e-13 m leave pressures, and with them temperatures, as uncertain.
    np.testing.assert_allclose(sensed, temperature, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(moved, actual(response)[1:], rtol=0.0, atol=1e-12)


def test_without_thermometers_it_is_the_simulator_at_every_position(
    estimator, response, samples, tmp_path
):
    """It is told heat and position; its model goes through a file."""
    write_observer(estimator.model, tmp_path / "model.h5")
    told = JointAware(read_observer(tmp_path / "model.h5"))
    assert fingerprint(told.model) == fingerprint(estimator.model)
    state, found = told.initial_state(), []
    for (time, *_, place), power in zip(samples, response["source_power"].to_numpy(), strict=True):
        told.parts.views(state)["linear"][-2:] = *power, 0.0
        state, estimate = told.sample(state, time, [np.nan] * 4 + [place])
        found.append(estimate)
    moved, _ = here(told.axes, told.details, found)
    np.testing.assert_allclose(moved, actual(response), rtol=0.0, atol=1e-9)
    for k, axis in enumerate("xy"):
        offset = actual(response, "line_offset")[:, 0, k]
        of_line = [estimate.displacement[k] for estimate in found]
        np.testing.assert_allclose(of_line, offset, rtol=0.0, atol=1e-9)
        slope = actual(response, "line_slope")[:, 0, k]
        np.testing.assert_allclose(detail(told, found, f"{axis}_slope"), slope, rtol=0.0, atol=1e-8)
        assert (detail(told, found, f"{axis}_P0") == 50.0).all()
        asked = 1e3 * response["asked_position"].to_numpy()[0]
        there = [detail(told, found, name_at(axis, at)) for at in asked]
        actually = actual(response, "asked_displacement")[:, 0, :, k]
        np.testing.assert_allclose(np.transpose(there), actually, rtol=0.0, atol=1e-9)


def test_thermometers_tell_the_displacement_wherever_the_axis_stands(estimator, response, samples):
    _, found = estimates(estimator, samples)
    moved, _ = here(estimator.axes, estimator.details, found)
    error, size = np.abs(moved - actual(response)), np.abs(actual(response)).max(axis=0)
    # The heat is found within some samples from its onset.
    assert (error[30:].max(axis=0) < 0.02 * size).all()
    # A model that is told that the axis stands in the middle is off by the error of its place.
    standing = [(*sample[:-1], 0.05) for sample in samples]
    there, _ = here(estimator.axes, estimator.details, estimates(estimator, standing)[1])
    wrong = np.abs(there - actual(response))
    assert (wrong[30:].max(axis=0) > 5.0 * error[30:].max(axis=0)).all()


def test_a_continued_run_is_the_uninterrupted_one(estimator, samples):
    assert_goes_on(estimator, samples)


def test_a_broken_thermometer_is_left_out_while_the_axis_moves(estimator, response, samples):
    broken = np.array(samples)
    broken[40:, 2] += 8.0
    _, found = estimates(estimator, broken.tolist())
    assert {name for one in found[40:] for name in one.distrusted} == {"guide"}
    moved, band = here(estimator.axes, estimator.details, found)
    assert (np.abs(moved - actual(response)) <= band).all()
    assert (band[-1] < 1e-3 * np.abs(actual(response)).max(axis=0)).all()


def test_a_reading_where_the_axis_stands_corrects_a_warm_start_along_the_stroke(
    estimator, response, samples
):
    late, start = samples[60:], estimator.warm_state()
    shown = actual(response)[60:]
    times = [time for time, *_ in late]
    touched = list(with_probe_readings(late, np.array(times[5:6]), shown[5:6]))
    (_, alone), (_, told) = (estimates(estimator, rows, start) for rows in (late, touched))
    asked = actual(response, "asked_displacement")[60:, 0]
    for at in (0, -1):
        name = name_at("x", 1e3 * response["asked_position"].to_numpy()[0, at])
        before, after = (
            np.abs(detail(estimator, found, name) - asked[:, at, 0])[5:11].max()
            for found in (alone, told)
        )
        assert after < 0.1 * before
    assert (told[5].band < 0.3 * alone[5].band).all()


def test_the_command_takes_readings_where_the_axis_stands(estimator, response, tmp_path):
    model, given = tmp_path / "knee.h5", tmp_path / "run.nc"
    write_observer(estimator.model, model)
    write_response(response, given)
    time, moved = float(response["time"][10]), 1e6 * actual(response)[10, 0]
    (tmp_path / "probe.csv").write_text(f"time_s,x_um\n{time},{moved}\n")
    bands = []
    for more in ([], ["--readings", tmp_path / "probe.csv"]):
        assert run("estimate", model, given, "--warm", "--out", tmp_path / "e.csv", *more) == 0
        _, rows = read_estimate((tmp_path / "e.csv").read_text("utf-8").splitlines(True), "e.csv")
        bands.append(rows[10].band[0])
    assert bands[1] < 0.9 * bands[0]


def test_a_power_that_a_control_knows_is_one_more_reading_beside_the_position(
    estimator, response, samples
):
    """Its heat is known at once: nothing is left to the thermometers."""
    shares = {"bearings": 0.3}
    told = replace(estimator, model=replace(estimator.model, power_shares=shares))
    rows = list(samples_in(response, SENSORS, axes=["y"], shares=shares))
    assert [one.name for one in told.channels][4:6] == ["y_pos", "bearings_power"]
    (_, blind), (_, found) = estimates(estimator, samples), estimates(told, rows)
    without, error = (
        np.abs(here(told.axes, told.details, one)[0] - actual(response)).max(axis=0)
        for one in (blind, found)
    )
    assert (error < 1e-3 * without).all()


@pytest.mark.parametrize("place", [np.nan, 0.3, -5.0], ids=["none", "beyond", "far"])
def test_a_position_that_is_none_is_missing_and_stays_what_it_was(estimator, samples, place):
    state, _ = estimates(estimator, samples[:20])
    time, *values, _ = samples[20]
    _, without = estimator.sample(state, time, [*values, place])
    _, stays = estimator.sample(state, time, [*values, samples[19][-1]])
    assert without.missing == ("y_pos",)
    assert Status.READING_MISSING in without.status
    assert np.array_equal(without.displacement, stays.displacement)


@pytest.mark.parametrize("away", [1, 30, pytest.param(360, marks=pytest.mark.long)])
def test_the_band_holds_what_an_axis_does_whose_position_is_missing(estimator, away):
    assert_held(estimator, slice(40, 40 + away), [0])


def test_a_model_without_speeds_has_the_band_of_the_place_alone(estimator, samples):
    known = replace(estimator.model.calibrated, speeds=())
    old = JointAware(replace(estimator.model, calibrated=known))
    rows = np.array(samples[:60])
    rows[30:40, -1] = np.nan
    now, before = (estimates(one, rows.tolist())[1] for one in (estimator, old))
    assert all(Status.UNSETTLED in one.status for one in before[30:40])
    assert not any(Status.UNSETTLED in one.status for one in before[40:])
    assert all(Status.UNSETTLED in one.status for one in now[40:45])
    later = zip(now[31:], before[31:], strict=True)
    assert all((one.band > other.band).all() for one, other in later)


def test_a_state_from_before_positions_could_be_missing_goes_on(estimator, samples):
    state, _ = estimates(estimator, samples[:40])
    begins = next(at.start for name, at, _ in estimator.parts.parts if name == "position_away")
    np.testing.assert_array_equal(completed(state[:begins], estimator.initial_state()), state)


def test_a_log_and_a_service_name_the_position(estimator, samples):
    names = ("bearing_K", "guide_K", "table_K", "ambient_K", "y_pos_mm")
    values = np.array(samples)[:, 1:]
    log = Log(
        times=np.array(samples)[:, 0],
        starts=(0,),
        columns=tuple(column_named(name) for name in names),
        values=values,
    )
    read = list(KIND.log(estimator.model, [log], "log", None, Cold()))
    np.testing.assert_allclose(read, samples, rtol=1e-12)
    other = replace(log, columns=tuple(column_named(one) for one in (*names[:-1], "place_mm")))
    with pytest.raises(InputError, match=r"day\.csv: no column y_pos_mm, .*--column THEIRS=y_pos"):
        list(KIND.log(estimator.model, [other], "day.csv", None, Cold()))
    intake = KIND.intake(estimator.model, True)
    assert intake.names == (*names, "x_um", "y_um")
    given, _ = intake.convert([1.0, 2.0, 3.0, 0.5, 120.0, np.nan, np.nan], 0.0)
    assert given[:5] == pytest.approx([1.0, 2.0, 3.0, 0.5, 0.12])


def test_a_search_does_not_lose_the_way_of_an_axis_in_longer_steps(machine, response):
    moves = run_in(response, machine, "run")
    inputs = moves.inputs.copy()
    inputs[:, -1] = 0.05
    stands = replace(moves, inputs=inputs)
    found, coarse = searched(machine, [moves, stands], 20)
    assert found is moves
    assert len(coarse.inputs) == 20


@pytest.mark.long
def test_a_calibration_finds_what_differs_and_its_band_holds_along_the_stroke(case, tmp_path):
    """The plant convects twice as much as the case says, and rests on other positions."""
    plant = case.replace(convection_W_m2K={"exterior": 12.0}, march={"duration_min": 40.0})
    runs = {}
    for level, places in ((1.0, (200, -100, 50)), (2.0, (0, 150, -50))):
        path = tmp_path / f"course{level:g}.csv"
        rows = [(700.0 * k, at) for k, at in enumerate(places)]
        path.write_text("time_s,position_mm\n" + "".join(f"{t:g},{at}\n" for t, at in rows))
        one = plant.replace(heat_input={"level": level}, axes={"y": {"file": str(path)}})
        runs[f"{level:g}"] = simulate(one, accuracy=False).response
    effort = Effort(Search(starts=0, steps=40, evaluations=6), Drawing(draws=2, duration=1800.0))
    found = calibrate_joint_aware(
        case, runs, SENSORS, fitted=["film", "heat", "expansion"], effort=effort
    )
    film = dict(zip((one.name for one in found.fit.parameters), found.fit.coordinates, strict=True))
    assert np.exp(film["film"]) > 1.5
    response = simulate(plant.replace(heat_input={"level": 1.5}), accuracy=False).response
    estimator = JointAware(found.model)
    _, made = estimates(estimator, samples_in(response, SENSORS, axes=["y"]))
    moved, band = here(estimator.axes, estimator.details, made)
    error = np.abs(moved - actual(response))
    assert (error[30:].max(axis=0) < 0.02 * np.abs(actual(response)).max(axis=0)).all()
    assert (error <= band).mean() > 0.8
    places = 1e3 * response["asked_position"].to_numpy()[0]
    there = [[detail(estimator, made, name_at(axis, at)) for axis in "xy"] for at in places]
    wanted = actual(response, "asked_displacement")[:, 0].transpose(1, 2, 0)
    assert (np.abs(there - wanted) <= band.T).mean() > 0.8


def test_what_knows_no_axis_says_so_in_one_line(machine, estimator):
    with pytest.raises(InputError, match="no moving axis"):
        with_linear_joint(machine)
    with pytest.raises(InputError, match="moving axis"):
        KIND.start(estimator.model, Options(ageing=("film",)))


def test_the_control_is_given_the_line_over_the_whole_stroke(estimator):
    assert KIND.strokes(estimator.model) == {
        "x": Stroke(0.05, -0.1, 0.2),
        "y": Stroke(0.05, -0.1, 0.2),
    }


def test_commands_take_a_log_to_lines_for_the_control(estimator, response, samples, tmp_path):
    """`estimate`, `validate` and `compensate`, which takes K0, slope and P0 from the table."""
    write_observer(estimator.model, tmp_path / "model.h5")
    rows = [[time, *values, 1e3 * place] for time, *values, place in samples]
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    head = "time_s,bearing_K,guide_K,table_K,ambient_K,y_pos_mm"
    (tmp_path / "log.csv").write_text("\n".join([head, *lines]) + "\n")
    response.to_netcdf(tmp_path / "run.nc")
    (tmp_path / "offsets.toml").write_text(SLOPED)
    model, log, table = (tmp_path / name for name in ("model.h5", "log.csv", "estimate.csv"))
    assert run("estimate", model, log, "--out", table) == 0
    read = np.genfromtxt(table, delimiter=",", names=True)
    _, found = estimates(estimator, samples)
    moved, _ = here(estimator.axes, estimator.details, found)
    np.testing.assert_allclose(read["x_here_um"], 1e6 * moved[:, 0], atol=1e-3)
    line = read["x_um"] + read["x_slope_um_per_m"] * 1e-3 * (200.0 - read["x_P0_mm"])
    assert np.abs(line - read["x_here_um"])[10:20].max() < 5.0  # it stands at 200 mm then
    assert run("validate", model, tmp_path / "run.nc") == 0
    settings, offsets = tmp_path / "offsets.toml", tmp_path / "offsets.csv"
    assert run("compensate", table, "--settings", settings, "--out", offsets) == 0
    given = np.genfromtxt(offsets, delimiter=",", names=True)
    assert given["slope_Y_um_per_m"][-1] == pytest.approx(-read["y_slope_um_per_m"][-1], abs=2.0)
    assert (given["P0_Y_mm"] == 50.0).all()


def test_a_control_that_interpolates_is_given_a_table(estimator, samples, tmp_path):
    """An offset for each position; the service makes it of the estimate as `compensate` does."""
    write_observer(estimator.model, tmp_path / "model.h5")
    (tmp_path / "offsets.toml").write_text(TABLE)
    section = ModelSection(
        file=tmp_path / "model.h5",
        interval_s=estimator.model.step,
        offsets=tmp_path / "offsets.toml",
        reads="above-ambient",
    )
    model = load_model(section, tmp_path / "kept")
    machine = initial_state("mill", model, samples[0][0])
    for time, *values, place in samples[:20]:
        arrived = (*values, 1e3 * place, np.nan, np.nan)
        machine, _ = process_sample(model, machine, (time, arrived), Times(time, time), 0.0, 1.0)
    said = as_json(machine.latest)
    for axis, at in (("low", -100), ("high", 200)):
        displacement = said["details"][f"x_at_{at}_um"]
        assert abs(displacement) > 1.0
        assert said["offsets_um"][axis] == pytest.approx(-displacement, abs=0.06)


def test_no_machine_of_a_service_waits_for_the_table_of_a_missing_position(
    estimator, samples, tmp_path, monkeypatch
):
    write_observer(estimator.model, tmp_path / "model.h5")
    section = ModelSection(
        file=tmp_path / "model.h5", interval_s=estimator.model.step, reads="above-ambient"
    )
    model = load_model(section, tmp_path / "kept")
    monkeypatch.setattr(unreported_motion, "unreported_motion", lambda _: pytest.fail("made late"))
    rows = np.array(samples[:20])
    rows[10:, -1] = np.nan
    assert Status.UNSETTLED in estimates(model.estimator, rows.tolist())[1][-1].status


def test_a_machine_goes_to_other_processes(machine):
    """A batch of validations marches in several of them, also after a march in the first."""
    inputs = machine.inputs(np.tile(machine.power, (3, 1)), np.array([[0.0], [0.1], [0.2]]))
    physics = physics_with(machine, {})
    here_marched = simulate_known(physics, inputs, machine.step)
    there = simulate_known(pickle.loads(pickle.dumps(physics)), inputs, machine.step)
    assert all(map(np.array_equal, here_marched, there))


@pytest.fixture(scope="module")
def program(estimator, samples):
    return export_program(estimator, name="m", samples=samples)


@needs_gcc
@pytest.mark.parametrize("precision", PRECISIONS)
def test_its_program_follows_the_axis_with_every_warning_and_sanitiser(
    estimator, samples, precision, tmp_path
):
    found = export_program(estimator, precision, "m", samples)
    checked = SANITISED if precision is Precision.DOUBLE else []
    figures = selftest(written(found, tmp_path), "m", "-O1", *checked)
    assert figures["state"] == found.state
    assert figures["largest displacement"] > 20e-6


@needs_gcc
def test_its_program_has_the_modulus_of_the_calibration(machine, response, samples, tmp_path):
    """The springs of the ties follow it: the joints of the program were less stiff."""
    stiffer = observer(machine.strained(1.1, 1.0), {"run": response})
    selftest(written(export_program(stiffer, name="m", samples=samples), tmp_path), "m", "-O1")


@needs_gcc
def test_its_program_gives_the_line_and_the_place_with_their_bands(
    estimator, samples, program, tmp_path
):
    got = list(compiled(program, tmp_path)([row[1:] for row in samples]))
    _, there = estimates(estimator, samples)
    for k, axis in enumerate("xy"):
        for name, scale, allowed in (
            ("here", 1.0, 1e-11),
            ("slope", 1.0, 1e-10),
            ("P0", 1e3, 1e-9),
        ):
            found = scale * np.array([getattr(one, name)[k] for one in got])
            known = detail(estimator, there, f"{axis}_{name}")
            np.testing.assert_allclose(found, known, rtol=0.0, atol=allowed)
        # The state without a reading that jumps at the onset is only near that of Python.
        found = np.array([one.slope_band[k] for one in got[5:]])
        known = detail(estimator, there[5:], f"{axis}_slope_band")
        np.testing.assert_allclose(found, known, rtol=1e-9)


@needs_gcc
def test_a_position_that_is_none_is_missing_in_its_program(estimator, samples, program, tmp_path):
    """As in Python, where the axis stays; the next one is that of a way from there."""
    given = np.array(samples[:40])
    given[10, -1], given[20:23, -1], given[30, -1] = np.nan, 0.3, -5.0
    got = as_in_python(program, estimator, given.tolist(), tmp_path)
    missing = [k for k, one in enumerate(got) if one.status & Status.READING_MISSING]
    assert missing == [10, 20, 21, 22, 30]
    _, there = estimates(estimator, given.tolist())
    _, wide = here(estimator.axes, estimator.details, there)
    # The state without a reading that jumps at the onset is only near that of Python.
    for found, known in (("band", [one.band for one in there]), ("here_band", wide)):
        bands = np.array([list(getattr(one, found)) for one in got[5:]])
        np.testing.assert_allclose(bands, known[5:], rtol=1e-6)


@needs_gcc
def test_its_function_block_has_the_band_of_a_missing_position(estimator, tmp_path):
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="needs tree-sitter-iec61131-3-st")
    gone = slice(10, 30)
    rows = rows_of(estimator, course(estimator, 60, gone), 0.5)
    program = export_program(estimator, Precision.DOUBLE, "m", rows.tolist())
    rows = without_positions(estimator, rows, gone, [0])
    assert_function_block(program, estimator, rows, tmp_path)


@pytest.mark.long
@needs_gcc
@needs_matiec
def test_its_function_block_follows_the_axis(program, tmp_path):
    figures = selftest_by_both(program, tmp_path)
    assert figures["samples"] == program.samples


@pytest.mark.long
@needs_gxx
def test_no_sample_of_its_program_costs_more_than_is_printed(program, tmp_path):
    rows = ",\n".join(
        "{" + ", ".join(map(repr, row[1:])) + "}" for row in program.kept.samples.tolist()
    )
    body = f"""
static const m_real rows[{program.samples}][5] = {{ {rows} }};
int main() {{ static m_state state; static m_estimate found;
  m_init(&state);
  for (int k = 0; k < {program.samples}; k++) {{
    CLEAR(); m_step(&state, rows[k], &found); PRINT(); }} }}
"""
    counted = np.array(counts(program, tmp_path, "m", body))
    assert (counted <= operations(program.worst)).all()
    assert (np.median(counted, axis=0) >= 0.3 * np.array(operations(program.usual))).all()
    assert (counted.min(axis=0) <= operations(program.usual)).all()
