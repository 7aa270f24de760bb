"""The chain on a coarse machine: placement, calibration, validation, and the files of a run."""

import json
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from in_process import run
from reference_case import lasting
from short_runs import SHORT

from calibrate import chain
from estimator.fchs import judging as judge
from estimator.joint_aware.model_file import read_observer
from fesim.case.schema import MeshSection, read_case
from fesim.case.thermal_sections import HeldTemperatureSection
from meshes.structure import Probe
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.artefacts.response import read_response
from thermojoint.models.baselines import read_baselines
from thermojoint.models.model_file import read_model
from thermojoint.paper import inputs, paper_values, reproduce
from thermojoint.paper.drawing import estimate_figures
from thermojoint.paper.long_runs import adaptively, random_day
from thermojoint.paper.observers import observer_case, observers_beside

AXES = ("x", "y")
OBSERVERS = {"kalman-linear", "joint-aware"}


@pytest.fixture(scope="module")
def case_file(tmp_path_factory):
    """The reference machine with elements of 100 mm, 35 minutes in steps of 20 s."""
    text = files("thermojoint").joinpath("cases/reference.toml").read_text("utf-8")
    for pattern, new in (
        (r"joint_element_size_mm.*", ""),
        (r"element_size_mm = 40.0", "element_size_mm = 100.0"),
        (r"step_s = 2.0", "step_s = 20.0"),
        (r"spacing_mm = 25.0", "spacing_mm = 75.0"),
    ):
        text, changed = re.subn(pattern, new, text)
        assert changed == 1
    path = tmp_path_factory.mktemp("reproduce") / "coarse.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def case(case_file):
    return read_case(case_file)


@pytest.fixture(scope="module")
def results(case_file, few_starts):
    """The folder that `reproduce` leaves."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reproduce, "reproduce", partial(reproduce.reproduce, long=SHORT))
        assert run("reproduce", "--case", case_file, "--out", case_file.parent / "results") == 0
    return case_file.parent / "results"


@pytest.fixture(scope="module")
def responses(results):
    return {path.stem: read_response(path) for path in (results / "responses").glob("*.nc")}


@pytest.fixture(scope="module")
def model(results):
    return read_model(results / "model.json")


def test_long_runs_of_a_case_that_iterates_take_adaptive_steps(case):
    march = adaptively(case.replace(march={"coupling": "iterated"})).march
    assert march.method == "adaptive"


def test_a_run_leaves_every_file(results):
    simulated = (*inputs.CALIBRATION, *inputs.VALIDATION, inputs.DAY, inputs.COOL_DOWN)
    names = {f"responses/{name}.nc" for name in simulated}
    names |= {"model.json", "baselines.json", "tables.json", "validation.json", "report.html"}
    names |= {"model_steady.json", "tables_steady.json", "responses/step-2.0-steady.nc"}
    names |= {
        f"{kind}.{end}" for kind in ("joint_aware", "kalman_linear") for end in ("h5", "json")
    }
    found = {str(path.relative_to(results)) for path in results.rglob("*") if path.is_file()}
    assert names <= found
    assert not [name for name in found if "/." in name or name.startswith(".")]
    pictures = {name.split("/")[1] for name in found if name.startswith("figures/")}
    for number in range(6, 12):
        assert any(name.startswith(f"figure-{number:02d}") for name in pictures)
    assert {"temperature.png", "deformation.png", "pressure.png"} <= pictures
    assert {f"estimate-{case}.png" for case in inputs.CASES} <= pictures


def test_the_tables_are_those_of_the_model(command, results):
    code, out, _ = command("tables", results / "model.json", "--json", "-")
    assert code == 0
    assert json.loads(out) == json.loads((results / "tables.json").read_text())


def test_eqs_8_and_18_follow_the_calibration_responses(results):
    tables = json.loads((results / "tables.json").read_text())
    for axis in AXES:
        assert tables["table1"]["deformation"][axis]["max_abs_error_um"] < 0.1
        for level in ("0.5", "2.0"):
            assert tables["table3"]["max_abs_error_um"][level][axis] < 0.1


def test_validation_json_judges_every_estimator_in_every_case(results):
    rows = json.loads((results / "validation.json").read_text())["rows"]
    found = {(row["case"], row["estimator"], row["axis"]) for row in rows}
    assert found == {(c, e, a) for c in inputs.CASES for e in judge.ESTIMATORS for a in AXES}
    for row in rows:
        assert 0.0 < row["rms_error_um"] <= row["max_abs_error_um"]
        assert ("band_cover" in row) == ("mean_band_um" in row) == (row["estimator"] in OBSERVERS)
        if row["case"] not in (inputs.DAY, inputs.COOL_DOWN, inputs.WARM_START):
            assert row["max_abs_error_um"] <= row["peak_total_um"]
            assert row["peak_nonlinear_um"] > 0.0
        else:
            assert row["peak_nonlinear_um"] is None


def test_the_joint_aware_estimator_is_nearest_although_its_mesh_is_another(results):
    rows = json.loads((results / "validation.json").read_text())["rows"]
    error = {(r["case"], r["axis"], r["estimator"]): r["max_abs_error_um"] for r in rows}
    for case in ("step-1.5", "step-3.0", "triangle", "day", "cool-down"):
        for axis in AXES:
            ours = error[case, axis, "joint-aware"]
            others = [error[case, axis, name] for name in judge.ESTIMATORS if name != "joint-aware"]
            # What it is calibrated from is marched in steps of 20 s, the long runs adaptively.
            left_by_steps = 0.7 if case in ("day", "cool-down") else 0.0
            assert ours < max(min(others), left_by_steps)


def test_fictitious_sources_leave_less_than_the_linear_model_alone(results):
    rows = json.loads((results / "validation.json").read_text())["rows"]
    error = {(r["case"], r["axis"], r["estimator"]): r["max_abs_error_um"] for r in rows}
    for axis in AXES:
        assert error["step-1.5", axis, "fchs"] < error["step-1.5", axis, "linear"]


def test_the_observers_know_the_machine_on_a_coarser_mesh(case, results):
    sensors = read_observer(results / "joint_aware.h5").sensors
    assert sensors == ("a", "b", "T1", "T2")
    known = observer_case(case, {"a": Probe((0.55, 0.6125, 0.1), "column")})
    assert known.structure.element_size_mm == 125.0
    assert known.structure.joint_element_size_mm is None
    assert known.structure.dimensions_mm == case.structure.dimensions_mm
    assert known.probes["a"].position_mm == (550.0, 612.5, 100.0)
    assert known.joints == case.joints


def test_a_mesh_from_a_file_has_to_serve_its_observers(case):
    mesh = MeshSection(kind="mesh", file=Path("machine.msh"))
    measured = case.model_copy(update={"structure": mesh})
    assert observer_case(measured, {}).structure == mesh


def test_a_machine_with_held_temperatures_has_no_observers(case, tmp_path):
    held = {"bearings": HeldTemperatureSection(rise_K=0.0)}
    unlike = case.model_copy(update={"held_temperatures": held})
    with ThreadPoolExecutor() as crew:
        had, left_out = observers_beside(crew, unlike, {}, {}, tmp_path)()
    assert had == []
    assert set(left_out) == OBSERVERS
    assert not list(tmp_path.iterdir())


def test_a_day_is_drawn_from_its_seed(results, responses):
    heat, ambient = (random_day(480.0, 10)[name] for name in ("heat_input", "ambient_degC"))
    again, other = random_day(480.0, 10), random_day(480.0, 11)
    assert np.array_equal(heat, again["heat_input"])
    assert not np.array_equal(ambient[1], other["ambient_degC"][1])
    lasts = np.diff(heat[0])[::2]
    assert ((lasts > 299.0) & (lasts < 2401.0)).all()
    assert heat[0][-1] >= 480.0 * 60.0
    assert 0.0 <= heat[1].min() < heat[1].max() <= 2.0
    assert np.abs(ambient[1] - ambient[1][0]).max() == pytest.approx(3.0)
    # The day in the results is the drawn one, and says where its histories are.
    told = json.loads(responses["day"].attrs["case"])
    files = [told["heat_input"]["file"], told["ambient"]["file"]]
    assert all(Path(one).parent == results / "responses" and Path(one).is_file() for one in files)
    assert list(responses["day"]["probe"].to_numpy()) == ["a", "b", "T1", "T2"]


def test_the_report_is_one_page_that_loads_nothing(results):
    page = (results / "report.html").read_text()
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:)", page)
    assert "<script" not in page
    for words in ("Table 1", "Table 2", "Table 3", "triangle-noise", "gap residual", "after"):
        assert words in page
    assert "uncertain by" in page
    shown = len(list((results / "figures").iterdir()))
    assert page.count("data:image/png;base64,") == shown == 18


def test_regressions_are_judged_where_they_are_given(results, model, responses):
    given = {"triangle": responses["triangle"]}
    beside = read_baselines(results / "baselines.json")
    found = {
        with_them is not None: judge.validate_model(
            model, responses["step-1.0"], given, beside=judge.Beside(with_them)
        )
        for with_them in (None, beside)
    }
    names = {given: {row["estimator"] for row in one.rows} for given, one in found.items()}
    assert names[True] == set(judge.ESTIMATORS) - OBSERVERS - {"linear-steady", "fchs-steady"}
    assert names[False] == {"none", "linear", "fchs"}
    alone = judge.validate_model(None, responses["step-1.0"], given, beside=judge.Beside(beside))
    assert {row["estimator"] for row in alone.rows} == {"none", "mlr", "ridge", "arx"}
    assert list(estimate_figures(alone)) == ["estimate-triangle"]
    short = replace(beside, arx={"y": beside.arx["y"]})
    with pytest.raises(InputError, match="no axis named 'x'"):
        judge.validate_model(model, None, given, beside=judge.Beside(short))


@pytest.mark.long
def test_the_written_responses_calibrate_to_the_same_model_without_candidates(
    command, results, model, tmp_path
):
    """They name the sensors that were chosen."""
    of = {level: results / "responses" / f"step-{level}.nc" for level in ("0.5", "1.0", "2.0")}
    others = ["--input", f"0.5={of['0.5']}", "--input", f"2={of['2.0']}"]
    out = tmp_path / "model.json"
    code, told, _ = command("calibrate", "--reference", of["1.0"], *others, "--out", out)
    assert code == 0
    assert "Table 2" in told
    assert read_model(out) == model


def test_responses_without_sensors_or_candidates_are_refused(responses):
    bare = {n: r.isel(probe=slice(0, 2)).assign_attrs(case="") for n, r in responses.items()}
    with pytest.raises(InputError, match="name the sensors a, b, T1 and T2"):
        chain.calibrate_responses(bare["step-1.0"], {0.5: bare["step-0.5"], 2.0: bare["step-2.0"]})


def test_validation_noise_is_seeded(command, results, tmp_path):
    found = []
    for name, seed in (("one", 1), ("same", 1), ("other", 2)):
        out = tmp_path / f"{name}.json"
        arguments = ["validate", results / "model.json", results / "responses" / "triangle.nc"]
        reference = ["--reference", results / "responses" / "step-1.0.nc"]
        noise = ["--noise-pp", "0.12", "--seed", seed]
        code, text, _ = command(*arguments, *reference, *noise, "--json", out)
        assert code == 0
        assert "triangle" in text
        found.append(json.loads(out.read_text())["rows"])
    assert found[0] == found[1] != found[2]
    # The noise is on every temperature: it is not the paper's case.
    assert not {row["case"] for row in found[0]} & set(paper_values.VALIDATION_ERROR_UM)


def test_steps_that_cannot_be_marched_for_hours_leave_the_rest_as_it_is(
    case, tmp_path, monkeypatch
):
    def refused(*given):
        raise ConvergenceError("no equilibrium after 3 h")

    monkeypatch.setattr(reproduce, "simulate_steady", refused)
    monkeypatch.setattr(reproduce, "simulate_long", lambda *given: {"day": "long"})
    monkeypatch.setattr(reproduce, "field_scenes", lambda *given: {"temperature": "hot"})
    lasting, steps, scenes = reproduce._beside_calibration(case, SHORT, tmp_path)
    assert (lasting, scenes) == ({"day": "long"}, {"temperature": "hot"})
    assert str(steps) == "no equilibrium after 3 h"


@pytest.mark.long
def test_a_machine_that_no_fictitious_source_describes_has_the_rest_of_its_results(
    case_file, tmp_path, monkeypatch
):
    def refused(*given):
        raise ConvergenceError("no fit")

    monkeypatch.setattr(reproduce, "_calibrate", refused)
    monkeypatch.setattr(reproduce, "reproduce", partial(reproduce.reproduce, long=SHORT))
    assert run("reproduce", "--case", case_file, "--out", tmp_path / "out") == 0
    left_out = json.loads((tmp_path / "out" / "validation.json").read_text())["left_out"]
    assert left_out["fchs"] == "no fit"
    assert (tmp_path / "out" / "figures" / "estimate-day.png").is_file()
    assert "no fit" in (tmp_path / "out" / "report.html").read_text("utf-8")


def test_results_stay_as_they_were_until_all_of_the_new_ones_are_there(
    command, results, tmp_path, monkeypatch
):
    """Something fails once the new responses are written."""
    out = tmp_path / "results"
    shutil.copytree(results, out)
    (out / "figures" / "notes.txt").write_text("mine")
    before = {one: one.read_bytes() for one in out.rglob("*") if one.is_file()}
    (tmp_path / "short.toml").write_text(lasting(1.5))

    def failing(*given):
        [beside] = tmp_path.glob(".results.*")
        assert len(list(beside.rglob("*.nc"))) == 11
        raise InputError("these responses determine nothing")

    def refused(*given):
        raise InputError("no model")

    monkeypatch.setattr(reproduce, "reproduce", partial(reproduce.reproduce, long=SHORT))
    monkeypatch.setattr(reproduce, "_calibrate", refused)
    monkeypatch.setattr(reproduce, "observers_beside", lambda *given: lambda: ([], {}))
    monkeypatch.setattr(reproduce, "draw_views", failing)
    code, _, err = command("reproduce", "--case", tmp_path / "short.toml", "--out", out)
    # Where the set-up is slow, its progress stands before.
    assert (code, err.splitlines()[-1]) == (2, "thermojoint: these responses determine nothing")
    assert {one: one.read_bytes() for one in out.rglob("*") if one.is_file()} == before
    assert sorted(one.name for one in tmp_path.iterdir()) == ["results", "short.toml"]
