"""The coarse machine with a sensor on its source, and the observer that knows it."""

from pathlib import Path

import pytest
from observed import SENSORS, observed_data, run, step
from observed import observer as observer_of

from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from thermojoint.reduced.machine import reduce_machine


@pytest.fixture(scope="session")
def data(coarse_data):
    """The coarse machine on its reduced model, with a sensor on the source."""
    return observed_data(coarse_data)


@pytest.fixture(scope="session")
def setup(data):
    return set_up(case_from_data(data, "case", Path()))


@pytest.fixture(scope="session")
def machine(data, setup):
    return reduce_machine(case_from_data(data, "case", Path()), setup, SENSORS)


@pytest.fixture(scope="session")
def estimator(data, setup, machine):
    return observer_of(machine, {"step 2": run(data, setup, step(2.0))})


@pytest.fixture(scope="session")
def stepped(data, setup):
    """Ten minutes of heat input 1.5."""
    return run(data, setup, step(1.5))
