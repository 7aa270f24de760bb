"""Guides that roll or float, and a slide on a linear motor."""

import numpy as np
import pytest

from thermojoint.verification.moving_axis import on_axis, slide_data, write_course
from thermojoint.verification.structures import marched

STROKE = (0.0, 320.0)
#: Of rollers, in grease: across they hold.
ROLLING = {
    "normal_law": "back-burdekin",
    "back_burdekin": {"coefficient_um": 2.0, "exponent": 0.9},
    "conductance": {"law": "fixed", "value_W_m2K": 800.0},
    "friction_coefficient": 0.3,
}
#: Of a film of oil, whose stiffness is that at its load.
FLOATING = ROLLING | {
    "back_burdekin": {"coefficient_um": 5.0, "exponent": 1.0},
    "friction_coefficient": 0.0,
}
RUNNING = {"running_friction_coefficient": 0.004}
COURSE = np.array([0.0, 60.0, 90.0, 200.0, 300.0]), np.array([0.0, 0.0, 0.31, 0.05, 0.2])


def slide(folder, shown, law):
    data = slide_data(folder, shown)
    return data | {"joints": {"joint": data["joints"]["joint"] | law}}


def test_a_slide_on_a_film_of_oil_is_that_of_the_machine_meshed_there(tmp_path):
    data = on_axis(slide(tmp_path, 0.12, FLOATING), STROKE, position_mm=240.0)
    riding, meshed = marched(tmp_path, data), marched(tmp_path, slide(tmp_path, 0.24, FLOATING))
    for name in ("displacement", "temperature", "pressure", "heat_flow"):
        size = float(np.abs(meshed[name]).max())
        np.testing.assert_allclose(riding[name], meshed[name], rtol=0.0, atol=1e-6 * size)


@pytest.mark.parametrize("law", [ROLLING, FLOATING], ids=["rolling", "floating"])
def test_what_moves_on_rollers_or_oil_loses_no_heat_and_rubs_by_its_load(tmp_path, law):
    course = write_course(tmp_path, *COURSE)
    data = on_axis(slide(tmp_path, 0.12, law | RUNNING), STROKE, file=course)
    found = marched(tmp_path, data)
    assert float(np.abs(found["heat_balance"]).max()) < 1e-8
    # Mean speed of a step, times the load at its start.
    force = (found["pressure"] * found["contact_area"]).sum("contact").to_numpy()[:-1]
    way = np.diff(found["axis_way"].to_numpy()[:, 0])
    heat = 0.004 * force * way / np.diff(found["time"])
    np.testing.assert_allclose(found["running_heat"][1:, 0], heat, rtol=1e-9, atol=1e-12)
    assert heat.max() > 0.1
    # The load stays; what rolls or floats is pressed evenly at first, then as it bends.
    change = force / force[0] - 1.0
    assert np.abs(change).max() < 1e-4
    assert float(found["pressure"].std("contact").max()) > 1e3


def test_a_linear_motor_heats_what_it_moves_and_its_control_reads_a_scale(tmp_path):
    """Its windings have a heat of their own; without a screw the scale alone errs."""
    data = slide_data(tmp_path, 0.12)
    data["sources"]["windings"] = {
        "body": "slide",
        "reference_power_W": 60.0,
        "reading": "total",
        "heat_input": {"kind": "step", "level": 0.5},
    }
    data["heat_input"]["level"] = 0.0
    scale = {"expansion_1_K": 10e-6, "fixed_mm": 50.0, "head_mm": 20.0, "follows": "below"}
    course = write_course(tmp_path, *COURSE)
    found = marched(tmp_path, on_axis(data, STROKE, file=course, scale=scale))
    assert float(np.abs(found["heat_balance"]).max()) < 1e-8
    assert found["source_power"].sel(source="windings")[1:].to_numpy() == pytest.approx(30.0)
    last = found.isel(time=-1)
    tool, below = (float(last["temperature"].sel(probe=name)) for name in ("tool", "below"))
    assert tool > 2.0 * below > 0.1
    error = 10e-6 * below * (last["asked_position"][0].to_numpy() + 0.02 - 0.05)
    np.testing.assert_allclose(last["asked_positioning_error"][0], error, rtol=1e-9)
