"""What supports and joints bear, and stresses at probes: against equilibrium and the full field."""

import json

import numpy as np
import pytest
import xarray as xr
from batch_cases import case_text, grid
from hypothesis import given
from hypothesis import strategies as st

from fesim.batch.dataset import open_dataset, store_response
from fesim.batch.study import read_study
from fesim.batch.summary import figures_of
from fesim.case.identity import condensation_key, elasticity_key
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from fesim.setup.parts import check_names
from fesim.setup.structure import build_structure
from fesim.simulate import simulate
from fesim.solid.stress import principal, von_mises
from thermojoint.artefacts.errors import InputError
from thermojoint.verification.loaded import STANDING, WEIGHT, column_case, joint

ASKED = {"forces": True, "stress_probes": ["P"]}
stresses = st.lists(st.floats(-1e8, 1e8), min_size=6, max_size=6).map(np.array)


def machine(folder, **march):
    """Two bodies with a joint that slips, on a fixed foot, on springs and a roller, and heated."""
    push = {"surface": "top", "force_N": [2500.0, 300.0, -4000.0]}
    data = column_case(folder, True, {"loads": {"push": push, **WEIGHT}, "output": ASKED})
    data["joints"] = {"joint": joint(preload_MPa=0.5)}
    data["materials"]["iron"]["poisson_ratio"] = 0.27
    data["supports"] = {
        "fixed": ["foot"],
        "symmetry": {"back": "x"},
        "springs": {"top": {"stiffness_N_um": [0.0, 20.0, 30.0]}},
    }
    data["held_temperatures"] = {"foot": {"rise_K": 25.0}}
    data["march"] |= march
    return case_from_data(data, "machine", folder)


@pytest.fixture(scope="module")
def marched(tmp_path_factory):
    """Case, set-up, steps and response of the full thermal model."""
    case = machine(tmp_path_factory.mktemp("machine"), thermal="full")
    setup, steps = set_up(case), []
    return case, setup, steps, simulate(case, setup=setup, on_step=steps.append).response


def test_supports_bear_what_acts_at_every_step(marched):
    """Heat, slip and springs change who bears it, not how much."""
    _, _, _, response = marched
    weight = 7200.0 * 9.81 * 0.4 * 0.05**2
    borne = response["reaction"].sum("support").to_numpy()
    np.testing.assert_allclose(
        borne, np.tile([-2500.0, -300.0, 4000.0 + weight], (len(borne), 1)), rtol=1e-7
    )
    assert response["force_balance"].max().item() < 1e-7
    # The roller holds along x alone, and takes from the foot what it holds.
    roller = response["reaction"].sel(support="back")
    assert not roller.sel(space=["y", "z"]).any()
    assert np.abs(roller.sel(space="x")).min().item() > 100.0


def test_the_joint_passes_what_acts_above_it(marched):
    """Side b is the upper half: joint, roller, springs, weight and push are in balance."""
    _, _, _, response = marched
    last = response.isel(time=-1)
    passed = last["joint_force"].sel(joint="joint")
    springs = last["reaction"].sel(support="top")
    weight = 7200.0 * 9.81 * 0.2 * 0.05**2
    preload = 0.5e6 * 0.05**2
    # The roller is on both halves: only the other directions are known.
    assert passed[1] + springs[1] == pytest.approx(-300.0, rel=1e-6)
    assert passed[2] + springs[2] - preload == pytest.approx(4000.0 + weight, rel=1e-6)
    assert (last["pressure"] @ last["contact_area"]).item() == pytest.approx(passed[2].item())
    friction = 0.2 * last["pressure"]
    assert (np.linalg.norm(last["shear"], axis=1) <= friction * (1.0 + 1e-9)).all()


def test_the_reduced_march_bears_as_the_full_one(marched, tmp_path):
    _, _, _, full = marched
    reduced = simulate(machine(tmp_path, thermal="reduced", coupling="iterated")).response
    close = simulate(machine(tmp_path, thermal="full", coupling="iterated")).response
    np.testing.assert_allclose(reduced["reaction"], close["reaction"], atol=2.0)
    np.testing.assert_allclose(reduced["stress"], close["stress"], atol=2e4)
    assert full["stress"].shape == reduced["stress"].shape


def test_heat_alone_leaves_supports_in_balance(tmp_path):
    """Without a load there is a balance, too."""
    warm = {"held_temperatures": {"foot": {"rise_K": 25.0}}, "output": {"forces": True}}
    data = column_case(tmp_path, True, warm | {"joints": {"joint": joint(preload_MPa=0.5)}})
    data["supports"] = {"fixed": ["foot", "top"]}
    last = simulate(case_from_data(data, "c", tmp_path)).response.isel(time=-1)
    foot, top = (last["reaction"].sel(support=name, space="z").item() for name in ("foot", "top"))
    assert foot == pytest.approx(-top, rel=1e-6)
    assert foot > 100.0
    assert last["force_balance"].item() < 1e-7


def test_a_wall_bears_what_its_joint_passes(tmp_path):
    data = column_case(tmp_path, False, STANDING | {"output": ASKED})
    last = simulate(case_from_data(data, "c", tmp_path)).response.isel(time=-1)
    wall, feet = last["reaction"].sel(support="floor"), last["joint_force"].sel(joint="feet")
    # The wall is side b: the joint pushes it down, and it does not move. It has no weight.
    np.testing.assert_allclose(wall, -feet, rtol=1e-6, atol=1e-6)
    assert wall.sel(space="z").item() == pytest.approx(7200.0 * 9.81 * 0.4 * 0.05**2, rel=1e-6)


def test_nothing_is_said_of_forces_that_nobody_asked_for(tmp_path):
    data = column_case(tmp_path, False, STANDING)
    response = simulate(case_from_data(data, "c", tmp_path)).response
    assert not {"reaction", "shear", "joint_force", "stress", "force_balance"} & set(response)
    assert "force_balance" not in figures_of(response)


def test_a_summary_has_the_balance_of_forces(marched):
    _, _, _, response = marched
    assert figures_of(response)["force_balance"] == response["force_balance"].max().item()
    assert json.loads(response.attrs["case"])["output"]["forces"]


def test_what_is_asked_for_splits_condensations_but_keeps_the_elastic_one(tmp_path):
    data = column_case(tmp_path, False, STANDING)
    one, other = (
        case_from_data(data | {"output": output}, "c", tmp_path) for output in ({}, ASKED)
    )
    assert condensation_key(one) != condensation_key(other)
    assert elasticity_key(one) == elasticity_key(other)


def test_a_stress_probe_that_is_none_is_one_line(tmp_path):
    data = column_case(tmp_path, False, STANDING | {"output": {"stress_probes": ["p"]}})
    case = case_from_data(data, "c", tmp_path)
    with pytest.raises(InputError, match=r"output.stress_probes: no probe named 'p'"):
        check_names(case, build_structure(case))


@given(stress=stresses)
def test_invariants_of_a_stress(stress):
    size = 1e-6 * (1.0 + np.abs(stress).max())
    first, second, third = principal(stress)
    assert first >= second >= third
    assert first + second + third == pytest.approx(stress[:3].sum(), abs=size)
    mises = np.sqrt(0.5 * ((first - second) ** 2 + (second - third) ** 2 + (third - first) ** 2))
    assert von_mises(stress) == pytest.approx(mises, abs=size, rel=1e-6)
    pressed = stress + np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * 1e7
    assert von_mises(pressed) == pytest.approx(von_mises(stress), abs=size + 100.0, rel=1e-6)


def test_a_batch_keeps_the_forces_of_the_cases_that_ask_for_them(tmp_path):
    """Cases with and without: what one does not say is not a number in its row."""
    text = case_text(0.1) + "[loads.gravity]\nacceleration_m_s2 = [0.0, -9.81, 0.0]\n"
    (tmp_path / "machine.toml").write_text(text)
    path = tmp_path / "study.toml"
    path.write_text(f'case = "machine.toml"\n{grid("output.forces", True, False)}')
    study = read_study(path)
    dataset = open_dataset(tmp_path / "dataset.zarr", study)
    asked = next(one for one in study.cases if one.case.output.forces)
    response = simulate(asked.case).response
    store_response(dataset, asked.id, response)
    with xr.open_dataset(tmp_path / "dataset.zarr", engine="zarr") as kept:
        own, other = kept.sel(case=asked.id), kept.drop_sel(case=asked.id)
        for name in ("reaction", "joint_force", "joint_moment", "force_balance", "load_factor"):
            np.testing.assert_array_equal(own[name], response[name])
            assert np.isnan(other[name]).all()
        assert "stress" not in kept


def test_a_batch_without_forces_has_no_place_for_them(tmp_path):
    (tmp_path / "machine.toml").write_text(case_text(0.1))
    path = tmp_path / "study.toml"
    path.write_text(f'case = "machine.toml"\n{grid("heat_input.level", 1.0, 2.0)}')
    arrays = open_dataset(tmp_path / "dataset.zarr", read_study(path)).arrays
    assert "pressure" in arrays
    unasked = {"reaction", "shear", "support", "load_factor", "joint", "secant_residual"}
    assert not unasked & set(arrays)
