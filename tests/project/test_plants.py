"""Drawn plants: what is drawn, what their sensors tell, and what is said of them."""

import copy
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from benchmarks.plants.ablation import WITHOUT, without
from benchmarks.plants.drawing import FAMILIES, OFFSET, PARTS, Unlike, draw_plant
from benchmarks.plants.driving import DAY, LEVELS, drives
from benchmarks.plants.estimating import Errors
from benchmarks.plants.judging import CALIBRATIONS, calibrations, figures
from benchmarks.plants.preparing import with_parameters
from benchmarks.plants.responding import answers, measured
from benchmarks.plants.structural import structural_answers
from benchmarks.plants.summary import summary_of
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.models.sensors import ROLES
from thermojoint.reduced.machine import along, reduce_machine


@pytest.fixture(scope="module")
def data(coarse_data):
    """The coarse machine with sensors of the four roles."""
    found = copy.deepcopy(coarse_data)
    found["march"] |= {"thermal": "reduced", "duration_min": 10.0}
    found["heat_input"] = {"kind": "step", "level": 2.0}
    found["probes"] = {
        name: {"position_mm": list(found["probes"][name]["position_mm"]), "body": "column"}
        for name in ROLES
    }
    return found


@pytest.fixture(scope="module")
def case(data):
    return case_from_data(data, "case", Path())


def test_a_plant_is_drawn_within_its_ranges_and_is_the_same_again(case):
    plants = [draw_plant(case, ROLES, 1, number) for number in range(50)]
    (section,) = case.joints.values()
    friction = [one.factors["friction"] * section.friction_coefficient for one in plants]
    assert min(friction) >= 0.2
    assert max(friction) <= 0.8
    assert np.ptp(friction) > 0.4
    assert all(np.abs(one.offset).max() <= OFFSET for one in plants)
    again = draw_plant(case, ROLES, 1, 7)
    assert again.factors == plants[7].factors
    assert draw_plant(case, ROLES, 2, 7).factors != again.factors


def test_the_first_plants_with_uneven_films_are_those_of_the_page(case):
    even, uneven, other = (FAMILIES["films"](case, ROLES, 2, number).factors for number in range(3))
    assert even == pytest.approx({"film": 1.0, "film rear": 1.0, "film interior, W/m2K": 0.0})
    assert 6.0 * uneven["film"] == pytest.approx(5.0)
    assert 6.0 * uneven["film"] * uneven["film rear"] == pytest.approx(19.0)
    assert 0.3 < other["film"] < 2.5
    assert 0.0 <= other["film interior, W/m2K"] <= 5.0


def test_a_day_has_levels_within_their_range_and_an_ambient_of_three_kelvin():
    day = drives(2.0, 5)["day"]
    assert day.heat.size == DAY / 2.0
    assert day.heat.min() >= LEVELS[0]
    assert day.heat.max() <= LEVELS[1]
    assert 10 < np.count_nonzero(np.diff(day.heat)) < 100
    assert np.abs(day.ambient).max() == pytest.approx(3.0, rel=0.1)


@pytest.mark.long
def test_a_plant_on_the_modes_of_the_case_answers_as_one_set_up_anew(data, case):
    setup = set_up(case)
    axes = ["x", "y"]
    machine = along(reduce_machine(case, setup, ROLES), axes)
    plant = draw_plant(case, ROLES, 1, 3)
    other = case_from_data(with_parameters(data, plant.factors), "plant", Path())
    anew = simulate(other, setup=set_up(other)).response.sel(axis=axes)
    drive = {"step": drives(machine.step, 0)["step-2.0"]}
    (answer,) = answers(machine, plant, drive).values()
    count = anew.sizes["time"]
    assert answer.displacement[:count] == pytest.approx(anew["displacement"].to_numpy(), abs=5e-8)

    response = measured(answer, machine, anew, plant.offset, (0.12, 5e-8), 0)
    wrong = response["temperature"].to_numpy() - answer.temperature
    assert wrong.mean(axis=0) == pytest.approx(plant.offset, abs=0.01)
    assert np.ptp(wrong, axis=0) == pytest.approx(np.full(4, 0.12), rel=1e-6)
    shaken = response["displacement"].to_numpy() - answer.displacement
    assert shaken.std() == pytest.approx(5e-8, rel=0.1)


@pytest.mark.long
def test_a_plant_like_the_case_in_structure_answers_as_one_with_parameters_only(data, case):
    machine = along(reduce_machine(case, set_up(case), ROLES), ["x", "y"])
    plant = FAMILIES["structural"](case, ROLES, 1, 3)
    assert plant.unlike is not None
    alike = Unlike(
        dimensions={"wall": 50.0},
        laws=("surface", "cmy-1969"),
        uneven=0.0,
        feet=(1e7, 1e7),
        films=dict.fromkeys(PARTS, 6.0) | {"interior": 0.0},
        door=1.0,
        friction=dict.fromkeys(plant.unlike.friction, 0.0),
        conduction=0.0,
        expansion=0.0,
        gradient=0.0,
        lag=np.full(4, 1e-3),
        place=np.zeros((4, 2)),
    )
    drive = {"step": drives(machine.step, 0)["step-2.0"]}
    (plain,) = answers(machine, plant, drive).values()
    same = replace(plant, unlike=alike)
    (found,) = structural_answers(data, ROLES, same, drive).values()
    assert found.temperature == pytest.approx(plain.temperature, abs=0.02)
    assert found.displacement == pytest.approx(plain.displacement, abs=1e-7)
    (other,) = structural_answers(data, ROLES, plant, drive).values()
    assert np.abs(other.displacement - plain.displacement).max() > 1e-6


def test_without_a_difference_a_plant_keeps_all_others(case):
    plant = FAMILIES["structural"](case, ROLES, 1, 3)
    gone = {
        "nothing": set(),
        "friction heat": {"friction"},
        "open door": {"door"},
        "warmer air": {"gradient"},
        "unknown heat, all three": {"friction", "door", "gradient"},
        "films of top and table": {"films"},
        "unknown heat, films of top and table": {"friction", "door", "gradient", "films"},
        "temperature-dependent material": {"conduction", "expansion"},
        "elastic feet": {"feet"},
        "lags and places of sensors": {"lag", "place"},
        "places of sensors": {"place"},
    }
    assert set(gone) == set(WITHOUT)
    for difference, changed in gone.items():
        other = without(plant, difference)
        assert (other.factors, other.seed) == (plant.factors, plant.seed)
        pairs = {
            field.name: [getattr(one.unlike, field.name) for one in (plant, other)]
            for field in fields(Unlike)
        }
        assert changed == {name for name, pair in pairs.items() if not np.array_equal(*pair)}


def test_the_summary_takes_the_larger_axis_and_counts_who_is_worse_than_linear(data):
    rows = [
        {
            **{"plant": plant, "sensors": 4, "calibration": "steps", "case": "day"},
            "estimator": estimator,
            **{"axis": axis, "max_abs_error_um": error, "rms_error_um": error},
            **{"band_cover": cover, "mean_band_width_um": cover, "interval_score_um": cover},
        }
        for plant, estimator, errors, cover in (
            (0, "joint-aware", (1.0, 3.0), 0.9),
            (0, "linear", (2.0, 2.0), None),
            (1, "joint-aware", (1.0, 0.5), 1.0),
            (1, "linear", (2.0, 2.0), None),
        )
        for axis, error in zip("xy", errors, strict=True)
    ]
    own, linear = summary_of(rows)
    assert own["median_um"] == pytest.approx(2.0)
    assert own["worse_than_linear"] == 1
    assert own["band_cover"] == pytest.approx(0.95)
    assert linear["worse_than_linear"] == 0
    assert linear["band_cover"] is None


def test_recorded_days_are_others_than_the_day_that_is_judged():
    runs = drives(60.0, 5, days=2)
    heats = [runs[name].heat for name in ("day", "day-1", "day-2")]
    assert np.array_equal(heats[0], drives(60.0, 5)["day"].heat)
    assert not any(np.array_equal(heats[k], heats[k - 1]) for k in range(3))
    assert calibrations(0) == CALIBRATIONS
    assert list(calibrations(2).values())[-1][-2:] == ("day-1", "day-2")


def test_a_warm_start_is_judged_from_when_it_has_settled():
    run = xr.Dataset(
        {"displacement": (("time", "axis"), np.ones((5, 1)))},
        {"time": np.arange(5.0), "axis": ["x"]},
    )
    error = np.array([[9.0], [1e-6], [2e-6], [1e-6], [1e-6]])
    band = np.full((5, 1), 1.5e-6)
    (row,) = figures("warm-start", "joint-aware", Errors(("x",), error, band), run, 1.0)
    assert row["max_abs_error_um"] == pytest.approx(2.0)
    assert row["band_cover"] == pytest.approx(0.75)
    assert row["mean_band_width_um"] == pytest.approx(3.0)
    # One sample of four is half a micrometre outside.
    assert row["interval_score_um"] == pytest.approx(3.0 + 40.0 * 0.5 / 4.0)
