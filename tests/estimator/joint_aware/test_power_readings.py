"""A power that a control knows tells of a source's heat before the thermometers do."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported import SANITISED, as_in_python, needs_gcc, selftest, written
from matiec import needs_matiec, selftest_by_both
from observed import assert_goes_on, errors, estimates, observer, run, step

from calibrate.joint_aware.calibration import Effort, calibrate_joint_aware
from calibrate.joint_aware.open_band import Drawing
from calibrate.joint_aware.physics_fit import Search
from estimator.exporting import export_program
from estimator.interface import Status
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.kind import KIND
from estimator.joint_aware.model_file import read_observer, write_observer
from estimator.joint_aware.readings import samples_in
from estimator.kind import Options
from fesim.case.schema import case_from_data
from thermojoint.artefacts.errors import InputError
from thermojoint.reduced.machine import reduce_machine

#: Thermometers away from the source, which see its heat minutes later.
SENSORS = ("T1", "T2")
SHARE = 0.3


def with_share(data):
    source = data["sources"]["bearings"] | {"power_share": SHARE}
    return case_from_data(data | {"sources": {"bearings": source}}, "case", Path())


@pytest.fixture(scope="module")
def told(data, setup, stepped):
    """An observer that reads the power of the bearings."""
    machine = reduce_machine(with_share(data), setup, SENSORS)
    found = observer(machine, {"step": stepped})
    return replace(found, model=replace(found.model, power_shares=machine.power_shares))


@pytest.fixture(scope="module")
def blind(told):
    """The same that only its thermometers tell."""
    return replace(told, model=replace(told.model, power_shares={}))


@pytest.fixture(scope="module")
def response(data, setup):
    return run(data, setup, step(2.0), minutes=8.0)


def samples(response, estimator, factor=1.0):
    shares = estimator.model.power_shares
    rows = np.array(list(samples_in(response, SENSORS, shares=shares)))
    rows[:, 4:] *= factor
    return rows.tolist()


def largest(estimator, response, rows):
    _, found = estimates(estimator, rows)
    return np.abs(errors(estimator, response, found)).max()


def test_heat_is_known_before_the_thermometers_see_it(blind, told, response):
    without = largest(blind, response, samples(response, blind))
    assert largest(told, response, samples(response, told)) < 0.1 * without
    # The thermometers correct a share that is wrong.
    for factor in (0.7, 1.3):
        assert largest(told, response, samples(response, told, factor)) < 0.5 * without


@pytest.mark.parametrize("power", [np.nan, 1e9, -1e9], ids=["none", "much", "negative"])
def test_a_power_that_is_none_changes_nothing(blind, told, response, power):
    """The heat stays what thermometers and the last power have told."""
    rows = np.array(samples(response, told))
    rows[:, 4] = power
    _, found = estimates(told, rows.tolist())
    _, alone = estimates(blind, samples(response, blind))
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_allclose(one.displacement, other.displacement, atol=1e-15)
    assert found[5].missing == ("bearings_power",)
    assert Status.READING_MISSING in found[5].status


@pytest.fixture(scope="module")
def switched_off_unseen(data, setup, told, tmp_path_factory):
    """A run, and its samples; the power is off when it is read again after ten minutes."""
    path = tmp_path_factory.mktemp("heat") / "heat.csv"
    path.write_text("time_s,heat_input\n0,2\n300,2\n302,0\n1200,0\n")
    response = run(data, setup, {"kind": "sampled", "file": str(path)}, minutes=20.0)
    rows = np.array(samples(response, told))
    rows[145:450, 4] = np.nan
    return response, rows.tolist()


def test_what_thermometers_found_is_not_told_again_by_a_power_that_is_back(
    blind, told, switched_off_unseen
):
    """The heat fell twice, and the estimate by as much as the switch had moved it."""
    response, rows = switched_off_unseen
    _, found = estimates(told, rows)
    _, alone = estimates(blind, samples(response, blind))
    for one, other in zip(found[450:], alone[450:], strict=True):
        np.testing.assert_allclose(one.displacement, other.displacement, atol=0.05e-6)
    np.testing.assert_allclose([one.details[0] for one in found[450:]], 0.0, atol=30.0)


@needs_gcc
def test_nor_in_its_program(told, program, switched_off_unseen, tmp_path):
    as_in_python(program, told, switched_off_unseen[1], tmp_path)


def test_a_run_goes_on_from_its_state(told, response):
    assert_goes_on(told, samples(response, told))


def test_a_calibration_gives_its_model_the_shares_of_the_case(data, stepped):
    effort = Effort(Search(starts=0, steps=20, evaluations=2), Drawing(draws=2, duration=600.0))
    case = with_share(data)
    found = calibrate_joint_aware(case, {"1.5": stepped}, SENSORS, fitted=["film"], effort=effort)
    assert found.model.power_shares == {"bearings": SHARE}
    rows = np.array(list(samples_in(stepped, SENSORS, shares=found.model.power_shares)))
    assert largest(JointAware(found.model), stepped, rows.tolist()) < 1e-6


def test_file_log_and_service_know_the_power(told, tmp_path):
    write_observer(told.model, tmp_path / "model.h5")
    assert read_observer(tmp_path / "model.h5").power_shares == {"bearings": SHARE}
    intake = KIND.intake(told.model, True)
    assert intake.names == ("T1_K", "T2_K", "ambient_K", "bearings_power_W", "x_um", "y_um")
    given, _ = intake.convert([1.0, 2.0, 0.5, 900.0, np.nan, np.nan], 0.0)
    assert given[:4] == pytest.approx([1.0, 2.0, 0.5, 900.0])
    with pytest.raises(InputError, match="whose powers are read"):
        KIND.start(told.model, Options(ageing=("film",)))


@pytest.fixture(scope="module")
def program(told, response):
    return export_program(told, name="m", samples=samples(response, told))


@needs_gcc
def test_its_program_knows_the_power(program, tmp_path):
    figures = selftest(written(program, tmp_path), "m", "-O1", *SANITISED)
    assert figures["largest displacement"] > 20e-6
    assert figures["state"] == program.state


@needs_gcc
def test_a_power_that_is_none_is_missing_in_its_program(told, response, program, tmp_path):
    rows = np.array(samples(response, told))
    rows[30:60, 4] = np.nan
    as_in_python(program, told, rows.tolist(), tmp_path)


@pytest.mark.long
@needs_gcc
@needs_matiec
def test_its_function_block_knows_the_power(program, tmp_path):
    selftest_by_both(program, tmp_path)
