"""Bodies that come loose in the march: their joints open, or slide as a whole."""

import tomllib

import numpy as np
import pytest
from bars import surface_law
from boxes import boxes
from edits import edited
from hypothesis import given, settings
from hypothesis import strategies as st

from fesim.case.schema import case_from_data
from fesim.joint.law import ACROSS, ALONG, CROSS, NORMAL, Traction
from fesim.joint.loosening import _as_at_rest, _stiff, watch_of, watch_work
from fesim.setup.machine import set_up, with_laws
from fesim.simulate import simulate
from fesim.solid.rigid_motions import constraints_of
from meshes.exchange import write_structure
from meshes.pairing import pair_joint
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.cli.app import app


def rod(low, high, cells=2):
    return (low, 0.0, 0.0), (high, 0.04, 0.04), (cells, 1, 1)


THREE_RODS = boxes(
    {"first": ("left.x1", "middle.x0"), "second": ("middle.x1", "right.x0")},
    left=rod(0.0, 0.1),
    middle=rod(0.1, 0.3),
    right=rod(0.3, 0.4),
)
JOINT = """\
preload_MPa = 1.0
along = 2
across = 2
roughness_um = 1.25
asperity_slope = 0.14
hardness_GPa = 1.961
friction_coefficient = 0.6
"""
CASE = f"""
title = "Three rods in line between walls"
bodies = {{ left = "iron", middle = "iron", right = "iron" }}
supports = {{ fixed = ["left.x0", "right.x1"] }}
march = {{ step_s = 20.0, duration_min = 10.0, thermal = "full" }}
displacement = {{ point = "P" }}
probes = {{ P = {{ position_mm = [200.0, 0.0, 0.0] }} }}
[structure]
kind = "mesh"
file = "rods.vtu"
[materials.iron]
conductivity_W_mK = 50.0
density_kg_m3 = 7200.0
heat_capacity_J_kgK = 500.0
youngs_modulus_GPa = 110.0
poisson_ratio = 0.25
expansion_1_K = 1.1e-5
[joints.first]
{JOINT}
[joints.second]
{JOINT}
[held_temperatures."middle.z1"]
rise_K = -30.0
"""


@pytest.fixture(scope="module")
def rods(tmp_path_factory):
    """A folder with the mesh of three rods, and their case as data."""
    folder = tmp_path_factory.mktemp("rods")
    write_structure(THREE_RODS, folder / "rods.vtu")
    return folder, tomllib.loads(CASE)


def case_of(rods, *edits):
    folder, data = rods
    return case_from_data(edited(data, *edits), "rods.toml", folder)


def test_a_body_whose_joints_open_on_the_way_raises(rods):
    """The middle rod shrinks away from both its neighbours: then nothing holds it."""
    with pytest.raises(ConvergenceError) as caught:
        simulate(case_of(rods))
    said = str(caught.value)
    assert "come loose" in said
    assert "body 'middle'" in said
    assert "moving along x, y and z" in said
    assert "\n" not in said


def test_a_body_on_springs_may_lose_its_joints(rods):
    held = case_of(
        rods, (("supports", "springs"), {"middle.z0": {"stiffness_N_um": [10.0, 10.0, 10.0]}})
    )
    response = simulate(held).response
    assert float(response["pressure"][-1].max()) == pytest.approx(0.0, abs=1.0)


def test_a_warm_rod_between_walls_stays(rods):
    response = simulate(case_of(rods, (("held_temperatures", "middle.z1", "rise_K"), 5.0))).response
    assert float(response["pressure"][-1].min()) > 1e6


@pytest.mark.parametrize("force", [[0.0, 0.0, 3000.0], [500.0, 3000.0, 2000.0]])
def test_a_load_beyond_what_friction_holds_leaves_its_body_loose(rods, force):
    """The friction of both joints bears 1920 N, less where the load is not in their middle."""
    pushed = case_of(
        rods,
        (("held_temperatures", "middle.z1", "rise_K"), 0.0),
        (("loads", "push"), {"surface": "middle.y1", "force_N": force}),
    )
    with pytest.raises(ConvergenceError, match="keep body 'middle' from turning about x"):
        simulate(pushed)


@pytest.mark.long
def test_an_adaptive_march_names_the_body_that_a_growing_load_makes_slide(rods):
    """However short its steps become: it is not their tolerance that ends it."""
    folder, _ = rods
    (folder / "growing.csv").write_text("time_s,factor\n0,0\n60,1\n")
    force = {"surface": "middle.y1", "force_N": [500.0, 3000.0, 2000.0], "file": "growing.csv"}
    pushed = case_of(
        rods,
        (("held_temperatures", "middle.z1", "rise_K"), 0.0),
        (("loads", "push"), force),
        (("march", "method"), "adaptive"),
        (("march", "thermal"), "reduced"),
    )
    with pytest.raises(ConvergenceError, match="keep body 'middle' from turning about x"):
        simulate(pushed)


FRICTIONLESS = [(("joints", name, "friction_coefficient"), 0.0) for name in ("first", "second")]


def test_a_rod_between_frictionless_joints_is_refused_before_anything_is_factorised(
    rods, monkeypatch
):
    monkeypatch.setattr("fesim.setup.discretised.heat_operators", None)
    with pytest.raises(InputError, match="body 'middle' from moving along y and z and from turnin"):
        simulate(case_of(rods, *FRICTIONLESS))


def test_a_law_without_friction_is_refused_on_a_condensation_with_it(rods):
    ready = set_up(case_of(rods))
    with pytest.raises(InputError, match="body 'middle' from moving along y and z"):
        with_laws(ready, case_of(rods, *FRICTIONLESS))


def test_inspect_says_the_same_of_a_case(rods, capsys):
    folder, _ = rods
    path = folder / "case.toml"
    path.write_text(CASE.replace("friction_coefficient = 0.6", "friction_coefficient = 0.0"))
    app(["inspect", str(path)], standalone_mode=False)
    said = " ".join(capsys.readouterr().out.split())
    assert "keeps body 'middle' from moving along y and z and from turning about x" in said
    path.write_text(CASE)
    app(["inspect", str(path)], standalone_mode=False)
    assert "keeps body" not in capsys.readouterr().out


# --- the check of a step -------------------------------------------------------------------------


JOINTS = [pair_joint(THREE_RODS, name, 3, 2) for name in ("first", "second")]
HOLDS = constraints_of(THREE_RODS, JOINTS, ["left.x0", "right.x1"], {}, {})
ROUGH, SMOOTH = surface_law(0.3), surface_law(0.0)


def state(law, states, turns):
    """Pressure and tangent (6, m) of elements that are open, slide or stick."""
    stiffness = law.friction.stiffness if law.friction.coefficient else 0.0
    kinds = np.array(states)
    tangent = np.zeros((6, len(kinds)))
    tangent[NORMAL] = -1e12
    along, across = np.cos(turns), np.sin(turns)
    sticks = kinds == "stick"
    tangent[ALONG] = -stiffness * np.where(sticks, 1.0, across**2)
    tangent[ACROSS] = -stiffness * np.where(sticks, 1.0, along**2)
    tangent[CROSS] = np.where(sticks, 0.0, stiffness * along * across)
    return np.where(kinds == "open", 0.0, law.preload), tangent


STATES = st.lists(st.sampled_from(["stick", "slide", "open"]), min_size=12, max_size=12)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(states=STATES, seed=st.integers(0, 99), rough=st.booleans())
def test_what_the_quick_checks_take_as_held_is_held(states, seed, rough):
    watch = watch_of(HOLDS, [(ROUGH if rough else SMOOTH, 6), (ROUGH, 6)])
    turns = np.random.default_rng(seed).choice([0.0, 0.5 * np.pi, 1.0], 12)
    (left, first), (right, second) = (
        state(law, states[at], turns[at])
        for law, at in ((ROUGH if rough else SMOOTH, slice(6)), (ROUGH, slice(6, 12)))
    )
    pressure, tangent = np.concatenate([left, right]), np.concatenate([first, second], axis=-1)
    left_over = watch._unheld(pressure > 0.0, tangent).shape[1]
    checked = watch.watched, watch_work(watch.watched), pressure, tangent
    if _as_at_rest(*checked):
        assert left_over == 0
    if _stiff(*checked):
        assert left_over == 0
    if left_over:
        with pytest.raises(ConvergenceError, match="body 'middle'"):
            watch.check(pressure, tangent)
    else:
        watch.check(pressure, tangent)


def test_what_slides_as_a_whole_is_loose_along_its_slip():
    watch = watch_of(HOLDS, [(ROUGH, 12)])
    names = ["along", "across"]
    for turn, name in zip((0.0, 0.5 * np.pi), names, strict=True):
        slip = HOLDS.directions[1 + names.index(name), 0]
        axis = "xyz"[int(np.argmax(np.abs(slip)))]
        pressure, tangent = state(ROUGH, ["slide"] * 12, np.full(12, turn))
        with pytest.raises(ConvergenceError, match=rf"'middle' from moving along {axis};"):
            watch.check(pressure, tangent)
        # Slip that spreads to all sides leaves no direction free.
        watch.check(*state(ROUGH, ["slide"] * 12, np.linspace(0.0, np.pi, 12)))


def test_a_state_on_the_verge_of_sliding_explains_a_failure():
    """The elements still stick, at their limit: the next step would find no equilibrium."""
    watch = watch_of(HOLDS, [(ROUGH, 12)])
    pressure, tangent = state(ROUGH, ["stick"] * 12, np.zeros(12))
    limit = ROUGH.friction.coefficient * ROUGH.preload
    watch.check(pressure, tangent)
    for part in (0.5, 0.999):
        value = np.stack([np.zeros(12), np.full(12, part * limit), np.zeros(12)])
        if part < 0.9:
            watch.explain(Traction(value, tangent, np.zeros((2, 12))))
        else:
            with pytest.raises(ConvergenceError, match="'middle' from moving along"):
                watch.explain(Traction(value, tangent, np.zeros((2, 12))))
