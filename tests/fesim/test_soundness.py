"""What would end in a wrong answer is refused before or in the march, in one line."""

import copy
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from boxes import boxes
from skfem import MeshHex

from fesim.batch.summary import figures_of
from fesim.batch.worker import Task
from fesim.batch.worker import run as run_task
from fesim.case.identity import case_id, condensation_key
from fesim.case.schema import case_from_data
from fesim.march.state_file import load_state, save_state
from fesim.setup.machine import set_up, with_laws
from fesim.setup.soundness import suspicions
from fesim.simulate import simulate
from meshes.exchange import write_structure
from meshes.faces import rows_in
from meshes.inspection import inspect, pieces
from meshes.structure import Probe, Structure
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.paper.summary import result_lines, rocking_lines
from thermojoint.reduced.machine import diagonal_modes, reduce_machine
from thermojoint.reduced.physics import make_physics, simulate_known

JOINT = {
    "side_a": "low.z1",
    "side_b": "high.z0",
    "preload_MPa": 1.0,
    "along": 1,
    "across": 1,
    "roughness_um": 1.25,
    "asperity_slope": 0.14,
    "hardness_GPa": 2.0,
    "friction_coefficient": 0.0,
}
SIDE = 0.02
LOW = ((0.0, 0.0, 0.0), (SIDE, SIDE, SIDE))
HIGH = ((0.0, 0.0, SIDE), (SIDE, SIDE, 2 * SIDE))
DATA = {
    "title": "two boxes",
    "structure": {"kind": "mesh", "file": "boxes.vtu"},
    "materials": {
        "steel": {
            "conductivity_W_mK": 45.0,
            "density_kg_m3": 7850.0,
            "heat_capacity_J_kgK": 470.0,
            "youngs_modulus_GPa": 206.0,
            "poisson_ratio": 0.3,
            "expansion_1_K": 12e-6,
        }
    },
    "bodies": {"low": "steel", "high": "steel"},
    "joints": {"j": JOINT},
    "supports": {"fixed": ["low.z0", "high.z1"]},
    "sources": {"s": {"body": "low", "reference_power_W": 10.0}},
    "heat_input": {"kind": "step", "level": 1.0},
    "march": {"step_s": 10.0, "duration_min": 1.0, "thermal": "full"},
    "displacement": {"point": "p"},
    "probes": {"p": {"position_mm": [10.0, 10.0, 10.0], "body": "low"}},
}


@pytest.fixture
def data():
    return copy.deepcopy(DATA)


def run(folder, data, structure=None):
    """Simulate a case on two boxes, or on the structure given."""
    if structure is None:
        structure = boxes({}, low=LOW, high=HIGH)
    write_structure(structure, folder / "boxes.vtu")
    return simulate(case_from_data(data, "case", Path(folder))).response


@pytest.mark.parametrize("of_the_mesh", [False, True])
def test_a_point_on_a_joint_must_say_which_body_it_means(tmp_path, data, of_the_mesh):
    structure = boxes({}, low=LOW, high=HIGH)
    on_the_joint = (0.01, 0.01, SIDE)
    if of_the_mesh:
        structure = replace(structure, probes={"at": Probe(on_the_joint)})
    else:
        data["probes"]["at"] = {"position_mm": [1e3 * x for x in on_the_joint]}
    data["displacement"] = {"point": "at"}
    with pytest.raises(InputError, match=r"'at' .* lies in 'low' and in 'high'.*say which"):
        run(tmp_path, data, structure)


def test_two_joints_on_the_same_faces_are_refused(tmp_path, data):
    data["joints"]["again"] = JOINT
    with pytest.raises(InputError, match="'j' and 'again' cover the same 8 cm2"):
        run(tmp_path, data)


@pytest.mark.filterwarnings("ignore:bodies 'high' and 'other' face each other")
def test_two_pads_on_one_face_are_no_joints_on_the_same_face(tmp_path, data):
    half = SIDE / 2
    structure = boxes(
        {},
        low=LOW,
        high=((0.0, 0.0, SIDE), (half, SIDE, 2 * SIDE)),
        other=((half, 0.0, SIDE), (SIDE, SIDE, 2 * SIDE)),
    )
    data["bodies"]["other"] = "steel"
    data["joints"]["k"] = JOINT | {"side_b": "other.z0"}
    data["supports"]["fixed"].append("other.z1")
    run(tmp_path, data, structure)


@pytest.mark.parametrize(
    ("key", "section"),
    [
        ("convection_W_m2K", 10.0),
        ("radiation", {"emissivity": 0.9, "ambient_degC": 20.0}),
    ],
)
def test_surfaces_that_overlap_may_not_both_exchange_heat(tmp_path, data, key, section):
    structure = boxes({}, low=LOW, high=HIGH)
    both = np.concatenate([structure.surfaces["low.x0"], structure.surfaces["low.x1"]])
    structure = replace(structure, surfaces=structure.surfaces | {"sides": both})
    data[key] = {"sides": section, "low.x0": section}
    with pytest.raises(InputError, match=rf"{key}: surfaces 'sides' and 'low.x0' share 4 cm2"):
        run(tmp_path, data, structure)
    # Nor one of them to the air of a cavity.
    data |= {key: {"sides": section}}
    data["cavities"] = {"air": {"surfaces": ["low.x0"], "film_W_m2K": 3.0}}
    with pytest.raises(InputError, match=r"cavities: surfaces 'low.x0' and 'sides' share 4 cm2"):
        run(tmp_path, data, structure)


def test_a_preloaded_joint_whose_sides_are_far_apart_is_refused(tmp_path, data):
    apart = boxes({}, low=LOW, high=((0.0, 0.0, 0.03), (SIDE, SIDE, 0.05)))
    with pytest.raises(InputError, match="'j': its sides are 10 to 10 mm apart"):
        run(tmp_path, data, apart)


def cracked():
    """Two boxes, the lower one of two layers that touch without a common node."""
    whole = boxes({}, low=LOW, high=HIGH)
    mesh, cells = whole.mesh, whole.bodies["low"]
    top = cells[mesh.p[2, mesh.t[:, cells]].mean(axis=0) > SIDE / 2]
    nodes = np.unique(mesh.t[:, top])
    corners = mesh.t.copy()
    renamed = np.full(mesh.p.shape[1], -1)
    renamed[nodes] = mesh.p.shape[1] + np.arange(nodes.size)
    corners[:, top] = renamed[corners[:, top]]
    points = np.hstack([mesh.p, mesh.p[:, nodes]])
    used, corners = np.unique(corners, return_inverse=True)
    split = MeshHex(points[:, used], corners.reshape(mesh.t.shape))
    facets = split.boundary_facets()
    centre = split.p[:, split.facets[:, facets]].mean(axis=1)
    ends = {"low.z0": 0.0, "high.z1": 2 * SIDE}
    surfaces = {name: facets[np.abs(centre[2] - z) < 1e-9] for name, z in ends.items()}
    joint = facets[np.abs(centre[2] - SIDE) < 1e-9]
    of_low = np.isin(split.f2t[0, joint], cells)
    surfaces |= {"low.z1": joint[of_low], "high.z0": joint[~of_low]}
    return replace(whole, mesh=split, surfaces=surfaces)


def test_a_body_whose_nodes_were_not_merged_is_refused(tmp_path, data):
    structure = cracked()
    assert inspect(structure).bodies["low"].pieces == 2
    with pytest.raises(InputError, match=r"body 'low' is in 2 pieces .* merge the nodes"):
        run(tmp_path, data, structure)


def test_a_body_of_pieces_whose_meshes_do_not_match_is_refused(tmp_path, data):
    """No node of one is at a node of the other, and each has its own support."""
    top = ((0.15 * SIDE, 0.15 * SIDE, SIDE), (0.85 * SIDE, 0.85 * SIDE, 2 * SIDE), (3, 3, 2))
    pieces = boxes({}, low=LOW, high=top)
    del data["bodies"]["high"], data["joints"]
    data["sources"]["s"]["body"] = "low"
    one = replace(pieces, bodies={"low": np.arange(pieces.mesh.nelements)})
    with pytest.raises(InputError, match=r"body 'low' is in 2 pieces .* merge the nodes"):
        run(tmp_path, data, one)


def test_a_seam_within_a_body_is_said(tmp_path, data):
    """Two columns on one foot that stand side by side without common nodes above it."""
    half, top = SIDE / 2, 2 * SIDE
    columns = {"left": (0.0, half), "right": (half, SIDE)}
    parts = boxes(
        {},
        low=LOW,
        **{name: ((a, 0.0, SIDE), (b, SIDE, top), (1, 2, 2)) for name, (a, b) in columns.items()},
    )
    mesh = parts.mesh
    above = (mesh.p[0] > half - 1e-9) & np.isin(
        np.arange(mesh.p.shape[1]), mesh.t[:, parts.bodies["right"]]
    )
    places = np.vstack([mesh.p, above & (mesh.p[2] > SIDE + 1e-9)]).round(9)
    _, kept, number = np.unique(places, axis=1, return_index=True, return_inverse=True)
    glued = MeshHex(mesh.p[:, kept], number.ravel()[mesh.t])
    foot = rows_in(glued.facets.T, number.ravel()[mesh.facets[:, parts.surfaces["low.z0"]]].T)
    one = replace(
        parts,
        mesh=glued,
        surfaces={"low.z0": foot},
        bodies={"low": np.arange(glued.nelements)},
    )
    write_structure(one, tmp_path / "boxes.vtu")
    del data["bodies"]["high"], data["joints"]
    data["supports"]["fixed"] = ["low.z0"]
    data["sources"]["s"]["body"] = "low"
    said = "body 'low' has 6 pairs of nodes at one place"
    assert any(said in line for line in inspect(one).warnings)
    with pytest.warns(UserWarning, match=said):
        set_up(case_from_data(data, "case", tmp_path))


def test_parts_of_a_body_that_meet_in_an_edge_only_are_said():
    """Two of the four quarters of a block, across from each other."""
    quarters = np.linspace(0.0, SIDE, 5)
    block = MeshHex.init_tensor(quarters, quarters, quarters)
    x, y, _ = block.p[:, block.t].mean(axis=1)
    mesh = block.restrict(np.flatnonzero((x < SIDE / 2) == (y < SIDE / 2)))
    one = Structure(mesh, {"block": np.arange(mesh.nelements)}, {}, {}, {})
    said = "parts of body 'block' meet in an edge or corner only, at (0.01, 0.01, "
    assert any(said in line for line in inspect(one).warnings)
    assert any(said in line for line in suspicions(one, []))


def test_cells_that_share_a_node_are_one_piece():
    chain = np.array([[0, 1], [1, 2], [5, 6], [2, 9]]).T
    assert pieces(chain).tolist() == [0, 0, 1, 0]


def test_a_joint_pressed_beyond_half_of_its_hardness_is_refused(tmp_path, data):
    data["joints"]["j"]["hardness_GPa"] = 0.1
    data["initial_temperature"] = {"rise_K": 100.0}
    with pytest.raises(ConvergenceError, match="'j': the pressure passes 50 MPa, half of its hard"):
        run(tmp_path, data)


def cooled_rod(data, **march):
    """A rod that a cold wall draws from its joint: staggered steps of a minute alternate."""
    data["materials"]["steel"] |= {"poisson_ratio": 0.0, "youngs_modulus_GPa": 104.0}
    data["joints"]["j"]["preload_MPa"] = 5.0
    data["held_temperatures"] = {"low.z0": {"rise_K": 0.0}, "high.z1": {"rise_K": -20.0}}
    data["march"] = {"step_s": 60.0, "duration_min": 15.0} | march
    return boxes(
        {}, low=((0.0, 0.0, 0.0), (SIDE, SIDE, 0.1)), high=((0, 0, 0.1), (SIDE, SIDE, 0.102))
    )


@pytest.mark.parametrize("thermal", ["full", "reduced"])
def test_steps_that_alternate_are_iterated_and_it_is_said(tmp_path, data, thermal):
    rod = cooled_rod(data, thermal=thermal)
    found = run(tmp_path, data, rod)
    data["march"]["coupling"] = "iterated"
    settled = run(tmp_path, data, rod)
    np.testing.assert_allclose(found["pressure"][-5:], settled["pressure"][-5:], rtol=1e-3)
    assert found["taken_over"][-9:].all()
    assert not settled["taken_over"].any()
    figures = figures_of(found)
    assert figures["taken_over"] >= 9
    assert f"{figures['taken_over']} steps" in result_lines(found, figures)[-1]


def test_steps_that_open_and_close_the_joint_in_turn_are_iterated(tmp_path, data):
    """The bodies must warm up before it closes: a period of four steps, without gain over one."""
    rod = cooled_rod(data, thermal="reduced", step_s=240.0, duration_min=120.0)
    data["held_temperatures"]["high.z1"]["rise_K"] = -100.0
    found = run(tmp_path, data, rod)
    data["march"]["coupling"] = "iterated"
    settled = run(tmp_path, data, rod)
    assert found["taken_over"][-9:].all()
    np.testing.assert_allclose(found["pressure"][-5:], settled["pressure"][-5:], rtol=1e-3)


@pytest.mark.parametrize(("step_s", "rise_K"), [(120.0, -20.0), (240.0, -60.0)], ids=["2", "3"])
def test_known_inputs_are_marched_by_halves_where_steps_oscillate(tmp_path, data, step_s, rise_K):
    """The joint-aware model's march, against the simulator; periods of two and of three steps."""
    rod = cooled_rod(data, thermal="reduced", step_s=step_s, duration_min=24.0 * step_s / 60.0)
    data["held_temperatures"]["high.z1"]["rise_K"] = rise_K
    write_structure(rod, tmp_path / "boxes.vtu")
    case = case_from_data(data, "case", tmp_path)
    setup = set_up(case)
    machine = reduce_machine(case, setup, ("p",))
    held = machine.at_preload
    physics = make_physics(diagonal_modes(machine, held), machine.joints, held)
    response = simulate(case, setup=setup, accuracy=False).response
    inputs = np.tile([*machine.power, 0.0, rise_K, 0.0], (response.sizes["time"] - 1, 1))
    _, moved = simulate_known(physics, inputs, case.march.step_s)
    assert response["taken_over"].any()
    expected = response["displacement"][-1]
    np.testing.assert_allclose(moved[-1], expected, rtol=1e-3, atol=1e-12)


def test_a_march_goes_on_in_the_middle_of_alternating(tmp_path, data):
    write_structure(cooled_rod(data), tmp_path / "boxes.vtu")

    def lasting(minutes):
        march = data["march"] | {"duration_min": minutes}
        return case_from_data(data | {"march": march}, "case", tmp_path)

    whole = lasting(9.0)
    expected = simulate(whole)
    assert expected.response["taken_over"].any()
    for minutes in (4.0, 5.0, 6.0, 7.0):
        early = lasting(minutes)
        save_state(simulate(early).state, early, tmp_path / "state.npz")
        rest = simulate(whole, start=load_state(tmp_path / "state.npz", whole)).response
        for name in ("pressure", "displacement", "taken_over"):
            same = expected.response[name][-rest.sizes["time"] :]
            np.testing.assert_array_equal(rest[name], same, err_msg=f"{name}, {minutes} min")


def test_heat_that_alternates_is_no_coupling_that_does(tmp_path, data):
    rows = [f"{10 * k},{10 * (k % 2)}" for k in range(20)]
    (tmp_path / "heat.csv").write_text("\n".join(["time_s,heat_input", *rows]))
    data["heat_input"] = {"kind": "sampled", "file": "heat.csv"}
    data["march"]["duration_min"] = 3.0
    found = run(tmp_path, data)
    moves = np.diff(found["pressure"].to_numpy()[:, 0])
    assert (moves[2:] * moves[1:-1] < 0.0).any()
    assert not found["taken_over"].any()
    assert figures_of(found)["unresolved_steps"] == 0


def test_steps_too_long_for_an_oscillation_are_said(tmp_path, data):
    """Dissimilar rods whose pressure oscillates by itself, every 140 s (Barber and Zhang 1988)."""
    light = {"conductivity_W_mK": 200.0, "density_kg_m3": 2700.0, "heat_capacity_J_kgK": 900.0}
    light |= {"youngs_modulus_GPa": 70.0, "poisson_ratio": 0.0, "expansion_1_K": 23e-6}
    data["materials"] |= {"aluminium": light}
    data["materials"]["steel"]["poisson_ratio"] = 0.0
    data["bodies"]["high"] = "aluminium"
    squared = {"law": "constants", "constant": 97.0, "exponent": 2.0}
    law = {"normal_law": "back-burdekin", "back_burdekin": {"coefficient_um": 3.0, "exponent": 0.5}}
    data["joints"]["j"] |= {"preload_MPa": 9.5, "conductance": squared} | law
    data["held_temperatures"] = {"low.z0": {"rise_K": 100.0}, "high.z1": {"rise_K": -47.0}}
    data["heat_input"]["level"] = 0.0
    rods = boxes({}, low=((0, 0, 0), (SIDE, SIDE, 0.06)), high=((0, 0, 0.06), (SIDE, SIDE, 0.13)))

    def marched(step_s):
        data["march"] = {"step_s": step_s, "duration_min": 21.0, "coupling": "iterated"}
        return run(tmp_path, data, rods)

    coarse, fine = marched(35.0), marched(7.0)
    assert figures_of(coarse)["unresolved_steps"] > 18
    assert "from 105 to 1260 s pressures" in "".join(result_lines(coarse, figures_of(coarse)))
    assert figures_of(fine)["unresolved_steps"] == 0
    later = [one["pressure"].sel(time=slice(600.0, None)) for one in (coarse, fine)]
    swings = [float(one.max() - one.min()) for one in later]
    assert swings[1] > swings[0]


def test_no_heat_is_lost_between_steps(tmp_path, data):
    (tmp_path / "heat.csv").write_text("time_s,heat_input\n0,0\n65,0\n66,1\n85,1\n86,0\n")
    data["heat_input"] = {"kind": "sampled", "file": "heat.csv"}
    data["march"] |= {"step_s": 60.0, "duration_min": 5.0}
    found = run(tmp_path, data)
    assert float(60.0 * found["source_power"].sum()) == pytest.approx(200.0)
    assert float(found["temperature"].max()) > 1.0


def test_a_load_that_comes_and_goes_between_steps_leaves_its_slip(tmp_path, data):
    (tmp_path / "load.csv").write_text("time_s,factor\n0,0\n65,0\n66,1\n95,1\n96,0\n")
    del data["sources"], data["heat_input"]
    friction = {"friction_coefficient": 0.3, "preload_MPa": 2.0}
    data["joints"]["j"] |= friction | {"along": 2, "across": 2}
    springs = {"high.z1": {"stiffness_N_um": [20.0, 0.0, 0.0]}}
    data["supports"] = {"fixed": ["low.z0"], "springs": springs}
    data["loads"] = {"t": {"force_N": [400.0, 0, 0], "surface": "high.z0", "file": "load.csv"}}
    plate = boxes({}, low=LOW, high=((0.0, 0.0, SIDE), (SIDE, SIDE, SIDE + 0.004)))
    left = []
    for step in (60.0, 1.0):
        data["march"] |= {"step_s": step, "duration_min": 3.0}
        slip = run(tmp_path, data, plate)["slip"][-1].to_numpy()
        left.append(float(np.abs(slip).max()))
    assert left[0] > 1e-6
    assert left[0] == pytest.approx(left[1], rel=1e-6)


@pytest.mark.parametrize("coupling", ["staggered", "iterated"])
@pytest.mark.parametrize("coefficient", [1e-8, 1e-2])
def test_the_pressure_of_a_joint_however_stiff_is_that_of_the_bodies(
    tmp_path, data, coupling, coefficient
):
    data["materials"]["steel"]["poisson_ratio"] = 0.0
    data["joints"]["j"] |= {
        "normal_law": "back-burdekin",
        "back_burdekin": {"coefficient_um": coefficient, "exponent": 1.0},
        "conductance": {"law": "fixed", "value_W_m2K": 1e4},
    }
    del data["sources"], data["heat_input"]
    data["held_temperatures"] = {"low.z0": {"rise_K": 0.0}, "high.z1": {"rise_K": 1.0}}
    data["march"] |= {"coupling": coupling, "duration_min": 10.0}
    pressure = run(tmp_path, data)["pressure"].to_numpy()[-1]
    # Half a kelvin in the mean, alpha T (l + l) = (p - p0) ((l + l) / E + coefficient).
    rise = 12e-6 * 0.5 / (1.0 / 206e9 + coefficient * 1e-12 / (2.0 * SIDE))
    assert pressure == pytest.approx(1e6 + rise, rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_the_same_case_in_other_units_gives_the_same_digits(tmp_path, seed):
    long, stiff, hot = 10.0 ** np.random.default_rng(seed).uniform(-3.0, 3.0, 3)
    plain = run(tmp_path, scaled(1.0, 1.0, 1.0), scaled_boxes(1.0))
    other = run(tmp_path, scaled(long, stiff, hot), scaled_boxes(long))
    units = {"temperature": 1.0, "pressure": stiff, "slip": long, "displacement": long}
    for name, unit in units.items():
        expected = plain[name].to_numpy()
        left = np.abs(other[name].to_numpy() / unit - expected).max()
        assert left <= 1e-10 * np.abs(expected).max(), name


def scaled_boxes(long):
    # No square, whose longer side would be a matter of rounding.
    corners = {
        "low": (LOW[0], (1.5 * SIDE, SIDE, SIDE)),
        "high": ((0.005, 0.0, SIDE), (1.5 * SIDE, SIDE, 2 * SIDE)),
    }
    return boxes({}, **{name: long * np.array(corner) for name, corner in corners.items()})


def scaled(long, stiff, hot):
    """The case with other units of length, stress and heat: temperatures remain what they are."""
    data = copy.deepcopy(DATA)
    steel = data["materials"]["steel"]
    steel["youngs_modulus_GPa"] *= stiff
    steel["conductivity_W_mK"] *= hot / long
    steel["density_kg_m3"] *= hot / long**3
    data["joints"]["j"] |= {
        "preload_MPa": 1.0 * stiff,
        "hardness_GPa": 2.0 * stiff,
        "roughness_um": 1.25 * long,
        "friction_coefficient": 0.1,
        "along": 3,
        "across": 2,
    }
    data["sources"]["s"]["reference_power_W"] = 30.0 * hot
    data["probes"]["p"]["position_mm"] = [10.0 * long] * 3
    return data


def test_bodies_that_touch_without_a_joint_are_said_by_every_set_up(tmp_path, data):
    del data["joints"]
    structure = boxes({}, low=LOW, high=HIGH)
    write_structure(structure, tmp_path / "boxes.vtu")
    case = case_from_data(data, "case", tmp_path)
    touching = "'low' and 'high' face each other on about 4 cm2 without a joint"
    with pytest.warns(UserWarning, match=touching):
        set_up(case)
    task = Task(case_id(case), condensation_key(case), case.model_dump_json())
    (said,) = run_task(task).warnings
    assert touching in said


def test_sides_of_a_joint_that_share_their_rim_are_said(tmp_path, data):
    """As Gmsh leaves it if it duplicates the nodes inside of a common face only."""
    apart = boxes({}, low=LOW, high=HIGH)
    mesh = apart.mesh
    inside = np.abs(mesh.p[:2] - SIDE / 2).max(axis=0) < 1e-9
    places = np.vstack([mesh.p, inside * np.arange(inside.size)]).round(9)
    _, kept, number = np.unique(places, axis=1, return_index=True, return_inverse=True)
    glued = MeshHex(mesh.p[:, kept], number.ravel()[mesh.t])
    facets = {name: number.ravel()[mesh.facets[:, on]].T for name, on in apart.surfaces.items()}
    surfaces = {name: rows_in(glued.facets.T, nodes) for name, nodes in facets.items()}
    write_structure(replace(apart, mesh=glued, surfaces=surfaces), tmp_path / "boxes.vtu")
    with pytest.warns(UserWarning, match="joint 'j': its sides share 8 nodes"):
        set_up(case_from_data(data, "case", tmp_path))


def test_a_cavity_that_joints_fill_is_refused(tmp_path, data):
    data["cavities"] = {"air": {"surfaces": ["low.z1", "high.z0"], "film_W_m2K": 3.0}}
    with pytest.raises(InputError, match=r"cavities.air: joints cover all of its surfaces"):
        run(tmp_path, data)


def test_radiation_knows_one_ambient(tmp_path, data):
    (tmp_path / "air.csv").write_text("time_s,ambient_degC\n0,30\n3600,31\n")
    data["radiation"] = {"low.x0": {"emissivity": 0.9, "ambient_degC": 20.0}}
    data["ambient"] = {"file": "air.csv"}
    with pytest.raises(InputError, match=r"x0.ambient_degC: 20 °C, but ambient begins with 30"):
        run(tmp_path, data)


def test_laws_on_a_shared_condensation_are_refused_as_alone(tmp_path, data):
    """A joint may start far open, but not with a preload; both share one condensation."""
    lifted = tuple((x, y, z + 0.1 * SIDE) for x, y, z in HIGH)
    write_structure(boxes({}, low=LOW, high=lifted), tmp_path / "boxes.vtu")
    preloaded = case_from_data(data, "case", tmp_path)
    open_first = {"preload_MPa": 0.0, "initial_opening_um": 9.0, "reference_pressure_MPa": 1.0}
    data["joints"]["j"] |= open_first
    starts_open = case_from_data(data, "case", tmp_path)
    assert condensation_key(starts_open) == condensation_key(preloaded)
    shared = set_up(starts_open)
    for make in (set_up, lambda case: with_laws(shared, case)):
        with pytest.raises(InputError, match="apart in the mesh, where a preloaded joint is"):
            make(preloaded)


def test_a_mesh_in_the_wrong_unit_is_said_to_be_so(tmp_path, data):
    data["structure"]["unit"] = "mm"
    data["probes"]["p"]["position_mm"] = [0.01, 0.01, 0.01]
    data["march"]["thermal"] = "reduced"
    with pytest.raises(InputError, match=r"singular.* 4e-05 m long: perhaps structure.unit"):
        run(tmp_path, data)


def test_a_stress_at_a_node_is_the_mean_of_its_cells(tmp_path, data):
    around = [1e-3 * np.array(at) for at in product((-1, 1), repeat=3)]
    for number, offset in enumerate([np.zeros(3), *around]):
        place = (5.0 + offset).tolist()
        data["probes"][f"p{number}"] = {"position_mm": place, "body": "low"}
    data["output"] = {"stress_probes": [f"p{number}" for number in range(9)]}
    structure = boxes({}, low=(*LOW, (4, 4, 4)), high=HIGH)
    node, *others = run(tmp_path, data, structure)["stress"].to_numpy()[-1]
    size = np.abs(node).max()
    assert np.ptp(others, axis=0).max() > 5e-3 * size
    np.testing.assert_allclose(node, np.mean(others, axis=0), atol=1e-3 * size)


def test_a_coarse_joint_says_how_much_too_easily_it_rocks():
    section = {"preload_MPa": 1.0, "along": 9, "across": 2}
    assert "joint 'j' is 33% too soft, with across = 2" in rocking_lines({"j": section})[0]
    assert "no resistance" in rocking_lines({"j": section | {"across": 1}})[0]
    assert not rocking_lines({"j": section | {"across": 5}})
