"""What a control repeats until the next probing is read once."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from machine_logs import along_log, as_csv, changed, machine_log

from calibrate.learning.learn import learn
from thermojoint.artefacts.held_readings import REPEATED, is_held, without_repeats
from thermojoint.artefacts.log import joined
from thermojoint.artefacts.log_file import read_log


def held(values):
    """Each reading is repeated in the rows without one."""
    return pd.Series(values).ffill().to_numpy()


def probed(log, rows):
    return changed(log, "x_um", lambda x: np.where(np.arange(len(x)) % rows == 0, x, np.nan))


def in_parts(log, rows):
    return [log.part(slice(first, first + rows)) for first in range(0, len(log.times), rows)]


@pytest.mark.parametrize("rows", [3, 45])
def test_a_held_displacement_is_what_was_probed_in_pieces_of_any_length(rows):
    log = probed(machine_log(), rows)
    repeated = changed(log, "x_um", held)
    for size in (len(log.times), 300):
        found = joined(without_repeats(in_parts(repeated, size)))
        np.testing.assert_array_equal(found.values, log.values)


def test_its_repeats_are_reported_as_missing(tmp_path):
    log = probed(machine_log(), 30)
    found = read_log(as_csv(changed(log, "x_um", held), tmp_path / "log.csv"))
    assert found.records[0].missing == {("x_um", REPEATED): np.isnan(log.at("x_um")).sum()}
    np.testing.assert_array_equal(np.isnan(found.values), np.isnan(log.values))


def test_a_line_along_an_axis_is_learned_at_the_positions_of_the_probings():
    log = along_log()[0]
    repeated = changed(log, "x_um", held)
    models = [learn([one], ["x_um@y_pos_mm"], 4) for one in (log, *without_repeats([repeated]))]
    assert models[0].channels == models[1].channels


@given(
    step=st.sampled_from([0.01, 0.02, 0.1, 0.25, 0.5, 1.0, 2.54]),
    every=st.sampled_from([1, 10, 60]),
    still=st.floats(0.0, 0.9),
    seed=st.integers(0, 100),
)
def test_a_coarse_display_of_a_machine_that_mostly_stands_still_is_not_held(
    step, every, still, seed
):
    """A display of a probe that reads all the time is left by one step."""
    draw = np.random.default_rng(seed)
    times = np.arange(0.0, 8.0 * 3600.0, float(every))
    moving = times > still * times[-1]
    heat = moving * (np.sin(2e-3 * times + draw.uniform(0.0, 6.0)) > 0.0)
    grown = 20.0 * pd.Series(heat).ewm(halflife=1200.0 / every).mean().to_numpy()
    assert not is_held(1e-6 * step * np.round(grown / step))


@given(
    step=st.sampled_from([0.001, 0.01, 0.1]),
    rows=st.integers(3, 100),
    readings=st.integers(8, 30),
    constant=st.floats(3.0, 30.0),
)
def test_a_warm_up_that_is_probed_now_and_then_is_held(step, rows, readings, constant):
    """However evenly it grows, as long as the display resolves it."""
    grown = 200.0 * -np.expm1(-np.arange(readings) / constant)
    shown = step * np.round(grown / step)
    assume(np.diff(grown).min() > 2.0 * step)
    assert is_held(1e-6 * np.repeat(shown, rows))
