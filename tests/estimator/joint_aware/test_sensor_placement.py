"""Sensors are placed where they tell most of the displacement."""

import copy
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nested_toml import as_toml
from scipy.linalg import solve_discrete_are
from typer.testing import CliRunner

from calibrate.joint_aware.misfit import physics_with
from calibrate.placement import joint_aware as placement
from calibrate.placement import plant_family
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from fesim.setup.structure import candidate_probes
from thermojoint.artefacts.errors import ConvergenceError, InputError
from thermojoint.cli.app import app
from thermojoint.reduced.machine import reduce_machine
from thermojoint.reduced.physics import simulate_known

BOXES = [
    {"body": "column", "low_mm": [550.0, 400.0, 0.0], "high_mm": [550.0, 800.0, 200.0]},
    {"body": "column", "low_mm": [650.0, 400.0, 50.0], "high_mm": [650.0, 700.0, 125.0]},
]


@pytest.fixture(scope="module")
def data(coarse_data):
    found = copy.deepcopy(coarse_data)
    found["march"] |= {"thermal": "reduced"}
    found["candidates"] = [box | {"spacing_mm": 200.0} for box in BOXES]
    return found


@pytest.fixture(scope="module")
def whole(data):
    case = case_from_data(data, "case", Path())
    setup = set_up(case)
    return reduce_machine(case, setup, list(candidate_probes(case, setup.structure)))


@pytest.fixture(scope="module")
def machine(whole):
    return plant_family.fewer_modes(whole)


@pytest.fixture(scope="module")
def family(machine):
    return plant_family.make_family(machine, plant_family.Drawing(plants=2))


def test_few_modes_answer_a_slow_heating_as_all_of_them(whole, machine):
    assert len(machine.capacity) < 0.6 * len(whole.capacity)
    inputs = np.tile(np.append(machine.power, 1.0), (60, 1))
    answers = []
    for one in (whole, machine):
        answers.append(simulate_known(physics_with(one, {}), inputs, plant_family.USUAL.step))
    for every, few in zip(*answers, strict=True):
        assert few == pytest.approx(every, abs=0.01 * np.abs(every).max())


@settings(max_examples=20)
@given(
    st.integers(2, 8),
    st.integers(1, 3),
    st.integers(0, 2**32 - 1),
)
def test_doubling_solves_the_riccati_equation_of_the_general_solver(size, sensors, seed):
    rng = np.random.default_rng(seed)
    transition = np.diag(rng.uniform(0.2, 0.99, size)) + 0.02 * rng.normal(size=(size, size))
    rows = rng.normal(size=(sensors, size))
    root = rng.normal(size=(size, size))
    variance = rng.uniform(0.1, 1.0, sensors)
    found = placement.steady_covariance(transition, rows, root @ root.T, variance)
    wanted = solve_discrete_are(transition.T, rows.T, root @ root.T, np.diag(variance))
    # The general solver loses digits where the system is ill-conditioned; the equation does not.
    assert found == pytest.approx(wanted, rel=1e-4, abs=1e-4 * np.abs(wanted).max())
    seen = rows @ found
    gain = np.linalg.solve(seen @ rows.T + np.diag(variance), seen).T
    again = transition @ (found - gain @ seen) @ transition.T + root @ root.T
    assert again == pytest.approx(found, rel=0, abs=1e-9 * np.abs(found).max())


def test_a_walk_that_no_sensor_sees_has_no_steady_covariance():
    with pytest.raises(ConvergenceError):
        placement.steady_covariance(np.eye(2), np.array([[1.0, 0.0]]), np.eye(2), np.ones(1))


def test_no_single_candidate_is_better_than_the_first_that_was_chosen(machine, family):
    found = placement.place_sensors(machine, 1, family=family)
    best = np.square(found.chosen.band).sum()
    for name in machine.sensor_names:
        alone = placement.place_sensors(machine, 1, [name], family).chosen
        assert np.square(alone.band).sum() >= best * (1 - 1e-9)


def test_exchanges_never_make_a_choice_worse_and_leave_what_is_kept(machine, family):
    kept = machine.sensor_names[-1]
    found = placement.place_sensors(machine, 3, [kept], family)
    assert found.chosen.names[0] == kept
    assert len(set(found.chosen.names)) == 3
    assert [len(step.names) for step in found.steps] == [1, 2, 3]
    assert np.square(found.chosen.band).sum() <= np.square(found.steps[-1].band).sum()


@pytest.fixture(scope="module")
def motored(data):
    """The machine with a motor at its rear, and its family."""
    sources = data["sources"] | {"motor": {"surface": "rear", "reference_power_W": 100.0}}
    case = case_from_data(data | {"sources": sources}, "case", Path())
    setup = set_up(case)
    names = list(candidate_probes(case, setup.structure))
    machine = plant_family.fewer_modes(reduce_machine(case, setup, names))
    return machine, plant_family.make_family(machine, plant_family.Drawing(plants=2))


def test_the_first_sensors_beside_one_that_is_kept_are_at_the_other_sources(motored):
    """The first source got one beside the kept one, and the other none: in this order only."""
    machine, family = motored
    names, step = machine.sensor_names, family.step
    closest = [names[at] for at in plant_family.loudest(machine, step)]
    others = [name for name in names if name not in closest]
    kept = next(
        name
        for name in others
        if [*plant_family.unseen_sources(machine, [name], step)] == ["motor"]
    )
    begun = placement.place_sensors(machine, 2, [kept], family).steps[0]
    assert begun.names == (kept, closest[1])


def test_sources_with_the_same_candidate_do_not_get_it_twice(motored, monkeypatch):
    machine, family = motored
    monkeypatch.setattr(placement, "loudest", lambda *_: [0, 0])
    begun = placement.place_sensors(machine, 2, (), family).steps[0]
    assert begun.names[0] == machine.sensor_names[0]
    assert len(set(begun.names)) == 2


def test_a_plant_like_the_model_leaves_what_the_heat_walks_between_two_readings(machine, family):
    """Without any difference of the plants the sensor that hears of the heat first is the best."""
    alike = replace(
        family,
        readings=np.zeros_like(family.readings),
        displacement=np.zeros_like(family.displacement),
    )
    chosen = placement.place_sensors(machine, 1, family=alike).chosen.names[0]
    physics = physics_with(machine, {})
    soon, _ = simulate_known(physics, np.array([[*machine.power, 0.0]]), plant_family.USUAL.step)
    ranks = np.argsort(-soon[0])[:3]
    assert chosen in [machine.sensor_names[k] for k in ranks]


@pytest.mark.parametrize(
    ("count", "kept", "what"),
    [(0, [], "ask for 1 to"), (999, [], "candidates"), (2, ["nowhere"], "nowhere")],
)
def test_a_choice_that_cannot_be_is_refused_in_one_line(machine, count, kept, what):
    with pytest.raises(InputError, match=what) as caught:
        placement.place_sensors(machine, count, kept)
    assert "\n" not in str(caught.value)


def test_the_command_refuses_such_a_choice_before_it_draws_machines(data, tmp_path, monkeypatch):
    monkeypatch.setattr(plant_family, "make_family", lambda _: pytest.fail("minutes of work"))
    case = tmp_path / "machine.toml"
    case.write_text(as_toml(data))
    words = ["place", str(case), "--count", "0", "--out", str(tmp_path / "sensors.toml")]
    assert "ask for 1 to" in str(CliRunner().invoke(app, words).exception)


def test_the_command_writes_probes_that_a_case_takes(data, tmp_path):
    case, out = tmp_path / "machine.toml", tmp_path / "sensors.toml"
    case.write_text(as_toml(data))
    words = ["place", case, "--count", "2", "--keep", "a", "--out", out]
    result = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert result.exit_code == 0
    assert "after exchanges" in result.stdout
    text = out.read_text()
    assert "The case has already: a." in text
    found = tomllib.loads(text)["probes"]
    assert len(found) == 1
    given = copy.deepcopy(data)
    given["probes"] |= found
    given["candidates"] = []
    case_from_data(given, "case", Path())


def test_the_command_refuses_to_replace_its_case(data, tmp_path):
    case = tmp_path / "machine.toml"
    case.write_text(as_toml(data))
    result = CliRunner().invoke(app, ["place", str(case), "--out", str(case)])
    assert isinstance(result.exception, InputError)


def test_a_probe_to_be_kept_that_is_not_there_is_refused_in_one_line(data, tmp_path):
    case, out = tmp_path / "machine.toml", tmp_path / "sensors.toml"
    case.write_text(as_toml(data))
    words = ["place", str(case), "--keep", "nowhere", "--out", str(out)]
    result = CliRunner().invoke(app, words)
    assert isinstance(result.exception, InputError)
    assert len(str(result.exception)) < 200
    assert not out.exists()
