"""A joint-aware model with a ball screw or a scale: its error is part of the estimate."""

from dataclasses import replace

import numpy as np
import pytest
from exported import SANITISED, needs_gcc, selftest, written
from moving_knee import SCREW, STEEL, moving
from observed import observer
from structured_text import run as run_structured_text

from calibrate.joint_aware.calibration import machine_of
from calibrate.joint_aware.misfit import physics_with
from calibrate.joint_aware.physics_fit import Search, fit_physics
from calibrate.joint_aware.readings import run_in
from estimator.export.structured_text import st_files
from estimator.exporting import export_program
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import fingerprint, read_observer, write_observer
from estimator.joint_aware.readings import samples_in
from estimator.lines import here
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.reduced.axis_drive import HEATS, AxisDrives
from thermojoint.reduced.machine import along
from thermojoint.reduced.parameters import active
from thermojoint.reduced.physics import simulate_known

SENSORS = ("bearing", "guide")
COURSE = [(0, 0), (60, 0), (90, 200), (240, 200), (270, -100), (480, 30), (510, 85), (1200, 85)]
SCALE = {"expansion_1_K": 8.0e-6, "fixed_mm": -150.0, "lag_s": 300.0}
DRIVES = {"screw": {"ball_screw": SCREW}, "set right": {"ball_screw": SCREW, "zero_mm": 100.0}}
DRIVES["scale"] = {"scale": SCALE}
#: Of drives that heat the machine, are warmed by it and stand on seats that it moves.
FEELING = {
    "bearings": "fixed-fixed",
    "stretch_um": 30.0,
    "seat": "guide",
    "far_seat": "nose",
    "nut_surface": "screw_foot",
    "nut_share": 0.7,
    "bearing_conductance_W_K": 3.0,
    "bearing_surface": "rear",
    "bearing_share": 0.5,
}
DRIVES["feeling screw"] = {"ball_screw": SCREW | FEELING}
DRIVES["feeling scale"] = {"scale": SCALE | {"seat": "guide", "follows": "bearing"}}
#: Set right where their seats are displaced otherwise than where the axis stands.
DRIVES["seated screw"] = DRIVES["feeling screw"] | {"zero_mm": 170.0}
DRIVES["seated scale"] = DRIVES["feeling scale"] | {"zero_mm": -60.0}


def case_with(folder, drive):
    knee = moving(folder, COURSE).replace(materials={"steel": STEEL}, axes={"y": drive})
    if drive == DRIVES["set right"]:
        # Its joint slides at places where the lines are taken: the program holds some of them.
        knee = knee.replace(joints={"knee": {"friction_coefficient": 0.15, "across": 1}})
    return knee.replace(march={"duration_min": 20.0, "step_s": 10.0})


@pytest.fixture(
    scope="module",
    params=[
        pytest.param("screw", marks=pytest.mark.long),
        "set right",
        pytest.param("scale", marks=pytest.mark.long),
        pytest.param("feeling screw", marks=pytest.mark.long),
        pytest.param("feeling scale", marks=pytest.mark.long),
        "seated screw",
        "seated scale",
    ],
)
def driven(request, tmp_path_factory):
    """The machine, and its response."""
    case = case_with(tmp_path_factory.mktemp("drive"), DRIVES[request.param])
    return along(machine_of(case, SENSORS), ["x", "y"]), simulate(case, accuracy=False).response


def test_told_its_heat_it_is_the_simulator_with_its_drive(driven, tmp_path):
    """Where the axis stands, as a line over the stroke, and after its model went through a file."""
    machine, response = driven
    made = observer(machine, {"run": response})
    write_observer(made.model, tmp_path / "model.h5")
    told = JointAware(read_observer(tmp_path / "model.h5"))
    assert fingerprint(told.model) == fingerprint(made.model)
    state, found, heat = told.initial_state(), [], response["source_power"].to_numpy()[:, :1]
    samples = samples_in(response, SENSORS, axes=["y"])
    for (time, *_, place), power in zip(samples, heat, strict=True):
        told.parts.views(state)["linear"][-2:] = *power, 0.0
        state, estimate = told.sample(state, time, [np.nan] * 3 + [place])
        found.append(estimate)
    actual = {
        name: response[name].sel(axis=["x", "y"]).to_numpy()
        for name in ("displacement", "line_offset")
    }
    moved, _ = here(told.axes, told.details, found)
    np.testing.assert_allclose(moved, actual["displacement"], rtol=0.0, atol=1e-9)
    offsets = np.array([estimate.displacement for estimate in found])
    np.testing.assert_allclose(offsets, actual["line_offset"][:, 0], rtol=0.0, atol=1e-9)


@needs_gcc
def test_its_program_has_the_drive(driven, request, tmp_path):
    """In C and in Structured Text."""
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="needs tree-sitter-iec61131-3-st")
    machine, response = driven
    made = observer(machine, {"run": response})
    samples = list(samples_in(response, SENSORS, axes=["y"]))
    program = export_program(made, name="m", samples=samples)
    figures = selftest(written(program, tmp_path / "c"), "m", "-O1", *SANITISED)
    run_structured_text(st_files(program), "m", tmp_path)
    if request.node.callspec.params["driven"] == "set right":
        assert figures["own status words"] > 0


def test_known_inputs_are_marched_as_the_simulator_does(driven):
    machine, response = driven
    run = run_in(response, machine, "run")
    sensed, moved = simulate_known(physics_with(machine, {}), run.inputs, machine.step)
    actual = response["temperature"].sel(probe=list(SENSORS))[1:]
    np.testing.assert_allclose(sensed, actual, rtol=0.0, atol=1e-6)
    actual = response["displacement"].sel(axis=["x", "y"])[1:]
    np.testing.assert_allclose(moved, actual, rtol=0.0, atol=1e-9)
    assert np.abs(moved).max() > 1e-5


def test_a_screw_that_heats_the_machine_does_not_change_its_surroundings(tmp_path):
    """The ambient, and heat of faces and bodies that is unknown, warm it as without the screw."""
    seen = {}
    for drive in ("screw", "feeling screw"):
        machine = machine_of(case_with(tmp_path, DRIVES[drive]), SENSORS)
        system = machine.conduction + machine.convection
        heats = np.column_stack([machine.ambient, machine.faces, machine.bodies])
        seen[drive] = machine.sensors @ np.linalg.solve(system, heats)
    np.testing.assert_allclose(seen["screw"][:, 0], 1.0, rtol=1e-4)
    np.testing.assert_allclose(seen["feeling screw"], seen["screw"], rtol=0.0, atol=1e-3)


def test_its_tangent_is_what_small_motions_of_its_probes_do(driven):
    """Also where the drive is set right, away from the place."""
    machine, _ = driven
    drives, rng = machine.guide.drives, np.random.default_rng(7)
    places = drives.with_zeros(np.array([0.05]))
    rows = {tuple(at): rng.normal(size=(len(machine.elastic.probe_thermal), 3)) for at in places}
    small = 1e-9 * rng.normal(size=3)
    probes = np.array([rows[tuple(at)] @ small for at in places])
    moved = drives.displacement(drives.cold, places, probes)[0]
    found = drives.tangent(rows.__getitem__, (0.05,)) @ small
    np.testing.assert_allclose(found, moved, rtol=1e-6, atol=1e-16)


def test_responses_of_a_driven_machine_need_a_model_with_its_drive(driven):
    machine, response = driven
    nothing = AxisDrives((None,), np.zeros((len(machine.start), 0)), np.zeros((0, 1)))
    without = replace(machine, guide=replace(machine.guide, drives=nothing))
    with pytest.raises(InputError, match="run 1: its displacement has the error of a ball screw"):
        run_in(response, without, "run 1")


def test_the_friction_of_a_screw_is_fitted(tmp_path):
    """Its nut and its bearing rub half as much again as the case says."""
    case = case_with(tmp_path, {"ball_screw": SCREW | FEELING})
    rubs = {name: 1.5 * SCREW[name] for name in HEATS if name in SCREW}
    response = simulate(case.replace(axes={"y": {"ball_screw": rubs}}), accuracy=False).response
    machine = along(machine_of(case, SENSORS), ["x", "y"])
    assert {"screw heat y", "screw film y"} <= {one.name for one in active(machine)}
    search = Search(starts=0, evaluations=8)
    fit = fit_physics(machine, [run_in(response, machine, "run")], ["screw heat y"], search)
    assert np.exp(fit.coordinates) == pytest.approx(1.5, rel=1e-3)
