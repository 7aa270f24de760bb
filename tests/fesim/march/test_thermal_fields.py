"""Warm starts, formulas and tables of position, profiles of heat and held temperatures."""

import numpy as np
import pytest
from bars import two_bars
from hypothesis import given
from hypothesis import strategies as st
from in_process import run
from nested_toml import as_toml
from repository import ROOT

from calibrate.drivable import check_drivable
from fesim.batch.summary import figures_of
from fesim.case.formula import FUNCTIONS, formula
from fesim.case.identity import condensation_key
from fesim.case.position_table import read_position_table
from fesim.case.schema import case_from_data, read_case
from fesim.march.state_file import load_state, save_state
from fesim.setup.initial_temperature import initial_temperature
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from fesim.snapshots import snapshot_writer
from meshes.exchange import write_structure
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import read_response, write_response
from thermojoint.paper.summary import result_lines
from thermojoint.verification.structures import marched
from thermojoint.verification.thermal_bar import METAL, bar_case

REFERENCE = ROOT / "thermojoint" / "cases" / "reference.toml"
POINTS = np.array([[0.0, 0.1, 0.2], [0.0, 0.05, -0.1], [0.3, 0.0, 0.1]])

# --- formulas ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2", [2.0, 2.0, 2.0]),
        ("x_mm", [0.0, 100.0, 200.0]),
        ("-y_m**2 + z_m", [0.3, -0.0025, 0.09]),
        ("where(x_mm > 50, 1, 0) - (z_m <= 0)", [0.0, 0.0, 1.0]),
        ("hypot(3, 4) * min(x_m, 0.1) / pi", [0.0, 0.5 / np.pi, 0.5 / np.pi]),
        ("max(exp(0), atan2(0, 1))", [1.0, 1.0, 1.0]),
    ],
)
def test_a_formula_is_what_it_says(text, expected):
    np.testing.assert_allclose(formula(text)(POINTS), expected, rtol=1e-14, atol=1e-16)


@pytest.mark.parametrize("text", ["1 / 0", "9**9**9**9", "pi**pi**pi**pi", "log(-1)"])
def test_what_has_no_value_is_not_finite_and_takes_no_time(text):
    assert not np.isfinite(formula(text)(POINTS)).any()


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "().__class__",
        "x_m.real",
        "x_m[0]",
        "lambda: 1",
        "[x_m for x_m in (1, 2)]",
        "(x := 1)",
        "f'{x_m}'",
        "'text'",
        "True",
        "1j",
        "x_m @ y_m",
        "x_m if 1 else 2",
        "not x_m",
        "1 < x_m < 2",
        "sqrt(x_m, out=1)",
        "sqrt(*x_m)",
        "sqrt(1, 2)",
        "open(1)",
        "sqrt",
        "x",
        "x_m; y_m",
        "x_m = 1",
        "",
        "1 +",
        "(" * 400,
        "-" * 900 + "1",
        "1" * 400,
        "1e999",
        "1 + " * 400 + "1",
        "a\0b",
    ],
)
def test_nothing_but_arithmetic_of_position_is_a_formula(text):
    with pytest.raises(ValueError, match=r"\S") as refused:
        formula(text)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


@given(st.text(alphabet="xyz_m 0123456789.+-*/()<>=,sqrtabelogwhi'[]{}:@&|~^%\\", max_size=30))
def test_any_text_is_a_formula_or_refused_in_one_line(text):
    try:
        values = formula(text)(POINTS)
    except ValueError as refused:
        assert "\n" not in str(refused)  # noqa: PT017
    else:
        assert values.shape == (3,)


def test_every_function_takes_arrays():
    for name, (_, count) in FUNCTIONS.items():
        assert formula(f"{name}({', '.join(['x_m'] * count)})")(POINTS).shape == (3,)


# --- tables --------------------------------------------------------------------------------------


def table(folder, text, column="rise_K"):
    path = folder / "table.csv"
    path.write_text(text)
    return read_position_table(path, column)


def test_a_table_is_linear_between_its_points_and_flat_beyond_them(tmp_path):
    rows = [f"{x},{z},{x + 10 * z + x * z}" for z in (0, 100) for x in (200, 0, 50)]
    found = table(tmp_path, "x_mm,z_mm,rise_K\n" + "\n".join(rows) + "\n")
    x, z = np.array([25.0, 125.0, 300.0, -5.0]), np.array([50.0, 10.0, 200.0, 0.0])
    inside = np.clip(x, 0, 200), np.clip(z, 0, 100)
    expected = inside[0] + 10 * inside[1] + inside[0] * inside[1]
    np.testing.assert_allclose(found(1e-3 * np.array([x, 0 * x, z])), expected, rtol=1e-12)


def test_a_table_of_one_row_is_constant(tmp_path):
    np.testing.assert_array_equal(table(tmp_path, "y_mm,rise_K\n5,3\n")(POINTS), [3.0, 3.0, 3.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rise_K\n1\n", "no header"),
        ("x_mm,rise_K\n", "needs rows"),
        ("x_mm,rise_K\n0,1\n0,2\n", "are not a grid"),
        ("x_mm,y_mm,rise_K\n0,0,1\n1,1,2\n", "are not a grid of 2 x 2"),
        ("x_mm,rise_K\n0,nan\n", "not finite"),
        ("x_mm,factor\n0,1\n", "'rise_K' is missing"),
    ],
)
def test_a_bad_table_is_one_line(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as refused:
        table(tmp_path, text)
    assert "\n" not in str(refused.value)


# --- warm starts ---------------------------------------------------------------------------------

SURFACE = {
    "preload_MPa": 2.0,
    "along": 2,
    "across": 2,
    "roughness_um": 1.25,
    "asperity_slope": 0.14,
    "hardness_GPa": 1.961,
    "friction_coefficient": 0.3,
}


def bars(folder, **changes):
    """Two bars with a joint, held at one end, whose right one starts warm."""
    write_structure(two_bars((4, 3, 2), (6, 2, 2)), folder / "bars.vtu")
    iron = METAL | {"poisson_ratio": 0.27, "expansion_1_K": 13.7e-6}
    return {
        "title": "bars",
        "structure": {"kind": "mesh", "file": "bars.vtu"},
        "materials": {"iron": iron},
        "bodies": {"left": "iron", "right": "iron"},
        "joints": {"joint": SURFACE},
        "supports": {"fixed": ["left_end"], "symmetry": {"right_end": "x"}},
        "convection_W_m2K": {"top": 20.0},
        "initial_temperature": {"expression_K": "where(x_mm > 100, 15, 2 + z_mm / 10)"},
        "held_temperatures": {"left_end": {"rise_K": 5.0}},
        "march": {"step_s": 5.0, "duration_min": 2.0},
        "displacement": {"point": "end"},
        "probes": {
            "left": {"position_mm": [50.0, 30.0, 20.0]},
            "right": {"position_mm": [200.0, 30.0, 20.0]},
        },
    } | changes


@pytest.fixture(scope="module")
def warm(tmp_path_factory):
    """Case and response, full and reduced."""
    folder = tmp_path_factory.mktemp("warm")
    found = {}
    for thermal in ("full", "reduced"):
        data = bars(folder)
        data["march"]["thermal"] = thermal
        case = case_from_data(data, "bars", folder)
        setup = set_up(case)
        found[thermal] = case, setup, simulate(case, setup=setup)
    return found


def test_row_zero_is_the_field_in_equilibrium(warm):
    case, setup, done = warm["full"]
    start = done.response.isel(time=0)
    assert start["temperature"].sel(probe="right").item() == pytest.approx(15.0, rel=1e-12)
    assert start["temperature"].sel(probe="left").item() == pytest.approx(4.0, rel=1e-12)
    # Held from the start, and grown between its supports, which presses the joint.
    field = setup.machine.start.temperature(np.array([0.0, 5.0]))
    held = setup.spaces.heat.doflocs[0] < 1e-9
    np.testing.assert_allclose(field[held], 5.0, rtol=1e-12)
    assert (done.response["held_temperature"] == 5.0).all()
    assert start["pressure"].min().item() > 2e6
    # Both sides have the formula's value at the joint.
    assert np.abs(start["heat_flow"]).max().item() < 1e-9
    assert case.initial_temperature is not None


def test_the_reduced_march_starts_warm_as_the_full_one(warm):
    full, reduced = (warm[thermal][2].response for thermal in ("full", "reduced"))
    np.testing.assert_allclose(reduced["temperature"], full["temperature"], atol=1e-3)
    np.testing.assert_allclose(reduced["displacement"], full["displacement"], atol=2e-9)
    np.testing.assert_allclose(reduced["pressure"], full["pressure"], rtol=1e-3)
    np.testing.assert_allclose(reduced["heat_flow"], full["heat_flow"], atol=1e-2)
    for response in (full, reduced):
        assert np.abs(response["heat_balance"]).max().item() < 1e-8
        assert response["gap_residual"].max().item() < 1e-11
    assert reduced.attrs["reduction_error"] <= 1.0


def test_the_full_field_of_row_zero_ends_where_the_probe_does(warm):
    """Two ways to one displacement: the condensed probe and the field behind a snapshot."""
    from fesim.simulate import at_rest

    _, setup, done = warm["reduced"]
    step = at_rest(setup.machine, np.array([0.0, 5.0]))
    found = setup.displacement(step).reshape(-1, 3)[setup.spaces.elastic.nodal_dofs[0]]
    points = setup.structure.mesh.p
    at = np.argmin(np.abs(points - np.array([[0.25], [0.03], [0.02]])).sum(axis=0))
    np.testing.assert_allclose(found[at], done.response["displacement"][0], atol=1e-13)


def test_a_snapshot_of_a_march_starts_the_next_where_it_ended(warm, tmp_path):
    case, setup, done = warm["full"]
    simulate(case, setup=setup, on_step=snapshot_writer(setup, tmp_path, [120.0]))
    [snapshot] = tmp_path.glob("structure_*.vtu")
    data = bars(tmp_path, initial_temperature={"file": snapshot.name})
    again = case_from_data(data, "bars", tmp_path)
    field = initial_temperature(again, setup.structure, setup.spaces.heat)
    np.testing.assert_allclose(field, done.state.temperature, atol=1e-5)
    # Another mesh of the same bars: each body keeps its own side of the joint.
    write_structure(two_bars((3, 2, 2), (5, 3, 1)), tmp_path / "bars.vtu")
    data["march"]["thermal"] = "full"
    there = set_up(case_from_data(data, "bars", tmp_path)).machine
    begins = there.start.temperature(np.array([0.0, 5.0]))
    jump = setup.machine.thermal.jump @ done.state.temperature
    assert np.abs(jump).min() > 0.01
    np.testing.assert_allclose(there.thermal.jump @ begins, jump, rtol=0.3)


def test_a_march_is_continued_only_from_the_same_start(warm, tmp_path):
    case, _, done = warm["reduced"]
    save_state(done.state, case, tmp_path / "state.npz")
    load_state(tmp_path / "state.npz", case)
    data = case.model_dump(mode="json") | {"initial_temperature": {"rise_K": 1.0}}
    other = case_from_data(data, "bars", tmp_path)
    with pytest.raises(InputError, match="state of another"):
        load_state(tmp_path / "state.npz", other)
    assert condensation_key(case) != condensation_key(other)


def test_a_uniform_start_at_the_ambient_changes_nothing(tmp_path):
    data = bars(tmp_path, initial_temperature={"rise_K": 0.0}, held_temperatures={})
    data["ambient"] = {"file": "hall.csv"}
    (tmp_path / "hall.csv").write_text("time_s,ambient_degC\n0,20\n60,22\n")
    zero = simulate(case_from_data(data, "bars", tmp_path)).response
    del data["initial_temperature"]
    none = simulate(case_from_data(data, "bars", tmp_path)).response
    np.testing.assert_allclose(zero["pressure"], none["pressure"], rtol=1e-9)
    np.testing.assert_allclose(zero["displacement"], none["displacement"], atol=1e-14)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"rise_K": 1.0, "file": "a.csv"}, "give one of 'rise_K'"),
        ({}, "give one of 'rise_K'"),
        ({"expression_K": "import os"}, "is not a formula"),
        ({"expression_K": "speed"}, "no variable named 'speed'"),
        ({"expression_K": "1 / (x_m - 0.1)"}, "initial_temperature.expression_K: is inf at"),
        ({"file": "missing.csv"}, "missing.csv: cannot be read"),
        ({"file": "missing.vtu"}, "cannot be read"),
        ({"file": "bars.vtu"}, "no snapshot of a structure"),
        ({"file": "text.vtu"}, "not a readable VTU"),
    ],
)
def test_a_start_that_is_none_is_one_line(tmp_path, section, message):
    (tmp_path / "text.vtu").write_text("no VTU")
    with pytest.raises(InputError, match=message) as refused:
        set_up(case_from_data(bars(tmp_path, initial_temperature=section), "bars", tmp_path))
    assert "\n" not in str(refused.value)


def test_calibration_drives_start_at_the_ambient(warm):
    case, _, _ = warm["reduced"]
    driven = case.model_copy(
        update={
            "held_temperatures": {},
            "sources": read_case(REFERENCE).sources,
        }
    )
    with pytest.raises(InputError, match="starts at the ambient"):
        check_drivable(driven)


# --- heat alone ----------------------------------------------------------------------------------


@pytest.mark.parametrize("thermal", ["reduced", "full"])
def test_heat_alone_is_marched_as_with_deformation_and_needs_no_supports(tmp_path, thermal):
    bonded = SURFACE | {"conductance": {"law": "fixed", "value_W_m2K": 2000.0}}
    data = bars(tmp_path, joints={"joint": bonded})
    data["march"] = data["march"] | {"thermal": thermal}
    whole = simulate(case_from_data(data, "bars", tmp_path)).response
    del data["displacement"]
    setup = set_up(case_from_data(data | {"supports": {}}, "bars", tmp_path))
    alone = simulate(case_from_data(data | {"supports": {}}, "bars", tmp_path), setup=setup)
    write_response(alone.response, tmp_path / "alone.nc")
    read = read_response(tmp_path / "alone.nc")
    # The modes are those of other outputs.
    np.testing.assert_allclose(read["temperature"], whole["temperature"], atol=1e-3)
    assert read["displacement"].shape == (len(read["time"]), 0)
    assert "heat alone" in result_lines(read, figures_of(read))[-1].lower()
    assert "svg" in alone._repr_html_()
    with pytest.raises(InputError, match="the case asks for heat alone"):
        setup.field  # noqa: B018 - it raises
    (tmp_path / "alone.toml").write_text(as_toml(data | {"supports": {}}))
    for show, code in (("temperature", 0), ("deformation", 2), ("pressure", 2), ("pressures", 2)):
        picture = tmp_path / f"{show}.png"
        assert run("view", tmp_path / "alone.toml", "--show", show, "--out", picture) == code


def test_what_needs_a_deformation_says_so_without_one(tmp_path):
    data = bars(tmp_path)
    del data["displacement"]
    for changes, section in (
        ({}, "joints.joint"),
        ({"joints": {}, "output": {"forces": True}}, "output"),
        ({"joints": {}, "loads": {"w": {"acceleration_m_s2": [0, 0, -9.8]}}}, "loads.w"),
    ):
        with pytest.raises(InputError, match=rf"{section} needs the deformation") as refused:
            case_from_data(data | changes, "bars", tmp_path)
        assert "\n" not in str(refused.value)


# --- profiles ------------------------------------------------------------------------------------

STEP = {"heat_input": {"kind": "step", "level": 1.0}}


def heated(folder, profile, **where):
    source = {"reference_power_W": 30.0, "profile": profile} | (where or {"body": "block"})
    data = bar_case(folder, STEP | {"sources": {"heat": source}}, (8, 2, 2))
    return data | {"march": {"step_s": 10.0, "duration_min": 1.0, "thermal": "full"}}


@pytest.mark.parametrize("where", [{"body": "block"}, {"surface": "z1"}])
def test_a_profile_moves_heat_and_keeps_the_power(tmp_path, where):
    (tmp_path / "weights.csv").write_text("x_mm,factor\n0,0\n100,100\n")
    by_formula = marched(tmp_path, heated(tmp_path, {"expression": "x_mm"}, **where))
    by_table = marched(tmp_path, heated(tmp_path, {"file": "weights.csv"}, **where))
    even = heated(tmp_path, {"expression": "7"}, **where)
    plain = heated(tmp_path, {"expression": "7"}, **where)
    del plain["sources"]["heat"]["profile"]
    np.testing.assert_allclose(by_formula["temperature"], by_table["temperature"], rtol=1e-9)
    np.testing.assert_allclose(
        marched(tmp_path, even)["temperature"], marched(tmp_path, plain)["temperature"], rtol=1e-9
    )
    last = by_formula["temperature"][-1]
    assert last.sel(probe="end") > last.sel(probe="middle") > last.sel(probe="start")
    assert np.abs(by_formula["heat_balance"]).max().item() < 1e-9


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        ({"expression": "x_mm - 50"}, "sources.heat.profile: is .* below 0"),
        ({"expression": "0 * x_m"}, "zero everywhere"),
        ({"expression": "1 / 0"}, "is inf at"),
        ({"expression": "x"}, "no variable named 'x'"),
        ({}, "give either 'expression' or 'file'"),
        ({"file": "missing.csv"}, "missing.csv: cannot be read"),
    ],
)
def test_a_profile_that_is_none_is_one_line(tmp_path, profile, message):
    with pytest.raises(InputError, match=message) as refused:
        marched(tmp_path, heated(tmp_path, profile))
    assert "\n" not in str(refused.value)


def test_another_profile_is_another_condensation(tmp_path):
    (tmp_path / "weights.csv").write_text("x_mm,factor\n0,1\n100,2\n")
    data = heated(tmp_path, {"file": "weights.csv"}, surface="z1")
    data |= {"held_temperatures": {"x0": {"rise_K": 1.0, "profile": {"expression": "1"}}}}
    keys = [condensation_key(case_from_data(data, "case", tmp_path))]
    data["held_temperatures"]["x0"]["rise_K"] = 2.0
    assert condensation_key(case_from_data(data, "case", tmp_path)) == keys[0]
    (tmp_path / "weights.csv").write_text("x_mm,factor\n0,1\n100,3\n")
    keys.append(condensation_key(case_from_data(data, "case", tmp_path)))
    data["held_temperatures"]["x0"]["profile"]["expression"] = "2"
    keys.append(condensation_key(case_from_data(data, "case", tmp_path)))
    assert len(set(keys)) == 3


def test_a_held_profile_follows_its_history_in_both_models(tmp_path):
    (tmp_path / "held.csv").write_text("time_s,rise_K\n0,0\n60,30\n")
    held = {"x0": {"file": "held.csv", "profile": {"expression": "0.5 + y_mm / 20"}}}
    found = []
    for thermal in ("full", "reduced"):
        march = {"step_s": 10.0, "duration_min": 1.0, "thermal": thermal}
        data = bar_case(tmp_path, {"held_temperatures": held, "march": march}, (8, 2, 2))
        data["probes"] |= {f"y{y:g}": {"position_mm": [0.0, y, 10.0]} for y in (0.0, 10.0, 20.0)}
        found.append(marched(tmp_path, data)["temperature"])
    full, reduced = found
    on_edge = full[-1].sel(probe=["y0", "y10", "y20"]).to_numpy()
    np.testing.assert_allclose(on_edge, [15.0, 30.0, 45.0], rtol=1e-12)
    np.testing.assert_allclose(reduced, full, atol=1e-3)
