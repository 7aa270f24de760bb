"""Heat of friction: from the work of sliding, into both sides, in the step in which they slide."""

import numpy as np
import pytest

from fesim.case.schema import case_from_data
from fesim.march.state_file import load_state, save_state
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.reduced.machine import reduce_machine
from thermojoint.verification.loaded import STANDING, column_case, joint

PUSH = [4000.0, 0.0, 0.0]


def pushed(folder, force=PUSH, heats=True, **march):
    """A column in two halves; one is pushed over the other and back against a spring."""
    (folder / "push.csv").write_text("time_s,factor\n0,0\n60,1\n180,-1\n300,1\n")
    changes = {
        "supports": {
            "fixed": ["foot"],
            "symmetry": {"side": "y"},
            "springs": {"joint.b": {"stiffness_N_um": [5.0, 0.0, 0.0]}},
        },
        "joints": {"joint": joint(preload_MPa=2.0, slip_heating=heats)},
        "loads": {"push": {"surface": "joint.b", "force_N": force, "file": "push.csv"}},
        "march": {"step_s": 20.0, "duration_min": 5.0} | march,
    }
    data = column_case(folder, True, changes)
    data["materials"]["iron"]["youngs_modulus_GPa"] = 1e8  # only the joint gives way
    return case_from_data(data, "column", folder)


@pytest.mark.parametrize("thermal", ["full", "reduced"])
@pytest.mark.parametrize("coupling", ["staggered", "iterated"])
def test_what_friction_works_is_stored_in_both_sides(tmp_path, thermal, coupling):
    response = simulate(pushed(tmp_path, thermal=thermal, coupling=coupling)).response
    heat = response["friction_heat"].to_numpy()
    # It slides while the force grows beyond mu P = 1000 N of 4000 N, 0.6 mm from side to side.
    assert 20.0 * heat.sum() == pytest.approx(1000.0 * 5 * 0.6e-3, rel=1e-3)
    assert (heat >= -1e-9 * heat.max()).all()
    assert np.abs(response["heat_balance"]).max() < 1e-8
    sides = response["heat_flow"].to_numpy()
    assert np.abs(sides).max() < 1e-6 * heat.max(), "equal halves warm alike: none flows across"


def test_a_joint_that_sticks_is_not_heated(tmp_path):
    light = [500.0, 0.0, 0.0]
    counted, plain = (simulate(pushed(tmp_path, light, heats)).response for heats in (True, False))
    assert not counted["friction_heat"].to_numpy().any()
    assert "friction_heat" not in plain
    np.testing.assert_allclose(counted["displacement"], plain["displacement"], atol=1e-12)


def test_a_march_with_friction_goes_on_bit_for_bit(tmp_path):
    whole = pushed(tmp_path)
    half = pushed(tmp_path, duration_min=2.0)
    save_state(simulate(half).state, half, tmp_path / "state.npz")
    rest = simulate(whole, start=load_state(tmp_path / "state.npz", whole)).response
    uninterrupted = simulate(whole).response
    for name in ("friction_heat", "displacement", "temperature"):
        np.testing.assert_array_equal(rest[name], uninterrupted[name][-len(rest["time"]) :])


def test_a_load_that_turns_within_a_step_is_refused_with_friction_heat(tmp_path, monkeypatch):
    """Before anything is set up."""
    monkeypatch.setattr("fesim.simulate.set_up", None)
    with pytest.raises(InputError, match="turns back within the step to 80 s"):
        simulate(pushed(tmp_path, step_s=40.0))


def test_adaptive_steps_and_adiabatic_walls_refuse_friction_heat(tmp_path):
    with pytest.raises(InputError, match=r"joints\.joint\.slip_heating: adaptive"):
        pushed(tmp_path, method="adaptive")
    feet = STANDING["joints"]["feet"] | {"slip_heating": True}
    standing = column_case(tmp_path, False, STANDING | {"joints": {"feet": feet}})
    with pytest.raises(InputError, match="the wall 'floor' has no temperature"):
        case_from_data(standing, "column", tmp_path)


def test_the_joint_aware_estimator_refuses_friction_heat(tmp_path):
    case = pushed(tmp_path)
    with pytest.raises(InputError, match=r"joint-aware: joints\.joint"):
        reduce_machine(case, None, [])
