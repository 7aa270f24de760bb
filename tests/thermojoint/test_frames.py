"""Data frames are read by the rules of files, and what is shown of an object is short."""

import math

import numpy as np
import pandas as pd
import pytest
from machine_logs import as_csv, machine_log
from repository import ROOT

import thermojoint as tj


@pytest.fixture(scope="module")
def log():
    return machine_log(hours=10.0)


@pytest.fixture(scope="module")
def frame(log):
    cells = {column.name: column.from_si(log.at(column.name)).round(4) for column in log.columns}
    return pd.DataFrame({"time_s": log.times} | cells)


@pytest.fixture(scope="module")
def learned(frame, tmp_path_factory):
    path = tmp_path_factory.mktemp("learned") / "model.json"
    tj.write_learned(tj.learn(frame, ["x_um"], max_sensors=2), path)
    return tj.open_estimator(path)


def test_a_frame_is_the_log_that_its_file_would_be(log, frame, tmp_path):
    of_file = tj.read_log([as_csv(log, tmp_path / "log.csv")])
    of_frame = tj.log_from_frame(frame)
    assert of_frame.columns == of_file.columns
    np.testing.assert_array_equal(of_frame.values, of_file.values)


def test_an_index_of_times_is_the_clock(frame):
    clock = pd.Timestamp("2026-03-02") + pd.to_timedelta(frame["time_s"], "s")
    indexed = frame.drop(columns="time_s").set_index(clock)
    assert np.ptp(tj.log_from_frame(indexed).times) == pytest.approx(10 * 3600.0 - 60.0, abs=0)


def test_a_model_learned_from_a_frame_is_that_of_the_file(frame, learned, log, tmp_path):
    path = as_csv(log, tmp_path / "log.csv")
    assert tj.learn(path, "x_um", max_sensors=2).channels == learned.model.channels


def test_an_estimate_of_a_frame_is_a_frame_and_judged_by_one(frame, learned):
    found = tj.estimate(learned, frame)
    assert list(found.columns) == ["time_s", "x_um", "x_band_um", "status", "quality"]
    assert len(found) == len(frame)
    (row,) = tj.validate(learned, frame).to_dict("records")
    error = (found["x_um"] - frame["x_um"]).abs().max()
    assert row["max_abs_error_um"] == pytest.approx(error, rel=1e-6, abs=0)
    assert row["max_abs_error_um"] < 0.2 * row["peak_total_um"]


def test_readings_are_given_by_name_in_the_unit_that_the_name_states(frame, learned):
    """Also in another unit of the same quantity; what is not there is missing."""
    names = tj.reads(learned)
    rows = frame[["time_s", *names]].head(30).to_dict("records")
    other = [
        {
            name.replace("_rpm", "_rad_s").replace("_degC", "_degF"): value * math.pi / 30.0
            if name.endswith("_rpm")
            else 1.8 * value + 32.0
            if name.endswith("_degC")
            else value
            for name, value in row.items()
        }
        for row in rows
    ]
    expected = tj.estimate(learned, frame.head(30))["x_um"].to_numpy()
    for given in (rows, other):
        run = tj.follow(learned, tj.samples(learned, given), learned.initial_state())
        found = [1e6 * one.displacement[0] for _, one in run]
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)
    with pytest.raises(tj.InputError, match="no reading named 'T9_degC'"):
        list(tj.samples(learned, [{"time_s": 0.0, "T9_degC": 20.0}]))
    (lacking,) = tj.samples(learned, [{"time_s": 0.0}])
    assert np.isnan(lacking[1 : 1 + len(names)]).all()


def test_a_response_judges_an_opened_estimator(coarse_response, hand_made_model, tmp_path):
    tj.write_model(hand_made_model, tmp_path / "model.json", tj.Provenance("round numbers"))
    estimator = tj.open_estimator(tmp_path / "model.json")
    alone = tj.validate(estimator, coarse_response)
    named = tj.validate(estimator, {"step": coarse_response})
    assert alone["case"].tolist() == ["response", "response"]
    assert named["case"].tolist() == ["step", "step"]
    assert alone["max_abs_error_um"].tolist() == named["max_abs_error_um"].tolist()


# --- a case --------------------------------------------------------------------------------------


def test_a_case_with_changes_is_checked_as_a_file_is(coarse_case):
    (joint,) = list(coarse_case.joints)[:1]
    changed = coarse_case.replace(joints={joint: {"friction_coefficient": 0.25}})
    assert changed.joints[joint].friction_coefficient == 0.25
    assert changed.joints[joint].preload_MPa == coarse_case.joints[joint].preload_MPa
    assert coarse_case.replace() == coarse_case
    with pytest.raises(tj.InputError, match="did you mean 'friction_coefficient'"):
        coarse_case.replace(joints={joint: {"friction_coeficient": 0.2}})
    with pytest.raises(tj.InputError, match="friction_coefficient"):
        coarse_case.replace(joints={joint: {"friction_coefficient": -5.0}})


def test_a_section_of_another_kind_takes_the_place_of_the_present_one(coarse_case):
    ramp = coarse_case.replace(heat_input={"kind": "ramp", "level": 2.0, "duration_min": 5.0})
    assert ramp.heat_input == tj.RampInput(kind="ramp", level=2.0, duration_min=5.0)
    step = tj.StepInput(kind="step", level=0.5)
    assert ramp.replace(heat_input=step).heat_input == step


def test_a_case_is_simulated_by_the_name_of_its_file():
    found = tj.simulate(str(ROOT / "examples" / "batch" / "machine.toml"))
    assert float(found.response["gap_residual"].max()) < 1e-12
    assert len(repr(found)) < 300
    assert "<svg" in found._repr_html_()


# --- what is shown -------------------------------------------------------------------------------


def test_what_a_notebook_shows_of_an_object_is_short(
    coarse_case, coarse_setup, hand_made_model, log, learned
):
    simulated = (coarse_case, coarse_setup, coarse_setup.structure)
    assembly = tj.assemble(hand_made_model, 2.0, 7200.0)
    for one in (*simulated, hand_made_model, assembly, log, learned, learned.model):
        assert "\n" not in repr(one)
        assert len(repr(one)) < 400
        assert repr(one).startswith(type(one).__name__ + "(")
        assert one._repr_html_().count("<tr>") >= 2
