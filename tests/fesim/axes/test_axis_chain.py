"""A column that carries a ram, and a table: three axes in one march."""

import pickle
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from in_process import run

from fesim.axes import condensation
from fesim.axes.setup import set_up_axes
from fesim.case.identity import thermal_key
from fesim.case.schema import case_from_data, read_case
from fesim.march.state_file import fingerprint, load_state, save_state
from fesim.simulate import simulate
from meshes.exchange import read_structure
from meshes.three_axes import three_axis_machine
from thermojoint.artefacts.errors import InputError
from thermojoint.plausibility import of_case
from thermojoint.verification.axis_chain import chain_data, on_axes

PATH = Path(str(files("thermojoint").joinpath("cases/three_axes.toml")))
#: (s, mm) of each axis: it moves alone, with another one, with both.
COURSES = {
    "x": [(0, -200), (60, -200), (130, 250), (400, 250)],
    "y": [(0, 50), (100, 50), (180, -270), (400, -270)],
    "z": [(0, -100), (150, 110), (400, 110)],
}
SCREW = {
    "bearings": "fixed-free",
    "fixed_bearing_mm": -450.0,
    "far_end_mm": 450.0,
    "nut_length_mm": 80.0,
    "diameter_mm": 30.0,
    "lead_mm": 10.0,
    "material": "iron",
    "film_W_m2K": 10.0,
    "nut_torque_Nm": 2.0,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chain")
    for name, rows in COURSES.items():
        text = "".join(f"{time},{place}\n" for time, place in rows)
        (folder / f"{name}.csv").write_text("time_s,position_mm\n" + text)
    return folder


def chain(folder, at=None, changes=None, **sections):
    """The machine along its courses, or standing at positions, mm; with changes of single axes."""
    courses = {name: {"file": f"{name}.csv"} for name in COURSES}
    if at is not None:
        courses = {name: {"position_mm": place} for name, place in zip("xyz", at, strict=True)}
    data = on_axes(chain_data(folder, (0.0, 0.0, 0.0)), courses)
    data["march"] = {"step_s": 30.0, "duration_min": 5.0}
    data["axes"]["x"]["rotation_within_mm"] = 120.0
    for name, keys in (changes or {}).items():
        data["axes"][name] |= keys
    return case_from_data(data | sections, "chain", folder)


@pytest.fixture(scope="module")
def driven(folder):
    """One screw on the bed, another one on the column, a scale on the bed."""
    case = chain(
        folder,
        changes={
            "x": {"ball_screw": SCREW, "zero_mm": 0.0},
            "y": {"ball_screw": SCREW | {"cells": 40, "seat": "guide"}},
            "z": {"scale": {"expansion_1_K": 8e-6, "fixed_mm": 0.0, "follows": "guide"}},
        },
        volume={"points_mm": [{"x": 100.0, "y": -270.0, "z": 110.0}, {"x": 0, "y": 0, "z": 0}]},
    )
    ready = set_up_axes(case)
    return case, ready, simulate(case, setup=ready).response


def test_where_the_axes_stand_displacement_is_that_asked_for_there(folder):
    at = (130.0, -270.0, 110.0)
    asked = {name: {"asked_mm": [0.0, place]} for name, place in zip("xyz", at, strict=True)}
    points = {"grid_mm": {name: [place] for name, place in zip("xyz", at, strict=True)}}
    response = simulate(chain(folder, at, asked, volume=points)).response
    size = float(np.abs(response["displacement"]).max())
    assert size > 1e-6
    for axis in range(3):
        there = response["asked_displacement"][:, axis, 1]
        assert np.allclose(there, response["displacement"], rtol=0.0, atol=1e-6 * size)
    here = response.isel(time=-1)
    there = response["volume_displacement"][0, 0]
    assert np.allclose(there, here["displacement"], rtol=0.0, atol=1e-6 * size)
    turned = response["volume_rotation"][0, 0]
    assert np.allclose(turned, here["rotation"], rtol=0.0, atol=1e-10)
    assert float(np.abs(turned).max()) > 1e-7


def test_one_thermal_state_is_seen_from_every_place_alike(folder):
    """Where x and z stand, the line along y is that over points of the volume."""
    at = (100.0, 0.0, -50.0)
    points = [{"x": 100.0, "y": y, "z": -50.0} for y in (-300.0, 300.0)]
    response = simulate(chain(folder, at, volume={"points_mm": points})).response
    asked = response["asked_displacement"][-1, 1]
    assert np.allclose(response["volume_displacement"][0], asked, rtol=0.0, atol=1e-15)
    slope = (asked[1] - asked[0]) / 0.6
    assert np.allclose(response["line_slope"][-1, 1], slope, rtol=1e-9, atol=1e-15)


def test_what_rides_on_a_tilted_body_has_its_lever(folder):
    """A warm column leans: along it the point on the ram moves by the ram's rotation times way."""
    points = [{"x": 0.0, "y": y, "z": 0.0} for y in (-100.0, 0.0, 100.0)]
    case = chain(folder, (0.0, 0.0, 0.0), volume={"points_mm": points})
    data = case.model_dump(mode="json", exclude_unset=True)
    # The column alone is heated; the ram stays cold behind joints that conduct nothing.
    data["sources"] = {
        "sun": {"surface": "column_back", "reference_power_W": 400.0, "reading": "total"}
    }
    for joint in data["joints"].values():
        joint["conductance"] = {"law": "none"}
    response = simulate(case_from_data(data, "chain", folder)).response
    low, _, high = response["volume_displacement"][0].to_numpy()
    turned = response["volume_rotation"][0, :, 0].to_numpy()
    # u = w x r: along y a rotation w about x adds w y to u along z. Simpson's rule, as w varies.
    leans = 0.2 * (turned[0] + 4.0 * turned[1] + turned[2]) / 6.0
    assert abs(leans) > 1e-6
    assert high[2] - low[2] == pytest.approx(leans, rel=0.02)


def test_the_ram_needs_no_station_of_the_columns_axis(driven):
    _, ready, _ = driven
    stations = ready.moving.guideway.stations
    held = {
        name: set(place[:, riding].ravel().tolist())
        for name, place, riding in zip("xyz", stations.place, stations.riding, strict=True)
    }
    assert not held["x"] & held["y"]
    # Eight places along, two across; the column's stroke is that of the ram.
    assert [len(places) for places in held.values()] == [16, 16, 10]


def test_combinations_are_tied_only_where_the_axes_are_asked_about(folder, monkeypatch):
    tied, tie = [], condensation.condense_aligned
    monkeypatch.setattr(condensation, "condense_aligned", lambda *a: tied.append(a) or tie(*a))
    ready = set_up_axes(chain(folder, (0.0, 0.0, 0.0)))
    simulate(chain(folder, (0.0, 0.0, 0.0)), setup=ready)
    assert [len(one) for one in ready.moving.guideway.stations.positions] == [7, 7, 4]
    # The first one, where they stand, and two positions of each axis.
    assert len(tied) == 8


def test_energy_holds_while_all_move(driven):
    _, _, response = driven
    assert float(np.abs(response["heat_balance"]).max()) < 1e-8
    assert float(np.abs(response["axis_position"].diff("time")).max()) > 0.1


def test_every_drive_errs_along_its_own_axis(folder, driven):
    case, ready, response = driven
    plain = replace(ready, axes=tuple(replace(axis, drive=None) for axis in ready.axes))
    alone = simulate(case, setup=plain).response
    error = response["positioning_error"]
    # The ram has the errors of x and y; the table, to which it is relative, that of z.
    carried = error * [1.0, 1.0, -1.0]
    apart = response["displacement"] - alone["displacement"]
    assert np.allclose(apart, carried, rtol=0.0, atol=1e-15)
    assert float(np.abs(error[-1]).min()) > 1e-10
    last, steps = response.isel(time=-1), response["asked_displacement"][-1]
    without = alone["asked_displacement"][-1]
    # Along x the error of y is that where x is asked about: the column moves the seat of y.
    own = last["asked_positioning_error"][0]
    assert np.allclose((steps - without)[0, :, 0], own, rtol=0.0, atol=1e-15)
    assert not np.allclose((steps - without)[0, 0, 1], (steps - without)[1, 0, 1])


def test_axes_with_and_without_a_screw_share_a_response(driven):
    _, _, response = driven
    warm = response["screw_temperature"][-1]
    assert warm.shape == (3, 100)
    assert float(warm[0].max()) > 0.1
    assert np.array_equal(warm[1, 39:], np.full(61, float(warm[1, 39])))
    assert not warm[2].any()
    assert not response["scale_temperature"][:, :2].any()


def test_a_continued_march_is_the_uninterrupted_one(driven, tmp_path):
    case, ready, response = driven
    half = case.replace(march={"duration_min": 2.0})
    save_state(simulate(half, setup=ready).state, half, tmp_path / "half.npz")
    rest = simulate(case, setup=ready, start=load_state(tmp_path / "half.npz", case)).response
    for name in ("displacement", "temperature", "positioning_error", "asked_displacement"):
        assert np.array_equal(rest[name], response[name].sel(time=rest["time"])), name
    assert np.array_equal(rest["volume_displacement"], response["volume_displacement"])


def test_the_state_of_another_order_of_axes_is_refused(driven):
    case, _, _ = driven
    turned = case.model_copy(update={"axes": dict(reversed(case.axes.items()))})
    assert fingerprint(turned) != fingerprint(case)


def test_what_is_asked_about_is_no_part_of_the_machine(folder, driven):
    case, _, _ = driven
    other = case.replace(volume={"at_s": [60.0, 120.0]})
    assert thermal_key(other) == thermal_key(case)
    survey = simulate(other).response
    assert survey["survey"].to_numpy().tolist() == [60.0, 120.0]


def refused(folder, *args, **sections):
    with pytest.raises(InputError) as error:
        set_up_axes(chain(folder, *args, **sections))
    (line,) = str(error.value).splitlines()
    return line


def test_what_does_not_fit_together_is_refused_in_one_line(folder):
    at = (0.0, 0.0, 0.0)
    alone = {"x": {"bodies": ["column"]}}
    assert "add what is carried to axes.x.bodies" in refused(folder, at, alone)
    twice = {"y": {"rotation_within_mm": 80.0}}
    assert "give it once" in refused(folder, at, twice)
    point = {"x": 0.0, "y": 0.0}
    assert "every axis (x, y, z)" in refused(folder, at, volume={"points_mm": [point]})
    assert "no point" in refused(folder, at, volume={})
    far = {"grid_mm": point | {"z": 300.0}}
    far["grid_mm"] = {name: [place] for name, place in far["grid_mm"].items()}
    assert "z = 300 mm is outside axes.z.stroke_mm" in refused(folder, at, volume=far)
    late = {"points_mm": [point | {"z": 0.0}], "at_s": [1e4]}
    assert "after the end" in refused(folder, at, volume=late)


def test_a_carried_axis_without_a_seat_is_warned_of(folder):
    (line,) = of_case(chain(folder), "chain.toml")
    assert line.startswith("chain.toml: axes.y: another axis carries it")
    scale = {"y": {"scale": {"expansion_1_K": 8e-6, "fixed_mm": 0.0, "seat": "guide"}}}
    assert of_case(chain(folder, changes=scale), "chain.toml") == []
    assert of_case(read_case(PATH), "three_axes.toml") == []


def test_a_model_in_other_units_of_stiffness_ties_alike_in_another_process(driven):
    """A factor on the modulus is one on every spring and compliance."""
    elastic, corner = driven[1].moving.guideway.elastic, (1, 4, 2)
    ties = elastic.ties
    stiff = replace(
        ties,
        springs=2.0 * ties.springs,
        compliance=0.5 * ties.compliance,
        reference=2.0 * ties.reference,
    )
    anew = pickle.loads(pickle.dumps(replace(elastic, ties=stiff)))[corner]
    for name, value in vars(elastic.strained(2.0, 1.0)[corner]).items():
        size = np.abs(value).max()
        assert np.allclose(getattr(anew, name), value, rtol=0.0, atol=1e-9 * size), name


def test_the_shipped_mesh_is_that_of_its_machine():
    shipped, made = read_structure(PATH.with_suffix(".vtu"), 1.0), three_axis_machine(0.05)
    assert np.allclose(shipped.mesh.p, made.mesh.p, rtol=0.0, atol=1e-12)
    assert set(shipped.surfaces) == set(made.surfaces)
    assert {name: cells.size for name, cells in shipped.bodies.items()} == {
        name: cells.size for name, cells in made.bodies.items()
    }


def test_the_shipped_case_moves_all_axes(tmp_path, capsys):
    text = PATH.read_text("utf-8").replace("duration_min = 40.0", "duration_min = 2.0")
    for name in ("three_axes.vtu", *(f"three_axes_{axis}.csv" for axis in "xyz")):
        text = text.replace(f'"{name}"', f'"{PATH.with_name(name)}"')
    (tmp_path / "three.toml").write_text(text)
    case = read_case(tmp_path / "three.toml")
    assert list(case.axes) == ["x", "y", "z"]
    assert run("simulate", tmp_path / "three.toml", "--out", tmp_path / "three.nc") == 0
    said = capsys.readouterr().err
    for axis in "xyz":
        assert f"axis '{axis}' at the end: displacement along z" in said
