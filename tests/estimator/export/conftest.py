"""Estimators that are exported."""

import pytest
from machine_logs import machine_log

from calibrate.learning.learn import learn
from estimator.export.program import Precision
from estimator.exporting import export_program
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


@pytest.fixture(scope="session")
def joint_aware_program(estimator):
    """The joint-aware estimator in double precision, with samples of its own."""
    return export_program(estimator, Precision.DOUBLE, "m")
