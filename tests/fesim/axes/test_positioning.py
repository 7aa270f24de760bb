"""A moving axis and its drive: what a warm screw or scale adds to where the bodies are."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_knee import PATH, coarse_data, moving
from repository import ROOT

from fesim.axes.ball_screw import Beside, heat_at_ends, heat_of_nut, moved, tension, warmed
from fesim.axes.positioning import Drive, Surfaces, positioning_error, screw_of, screw_tension
from fesim.axes.setup import drive_of, set_up_axes
from fesim.case.drive_sections import BallScrewSection
from fesim.case.identity import condensation_key, thermal_key
from fesim.case.schema import case_from_data, parse_case
from fesim.march.state_file import fingerprint, load_state, save_state
from fesim.simulate import simulate
from fesim.solid.materials import Material
from thermojoint.artefacts.errors import InputError
from thermojoint.paper.summary import axis_lines, drive_lines
from thermojoint.plausibility import of_case

STEEL = Material(50.0, 7850.0, 470.0, 206e9, 0.3, 11.5e-6)
SCREW = {
    "bearings": "fixed-free",
    "fixed_bearing_mm": -300.0,
    "far_end_mm": 400.0,
    "nut_mm": 10.0,
    "nut_length_mm": 80.0,
    "diameter_mm": 40.0,
    "lead_mm": 10.0,
    "material": "steel",
    "film_W_m2K": 15.0,
    "nut_torque_Nm": 3.0,
    "bearing_torque_Nm": 0.5,
}
FIXED = SCREW | {"bearings": "fixed-fixed", "stretch_um": 30.0}
NO_SEATS = np.full(3, -1)
NO_SURFACES = Surfaces(NO_SEATS, np.zeros((3, 0)))
SCALE = {"expansion_1_K": 8e-6, "fixed_mm": -100.0, "head_mm": 20.0}
#: (s, mm): stands, moves within steps and across them, there and back.
COURSE = [(0, 0), (45, 0), (70, 200), (80, 200), (130, -100), (150, 50), (400, 50)]


def screw_with(**keys):
    return screw_of(BallScrewSection.model_validate(SCREW | keys), STEEL)


def error_of(screw, temperature, *positions):
    drive = Drive(screw, None, None, 0, None, NO_SURFACES, NO_SEATS)
    seats = np.zeros((len(positions), 3))
    return positioning_error(drive, temperature, np.array(positions), seats)


def test_only_what_lies_between_bearing_and_nut_moves_the_nut():
    screw = screw_with()
    temperature = np.zeros(100)
    temperature[60:] = 10.0  # from 0.42 m off the bearing on, which is at 120 mm
    grown = 10.0 * STEEL.expansion
    expected = [0.0, grown * 0.05, grown * 0.09]
    assert np.allclose(
        error_of(screw, temperature, 0.1, 0.16, 0.2), expected, rtol=1e-9, atol=1e-18
    )


def test_with_the_motor_at_the_other_end_the_nut_moves_the_other_way():
    up, down = screw_with(), screw_with(fixed_bearing_mm=400.0, far_end_mm=-300.0)
    rise = np.linspace(0.0, 20.0, 100)
    whole = STEEL.expansion * rise.mean() * 0.7
    apart = error_of(up, rise, 0.15) - error_of(down, rise[::-1], 0.15)
    assert apart == pytest.approx(whole, rel=1e-9, abs=0)


places = st.lists(st.floats(0.05, 0.65), min_size=2, max_size=6)


@given(places)
def test_the_heat_of_the_nut_is_torque_times_angle_and_enters_where_it_passes(way):
    screw = screw_with().made
    times = 7.0 * np.arange(len(way))
    heat = heat_of_nut(screw, times, np.array(way))
    angle = 2.0 * np.pi * np.abs(np.diff(way)).sum() / 0.01
    assert heat.sum() * times[-1] == pytest.approx(3.0 * angle, rel=1e-9, abs=1e-9)
    assert heat_at_ends(screw.heat, times, np.array(way))[0] * times[-1] == pytest.approx(
        0.5 * angle, rel=1e-9, abs=1e-12
    )
    edges = screw.conduction.edges
    beside = (edges[1:] < min(way) - 0.04) | (edges[:-1] > max(way) + 0.04)
    assert np.abs(heat[beside]).max(initial=0.0) <= 1e-9 * (1.0 + heat.max())
    assert heat.min() >= -1e-9 * (1.0 + heat.max())


@given(places, st.floats(0.0, 40.0), st.floats(0.0, 5.0), st.floats(1.0, 1e4))
def test_no_heat_is_lost(way, film, sink, length):
    keys = {"bearings": "fixed-supported", "far_bearing_torque_Nm": 0.2, "motor_heat_W": 5.0}
    screw = screw_with(film_W_m2K=film, bearing_conductance_W_K=sink, **keys).made
    start = np.linspace(5.0, -3.0, 100)
    times = np.linspace(0.0, length, len(way))
    step = warmed(screw, start, Beside(-2.0, np.array([1.0, 7.0])), times, np.array(way))
    assert abs(step.balance) < 1e-9
    kept = screw.conduction.capacity * (step.temperature - start).sum()
    assert step.stored * length == pytest.approx(kept, rel=1e-6, abs=1e-6 * step.entered * length)


def test_under_steady_heat_the_length_of_the_steps_does_not_matter():
    screw = screw_with(motor_heat_W=20.0).made
    still = np.array([0.3, 0.3])
    beside = Beside(4.0, np.zeros(2))
    whole = warmed(screw, np.zeros(100), beside, np.array([0.0, 600.0]), still).temperature
    parts = np.zeros(100)
    for k in range(60):
        parts = warmed(screw, parts, beside, 10.0 * np.array([k, k + 1.0]), still).temperature
    assert np.allclose(parts, whole, rtol=1e-10, atol=0)


def test_a_stretched_screw_loses_tension_and_then_grows_as_one_that_is_free():
    held = screw_of(BallScrewSection.model_validate(FIXED), STEEL).made
    free = screw_with().made
    ends = np.array([0.2, 0.7])
    pulls = [tension(held, np.full(100, rise)) for rise in (0.0, 1.0, 2.0, 8.0)]
    assert pulls[0] == pytest.approx(206e9 * np.pi * 0.02**2 * 30e-6 / 0.7)
    assert np.allclose(np.diff(pulls[:3]), -206e9 * np.pi * 0.02**2 * 11.5e-6)
    assert pulls[3] == 0.0
    assert np.allclose(moved(held, np.full(100, 2.0), ends), 0.0, atol=1e-18)
    slack = [moved(one, np.full(100, 8.0), ends) for one in (held, free)]
    assert np.allclose(slack[1] - slack[0], [30e-6 * 2.0 / 7.0, 30e-6])


@pytest.fixture(scope="module")
def course(tmp_path_factory):
    return tmp_path_factory.mktemp("course")


@pytest.fixture(scope="module")
def case_with(course):
    return partial(knee, course)


def knee(course, **axis):
    """The knee along its course with changes of its axis."""
    data = moving(course, COURSE).model_dump(mode="json", exclude_unset=True)
    data["materials"]["steel"] = data["materials"]["cast_iron"] | {"expansion_1_K": 11.5e-6}
    data["axes"]["y"] |= axis
    return case_from_data(data, "knee", course)


@pytest.fixture(scope="module")
def setup(case_with):
    return set_up_axes(case_with(ball_screw=SCREW))


@pytest.fixture(scope="module")
def march(setup):
    """March a case on the machine that all have in common."""

    def marched(case, **keys):
        (axis,) = setup.axes
        drive = drive_of(case, setup.setup, axis.name, axis.drive.surfaces)
        driven = replace(
            setup, setup=replace(setup.setup, case=case), axes=(replace(axis, drive=drive),)
        )
        return simulate(case, setup=driven, **keys)

    return marched


@pytest.fixture(scope="module")
def alone(case_with, march):
    return march(case_with()).response


@pytest.fixture(scope="module")
def driven(case_with, march):
    return march(case_with(ball_screw=FIXED)).response


def test_a_drive_moves_what_it_carries_and_nothing_else(alone, driven):
    assert "positioning_error" not in alone
    for name in ("temperature", "pressure", "heat_flow", "slip"):
        assert np.array_equal(alone[name], driven[name]), name
    # The displacement is that of the column relative to the table, which moves along y.
    error = driven["positioning_error"][:, 0]
    assert float(np.abs(error).max()) > 1e-7
    apart = driven["displacement"] - alone["displacement"]
    assert np.allclose(apart.sel(axis="y"), -error, rtol=0.0, atol=1e-15)
    assert np.array_equal(apart.sel(axis="x"), np.zeros(error.size))
    slope = driven["line_slope"] - alone["line_slope"]
    positions = driven["asked_position"][0]
    fitted = np.polyfit(positions, driven["asked_positioning_error"][-1, 0], 1)[0]
    assert float(slope[-1, 0, 1]) == pytest.approx(-fitted, rel=1e-6, abs=0)


def test_a_screw_that_nothing_warms_positions_exactly(case_with, march, alone):
    quiet = FIXED | {"nut_torque_Nm": 0.0, "bearing_torque_Nm": 0.0}
    response = march(case_with(ball_screw=quiet)).response
    assert not response["positioning_error"].any()
    assert np.array_equal(response["displacement"], alone["displacement"])


def test_the_error_at_the_present_position_is_that_asked_for_there(driven):
    last = driven.isel(time=-1, moving_axis=0)
    (there,) = np.flatnonzero(np.isclose(last["asked_position"], last["axis_position"]))
    asked = float(last["asked_positioning_error"][there])
    assert float(last["positioning_error"]) == pytest.approx(asked, rel=1e-12, abs=0)
    displaced = last["asked_displacement"][there]
    assert np.allclose(displaced, last["displacement"], rtol=0.0, atol=2e-12)


def test_a_continued_march_is_the_uninterrupted_one(case_with, march, driven, tmp_path):
    case = case_with(ball_screw=FIXED)
    half = case.replace(march={"duration_min": 2.0})
    save_state(march(half).state, half, tmp_path / "half.npz")
    rest = march(case, start=load_state(tmp_path / "half.npz", case)).response
    for name in ("screw_temperature", "screw_tension", "positioning_error", "displacement"):
        whole = driven[name].sel(time=rest["time"])
        assert np.array_equal(rest[name], whole), name


def test_the_state_of_another_screw_is_refused(case_with, march, tmp_path):
    case = case_with(ball_screw=FIXED)
    short = case.replace(march={"duration_min": 1.0})
    save_state(march(short).state, short, tmp_path / "state.npz")
    with pytest.raises(InputError, match="state of another structure"):
        load_state(tmp_path / "state.npz", case_with(ball_screw=SCREW))


def test_a_state_without_the_screw_does_not_start_one(case_with, march):
    short = case_with().replace(march={"duration_min": 1.0})
    with pytest.raises(InputError, match="another drive"):
        march(case_with(ball_screw=SCREW), start=march(short).state)


def test_the_state_beside_another_probe_is_refused(case_with):
    case = case_with(scale=SCALE | {"follows": "guide"})
    there = {"guide": {"position_mm": [650.0, 700.0, 87.5], "body": "column"}}
    assert fingerprint(case.replace(probes=there)) != fingerprint(case)
    free = case_with(scale=SCALE)
    assert fingerprint(free.replace(probes=there)) == fingerprint(free)


def test_a_machine_may_be_heated_by_its_drive_alone(case_with):
    data = case_with(ball_screw=SCREW | {"nut_surface": "screw_foot", "nut_share": 0.5}).model_dump(
        mode="json", exclude_unset=True
    )
    del data["sources"], data["heat_input"]
    response = simulate(case_from_data(data, "knee", PATH.parent)).response
    assert list(response["source"].to_numpy()) == ["y nut"]
    assert float(response["source_power"].max()) > 1.0
    assert float(np.abs(response["displacement"]).max()) > 1e-8


def test_a_scale_follows_a_probe_of_the_machine(case_with, march):
    response = march(case_with(scale=SCALE | {"follows": "guide"})).response
    beside = response["temperature"].sel(probe="guide").to_numpy()
    assert beside.max() > 0.1
    assert np.allclose(response["scale_temperature"][:, 0], beside, rtol=1e-9, atol=1e-15)
    arm = response["axis_position"][:, 0] + 0.12
    error = response["positioning_error"][:, 0]
    assert np.allclose(error, 8e-6 * beside * arm, rtol=1e-9, atol=1e-20)
    slow = march(case_with(scale=SCALE | {"follows": "guide", "lag_s": 300.0})).response
    behind = slow["scale_temperature"][1:, 0]
    assert (behind > 0.0).all()
    assert (behind < 0.9 * beside[1:]).all()


def test_what_heat_the_screw_does_not_take_warms_the_machine(case_with, alone):
    shares = {"nut_share": 0.4, "bearing_share": 0.3, "bearing_conductance_W_K": 2.0}
    surfaces = {"nut_surface": "screw_foot", "bearing_surface": "column_base"}
    case = case_with(ball_screw=SCREW | shares | surfaces).replace(
        probes={"nut": {"position_mm": [725.0, 270.0, 240.0], "body": "screw"}}
    )
    response = simulate(case).response
    assert list(response["source"].to_numpy()) == ["bearings", "y nut", "y bearing"]
    step = case.march.step_s
    # 45 s to 60 s: 120 mm of the first way, with 3 N m at the nut.
    heat = 0.6 * 3.0 * 2.0 * np.pi * 0.12 / 0.01 / step
    assert float(response["source_power"].sel(source="y nut")[2]) == pytest.approx(heat, rel=1e-9)
    # The bearing conducts on when the axis stands.
    assert float(response["source_power"].sel(source="y bearing")[-1]) > 0.01
    assert float(response["temperature"].sel(probe="nut")[-1]) > 0.1
    assert float(np.abs(response["heat_balance"]).max()) < 1e-8
    assert np.array_equal(response["heat_input"], alone["heat_input"])


def test_a_seat_that_the_structure_moves_moves_the_bodies(case_with, alone):
    still = {"expansion_1_K": 0.0, "fixed_mm": 0.0, "seat": "guide"}
    response = simulate(case_with(scale=still)).response
    recorded = case_with().model_dump(mode="json", exclude_unset=True)
    recorded["displacement"] = {"point": "guide"}
    del recorded["axes"]["y"]["rotation_within_mm"]
    seat = simulate(case_from_data(recorded, "knee", PATH.parent)).response
    moved_y = seat["displacement"].sel(axis="y")
    size = float(np.abs(moved_y).max())
    assert size > 1e-6
    # Each has thermal modes of its own.
    assert np.allclose(response["positioning_error"][:, 0], moved_y, rtol=0.0, atol=1e-4 * size)
    asked = response["asked_positioning_error"][:, 0]
    there = seat["asked_displacement"][:, 0].sel(axis="y")
    assert np.allclose(asked, there, rtol=0.0, atol=1e-4 * size)
    assert np.allclose(response["rotation"], alone["rotation"], rtol=0.0, atol=1e-9)
    zeroed = simulate(case_with(scale=still, zero_mm=50.0)).response
    errors = zeroed["asked_positioning_error"][:, 0]
    assert np.allclose(errors, asked - asked[:, 2], rtol=0.0, atol=1e-4 * size)
    # Zero but for rounding.
    assert float(np.abs(errors[:, 2]).max()) < 1e-9 * size


def test_seats_that_move_apart_stretch_the_screw():
    held = screw_of(BallScrewSection.model_validate(FIXED), STEEL)
    cool, seats = np.zeros(100), np.array([[2e-6, 9e-6, 0.0]] * 3)
    pulled = [screw_tension(held, cool, one) for one in (np.zeros(3), seats[0])]
    assert pulled[1] - pulled[0] == pytest.approx(206e9 * np.pi * 0.02**2 * 7e-6 / 0.7)
    drive = Drive(held, None, None, 0, None, NO_SURFACES, NO_SEATS)
    # At the near bearing, in the middle, at the far one.
    errors = positioning_error(drive, cool, np.array([-0.31, 0.04, 0.39]), seats)
    assert np.allclose(errors, [2e-6, 5.5e-6, 9e-6])


def test_bearings_that_would_make_a_surface_swing_are_refused(case_with):
    hot = {"bearing_conductance_W_K": 1e4, "bearing_surface": "bearings", "diameter_mm": 100.0}
    case = case_with(ball_screw=SCREW | hot | {"cells": 1000})
    with pytest.raises(InputError, match="past the temperature of the screw; take a shorter"):
        set_up_axes(case)


def test_a_seat_on_a_body_that_moves_is_refused(case_with):
    with pytest.raises(InputError, match="the seat 'table' is on a body that moves"):
        set_up_axes(case_with(scale=SCALE | {"seat": "table"}))


def test_only_the_surfaces_of_a_screw_belong_to_the_condensed_machine(case_with):
    plain, warm = case_with(ball_screw=SCREW), case_with(ball_screw=FIXED, zero_mm=0.0)
    heating = case_with(ball_screw=SCREW | {"nut_surface": "screw_foot"})
    assert condensation_key(plain) == condensation_key(warm) == condensation_key(case_with())
    assert thermal_key(heating) != thermal_key(plain)


def test_a_surface_that_is_not_there_is_refused(case_with):
    case = case_with(ball_screw=SCREW | {"nut_surface": "nut"})
    with pytest.raises(InputError, match="axes: heat of y nut: no surface named 'nut'") as error:
        set_up_axes(case)
    assert "\n" not in str(error.value)


def test_a_control_with_a_scale_does_not_see_the_screw(case_with, march, driven):
    both = march(case_with(ball_screw=FIXED, scale=SCALE)).response
    assert np.array_equal(both["screw_temperature"], driven["screw_temperature"])
    assert not both["positioning_error"].any(), "the ambient is constant"


def test_where_the_control_is_set_to_zero_there_is_no_error(case_with, march, driven):
    zeroed = march(case_with(ball_screw=FIXED, zero_mm=200.0)).response
    errors = zeroed["asked_positioning_error"][:, 0]
    assert not errors[:, -1].any()
    plain = driven["asked_positioning_error"][:, 0]
    assert np.allclose(errors, plain - plain[:, -1], rtol=0.0, atol=1e-18)


def test_the_summary_says_the_error_and_when_the_screw_is_slack(case_with, march, driven):
    (line,) = drive_lines(driven)
    assert "positioning error" in line
    assert "kN" in line
    loose = march(case_with(ball_screw=FIXED | {"stretch_um": 0.5})).response
    assert "slack" in drive_lines(loose)[1]
    assert len(axis_lines(loose)) == len(axis_lines(driven))


def test_the_examples_of_the_page_drive_the_shipped_knee():
    page = (ROOT / "docs" / "moving-axes.md").read_text("utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    drives = [block for block in blocks if "[axes.y.ball_screw]" in block or "y.scale]" in block]
    assert len(drives) == 2
    for block in drives:
        case = parse_case(PATH.read_text("utf-8") + block, "knee", PATH.parent)
        assert (case.axes["y"].ball_screw is None) != (case.axes["y"].scale is None)


def refused(tmp_path, **axis):
    data = coarse_data()
    data["materials"]["steel"] = data["materials"]["cast_iron"]
    data["axes"]["y"] |= axis
    with pytest.raises(InputError) as error:
        case_from_data(data, "knee", tmp_path)
    (line,) = str(error.value).splitlines()
    return line


@pytest.mark.parametrize(
    ("axis", "said"),
    [
        ({"ball_screw": SCREW | {"bearings": "fixed-fixed"}}, "either 'stretch_um' or"),
        ({"ball_screw": FIXED | {"pretension_kN": 2.0}}, "either 'stretch_um' or"),
        ({"ball_screw": SCREW | {"stretch_um": 20.0}}, "nothing pulls a fixed-free screw"),
        ({"ball_screw": SCREW | {"far_bearing_torque_Nm": 0.1}}, "no far bearing"),
        ({"ball_screw": SCREW | {"far_bearing_surface": "rear"}}, "no far bearing"),
        ({"ball_screw": SCREW | {"far_end_mm": -300.0}}, "no length"),
        ({"ball_screw": SCREW | {"far_end_mm": 220.0}}, "the nut covers 170 to 250 mm"),
        ({"ball_screw": SCREW | {"material": "brass"}}, "no material 'brass'"),
        ({"ball_screw": SCREW | {"nut_share": 1.2}}, "nut_share"),
        ({"scale": SCALE | {"follows": "bed"}}, "no probe 'bed'"),
        ({"scale": SCALE | {"seat": "bed"}}, "no probe 'bed' to sit at"),
        ({"ball_screw": SCREW | {"far_seat": "guide"}}, "nothing pulls a fixed-free screw"),
        ({"scale": SCALE, "zero_mm": 300.0}, "outside stroke_mm"),
        ({"zero_mm": 0.0}, "no error to set to zero"),
    ],
)
def test_a_wrong_drive_is_refused_in_one_line(tmp_path, axis, said):
    assert said in refused(tmp_path, **axis)


@pytest.mark.parametrize(
    ("key", "value", "meant"),
    [
        ("lead_mm", 0.01, "0.01 m would be 10 mm"),
        ("nut_torque_Nm", 1500.0, "1500 N mm would be 1.5 N m"),
        ("stretch_um", 30e-6, "3e-05 m would be 30 µm"),
    ],
)
def test_a_wrong_unit_is_warned_of(case_with, key, value, meant):
    (line,) = of_case(case_with(ball_screw=FIXED | {key: value}), "knee.toml")
    assert line.startswith(f"knee.toml: axes.y.ball_screw.{key}")
    assert meant in line
