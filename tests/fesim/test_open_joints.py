"""Joints that start open, conductances beside Eq. 11, and rigid walls."""

import sys

import numpy as np
import pytest
from bars import two_bars
from boxes import boxes
from hypothesis import given, settings
from hypothesis import strategies as st
from repository import ROOT

from fesim.case.joint_sections import JointSection
from fesim.case.schema import case_from_data, read_case
from fesim.joint.compiled_gap import compile_gap
from fesim.joint.conductance import ConductanceTable
from fesim.joint.gap import gap_problem, solve_gap
from fesim.joint.law import JointLaw, evaluate, stiffness_at_rest
from fesim.joint.opening import TOUCHING
from fesim.setup.laws import law_of, read_conductance_table
from fesim.setup.parts import make_parts
from fesim.setup.structure import build_structure
from fesim.simulate import simulate
from meshes.exchange import read_structure, write_structure
from meshes.pairing import outward_areas, pair_joint
from meshes.wall import face_of, with_wall
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.verification.thermal_bar import METAL

ROD = ROOT / "examples" / "bistable_rod"
SURFACE = {"along": 1, "across": 1}
SURFACE |= {"roughness_um": 1.25, "asperity_slope": 0.14, "hardness_GPa": 1.961}
CLOSED = SURFACE | {"preload_MPa": 2.0, "friction_coefficient": 0.3}
OPEN = SURFACE | {
    "preload_MPa": 0.0,
    "initial_opening_um": 10.0,
    "reference_pressure_MPa": 2.0,
    "friction_coefficient": 0.3,
}
LAWS = [
    {},
    {"normal_law": "back-burdekin", "back_burdekin": {"coefficient_um": 0.6, "exponent": 0.5}},
]
PRESSURES = np.array([0.1e6, 1e6, 5e6, 20e6])


def open_law(extra, opening=10e-6):
    return law_of(JointSection(**OPEN | extra), np.full(1, 47.0), np.full(1, opening))


# --- openings ------------------------------------------------------------------------------------


@pytest.mark.parametrize("extra", LAWS)
@given(opening=st.floats(0.0, 5e-4))
def test_a_joint_presses_from_where_its_surfaces_touch(extra, opening):
    law = open_law(extra, opening)
    clear, touching, pressed = (
        float(law.normal.pressure(np.array([gap]))[0])
        for gap in (1e-6 - opening, -opening, -opening - 1e-6)
    )
    assert clear <= touching <= TOUCHING * 1.961e9 * (1.0 + 1e-6)
    assert pressed > touching
    assert law.preload == 0.0


@pytest.mark.parametrize("extra", LAWS)
def test_an_open_joint_closed_by_its_opening_is_the_preloaded_one(extra):
    """At the same distance of the surfaces the same law holds, whatever it was at the start."""
    closed = law_of(JointSection(**CLOSED | extra), np.full(1, 47.0))
    opened = open_law(extra)
    shift = float(opened.normal.shift[0])
    gap = np.array([[-shift + 0.1e-6], [0.2e-6], [0.0]])
    near = np.array([[0.1e-6], [0.2e-6], [0.0]])
    one, other = (
        evaluate(law, at, np.zeros((2, 1))) for law, at in ((closed, near), (opened, gap))
    )
    assert other.value[0] == pytest.approx(one.value[0] + closed.preload, rel=1e-9)
    np.testing.assert_allclose(other.value[1:], one.value[1:], rtol=1e-9)
    np.testing.assert_allclose(other.tangent, one.tangent, rtol=1e-9)


@pytest.mark.parametrize("extra", LAWS)
@settings(deadline=None, max_examples=20)
@given(
    closing=st.floats(-30e-6, 30e-6), slip=st.floats(-5e-6, 5e-6), opening=st.floats(1e-6, 30e-6)
)
def test_machine_code_and_plain_newton_close_a_gap_alike(extra, closing, slip, opening):
    law = open_law(extra, opening)
    laws: list[tuple[JointLaw, int]] = [(law, 1)]
    springs = stiffness_at_rest(laws)
    alone = np.array([2e-12, 1e-12, 1e-12])
    # As a condensation has it, with its springs across the gap.
    compliance = np.diag(alone / (1.0 + alone * springs))
    problem = gap_problem(
        compliance, np.ones(3), springs, springs, lambda gap, s: evaluate(law, gap, s)
    )
    compiled = compile_gap(problem, laws)
    start = np.zeros((3, 1))
    free = np.array([closing, slip, 0.0]) / (1.0 + alone * springs)
    plain = solve_gap(problem, free, np.zeros((2, 1)), start)
    found = compiled.solve(free, np.zeros((2, 1)), start)
    np.testing.assert_allclose(found.gap, plain.gap, atol=1e-12)
    pressure = float(found.traction.value[0, 0])
    # Equilibrium: what the heat closes, less what the pressure pushes back.
    assert found.gap[0, 0] == pytest.approx(closing + 2e-12 * pressure, abs=1e-11)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"preload_MPa": 1.0}, "are for a joint without preload"),
        ({"initial_opening_um": None}, "preload_MPa = 0 needs 'initial_opening_um'"),
        ({"initial_opening_um": -2.0}, "sides would overlap"),
        ({"reference_pressure_MPa": 2000.0}, "below half of the hardness"),
        ({"gap": {}}, "give 'gas_conductivity_W_mK', or both emissivities"),
        ({"gap": {"emissivity_a": 0.5}}, "radiation needs"),
        ({"conductance": {"law": "fixed"}}, "'value_W_m2K' goes with"),
        ({"conductance": {"law": "table"}}, "'file' goes with"),
    ],
)
def test_a_slip_about_gaps_is_one_line(change, message):
    data = _example()
    data["joints"]["tip"] |= change
    with pytest.raises(InputError, match=message) as refused:
        case_from_data(data, "case.toml", ROD)
    assert "\n" not in str(refused.value)


def _example():
    return read_case(ROD / "case.toml").model_dump(mode="json")


@pytest.mark.parametrize("apart", [30e-6, -30e-6])
def test_an_opening_from_the_mesh_is_the_meshs_own(tmp_path, apart):
    structure = two_bars()
    nodes = np.unique(structure.mesh.t[:, structure.bodies["right"]])
    structure.mesh.p[0, nodes] += apart
    del structure.probes["end"]
    write_structure(structure, tmp_path / "bars.vtu")
    case = case_from_data(_bars(initial_opening_um="mesh"), "bars", tmp_path)
    if apart < 0.0:
        with pytest.raises(InputError, match="overlap by 30 um in the mesh"):
            make_parts(case)
        return
    [(law, _)] = make_parts(case).laws
    np.testing.assert_allclose(law.normal.opening, apart, rtol=1e-6)


def test_a_body_that_only_an_open_joint_could_hold_is_refused(tmp_path):
    write_structure(two_bars(), tmp_path / "bars.vtu")
    data = _bars(initial_opening_um=5.0)
    data["supports"] = {"fixed": ["left_end"]}
    with pytest.raises(InputError, match="a joint that starts open holds nothing"):
        make_parts(case_from_data(data, "bars", tmp_path))


def lying(folder, opening, force):
    """Simulate a block that nothing holds, above a plate by an opening, um, under its weight."""
    structure = boxes(
        {"joint": ("plate.z1", "block.z0")},
        plate=((0.0, 0.0, -0.02), (0.1, 0.1, 0.0), (2, 2, 1)),
        block=((0.0, 0.0, 0.0), (0.1, 0.1, 0.04), (2, 2, 1)),
    )
    write_structure(structure, folder / "block.vtu")
    data = _bars(initial_opening_um=opening, reference_pressure_MPa=0.1, along=3, across=3)
    data |= {
        "structure": {"kind": "mesh", "file": "block.vtu"},
        "bodies": {"plate": "iron", "block": "iron"},
        "supports": {"fixed": ["plate.z0"]},
        "loads": {
            "weight": {"acceleration_m_s2": [0.0, 0.0, -9.81]},
            "force": {"surface": "block.z1", "force_N": force},
        },
        "held_temperatures": {},
        "march": {"step_s": 10.0, "duration_min": 1.0},
        "probes": {"tip": {"position_mm": [100.0, 100.0, 40.0], "body": "block"}},
        "displacement": {"point": "tip"},
    }
    return simulate(case_from_data(data, "block", folder), accuracy=False).response


def test_a_body_that_nothing_holds_falls_on_its_joint(tmp_path):
    """Six rigid motions, tilted by a side force: as from where it touches, but for the fall."""
    force = [-100.0, 50.0, -500.0]
    there, above = (lying(tmp_path, opening, force) for opening in (0.0, 50.0))
    moved = above["displacement"] + 50e-6 * np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(moved, there["displacement"], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(above["pressure"], there["pressure"], rtol=1e-5)
    assert np.ptp(there["pressure"][-1].to_numpy()) > 1e3


@pytest.mark.parametrize("force", [[0.0, 0.0, 100.0], [300.0, 0.0, -500.0]])
def test_a_body_that_its_loads_carry_away_is_refused(tmp_path, force):
    with pytest.raises(ConvergenceError, match=r"a body .*has come loose"):
        lying(tmp_path, 5.0, force)


def _bars(**joint):
    return {
        "title": "bars",
        "structure": {"kind": "mesh", "file": "bars.vtu"},
        "materials": {"iron": METAL | {"expansion_1_K": 13.7e-6}},
        "bodies": {"left": "iron", "right": "iron"},
        "joints": {"joint": OPEN | joint},
        "supports": {"symmetry": {"left_end": "x", "right_end": "x", "bottom": "y", "back": "z"}},
        "held_temperatures": {"left_end": {"rise_K": 40.0}, "right_end": {"rise_K": 0.0}},
        "march": {"step_s": 10.0, "duration_min": 20.0},
        "displacement": {"point": "left_face"},
        "probes": {"P": {"position_mm": [50.0, 30.0, 20.0], "body": "left"}},
    }


# --- conductances --------------------------------------------------------------------------------


def power_table(exponent, rises=(0.0,)):
    values = [1e4 * (1.0 + 0.01 * rise) * (PRESSURES / 1e6) ** exponent for rise in rises]
    return ConductanceTable(PRESSURES, np.array(rises), np.array(values))


@given(pressure=st.floats(1.0, 1e9), exponent=st.floats(0.1, 1.5))
def test_a_table_of_a_power_law_is_that_power_law_far_beyond_its_ends(pressure, exponent):
    found = power_table(exponent)(np.array([pressure]))[0]
    assert found == pytest.approx(1e4 * (pressure / 1e6) ** exponent, rel=1e-9)


@pytest.mark.parametrize("place", [*PRESSURES, 0.02e6, 90e6])
def test_a_table_has_a_continuous_slope_at_its_points_and_ends(place):
    table = ConductanceTable(PRESSURES, np.zeros(1), np.array([[2e3, 9e3, 1.5e4, 6e4]]))
    step = 1e-6 * place
    below, at, above = table(np.array([place - step, place, place + step]))
    assert (above - at) == pytest.approx(at - below, rel=1e-3)
    assert above > below


@pytest.mark.parametrize("rise", [-20.0, 0.0, 30.0, 80.0, 300.0])
def test_a_table_has_a_continuous_slope_in_temperature(rise):
    table = power_table(0.9, (0.0, 30.0, 80.0))
    step = 1e-3
    below, at, above = (
        float(table.at(np.array([1e6]), np.array([rise + shift]))[0]) for shift in (-step, 0, step)
    )
    assert (above - at) == pytest.approx(at - below, rel=1e-3, abs=1e-9 * at)
    # Beyond its ends it goes on by its last slope over one interval's width at most.
    assert 0.5e4 < at < 2.6e4


def test_a_table_passes_through_its_points_and_nothing_passes_without_pressure():
    table = power_table(0.9, (0.0, 30.0, 80.0))
    for k, rise in enumerate(table.rises):
        found = table.at(PRESSURES, np.full(4, rise))
        np.testing.assert_allclose(found, table.values[k], rtol=1e-12)
    assert float(table(np.zeros(1))[0]) < 1e-200


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("1,5000\n1,6000", "pressure_MPa must rise strictly"),
        ("2,5000\n1,6000", "pressure_MPa must rise strictly"),
        ("1,5000\n2,4000", "falls as pressure_MPa rises"),
        ("0,10\n2,4000", "all above 0"),
        ("1,5000", "two pressures or more"),
        ("1,-5\n2,5", "must be above 0"),
        ("1,x\n2,5", "'x' is not a number"),
        ("", "two pressures or more"),
    ],
)
def test_a_table_that_does_not_rise_is_one_line(tmp_path, rows, message):
    path = tmp_path / "table.csv"
    path.write_text(f"pressure_MPa,conductance_W_m2K\n{rows}\n")
    with pytest.raises(InputError, match=message) as refused:
        read_conductance_table(path)
    assert str(path) in str(refused.value)


def test_a_table_of_temperatures_is_read_and_used(tmp_path):
    """Bars through a joint whose h is table(p, T): the flow in the end is that of the table."""
    write_structure(two_bars(), tmp_path / "bars.vtu")
    rows = [
        f"{p},{rise},{2000.0 * p**0.9 * (1.0 + rise / 100.0)}"
        for rise in (0.0, 20.0, 60.0)
        for p in (0.5, 2.0, 50.0)
    ]
    text = "pressure_MPa,rise_K,conductance_W_m2K\n" + "\n".join(rows)
    (tmp_path / "table.csv").write_text(text)
    data = _bars()
    data["joints"]["joint"] = CLOSED | {"conductance": {"law": "table", "file": "table.csv"}}
    data["march"] |= {"step_s": 300.0, "duration_min": 300.0}
    ends = []
    for coupling in ("staggered", "iterated"):
        for thermal in ("full", "reduced"):
            data["march"] |= {"coupling": coupling, "thermal": thermal}
            ends.append(simulate(case_from_data(data, "bars", tmp_path)).response.isel(time=-1))
    table = read_conductance_table(tmp_path / "table.csv")
    for last in ends:
        flux = last["heat_flow"].item() / last["contact_area"].item()
        jump = flux / last["conductance"].item()
        warm = 40.0 - flux * 0.10 / 47.0 - 0.5 * jump
        expected = table.at(last["pressure"].to_numpy(), np.array([warm]))
        assert last["conductance"].item() == pytest.approx(expected[0], rel=1e-5)


# --- the bistable rod ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def states():
    sys.path.insert(0, str(ROD))
    import bistable_rod

    sys.path.pop(0)
    return bistable_rod.steady_states(bistable_rod.WALL)


@pytest.mark.parametrize(
    ("wall", "which"), [({"rise_K": 24.0}, 0), ({"file": "wall_was_hot.csv"}, 2)]
)
def test_the_history_of_the_wall_decides_where_the_rod_settles(states, wall, which):
    data = _example()
    data["held_temperatures"]["wall"] = wall
    response = simulate(case_from_data(data, "bistable rod", ROD)).response
    opening, pressure, end = states[which]
    assert response["temperature"][-1].item() == pytest.approx(end, rel=1e-9)
    assert response["opening"][-1].item() == pytest.approx(opening, rel=1e-9)
    assert response["pressure"][-1].item() == pytest.approx(pressure, rel=1e-6)
    assert np.abs(response["heat_balance"]).max().item() < 1e-9


# --- walls ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("tetrahedra", [False, True])
def test_a_wall_faces_its_surface_facet_by_facet(tetrahedra):
    structure = two_bars(tetrahedra=tetrahedra)
    walled = with_wall(structure, "wall", "right_end")
    mesh = walled.mesh
    own, face = structure.surfaces["right_end"], walled.surfaces[face_of("wall")]
    assert len(face) == len(own)
    area = outward_areas(mesh, face).sum(axis=0)
    np.testing.assert_allclose(area, -outward_areas(structure.mesh, own).sum(axis=0), atol=1e-15)
    # Its own nodes, right way up, and the other surfaces are where they were.
    assert not np.intersect1d(mesh.t[:, walled.bodies["wall"]], structure.mesh.t).size
    for name, facets in structure.surfaces.items():
        one, other = (
            m.p[:, m.facets[:, f]].mean()
            for m, f in ((structure.mesh, facets), (mesh, walled.surfaces[name]))
        )
        assert one == pytest.approx(other, rel=1e-12)
    assert mesh.boundary_facets().size == structure.mesh.boundary_facets().size + len(
        walled.surfaces["wall"]
    )
    walled.joints["foot"] = ("right_end", face_of("wall"))
    joint = pair_joint(walled, "foot", 2, 2)
    assert joint.area.sum() == pytest.approx(np.linalg.norm(area), rel=1e-9)


def test_no_heat_passes_a_wall_without_a_temperature():
    data = _example()
    del data["held_temperatures"]["wall"]
    data["held_temperatures"]["foot"]["rise_K"] = 30.0
    response = simulate(case_from_data(data, "rod", ROD)).response
    assert np.abs(response["heat_flow"]).max().item() < 1e-12
    # The rod is as warm as its foot and presses: nothing cools it.
    assert response["temperature"][-1].item() == pytest.approx(30.0, rel=1e-3)
    assert response["pressure"][-1].item() > 1e5


@pytest.mark.parametrize(
    ("walls", "message"),
    [
        ({"wall": {"faces": "wal_side"}}, "no surface named 'wal_side'"),
        ({"rod": {"faces": "wall_side"}}, "has that name already"),
    ],
)
def test_a_slip_about_walls_is_one_line(walls, message):
    with pytest.raises(InputError, match=message):
        build_structure(case_from_data(_example() | {"walls": walls}, "rod", ROD))


@pytest.mark.parametrize(
    "section",
    [
        {"sources": {"heat": {"body": "wall", "reference_power_W": 50.0}}},
        {"sources": {"heat": {"surface": "wall.face", "reference_power_W": 50.0}}},
        {"loads": {"weight": {"acceleration_m_s2": [0.0, 0.0, -9.81], "bodies": ["wall"]}}},
        {"loads": {"push": {"surface": "wall", "pressure_MPa": 1.0}}},
    ],
)
def test_heat_and_loads_on_a_wall_are_refused(section):
    """They did nothing."""
    heat = {"heat_input": {"kind": "step", "level": 1.0}}
    case = case_from_data(_example() | section | heat, "rod", ROD)
    with pytest.raises(InputError, match=r"'wall' is a rigid wall.* name what it faces"):
        make_parts(case)


@pytest.mark.parametrize(
    "place", [("joints", "tip", "side_b"), ("held_temperatures", "wall.face", "rise_K")]
)
def test_a_wall_has_no_other_name(place):
    """By that of its face an adiabatic wall took heat, and a warm one none."""
    data = _example()
    section, name, key = place
    data[section][name] = data[section].get(name, {}) | {
        key: "wall.face" if key == "side_b" else 3.0
    }
    with pytest.raises(
        InputError, match=r"'wall\.face' is the face of a wall; name the wall, 'wal"
    ):
        make_parts(case_from_data(data, "rod", ROD))


def test_the_rods_mesh_is_the_one_that_the_script_writes(states):
    from thermojoint.verification.bistable import rod

    kept = read_structure(ROD / "rod.vtu")
    np.testing.assert_allclose(kept.mesh.p, rod().mesh.p, atol=1e-12)
