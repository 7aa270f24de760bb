"""The joint-aware estimator of a machine with several axes, in a chain and side by side."""

from dataclasses import replace

import numpy as np
import pytest
from exported import SANITISED, as_in_python, needs_gcc, selftest, written
from observed import estimates, observer
from three_axes import coarse
from unseen_motion import (
    assert_function_block,
    assert_held,
    assert_held_after_a_gap,
    course,
    followed,
    rows_of,
    without_positions,
)

from calibrate.joint_aware.calibration import Effort, calibrate_joint_aware, machine_of
from calibrate.joint_aware.misfit import physics_with
from calibrate.joint_aware.open_band import Drawing
from calibrate.joint_aware.physics_fit import Search
from calibrate.joint_aware.readings import run_in
from estimator.export.program import Precision
from estimator.exporting import export_program
from estimator.interface import Status
from estimator.joint_aware import guided_program
from estimator.joint_aware import program as joint_aware_program
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.joint_aware.model_file import fingerprint, read_observer, write_observer
from estimator.joint_aware.readings import samples_in
from estimator.lines import Stroke, here
from fesim.simulate import simulate
from thermojoint.reduced import physics
from thermojoint.reduced.machine import along
from thermojoint.reduced.physics import simulate_known

#: (s, mm): each axis alone, with another one, all together; aligned and between stations.
COURSES = {
    "x": [(0, -200), (90, -200), (240, 250), (480, 250), (510, 30), (1200, -130)],
    "y": [(0, 50), (150, 50), (270, -270), (600, -270), (900, 300), (1200, 85)],
    "z": [(0, -100), (300, 110), (600, 110), (630, 200), (1200, 0)],
}
SENSORS = ("ram", "column_top", "bed_front")
AXES = ("x", "y", "z")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """The drive along y is set right away from where the axis stands, on its seats."""
    case = coarse(tmp_path_factory.mktemp("axes"), COURSES)
    return case.replace(axes={"y": {"zero_mm": 120.0}})


@pytest.fixture(scope="module")
def response(case):
    return simulate(case, accuracy=False).response


@pytest.fixture(scope="module")
def machine(case):
    return along(machine_of(case, SENSORS), AXES)


@pytest.fixture(scope="module")
def estimator(machine, response):
    return observer(machine, {"run": response}, AXES)


@pytest.fixture(scope="module")
def samples(response):
    return list(samples_in(response, SENSORS, axes=AXES))


def test_the_reduced_machine_marches_as_the_simulator(machine, response):
    """With its drives: two heat it, stand on seats that it moves or follow a probe of it."""
    run = run_in(response, machine, "run")
    sensed, moved = simulate_known(physics_with(machine, {}), run.inputs, machine.step)
    temperature = response["temperature"].sel(probe=list(SENSORS))[1:]
    np.testing.assert_allclose(sensed, temperature, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(moved, run.displacement[1:], rtol=0.0, atol=1e-9)
    assert np.abs(moved).max() > 1e-5


def test_known_inputs_are_marched_in_compiled_steps_that_are_the_plain_ones(
    machine, response, monkeypatch
):
    """At other parameters, with sensors that lag and ways that positions do not show."""
    inputs = run_in(response, machine, "run").inputs
    gone = np.linspace(0.0, 0.4, inputs.shape[0])[:, None] * [1.0, 0.0, 2.0]
    compiled = physics_with(machine, {"film": 1.4, "preload": 0.8, "lag ram, s": 20.0})
    # What an exchange in the modes would be: none, but not known to be.
    plain = replace(compiled, held=np.full(compiled.contacts, 1e-12))
    expected = simulate_known(plain, inputs, machine.step, gone)
    monkeypatch.setattr(physics, "conduct_driven", lambda *_: pytest.fail("a plain step"))
    found = simulate_known(compiled, inputs, machine.step, gone)
    np.testing.assert_allclose(found[0], expected[0], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(found[1], expected[1], rtol=0.0, atol=1e-11)
    assert np.abs(found[1]).max() > 1e-5


def told(estimator, samples, response):
    """Estimates without thermometers: heat and positions are given."""
    state, found = estimator.initial_state(), []
    power = response["source_power"].to_numpy()[:, :1]
    for (time, *_, x, y, z), heat in zip(samples, power, strict=True):
        estimator.parts.views(state)["linear"][-2:] = *heat, 0.0
        state, estimate = estimator.sample(state, time, [np.nan] * 4 + [x, y, z])
        found.append(estimate)
    return found


def test_told_its_heat_it_is_the_simulator_with_its_drives(estimator, response, samples, tmp_path):
    """Where the axes stand, and as lines along each; its model goes through a file."""
    write_observer(estimator.model, tmp_path / "model.h5")
    read = JointAware(read_observer(tmp_path / "model.h5"))
    assert fingerprint(read.model) == fingerprint(estimator.model)
    found = told(read, samples, response)
    moved, _ = here(read.axes, read.details, found)
    np.testing.assert_allclose(moved, response["displacement"], rtol=0.0, atol=1e-9)
    names = [channel.name for channel in read.details]
    details = np.array([estimate.details for estimate in found])
    for k, name in enumerate(AXES):
        offset, slope = (response[f"line_{one}"].to_numpy() for one in ("offset", "slope"))
        for a, moving in enumerate(AXES):
            there = details[:, names.index(f"{name}_K0_{moving}")]
            np.testing.assert_allclose(there, offset[:, a, k], rtol=0.0, atol=1e-9)
            there = details[:, names.index(f"{name}_slope_{moving}")]
            np.testing.assert_allclose(there, slope[:, a, k], rtol=0.0, atol=1e-8)
        # A control is given the line along the axis of its own direction.
        given = [estimate.displacement[k] for estimate in found]
        np.testing.assert_allclose(given, offset[:, k, k], rtol=0.0, atol=1e-9)
    strokes = {"x": Stroke(0.0, -0.3, 0.3), "y": Stroke(0.0, -0.3, 0.3)}
    assert KIND.strokes(read.model) == strokes | {"z": Stroke(0.05, -0.1, 0.2)}


def test_a_displacement_that_no_axis_moves_along_is_that_where_they_stand(machine, response):
    made = observer(machine, {"run": response}, ("y", "z")).model
    without = JointAware(replace(made, moving_axes=tuple(map(oblique, made.moving_axes))))
    assert KIND.strokes(without.model) == {"y": Stroke(0.0, -0.3, 0.3)}
    found = told(without, list(samples_in(response, SENSORS, axes=AXES)), response)
    moved = np.array([estimate.displacement[1] for estimate in found])
    np.testing.assert_allclose(moved, response["displacement"][:, 2], rtol=0.0, atol=1e-9)


def oblique(axis):
    return replace(axis, along="") if axis.name == "z" else axis


def test_channels_are_positions_each_of_which_may_be_missing(estimator, samples):
    intake = KIND.intake(estimator.model, True)
    names = [*(f"{name}_K" for name in (*SENSORS, "ambient")), *(f"{one}_pos_mm" for one in AXES)]
    assert intake.names == (*names, *(f"{one}_um" for one in AXES))
    state, _ = estimates(estimator, samples[:20])
    time, *values, x, _, z = samples[20]
    _, without = estimator.sample(state, time, [*values, x, np.nan, z])
    _, beyond = estimator.sample(state, time, [*values, x, 0.31, z])
    _, stays = estimator.sample(state, time, [*values, x, samples[19][-2], z])
    assert without.missing == beyond.missing == ("y_pos",)
    assert Status.READING_MISSING in without.status
    for one in (without, beyond):
        assert np.array_equal(one.displacement, stays.displacement)


def test_calibrated_it_runs_free_on_a_plant_that_differs(case, tmp_path):
    """The plant expands and convects more, and its axes take other ways than in the runs."""
    iron = {"expansion_1_K": 1.15 * case.materials["cast_iron"].expansion_1_K}
    plant = case.replace(convection_W_m2K={"exterior": 12.0}, materials={"cast_iron": iron})
    runs = {}
    for level, (x, y, z) in ((0.4, (200, 300, 0)), (0.8, (-100, -300, 150))):
        courses = {
            "x": [(0, -x), (1200, x)],
            "y": [(0, -y), (2400, y)],
            "z": [(0, z), (900, 100 - z)],
        }
        folder = tmp_path / f"{level:g}"
        folder.mkdir()
        files = coarse(folder, courses).axes
        one = plant.replace(
            heat_input={"level": level}, axes={name: {"file": files[name].file} for name in AXES}
        )
        runs[f"{level:g}"] = simulate(one, accuracy=False).response
    effort = Effort(Search(starts=0, steps=30, evaluations=5), Drawing(draws=4, duration=1200.0))
    fitted = ["film", "heat", "expansion"]
    found = calibrate_joint_aware(case, runs, SENSORS, fitted=fitted, effort=effort)
    response = simulate(plant.replace(heat_input={"level": 0.6}), accuracy=False).response
    estimator = JointAware(found.model)
    made = estimates(estimator, samples_in(response, SENSORS, axes=AXES))[1]
    moved, band = here(estimator.axes, estimator.details, made)
    actual = response["displacement"].sel(axis=list(estimator.axes)).to_numpy()
    error = np.abs(moved - actual)
    # As its case describes it, the machine is off by the expansion.
    described = observer(machine_of(case, SENSORS), {"run": simulate(case).response}, AXES)
    made = estimates(described, samples_in(response, SENSORS, axes=AXES))[1]
    off = np.abs(here(AXES, described.details, made)[0] - response["displacement"].to_numpy())
    assert off[20:].max() > 0.1 * np.abs(actual).max()
    assert error[20:].max() < 0.2 * off[20:].max()
    assert (error <= band).mean() > 0.8
    # In the middle of the run its drives are warm, and count as cold.
    samples = list(samples_in(response, SENSORS, axes=AXES))[20:]
    made = estimates(estimator, samples, estimator.warm_state())[1]
    moved, wide = here(estimator.axes, estimator.details, made)
    assert (np.abs(moved - actual[20:]) <= wide).mean() > 0.9
    cold, lasts = found.model.band.drive, found.model.modes.drives.lasts
    assert (wide[0] ** 2 > 1.96**2 * cold).all()
    assert cold.max() > 0.0
    np.testing.assert_allclose(found.model.cold_drives(lasts), cold * np.exp(-2.0))


@needs_gcc
def test_its_program_follows_all_axes_with_their_drives(estimator, samples, tmp_path):
    found = export_program(estimator, Precision.DOUBLE, "m", samples[:80])
    names = [one.name for one in found.interface.outputs]
    assert {"here_z", "slope_y", "along_K0_x_z"} <= set(names)
    figures = selftest(written(found, tmp_path), "m", "-O1", *SANITISED)
    assert figures["own status words"] == 0
    assert figures["largest displacement"] > 5e-6


@pytest.mark.parametrize("axes", [[1], [0, 1, 2]])
def test_the_band_holds_what_axes_do_whose_positions_are_missing(estimator, axes):
    assert_held(estimator, slice(40, 70), axes, after=60)


@pytest.mark.parametrize("count", [4, 30])
def test_the_band_holds_what_axes_do_in_a_gap(estimator, count):
    assert_held_after_a_gap(estimator, slice(40, 40 + count))


def test_a_sample_that_is_late_or_lost_is_no_gap(estimator):
    rows = rows_of(estimator, course(estimator, 60, slice(30, 30)), 0.5)
    late = np.delete(rows, 40, axis=0)
    late[50:, 0] += 3.0
    found = followed(estimator, late)
    # Temperatures alone make the band wider in those two samples.
    assert set(np.flatnonzero(found.unsettled)) <= {40, 50}
    assert (found.band < 3.0 * found.band[0]).all()


@pytest.fixture(scope="module")
def hot(estimator):
    """Samples in which joints slide far from where they are, at the positions of the lines."""
    rows = rows_of(estimator, course(estimator, 60, slice(40, 40)), 2.0)
    return rows, export_program(estimator, Precision.DOUBLE, "m", rows.tolist())


@needs_gcc
def test_its_program_settles_joints_that_slide_far(estimator, hot, tmp_path):
    """A line that was held since the joints began to slide was off by 4 um, and more with time."""
    rows, program = hot
    got = as_in_python(program, estimator, rows.tolist(), tmp_path, 1e-9)
    assert not any(one.status & guided_program.LINE_HELD for one in got)
    assert max(one.newton_steps for one in got) < joint_aware_program.DAMPED_STEPS


@pytest.fixture(scope="module")
def unread(estimator):
    """Samples without the positions of two axes for a while, and the program to judge by them."""
    gone = slice(5, 25)
    rows = rows_of(estimator, course(estimator, 40, gone), 0.5)
    program = export_program(estimator, Precision.DOUBLE, "m", rows.tolist())
    return without_positions(estimator, rows, gone, [0, 2]), program


@needs_gcc
def test_its_program_has_the_band_of_missing_positions(estimator, unread, tmp_path):
    rows, program = unread
    got = as_in_python(program, estimator, rows.tolist(), tmp_path, 1e-9)
    expected = followed(estimator, rows)
    for name, values in (("band", expected.band), ("here_band", expected.band_here)):
        found = np.array([list(getattr(one, name)) for one in got])
        np.testing.assert_allclose(found, values, rtol=1e-5)
    unsettled = [bool(one.status & Status.UNSETTLED) for one in got]
    np.testing.assert_array_equal(unsettled, expected.unsettled)


@pytest.mark.long
@needs_gcc
@pytest.mark.parametrize("given", ["hot", "unread"])
def test_its_function_block_settles_far_joints_and_has_the_band_of_missing_positions(
    estimator, given, request, tmp_path
):
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="needs tree-sitter-iec61131-3-st")
    rows, program = request.getfixturevalue(given)
    assert_function_block(program, estimator, rows, tmp_path)
