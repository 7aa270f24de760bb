"""Sensitivity studies: exact where the answer is known, and the machine's own physics."""

import json
import re
import shutil
from importlib.resources import files

import moving_knee
import numpy as np
import pandas as pd
import pytest
from batch_cases import case_text
from hypothesis import given
from hypothesis import strategies as st
from in_process import run

from fesim.batch.study import RangeSection, study_of
from fesim.batch.summary import columns
from fesim.case.schema import case_from_data, parse_case, read_case
from thermojoint.artefacts.errors import InputError
from thermojoint.sensitivity.local import effects_of, rows_of
from thermojoint.sensitivity.measures import INDICES
from thermojoint.sensitivity.parameters import Parameter, parameters_of
from thermojoint.sensitivity.results import chosen_figures, physical
from thermojoint.sensitivity.screening import design_of, indices_of

EFFECTS = ("heat_input.level", "joints.knee.friction_coefficient", "materials.cast_iron.exp*")
RANGES = """case = "machine.toml"
ranges = [
  { path = "heat_input.level", low = 0.5, high = 3.0 },
  { path = "joints.knee.roughness_um", low = 0.6, high = 2.5, scale = "log" },
]
"""


@given(
    st.lists(st.floats(-10.0, 10.0), min_size=5, max_size=5),
    st.floats(0.1, 10.0),
)
def test_effects_of_a_polynomial_of_fourth_degree_are_its_derivatives(coefficients, value):
    curve = np.polynomial.Polynomial(coefficients)
    parameter = Parameter("x", value, 0.01 * value)
    figures = np.array([[curve(row["x"])] for row in rows_of([parameter])])
    (effect,) = effects_of([parameter], figures)
    size = np.abs(np.array(coefficients) * value ** np.arange(5)).sum()
    assert effect.change[0] == pytest.approx(
        curve.deriv()(value) * 0.01 * value, abs=1e-12 * max(size, 1e-6)
    )


def test_more_of_a_negative_value_is_further_from_zero(coarse_data):
    """The effect of 1 % of a figure in proportion to a weight is 1 % of it, wherever up is."""
    loads = {"loads": {"weight": {"acceleration_m_s2": [0.0, -9.81, 0.0]}}}
    case = case_from_data(coarse_data | loads, "case", None)
    (gravity,) = parameters_of(case, ("loads.*",))
    figures = np.array([[-2.0 * row[gravity.path]] for row in rows_of([gravity])])
    (effect,) = effects_of([gravity], figures)
    assert effect.change[0] == pytest.approx(0.01 * 2.0 * 9.81)


def test_a_parameter_without_all_its_cases_has_no_effect():
    parameters = [Parameter("x", 1.0, 0.01), Parameter("y", 1.0, 0.01)]
    figures = np.arange(8.0)[:, None]
    figures[6] = np.nan
    assert [effect.parameter.path for effect in effects_of(parameters, figures)] == ["x"]


def test_parameters_are_the_numbers_of_the_machine_and_not_of_its_mesh_or_march(coarse_data):
    case = case_from_data(coarse_data, "case", None)
    paths = {parameter.path: parameter for parameter in parameters_of(case)}
    assert paths["joints.knee.preload_MPa"].unit_change == pytest.approx(0.0441)
    assert paths["probes.T1.position_mm.0"].change == "1 mm"
    assert paths["structure.dimensions_mm.wall"].value == pytest.approx(50.0)
    assert not any(path.startswith(("march", "candidates")) for path in paths)
    assert "structure.element_size_mm" not in paths
    assert "joints.knee.along" not in paths
    named = parameters_of(case, ("joints.*.friction*",))
    assert [parameter.path for parameter in named] == ["joints.knee.friction_coefficient"]


@pytest.mark.parametrize(
    "name", [pytest.param("reference", marks=pytest.mark.long), "iso230_3_etve"]
)
def test_every_number_of_a_shipped_machine_is_varied_as_far_as_its_parts_fit(name, tmp_path):
    cases = files("thermojoint").joinpath("cases")
    source = tmp_path / f"{name}.toml"
    text = cases.joinpath(source.name).read_text("utf-8")
    # Every element twice as large: the parts of each case are paired.
    coarse = re.sub(r"(?<=size_mm = )\S+", lambda size: str(2.0 * float(size[0])), text)
    source.write_text(coarse, "utf-8")
    for history in re.findall(r'file = "(.+)"', text):
        shutil.copy(str(cases.joinpath(history)), tmp_path)
    parameters, reasons = parameters_of(read_case(source)), []
    rows, paths = rows_of(parameters), [each.path for each in parameters]
    found = study_of(source, rows, paths, name, lambda values, reason: reasons.append(reason))
    assert len(found.cases) > 0.9 * len(rows) > 100
    assert all("does not fit" in reason for reason in reasons)


def test_parameters_of_an_axis_are_not_where_it_is_read_and_meshed():
    paths = [parameter.path for parameter in parameters_of(moving_knee.coarse(), ("axes.*",))]
    assert paths == ["axes.y.stroke_mm.0", "axes.y.stroke_mm.1"]
    screw = moving_knee.coarse(ball_screw=moving_knee.SCREW | {"material": "cast_iron"})
    found = {one.path.rpartition(".")[2]: one for one in parameters_of(screw, ("axes.y.ball*",))}
    assert found["nut_torque_Nm"].unit_change == pytest.approx(0.01 * found["nut_torque_Nm"].value)
    # A percentage of a position would depend on where the axis has its zero.
    assert (found["fixed_bearing_mm"].change, found["diameter_mm"].change) == ("1 mm", "1 %")
    assert found["fixed_bearing_mm"].unit_change == 1.0


def test_lines_along_axes_are_judged_where_they_are_asked_for():
    slope = "displacement_x_slope_y_final_um_per_m"
    summary = pd.DataFrame({"displacement_x_final_um": [1.0, 2.0], slope: [3.0, 4.0]})
    assert chosen_figures(summary, []) == ["displacement_x_final_um"]
    assert chosen_figures(summary, [slope]) == [slope]
    assert slope in physical(columns(["y"]))
    assert "steps" not in physical(columns(["y"]))


def test_sobol_indices_of_a_known_function_are_its_own_and_converge():
    """Ishigami's function: first order 0.314, 0.442, 0; total 0.558, 0.442, 0.244."""
    ranges = [RangeSection(path=f"x{k}", low=-np.pi, high=np.pi) for k in range(3)]
    design = design_of(ranges, "sobol", 1024, seed=1)
    x = np.array([list(row.values()) for row in design.rows])
    figure = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    quarter, half, whole = indices_of(design, figure)
    assert [stage["samples"] for stage in (quarter, half, whole)] == [1280, 2560, 5120]
    np.testing.assert_allclose(whole["S1"], [0.3139, 0.4424, 0.0], atol=0.04)
    np.testing.assert_allclose(whole["ST"], [0.5576, 0.4424, 0.2437], atol=0.04)


def test_morris_screening_of_a_plane_is_its_slope_without_spread():
    ranges = [RangeSection(path=f"x{k}", low=0.0, high=3.0) for k in range(2)]
    design = design_of(ranges, "morris", 8, seed=1)
    figure = np.array([2.0 * row["x0"] - 5.0 * row["x1"] for row in design.rows])
    *_, whole = indices_of(design, figure)
    # A third of the range is 1.
    np.testing.assert_allclose(whole["mu"], [2.0, -5.0], rtol=1e-9)
    np.testing.assert_allclose(whole["mu_star"], [2.0, 5.0], rtol=1e-9)
    np.testing.assert_allclose(whole["sigma"], 0.0, atol=1e-9)


@pytest.mark.parametrize("method", ["morris", "sobol"])
def test_rounding_errors_of_a_figure_that_stays_have_no_indices(method):
    ranges = [RangeSection(path=f"x{k}", low=0.0, high=3.0) for k in range(2)]
    design = design_of(ranges, method, 8, seed=1)
    for stage in indices_of(design, 1e-16 * np.array([row["x0"] for row in design.rows])):
        assert not any(any(stage[name]) for name in INDICES[method])


def test_a_base_of_sobol_samples_is_a_power_of_two():
    with pytest.raises(InputError, match="power of two"):
        design_of([RangeSection(path="x", low=0.0, high=1.0)] * 2, "sobol", 12, seed=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The coarse machine for a minute, and ranges of it."""
    folder = tmp_path_factory.mktemp("sensitivity")
    (folder / "machine.toml").write_text(case_text(1.0))
    (folder / "ranges.toml").write_text(RANGES)
    return folder


@pytest.mark.parametrize("path", ["joints.knee.along", "march.step_s"])
def test_a_number_that_small_changes_do_not_fit_is_refused_with_the_reason(folder, capsys, path):
    out = folder / "refused"
    assert run("sensitivity", folder / "machine.toml", "--out", out, "--parameter", path) == 2
    assert "whole numbers, zeros, and those of march" in capsys.readouterr().err


def test_temperatures_rise_with_the_heat_and_displacements_with_the_expansion(folder):
    patterns = [part for path in EFFECTS for part in ("--parameter", path)]
    command = (folder / "machine.toml", "--out", folder / "local", "--workers", 1)
    assert run("sensitivity", *command, *patterns, "--json", folder / "local.json") == 0
    content = json.loads((folder / "local.json").read_text())
    assert content["cases"] == 4 * 3
    effects = {(row["figure"], row["path"]): row["change"] for row in content["entries"]}
    case = parse_case((folder / "machine.toml").read_text(), "case", folder)
    assert case.heat_input is not None
    warmth = effects["temperature_max_K", "heat_input.level"]
    # The joint is the only nonlinearity: one percent of heat is one percent of the temperature.
    table = (folder / "local" / "summary.csv").read_text().splitlines()
    column = table[0].split(",").index("temperature_max_K")
    assert warmth == pytest.approx(0.01 * float(table[1].split(",")[column]), rel=0.03)
    grown = effects["displacement_x_final_um", "materials.cast_iron.expansion_1_K"]
    heated = effects["displacement_x_final_um", "heat_input.level"]
    assert grown == pytest.approx(heated, rel=1e-2)
    assert (folder / "local" / "sensitivity.png").stat().st_size > 1000
    rows = (folder / "local" / "sensitivity.csv").read_text().splitlines()
    assert len(rows) == 1 + len(content["entries"])


def test_ranges_are_screened_and_a_second_method_shares_what_has_run(folder):
    command = (folder / "ranges.toml", "--out", folder / "both", "--workers", 1, "--samples", 4)
    assert run("sensitivity", *command, "--json", folder / "m.json") == 0
    assert run("sensitivity", *command, "--json", folder / "again.json") == 0
    first, again = ((folder / name).read_text() for name in ("m.json", "again.json"))
    assert first == again
    content = json.loads(first)
    moved = [row for row in content["entries"] if row["figure"] == "displacement_x_final_um"]
    assert [row["path"] for row in moved] == ["heat_input.level", "joints.knee.roughness_um"]
    assert content["convergence"]["displacement_x_final_um"][-1]["samples"] == 12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--parameter", "joint.*"), "no number of"),
        (("--parameter", "heat_input.level", "--parameter", "joint.*"), "joint.*: no number of"),
        (("--figure", "displacement_q_um"), "--figure"),
        (("--method", "sobol"), "--method: goes with a file of ranges"),
        (("--samples", "64"), "--samples: goes with a file of ranges"),
        (("--seed", "2"), "--seed: goes with a file of ranges"),
    ],
)
def test_what_is_unknown_or_of_the_other_kind_is_refused_before_any_case(
    folder, tmp_path, capsys, options, message
):
    command = (folder / "machine.toml", "--out", tmp_path / "none", "--workers", 1)
    assert run("sensitivity", *command, *options) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("name", ["sensitivity.csv", "sensitivity.png"])
def test_files_of_others_in_its_folder_are_kept(folder, tmp_path, capsys, name):
    (tmp_path / name).write_text("my notes\n")
    command = (folder / "machine.toml", "--out", tmp_path, "--workers", 1)
    assert run("sensitivity", *command, "--parameter", "heat_input.level") == 2
    assert f"{name}: exists and is not a" in capsys.readouterr().err
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [(name, "my notes\n")]


def test_ranges_without_any_result_are_told(folder, capsys):
    (folder / "hot.toml").write_text(
        RANGES.replace("low = 0.5, high = 3.0", "low = 1e9, high = 1e10")
    )
    command = (folder / "hot.toml", "--out", folder / "hot", "--workers", 1, "--samples", 4)
    assert run("sensitivity", *command) == 2
    assert "no case has a result" in capsys.readouterr().err


def test_json_on_standard_output_is_all_that_is_printed_there(folder, capsys):
    command = (folder / "machine.toml", "--out", folder / "local", "--workers", 1)
    chosen = [part for path in EFFECTS for part in ("--parameter", path)]
    assert run("sensitivity", *command, *chosen, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["entries"]
