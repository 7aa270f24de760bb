"""The compensation output: laws of what a control receives, its settings, its preview."""

import csv
import json
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
from estimator.lines import Lines, Stroke
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.settings import toml
from thermojoint.cli.app import app
from thermojoint.compensation.offsets.output import (
    Mode,
    OutputSettings,
    at_zero,
    band_along,
    content_of,
    cycle,
    followed,
    mode_of,
    offsets_of,
    restored,
    slopes_of,
)
from thermojoint.compensation.offsets.preview import preview
from thermojoint.compensation.offsets.settings import (
    Settings,
    SlopeSection,
    read_settings,
    settings_from_data,
    with_slopes,
)
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
    recover_time=0.0,
    longest_cycle=math.inf,
)
TWO = replace(PLAIN, names=("X", "Y"), estimated=("x", "y"), signs=(-1, 1))

sizes = st.floats(1e-8, 1e-3)
times = st.floats(0.01, 1e4)
settings = st.builds(
    replace,
    st.just(TWO),
    resolution=sizes,
    rate=st.floats(1e-9, 1e-3),
    dead_band=st.just(0.0) | sizes,
    filter_time=st.just(0.0) | times,
    largest=sizes,
    freeze_time=st.just(0.0) | times,
    decay_time=times,
    recover_time=st.just(0.0) | times,
    longest_cycle=times,
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


STROKE = Stroke(0.3, 0.1, 0.6)
POSITIONS = np.linspace(STROKE.low, STROKE.high, 6)


def lined_settings(stage, parts, reference, steps):
    """X takes a slope, of which these are the parts of rate and limit at the far end."""
    lever = max(abs(end - reference) for end in STROKE[1:])
    whole = (stage.rate, stage.dead_band, stage.largest)
    rate, dead_band, largest = (
        part * one / lever / MICRO for part, one in zip(parts, whole, strict=True)
    )
    section = SlopeSection(
        resolution_um_per_m=largest / steps,
        rate_um_per_m_s=rate,
        dead_band_um_per_m=dead_band,
        largest_um_per_m=largest,
        reference_mm=1e3 * reference,
    )
    given = Settings(stage, Trust((), math.inf, math.inf), 1.0, {"X": section})
    return with_slopes(given, {"x": STROKE}, "test").output


parts = st.floats(0.05, 0.9)
#: Some seconds to the limit, in some hundred steps.
lined = st.builds(
    lined_settings,
    st.builds(
        replace,
        st.just(TWO),
        resolution=st.floats(1e-8, 1e-6),
        rate=st.floats(3e-6, 1e-4),
        dead_band=st.sampled_from([0.0, 2e-6]),
        filter_time=st.sampled_from([0.0, 5.0]),
        largest=st.just(1e-4),
        freeze_time=st.sampled_from([0.0, 10.0]),
        decay_time=st.sampled_from([5.0, 100.0]),
        recover_time=st.sampled_from([0.0, 5.0]),
        longest_cycle=st.sampled_from([5.0, 100.0]),
    ),
    st.tuples(parts, parts, parts),
    st.sampled_from([0.3, 0.0, 0.6, -1.0]),
    st.floats(100.0, 1000.0),
)
#: Targets as parts of the largest correction, at the far end of the stroke for a slope.
wanted = st.sampled_from([-2.0, -1.0, 0.0, 1.0, 2.0]) | st.floats(-1.0, 1.0) | st.just(math.nan)
lined_courses = st.lists(
    st.tuples(st.floats(0.01, 20.0), st.none() | st.tuples(wanted, wanted, wanted)),
    min_size=5,
    max_size=30,
)


def run_lined(settings, course, state=None):
    """Every state, the first one before the course."""
    scale = settings.largest / settings.channels.levers
    scaled = [(one, None if parts is None else scale * parts) for one, parts in course]
    return run(settings, scaled, state)


def corrections(settings, state):
    """Of X at every position, then of Y."""
    (along,) = settings.slopes
    k0, other = offsets_of(settings, state)
    (slope,) = slopes_of(settings, state)
    return np.append(k0 + slope * (POSITIONS - along.reference), other)


def one_step(settings):
    """Of X at every position, then of Y."""
    (along,) = settings.slopes
    of_slope = along.slope.resolution * np.abs(POSITIONS - along.reference)
    return settings.resolution + np.append(of_slope, 0.0)


@given(settings, courses)
def test_no_offset_is_ever_beyond_the_largest_total(settings, course):
    for state in run(settings, course):
        assert np.abs(offsets_of(settings, state)).max() <= settings.largest * (1.0 + 1e-8)


@given(settings, courses)
def test_no_offset_is_between_two_steps_of_the_resolution(settings, course):
    for state in run(settings, course):
        assert state.steps.dtype == np.int64
        assert offsets_of(settings, state) == pytest.approx(
            settings.resolution * np.rint(offsets_of(settings, state) / settings.resolution),
            rel=1e-12,
            abs=0,
        )


@given(settings, courses)
def test_over_any_time_an_offset_moves_by_the_rate_and_one_step_at_most(settings, course):
    states = run(settings, course)
    rows = np.array([offsets_of(settings, state) for state in states])
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
    way = np.abs(offsets_of(settings, after[-1])).max() / settings.rate
    long = settings.freeze_time + 50.0 * settings.decay_time + 2.0 * way + 10.0 * length
    # Of cycles that count whole, one moves as far as its time allows.
    whole = replace(settings, longest_cycle=math.inf)
    gone = run(whole, [(long, None), (long, None)], after[-1])[-1]
    assert not gone.steps.any()


@given(settings, st.lists(st.tuples(settings, courses), min_size=1, max_size=4), courses)
def test_no_change_of_the_settings_moves_an_offset_faster_than_the_rate(first, changes, course):
    """Whatever is changed between two cycles, axis by axis, by name; through JSON as it is kept."""
    state = run(first, course)[-1]
    before = dict(zip(first.names, offsets_of(first, state), strict=True))
    content = content_of(first, state)
    for used, later in changes:
        start = content["time"] or 0.0
        state = restored(used, json.loads(json.dumps(content)), start, 0.0)
        for name, offset in zip(used.names, offsets_of(used, state), strict=True):
            assert abs(offset - before[name]) <= 0.5 * used.resolution * (1.0 + 1e-6)
        for length, target in later:
            start, last = start + length, offsets_of(used, state)
            state = cycle(used, state, start, target)
            allowed = used.rate * min(length, used.longest_cycle) + used.resolution
            moved = np.abs(offsets_of(used, state) - last)
            assert (moved <= allowed * (1.0 + 1e-6)).all()
            # A limit that was lowered is reached at the rate, and never passed from within.
            most = np.maximum(np.abs(last), used.limits.most_steps * used.resolution)
            assert (np.abs(offsets_of(used, state)) <= most * (1.0 + 1e-9)).all()
        before = dict(zip(used.names, offsets_of(used, state), strict=True))
        content = content_of(used, state)


@given(lined, lined_courses)
def test_a_correction_keeps_the_rate_and_the_limit_at_every_position(settings, course):
    states = run_lined(settings, course)
    found = np.array([corrections(settings, state) for state in states])
    assert np.abs(found).max() <= settings.largest * (1.0 + 1e-8)
    for first in range(1, len(states)):
        passed = np.array([state.time for state in states[first:]]) - states[first].time
        moved = np.abs(found[first:] - found[first])
        allowed = settings.rate * passed[:, None] + one_step(settings)
        assert (moved <= allowed * (1.0 + 1e-6)).all()


@given(lined, lined_courses, st.integers(1, 20), st.floats(0.01, 100.0))
def test_without_an_estimate_a_line_freezes_then_decays_to_zero(settings, course, count, length):
    before = run_lined(settings, course)[-1]
    after = run(settings, [(length, None)] * count, before)[1:]
    rows = np.array([before.steps, *(state.steps for state in after)])
    assert (np.diff(np.abs(rows), axis=0) <= 0).all()
    assert (rows[1:] * rows[:-1] >= 0).all()
    for state in after:
        if mode_of(settings, state) is Mode.FREEZE and math.isnan(before.unusable_since):
            assert (state.steps == before.steps).all()
    # As many cycles as led there, each as long as may be.
    long = settings.freeze_time + 50.0 * settings.decay_time + settings.longest_cycle + 100.0
    assert not run(settings, [(long, None)] * (len(course) + 3), after[-1])[-1].steps.any()


@given(lined, st.lists(st.tuples(lined, lined_courses), min_size=1, max_size=3), lined_courses)
def test_no_change_of_the_settings_moves_a_line_faster_than_the_rate(first, changes, course):
    """Whatever is changed between two cycles, P0 too; through JSON as it is kept."""
    state, before = run_lined(first, course)[-1], first
    for used, later in changes:
        last = corrections(before, state)
        content = json.loads(json.dumps(content_of(before, state)))
        state = restored(used, content, content["time"], 0.0)
        moved = np.abs(corrections(used, state) - last)
        assert (moved <= 0.5 * one_step(used) * (1.0 + 1e-6)).all()
        for length, target in later:
            last = corrections(used, state)
            state = run_lined(used, [(length, target)], state)[-1]
            moved = np.abs(corrections(used, state) - last)
            allowed = used.rate * min(length, used.longest_cycle) + one_step(used)
            assert (moved <= allowed * (1.0 + 1e-6)).all()
        before = used


def test_a_line_is_followed_at_the_reference_of_the_control():
    settings = lined_settings(TWO, (0.5, 0.5, 0.5), 0.1, 1e4)
    known = np.full(2, np.nan)
    known[0] = 40.0 * MICRO
    lines = Lines(known, 0.1 * known, np.array([0.3, np.nan]), *np.full((2, 2), np.nan))
    targets = followed(settings, ("x", "y"), MICRO * np.array([20.0, 5.0]), lines)
    assert targets / MICRO == pytest.approx([-12.0, 5.0, -40.0])
    # A band that holds at 600 mm, 300 mm from P0.
    band = band_along(settings, ("x", "y"), np.full(2, 2.0 * MICRO), lines)
    assert band / MICRO == pytest.approx([2.0 + 0.3 * 4.0, 2.0])
    assert np.isnan(followed(settings, ("x", "y"), np.zeros(2))[2])


def test_an_axis_keeps_its_offset_by_its_name_and_a_new_one_begins_at_zero():
    state = run(PLAIN, [(1.0, np.array([27.2 * MICRO]))] * 2)[-1]
    content = content_of(PLAIN, state)
    coarse = replace(PLAIN, resolution=MICRO, names=("Y", "X"), estimated=("y", "x"), signs=(1, -1))
    found = offsets_of(coarse, restored(coarse, content, 2.0, 0.0))
    assert found == pytest.approx([0.0, 27.0 * MICRO], abs=1e-12)


def test_a_status_that_comes_and_goes_moves_nothing_until_it_stays():
    settings = replace(PLAIN, freeze_time=1e9, recover_time=10.0)
    wanted = np.array([20.0 * MICRO])
    calm = run(settings, [(1.0, np.array([5.0 * MICRO]))] * 3)[-1]
    flapping = run(settings, [(1.0, None), (5.0, wanted)] * 20, calm)[1:]
    assert {offsets_of(settings, state)[0] for state in flapping} == {offsets_of(settings, calm)[0]}
    assert {mode_of(settings, state) for state in flapping} == {Mode.FREEZE}
    stays = run(settings, [(5.0, wanted)] * 3, flapping[-1])[1:]
    assert [mode_of(settings, state) for state in stays] == [Mode.FREEZE, Mode.FOLLOW, Mode.FOLLOW]


def test_after_a_pause_an_offset_begins_where_it_was():
    settings = replace(PLAIN, rate=MICRO, longest_cycle=30.0)
    state = run(settings, [(1.0, np.array([0.0]))] * 2)[-1]
    later = cycle(settings, state, state.time + 36_000.0, np.array([100.0 * MICRO]))
    assert offsets_of(settings, later) == pytest.approx([30.0 * MICRO])


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


def test_the_largest_rate_is_no_limit():
    """It allows more steps than an integer counts."""
    state = run(replace(PLAIN, rate=1e294), [(1.0, 5e-5)] * 3)[-1]
    assert offsets_of(PLAIN, state) / MICRO == pytest.approx([50.0])


def test_the_filter_is_a_first_order_one():
    filtered = replace(PLAIN, filter_time=50.0)
    states = run(filtered, [(1.0, np.zeros(1)), *[(1.0, np.array([100.0 * MICRO]))] * 50])
    assert offsets_of(filtered, states[-1])[0] == pytest.approx(
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
recover_s = 0.0

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


def compensate(files, estimate, *more):
    """What the command came to, and the file that it writes."""
    out = files / "offsets.csv"
    command = ["compensate", estimate, "--settings", files / "offsets.toml", "--out", out, *more]
    return CliRunner().invoke(app, [*map(str, command)]), out


def compensated(files, *more):
    """What the command said, and its rows."""
    done, out = compensate(files, files / "estimate.csv", *more)
    assert done.exit_code == 0, done.output
    with out.open(encoding="utf-8", newline="") as file:
        return done.output, list(csv.DictReader(file))


def refused(files, estimate):
    """What the command said of a mistake, in one line; it has written nothing."""
    done, out = compensate(files, estimate)
    assert isinstance(done.exception, InputError)
    assert not out.exists()
    assert "\n" not in str(done.exception)
    return str(done.exception)


def test_the_preview_has_a_row_for_every_cycle_and_says_what_it_does(files):
    said, rows = compensated(files, "-v")
    assert "compensating: " in said
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


@pytest.mark.parametrize(("band", "warned"), [("1.0", False), ("", True)])
def test_a_limit_on_bands_that_there_are_none_of_is_warned_of(files, band, warned):
    (files / "offsets.toml").write_text(f"widest_band_um = 5.0\n{SETTINGS}")
    table = "time_s,x_um,x_band_um,y_um,y_band_um,status\n"
    rows = "".join(f"{k},1.0,{band},1.0,{band},ok\n" for k in range(3))
    (files / "estimate.csv").write_text(table + rows)
    assert ("there is no band" in compensated(files)[0]) == warned


def test_why_nothing_follows_is_said(files):
    """It said that offsets waited, and not why."""
    lines = [
        f"{k},1,10,-5,{9.0 if k == 3 else 1.0},1.0,{'unsettled' if k else 'ok'}" for k in range(4)
    ]
    (files / "estimate.csv").write_text(estimate_text(lines), "utf-8")
    (files / "offsets.toml").write_text(f"widest_band_um = 5.0\n{SETTINGS}", "utf-8")
    said, _ = compensated(files)
    assert "offsets.toml: unsettled 75 %, widest_band_um 25 % of the estimates" in said
    assert "oldest_s" not in said


def test_the_band_of_a_displacement_that_no_axis_follows_holds_no_axis(files):
    """X follows x at 2 +/- 1 um; y is known to 9 um, and no axis follows it."""
    lines = [f"{k},1,2,-5,1.0,9.0,ok" for k in range(4)]
    (files / "estimate.csv").write_text(estimate_text(lines), "utf-8")
    only_x = SETTINGS.partition("[axes.Z]")[0]
    (files / "offsets.toml").write_text(f"widest_band_um = 5.0\n{only_x}", "utf-8")
    said, rows = compensated(files)
    assert "widest_band_um" not in said
    assert [row["state"] for row in rows] == ["follow"] * 4
    assert float(rows[-1]["offset_X_um"]) == pytest.approx(-2.0)


def test_estimates_that_are_too_old_before_the_next_are_said(files):
    lines = [f"{60 * k},1,10,-5,,,ok" for k in range(4)]
    (files / "estimate.csv").write_text(estimate_text(lines), "utf-8")
    (files / "offsets.toml").write_text(SETTINGS, "utf-8")
    said, _ = compensated(files)
    assert "oldest_s 5 is shorter than the 60 s between two estimates" in said
    assert "unusable" not in said


def test_a_night_between_two_days_is_said_and_nothing_follows_it(files):
    seconds = [*range(0, 3600, 60), *range(50_000, 53_600, 60)]
    rows = [f"{1772431200 + second},1,10,-5,,,ok" for second in seconds]
    (files / "estimate.csv").write_text(estimate_text(rows), "utf-8")
    slow = SETTINGS.replace("oldest_s = 5.0", "oldest_s = 120.0").replace(
        "cycle_s = 1", "cycle_s = 5"
    )
    (files / "offsets.toml").write_text(slow, "utf-8")
    said, rows = compensated(files)
    assert "2 runs, 1 pause: 12.91 h from 2026-03-02 06:59:00" in said
    assert re.search(r"offsets: follow 13\.\d %, freeze \S+ %, decay 86\.\d % of", said)
    assert np.diff([float(row["time_s"]) for row in rows]) == pytest.approx(5.0)


ALONG = f"""{SETTINGS}
[axes.X.slope]
resolution_um_per_m = 1.0
"""


def along_text(slopes, p0=300.0):
    """K0 of 20 um along x, and these slopes (um/m); y at one place."""
    named = "x_slope_um_per_m,x_slope_band_um_per_m,x_P0_mm,x_stroke_from_mm,x_stroke_to_mm"
    more = "x_here_um,x_here_band_um,x_um,y_um,x_band_um,y_band_um"
    rows = [f"{k},{one},8,{p0},100,600,,,20,4,1,1,ok" for k, one in enumerate(slopes)]
    return "\n".join([f"time_s,{named},{more},status", *rows, ""])


def test_the_preview_of_an_axis_with_a_slope_has_k0_slope_and_p0(files):
    (files / "estimate.csv").write_text(along_text([60.0] * 100), "utf-8")
    (files / "offsets.toml").write_text(ALONG, "utf-8")
    said, rows = compensated(files)
    assert "X: K0 at P0 = 300 mm and slope; from 100 to 600 mm at most 500 um, 2 um/s" in said
    named = ["offset_X_um", "offset_Z_um", "slope_X_um_per_m", "P0_X_mm"]
    assert [*rows[0]] == ["time_s", *named, "state"]
    assert [float(rows[-1][name]) for name in named] == pytest.approx([-20.0, 4.0, -60.0, 300.0])
    k0, slope = (np.array([float(row[name]) for row in rows]) for name in (named[0], named[2]))
    for position in np.linspace(0.1, 0.6, 11):
        moved = np.abs(np.diff(k0 + (position - 0.3) * slope))
        assert moved.max() <= 2.0 + 0.1 + 1.0 * abs(position - 0.3)


def test_the_slopes_band_counts_at_the_far_end():
    """Half-widths of 1 um and of 8 um/m: 3.4 um at 600 mm."""
    axes, rows = read_estimate(along_text([60.0] * 3).splitlines(), "estimate.csv")
    assert axes == ("x", "y")
    for widest, state in ((3.5, "follow"), (3.3, "wait")):
        given = toml.parse(ALONG, "s.toml") | {"widest_band_um": widest}
        found = list(preview(settings_from_data(given, "s.toml"), axes, rows))
        assert found[-1].state == state


TABLE = """
rate_um_s = 2.0
[axes."X 100"]
follows = "x"
at_mm = 100.0
[axes."X 600"]
follows = "x"
at_mm = 600
"""


def placed_text(low, high):
    """x is low (um) at 100 mm and high at 600 mm."""
    rows = [f"{k},{low},{high},20,1,ok" for k in range(100)]
    return "\n".join(["time_s,x_at_100_um,x_at_600_um,x_um,x_band_um,status", *rows, ""])


def test_a_table_has_an_offset_for_each_position_and_each_keeps_the_rate(files):
    """What a control interpolates between two of them moves no faster than either."""
    (files / "estimate.csv").write_text(placed_text(8, -32), "utf-8")
    (files / "offsets.toml").write_text(TABLE, "utf-8")
    _, rows = compensated(files)
    low, high = ([float(row[f"offset_X {at}_um"]) for row in rows] for at in (100, 600))
    assert (low[-1], high[-1]) == pytest.approx((-8.0, 32.0))
    for share in np.linspace(0.0, 1.0, 5):
        between = (1.0 - share) * np.array(low) + share * np.array(high)
        assert np.abs(np.diff(between)).max() <= 2.0 + 0.1 + 1e-9


def test_a_column_that_is_named_like_a_position_is_ignored():
    text = placed_text(8, -32).replace("x_at_100_um", "x_at_rest_um").replace("8,", "warm,", 1)
    axes, rows = read_estimate(text.splitlines(), "estimate.csv")
    assert axes == ("x",)
    assert [*rows[0].places] == ["x_at_600"]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "at_mm = 600",
            "at_mm = 500",
            "offsets.toml: axes: the estimate has: no axis named 'x_at_500'",
        ),
        ("at_mm = 600", "at_mm = nan", "at_mm"),
        ("at_mm = 600", 'at_mm = 600\n[axes."X 600".slope]', "leave at_mm or slope out"),
    ],
)
def test_a_position_that_the_estimate_does_not_have_is_refused_in_one_line(files, old, new, told):
    (files / "estimate.csv").write_text(placed_text(8, -32), "utf-8")
    (files / "offsets.toml").write_text(TABLE.replace(old, new), "utf-8")
    assert told in refused(files, files / "estimate.csv")


def test_without_a_slope_in_the_settings_the_offset_is_k0(files):
    axes, rows = read_estimate(along_text([60.0] * 100).splitlines(), "estimate.csv")
    (last,) = [*preview(read_settings(files / "offsets.toml"), axes, rows)][-1:]
    assert last.offsets / MICRO == pytest.approx([-20.0, 4.0])
    assert (last.slopes.size, last.references.size) == (0, 0)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("[axes.X.slope]", "[axes.Z.slope]", "axes.Z.slope: y is estimated at one place"),
        ("_per_m = 1.0", "_per_m = 0.0", "axes.X.slope.resolution_um_per_m"),
        ("resolution_um_per_m", "resolution_um_m", "did you mean 'resolution_um_per_m'?"),
        ("_per_m = 1.0", "_per_m = 1.0\nrate_um_per_m_s = 7.0", "300 mm from P0 it is all of rate"),
        ("_per_m = 1.0", "_per_m = 1.0\nlargest_um_per_m = 1700", "is all of largest_um 500"),
        ("_per_m = 1.0", "_per_m = 900.0", "is not 1 to 1e+09 steps"),
        ("_per_m = 1.0", "_per_m = 5e-324", "is not 1 to 1e+09 steps"),
        ("_per_m = 1.0", "_per_m = 1.0\nreference_mm = 9e9", "is not 1 to 1e+09 steps"),
    ],
)  # fmt: skip
def test_a_slope_that_cannot_be_is_refused_in_one_line(files, old, new, told):
    (files / "estimate.csv").write_text(along_text([60.0] * 3), "utf-8")
    (files / "offsets.toml").write_text(ALONG.replace(old, new), "utf-8")
    assert told in refused(files, files / "estimate.csv")


def test_a_clock_that_begins_before_zero_makes_the_same_offsets():
    given = {"filter_s": 5.0, "recover_s": 0.0, "axes": {"X": {"follows": "x"}}}
    settings, found = settings_from_data(given, "s.toml"), []
    for begin in (-5.0, 0.0):
        rows = [Row(begin + k, np.array([1e-6 * k]), np.array([math.nan]), "ok") for k in range(11)]
        found.append([one.offsets.tolist() for one in preview(settings, ("x",), rows)])
    assert found[0] == found[1]


def test_an_old_estimate_is_no_estimate():
    given = {"oldest_s": 5.0, "recover_s": 0.0, "axes": {"X": {"follows": "x"}}}
    settings = settings_from_data(given, "s.toml")
    rows = [Row(time, np.array([1e-6]), np.array([math.nan]), "ok") for time in (0.0, 20.0)]
    found = [one.state for one in preview(settings, ("x",), rows)]
    assert found[:6] == ["follow"] * 6
    assert found[6:20] == ["freeze"] * 14
    assert found[20] == "follow"


def test_a_preview_of_no_estimates_is_refused(files):
    with pytest.raises(InputError, match=r"offsets: no rows; give estimates"):
        next(preview(read_settings(files / "offsets.toml"), ("x",), [], "offsets"))


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
        ("resolution_um = 0.1", "resolution_um = 1e-320\nlargest_um = 1e-319", "largest_um"),
        ("sign = 1", "sign = true", "axes.Z.sign"),
        ("cycle_s = 1.0", "cycle_s = 1e-12", "cycle_s 1e-12: more than"),
        ("cycle_s = 1.0", "cycle_s = 5e-324", "more than 1e.09 cycles in the 62 s"),
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
        (estimate_text(["0,1,a,0,,,ok"]), "'a' is not a number"),
        (
            estimate_text(["1796056561.5,1,0,0,,,ok", "1796056560,1,0,0,,,ok"]),
            "time 1796056560 s does not come after 1796056561.5 s",
        ),
        (estimate_text(["0,1,0"]), "3 values"),
    ],
)
def test_what_is_no_estimate_is_refused_in_one_line(text, told):
    with pytest.raises(InputError, match=told):
        read_estimate(text.splitlines(), "estimate.csv")


def test_an_estimate_that_a_spreadsheet_saved_is_the_same():
    """Semicolons and decimal commas."""
    plain = estimate_text([f"{2 * k},1.5,{k}.25,-0.5,,0.5,ok" for k in range(4)])
    axes, expected = read_estimate(plain.splitlines(), "estimate.csv")
    saved = plain.replace(",", ";").replace(".", ",")
    again, rows = read_estimate(saved.splitlines(), "saved.csv")
    assert again == axes == ("x", "y")
    for one, other in zip(rows, expected, strict=True):
        assert (one.time, one.status) == (other.time, other.status)
        assert np.array_equal(one.displacement, other.displacement)
        assert np.array_equal(one.band, other.band, equal_nan=True)


def test_the_command_refuses_a_response_and_leaves_nothing(files):
    refused(files, "r.nc")


def test_the_settings_of_the_page_are_settings():
    page = (ROOT / "docs" / "closing-the-loop.md").read_text("utf-8")
    block, slope, table = re.findall(r"```toml\n(.*?)```", page, re.S)
    settings = settings_from_data(toml.parse(block, "page"), "page")
    assert settings.output.signs == (-1, -1)
    along = settings_from_data(toml.parse(block + slope, "page"), "page")
    placed = settings_from_data(toml.parse(table, "page"), "page").output
    assert placed.estimated == ("y_at_-100", "y_at_50", "y_at_200")
    (own,) = with_slopes(along, {"x": STROKE}, "page").output.slopes
    assert own.slope.resolution == pytest.approx(MICRO)
    assert settings.trust.widest_band == pytest.approx(5.0 * MICRO)
