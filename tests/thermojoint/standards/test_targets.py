"""Tests with the machine's own motion: the turning machine, the rotary table, the targets."""

import tomllib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from fesim.case.schema import parse_case
from fesim.simulate import simulate
from meshes.box_machine import meshed
from meshes.exchange import read_structure
from meshes.turning_machine import TURNING_MACHINE
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import write_response
from thermojoint.plausibility import of_case
from thermojoint.standards.iso230_3.evaluation import evaluate
from thermojoint.standards.iso230_3.protocol import Protocol
from thermojoint.standards.iso230_3.record import response_record, with_tilts

CASES = Path(str(files("thermojoint").joinpath("cases")))
TURNING = ("iso13041_8_spindle", "iso13041_8_z_axis", "iso13041_8_x_axis")


def case_of(name, **march):
    case = parse_case((CASES / f"{name}.toml").read_text("utf-8"), name, CASES)
    return case.model_copy(update={"march": case.march.model_copy(update=march)})


def simulated(name):
    """The first 75 minutes in long steps."""
    return simulate(case_of(name, step_s=150.0, duration_min=75.0)).response


@pytest.fixture(scope="module")
def z_axis():
    return simulated("iso13041_8_z_axis")


def by_symbol(protocol, record):
    return {one.symbol: one.value for one in evaluate(protocol, record).parameters}


def test_the_shipped_mesh_is_that_of_the_turning_machine():
    shipped, made = read_structure(CASES / "iso13041_8.vtu"), meshed(TURNING_MACHINE, 0.05)
    assert np.allclose(shipped.mesh.p, made.mesh.p, rtol=0.0, atol=1e-12)
    assert {name: one.size for name, one in shipped.surfaces.items()} == {
        name: one.size for name, one in made.surfaces.items()
    }


def test_the_tests_of_turning_differ_in_what_runs_alone():
    def machine(name):
        data = tomllib.loads((CASES / f"{name}.toml").read_text("utf-8"))
        for axis in data["axes"].values():
            axis.pop("file", axis.pop("position_mm", None))
        return {key: data[key] for key in data if key not in ("title", "sources", "heat_input")}

    assert machine(TURNING[0]) == machine(TURNING[1]) == machine(TURNING[2])


@pytest.mark.parametrize("name", [*TURNING, "iso230_3_rotary_axis", "iso230_3_linear_axis"])
def test_a_shipped_case_is_warned_of_nothing(name):
    assert of_case(case_of(name), name) == []


@pytest.mark.long
def test_a_moving_axis_is_read_at_its_two_targets(z_axis):
    record = response_record(z_axis)
    axis, asked = list(z_axis["moving_axis"].to_numpy()).index("z"), z_axis["asked_displacement"]
    for mark, at in (("P1", -0.15), ("P2", 0.2)):
        place = z_axis["asked_position"].to_numpy()[axis].tolist().index(pytest.approx(at))
        assert np.array_equal(record.displacements[f"z{mark}"], asked.to_numpy()[:, axis, place, 2])
        assert f"A{mark}" in record.tilts
    # While it is heated by its own motion alone.
    assert not z_axis["heat_input"].to_numpy().any()
    assert evaluate(Protocol.LINEAR_AXIS, record).period == pytest.approx((0.0, 4350.0))


def test_the_screw_makes_the_far_target_move_further(z_axis):
    record = response_record(z_axis, {"z": "z"})
    found = by_symbol(Protocol.LINEAR_AXIS, with_tilts(record, {"scale": ("zP2", "zP1")}, 0.35))
    assert found["d(zP2)60"] > 5.0 * found["d(zP1)60"] > 0.0
    # The screw, 1 to 10 K warmer, between the targets.
    assert 11.5e-6 < found["d(scale)60"] < 115e-6
    assert not [symbol for symbol in found if symbol.startswith("d(x")]


def test_an_axis_that_is_back_at_every_sample_is_read_at_its_two_targets(z_axis):
    cycles = z_axis.copy(deep=True)
    cycles["axis_position"][:] = z_axis["axis_position"][0]
    found, told = response_record(cycles), response_record(z_axis)
    assert list(found.displacements) == list(told.displacements)
    frictionless = cycles.assign(running_heat=0.0 * cycles["running_heat"])
    period = evaluate(Protocol.LINEAR_AXIS, response_record(frictionless)).period
    assert period == pytest.approx((0.0, 4350.0))


@pytest.mark.long
def test_a_knee_that_warms_by_moving_is_read_at_its_two_targets():
    response = simulated("iso230_3_linear_axis")
    found = by_symbol(Protocol.LINEAR_AXIS, response_record(response, {"y": "y"}))
    # Of the height of the stroke the screw grows, and the column beside it.
    assert found["d(yP2)60"] > 2e-6
    assert found["d(yP1)60"] > 0.0
    assert float(response["running_heat"].max()) > 10.0


@pytest.mark.long
def test_a_turning_spindle_lifts_its_workpiece():
    record = response_record(simulated("iso13041_8_spindle"))
    found = by_symbol(Protocol.SPINDLE, record)
    assert 5e-6 < found["d(y)60"] < 100e-6
    # The work goes up: the tool goes down against it.
    assert record.displacements["y"][-1] < 0.0
    assert {"A", "B", "C"} <= set(record.tilts)


def test_a_rotary_table_grows_and_tilts_in_its_plane_of_symmetry():
    record = response_record(simulated("iso230_3_rotary_axis"))
    found = by_symbol(Protocol.ROTARY_AXIS, record)
    # The table of 100 mm, some kelvins warmer, and the bed below it.
    grown = 13.7e-6 * 0.1 * found["ΔT(work)60"]
    assert 0.5 * grown < found["d(y)60"] < 4.0 * grown
    assert found["d(A)60"] > 0.0
    assert not {"x"} & set(record.displacements)
    assert not {"B", "C"} & set(record.tilts)


def test_several_axes_that_move_are_refused_in_one_line(command, z_axis, tmp_path):
    moved = z_axis.copy(deep=True)
    moved["axis_way"][:, 1] = 1e-3 * np.arange(moved.sizes["time"])
    with pytest.raises(InputError, match="z, x move; a test moves one axis"):
        response_record(moved)
    path = tmp_path / "moved.nc"
    write_response(moved, path)
    code, _, err = command("iso230-3", path, "--test", "linear-axis")
    assert (code, err.count("\n")) == (2, 1)


def test_a_displacement_that_a_response_lacks_is_refused(z_axis):
    with pytest.raises(InputError, match="no axis named 'zz'"):
        response_record(z_axis, {"Z": "zz"})
