"""A knee that moves along its guide: against the machine meshed there, energy, resumption."""

import numpy as np
import pytest
from in_process import run
from moving_knee import PATH, coarse, coarse_data, meshed_at, moving, standing_at

from fesim.axes import setup as axes_setup
from fesim.axes.axis import Axis, gone
from fesim.axes.setup import course_of, set_up_axes
from fesim.case.history import History
from fesim.case.schema import case_from_data
from fesim.march.state_file import load_state, save_state
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError

#: (s, mm): stands, moves within steps and across them, there and back.
COURSE = [(0, 0), (45, 0), (70, 200), (80, 200), (130, -100), (150, 30), (400, 30)]


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    return moving(tmp_path_factory.mktemp("course"), COURSE)


@pytest.fixture(scope="module")
def setup(case):
    return set_up_axes(case)


@pytest.fixture(scope="module")
def response(case, setup):
    return simulate(case, setup=setup).response


@pytest.mark.parametrize("position", [pytest.param(-100.0, marks=pytest.mark.long), 100.0])
def test_where_positions_are_aligned_it_is_the_machine_meshed_there(position):
    on_axis = simulate(standing_at(position)).response
    meshed = simulate(meshed_at(position), accuracy=False).response
    # The two thermal bases differ, each by less than its tolerance.
    for name in ("displacement", "temperature", "pressure", "heat_flow"):
        size = float(np.abs(meshed[name]).max())
        assert np.allclose(on_axis[name], meshed[name], rtol=0.0, atol=5e-6 * size), name


@pytest.mark.long
def test_between_aligned_positions_shorter_stations_err_less():
    exact = set_up_axes(standing_at(50.0, 50.0)).moving.standing((0.05,)).contact.elastic
    errors = []
    for station in (300.0, 100.0):
        elastic = set_up_axes(standing_at(50.0, station)).moving.standing((0.05,)).contact.elastic
        apart = np.abs(elastic.compliance - exact.compliance).max()
        errors.append(float(apart / np.abs(exact.compliance).max()))
    assert errors[1] < 5e-3
    assert errors[1] < 0.25 * errors[0]


def test_energy_and_equilibrium_hold_while_it_moves(response):
    assert float(np.abs(response["heat_balance"]).max()) < 1e-8
    assert float(response["running_heat"].max()) > 1.0
    # Nothing but the joint presses on the table along x.
    change = response["pressure"] - response["pressure"][0]
    forces = change * response["contact_area"]
    assert float(np.abs(forces.sum("contact")).max()) < 1e-5 * float(np.abs(forces).max())


def test_the_basis_of_modes_holds_over_the_stroke(case, response, monkeypatch):
    """A hundredth of its tolerances finds more modes, which change next to nothing anywhere."""
    monkeypatch.setenv("THERMOJOINT_CACHE", "off")
    for name in ("TEMPERATURE_ERROR", "GAP_ERROR", "DISPLACEMENT_ERROR"):
        monkeypatch.setattr(axes_setup, name, getattr(axes_setup, name) / 100.0)
    finer = simulate(case, accuracy=False).response
    assert finer.attrs["thermal_modes"] > response.attrs["thermal_modes"]
    for name, most in (
        ("displacement", 1e-11),
        ("asked_displacement", 1e-11),
        ("temperature", 1e-4),
    ):
        np.testing.assert_allclose(finer[name], response[name], rtol=0.0, atol=most)


def test_friction_heat_is_that_of_force_and_way(case, setup, response):
    step, at = case.march.step_s, 2  # from 30 s to 60 s: 120 mm of the first way
    way = 0.2 * 15.0 / 25.0
    force = float(response["pressure"][at - 1] @ response["contact_area"])
    heat = 2.0 * case.joints["knee"].running_friction_coefficient * force * way / step
    assert float(response["running_heat"][at, 0]) == pytest.approx(heat, rel=1e-9, abs=0)


def test_displacement_at_the_present_position_is_that_asked_for_there():
    standing = coarse(file=None, position_mm=200.0, asked_mm=[-100.0, 200.0])
    response = simulate(standing).response
    there = response["asked_displacement"][:, 0, 1]
    assert np.allclose(there, response["displacement"], rtol=0.0, atol=2e-12)
    turned = response["asked_rotation"][:, 0, 1]
    assert np.allclose(turned, response["rotation"], rtol=0.0, atol=2e-11)


def test_the_line_meets_two_positions_exactly(response):
    two = simulate(coarse(file=None, position_mm=0.0, asked_mm=[-100.0, 200.0])).response.isel(
        time=-1, moving_axis=0
    )
    ends = two["asked_displacement"].to_numpy()
    assert np.allclose(two["line_left"], 0.0, atol=1e-15)
    assert np.allclose(two["line_slope"], (ends[1] - ends[0]) / 0.3, rtol=1e-9, atol=1e-12)
    assert np.allclose(two["line_offset"], ends.mean(axis=0), rtol=1e-9, atol=1e-15)
    assert float(response["line_left"][-1].max()) > 0.0


def test_a_continued_march_is_the_uninterrupted_one(case, setup, response, tmp_path):
    half = case.replace(march={"duration_min": 2.0})
    first = simulate(half, setup=setup)
    save_state(first.state, half, tmp_path / "half.npz")
    rest = simulate(case, setup=setup, start=load_state(tmp_path / "half.npz", case)).response
    for name in ("displacement", "temperature", "pressure", "slip", "asked_displacement"):
        whole = response[name].sel(time=rest["time"])
        assert np.array_equal(rest[name], whole), name


def test_the_way_at_a_time_has_the_same_bits_whatever_the_other_times_are():
    rng = np.random.default_rng(4)
    course = History(np.sort(rng.uniform(-10.0, 300.0, 80)), rng.uniform(-0.1, 0.2, 80))
    axis = Axis("y", course, np.zeros(1), 0.0, None, np.zeros(3))
    times = 10.0 * np.arange(40.0)
    whole = gone(axis, times)
    assert all(np.array_equal(gone(axis, times[k:]), whole[k:]) for k in range(40))
    finely = np.abs(np.diff(course(np.union1d(times, np.clip(course.times, 0.0, None)))))
    assert whole[-1] == pytest.approx(finely.sum(), rel=1e-12)


def test_without_heat_nothing_moves_wherever_it_stands(tmp_path):
    data = coarse_data()
    data["heat_input"] = {"kind": "step", "level": 0.0}
    data["joints"]["knee"]["running_friction_coefficient"] = 0.0
    path = tmp_path / "course.csv"
    path.write_text("time_s,position_mm\n0,0\n60,170\n300,-90\n")
    data["axes"]["y"]["file"] = str(path)
    response = simulate(case_from_data(data, "knee", tmp_path)).response
    assert float(np.abs(response["displacement"]).max()) < 1e-15
    assert float(np.abs(response["rotation"]).max()) < 1e-15
    assert np.allclose(response["pressure"], response["pressure"][0], rtol=1e-12)


def refused(changes, tmp_path, axis=None):
    data = coarse_data()
    data["axes"]["y"] |= axis or {}
    for section, keys in changes.items():
        data[section] = data.get(section, {}) | keys
    with pytest.raises(InputError) as error:
        set_up_axes(case_from_data(data, "knee", tmp_path))
    (line,) = str(error.value).splitlines()
    return line


def test_what_an_axis_does_not_support_is_refused_in_one_line(tmp_path):
    load = {"surface": "exterior", "force_N": [1.0, 0.0, 0.0]}
    assert "loads.push" in refused({"loads": {"push": load}}, tmp_path)
    assert "adaptive" in refused({"march": {"method": "adaptive"}}, tmp_path)
    assert "thermal" in refused({"march": {"thermal": "full"}}, tmp_path)
    assert "output" in refused({"output": {"forces": True}}, tmp_path)
    assert "no joint rides" in refused({"joints": _knee(axis=None)}, tmp_path)
    assert "no section" in refused({"joints": _knee(axis="q")}, tmp_path)
    assert "exchange side_a" in refused(
        {"joints": _knee(side_a="knee.a", side_b="knee.b")}, tmp_path
    )
    assert "contains the guide" in refused({"convection_W_m2K": {"knee.a": 6.0}}, tmp_path)
    assert "held surface" in refused({"held_temperatures": {"knee.a": {"rise_K": 1.0}}}, tmp_path)


def _knee(**changes):
    joint = coarse_data()["joints"]["knee"] | changes
    if joint["axis"] is None:
        del joint["axis"], joint["running_friction_coefficient"]
    return {"knee": joint}


def test_a_stroke_off_the_guide_is_refused(tmp_path):
    long = {"stroke_mm": [-100.0, 400.0]}
    assert "leave the guide" in refused({}, tmp_path, long)
    assert "not parallel" in refused({}, tmp_path, {"direction": [1.0, 0.0, 0.0]})
    assert "share nodes" in refused({}, tmp_path, {"bodies": ["table"]})
    assert "on a line" in refused({}, tmp_path, {"rotation_within_mm": 1.0})


def test_a_history_outside_the_stroke_is_refused(tmp_path):
    """But for a micrometre or two, as records have it."""
    section = moving(tmp_path, [(0, 0), (60, 200.001)]).axes["y"]
    assert course_of(section, "y")(60.0) == 0.2
    case = moving(tmp_path, [(0, 0), (60, 201)])
    with pytest.raises(InputError, match=r"201 mm at 60 s is outside stroke_mm"):
        set_up_axes(case)


@pytest.mark.parametrize(
    ("axis", "said"),
    [
        ({"position_mm": 300.0, "file": None}, "outside stroke_mm"),
        ({"position_mm": 0.0}, "either 'position_mm' or 'file'"),
        ({"stroke_mm": [200.0, -100.0]}, "no stroke"),
        ({"direction": [0.0, 0.0, 0.0]}, "direction is zero"),
        ({"asked_mm": [0.0]}, "two positions"),
        ({"asked_mm": [0.0, 300.0]}, "outside stroke_mm"),
    ],
)
def test_a_wrong_axis_is_refused(axis, said):
    with pytest.raises(InputError, match=said):
        coarse(**axis)


def test_the_command_prints_the_line(tmp_path, capsys):
    text = PATH.read_text("utf-8")
    for usual, changed in (
        ('file = "moving_knee.csv"', "position_mm = 150.0"),
        ("element_size_mm = 50.0", "element_size_mm = 100.0"),
        ("along = 8", "along = 4"),
        ("across = 3", "across = 1"),
        ("duration_min = 60.0", "duration_min = 1.0"),
    ):
        assert usual in text
        text = text.replace(usual, changed)
    (tmp_path / "knee.toml").write_text(text)
    assert run("simulate", tmp_path / "knee.toml", "--out", tmp_path / "knee.nc") == 0
    assert "K0" in capsys.readouterr().err


def test_what_cannot_move_says_so(case):
    with pytest.raises(InputError, match="`simulate`, `view` and joint-aware models move bodies"):
        set_up(case)
