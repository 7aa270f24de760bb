"""Forces, pressures and weights: on the joint's equations, in time, and on every way to march."""

import numpy as np
import pytest
from bars import two_bars

from fesim.case.identity import condensation_key, elasticity_key
from fesim.case.schema import case_from_data
from fesim.joint.cutting import cut, held_by
from fesim.joint.gap import gap_problem, solve_gap
from fesim.joint.law import BackBurdekinLaw, Friction, JointLaw, evaluate, stiffness_at_rest
from fesim.setup.parts import check_names
from fesim.setup.structure import build_structure
from fesim.simulate import simulate
from fesim.solid.forces import BodyForce, SurfaceForce, SurfacePressure, nodal_forces
from fesim.solid.materials import Material
from fesim.solid.spaces import make_spaces
from thermojoint.artefacts.errors import InputError
from thermojoint.verification.loaded import STANDING, WEIGHT, column_case, joint

IRON = Material(47.0, 7200.0, 500.0, 104e9, 0.27, 13.7e-6)


@pytest.mark.parametrize("tetrahedra", [False, True])
def test_nodal_forces_add_up_to_what_acts(tetrahedra):
    structure = two_bars(tetrahedra=tetrahedra)
    spaces = make_spaces(structure.mesh)
    loads = [
        SurfaceForce("top", (3.0, -4.0, 5.0)),
        SurfacePressure("right_end", 2e6),
        BodyForce(("left",), (0.0, 0.0, -9.81)),
    ]
    materials = {"left": IRON, "right": IRON}
    forces = nodal_forces(structure, spaces, materials, loads).reshape(-1, 3, 3)
    np.testing.assert_allclose(forces[..., 0].sum(axis=0), [3.0, -4.0, 5.0], rtol=1e-12)
    # Against the outward normal, on 60 x 40 mm.
    pressed = [-2e6 * 0.06 * 0.04, 0.0, 0.0]
    np.testing.assert_allclose(forces[..., 1].sum(axis=0), pressed, rtol=1e-12, atol=1e-9)
    weight = [0.0, 0.0, -9.81 * 7200.0 * 0.10 * 0.06 * 0.04]
    np.testing.assert_allclose(forces[..., 2].sum(axis=0), weight, rtol=1e-12, atol=1e-12)


def heated(folder, **changes):
    """Two bars with a joint, a warm foot and a force that grows."""
    (folder / "force.csv").write_text("time_s,factor\n0,0.5\n100,1\n")
    force = {"surface": "top", "force_N": [300.0, 0.0, -6000.0], "file": "force.csv"}
    return column_case(folder, True, changes) | {
        "joints": {"joint": joint(preload_MPa=2.0)},
        "supports": {"fixed": ["foot"]},
        "held_temperatures": {"foot": {"rise_K": 20.0}},
        "loads": {"cut": force, **WEIGHT},
    }


def test_a_pressure_is_the_force_over_its_surface(tmp_path):
    """Both also on a machine of which a half is meshed: the force is that of the whole."""
    ends = []
    for load in ({"force_N": [0.0, 0.0, -5000.0]}, {"pressure_MPa": 1.0}):
        data = heated(tmp_path)
        data["structure"]["symmetry_factor"] = 2
        data["loads"] = {"top": {"surface": "top"} | load}
        ends.append(simulate(case_from_data(data, "bars", tmp_path)).response)
    np.testing.assert_allclose(ends[0]["pressure"], ends[1]["pressure"], rtol=1e-9)


def test_a_case_of_loads_alone_marches(tmp_path):
    response = simulate(
        case_from_data(column_case(tmp_path, False, STANDING), "c", tmp_path)
    ).response
    force = (response["pressure"] * response["contact_area"]).sum("contact")
    # The weight is there from the start on.
    np.testing.assert_allclose(force, 7200.0 * 9.81 * 0.4 * 0.05**2, rtol=1e-6)


def test_loads_split_condensations_but_keep_the_elastic_one(tmp_path):
    data = heated(tmp_path)
    one = case_from_data(data, "bars", tmp_path)
    (tmp_path / "other.csv").write_text("time_s,factor\n0,1\n")
    data["loads"]["cut"] = data["loads"]["cut"] | {"file": "other.csv"}
    same = case_from_data(data, "bars", tmp_path)
    data["loads"]["cut"] = data["loads"]["cut"] | {"force_N": [0.0, 0.0, 1.0]}
    other = case_from_data(data, "bars", tmp_path)
    assert condensation_key(one) == condensation_key(same) != condensation_key(other)
    assert elasticity_key(one) == elasticity_key(other)


@pytest.mark.parametrize(
    ("load", "message"),
    [
        ({"surface": "tpo", "pressure_MPa": 1.0}, "loads.odd.surface.*'tpo'.*'top'"),
        ({"acceleration_m_s2": [0, 0, 1], "bodies": ["uper"]}, "loads.odd.bodies.*'uper'.*'upper'"),
        ({"surface": "top"}, "give one of 'force_N'"),
        ({"force_N": [0, 0, 1]}, "need the 'surface'"),
        ({"surface": "top", "acceleration_m_s2": [0, 0, 1]}, "'acceleration_m_s2' has none"),
        ({"surface": "top", "pressure_MPa": 1.0, "bodies": ["upper"]}, "'bodies' go with"),
        ({"surface": "top", "force_kN": [0, 0, 1]}, "did you mean 'force_N'"),
    ],
)
def test_a_slip_about_loads_is_one_line(tmp_path, load, message):
    data = heated(tmp_path)
    data["loads"]["odd"] = load

    def read():
        case = case_from_data(data, "bars", tmp_path)
        check_names(case, build_structure(case))

    with pytest.raises(InputError, match=message) as refused:
        read()
    assert "\n" not in str(refused.value)


# --- steps that are cut --------------------------------------------------------------------------


def sliding_problem(friction):
    law = JointLaw(BackBurdekinLaw(0.6e-9, 0.5, 2e6), Friction(friction, 3e12), lambda p: p)
    springs = stiffness_at_rest([(law, 2)])
    rng = np.random.default_rng(3)
    half = rng.standard_normal((6, 6)) * 1e-12
    compliance = np.linalg.inv(
        np.linalg.inv(half @ half.T * 1e12 + 1e-12 * np.eye(6)) + np.diag(springs)
    )
    return gap_problem(
        compliance, np.ones(6), springs, springs, lambda gap, slip: evaluate(law, gap, slip)
    )


def test_a_gap_in_equilibrium_is_held_by_its_thermal_gap():
    problem = sliding_problem(0.4)
    thermal = np.linspace(-3e-7, 4e-7, 6)
    found = solve_gap(problem, thermal, np.zeros((2, 2)), np.zeros((3, 2)))
    np.testing.assert_allclose(
        held_by(problem, found.gap, np.zeros((2, 2))), thermal, rtol=1e-6, atol=1e-12
    )


@pytest.mark.parametrize("friction", [0.0, 0.5, 2.0])
def test_a_step_that_is_cut_ends_in_an_equilibrium_of_its_whole(friction):
    problem = sliding_problem(friction)
    thermal = np.array([-1e-4, 3e-4, 5e-6, -2e-6, 1e-6, 4e-6])
    found, pieces = cut(problem, thermal, np.zeros((2, 2)), np.zeros((3, 2)))
    assert pieces >= 2
    size = np.abs(problem.residual(found.gap, found.traction, thermal)).max()
    assert size <= 1e-13
