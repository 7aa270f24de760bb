"""From a case to a machine: names that must exist, and what editing the case alone changes."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from edits import edited

from fesim.case.schema import case_from_data
from fesim.joint.law import BackBurdekinLaw, SurfaceNormalLaw
from fesim.setup.laws import joint_law
from fesim.setup.loads import heat_history, source_power
from fesim.setup.machine import set_up
from fesim.setup.parts import paired_joints
from fesim.setup.structure import (
    body_materials,
    body_of_candidate,
    build_structure,
    candidate_probes,
)
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError

PROBES = {
    "a": {"position_mm": [575.0, 600.0, 175.0], "body": "column"},
    "T1": {"position_mm": [625.0, 450.0, 87.5]},
}

KNEE = {
    "preload_MPa": 4.41,
    "along": 9,
    "roughness_um": 1.25,
    "asperity_slope": 0.14,
    "hardness_GPa": 1.961,
    "friction_coefficient": 0.6,
}


@pytest.fixture
def edit(coarse_data):
    """Make the coarse case with edits: (("joints", "knee", "along"), 4), ..."""

    def make(*edits):
        data = edited(coarse_data | {"probes": PROBES, "candidates": []}, *edits)
        return case_from_data(data, "machine.toml", Path())

    return make


NAMES = [
    (("bodies", "colum"), "cast_iron", "no body named 'colum'; did you mean 'column'?"),
    (("bodies", "table"), "castiron", "no material named 'castiron'; did you mean 'cast_iron'?"),
    (("bodies", "screw"), None, "body 'screw' has no material"),
    (
        ("sources", "bearings", "surface"),
        "bearing",
        "no surface named 'bearing'; did you mean 'bearings'?",
    ),
    (
        ("supports", "fixed"),
        ["column_bas", "screw_foot"],
        "no surface named 'column_bas'; did you mean 'column_base'?",
    ),
    (("supports", "symmetry"), {"symetry": "z"}, "did you mean 'symmetry'?"),
    (("convection_W_m2K", "outside"), 6.0, "convection_W_m2K: no surface named 'outside'"),
    (("displacement", "point"), "C", "displacement: no probe named 'C'"),
    (("displacement", "relative_to"), "BB", "did you mean 'B'?"),
    (
        ("structure", "dimensions_mm"),
        {"wal": 40.0},
        "structure.dimensions_mm: no dimension named 'wal'; did you mean 'wall'?",
    ),
    (("structure", "dimensions_mm"), {"wall": 300.0}, "does not fit"),
    (("joints", "kne"), KNEE, "no joint named 'kne'; did you mean 'knee'?"),
    (("joints",), {}, "joint 'knee' has no section"),
    (
        ("joints", "knee"),
        KNEE | {"side_a": "knee.a", "side_b": "knee.c"},
        "no surface named 'knee.c'; did you mean",
    ),
    (
        ("joints", "knee"),
        KNEE | {"side_a": "column_base", "side_b": "screw_foot"},
        "do not face each other",
    ),
    (
        ("joints", "knee"),
        KNEE | {"side_a": "column_base", "side_b": "knee.b"},
        "its sides do not face each other",
    ),
    (("probes", "a", "body"), "spindle", "probe 'a': no body named 'spindle'"),
    (("probes", "a", "position_mm"), [300.0, 600.0, 175.0], "lies in no cell of body 'column'"),
    (("probes", "a", "position_mm"), [0.575, 0.6, 9999.0], "outside the mesh"),
    (("probes", "a", "position_mm"), [700.0, 370.0, 100.0], "lies in no cell of body 'column'"),
    (("probes",), {}, "the case names no temperature probe"),
    (
        ("heat_input",),
        {"kind": "sampled", "file": "none.csv"},
        "none.csv: no such file; give a history",
    ),
    (
        ("candidates",),
        [{"body": "tabel", "low_mm": [0, 0, 0], "high_mm": [1, 1, 1], "spacing_mm": 1}],
        "candidates.body: no body named 'tabel'; did you mean 'table'?",
    ),
    (("supports", "springs"), {"feet": {"stiffness_N_um": [1, 1, 1]}}, "no surface named 'feet'"),
    (("held_temperatures",), {"foot": {"rise_K": 1.0}}, "no surface named 'foot'"),
    (("sources", "x"), {"body": "scre", "reference_power_W": 1.0}, "sources.x.body: no body named"),
    (("ambient",), {"file": "none.csv"}, "none.csv: no such file; give a history"),
]


@pytest.mark.parametrize(("place", "value", "message"), NAMES, ids=[name[2] for name in NAMES])
def test_what_the_structure_does_not_have_is_refused_in_one_line(edit, place, value, message):
    with pytest.raises(InputError) as caught:
        set_up(edit((place, value)))
    said = str(caught.value)
    assert message in said
    assert "\n" not in said


def test_a_machine_without_its_supports_is_refused(edit):
    with pytest.raises(
        InputError, match="supports: no support, spring or joint keeps body 'column'"
    ):
        set_up(edit((("supports",), {"fixed": []})))


def test_a_machine_that_only_its_column_holds_marches(edit):
    """The table hangs on the joint: the reference springs carry it into the condensation."""
    case = edit((("supports", "fixed"), ["column_base"]), (("march", "duration_min"), 0.5))
    response = simulate(case).response
    assert float(response["gap_residual"].max()) <= 1e-11
    held = float(np.abs(response["displacement"]).max())
    assert 0.0 < held < 1e-3


# --- what editing the case alone changes ---------------------------------------------------------


def power_in(case):
    """Heat per second that enters the whole machine at heat input 1, from the operators."""
    setup = set_up(case)
    return (
        setup.machine.thermal.inputs[:, 0].sum()
        * source_power(case.sources["bearings"])
        * setup.structure.symmetry_factor
    )


def test_reading_of_the_reference_power_is_the_cases(edit):
    per_source = edit((("sources", "bearings", "reading"), "per source"))
    total = edit((("sources", "bearings", "reading"), "total"))
    assert source_power(per_source.sources["bearings"]) == pytest.approx(590.0, rel=1e-12)
    assert source_power(total.sources["bearings"]) == pytest.approx(295.0, rel=1e-12)
    assert power_in(per_source) == pytest.approx(590.0, rel=1e-12)
    assert power_in(total) == pytest.approx(295.0, rel=1e-12)


def test_halving_the_power_halves_the_temperatures_at_first(edit):
    """In the first step the joint is at its preload whatever the power."""
    full, half = (
        simulate(edit((("sources", "bearings", "reading"), reading)))
        .response["temperature"]
        .to_numpy()
        for reading in ("per source", "total")
    )
    np.testing.assert_allclose(full[1], 2.0 * half[1], rtol=1e-9)
    assert np.abs(full[-1] / half[-1] - 2.0).max() > 1e-6


def test_source_surface_is_the_cases(edit, coarse_setup):
    elsewhere = set_up(edit((("sources", "bearings", "surface"), "screw_foot")))
    for setup, axis, plane in ((coarse_setup, 0, 0.55), (elsewhere, 1, 0.0)):
        heat = setup.machine.thermal.inputs[:, 0]
        off = np.abs(setup.spaces.heat.doflocs[axis] - plane) > 1e-6
        np.testing.assert_allclose(heat[off], 0.0, atol=1e-9)
    assert elsewhere.machine.thermal.inputs[:, 0].sum() == pytest.approx(0.5)


def test_friction_coefficient_is_the_cases(edit, coarse_case, coarse_setup):
    slippery = edit((("joints", "knee", "friction_coefficient"), 0.05))
    laws = set_up(slippery).machine.contact.laws
    assert [law.friction.coefficient for law, _ in laws] == [0.05]
    usual = simulate(coarse_case, setup=coarse_setup).response
    slid = simulate(slippery).response
    assert float(np.abs(slid["slip"]).max()) > float(np.abs(usual["slip"]).max())
    assert slid.attrs["friction"] == "0.05"


@pytest.mark.parametrize(
    ("conductance", "expected"),
    [
        ({"law": "cmy-1969"}, 18809.0),
        ({"law": "yovanovich-1982"}, 20072.0),
        ({"law": "cmy-exact"}, 19963.0),
        ({"law": "constants", "constant": 1.25, "exponent": 0.95}, 20072.0),
    ],
)
def test_conductance_constants_are_the_cases(edit, coarse_setup, conductance, expected):
    """At the preload, P/H = 2.2489e-3; references: 18806, 20069 and 19960 at 2.2485e-3."""
    case = edit((("joints", "knee", "conductance"), conductance))
    materials = body_materials(case, coarse_setup.structure)
    law = joint_law(case.joints["knee"], coarse_setup.structure, materials, coarse_setup.joints[0])
    assert law.conductance(np.array([4.41e6]))[0] == pytest.approx(expected, abs=2.0)


def test_normal_law_is_the_cases(edit, coarse_setup):
    measured = edit(
        (("joints", "knee", "normal_law"), "back-burdekin"),
        (("joints", "knee", "back_burdekin"), {"coefficient_um": 0.8, "exponent": 0.5}),
    )
    found = []
    for case in (edit(), measured):
        materials = body_materials(case, coarse_setup.structure)
        found.append(
            joint_law(
                case.joints["knee"], coarse_setup.structure, materials, coarse_setup.joints[0]
            ).normal
        )
    assert isinstance(found[0], SurfaceNormalLaw)
    assert isinstance(found[1], BackBurdekinLaw)
    # 0.8 um sqrt(4.41) closes it from touching to the preload.
    touching = found[1].pressure(np.array([0.8e-6 * 2.1 * (1.0 - 1e-9), 0.8e-6 * 2.1 * 1.001]))
    assert 0.0 < touching[0] < 1.0
    assert touching[1] == 0.0


def test_conductivity_of_the_joint_is_harmonic_between_its_bodies(edit, coarse_setup):
    case = edit(
        (("materials", "cast_iron", "conductivity_W_mK"), 47.0),
        (("materials", "screw", "conductivity_W_mK"), 10.0),
        (("bodies", "table"), "screw"),
    )
    laws = [
        joint_law(
            c.joints["knee"],
            coarse_setup.structure,
            body_materials(c, coarse_setup.structure),
            coarse_setup.joints[0],
        )
        for c in (case, edit())
    ]
    ratio = laws[0].conductance(np.array([1e6]))[0] / laws[1].conductance(np.array([1e6]))[0]
    assert ratio == pytest.approx(2.0 * 10.0 / (47.0 + 10.0), rel=1e-12)


def test_contact_elements_cover_the_strip(edit):
    setup = set_up(
        edit(
            (("joints", "knee", "along"), 4),
            (("joints", "knee", "across"), 2),
        )
    )
    (joint,) = setup.joints
    assert len(joint.area) == setup.machine.contact.count == 8
    assert joint.area.sum() == pytest.approx(0.40 * 0.075, rel=1e-12, abs=0.0)
    np.testing.assert_allclose(joint.area, joint.area.mean(), rtol=1e-9)


@pytest.mark.parametrize(
    ("heat_input", "times", "expected"),
    [
        ({"kind": "step", "level": 3.0}, [0.0, 60.0], [3.0, 3.0]),
        ({"kind": "ramp", "level": 2.0, "duration_min": 2.0}, [60.0, 120.0, 999.0], [1, 2, 2]),
        ({"kind": "triangle", "peak": 2.0, "duration_min": 10.0}, [150.0, 300.0, 600.0], [1, 2, 0]),
    ],
)
def test_minutes_of_the_heat_input_become_seconds(edit, heat_input, times, expected):
    history = heat_history(edit((("heat_input",), heat_input)).heat_input)
    np.testing.assert_allclose(history(np.array(times)), expected)


def test_dimensions_are_the_cases(edit):
    structure = build_structure(edit((("structure", "dimensions_mm"), {"column_height": 1250.0})))
    assert structure.mesh.p[1].max() == pytest.approx(1.25)


def test_probes_measure_what_the_field_is_where_they_are(coarse_setup):
    x, y, z = coarse_setup.spaces.heat.doflocs
    read = coarse_setup.probe_rows @ (1.0 + 2.0 * x - 3.0 * y + 4.0 * z)
    at = np.array([probe.position for probe in coarse_setup.probes.values()])
    np.testing.assert_allclose(read, 1.0 + at @ [2.0, -3.0, 4.0], atol=1e-9)


def test_candidates_are_the_lattice_points_inside_the_body(edit):
    section = {
        "body": "column",
        "low_mm": [500.0, 300.0, 100.0],
        "high_mm": [600.0, 400.0, 100.0],
        "spacing_mm": 50.0,
    }
    case = edit((("candidates",), [section]))
    found = candidate_probes(case, build_structure(case))
    # The wall spans x = 550 to 600; x = 500 is in the cavity.
    assert set(found) == {f"s{x}_{y}_100" for x in (550, 600) for y in (300, 350, 400)}
    assert found["s550_300_100"].position == pytest.approx((0.55, 0.3, 0.1))


def test_candidates_in_two_bodies_that_touch_are_those_of_both(edit):
    box = {"low_mm": [600.0, 400.0, 50.0], "high_mm": [650.0, 700.0, 100.0], "spacing_mm": 50.0}
    beyond = {"low_mm": [650.0, 400.0, 50.0], "high_mm": [700.0, 700.0, 100.0]}
    sections = [box | {"body": "column"}, box | beyond | {"body": "table"}]
    case = edit((("candidates",), sections))
    found = candidate_probes(case, build_structure(case))
    assert Counter(probe.body for probe in found.values()) == {"column": 28, "table": 28}
    assert {body_of_candidate(name) for name in found} == {"column", "table"}
    assert all(probe.body == body_of_candidate(name) for name, probe in found.items())
    assert body_of_candidate("s600_400_50") is None


def test_a_box_of_candidates_beside_its_body_is_refused(edit):
    box = {"body": "column", "low_mm": [9e3] * 3, "high_mm": [9.1e3] * 3, "spacing_mm": 50.0}
    case = edit((("candidates",), [box]))
    with pytest.raises(InputError, match="no lattice point of box 1 lies in body 'column'"):
        candidate_probes(case, build_structure(case))


# --- several sources, ambient, held surfaces, springs --------------------------------------------


def test_sources_add_up_each_by_its_own_history(edit, tmp_path):
    (tmp_path / "spindle.csv").write_text("time_s,heat_input\n0,0\n20,1\n")
    both = edit(
        (("sources", "drive"), {"body": "screw", "reference_power_W": 50.0}),
        (
            ("sources", "drive", "heat_input"),
            {"kind": "sampled", "file": str(tmp_path / "spindle.csv")},
        ),
        (("march", "duration_min"), 0.5),
    )
    response = simulate(both).response
    np.testing.assert_allclose(response["source_power"].sel(source="bearings")[1:], 590.0)
    np.testing.assert_allclose(
        response["source_power"].sel(source="drive")[[1, 5, 15]], [5, 25, 50]
    )
    assert float(np.abs(response["heat_balance"]).max()) < 1e-9
    np.testing.assert_allclose(
        response["heat_input"][1:], (590.0 + response["source_power"][1:, 1]) / 640.0
    )


def test_the_ambient_of_a_case_is_read_as_a_change(edit, tmp_path):
    (tmp_path / "air.csv").write_text("time_s,ambient_degC\n0,20\n10,25\n")
    case = edit(
        (("ambient",), {"file": str(tmp_path / "air.csv")}), (("march", "duration_min"), 0.5)
    )
    response = simulate(case).response
    np.testing.assert_allclose(response["ambient"][[0, 1, 5, 15]], [0.0, 1.0, 5.0, 5.0])
    assert float(np.abs(response["heat_balance"]).max()) < 1e-9


def test_stiff_springs_hold_like_a_support_and_soft_ones_give_way(edit):
    found = []
    for stiffness in (None, 1e9, 1.0):
        springs = {"column_base": {"stiffness_N_um": [stiffness] * 3}}
        supports = (
            {"fixed": ["column_base", "screw_foot"]}
            if stiffness is None
            else {"fixed": ["screw_foot"], "springs": springs}
        )
        setup = set_up(edit((("supports",), supports | {"symmetry": {"symmetry": "z"}})))
        found.append(setup.machine.contact.elastic.compliance)
    held, stiff, soft = found
    np.testing.assert_allclose(stiff, held, rtol=1e-3, atol=1e-4 * np.abs(held).max())
    assert np.linalg.eigvalsh(soft - held).min() > -1e-9 * np.abs(held).max()
    assert np.abs(soft - held).max() > 100.0 * np.abs(stiff - held).max()


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("sources", "bearings", "body"), "screw", "either 'surface' or 'body'"),
        (("held_temperatures",), {"screw_foot": {}}, "either 'rise_K' or 'file'"),
        (("sources",), {}, "nothing heats the structure"),
        (("heat_input",), None, "source 'bearings' has no heat input"),
    ],
)
def test_contradictions_are_refused(edit, place, value, message):
    with pytest.raises(InputError) as caught:
        edit((place, value))
    assert message in str(caught.value)


def test_a_set_up_of_another_step_is_refused(coarse_case, coarse_setup):
    """Its times would be those of the other step."""
    longer = coarse_case.march.model_copy(update={"step_s": 10.0})
    with pytest.raises(InputError, match="10 s, but the structure was set up for"):
        simulate(coarse_case.model_copy(update={"march": longer}), setup=coarse_setup)


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        ("joints.knee.preload_MPa", {"joints": {"knee": {"preload_MPa": 2.0}}}),
        (
            "materials.cast_iron.expansion_1_K",
            {"materials": {"cast_iron": {"expansion_1_K": 2e-5}}},
        ),
        ("convection_W_m2K.exterior", {"convection_W_m2K": {"exterior": 20.0}}),
        ("displacement.relative_to", {"displacement": {"relative_to": "c"}}),
        ("probes", {"probes": {"more": {"position_mm": [600.0, 1050.0, 250.0]}}}),
        ("march.thermal", {"march": {"thermal": "reduced"}}),
        ("supports.fixed", {"supports": {"fixed": []}}),
    ],
)
def test_a_set_up_of_another_case_is_refused(coarse_case, coarse_setup, key, changes):
    """It would be marched with what the set-up has."""
    with pytest.raises(InputError) as caught:
        simulate(coarse_case.replace(**changes), setup=coarse_setup)
    assert str(caught.value).startswith(f"{key}: the structure was set up for a case in which")


def test_a_shared_set_up_needs_the_ambient_that_radiation_names(coarse_data, tmp_path):
    (tmp_path / "hall.csv").write_text("time_s,ambient_degC\n0,35\n")
    radiated = {"exterior": {"emissivity": 0.9, "ambient_degC": 20.0}}
    case = case_from_data(coarse_data | {"radiation": radiated}, "case", tmp_path)
    hall = case_from_data(
        coarse_data | {"radiation": radiated, "ambient": {"file": "hall.csv"}}, "case", tmp_path
    )
    with pytest.raises(InputError, match="but ambient begins with 35"):
        simulate(hall, setup=set_up(case))


def test_more_contact_elements_in_all_than_memory_holds_are_refused(coarse_data):
    case = case_from_data(coarse_data, "case", Path())
    with pytest.raises(InputError, match="27 contact elements in all, and 26 at most") as caught:
        paired_joints(case, build_structure(case), most=26)
    assert "\n" not in str(caught.value)
