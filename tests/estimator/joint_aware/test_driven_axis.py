"""A joint-aware model with a ball screw or a scale: its error is part of the estimate."""

import numpy as np
import pytest
from exported import SANITISED, needs_gcc, selftest, written
from moving_knee import SCREW, STEEL, moving
from observed import observer
from structured_text import run as run_structured_text

from calibrate.joint_aware.calibration import machine_of
from calibrate.joint_aware.readings import run_in
from estimator.export.structured_text import st_files
from estimator.exporting import export_program
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import fingerprint, read_observer, write_observer
from estimator.joint_aware.readings import samples_in
from estimator.lines import here
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.reduced.machine import along, undriven

SENSORS = ("bearing", "guide")
COURSE = [(0, 0), (60, 0), (90, 200), (240, 200), (270, -100), (480, 30), (510, 85), (1200, 85)]
SCALE = {"expansion_1_K": 8.0e-6, "fixed_mm": -150.0, "lag_s": 300.0}
DRIVES = {"screw": {"ball_screw": SCREW}, "set right": {"ball_screw": SCREW, "zero_mm": 100.0}}
DRIVES["scale"] = {"scale": SCALE}


def case_with(folder, drive):
    knee = moving(folder, COURSE).replace(materials={"steel": STEEL}, axes={"y": drive})
    return knee.replace(march={"duration_min": 20.0, "step_s": 10.0})


@pytest.fixture(
    scope="module", params=["screw", pytest.param("set right", marks=pytest.mark.long), "scale"]
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
    state, found = told.initial_state(), []
    samples = samples_in(response, SENSORS, axes=["y"])
    for (time, *_, place), power in zip(samples, response["source_power"].to_numpy(), strict=True):
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
def test_its_program_has_the_drive(driven, tmp_path):
    """In C and in Structured Text."""
    pytest.importorskip("tree_sitter_iec61131_3_st", reason="needs tree-sitter-iec61131-3-st")
    machine, response = driven
    made = observer(machine, {"run": response})
    samples = list(samples_in(response, SENSORS, axes=["y"]))
    program = export_program(made, name="m", samples=samples)
    done, _ = selftest(written(program, tmp_path / "c"), "m", "-O1", *SANITISED)
    assert done.returncode == 0, done.stdout + done.stderr
    done, _ = run_structured_text(st_files(program), "m", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_calibration_run_is_without_what_the_drive_adds(driven):
    machine, response = driven
    # It moves what the displacement is relative to.
    error = -response["positioning_error"].to_numpy()[:, 0]
    without = run_in(response, machine, "run").displacement
    added = response["displacement"].sel(axis=["x", "y"]).to_numpy() - without
    np.testing.assert_allclose(added[:, 1], error, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(added[:, 0], 0.0, rtol=0.0, atol=1e-15)
    with pytest.raises(InputError, match="run 1: its displacement has the error of a ball screw"):
        run_in(response, undriven(machine), "run 1")


@pytest.mark.parametrize(
    ("drive", "says"),
    [
        ({"scale": SCALE | {"seat": "guide"}}, "has a seat"),
        ({"scale": SCALE | {"follows": "guide"}}, "has a probe that it follows"),
        ({"ball_screw": SCREW | {"nut_surface": "table_top"}}, "has a surface at its nut"),
    ],
    ids=["seat", "follows", "surface"],
)
def test_a_drive_that_feels_the_machine_is_refused(tmp_path, drive, says):
    with pytest.raises(InputError, match=rf"axes\.y: its drive {says}"):
        machine_of(case_with(tmp_path, drive), SENSORS)
