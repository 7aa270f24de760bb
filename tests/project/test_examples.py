"""The worked examples run, and their results are what mechanics and heat demand."""

import sys

import numpy as np
import pytest
from repository import ROOT

from fesim.case.schema import read_case
from fesim.simulate import simulate
from meshes.exchange import read_structure

EXAMPLES = ROOT / "examples"


@pytest.fixture(scope="module")
def two_rods():
    """The example's own module: its closed form is the judge."""
    sys.path.insert(0, str(EXAMPLES / "two_rods"))
    import two_rods

    sys.path.pop(0)
    return two_rods


def test_two_rods_settle_where_the_closed_form_says(two_rods):
    case = read_case(EXAMPLES / "two_rods" / "case.toml")
    response = simulate(case).response
    pressure, flux, jump = two_rods.steady_state(20.0, 0.0)
    assert response["pressure"][-1, 0].item() == pytest.approx(pressure, rel=1e-6)
    assert response["heat_flow"][-1].sum().item() == pytest.approx(
        flux * two_rods.WIDTH**2, rel=1e-6
    )
    last = response["temperature"][-1]
    found = last.sel(probe="left_of_joint") - last.sel(probe="right_of_joint")
    assert found.item() == pytest.approx(jump, rel=1e-5)
    assert np.abs(response["heat_balance"]).max().item() < 1e-9


def test_the_mesh_of_the_rods_is_the_one_that_the_script_writes(two_rods):
    kept = read_structure(EXAMPLES / "two_rods" / "two_rods.vtu")
    made = two_rods.rods()
    np.testing.assert_allclose(kept.mesh.p, made.mesh.p, atol=1e-12)
    np.testing.assert_array_equal(kept.mesh.t, made.mesh.t)
    assert kept.joints == made.joints


@pytest.fixture(scope="module")
def flange():
    """The flange's response."""
    return simulate(read_case(EXAMPLES / "bolted_flange" / "case.toml")).response


def forces(response, joint):
    """Normal force on a joint in time, N."""
    own = response["contact_joint"].to_numpy() == joint
    area = response["contact_area"].to_numpy()[own]
    return response["pressure"].to_numpy()[:, own] @ area


@pytest.mark.long
def test_the_bolt_pulls_at_its_nut_as_at_its_head(flange):
    """Only its two joints hold the bolt: its forces balance in every step."""
    head, nut = forces(flange, "head"), forces(flange, "nut")
    assert head[0] == pytest.approx(20e3, rel=0.01)
    np.testing.assert_allclose(head, nut, rtol=1e-6)


@pytest.mark.long
def test_the_bolt_is_stretched_first_and_slackens_when_it_is_warm(flange):
    """The flange is warm before the bolt; steel grows more than iron in the end."""
    head = forces(flange, "head")
    assert head.max() > 1.01 * head[0]
    assert head[-1] < 0.98 * head[0]


@pytest.mark.long
def test_heat_goes_from_the_heated_flange_into_the_other_and_into_the_bolt(flange):
    joints = flange["contact_joint"].to_numpy()
    at = 60
    flow = {name: flange["heat_flow"].to_numpy()[at, joints == name].sum() for name in set(joints)}
    # Side a is the lower flange, and the bolt.
    assert flow["faces"] < 0.0
    assert flow["head"] < 0.0
    assert np.abs(flange["heat_balance"]).max().item() < 1e-9
    assert flange["gap_residual"].max().item() < 1e-11


@pytest.mark.long
def test_the_flange_grows_away_from_its_base(flange):
    rise = flange["displacement"].sel(axis="z").to_numpy()
    warm = flange["temperature"].sel(probe="top").to_numpy()
    assert rise[120] > 20e-6
    # About what a free ring of that height would grow.
    assert rise[120] == pytest.approx(11e-6 * warm[120] * 0.04, rel=0.2)


def test_the_script_makes_an_equivalent_mesh(tmp_path):
    gmsh = pytest.importorskip("gmsh", exc_type=(ImportError, OSError))
    assert gmsh
    sys.path.insert(0, str(EXAMPLES / "bolted_flange"))
    import flange as script

    sys.path.pop(0)
    script.main(str(tmp_path / "flange.msh"))
    made = read_structure(tmp_path / "flange.msh")
    kept = read_structure(EXAMPLES / "bolted_flange" / "flange.msh")
    assert set(made.bodies) == set(kept.bodies)
    assert set(made.surfaces) == set(kept.surfaces)
    assert made.joints == kept.joints
    assert made.mesh.nelements == pytest.approx(kept.mesh.nelements, rel=0.2)


def test_bolts_of_the_machine_press_its_knee_and_follow_it():
    """Joint, bolts and screw keep the table in balance; a bolt that settles presses less."""
    response = simulate(read_case(EXAMPLES / "bolted_machine" / "machine.toml")).response
    pulls = response["bolt_force"]
    np.testing.assert_allclose(pulls[0], 30e3, rtol=1e-6)
    pressed = (response["pressure"] @ response["contact_area"]).to_numpy()
    # The table's screw holds back a little of it.
    assert pressed[0] == pytest.approx(120e3, rel=0.01)
    table = response["joint_force"].sel(joint="knee") + response["reaction"].sel(
        support="screw_foot"
    )
    np.testing.assert_allclose(table.sel(space="x"), pulls.sum("bolt"), rtol=1e-6)
    # Uneven from the start: more at the bolts.
    assert np.ptp(response["pressure"][0].to_numpy()) > 1e5
    settled = pulls.sel(bolt="upper", time=[600.0, 660.0]).to_numpy()
    assert 0.6 < settled[1] / settled[0] < 0.9
    assert response["force_balance"].max().item() < 1e-6


@pytest.mark.long
def test_the_loaded_machine_stands_on_its_foot_and_its_screw():
    """In every step supports bear weight and cutting force; half of the machine is meshed."""
    response = simulate(read_case(EXAMPLES / "loaded_machine" / "machine.toml")).response
    assert response["force_balance"].max().item() < 1e-6
    cutting = response["load_factor"].sel(load="cutting").to_numpy()
    borne = response["reaction"].sum("support").sel(space=["x", "y"]).to_numpy()
    weight = borne[0, 1]
    np.testing.assert_allclose(borne[:, 0], 1000.0 * cutting, atol=1e-3)
    np.testing.assert_allclose(borne[:, 1] - weight, -500.0 * cutting, atol=1e-3)
    # The tool is pushed back when it begins to cut, and comes back when it ends.
    at = response["displacement"].sel(axis="x").to_numpy()
    bent = np.diff(at, 2)
    assert bent[59] < -0.1e-6
    assert bent[119] == pytest.approx(-bent[59], rel=0.2)
    assert response["von_mises"].max().item() > 1e5
