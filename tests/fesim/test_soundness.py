"""What would end in a wrong answer is refused before or in the march, in one line."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from boxes import boxes
from skfem import MeshHex

from fesim.case.schema import case_from_data
from fesim.simulate import simulate
from meshes.exchange import write_structure
from meshes.inspection import inspect, pieces
from meshes.structure import Probe
from thermojoint.artefacts.errors import ConvergenceError, InputError

JOINT = {
    "side_a": "low.z1",
    "side_b": "high.z0",
    "preload_MPa": 1.0,
    "along": 1,
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


def test_the_sound_case_runs(tmp_path, data):
    assert float(run(tmp_path, data)["gap_residual"].max()) < 1e-12


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


def test_cells_that_share_a_node_are_one_piece():
    chain = np.array([[0, 1], [1, 2], [5, 6], [2, 9]]).T
    assert pieces(chain).tolist() == [0, 0, 1, 0]


def test_a_joint_pressed_beyond_half_of_its_hardness_is_refused(tmp_path, data):
    data["joints"]["j"]["hardness_GPa"] = 0.1
    data["initial_temperature"] = {"rise_K": 100.0}
    with pytest.raises(ConvergenceError, match="'j': the pressure passes 50 MPa, half of its hard"):
        run(tmp_path, data)
