"""The joint linearised at its preload: the machine that a Kalman filter alone can follow."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from general_rule import assert_general_rule, in_machine_code
from short_runs import QUICK

from calibrate.joint_aware.linear_joint import calibrate_linear_joint, with_linear_joint
from calibrate.joint_aware.misfit import physics_with
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import read_observer, write_observer
from estimator.joint_aware.readings import samples_in
from estimator.judging import judge
from estimator.sensor_faults import certainly_consistent
from fesim.case.schema import case_from_data
from fesim.case.thermal_sections import StepInput
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.paper.observers import fitted_text
from thermojoint.reduced.machine import along, reduce_machine
from thermojoint.reduced.physics import simulate_known


@pytest.fixture(scope="module")
def case(coarse_data):
    data = copy.deepcopy(coarse_data)
    data["march"] |= {"thermal": "reduced", "duration_min": 10.0, "step_s": 10.0}
    return case_from_data(data, "case", Path())


@pytest.fixture(scope="module")
def setup(case):
    return set_up(case)


@pytest.fixture(scope="module")
def machine(case, setup):
    return along(reduce_machine(case, setup, ("a", "b", "T1", "T2")), ["x", "y"])


@pytest.fixture(scope="module")
def responses(case, setup):
    return {"step 1.0": simulate(case, setup=setup).response}


@pytest.fixture(scope="module")
def calibrated(machine, responses):
    return calibrate_linear_joint(machine, responses, fitted=[], effort=QUICK)


def run_at(case, setup, level):
    heat = StepInput(kind="step", level=level)
    return simulate(case.model_copy(update={"heat_input": heat}), setup=setup).response


def marched(machine, level):
    physics = physics_with(machine, {})
    inputs = np.tile(np.append(level * machine.power, 0.0), (60, 1))
    return np.hstack(simulate_known(physics, inputs, machine.step)) / level


def test_near_the_preload_the_machine_is_its_linear_one(machine):
    linear = marched(with_linear_joint(machine), 1.0)
    small = np.abs(marched(machine, 1e-4) - linear).max(axis=0)
    large = np.abs(marched(machine, 2.0) - linear).max(axis=0)
    assert (small < 1e-3 * np.abs(linear).max(axis=0)).all()
    assert (small < 0.01 * large).all()


def test_the_linear_machine_is_proportional_to_its_heat(machine):
    linear = with_linear_joint(machine)
    assert marched(linear, 3.0) == pytest.approx(marched(linear, 1.0), rel=1e-9, abs=1e-12)


def test_its_estimator_says_what_it_is_and_has_no_joint(calibrated, tmp_path):
    write_observer(calibrated.model, tmp_path / "model.h5")
    estimator = JointAware(read_observer(tmp_path / "model.h5"))
    assert estimator.kind == "kalman-linear"
    assert not estimator.model.joints
    assert not {"friction", "preload", "roughness"} & set(estimator.model.factors)


def test_a_model_of_an_unknown_kind_is_refused(calibrated, tmp_path):
    write_observer(replace(calibrated.model, kind="oracle"), tmp_path / "model.h5")
    with pytest.raises(InputError, match="not a whole joint-aware model"):
        read_observer(tmp_path / "model.h5")


FITTED = ("heat", "film", "film interior, W/m2K")


def test_the_report_says_what_became_of_every_parameter(machine, responses):
    found = calibrate_linear_joint(machine, responses, fitted=FITTED, effort=QUICK)
    lines = fitted_text(JointAware(found.model)).splitlines()
    assert [line.split()[0] for line in lines] == ["heat", "film", "film"]
    absolute = [line for line in lines if "W/m2K" in line]
    assert len(absolute) == 1
    assert all("of the case's value" in line for line in lines if line not in absolute)
    assert all("uncertain by" in line for line in lines)


def test_it_follows_the_step_it_was_calibrated_with(calibrated, responses):
    estimator, response = JointAware(calibrated.model), responses["step 1.0"]
    seen = samples_in(response, estimator.model.sensors)
    for row in judge("step", response, estimator, seen):
        assert row["max_abs_error_um"] < 0.05 * row["peak_total_um"]
        assert row["rms_error_um"] < 0.02 * row["peak_total_um"]


def test_readings_that_its_joint_does_not_explain_are_taken_in_machine_code_as_well(
    calibrated, case, setup
):
    """Heat of six times the step that it knows: the joint of the machine is not linear."""
    hot = run_at(case, setup, 6.0)
    rows = list(samples_in(hot, calibrated.model.sensors))
    estimator, taken, far = JointAware(calibrated.model), [], []
    assert_general_rule(estimator, rows)
    for (_, *readings), (before, quick) in zip(rows, in_machine_code(estimator, rows), strict=True):
        predicted = estimator.observer.system.rows @ before.linear
        far.append(not certainly_consistent(readings - predicted, estimator.thresholds.faults))
        taken.append(quick)
    assert sum(one for one, off in zip(taken, far, strict=True) if off) > 0
    assert sum(not one for one in taken) < 0.2 * len(taken)
