"""What the tests of the service share."""

from pathlib import Path
from typing import NamedTuple

import pytest
import xarray as xr
from observed import SENSORS, observed_data, observer, run, step

from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.readings import samples_in
from fesim.case.schema import Case, case_from_data
from fesim.setup.machine import Setup, set_up
from thermojoint.models.assembly import assemble
from thermojoint.models.assembly_file import write_assembly
from thermojoint.reduced.machine import reduce_machine


@pytest.fixture(scope="session")
def model(hand_made_model, tmp_path_factory):
    """A model of one-second samples, as a file."""
    path = tmp_path_factory.mktemp("model") / "model.json"
    write_assembly(assemble(hand_made_model, 1.0, 7200.0), path)
    return path


class Watched(NamedTuple):
    """A coarse machine that warms up for some minutes, and its observer."""

    case: Case
    setup: Setup
    response: xr.Dataset
    estimator: JointAware

    @property
    def samples(self):
        return list(samples_in(self.response, self.estimator.model.sensors))


@pytest.fixture(scope="session")
def watched(coarse_data):
    data = observed_data(coarse_data)
    case = case_from_data(data, "case", Path())
    setup = set_up(case)
    response = run(data, setup, step(1.0), 4.0)
    machine = reduce_machine(case, setup, SENSORS)
    return Watched(case, setup, response, observer(machine, {"step": response}))
