"""Sensors of a machine with moving axes are placed for its whole working volume."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import three_axes
from moving_knee import coarse_data
from nested_toml import as_toml
from typer.testing import CliRunner

from calibrate.joint_aware.calibration import machine_of
from calibrate.joint_aware.misfit import physics_with
from calibrate.placement import plant_family
from calibrate.placement.joint_aware import place_sensors
from fesim.case.schema import case_from_data
from thermojoint import console
from thermojoint.cli.app import app
from thermojoint.reduced.physics import displaced, displaced_at, march_known, simulate_known

STEP = plant_family.USUAL.step
SMALL = plant_family.Drawing(plants=2, duration=2 * 3600.0)
BOXES = [
    {"body": "column", "low_mm": [550.0, 400.0, 50.0], "high_mm": [650.0, 1000.0, 50.0]},
    {"body": "table", "low_mm": [675.0, 400.0, 75.0], "high_mm": [825.0, 700.0, 75.0]},
]


@pytest.fixture(scope="module")
def data():
    found = coarse_data()
    del found["axes"]["y"]["file"]
    found["axes"]["y"]["position_mm"] = 0.0
    found["candidates"] = [box | {"spacing_mm": 100.0} for box in BOXES]
    return found


@pytest.fixture(scope="module")
def whole(data):
    case = case_from_data(data, "knee", Path())
    places = [[550.0, 500.0, 50.0], [550.0, 1000.0, 50.0], [650.0, 700.0, 50.0]]
    column = {f"c{k}": {"position_mm": at, "body": "column"} for k, at in enumerate(places)}
    table = {"t": {"position_mm": [825.0, 350.0, 75.0], "body": "table"}}
    return machine_of(case.replace(probes=column | table), (*column, *table, "guide", "bearing"))


@pytest.fixture(scope="module")
def machine(whole):
    return plant_family.fewer_modes(whole)


@pytest.fixture(scope="module")
def family(machine):
    return plant_family.make_family(machine, SMALL)


def inputs_of(machine, places):
    """Heat and an ambient of 1 K, on a way from place to place."""
    inputs = machine.inputs(np.tile(machine.power, (len(places), 1)), places)
    inputs[:, machine.power.size] = 1.0
    return inputs


def test_few_modes_have_what_the_guide_s_friction_excites(whole, machine):
    assert len(machine.capacity) < 0.6 * len(whole.capacity)
    rng = np.random.default_rng(1)
    places, gone = rng.uniform(-0.1, 0.2, (60, 1)), np.full((60, 1), 0.6)
    (every, at_every), (few, at_few) = (
        simulate_known(physics_with(one, {}), inputs_of(one, places), STEP, gone)
        for one in (whole, machine)
    )
    _, without = simulate_known(physics_with(whole, {}), inputs_of(whole, places), STEP)
    assert few == pytest.approx(every, abs=0.01 * np.abs(every).max())
    assert at_few == pytest.approx(at_every, abs=0.01 * np.abs(at_every).max())
    assert np.abs(without - at_every).max() > 0.02 * np.abs(at_every).max()


def places_of_axes(machine, count):
    rng = np.random.default_rng(2)
    strokes = [one[[0, -1]] for one in machine.guide.way.stations.positions]
    return np.column_stack([rng.uniform(*stroke, count) for stroke in strokes])


@pytest.mark.parametrize("axes", [1, 3])
def test_where_axes_stand_the_displacement_elsewhere_is_that_of_the_march(machine, axes, tmp_path):
    if axes == 3:
        courses = {name: [(0, 0), (600, 0)] for name in "xyz"}
        machine = machine_of(three_axes.coarse(tmp_path, courses), ("tool", "work"))
    physics, places = physics_with(machine, {}), places_of_axes(machine, 5)
    marched = march_known(physics, inputs_of(machine, places), STEP)
    found = displaced_at(physics, marched, places)
    here = displaced(physics, marched)
    np.testing.assert_allclose(found[range(5), range(5)], here, rtol=0.0, atol=1e-12)
    assert np.abs(found - here[:, None]).max() > 1e-7


def test_a_set_for_the_whole_stroke_is_better_over_it_than_one_for_its_end(machine, family):
    axes, seen = len(machine.axes), plant_family.filter_modes(machine)
    end = replace(family, displacement=family.displacement[:, -axes:], places=family.places[-1:])
    there, anywhere = (place_sensors(seen, 2, family=one).chosen for one in (end, family))
    elsewhere = place_sensors(seen, 2, there.names, family).chosen
    assert anywhere.names != there.names
    assert np.linalg.norm(anywhere.band) < 0.995 * np.linalg.norm(elsewhere.band)
    # A band for the stroke is that of its worst place.
    assert (elsewhere.band >= there.band * (1.0 - 1e-9)).all()


def test_a_source_without_a_sensor_nearby_is_named_with_the_candidate_that_is(machine):
    seen = plant_family.filter_modes(machine)
    (source,) = seen.source_names
    assert plant_family.unseen_sources(seen, ["t"], STEP) == {source: "bearing"}
    assert plant_family.unseen_sources(seen, ["t", "bearing"], STEP) == {}


def test_the_command_places_sensors_on_a_machine_that_moves(data, tmp_path, monkeypatch):
    monkeypatch.setattr(
        plant_family, "make_family", partial(plant_family.make_family, drawing=SMALL)
    )
    case, out = tmp_path / "knee.toml", tmp_path / "sensors.toml"
    case.write_text(as_toml(data))
    words = ["place", case, "--count", "2", "--keep", "guide", "--warm", "--out", out]
    # Every part may take minutes, and says that it is at work.
    told = partial(console.progress_lines, first_s=0.001, every_s=0.01)
    monkeypatch.setattr(console, "progress_lines", told)
    result = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0
    assert out.read_text().count("[probes.") == 1
    assert "drawing machines: " in result.stderr
