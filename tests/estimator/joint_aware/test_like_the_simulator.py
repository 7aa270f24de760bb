"""What the joint-aware estimator takes of a case: its observer without updates is the simulator."""

import numpy as np
import pytest
from observed import errors, estimates, observer

from calibrate.joint_aware import misfit
from calibrate.joint_aware.calibration import sensors_of
from calibrate.joint_aware.left_out import samples_of
from calibrate.joint_aware.misfit import physics_with
from calibrate.joint_aware.readings import held_in, run_in
from estimator.interface import Status
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.joint_aware.model_file import read_observer, write_observer
from estimator.joint_aware.readings import samples_in, temperatures_in
from estimator.kind import Cold
from estimator.noise import with_noise
from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import column_named
from thermojoint.reduced.machine import reduce_machine
from thermojoint.reduced.physics import at_start, simulate_known
from thermojoint.verification.loaded import STANDING, WEIGHT, column_case, joint

PRESSED = joint(preload_MPa=2.0)
LOOSE = joint(preload_MPa=0.0, initial_opening_um=0.2, reference_pressure_MPa=8.0)
TOUCHING = LOOSE | {"initial_opening_um": 0.0}
GAS = {"gas_conductivity_W_mK": 0.026, "temperature_jump_um": 0.4}
RADIATION = {"emissivity_a": 0.8, "emissivity_b": 0.6, "ambient_degC": 20.0}
CUT = {"surface": "top", "force_N": [300.0, 100.0, -3000.0], "file": "cut.csv"}
BOLT = {
    "head": {"position_mm": [15, 25, 400], "diameter_mm": 10.0, "body": "upper"},
    "thread": {"position_mm": [15, 25, 100], "diameter_mm": 10.0, "body": "lower"},
    "force_kN": 12.0,
    "material": "iron",
    "diameter_mm": 12.0,
}
TABLE = "rise_K,pressure_MPa,conductance_W_m2K\n0,0.1,3e3\n0,4,2e4\n50,0.1,2e3\n50,4,1.5e4\n"
#: What is taken, as sections of a case.
TAKEN = {
    "fixed": {"joints": {"joint": PRESSED | {"conductance": {"law": "fixed", "value_W_m2K": 4e3}}}},
    "none": {"joints": {"joint": PRESSED | {"conductance": {"law": "none"}}}},
    "table": {"joints": {"joint": PRESSED | {"conductance": {"law": "table", "file": "h.csv"}}}},
    "gas": {"joints": {"joint": PRESSED | {"gap": GAS | RADIATION}}},
    "open": {
        "joints": {"joint": LOOSE | {"gap": GAS}},
        "supports": {
            "fixed": ["foot"],
            "springs": {"top": {"stiffness_N_um": [20.0, 20.0, 20.0]}},
        },
        "loads": {"cut": CUT},
    },
    "wall": STANDING | {"supports": {"symmetry": {"back": "x", "side": "y"}}},
    "warm": {"joints": {"joint": PRESSED}, "initial_temperature": {"expression_K": "90 * z_m"}},
    "held": {
        "joints": {"joint": PRESSED},
        "held_temperatures": {"foot": {"file": "coolant.csv"}, "back": {"rise_K": 5.0}},
        "initial_temperature": {"rise_K": 2.0},
    },
    "warm wall": STANDING
    | {
        "supports": {"symmetry": {"back": "x", "side": "y"}},
        "held_temperatures": {"floor": {"file": "coolant.csv"}},
    },
    "loads": {"joints": {"joint": PRESSED}, "loads": {**WEIGHT, "cut": CUT}},
    "bolts": {"joints": {"joint": TOUCHING}, "bolts": {"b": BOLT}, "loads": {"cut": CUT, **WEIGHT}},
}


def case_of(folder, sections):
    """A column heated in its lower part, its foot held unless it stands on a wall."""
    (folder / "cut.csv").write_text("time_s,factor\n0,0.5\n60,1\n65,-0.2\n200,0.4\n")
    (folder / "coolant.csv").write_text("time_s,rise_K\n0,0\n100,8\n300,-3\n")
    (folder / "h.csv").write_text(TABLE)
    split = "walls" not in sections
    data = column_case(folder, split, {"supports": {"fixed": ["foot"]}, **sections})
    data["sources"] = {"heater": {"body": "lower", "reference_power_W": 60.0}}
    data["heat_input"] = {"kind": "step", "level": 2.0}
    data["convection_W_m2K"] = {"top": 40.0}
    data["probes"]["Q"] = {"position_mm": [40.0, 40.0, 60.0], "body": "lower"}
    data["march"] |= {"step_s": 5.0, "duration_min": 10.0}
    return case_from_data(data, "column", folder)


@pytest.fixture(scope="module", params=TAKEN)
def followed(request, tmp_path_factory):
    case = case_of(tmp_path_factory.mktemp(request.param), TAKEN[request.param])
    setup = set_up(case)
    machine = reduce_machine(case, setup, ("P", "Q"))
    return machine, simulate(case, setup=setup).response


def test_the_reduced_machine_marches_as_the_simulator(followed):
    machine, response = followed
    physics = physics_with(machine, {})
    run = run_in(response, machine, "run")
    sensed, moved = simulate_known(physics, run.inputs, machine.step)
    warm, bent = at_start(physics)
    for found, name, first in ((sensed, "temperature", warm), (moved, "displacement", bent)):
        whole = np.vstack([first, found])
        np.testing.assert_allclose(whole, response[name], rtol=0.0, atol=1e-9)


def test_the_observer_without_updates_is_the_simulator(followed, tmp_path):
    """It has no thermometer and is told its inputs; its state goes through a file."""
    machine, response = followed
    model = observer(machine, {"run": response}).model
    write_observer(model, tmp_path / "model.h5")
    estimator = JointAware(read_observer(tmp_path / "model.h5"))
    state, moved = estimator.initial_state(), []
    rows = np.array(list(samples_in(response, ("P", "Q"), model.loads)))
    rows[:, 1:4] = np.nan
    # Heat, held surfaces, ambient.
    known = np.zeros((len(rows), len(model.surfaces) + 2))
    known[:, 0] = response["source_power"][:, 0]
    known[:, 1:-1] = held_in(response, machine)
    for (time, *values), inputs in zip(rows, known, strict=True):
        estimator.parts.views(state)["linear"][-inputs.size :] = inputs
        state, estimate = estimator.sample(state, time, values)
        moved.append(estimate.displacement)
    given = response["displacement"].sel(axis=list(estimator.axes))
    np.testing.assert_allclose(moved[1:], given[1:], rtol=0.0, atol=1e-9)


def test_tighter_bolts_and_other_friction_are_parameters(tmp_path):
    case = case_of(tmp_path, TAKEN["bolts"])
    machine = reduce_machine(case, set_up(case), ("P", "Q"))
    other = case.replace(
        bolts={"b": {"force_kN": 13.2}}, joints={"joint": {"friction_coefficient": 0.3}}
    )
    response = simulate(other).response
    physics = physics_with(machine, {"preload": 1.1, "friction": 1.5})
    _, moved = simulate_known(physics, run_in(response, machine, "run").inputs, machine.step)
    np.testing.assert_allclose(moved, response["displacement"][1:], rtol=0.0, atol=1e-9)


def test_a_held_temperature_that_changes_is_read_or_estimated(tmp_path):
    coolant = {"held_temperatures": {"foot": {"file": "coolant.csv"}}}
    case = case_of(tmp_path, {"joints": {"joint": PRESSED}} | coolant)
    setup = set_up(case)
    response = simulate(case, setup=setup).response
    sensors = sensors_of(case, {"run": response})
    assert sensors == ("P", "Q", "foot")
    estimator = observer(reduce_machine(case, setup, sensors), {"run": response}, ["z"])
    rows = [list(row) for row in samples_in(response, sensors)]
    _, read = estimates(estimator, rows)
    assert np.abs(errors(estimator, response, read)).max() < 0.5e-6
    for row in rows[1:]:
        row[3] = np.nan
    _, guessed = estimates(estimator, rows)
    assert np.abs(errors(estimator, response, guessed)).max() < 2.5e-6
    at = [channel.name for channel in estimator.details].index("held_foot")
    assert guessed[-1].details[at] == pytest.approx(-3.0, abs=1.0)
    assert guessed[-1].missing == ("foot",)


def test_noise_is_on_the_reading_of_a_held_surface_too(tmp_path):
    """No response had a probe of its name, so that `validate --noise-pp` refused the model."""
    coolant = {"held_temperatures": {"foot": {"file": "coolant.csv"}}}
    case = case_of(tmp_path, {"joints": {"joint": PRESSED}} | coolant)
    response, sensors = simulate(case).response, ("P", "foot")
    noisy = with_noise(response, sensors, 0.12, 0)
    added = temperatures_in(noisy, sensors) - temperatures_in(response, sensors)
    assert np.ptp(added, axis=0) == pytest.approx([0.12, 0.12])


def test_a_load_is_read_in_percent_and_lasts_where_it_is_missing(tmp_path):
    case = case_of(tmp_path, TAKEN["loads"])
    setup = set_up(case)
    response = simulate(case, setup=setup).response
    estimator = observer(reduce_machine(case, setup, ("P", "Q")), {"run": response})
    names = ("P_K", "Q_K", "ambient_K", "cut_percent")
    assert KIND.intake(estimator.model, True).names[: len(names)] == names
    read = np.array([[0.0, 0.0, 0.0, 0.5], [0.0, 0.0, 0.0, np.nan], [0.0, 0.0, 0.0, -0.2]])
    log = Log(np.array([0.0, 5.0, 10.0]), tuple(map(column_named, names)), read)
    state, found = estimator.initial_state(), []
    for time, *values in KIND.log(estimator.model, [log], "log.csv", None, Cold()):
        state, estimate = estimator.sample(state, time, values)
        found.append(estimate)
    assert found[1].missing == ("cut",)
    assert Status.READING_MISSING in found[1].status
    np.testing.assert_allclose(found[1].displacement, found[0].displacement, atol=1e-9)
    off = np.abs(found[2].displacement - found[1].displacement)
    assert off.max() > 1e-7
    # The runs had factors from -0.2 to 1; the band holds what they all do.
    assert (off > found[0].band).any()
    assert (off <= found[1].band).all()
    assert [Status.UNSETTLED in one.status for one in found] == [False, True, False]
    write_observer(estimator.model, tmp_path / "model.h5")
    assert read_observer(tmp_path / "model.h5").calibrated.loads == ((-0.2, 1.0),)
    with pytest.raises(InputError, match="no 'load_factor', needed for cut"):
        run_in(response.drop_vars("load_factor"), reduce_machine(case, setup, ("P",)), "run")
    with pytest.raises(InputError, match="export: the machine has loads"):
        KIND.program(estimator, None, 5.0)


@pytest.mark.parametrize("cold", [0.0, 0.7])
def test_a_run_begins_under_its_own_loads(tmp_path, cold):
    """The case begins under half of the load: what that does was added to a run without any."""
    case = case_of(tmp_path, {"joints": {"joint": PRESSED}, "loads": {"cut": CUT}})
    (tmp_path / "other.csv").write_text(f"time_s,factor\n0,{cold}\n60,1\n")
    setup = set_up(case)
    other = case.replace(loads={"cut": {"file": str(tmp_path / "other.csv")}})
    response = simulate(other).response
    assert response["displacement"][0].to_numpy().any() == bool(cold)
    machine = reduce_machine(case, setup, ("P", "Q"))
    run = run_in(response, machine, "run")
    _, displacement = misfit.errors(misfit.make_problem(machine, [run]), (), np.zeros(0))
    assert np.abs(displacement).max() < 1e-9
    driven = machine.power.size + len(machine.held.names)
    assert samples_of(run, driven)[:, -1] == pytest.approx(response["load_factor"][:, 0].to_numpy())


def test_what_is_not_taken_is_one_line(tmp_path):
    changing = {"bolts": {"b": BOLT | {"file": "cut.csv"}}}
    case = case_of(tmp_path, TAKEN["bolts"] | changing)
    with pytest.raises(InputError, match="its force changes with time"):
        reduce_machine(case, set_up(case), ("P", "Q"))
