"""The estimated error of a displacement is as large as the true one, part by part."""

import json
from dataclasses import replace

import numpy as np
import pytest
from boxes import boxes
from scipy.sparse import csr_array

from fesim.accuracy.coarse_joints import _elastic
from fesim.case.schema import case_from_data
from fesim.setup import mesh_errors
from fesim.setup.discretised import discretised
from fesim.setup.machine import set_up
from fesim.setup.parts import make_parts
from fesim.simulate import simulate
from fesim.solid.condensation import ElasticCondensation
from fesim.solid.round_faces import bulges
from meshes.exchange import write_structure
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.paper.summary import accuracy_line
from thermojoint.verification import thermal_bar
from thermojoint.verification.thermal_bar import CONDUCTIVITY, EXPANSION, LENGTH, WIDTH, bar_case

#: Held all around, without lateral contraction: one-dimensional.
SIDES = {"x0": "x", "y0": "y", "y1": "y", "z0": "z", "z1": "z"}
METAL = thermal_bar.METAL | {"poisson_ratio": 0.3}


def parts_of(response):
    return {
        name: response.attrs.get(f"error_{name}_um") for name in ("joint", "mesh", "time", "total")
    }


def heated_inside(folder, count, **sections):
    """A rod of some elements, cold at its ends, with heat in its volume."""
    changes = {
        "sources": {"hot": {"body": "block", "reference_power_W": 20.0}},
        "held_temperatures": {"x0": {"rise_K": 0.0}, "x1": {"rise_K": 0.0}},
        "heat_input": {"kind": "step", "level": 1.0},
        "supports": {"symmetry": SIDES},
    }
    return case_from_data(bar_case(folder, changes | sections, (count, 1, 1)), "case", folder)


@pytest.mark.parametrize("count", [3, 8])
def test_the_mesh_of_a_rod_with_heat_inside_is_off_as_estimated(tmp_path, count):
    response = simulate(heated_inside(tmp_path, count)).response
    grown = EXPANSION * 20.0 / WIDTH**2 * LENGTH**2 / (12.0 * CONDUCTIVITY)
    error = 1e6 * abs(float(response["displacement"][-1, 0]) - grown)
    assert parts_of(response)["mesh"] == pytest.approx(error, rel=0.1)
    assert parts_of(response)["joint"] == 0.0


@pytest.mark.parametrize(("steps", "thermal"), [(10, "full"), (80, "full"), (80, "reduced")])
def test_the_steps_of_a_transient_are_off_as_estimated(tmp_path, steps, thermal):
    def grown(count, **march):
        changes = {
            "sources": {"hot": {"surface": "x1", "reference_power_W": 40.0}},
            "held_temperatures": {"x0": {"rise_K": 0.0}},
            "heat_input": {"kind": "step", "level": 1.0},
            "supports": {"symmetry": SIDES},
            "march": {"step_s": 400.0 / count, "duration_min": 400.0 / 60.0} | march,
        }
        data = bar_case(tmp_path, changes, (6, 1, 1))
        return simulate(case_from_data(data, "case", tmp_path)).response

    response = grown(steps, thermal=thermal)
    limit = grown(steps, method="adaptive", tolerance_um=1e-3, tolerance_K=1e-3)
    error = 1e6 * float(np.abs(response["displacement"] - limit["displacement"]).max())
    assert 0.5 < error / parts_of(response)["time"] < 2.0
    # An adaptive march has estimated its own.
    assert parts_of(limit)["time"] == limit.attrs["estimated_error_um"]


def test_a_shared_set_up_knows_the_mesh_errors_of_each_march(tmp_path):
    """Longer marches feel more of the mesh of the temperatures."""
    case = heated_inside(tmp_path, 3)
    short = case.replace(march={"duration_min": case.march.step_s / 30.0})
    own, shared = simulate(case).response, simulate(case, setup=set_up(short)).response
    assert parts_of(shared) == parts_of(own)


def test_joint_laws_that_share_a_factor_have_the_errors_of_a_factor_each(coarse_case, monkeypatch):
    dual = mesh_errors.DualHeat(discretised(coarse_case, make_parts(coarse_case)))
    rows = np.random.default_rng(1).normal(size=(3, dual.lifted.shape[1]))
    for conductance in (0.0, 400.0, 2e5):
        conducts = np.full(dual.jump.shape[0], conductance)
        shared = mesh_errors.heat_errors(dual, rows, conducts, 600.0)
        with monkeypatch.context() as patch:
            patch.setattr(mesh_errors, "FEW", 0)
            own = mesh_errors.heat_errors(dual, rows, conducts, 600.0)
        for name in ("temperature", "rising", "inputs", "flow"):
            expected = getattr(own, name)
            at_most = 1e-9 * np.abs(expected).max()
            np.testing.assert_allclose(getattr(shared, name), expected, rtol=0.0, atol=at_most)


@pytest.mark.parametrize("factor", [None, {"rise_K": [0.0, 40.0], "factor": [1.0, 1.1]}])
def test_a_rod_that_starts_warm_and_stays_so_owes_nothing_to_its_mesh(tmp_path, factor):
    """It counted as if it had warmed up in the time since the start."""
    changes = {
        "initial_temperature": {"expression_K": "200 * x_m"},
        "held_temperatures": {"x0": {"rise_K": 0.0}, "x1": {"rise_K": 20.0}},
        "supports": {"symmetry": SIDES},
        "march": {
            "step_s": 5.0,
            "duration_min": 5.0,
            "thermal": "full" if factor else "reduced",
        },
    }
    data = bar_case(tmp_path, changes, (3, 1, 1), metal={"heat_capacity_factor": factor})
    assert parts_of(simulate(case_from_data(data, "case", tmp_path)).response)["mesh"] < 1e-6


def test_a_continued_march_owes_to_its_mesh_what_the_whole_one_does(tmp_path):
    case = heated_inside(tmp_path, 3, march={"step_s": 5.0, "duration_min": 10.0})
    half = simulate(case.replace(march={"duration_min": 5.0}))
    rest, whole = simulate(case, start=half.state).response, simulate(case).response
    assert 0.7 < parts_of(rest)["mesh"] / parts_of(whole)["mesh"] <= 1.0


@pytest.fixture(scope="module")
def rocking(tmp_path_factory):
    """A stiff block that rocks on a plate under a force on its top: along and across to it."""
    folder = tmp_path_factory.mktemp("rocking")
    structure = boxes(
        {"joint": ("plate.z1", "block.z0"), "other": ("foot.z1", "plate.z0")},
        foot=((0.0, 0.0, -0.04), (0.1, 0.1, -0.02), (2, 2, 1)),
        plate=((0.0, 0.0, -0.02), (0.1, 0.1, 0.0), (2, 2, 1)),
        block=((0.0, 0.0, 0.0), (0.1, 0.1, 0.04), (2, 2, 1)),
    )
    write_structure(structure, folder / "block.vtu")

    def run(count, **other):
        joint = {
            "preload_MPa": 1.0,
            "along": count,
            "across": count,
            "normal_law": "back-burdekin",
            "back_burdekin": {"coefficient_um": 8.0, "exponent": 0.5},
            "roughness_um": 1.25,
            "asperity_slope": 0.14,
            "hardness_GPa": 2.0,
            "friction_coefficient": 0.6,
        }
        stiff = {"normal_law": "surface", "along": 3, "across": 3}
        data = {
            "title": "block",
            "structure": {"kind": "mesh", "file": "block.vtu"},
            "materials": {"metal": METAL},
            "bodies": dict.fromkeys(("foot", "plate", "block"), "metal"),
            "joints": {"joint": joint, "other": joint | stiff | other},
            "supports": {"fixed": ["foot.z0"]},
            "loads": {"f": {"surface": "block.z1", "force_N": [300.0, 0.0, 0.0]}},
            "march": {"step_s": 1.0, "duration_min": 0.05},
            "probes": {"tip": {"position_mm": [100.0, 100.0, 40.0], "body": "block"}},
            "displacement": {"point": "tip"},
        }
        return simulate(case_from_data(data, "block", folder)).response

    return run


@pytest.mark.parametrize("count", [3, 4])
def test_the_contact_elements_of_a_rocking_block_are_off_as_estimated(rocking, count):
    response = rocking(count)
    error = 1e6 * np.abs(response["displacement"] - rocking(8)["displacement"]).max()
    # The other joint is the same in both.
    by_joint = json.loads(response.attrs["error_by_joint_um"])
    assert 0.3 < float(error) / by_joint["joint"] < 3.0


def test_the_summary_names_the_joint_that_matters_most(rocking):
    response = rocking(3, along=6, across=6)
    by_joint = json.loads(response.attrs["error_by_joint_um"])
    assert by_joint["joint"] > by_joint["other"] > 0.0
    line = accuracy_line(response.attrs)
    assert line.startswith(f"δ is good to about {response.attrs['error_total_um']:.2g} µm: joint ")
    assert "(most by 'joint')" in line


def test_what_single_contact_elements_leave_is_unknown(rocking):
    response = rocking(2, along=2, across=2)
    assert parts_of(response)["joint"] is None
    assert "joint unknown" in accuracy_line(response.attrs)


def test_straight_edges_on_round_faces_are_off_as_estimated(tmp_path):
    """A quarter of a thick ring under inner pressure (Lamé, plane strain): 2 x 4 elements."""
    ring = boxes({}, ring=((0.0, 0.0, 0.0), (0.05, 0.5 * np.pi, 0.01), (2, 4, 1)))
    radius, angle = 0.05 + ring.mesh.p[0], ring.mesh.p[1].copy()
    ring.mesh.p[:2] = radius * np.cos(angle), radius * np.sin(angle)
    boundary = ring.mesh.boundary_facets()
    outer = np.isin(boundary, ring.surfaces["ring.x1"])
    inside = np.sort(np.abs(bulges(ring.mesh, boundary)[outer]))[-1]
    assert inside == pytest.approx(0.1 * (1.0 - np.cos(np.pi / 16.0)) * 2.0 / 3.0, rel=0.05)
    write_structure(ring, tmp_path / "ring.vtu")
    data = {
        "title": "ring",
        "structure": {"kind": "mesh", "file": "ring.vtu"},
        "materials": {"metal": METAL},
        "bodies": {"ring": "metal"},
        "supports": {"symmetry": {"ring.y0": "y", "ring.y1": "x", "ring.z0": "z", "ring.z1": "z"}},
        "loads": {"p": {"surface": "ring.x0", "pressure_MPa": 50.0}},
        "march": {"step_s": 1.0, "duration_min": 0.05},
        "probes": {"P": {"position_mm": [100.0, 0.0, 0.0]}},
        "displacement": {"point": "P"},
    }
    response = simulate(case_from_data(data, "ring", tmp_path)).response
    grown = 2.0 * 50e6 * 0.05**2 / (0.1**2 - 0.05**2) * 0.1 * (1.0 - 0.3**2) / 104e9
    error = 1e6 * abs(float(response["displacement"][-1, 0]) - grown)
    assert 0.5 < error / parts_of(response)["mesh"] < 2.0


def layer(folder, divisions, changes):
    """A cantilever of square section, one element or more across, and what acts on it."""
    beam = boxes({}, beam=((0.0, 0.0, 0.0), (0.2, 0.02, 0.02), divisions))
    write_structure(beam, folder / "beam.vtu")
    data = {
        "title": "beam",
        "structure": {"kind": "mesh", "file": "beam.vtu"},
        "materials": {"metal": METAL},
        "bodies": {"beam": "metal"},
        "supports": {"fixed": ["beam.x0"]},
        "march": {"step_s": 1e6, "duration_min": 1e5, "thermal": "full"},
        "probes": {"tip": {"position_mm": [200.0, 0.0, 0.0]}},
        "displacement": {"point": "tip"},
    }
    return simulate(case_from_data(data | changes, "beam", folder)).response


ACTING = {
    "force": {"loads": {"f": {"surface": "beam.x1", "force_N": [0.0, 200.0, 0.0]}}},
    "heat": {
        "sources": {"hot": {"surface": "beam.y1", "reference_power_W": 40.0}},
        "heat_input": {"kind": "step", "level": 1.0},
        "held_temperatures": {"beam.y0": {"rise_K": 0.0}, "beam.x0": {"rise_K": 0.0}},
    },
}


@pytest.mark.parametrize("acting", ACTING)
def test_a_single_element_across_a_wall_hides_no_error(tmp_path, acting):
    coarse = layer(tmp_path, (4, 1, 1), ACTING[acting])
    fine = layer(tmp_path, (16, 3, 3), ACTING[acting])["displacement"]
    error = 1e6 * float(np.abs(coarse["displacement"] - fine).max())
    assert 0.5 < error / parts_of(coarse)["mesh"] < 2.0


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_elements_that_only_their_own_springs_hold_cannot_be_merged(share):
    """Exactly singular, and singular but for rounding; held as stiffly again, they can."""
    area, springs = np.tile([share, 1.0 - share], 3), np.full(6, 2.0)
    nothing, means = np.zeros((6, 1)), csr_array(area[None, :2])
    alone = ElasticCondensation(
        compliance=np.diag(1.0 / (springs * area)),
        thermal_gap=nothing,
        probe_compliance=nothing.T,
        probe_thermal=nothing[:1],
        reference=springs,
        area=area,
    )
    with pytest.raises(ConvergenceError, match="singular"):
        _elastic(alone, None, means)
    merged, _ = _elastic(replace(alone, compliance=0.5 * alone.compliance), None, means)
    assert merged.compliance.shape == (3, 3)
