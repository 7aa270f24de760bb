"""Bolts: condensed as assembled, as a preload, in time, what they hold, and refused where wrong."""

from unittest.mock import patch

import numpy as np
import pytest
from boxes import boxes
from scipy.sparse import diags_array

from fesim.batch.summary import figures_of
from fesim.case.identity import condensation_key, elasticity_key
from fesim.case.schema import case_from_data
from fesim.march import adaptive
from fesim.march.settling import at_rest, initial_state
from fesim.march.state_file import load_state, save_state
from fesim.setup.machine import set_up, with_laws
from fesim.setup.structure import body_materials
from fesim.simulate import simulate
from fesim.solid.elasticity import elastic_operators
from fesim.solid.spaces import cells_around
from fesim.solid.stress import stress_at, stress_rows, stress_tensors
from meshes.exchange import write_structure
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.verification.bolted import COLUMN, FORCE, STIFFNESS, bolted
from thermojoint.verification.loaded import AREA, WEIGHT, column_case, joint

TOUCHING = joint(preload_MPa=0.0, initial_opening_um=0.0, reference_pressure_MPa=8.0)
#: Two bolts beside each other, from the top into the lower half.
ENDS = {"head": [400.0, "upper"], "thread": [100.0, "lower"]}


def bolt(x_mm=25.0, **said):
    """An M12 bolt along z at y = 25 mm."""
    ends = {
        name: {"position_mm": [x_mm, 25.0, height], "diameter_mm": 10.0, "body": body}
        for name, (height, body) in ENDS.items()
    }
    return ends | {"force_kN": 12.0, "material": "iron", "diameter_mm": 12.0} | said


def machine(folder, **changes):
    """Two bars on a joint that two unlike bolts press, under heat, weight and a slanting force."""
    (folder / "push.csv").write_text("time_s,factor\n0,0.5\n100,1\n")
    push = {"surface": "top", "force_N": [300.0, 100.0, 2000.0], "file": "push.csv"}
    data = column_case(folder, True, {"loads": {"push": push, **WEIGHT}})
    data["materials"]["iron"]["poisson_ratio"] = 0.27
    data["joints"] = {"joint": TOUCHING}
    data["supports"] = {"fixed": ["foot"]}
    data["held_temperatures"] = {"foot": {"rise_K": 20.0}}
    data["bolts"] = {"left": bolt(12.0), "right": bolt(38.0, force_kN=9.0)}
    data["output"] = {"forces": True, "stress_probes": ["P"]}
    march = changes.pop("march", {})
    return case_from_data(data | changes | {"march": data["march"] | march}, "machine", folder)


@pytest.fixture(scope="module")
def marched(tmp_path_factory):
    """Case, set-up, steps and response of the full thermal model."""
    case = machine(tmp_path_factory.mktemp("bolted"), march={"thermal": "full"})
    setup, steps = set_up(case), []
    return case, setup, steps, simulate(case, setup=setup, on_step=steps.append).response


def test_a_bolt_condensed_is_a_bolt_assembled(marched):
    """Woodbury's formula against the stiffness with the bolts' own entries in it."""
    _, setup, _, _ = marched
    elastic = elastic_operators(setup.structure, setup.spaces, setup.materials, ["foot"], {})
    field, free = setup.field, elastic.free
    springs = setup.bolts.springs
    stretch = -setup.forces[:, len(setup.machine.assembly.factors) - 3 :].T
    gap = field.gap.toarray()[:, free]
    reference = setup.machine.contact.elastic.reference
    held = gap.T @ diags_array(field.area * reference) @ gap
    ties = stretch[:, free].T @ diags_array(1.0 / springs.flexibility) @ stretch[:, free]
    whole = elastic.stiffness[free][:, free].toarray() + held + ties
    compliance = gap @ np.linalg.solve(whole, gap.T)
    scale = np.abs(compliance).max()
    np.testing.assert_allclose(
        setup.machine.contact.elastic.compliance, compliance, atol=1e-9 * scale
    )
    pushed = springs.growth.T / springs.flexibility
    load = elastic.thermal_load[free].toarray() + stretch[:, free].T @ pushed.T
    opened = gap @ np.linalg.solve(whole, load)
    found = setup.machine.contact.elastic.thermal_gap
    np.testing.assert_allclose(found, opened, atol=1e-9 * np.abs(opened).max())


def test_bolts_are_tight_before_anything_acts(marched):
    """Without loads every bolt has its force, and the joint presses with all of them."""
    _, setup, _, _ = marched
    rest = at_rest(setup.machine)
    np.testing.assert_allclose(setup.bolt_forces(rest), [12e3, 9e3], rtol=1e-6)
    area = setup.machine.contact.elastic.area[: setup.machine.contact.count]
    assert rest.state.pressure @ area == pytest.approx(21e3, rel=1e-6)
    # The stronger bolt presses its side more.
    left = setup.joints[0].centre[:, 0] < 0.025
    assert rest.state.pressure[left].mean() > 1.05 * rest.state.pressure[~left].mean()
    # Displacement counts from there.
    assert np.abs(rest.displacement).max() < 1e-12
    assert np.abs(setup.displacement(rest)).max() < 1e-12


def test_the_whole_is_in_balance_with_bolts(marched):
    _, _, _, response = marched
    assert response["force_balance"].max().item() < 1e-7
    weight = 7200.0 * 9.81 * 0.2 * 0.05**2
    last = response.isel(time=-1)
    passed = last["joint_force"].sel(joint="joint", space="z")
    pulls = last["bolt_force"].sum()
    # The upper half: joint up, bolts down, weight down, push up.
    assert (passed - pulls - weight + 2000.0).item() == pytest.approx(0.0, abs=1e-3)


def test_the_full_field_ends_where_the_condensed_displacement_does(marched):
    """And its stress is that of the probe, tightening included."""
    case, setup, steps, response = marched
    structure = setup.structure
    top = np.flatnonzero(
        np.isclose(structure.mesh.p.T, structure.probes["top"].position).all(axis=1)
    )
    field = setup.displacement(steps[-1]).reshape(-1, 3)
    own = setup.spaces.elastic.nodal_dofs[0, top[0]]
    np.testing.assert_allclose(field[own], response["displacement"][-1], atol=1e-12)
    probe = structure.probes["P"]
    cells = cells_around(structure, probe)
    rows = stress_rows(
        structure,
        setup.spaces,
        body_materials(case, structure),
        np.tile(probe.position, (len(cells), 1)).T,
        cells,
    )
    rises = setup.nodal_temperature(steps[-1].state)
    found = stress_at(rows, setup.deformation(steps[-1]), rises).mean(axis=0)
    row = response["stress"].sel(stress_probe="P")[-1].to_numpy()
    np.testing.assert_allclose(stress_tensors(row), found, atol=1e-7 * np.abs(found).max())


def test_the_reduced_march_has_the_bolt_forces_of_the_full_one(tmp_path):
    one, other = (
        simulate(machine(tmp_path, march={"thermal": thermal, "coupling": "iterated"})).response
        for thermal in ("full", "reduced")
    )
    np.testing.assert_allclose(other["bolt_force"], one["bolt_force"], atol=2.0)
    np.testing.assert_allclose(other["displacement"], one["displacement"], atol=2e-9)


def test_a_bolt_without_stiffness_is_a_preload(tmp_path):
    """One that only pulls, on bars that it presses evenly: the same march by two ways."""
    even = {"head": {"surface": "top"}, "thread": {"surface": "foot"}, "material": "iron"}
    soft = even | {"force_kN": 2.5, "stiffness_N_um": 1e-7}
    at = joint(preload_MPa=0.0, initial_opening_um=0.0, reference_pressure_MPa=1.0)
    push = {"push": {"surface": "top", "force_N": [0.0, 0.0, 1500.0]}, **WEIGHT}
    heat = {"held_temperatures": {"foot": {"rise_K": 20.0}}}
    pressed = column_case(tmp_path, True, heat | {"loads": push, "joints": {"joint": at}})
    one = case_from_data(pressed | {"bolts": {"soft": soft}}, "c", tmp_path)
    given = pressed | {"joints": {"joint": joint(preload_MPa=1.0)}}
    bolted_one, preloaded = (
        simulate(case).response for case in (one, case_from_data(given, "c", tmp_path))
    )
    for name, size in {"displacement": 1e-11, "pressure": 1.0, "temperature": 1e-6}.items():
        np.testing.assert_allclose(bolted_one[name], preloaded[name], atol=size, err_msg=name)


def test_bolts_press_beside_a_preload(tmp_path):
    given = {"joints": {"joint": joint(preload_MPa=2.0)}}
    setup = set_up(case_from_data(bolted(tmp_path, True, given), "c", tmp_path))
    rest = at_rest(setup.machine)
    area = setup.machine.contact.elastic.area[: setup.machine.contact.count]
    assert rest.state.pressure @ area == pytest.approx(2e6 * AREA + FORCE, rel=1e-7)
    np.testing.assert_allclose(setup.bolt_forces(rest), [FORCE], rtol=1e-7)


def test_what_a_bolt_is_given_on_the_way_it_shares_with_what_it_clamps(tmp_path):
    """A nut turned on, or a seat that settles: F k_c/(k_b + k_c) of what held ends would give."""
    (tmp_path / "turned.csv").write_text("time_s,factor\n0,1\n30,1\n40,1.5\n80,0.25\n")
    data = bolted(tmp_path, False, {})
    data["bolts"]["bolt"] = data["bolts"]["bolt"] | {"file": "turned.csv"}
    found = simulate(case_from_data(data, "c", tmp_path)).response["bolt_force"][:, 0]
    share = COLUMN / (STIFFNESS + COLUMN)
    factor = np.array([1.0, 1.0, 1.5, 0.875, 0.25, 0.25, 0.25])
    np.testing.assert_allclose(found, FORCE * (1.0 + share * (factor - 1.0)), rtol=1e-9)


def test_a_bolt_that_would_have_to_push_has_come_loose(tmp_path):
    data = bolted(tmp_path, False, {})
    push = {"surface": "top", "force_N": [0.0, 0.0, -1.1 * FORCE * (1.0 + COLUMN / STIFFNESS)]}
    (tmp_path / "late.csv").write_text("time_s,factor\n0,0\n40,0\n60,1\n")
    data["loads"] = {"push": push | {"file": "late.csv"}}
    with pytest.raises(ConvergenceError, match=r"t = 60 s: bolt 'bolt' has come loose"):
        simulate(case_from_data(data, "c", tmp_path))


@pytest.mark.parametrize("plainly", [False, True])
def test_adaptive_steps_notice_a_bolt_that_is_loose_between_two_rows(tmp_path, plainly):
    data = bolted(tmp_path, False, {})
    push = {"surface": "top", "force_N": [0.0, 0.0, -1.1 * FORCE * (1.0 + COLUMN / STIFFNESS)]}
    (tmp_path / "pulse.csv").write_text("time_s,factor\n0,0\n130,0\n140,1\n150,0\n")
    data["loads"] = {"push": push | {"file": "pulse.csv"}}
    data["march"] = {"step_s": 100.0, "duration_min": 5.0, "method": "adaptive"}
    by = {"return_value": None} if plainly else {"wraps": adaptive._compiled}
    with (
        patch.object(adaptive, "_compiled", **by),
        pytest.raises(ConvergenceError, match=r"t = 1[34]\d.*: bolt 'bolt' has come loose"),
    ):
        simulate(case_from_data(data, "c", tmp_path))
    before = data | {"march": data["march"] | {"step_s": 10.0, "duration_min": 2.0}}
    assert simulate(case_from_data(before, "c", tmp_path)).response.sizes["time"] == 13


def test_a_bolt_holds_a_body_along_its_axis(tmp_path):
    """The upper half hangs on nothing else: its joint starts open, and the bolt closes it."""
    apart = joint(preload_MPa=0.0, initial_opening_um=5.0, reference_pressure_MPa=4.0)
    hung = column_case(tmp_path, True, {"loads": WEIGHT, "joints": {"joint": apart}})
    warm = hung | {"loads": {}, "initial_temperature": {"rise_K": 1.0}}
    with pytest.raises(InputError, match="keeps body 'upper' from moving along z"):
        set_up(case_from_data(warm, "c", tmp_path))
    ends = {"head": {"surface": "top"}, "thread": {"surface": "foot"}}
    one = ends | {"force_kN": 10.0, "material": "iron", "diameter_mm": 12.0}
    response = simulate(case_from_data(hung | {"bolts": {"one": one}}, "c", tmp_path)).response
    first = response.isel(time=0)
    weight = 7200.0 * 9.81 * 0.2 * AREA
    pressed = (first["pressure"] @ first["contact_area"]).item()
    assert pressed == pytest.approx(first["bolt_force"][0].item() + weight, rel=1e-6)
    assert first["bolt_force"][0].item() == pytest.approx(10e3, rel=1e-3)


def test_forces_are_given_anew_without_another_condensation(marched, tmp_path):
    case, setup, _, _ = marched
    bolts = case.bolts | {"left": case.bolts["left"].model_copy(update={"force_kN": 15.0})}
    other = case.model_copy(update={"bolts": bolts})
    assert condensation_key(other) == condensation_key(case)
    again = with_laws(setup, other)
    found, expected = (simulate(other, setup=one).response for one in (again, set_up(other)))
    np.testing.assert_allclose(found["bolt_force"], expected["bolt_force"], rtol=1e-9)
    np.testing.assert_allclose(found["displacement"], expected["displacement"], atol=1e-14)
    with pytest.raises(InputError, match=r"bolts: .* set it up for this case"):
        simulate(other, setup=setup)


def test_what_a_bolt_is_splits_condensations_but_keeps_the_elastic_one(marched):
    case, _, _, _ = marched
    thick = case.bolts | {"left": case.bolts["left"].model_copy(update={"diameter_mm": 16.0})}
    other = case.model_copy(update={"bolts": thick})
    assert condensation_key(other) != condensation_key(case)
    assert elasticity_key(other) == elasticity_key(case)
    moved = case.model_copy(update={"bolts": {"left": case.bolts["left"]}})
    assert elasticity_key(moved) != elasticity_key(case)


def test_a_march_with_bolts_goes_on_where_it_was_saved(marched, tmp_path):
    case, setup, _, whole = marched
    half = case.model_copy(update={"march": case.march.model_copy(update={"duration_min": 1.0})})
    save_state(simulate(half, setup=setup).state, half, tmp_path / "half.npz")
    start = load_state(tmp_path / "half.npz", case)
    rest = simulate(case, setup=setup, start=start).response
    np.testing.assert_array_equal(rest["bolt_force"], whole["bolt_force"][-rest.sizes["time"] :])


def test_a_march_starts_from_the_tightened_state(marched):
    _, setup, _, _ = marched
    assembly = setup.machine.assembly
    state = initial_state(setup.machine)
    np.testing.assert_array_equal(state.gap, assembly.gap)
    np.testing.assert_array_equal(state.slip, assembly.slip)


def test_a_summary_has_the_range_of_the_bolt_forces(marched):
    _, _, _, response = marched
    figures = figures_of(response)
    assert figures["bolt_force_min_N"] == response["bolt_force"].min().item()
    assert figures["bolt_force_max_N"] == response["bolt_force"].max().item()


CUT = {
    "discs": {
        "head": {"position_mm": [25.0, 0.0, 80.0], "diameter_mm": 24.0, "body": "upper"},
        "thread": {"position_mm": [25.0, 0.0, 10.0], "diameter_mm": 8.0, "body": "lower"},
    },
    "surfaces": {"head": {"surface": "upper.z1"}, "thread": {"surface": "lower.z0"}},
}


@pytest.mark.parametrize("ends", CUT.values(), ids=CUT)
def test_a_bolt_cut_by_a_symmetry_plane_is_half_of_the_whole_one(ends, tmp_path):
    """Also if its ends are of unlike size, so that the middles of their halves are, too."""
    responses = []
    for copies in (1, 2):
        back = {"lower": -0.03, "upper": -0.02} if copies == 1 else {"lower": 0.0, "upper": 0.0}
        count = 4 // copies
        structure = boxes(
            {"joint": ("upper.z0", "lower.z1")},
            lower=((0.0, back["lower"], 0.0), (0.06, 0.03, 0.04), (2, count, 2)),
            upper=((0.0, back["upper"], 0.04), (0.06, 0.02, 0.08), (2, count, 2)),
        )
        write_structure(structure, tmp_path / f"{copies}.vtu")
        data = column_case(tmp_path, True, {"joints": {"joint": TOUCHING | {"across": count}}})
        data["structure"] |= {"file": f"{copies}.vtu", "symmetry_factor": copies}
        data["supports"] = {"springs": {"lower.z0": {"stiffness_N_um": [100.0, 100.0, 500.0]}}}
        if copies == 2:
            data["supports"]["symmetry"] = {"lower.y0": "y", "upper.y0": "y"}
        shares = {"force_kN": 20.0 / copies, "stiffness_N_um": 300.0 / copies}
        data["bolts"] = {"b": ends | shares | {"material": "iron"}}
        data["sources"] = {"s": {"surface": "upper.x1", "reference_power_W": 200.0}}
        data["heat_input"] = {"kind": "step", "level": 1.0}
        data["probes"] = {"top": {"position_mm": [60.0, 0.0, 80.0], "body": "upper"}}
        case = case_from_data(data, "halves", tmp_path)
        responses.append(simulate(case, accuracy=False).response)
    whole, half = responses
    np.testing.assert_allclose(2.0 * half["bolt_force"], whole["bolt_force"], rtol=1e-6)
    moved = np.abs(whole["displacement"]).max()
    np.testing.assert_allclose(half["displacement"], whole["displacement"], atol=1e-6 * moved)
    pressed = np.sort(whole["pressure"])[:, ::2]
    np.testing.assert_allclose(np.sort(half["pressure"]), pressed, rtol=1e-6)


WRONG = {
    "surface": ({"head": {"surface": "tip"}}, r"bolts.b.head.surface: no surface named 'tip'"),
    "body": (
        {"head": {"position_mm": [25, 25, 400], "diameter_mm": 10, "body": "uper"}},
        r"bolts.b.head.body: no body named 'uper'",
    ),
    "outside": (
        {"head": {"position_mm": [25, 25, 500], "diameter_mm": 10, "body": "upper"}},
        r"bolts.b.head: the disc around .* lies in no cell of body 'upper'",
    ),
    "material": ({"material": "steal"}, r"bolts.b.material: no material named 'steal'"),
    "place": ({"thread": {"surface": "top"}, "head": {"surface": "top"}}, "coincide"),
    "history": ({"file": "zero.csv"}, r"bolts.b: its factor is not positive at the start"),
    "force": ({"force_kN": -1.0}, r"bolts.b.force_kN"),
    "length": ({"clamped_length_mm": 0.0}, r"bolts.b.clamped_length_mm"),
    "stiffness": ({"stiffness_N_um": 10.0}, "give either 'diameter_mm' or 'stiffness_N_um'"),
    "disc": ({"head": {"position_mm": [25, 25, 400]}}, "go with 'position_mm', both of them"),
    "nowhere": ({"head": {}}, "give either 'surface' or 'position_mm'"),
    "key": ({"torque_Nm": 10.0}, r"bolts.b: no key named 'torque_Nm'"),
}


@pytest.mark.parametrize(("said", "message"), WRONG.values(), ids=WRONG)
def test_a_bolt_that_cannot_be_is_one_line(tmp_path, said, message):
    (tmp_path / "zero.csv").write_text("time_s,factor\n0,0\n10,1\n")
    data = column_case(tmp_path, True, {"joints": {"joint": TOUCHING}})
    data["bolts"] = {"b": bolt() | said}
    with pytest.raises(InputError, match=message) as raised:
        set_up(case_from_data(data, "c", tmp_path))
    assert "\n" not in str(raised.value)
