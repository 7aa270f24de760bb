"""The coarse machine with a sensor on its source, and the observer that knows it."""

from dataclasses import replace
from pathlib import Path

import pytest
from observed import MINUTE, PLACES, SENSORS, observed_data, run, step
from observed import observer as observer_of

from fesim.case.schema import case_from_data
from fesim.setup.machine import set_up
from thermojoint.reduced.machine import along, reduce_machine


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
def small(machine):
    """The machine with the two axes along which it moves."""
    return along(machine, ["x", "y"])


@pytest.fixture(scope="session")
def estimator(data, setup, machine):
    return observer_of(machine, {"step 2": run(data, setup, step(2.0))})


@pytest.fixture(scope="session")
def stepped(data, setup):
    """Ten minutes of heat input 1.5."""
    return run(data, setup, step(1.5))


@pytest.fixture(scope="session")
def spread_data(data):
    """The coarse machine with a thermometer on its source and on four faces."""
    probes = {name: {"position_mm": at, "body": body} for name, (body, at) in PLACES.items()}
    return data | {"probes": probes, "displacement": data["displacement"]}


@pytest.fixture(scope="session")
def spread_setup(spread_data):
    return set_up(case_from_data(spread_data, "case", Path()))


@pytest.fixture(scope="session")
def spread(spread_data, spread_setup):
    case = case_from_data(spread_data, "case", Path())
    machine = reduce_machine(case, spread_setup, tuple(PLACES))
    return along(replace(machine, step=MINUTE), ["x", "y"])
