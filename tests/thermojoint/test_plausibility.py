"""Values hardly meant get one line with the unit that was; the machines at hand get none."""

import tomllib
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from edits import edited
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT

from fesim.case.schema import case_from_data, read_case
from thermojoint import plausibility
from thermojoint.artefacts.response import make_response

REFERENCE = tomllib.loads(
    files("thermojoint").joinpath("cases/reference.toml").read_text(encoding="utf-8")
)
IRON = ("materials", "cast_iron")
KNEE = ("joints", "knee")


def lines_of(*edits, folder=Path()):
    """The lines about the reference machine with some values set."""
    data = edited(REFERENCE, *edits)
    return plausibility.of_case(case_from_data(data, "case", folder), "case.toml")


SLIPS = [
    ((*IRON, "density_kg_m3"), 7.2, "7.2 g/cm3 would be 7200 kg/m3"),
    ((*IRON, "density_kg_m3"), 0.26, "0.26 lb/in3 would be 7196.8 kg/m3"),
    ((*IRON, "density_kg_m3"), 7.2e-9, "7.2e-09 t/mm3 would be 7200 kg/m3"),
    ((*IRON, "youngs_modulus_GPa"), 0.104, "0.104 TPa would be 104 GPa"),
    ((*IRON, "youngs_modulus_GPa"), 104e9, "1.04e+11 Pa would be 104 GPa"),
    ((*IRON, "youngs_modulus_GPa"), 104e3, "104000 MPa would be 104 GPa"),
    ((*IRON, "expansion_1_K"), 13.7, "13.7 1e-6/K would be 1.37e-05 1/K"),
    ((*IRON, "expansion_1_K"), 0.0137, "0.0137 mm/(m K) would be 1.37e-05 1/K"),
    ((*IRON, "conductivity_W_mK"), 47e3, "47000 mW/(m K) would be 47 W/(m K)"),
    ((*IRON, "heat_capacity_J_kgK"), 0.5, "0.5 kJ/(kg K) would be 500 J/(kg K)"),
    (("heat_input", "level"), 150.0, "150 % would be 1.5 times the reference step"),
    (("convection_W_m2K", "exterior"), 6e7, "6e+07 µW/(m2 K) would be 60 W/(m2 K)"),
    (("convection_W_m2K", "exterior"), 6e-6, "6e-06 W/(mm2 K) would be 6 W/(m2 K)"),
    (("sources", "bearings", "reference_power_W"), 6e6, "would be"),
    (("sources", "bearings", "reference_power_W"), 0.295, "0.295 kW would be 295 W"),
    ((*KNEE, "preload_MPa"), 0.00441, "0.00441 GPa would be 4.41 MPa"),
    ((*KNEE, "hardness_GPa"), 200.0, "200 kgf/mm2 (HB, HV) would be 1.9613 GPa"),
    ((*KNEE, "roughness_um"), 1.25e-6, "1.25e-06 m would be 1.25 µm"),
    ((*KNEE, "roughness_um"), 1250.0, "1250 nm would be 1.25 µm"),
    ((*KNEE, "asperity_slope"), 8.0, "8 degrees would be 0.13963 rad"),
    ((*KNEE, "friction_coefficient"), 60.0, "60 % would be 0.6"),
    (("structure", "element_size_mm"), 0.05, "0.05 m would be 50 mm"),
    (("structure", "dimensions_mm", "wall"), 0.05, "0.05 m would be 50 mm"),
    (
        ("held_temperatures", "exterior", "rise_K"),
        293.15,
        "293.15 K, as an absolute temperature, would be 0 K above an ambient of 20 °C",
    ),
    (
        ("supports", "springs", "column_base", "stiffness_N_um"),
        [2e8, 0.0, 0.0],
        "2e+08 N/m would be 200 N/µm",
    ),
]


@pytest.mark.parametrize(("place", "value", "meant"), SLIPS)
def test_an_implausible_value_gets_one_line_with_the_unit_that_was_meant(place, value, meant):
    (line,) = lines_of((place, value))
    assert line.startswith(f"case.toml: {'.'.join(place)}")
    assert "is implausible, usual is" in line
    assert meant in line
    assert "\n" not in line


@pytest.mark.parametrize(
    "path",
    [
        "thermojoint/cases/reference.toml",
        "thermojoint/cases/equal_heights.toml",
        *("examples/bolted_flange/case.toml", "examples/two_rods/case.toml"),
        *("examples/batch/machine.toml", "examples/clamp/clamp.toml"),
    ],
)
def test_the_machines_at_hand_are_plausible(path):
    assert plausibility.of_case(read_case(ROOT / path), path) == []


def test_a_value_that_no_unit_explains_is_told_without_one():
    (line,) = lines_of(((*IRON, "heat_capacity_J_kgK"), 31.0))
    assert line.endswith("usual is 100 to 5000 J/(kg K)")


def test_names_like_keys_are_no_values():
    case = {"level": 6.0, "density_kg_m3": 6.0, "preload_MPa": 6.0}
    assert lines_of((("convection_W_m2K",), case)) == []


def test_a_displacement_of_a_point_from_itself_is_told():
    (line,) = lines_of((("displacement",), {"point": "A", "relative_to": "A"}))
    assert line.startswith("case.toml: displacement: point and relative_to are both 'A'")
    tip = {"tool_mm": [0.0, 0.0, 100.0], "tool_within_mm": 50.0}
    assert lines_of((("displacement",), {"point": "A", "relative_to": "A"} | tip)) == []


QUANTITIES = [*plausibility.CASE.values(), plausibility.AMBIENT, plausibility.RISE_AT_START]


@given(st.sampled_from(QUANTITIES), st.floats(0.0, 1.0), st.data())
def test_what_a_line_proposes_is_plausible_and_what_is_plausible_has_no_line(quantity, at, data):
    plain = quantity.low + at * (quantity.high - quantity.low)
    assert plausibility.implausible("here", plain, quantity) == []
    if quantity.slips:
        slip = data.draw(st.sampled_from(quantity.slips))
        wrong = (quantity.typical - slip.offset) / slip.factor
        lines = plausibility.implausible("here", wrong, quantity)
        assert all(" would be " in line for line in lines)
        assert len(lines) == (0 if quantity.low <= wrong <= quantity.high or wrong == 0.0 else 1)


def history(folder, column, rows):
    text = f"time_s,{column}\n" + "".join(f"{time},{value}\n" for time, value in rows)
    (folder / "given.csv").write_text(text)
    return folder / "given.csv"


def sampled(folder):
    return lines_of((("heat_input",), {"kind": "sampled", "file": "given.csv"}), folder=folder)


def test_a_heat_input_in_percent_is_told(tmp_path):
    history(tmp_path, "heat_input", [(0, 0), (30, 100), (600, 40)])
    (line,) = sampled(tmp_path)
    assert line.startswith(f"{tmp_path / 'given.csv'}: heat_input = 100 is implausible")
    assert "100 % would be 1 times the reference step" in line


def test_swapped_columns_of_a_rising_history_are_told(tmp_path):
    history(tmp_path, "heat_input", [(0, 0), (0.5, 30), (1.0, 300), (1.5, 600)])
    (line,) = sampled(tmp_path)
    assert "the columns look swapped: heat_input rises from 0 to 600" in line
    history(tmp_path, "heat_input", [(0, 0), (30, 0.5), (300, 1.0), (600, 1.5)])
    assert sampled(tmp_path) == []


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([(0, 293.15), (600, 295.0)], "295 K would be 21.85 °C"),
        ([(0, 68.0), (600, 72.0)], "72 °F would be 22.222 °C"),
        ([(19.0, 0), (20.0, 600), (21.0, 1200)], "the columns look swapped"),
        ([(0, 19.0), (600, 23.0)], None),
    ],
)
def test_an_ambient_in_another_unit_is_told(tmp_path, rows, said):
    history(tmp_path, "ambient_degC", rows)
    lines = lines_of((("ambient",), {"file": "given.csv"}), folder=tmp_path)
    assert len(lines) == (said is not None)
    assert all(said in line for line in lines)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([(3600, 0.0), (3660, 1.0)], "3600 to 3660 s, wholly outside the march from 0 to 2100 s"),
        ([(-600, 0.0), (-60, 1.0)], "in which it stays at 1;"),
        ([(-600, 0.0), (60, 1.0)], None),
        ([(2000, 0.0), (3000, 1.0)], None),
        ([(3600, 1.0)], None),
    ],
)
def test_a_history_wholly_outside_the_march_is_told(tmp_path, rows, said):
    history(tmp_path, "heat_input", rows)
    assert [said in line for line in sampled(tmp_path)] == [True] * (said is not None)


def test_a_load_after_the_march_is_told(tmp_path):
    history(tmp_path, "factor", [(3600, 0.0), (3660, 1.0)])
    load = {"surface": "exterior", "force_N": [0.0, -100.0, 0.0], "file": "given.csv"}
    (line,) = lines_of((("loads", "cut"), load), folder=tmp_path)
    assert "factor goes from 3600 to 3660 s" in line


@pytest.mark.parametrize(
    ("heat", "ambient", "said"),
    [
        ("2026-03-02 08:00:00", "2026-03-02 07:30:00", "1800 s earlier than that of"),
        ("23:59:00", "23:59:30", "30 s later than that of"),
        ("2026-03-02 08:00:00", "2026-03-02 08:00:01", None),
        ("2026-03-02 08:00:00", "08:30:00", None),
        ("0", "60", None),
    ],
)
def test_histories_that_were_recorded_from_different_times_on_are_told(
    tmp_path, heat, ambient, said
):
    """Each counts from its own first row, also where both have dates."""
    clock = "time_s" if heat == "0" else "time"
    (tmp_path / "heat.csv").write_text(f"{clock},heat_input\n{heat},1.0\n")
    (tmp_path / "hall.csv").write_text(f"{clock},ambient_degC\n{ambient},21.0\n")
    lines = lines_of(
        (("heat_input",), {"kind": "sampled", "file": "heat.csv"}),
        (("ambient",), {"file": "hall.csv"}),
        folder=tmp_path,
    )
    assert [said in line for line in lines] == [True] * (said is not None)


@pytest.mark.parametrize(
    "text", ["", "time_s,heat_input\n", "time_s,heat_input\n0,nan\n", "a\n1\n"]
)
def test_a_history_that_will_be_refused_is_left_to_its_reader(tmp_path, text):
    (tmp_path / "given.csv").write_text(text)
    assert sampled(tmp_path) == []


def test_several_cases_have_one_line_for_each_place(tmp_path):
    cases = []
    for density in (7.2, 7.3, 7200.0):
        data = edited(REFERENCE, ((*IRON, "density_kg_m3"), density))
        cases.append(case_from_data(data, "case", tmp_path))
    (line,) = plausibility.of_cases(cases, "study.toml")
    assert "density_kg_m3 = 7.2 is implausible" in line


@pytest.mark.parametrize(
    ("sample", "said"),
    [
        ({"time_s": 1e9, "delta_T_K": 4.0, "T1_K": 1.0, "T2_K": 2.0}, []),
        ({"T1_K": 294.0}, ["T1_K = 294 is implausible"]),
        ({"a_degC": 40.0, "ambient_degC": 21.0}, []),
        (
            {"a_degC": 313.0, "ambient_degC": 293.0},
            ["313 K would be 39.85", "293 K would be 19.85"],
        ),
        ({"a_degC": 104.0, "ambient_degC": 68.0}, ["68 °F would be 20 °C"]),
    ],
)
def test_a_measured_row_in_kelvin_or_fahrenheit_is_told(sample, said):
    lines = plausibility.of_sample(sample, "measured.csv")
    assert len(lines) == len(said)
    assert all(part in line for part, line in zip(said, lines, strict=True))


def measured(temperature=0.0, displacement=1e-4, heat=1.0, position=0.5, **attributes):
    """A measured response whose temperatures rise by 30 K from where they start."""
    time = 2.0 * np.arange(4)
    return make_response(
        {
            "heat_input": np.full(4, heat),
            "temperature": temperature + np.outer(np.arange(4) * 10.0, np.ones(2)),
            "displacement": displacement * np.arange(4.0)[:, None] / 3.0,
            "probe_position": np.full((2, 3), position),
        },
        {"time": time, "probe": ["a", "b"], "axis": ["x"], "space": ["x", "y", "z"]},
        attributes,
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, None),
        ({"temperature": 294.15}, "294.15 K, as an absolute temperature, would be 1 K above"),
        ({"temperature": 21.0}, "21 °C as read would be 1 K above an ambient of 20 °C"),
        ({"temperature": 69.8}, "69.8 °F as read would be 1 K above an ambient of 20 °C"),
        ({"displacement": 120.0}, "120 µm would be 0.00012 m"),
        ({"displacement": -0.12}, "-0.12 mm would be -0.00012 m"),
        ({"heat": 100.0}, "100 % would be 1 times the reference step"),
        ({"position": 500.0}, "500 mm would be 0.5 m"),
        ({"reference_power_W": 0.295}, "0.295 kW would be 295 W"),
        # Simulated: it starts where a saved state ended.
        ({"temperature": 21.0, "case": "{}"}, None),
    ],
)
def test_a_measured_response_in_another_unit_is_told(given, said):
    lines = plausibility.of_response(measured(**given), "measured.nc")
    assert len(lines) == (said is not None)
    assert all(line.startswith("measured.nc: ") and said in line for line in lines)


def test_a_mesh_in_mm_that_was_read_as_m_is_told(coarse_setup):
    assert plausibility.of_structure(coarse_setup.structure, "case.toml") == []
    (line,) = plausibility.implausible("case.toml: longest side", 45.0, plausibility.EXTENT)
    assert "45 read as m from a mesh in mm would be 0.045 m" in line
    (line,) = plausibility.implausible("case.toml: longest side", 7e-4, plausibility.EXTENT)
    assert "0.0007 read as mm from a mesh in m would be 0.7 m" in line


OTHER_PLACES = [
    ((("heat_input",), {"kind": "ramp", "level": 150.0, "duration_min": 2.0}), "heat_input.level"),
    (
        (("heat_input",), {"kind": "triangle", "peak": 150.0, "duration_min": 2.0}),
        "heat_input.peak",
    ),
    (
        (("sources", "bearings", "heat_input"), {"kind": "step", "level": 150.0}),
        "sources.bearings.heat_input.level",
    ),
    (((*KNEE, "tangential_stiffness_ratio"), 84.4), "joints.knee.tangential_stiffness_ratio"),
    ((("march",), {"step_s": 5000.0, "duration_min": 100.0}), "march.step_s"),
    ((("march", "duration_min"), 1e5), "march.duration_min"),
    ((("structure", "joint_element_size_mm"), 0.025), "structure.joint_element_size_mm"),
    (
        (("candidates",), [REFERENCE["candidates"][0] | {"spacing_mm": 0.05}]),
        "candidates.0.spacing_mm",
    ),
]


@pytest.mark.parametrize(("edit", "place"), OTHER_PLACES)
def test_values_are_found_in_every_kind_of_section(edit, place):
    (line,) = lines_of(edit)
    assert line.startswith(f"case.toml: {place} = ")
    assert " would be " in line
