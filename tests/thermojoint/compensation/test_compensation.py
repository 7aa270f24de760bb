"""The compensation output: laws of what a control receives, its settings, its preview."""

import csv
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT
from typer.testing import CliRunner

from estimator.estimate_table import Row, read_estimate
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.settings import toml
from thermojoint.cli.app import app
from thermojoint.compensation.offsets.output import (
    OutputSettings,
    at_zero,
    cycle,
    followed,
    offsets_of,
)
from thermojoint.compensation.offsets.preview import preview
from thermojoint.compensation.offsets.settings import read_settings, settings_from_data
from thermojoint.compensation.offsets.usable import Trust, usable

MICRO = 1e-6
PLAIN = OutputSettings(
    names=("X",),
    estimated=("x",),
    signs=(-1,),
    resolution=0.1 * MICRO,
    rate=1e3,
    dead_band=0.0,
    filter_time=0.0,
    largest=1.0,
    freeze_time=0.0,
    decay_time=100.0,
)

sizes = st.floats(1e-8, 1e-3)
times = st.floats(0.01, 1e4)
settings = st.builds(
    replace,
    st.just(replace(PLAIN, names=("X", "Y"), estimated=("x", "y"), signs=(-1, 1))),
    resolution=sizes,
    rate=st.floats(1e-9, 1e-3),
    dead_band=st.just(0.0) | sizes,
    filter_time=st.just(0.0) | times,
    largest=sizes,
    freeze_time=st.just(0.0) | times,
    decay_time=times,
)
targets = st.none() | st.lists(
    st.floats(-1e-2, 1e-2) | st.just(math.nan), min_size=2, max_size=2
).map(np.array)
#: Length of each cycle and what is wanted in it.
courses = st.lists(st.tuples(st.floats(0.01, 100.0), targets), min_size=1, max_size=30)


def run(settings, course, state=None):
    """Every state, the first one before the course."""
    states, time = [state or at_zero(settings)], 0.0 if state is None else state.time
    for length, target in course:
        time += length
        states.append(cycle(settings, states[-1], time, target))
    return states


def as_row(settings, state):
    return offsets_of(settings, state)


@given(settings, courses)
def test_no_offset_is_ever_beyond_the_largest_total(settings, course):
    for state in run(settings, course):
        assert np.abs(as_row(settings, state)).max() <= settings.largest * (1.0 + 1e-8)


@given(settings, courses)
def test_no_offset_is_between_two_steps_of_the_resolution(settings, course):
    for state in run(settings, course):
        assert state.steps.dtype == np.int64
        assert as_row(settings, state) == pytest.approx(
            settings.resolution * np.rint(as_row(settings, state) / settings.resolution),
            rel=1e-12,
            abs=0,
        )


@given(settings, courses)
def test_over_any_time_an_offset_moves_by_the_rate_and_one_step_at_most(settings, course):
    states = run(settings, course)
    rows = np.array([as_row(settings, state) for state in states])
    # The first cycle begins at no known time: nothing may move in it but a step saved before.
    for first in range(1, len(states)):
        passed = np.array([state.time for state in states[first:]]) - states[first].time
        moved = np.abs(rows[first:] - rows[first]).max(axis=1)
        allowed = settings.rate * passed + settings.resolution
        assert (moved <= allowed * (1.0 + 1e-6)).all()


@given(settings, courses, st.integers(1, 20), st.floats(0.01, 100.0))
def test_without_an_estimate_offsets_freeze_then_decay_to_zero(settings, course, count, length):
    before = run(settings, course)[-1]
    after = run(settings, [(length, None)] * count, before)[1:]
    since = after[0].unusable_since
    rows = np.array([before.steps, *(state.steps for state in after)])
    assert (np.diff(np.abs(rows), axis=0) <= 0).all()
    assert (rows[1:] * rows[:-1] >= 0).all()
    for state in after:
        if math.isnan(before.unusable_since) and state.time - since <= settings.freeze_time:
            assert (state.steps == before.steps).all()
    way = np.abs(as_row(settings, after[-1])).max() / settings.rate
    long = settings.freeze_time + 50.0 * settings.decay_time + 2.0 * way + 10.0 * length
    # One cycle of any length moves as far as its time allows.
    gone = run(settings, [(long, None), (long, None)], after[-1])[-1]
    assert not gone.steps.any()


@given(settings, courses)
def test_what_was_done_is_not_undone_by_running_it_again(settings, course):
    first, second = run(settings, course), run(settings, course)
    assert all((one.steps == other.steps).all() for one, other in zip(first, second, strict=True))


def test_signs_and_axes_are_mapped():
    crossed = replace(PLAIN, names=("U", "V"), estimated=("y", "x"), signs=(1, -1))
    assert followed(crossed, ("x", "y"), np.array([2.0, 3.0])) == pytest.approx([3.0, -2.0])


def test_a_slow_rate_still_arrives():
    """A tenth of a step in every cycle is a step in every tenth cycle, no standstill."""
    slow = replace(PLAIN, rate=0.01 * MICRO)
    states = run(slow, [(1.0, np.array([5.0 * MICRO]))] * 101)
    moves = np.flatnonzero(np.diff([int(state.steps[0]) for state in states]))
    assert int(states[-1].steps[0]) == 10
    assert np.diff(moves) == pytest.approx(10.0, abs=1.0)


def test_the_filter_is_a_first_order_one():
    filtered = replace(PLAIN, filter_time=50.0)
    states = run(filtered, [(1.0, np.zeros(1)), *[(1.0, np.array([100.0 * MICRO]))] * 50])
    assert as_row(filtered, states[-1])[0] == pytest.approx(
        100.0 * MICRO * (1.0 - math.exp(-1.0)), abs=0.06 * MICRO
    )


def test_within_the_dead_band_nothing_moves():
    banded = replace(PLAIN, dead_band=0.5 * MICRO)
    course = [(1.0, np.array([value * MICRO])) for value in (10.0, 10.4, 9.6, 10.3, 10.7)]
    assert [int(state.steps[0]) for state in run(banded, course)[1:]] == [0, 100, 100, 100, 107]


@pytest.mark.parametrize(
    ("age", "band", "status", "wanted"),
    [
        (1.0, 1.0, "ok", True),
        (1.0, math.nan, "beyond-time reading-missing:T1", True),
        (1.0, 1.0, "beyond-time unsettled", False),
        (1.0, 3.0, "ok", False),
        (11.0, 1.0, "ok", False),
        (1.0, 1.0, "sensor-distrusted:unsettled", True),
    ],
)
def test_an_estimate_is_used_if_it_is_new_narrow_and_known(age, band, status, wanted):
    trust = Trust(("unsettled",), 2.0 * MICRO, 10.0)
    assert usable(trust, age, np.array([band * MICRO]), status) == wanted


SETTINGS = """cycle_s = 1.0
resolution_um = 0.1
rate_um_s = 2.0
dead_band_um = 0.0
oldest_s = 5.0
freeze_s = 10.0
decay_s = 20.0

[axes.X]
follows = "x"
sign = -1

[axes.Z]
follows = "y"
sign = 1
"""


def estimate_text(rows):
    named = "x_um,y_um,x_band_um,y_band_um"
    return "\n".join([f"time_s,heat_W,{named},status", *rows, ""])


@pytest.fixture
def files(tmp_path):
    rows = [f"{2 * k},1,{k},{-0.5 * k},,,ok" for k in range(11)]
    rows += ["22,1,,,,,ok", "62,1,20,-10,0.5,0.5,ok"]
    (tmp_path / "estimate.csv").write_text(estimate_text(rows), "utf-8")
    (tmp_path / "offsets.toml").write_text(SETTINGS, "utf-8")
    return tmp_path


def test_the_preview_has_a_row_for_every_cycle_and_says_what_it_does(files):
    out = files / "offsets.csv"
    command = ["compensate", str(files / "estimate.csv"), "--out", str(out)]
    done = CliRunner().invoke(app, [*command, "--settings", str(files / "offsets.toml")])
    assert done.exit_code == 0, done.output
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time_s"]) for row in rows] == pytest.approx(np.arange(63.0))
    by_time = {round(float(row["time_s"])): row for row in rows}
    assert float(by_time[20]["offset_X_um"]) == pytest.approx(-10.0)
    assert float(by_time[20]["offset_Z_um"]) == pytest.approx(-5.0)
    # The empty row at 22 s: frozen, then decaying; at 62 s it follows again, at 2 um/s.
    states = [by_time[second]["state"] for second in (20, 22, 32, 33, 61, 62)]
    assert states == ["follow", "freeze", "freeze", "decay", "decay", "follow"]
    assert float(by_time[32]["offset_X_um"]) == pytest.approx(-10.0)
    last, before = (float(by_time[second]["offset_X_um"]) for second in (62, 61))
    assert before == pytest.approx(-10.0 * math.exp(-29.0 / 20.0), abs=0.15)
    assert last == pytest.approx(before - 2.0, abs=0.11)


def test_an_old_estimate_is_no_estimate():
    settings = settings_from_data({"oldest_s": 5.0, "axes": {"X": {"follows": "x"}}}, "s.toml")
    rows = [Row(time, np.array([1e-6]), np.array([math.nan]), "ok") for time in (0.0, 20.0)]
    found = [one.state for one in preview(settings, ("x",), rows)]
    assert found[:6] == ["follow"] * 6
    assert found[6:20] == ["freeze"] * 14
    assert found[20] == "follow"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("cycle_s = 1.0", "cycle_s = 0", "cycle_s"),
        ("rate_um_s", "rate_ums", "did you mean 'rate_um_s'?"),
        ("sign = 1", "sign = 2", "axes.Z.sign"),
        ('follows = "y"', 'follows = "z"', "'z'"),
        ("cycle_s = 1.0", 'cycle_s = 1.0\nunusable = ["unsetled"]', "'unsettled'"),
        ("resolution_um = 0.1", "resolution_um = 1e6", "largest_um"),
        ("resolution_um = 0.1", "resolution_um = 1e-300", "largest_um"),
        ("cycle_s = 1.0", "cycle_s 1.0", "TOML"),
    ],
)
def test_a_mistake_in_the_settings_is_one_line(files, old, new, told):
    path = files / "offsets.toml"
    path.write_text(SETTINGS.replace(old, new), "utf-8")
    with (files / "estimate.csv").open() as lines:
        axes, rows = read_estimate(lines, "estimate.csv")
    with pytest.raises(InputError, match=told.replace("?", r"\?")) as error:
        list(preview(read_settings(path), axes, rows))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no estimate"),
        ("time_s,x\n1,2\n", "no estimate"),
        (estimate_text([]), "no row"),
        (estimate_text(["0,1,a,0,,,ok"]), "'a' is no number"),
        (estimate_text(["0,1,0,0,,,ok", "0,1,0,0,,,ok"]), "does not come after"),
        (estimate_text(["0,1,0"]), "3 values"),
    ],
)
def test_what_is_no_estimate_is_refused_in_one_line(text, told):
    with pytest.raises(InputError, match=told):
        read_estimate(text.splitlines(), "estimate.csv")


def test_the_command_refuses_a_response_and_leaves_nothing(files):
    out = files / "offsets.csv"
    command = ["compensate", "r.nc", "--settings", str(files / "offsets.toml"), "--out", str(out)]
    done = CliRunner().invoke(app, command)
    assert isinstance(done.exception, InputError)
    assert not out.exists()


def test_the_settings_of_the_page_are_settings():
    page = (ROOT / "docs" / "closing-the-loop.md").read_text("utf-8")
    (block,) = re.findall(r"```toml\n(.*?)```", page, re.S)
    settings = settings_from_data(toml.parse(block, "page"), "page")
    assert settings.output.signs == (-1, -1)
    assert settings.trust.widest_band == pytest.approx(5.0 * MICRO)
