"""A machine like another is learned from few readings, and one that is the same is left alone."""

from dataclasses import replace

import numpy as np
import pytest
from machine_logs import as_csv, changed, machine_log
from typer.testing import CliRunner

import thermojoint as tj
from calibrate.learning.learn import learn
from calibrate.learning.rules import Transfer
from calibrate.learning.transfer import Prior, Readings, fitted, learn_like
from estimator.learned.estimator import Learned
from estimator.learned.judging import judge
from thermojoint.artefacts.errors import InputError
from thermojoint.cli.app import app
from thermojoint.models.learned import MEAN, SISTER, read_learned, write_learned

AXES = ["x_um", "z_um"]
LOG = machine_log()


def like_it(log, factor=1.0, zero_um=0.0):
    """The log of a machine that moves by another factor, from another zero."""
    for name in AXES:
        log = changed(log, name, lambda values: factor * values + 1e-6 * zero_um)
    return log


def read_at(log, rows):
    """The log with displacements in some rows only."""

    def few(values):
        kept = np.full_like(values, np.nan)
        kept[list(rows)] = values[list(rows)]
        return kept

    for name in AXES:
        log = changed(log, name, few)
    return log


FEW = range(240, 840, 75)
WEAKER = like_it(LOG, 0.7, 20.0)
DAY = like_it(machine_log(hours=10.0, seed=5, start=500000.0), 0.7, 20.0)


@pytest.fixture(scope="module")
def sister():
    return learn([LOG], AXES, 4)


def rms(model, day=DAY):
    return np.array([row["rms_error_um"] for row in judge("day", Learned(model), day)])


def test_few_readings_of_a_weaker_machine_beat_the_model_of_its_sister_on_another_day(sister):
    model = learn_like([read_at(WEAKER, FEW)], AXES, [sister])
    assert (rms(model) < 0.5 * rms(sister)).all()
    rows = judge("day", Learned(model), DAY)
    assert all(row["band_cover"] > 0.9 for row in rows)
    errors = model.learned_from.errors_um
    assert set(errors) == {"learned", SISTER, MEAN}
    assert (np.array(errors["learned"]) < errors[SISTER]).all()
    # Two readings make a block: the worst one is worse than all together.
    worst = model.learned_from.worst_um
    assert all((np.array(worst[kind]) > 1.05 * np.array(errors[kind])).all() for kind in errors)
    assert model.learned_from.best("learned") == "learned"


def test_readings_that_the_sister_explains_change_little(sister):
    same = like_it(machine_log(hours=10.0, seed=5, start=500000.0), 1.0, 20.0)
    model = learn_like([read_at(like_it(LOG, 1.0, 20.0), FEW)], AXES, [sister])
    moved = replace(
        sister,
        channels=tuple(replace(one, zero=one.zero + 20e-6) for one in sister.channels),
    )
    assert (rms(model, same) < rms(moved, same) + 0.5).all()


@pytest.mark.parametrize("rows", [[540], [240], [465, 540]])
@pytest.mark.parametrize("size_um", [-999.0, 100.0])
def test_a_reading_far_from_what_the_others_and_the_sister_let_expect_is_left_out(
    sister, rows, size_um
):
    def misread(values):
        values[rows] = 1e-6 * size_um
        return values

    model = learn_like([read_at(changed(WEAKER, "x_um", misread), FEW)], AXES, [sister])
    origin = model.learned_from
    told = [text for text in (*origin.faults, *origin.warnings) if "left out" in text]
    assert told
    assert all(text.startswith("x_um: ") for text in told)
    assert rms(model)[0] < 0.8


@pytest.mark.parametrize("log", [WEAKER, like_it(LOG, -3.0, 2000.0), like_it(LOG, 3.0)])
def test_no_reading_of_a_very_different_machine_is_left_out(sister, log):
    origin = learn_like([read_at(log, FEW)], AXES, [sister]).learned_from
    assert "left out" not in " ".join((*origin.faults, *origin.warnings))


def test_too_few_readings_are_refused_with_the_one_that_was_left_out(sister):
    def misread(values):
        values[540] = 300e-6
        return values

    few = read_at(changed(WEAKER, "x_um", misread), range(240, 840, 150))
    with pytest.raises(InputError, match=r"x_um: 3 readings, .*; x_um: 300 um 9.0 h after"):
        learn_like([few], AXES, [sister])


def test_each_run_has_its_own_zero(sister):
    early, late = (read_at(like_it(LOG, 0.7, zero), FEW) for zero in (0.0, 200.0))
    model = learn_like([early, late], AXES, [sister])
    assert model.learned_from.errors_um["learned"][0] < 2.0


def test_a_model_is_known_for_as_long_as_its_longest_run_wherever_clocks_begin(sister):
    other = read_at(machine_log(hours=10.0, seed=5, start=20000.0), range(240, 600, 75))
    model = learn_like([read_at(LOG, FEW), other], AXES, [sister])
    assert model.duration_s == sister.duration_s


def test_two_sisters_are_one_prior_with_their_spread(sister):
    other = learn_like([read_at(WEAKER, FEW)], AXES, [sister])
    between = like_it(LOG, 0.85)
    one = learn_like([read_at(between, FEW)], AXES, [sister])
    both = learn_like([read_at(between, FEW)], AXES, [sister, other])
    assert both.features == one.features == sister.features


def test_more_readings_leave_less_of_the_prior():
    draw = np.random.default_rng(0)
    prior = Prior(0.0, 1e-4, np.array([1e-5, 2e-5]), np.zeros((2, 2)), 1e-7)
    wanted = np.array([1.4e-5, 1.5e-5])
    features = draw.standard_normal((200, 2))
    readings = Readings(
        3600.0 * np.arange(200.0), np.zeros(200, dtype=int), features, features @ wanted
    )
    few, many = (fitted(readings.at(np.arange(n)), prior, Transfer()) for n in (4, 200))
    np.testing.assert_allclose(many.weights, wanted, rtol=0.05)
    assert (np.diag(many.covariance) < np.diag(few.covariance)).all()
    assert np.linalg.eigvalsh(many.covariance).min() > -1e-24


def test_what_does_not_fit_is_refused(sister):
    few = read_at(WEAKER, FEW)
    for log, models, said in (
        (read_at(WEAKER, []), [sister], "x_um: 0 readings"),
        (read_at(WEAKER, [700, 800]), [sister], "x_um: 2 readings"),
        (few, [], "give the model"),
        (few, [sister, learn([LOG], AXES, 1)], "model 2 has other features"),
        (
            changed(few, sister.sensors[0], lambda values: values * 0.0 + 300.0),
            [sister],
            "never moves .* the model given by --like reads it",
        ),
    ):
        with pytest.raises(InputError, match=said):
            learn_like([log], AXES, models)
    with pytest.raises(InputError, match="--like"):
        learn_like([few], ["w_um"], [sister])


def test_the_command_and_the_public_function_learn_the_same(sister, tmp_path):
    write_learned(sister, tmp_path / "sister.json")
    log = as_csv(read_at(WEAKER, FEW), tmp_path / "readings.csv")
    words = ["learn", log, "--displacement", "x_um", "--like", tmp_path / "sister.json"]
    told = CliRunner().invoke(app, [*map(str, words), "--out", str(tmp_path / "model.json")])
    assert told.exit_code == 0, told.output
    assert "sister" in told.output
    found = read_learned(tmp_path / "model.json")
    same = tj.learn(log, "x_um", like=[sister])
    assert found.channels == same.channels
    refused = CliRunner().invoke(
        app, [*map(str, words), "--kind", "ridge", "--out", str(tmp_path / "other.json")]
    )
    assert "--kind" in str(refused.exception)
