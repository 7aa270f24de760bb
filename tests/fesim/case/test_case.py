"""The case file: what is allowed, and one line for everything that is not."""

import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import get_args, get_origin

import pytest
from edits import edited
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from fesim.case.identity import case_id
from fesim.case.schema import Case, case_from_data, parse_case, read_case, step_count
from thermojoint.artefacts.errors import InputError, InputErrors, UnreadableError
from thermojoint.artefacts.settings.section import files_of

REFERENCE = files("thermojoint").joinpath("cases/reference.toml").read_text("utf-8")
PROBES = {
    "a": {"position_mm": [575.0, 600.0, 175.0], "body": "column"},
    "T1": {"position_mm": [625.0, 450.0, 87.5]},
}
DATA = tomllib.loads(REFERENCE) | {"probes": PROBES}


def changed(place, value):
    """The reference case with one value set, or without it if that is None."""
    return edited(DATA, (place, value))


def refusal(data, folder=Path()):
    with pytest.raises(InputError) as caught:
        case_from_data(data, "machine.toml", folder)
    said = str(caught.value)
    assert "\n" not in said
    assert said.startswith("machine.toml")
    return said


def test_the_reference_case_is_valid():
    case = parse_case(REFERENCE, "reference.toml", Path())
    assert case.sources["bearings"].reference_power_W == 295.0
    assert case.joints["knee"].preload_MPa == 4.41
    assert case.probes or case.candidates


def test_both_shipped_machines_have_all_that_is_printed():
    text = files("thermojoint").joinpath("cases/equal_heights.toml").read_text("utf-8")
    case = parse_case(text, "equal_heights.toml", Path())
    reference = parse_case(REFERENCE, "reference.toml", Path())
    for same in ("materials", "sources", "convection_W_m2K", "supports", "displacement", "march"):
        assert getattr(case, same) == getattr(reference, same)
    knee, of_reference = case.joints["knee"], reference.joints["knee"]
    assert knee.model_copy(update={"friction_coefficient": 0.3}) == of_reference
    assert len(case.candidates) == 2


@pytest.mark.parametrize(("step", "count"), [(2.0, 1050), (9.0, 234), (1400.0, 2), (2100.0, 1)])
def test_a_march_ends_with_the_first_step_at_or_after_its_duration(step, count):
    case = case_from_data(changed(("march", "step_s"), step), "case", Path())
    assert case.march.duration_min == 35.0
    assert step_count(case.march) == count


def test_a_snapshot_after_the_end_is_refused():
    case_from_data(changed(("output",), {"snapshots_s": [0.0, 2100.0]}), "case", Path())
    said = refusal(changed(("output",), {"snapshots_s": [60.0, 2101.0]}))
    assert "2101 s is after the end at 2100 s" in said


def test_a_case_survives_being_stored_in_a_response():
    case = parse_case(REFERENCE, "reference.toml", Path())
    assert Case.model_validate_json(case.model_dump_json()) == case


@pytest.mark.parametrize(
    ("place", "near", "where"),
    [
        (("titel",), "title", "machine.toml"),
        (("march", "steps_s"), "step_s", "machine.toml: march"),
        (("joints", "knee", "friction"), "friction_coefficient", "machine.toml: joints.knee"),
        (("joints", "knee", "preload_mpa"), "preload_MPa", "machine.toml: joints.knee"),
        (
            ("joints", "knee", "conductance", "exponents"),
            "exponent",
            "machine.toml: joints.knee.conductance",
        ),
        (
            ("materials", "cast_iron", "conductivity_WmK"),
            "conductivity_W_mK",
            "machine.toml: materials.cast_iron",
        ),
        (("structure", "element_size"), "element_size_mm", "machine.toml: structure"),
        (("heat_input", "levels"), "level", "machine.toml: heat_input"),
        (("sources", "bearings", "surfaces"), "surface", "machine.toml: sources.bearings"),
        (("probes", "a", "position"), "position_mm", "machine.toml: probes.a"),
        (("supports", "fix"), "fixed", "machine.toml: supports"),
        (("convection",), "convection_W_m2K", "machine.toml"),
    ],
)
def test_an_unknown_key_is_refused_with_its_place_and_the_nearest_known_one(place, near, where):
    said = refusal(changed(place, 1.0))
    assert said == f"{where}: no key named {place[-1]!r}; did you mean {near!r}?"


POSITIVE = [
    *(
        ("materials", "cast_iron", name)
        for name in (
            "conductivity_W_mK",
            "density_kg_m3",
            "heat_capacity_J_kgK",
            "youngs_modulus_GPa",
        )
    ),
    *(
        ("joints", "knee", name)
        for name in (
            "roughness_um",
            "asperity_slope",
            "hardness_GPa",
            "tangential_stiffness_ratio",
        )
    ),
    ("structure", "element_size_mm"),
    ("sources", "bearings", "reference_power_W"),
    ("march", "step_s"),
    ("march", "duration_min"),
]
NOT_NEGATIVE = [
    ("joints", "knee", "preload_MPa"),
    ("joints", "knee", "friction_coefficient"),
    ("convection_W_m2K", "exterior"),
]
FINITE = [
    ("materials", "cast_iron", "expansion_1_K"),
    ("materials", "cast_iron", "poisson_ratio"),
    ("heat_input", "level"),
]
IMPOSSIBLE = [
    *((place, value) for place in POSITIVE for value in (0.0, -1.0, math.nan, math.inf)),
    *((place, value) for place in NOT_NEGATIVE for value in (-1e-9, math.nan, math.inf)),
    *((place, value) for place in FINITE for value in (math.nan, math.inf, -math.inf)),
    (("materials", "cast_iron", "poisson_ratio"), 0.5),
    (("materials", "cast_iron", "density_kg_m3"), "heavy"),
    (("joints", "knee", "along"), 0),
    (("joints", "knee", "along"), 2.5),
    (("joints", "knee", "normal_law"), "hertz"),
    (("sources", "bearings", "count"), 0),
    (("sources", "bearings", "reading"), "each"),
    (("march", "coupling"), "strong"),
    (("march", "solver"), "mumps"),
    (("supports", "symmetry"), {"symmetry": "w"}),
    (("probes", "a", "position_mm"), [1.0, 2.0]),
    (("probes", "a", "position_mm"), [1.0, 2.0, math.nan]),
    (("structure", "half"), "perhaps"),
    (("output",), {"snapshots_s": [-1.0]}),
    # Text is no number, and a number no yes.
    (("joints", "knee", "preload_MPa"), "4.41"),
    (("joints", "knee", "along"), "3"),
    (("march", "step_s"), True),
    (("structure", "half"), "true"),
    (("probes", "a", "position_mm"), ["575", 600.0, 175.0]),
]


@pytest.mark.parametrize(("place", "value"), IMPOSSIBLE)
def test_an_impossible_value_is_refused_with_its_place(place, value):
    said = refusal(changed(place, value))
    assert ".".join(place) in said
    assert said.endswith(("; change it", "; add it"))


@pytest.mark.parametrize(
    ("place", "key"),
    [
        (("materials", "mesh"), "density_kg_m3"),
        (("materials", "step"), "poisson_ratio"),
        (("sources", "triangle"), "reference_power_W"),
        (("joints", "sampled"), "preload_MPa"),
    ],
)
def test_a_section_that_is_called_like_a_kind_is_named_as_it_is_called(place, key):
    data = changed(place, {})
    section, name = place
    data[section][name] = next(iter(DATA[section].values())) | {key: "much"}
    said = refusal(data)
    assert said.startswith(f"machine.toml: {section}.{name}.{key}: ")


def test_a_bad_value_of_a_kind_is_named_without_the_kind():
    assert refusal(changed(("structure", "half"), "maybe")).startswith(
        "machine.toml: structure.half: "
    )
    data = changed(("sources", "bearings", "heat_input"), {"kind": "step", "level": "much"})
    assert refusal(data).startswith("machine.toml: sources.bearings.heat_input.level: ")


def test_keys_of_a_section_called_like_a_key_are_known():
    data = changed(("materials", "poisson_ratio"), DATA["materials"]["screw"] | {"densty": 1.0})
    assert "did you mean 'density_kg_m3'?" in refusal(data)


#: What every case says, and what belongs to one machine and not to machines.
NO_DEFAULT = [
    *(("title",), ("structure",), ("supports",), ("bodies",), ("heat_input", "level")),
    ("materials", "cast_iron", "density_kg_m3"),
    ("probes", "T1", "position_mm"),
    *(
        ("joints", "knee", name)
        for name in (
            *("preload_MPa", "roughness_um", "asperity_slope", "hardness_GPa"),
            "friction_coefficient",
        )
    ),
    ("joints", "knee", "back_burdekin", "coefficient_um"),
    ("joints", "knee", "back_burdekin", "exponent"),
    ("sources", "bearings", "reference_power_W"),
    ("march",),
    ("march", "step_s"),
    ("march", "duration_min"),
]


@pytest.mark.parametrize("place", NO_DEFAULT)
def test_a_missing_key_without_a_default_is_named_with_its_place(place):
    assert refusal(changed(place, None)) == f"machine.toml: {'.'.join(place)} is missing; add it"


def test_the_constants_of_a_law_that_is_asked_for_must_be_given():
    data = changed(("joints", "knee", "back_burdekin"), None)
    case_from_data(data, "case", Path())
    data["joints"]["knee"]["normal_law"] = "back-burdekin"
    assert "needs back_burdekin = { coefficient_um" in refusal(data)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ('[bodies]\ntable = "cast_iron"\nslide.left = "cast_iron"\n', "slide.left"),
        ("[convection_W_m2K]\nslide.a = 6.0\n", "slide.a"),
        ("[convection_W_m2K]\nslide.a.top = 6.0\n", "slide.a.top"),
        ('[supports]\nsymmetry.cut.x = "x"\n', "cut.x"),
        ("[joints.slide.left]\npreload_MPa = 1.0\n", "slide.left"),
        ("[probes.T.1]\nposition_mm = [0.0, 0.0, 0.0]\n", "T.1"),
        ("[held_temperatures.slide.a]\nrise_K = 1.0\n", "slide.a"),
    ],
)
def test_a_dotted_name_without_quotes_is_told_to_need_them(text, name):
    parts = tomllib.loads(text)
    said = refusal({**DATA, **parts})
    assert said.endswith(f'if the name is {name}, write it in quotes: "{name}"')


@pytest.mark.parametrize(
    ("section", "kind"), [("structure", "gear_box"), ("heat_input", "sine"), ("structure", None)]
)
def test_an_unknown_kind_is_refused(section, kind):
    assert f"machine.toml: {section}" in refusal(changed((section, "kind"), kind))


@pytest.mark.parametrize(
    "conductance",
    [
        {"law": "constants"},
        {"law": "constants", "constant": 1.3},
        {"law": "constants", "exponent": 0.9},
        {"law": "cmy-1969", "constant": 1.3, "exponent": 0.9},
        {"law": "cmy-exact", "exponent": 0.9},
    ],
)
def test_constants_of_eq_11_come_with_their_law_and_both(conductance):
    said = refusal(changed(("joints", "knee", "conductance"), conductance))
    assert 'go with law = "constants", both of them' in said
    assert "joints.knee.conductance" in said


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        (("joints", "knee", "preload_MPa"), 0.5 * 1961.0, "below half of the hardness"),
        (("joints", "knee", "side_a"), "knee.a", "both side_a and side_b"),
        (("march", "duration_min"), 0.01, "shorter than one step"),
        (("output",), {"stress_probes": ["a", "a"]}, "stress_probes: 'a' is named twice"),
    ],
)
def test_values_that_do_not_go_together_are_refused(place, value, told):
    assert told in refusal(changed(place, value))


@pytest.mark.parametrize("section", ["materials", "joints", "probes", "structure", "sources"])
def test_a_number_in_place_of_a_section_is_refused(section):
    assert f"machine.toml: {section}" in refusal(changed((section,), 3))


def test_files_are_looked_for_beside_the_case(tmp_path):
    data = changed(("heat_input",), {"kind": "sampled", "file": "run.csv"})
    case = case_from_data(data, "machine.toml", tmp_path)
    assert case.heat_input.file == tmp_path / "run.csv"
    elsewhere = tmp_path / "other" / "run.csv"
    data = changed(("heat_input",), {"kind": "sampled", "file": str(elsewhere)})
    assert case_from_data(data, "machine.toml", tmp_path).heat_input.file == elsewhere


def test_every_mistake_of_a_case_has_a_line():
    data = changed(("joints", "knee", "preload_mpa"), 4.41)
    del data["joints"]["knee"]["preload_MPa"]
    data["march"]["step_s"] = -2.0
    data["heat_input"] = {"kind": "step", "levl": 1.0}
    data["sources"]["bearings"] |= {"count": "2", "colour": "red"}
    del data["title"]
    with pytest.raises(InputErrors) as caught:
        case_from_data(data, "machine.toml", Path())
    assert sorted(str(caught.value).splitlines()) == [
        "machine.toml: heat_input: no key named 'levl'; did you mean 'level'?",
        "machine.toml: joints.knee: no key named 'preload_mpa'; did you mean 'preload_MPa'?",
        "machine.toml: march.step_s: input should be greater than 0 (given: -2.0); change it",
        "machine.toml: sources.bearings.count: input should be a valid integer (given: '2'); "
        "change it",
        next(
            line
            for line in str(caught.value).splitlines()
            if line.startswith("machine.toml: sources.bearings: no key named 'colour'; ")
        ),
        "machine.toml: title is missing; add it",
    ]


def places_of_files(kind, place=()):
    """Every place of a schema whose type is a file's name; ``*`` is a name that a user gives."""
    if kind is Path:
        yield ".".join(place)
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        for name, field in kind.model_fields.items():
            yield from places_of_files(field.annotation, (*place, name))
    else:
        inner = (*place, "*") if get_origin(kind) is dict else place
        for part in get_args(kind):
            yield from places_of_files(part, inner)


#: Sections with a file, for every place where a case may name one.
WITH_FILE = {
    "structure": {"kind": "mesh"},
    "heat_input": {"kind": "sampled"},
    "sources.bearings.heat_input": {"kind": "sampled"},
    "sources.bearings.profile": {},
    "ambient": {},
    "initial_temperature": {},
    "held_temperatures.foot": {},
    "held_temperatures.foot.profile": {},
    "loads.weight": {"acceleration_m_s2": [0.0, 0.0, -9.81]},
    "bolts.left": {
        "head": {"surface": "a"},
        "thread": {"surface": "b"},
        "force_kN": 1.0,
        "material": "steel",
        "diameter_mm": 10.0,
    },
    "joints.knee.conductance": {"law": "table"},
    "axes.y": {
        "bodies": ["table"],
        "direction": [0.0, 1.0, 0.0],
        "stroke_mm": [0.0, 1.0],
        "station_mm": 1.0,
    },
}


def test_every_file_that_a_case_can_name_is_tried_here():
    named = {"bearings", "foot", "weight", "left", "knee", "y"}
    tried = {
        ".".join("*" if part in named else part for part in place.split(".")) + ".file"
        for place in WITH_FILE
    }
    assert tried == set(places_of_files(Case))


@pytest.mark.parametrize("place", WITH_FILE)
def test_a_case_is_another_when_what_is_in_its_file_changes(tmp_path, place):
    data = DATA | {"held_temperatures": {"foot": {"rise_K": 1.0}}}
    data = edited(data, (place.split("."), WITH_FILE[place] | {"file": "given.csv"}))
    if "axes" in data:
        data["joints"]["knee"]["axis"] = "y"
    case = case_from_data(data, "machine.toml", tmp_path)
    path = tmp_path / "given.csv"
    assert files_of(case) == [path]
    path.write_text("1")
    before = case_id(case)
    assert case_id(case) == before
    path.write_text("2")
    assert case_id(case) != before
    path.unlink()
    with pytest.raises(UnreadableError, match=r"given\.csv: cannot be read"):
        case_id(case)


@pytest.mark.parametrize(
    "text", ["title = ", "title = 'a'\ntitle = 'b'", "[march\nstep_s = 2", "just words"]
)
def test_text_that_is_no_toml_is_refused_with_its_line(text):
    with pytest.raises(InputError, match=r"machine\.toml: no valid TOML: .*\(at ") as caught:
        parse_case(text, "machine.toml", Path())
    assert "\n" not in str(caught.value)


@given(text=st.text(max_size=60))
def test_any_text_is_a_case_or_one_line_for_each_mistake(text):
    with pytest.raises(InputError) as caught:
        parse_case(text, "machine.toml", Path())
    assert isinstance(caught.value, InputErrors) or "\n" not in str(caught.value)
    assert all(line.startswith("machine.toml: ") for line in str(caught.value).splitlines())


def test_a_case_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: cannot be read; give a TOML case file"):
        read_case(tmp_path / "none.toml")
    with pytest.raises(InputError, match="cannot be read"):
        read_case(tmp_path)
    binary = tmp_path / "case.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        read_case(binary)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_case_is_read_from_its_file(tmp_path, encoding):
    """A byte order mark may lead."""
    path = tmp_path / "machine.toml"
    path.write_text(REFERENCE, encoding=encoding)
    assert read_case(path) == parse_case(REFERENCE, "reference", Path())
