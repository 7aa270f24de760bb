"""Estimators that are exported."""

import pytest
from machine_logs import machine_log

from calibrate.learning.learn import learn
from estimator.fchs.estimator import Fchs
from estimator.learned.estimator import Learned
from thermojoint.models.assembly import assemble


@pytest.fixture(scope="session")
def fchs(hand_made_model):
    """For samples every 20 s."""
    return Fchs(assemble(hand_made_model, 20.0, 7200.0))


@pytest.fixture(scope="session")
def learned():
    return Learned(learn([machine_log()], ["x_um", "z_um"], 4))
