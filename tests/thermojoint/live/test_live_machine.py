"""One machine of the service: what silence does, what a kill does not, and what the store keeps."""

import contextlib
import logging
import math
import sqlite3
from dataclasses import replace

import numpy as np
import pytest
from machine_fleet import fleet_of, keep
from small_disk import fill, mounted

from benchmarks import offset_invariant
from estimator.estimate_table import Row
from estimator.interface import follow
from estimator.quality import Quality
from thermojoint.artefacts.errors import InputError
from thermojoint.compensation.offsets.preview import preview
from thermojoint.compensation.offsets.settings import read_settings
from thermojoint.live import processing
from thermojoint.live.archive import Archive
from thermojoint.live.arrivals import Arrival
from thermojoint.live.disk_reserve import SLICE, adjust_reserve, preallocate
from thermojoint.live.loaded_models import LoadedModel, load_model
from thermojoint.live.log_lines import EventLog, limited, line_of
from thermojoint.live.machine_state import (
    Times,
    after_silence,
    initial_state,
    process_sample,
    restore_state,
)
from thermojoint.live.metrics import fresh_metrics
from thermojoint.live.publication import AxisLine, as_json, as_row, columns_of, fitted, from_row
from thermojoint.live.rate_limit import AT_ONCE, LineLimit
from thermojoint.live.recovery import is_damage
from thermojoint.live.running import restored_fleet
from thermojoint.live.samples import AssemblyRule
from thermojoint.live.settings import ModelSection, WatchdogSection, service_from_data
from thermojoint.live.store import (
    Batch,
    Event,
    StoredSample,
    checkpoint_wal,
    commit,
    era_before,
    era_of,
    last_received,
    new_era,
    open_store,
    prune,
    stored_eras,
)

OFFSETS = """
rate_um_s = 1000.0
oldest_s = 5.0
freeze_s = 10.0
decay_s = 20.0
unusable = []
[axes.X]
follows = "x"
"""
START = 1_772_431_200.0


@pytest.fixture(scope="module")
def model(model, tmp_path_factory) -> LoadedModel:
    base = tmp_path_factory.mktemp("machine")
    (base / "offsets.toml").write_text(OFFSETS)
    return load_model(ModelSection(file=model, offsets=base / "offsets.toml"), base / "kept")


def readings(k):
    rise = 1.0 - math.exp(-k / 60.0)
    return (20.0 + 6.0 * rise, 20.0 + 0.5 * rise, 20.0 + rise, 20.0 + 3.0 * rise, 20.0)


def at(k):
    """So many seconds after the start, by both clocks."""
    return Times(START + k, START + k)


def sampled(k, given=None, silence=1.0):
    """A sample of then, taken then, so many seconds after the last estimate."""
    return (START + k, given or readings(k)), at(k), 0.0, silence


def after(model, count):
    machine = initial_state("mill", model, START)
    for k in range(count):
        machine, refusal = process_sample(model, machine, *sampled(k))
        assert not refusal
    return machine


def test_a_machine_of_which_nothing_is_known_says_so(model):
    said = initial_state("mill", model, START).latest
    told = as_json(said)
    assert (told["quality"], told["time"], told["displacement_um"]) == (
        "bad",
        None,
        {"x": None, "y": None},
    )
    machine = initial_state("mill", model, START)
    assert after_silence(model, machine, 1e9, at(0), WatchdogSection())[1].quality is Quality.BAD


def test_silence_makes_the_last_value_uncertain_then_bad_and_the_offsets_freeze_and_decay(model):
    machine = after(model, 60)
    before = machine.latest.offsets[0]
    assert abs(before) > 1e-6
    found = {}
    for age in range(1, 200):
        machine, found[age] = after_silence(
            model, machine, float(age), at(60 + age), WatchdogSection()
        )
    assert found[9].quality is machine.latest.quality
    assert (found[10].quality, found[60].quality) == (Quality.UNCERTAIN, Quality.BAD)
    assert found[10].status.endswith("silent")
    np.testing.assert_array_equal(found[199].displacement, machine.latest.displacement)
    offsets = np.array([found[age].offsets[0] for age in range(1, 200)])
    np.testing.assert_array_equal(offsets[:15], before)
    assert np.all(np.diff(np.abs(offsets)) <= 0.0)
    assert abs(offsets[-1]) < 0.01 * abs(before)


def test_a_sample_that_no_estimator_can_use_counts_and_changes_no_estimate(model):
    machine = after(model, 30)
    broken = (math.nan, *readings(30)[1:])
    other, refusal = process_sample(model, machine, *sampled(30, broken))
    assert "finite" in refusal
    assert other.latest.number == 31
    np.testing.assert_array_equal(other.estimator_state, machine.estimator_state)
    assert other.latest.quality is Quality.UNCERTAIN
    again, refusal = process_sample(model, other, *sampled(31))
    assert not refusal
    assert again.latest.quality is machine.latest.quality


@pytest.mark.parametrize("value", [9.9e37, -1e6, 9999.0, -3276.8, -999.0, math.inf, math.nan])
def test_what_is_no_temperature_is_a_missing_reading(model, value):
    assert math.isnan(model.intake.usable((value, *readings(1)[1:]))[0])


@pytest.fixture
def path(tmp_path):
    return tmp_path / "history.sqlite"


@pytest.fixture
def store(path):
    return open_store(path)


@pytest.fixture
def fleet(model, store):
    return fleet_of(model, store, START)


def feed(fleet, store, first, last):
    for k in range(first, last):
        keep(fleet, store, Arrival("mill", START + k, readings(k), START + k, position=k))


def checkpoint(fleet, store):
    commit(store, Batch(checkpoints=[processing.checkpoint_of(fleet.machines["mill"])]))


@pytest.mark.parametrize("at_sample", [None, 0, 17, 40])
def test_a_machine_goes_on_bit_for_bit_wherever_its_last_checkpoint_was(
    model, at_sample, path, store, fleet
):
    mill = fleet.machines["mill"]
    for end in (17, 40):
        feed(fleet, store, 0 if end == 17 else 17, end)
        if at_sample in (0, end):
            checkpoint(fleet, store)
    kept = stored_eras(store, [mill.era])[mill.era]
    last = Archive(path).checkpointed("mill", mill.era)
    received = last_received(store)["mill"]
    machine, position = restore_state("mill", model, kept, last, received, at(39))
    assert position == 39
    np.testing.assert_array_equal(machine.estimator_state, mill.state.estimator_state)
    assert machine.assembly == mill.state.assembly
    before = mill.state.output._replace(credit=0.0)
    np.testing.assert_equal(machine.output._asdict(), before._asdict())
    np.testing.assert_array_equal(as_row(machine.latest), as_row(mill.state.latest))
    history = Archive(path).history("mill", 0.0, 1e11, 1000)
    np.testing.assert_array_equal(history.numbers, np.arange(1, 41))


def test_the_history_marks_what_is_missing_thins_and_forgets(path, store, fleet):
    mill = fleet.machines["mill"]
    feed(fleet, store, 0, 100)
    checkpoint(fleet, store)
    mill.awaits_first_sample = True
    feed(fleet, store, 150, 250)
    checkpoint(fleet, store)
    feed(fleet, store, 250, 260)
    archive = Archive(path)
    whole = archive.history("mill", 0.0, 1e11, 1000)
    assert [(one.since - START, one.until - START, one.why) for one in whole.gaps] == [
        (99.0, 150.0, "the service was down")
    ]
    thinned = archive.history("mill", 0.0, 1e11, 50)
    assert thinned.every > 1
    assert len(thinned.numbers) <= 51
    assert set(thinned.numbers) <= set(whole.numbers)
    part = archive.history("mill", START + 160, START + 170, 1000)
    np.testing.assert_array_equal(part.columns.times - START, np.arange(160.0, 171.0))
    assert archive.latest("mill").number == 210
    end = store.execute("SELECT max(id) FROM journal").fetchone()[0]
    prune(store, end - 10, [mill.era], 30.0, START + 260.0)
    left = archive.history("mill", 0.0, 1e11, 1000)
    np.testing.assert_array_equal(left.numbers, np.arange(101, 211))
    with pytest.raises(InputError, match="no machine named 'miller'"):
        archive.history("miller", 0.0, 1e11, 1000)
    checkpoint_wal(path)
    # All of it is in the file: the next commit begins it anew.
    log = path.with_name(path.name + "-wal")
    size = log.stat().st_size
    commit(store, Batch())
    assert log.stat().st_size == size


def test_a_short_span_of_a_long_history_is_not_thinned(path, store, fleet):
    """A backlog that was read at once is one chunk; the journal is as long as a checkpoint."""
    feed(fleet, store, 0, 200)
    checkpoint(fleet, store)
    feed(fleet, store, 200, 300)
    for begin in (150, 190, 230):
        part = Archive(path).history("mill", START + begin, START + begin + 20, 21)
        np.testing.assert_array_equal(part.numbers, np.arange(begin + 1, begin + 22))
    thinned = Archive(path).history("mill", START + 100, START + 299, 100)
    assert (thinned.every, len(thinned.numbers)) == (2, 100)


def test_another_model_begins_anew(model, store, fleet):
    feed(fleet, store, 0, 10)
    era = fleet.machines["mill"].era
    assert era_of(store, "mill", model.digest, model.layout, START) == era
    other = era_of(store, "mill", "another", model.layout, START)
    assert other != era
    assert stored_eras(store, [other])[other].state is None


def test_what_a_killed_service_had_of_a_former_model_stays_in_the_history(
    model, path, store, fleet
):
    def numbers():
        (end,) = store.execute("SELECT max(id) FROM journal").fetchone()
        prune(store, end, [], 1e6, START + 30.0)
        return Archive(path).history("mill", 0.0, 1e11, 1000).numbers.tolist()

    feed(fleet, store, 0, 10)
    checkpoint(fleet, store)
    feed(fleet, store, 10, 20)
    former = list(range(1, 21))
    assert numbers() == former
    fleet = fleet_of(replace(model, digest="another"), store, START)
    feed(fleet, store, 20, 30)
    assert numbers() == [*former, *range(1, 11)]
    checkpoint(fleet, store)
    assert numbers() == [*former, *range(1, 11)]
    assert not store.execute("SELECT count(*) FROM journal").fetchone()[0]


def test_the_history_from_before_a_change_of_the_axes_is_still_read(model, path, store, fleet):
    feed(fleet, store, 0, 10)
    checkpoint(fleet, store)
    feed(fleet, store, 10, 20)
    before = Archive(path).history("mill", 0.0, 1e11, 1000).columns
    line = AxisLine("Y", 0.1, 0.2)
    layout = replace(model.layout, controls=("Y", *model.layout.controls), lines=(line,))
    era_of(store, "mill", model.digest, layout, START + 20.0)
    now = Archive(path).history("mill", 0.0, 1e11, 1000)
    assert now.layout == layout
    for name in ("times", "quality", "displacement", "band", "details", "readings"):
        np.testing.assert_array_equal(getattr(now.columns, name), getattr(before, name))
    np.testing.assert_array_equal(now.columns.offsets[:, 1:], before.offsets)
    assert np.isnan(now.columns.offsets[:, 0]).all()
    assert np.isnan(now.columns.slopes).all()
    newest = Archive(path).latest("mill")
    assert (newest.number, newest.offsets[1]) == (20, before.offsets[-1, 0])


def test_an_offset_at_another_p0_is_not_one_at_this(model):
    """K0 says nothing without its P0, of which a history has one."""
    own = replace(model.layout, controls=("X", "Z"), lines=(AxisLine("X", 0.1, 0.2),))
    moved = replace(own, lines=(AxisLine("X", 0.2, 0.2),))
    row = np.arange(float(own.width))[None]
    found = columns_of(moved, fitted(row, own, moved))
    same = columns_of(own, row)
    assert np.isnan([found.offsets[0, 0], found.slopes[0, 0]]).all()
    assert found.offsets[0, 1] == same.offsets[0, 1]


def test_a_row_of_the_history_is_the_publication(model):
    said = after(model, 20).latest
    back = from_row("mill", said.number, model.layout, as_row(said), said.status)
    # What the offsets do is said of the present alone.
    assert as_json(back) == as_json(said) | {"offset_mode": None}


def test_nothing_is_acknowledged_before_its_sample_is_kept(model, store, fleet):
    mill = fleet.machines["mill"]
    mill.model = replace(model, rule=AssemblyRule(1.0, 0.0, 0.0, 5))
    said = []
    first = Arrival("mill", START, (*readings(0)[:4], None), START, 0, lambda: said.append(1))
    rest = Arrival("mill", START, (*(None,) * 4, 20.0), START, 1, lambda: said.append(2))
    results = processing.process(fleet, [first], START, START)
    assert not results.acknowledgements
    results = processing.process(fleet, [rest], START, START)
    assert len(results.acknowledgements) == len(results.samples) + 1 == 2
    again = processing.process(fleet, [first], START, START)
    assert (len(again.acknowledgements), len(again.samples)) == (1, 0)


def test_an_event_is_one_line_however_it_is_called():
    line = line_of("malformed", 'a "name"\nevent=forged', "mill")
    assert "\n" not in line
    assert line.startswith("event=malformed machine=mill text=")
    assert line.count("event=") == 2
    assert '\\"name\\"' in line


def test_a_flood_of_events_is_a_few_lines():
    log = EventLog()
    for k in range(10_000):
        log.say(START + 0.001 * k, "malformed", "x", "mill")
    assert len(log.pending) == AT_ONCE
    log.say(START + 100.0, "malformed", "x", "mill")
    assert "9995 more" in log.pending[-1].text


def test_a_clock_that_is_set_back_leaves_no_event_out():
    limit = LineLimit()
    times = [1e4] * (AT_ONCE + 3) + [1e4 - 3600.0]
    assert [limit.left_out("status", time) for time in times][AT_ONCE:] == [None, None, None, 3]


def test_readings_that_are_late_since_the_clock_was_set_back_say_for_how_long(model, store):
    fleet = fleet_of(model, store, START)
    keep(fleet, store, Arrival("mill", START + 7200.0, readings(0), START))
    processing.process(fleet, [Arrival("mill", START, readings(1), START)], START, START + 1.0)
    (line,) = [e.text for e in fleet.log.pending if e.kind == "late"]
    assert line.endswith("the clock was set back: the last sample is 7200 s ahead of it")


def test_a_library_that_complains_without_end_is_a_few_lines():
    passes = limited(LineLimit())
    written = []
    for k in range(1000):
        record = logging.LogRecord("asyncua", logging.ERROR, "x.py", 7, "fault %d", (k,), None)
        record.created = START + 0.001 * k
        written += [record.getMessage()] if passes(record) else []
    assert len(written) == AT_ONCE
    assert written[0] == 'event=library text="asyncua: fault 0"'
    other = logging.LogRecord("asyncua", logging.ERROR, "x.py", 8, "another", (), None)
    assert passes(other)


# --- what a control receives ---------------------------------------------------------------------


def with_offsets(model, text, folder):
    """The model with other settings of its compensation output."""
    (folder / "other.toml").write_text(text)
    output = read_settings(folder / "other.toml")
    layout = replace(model.layout, controls=output.output.names)
    return replace(model, output=output, layout=layout)


def test_refused_samples_neither_hold_an_offset_nor_hurry_it(model):
    """The output's clock is the service's own: refused samples and silence freeze alike."""
    machine, alone = after(model, 60), after(model, 60)
    for k in range(60, 110):
        broken = sampled(k, (math.nan, *readings(k)[1:]), silence=k - 59.0)
        machine, refusal = process_sample(model, machine, *broken)
        assert refusal
        assert machine.latest.offset_mode == (
            "follow" if k <= 64 else "freeze" if k <= 75 else "decay"
        )
    for age in (20.0, 50.0, 51.0, 60.0, 100.0):
        _, expected = after_silence(model, alone, age, at(59 + age), WatchdogSection())
        if age > 50.0:
            machine, said = after_silence(model, machine, age, at(59 + age), WatchdogSection())
            assert machine.output.time == START + 59 + age
            # The refused ones froze it when the estimate was too old, the silence only when it was
            # noticed.
            assert abs(said.offsets[0]) <= abs(expected.offsets[0])


def test_a_service_sends_what_compensate_previews_for_the_same_readings(model, store, tmp_path):
    """A sample that FCHS refuses is a pause in both, as it has no row in a table of estimates."""
    text = OFFSETS.replace("1000.0", "0.2").replace("oldest_s", "recover_s = 3.0\noldest_s")
    model = with_offsets(model, text, tmp_path)
    fleet, rows, sent = fleet_of(model, store, START), [], []
    for k in range(120):
        lost = k < 2 or k % 7 == 3 or 60 <= k < 90
        given = (1e30, *readings(k)[1:]) if lost else readings(k)
        keep(fleet, store, Arrival("mill", START + k, given, START + k))
        processing.check_silence(fleet, *at(k))
        mill = fleet.machines["mill"].state
        sent.append((mill.latest.offsets[0], mill.latest.offset_mode))
        if not lost:
            rows.append(Row(START + k, mill.usable.displacement, mill.usable.band, "ok"))
    previewed = list(preview(model.output, model.layout.axes, rows))
    assert [(one.offsets[0], one.state) for one in previewed] == sent[2:]
    assert {mode for _, mode in sent[2:]} == {"follow", "freeze", "decay"}


@pytest.mark.parametrize("resolution", [0.1, 1.0, 10.0])
def test_a_restart_with_another_resolution_keeps_the_offset(
    model, tmp_path, resolution, store, fleet
):
    feed(fleet, store, 0, 40)
    before = fleet.machines["mill"].state.latest.offsets[0]
    assert abs(before) > 1e-6
    other = with_offsets(model, f"resolution_um = {resolution}\n{OFFSETS}", tmp_path)
    kept = stored_eras(store, [fleet.machines["mill"].era])[fleet.machines["mill"].era]
    machine, _ = restore_state("mill", other, kept, None, last_received(store)["mill"], at(40))
    assert machine.latest.offsets[0] == pytest.approx(before, abs=0.5e-6 * resolution * 1.001)


def test_a_full_disk_is_no_damage(store):
    """SQLite ends the transaction by itself; the next commit finds room again."""
    (pages,) = store.execute("PRAGMA page_count").fetchone()
    store.execute(f"PRAGMA max_page_count = {pages}")
    batch = Batch(events=[Event(START, None, "status", 100_000 * "x")])
    with pytest.raises(sqlite3.OperationalError, match="full") as found:
        commit(store, batch)
    assert not is_damage(found.value)
    store.execute("PRAGMA max_page_count = 10000")
    commit(store, batch)


def test_a_store_goes_on_in_its_reserve_on_a_full_disk(tmp_path):
    """For all of it, and then it loses nothing; with room again it has a reserve again."""
    batch = Batch(samples=[StoredSample(1, k, bytes(8 * 20), "ok", "{}") for k in range(1000)])
    wanted, stored, rooms = 3 * SLICE, 0, []
    with mounted(tmp_path / "disk", 96) as disk:
        path = disk / "history.sqlite"
        store = open_store(path)
        preallocate(store, path)
        for _ in range(10):
            room = adjust_reserve(store, path, wanted)
        assert (room.full, room.reserve >= wanted) == (False, True)
        filler = fill(disk)
        with contextlib.suppress(sqlite3.OperationalError):
            while True:
                rooms.append(adjust_reserve(store, path, wanted))
                commit(store, batch)
                stored += 1000
        assert all(room.full for room in rooms)
        assert sorted(rooms, reverse=True) == rooms
        assert 8 * 20 * stored > 0.7 * wanted
        assert store.execute("SELECT count(*) FROM journal").fetchone() == (stored,)
        filler.unlink()
        commit(store, batch)
        for _ in range(10):
            room = adjust_reserve(store, path, wanted)
        assert (room.full, room.reserve >= wanted) == (False, True)
        assert store.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        store.close()


def test_other_axes_of_the_control_leave_the_estimator_its_state(
    model, tmp_path, path, store, fleet
):
    feed(fleet, store, 0, 40)
    checkpoint(fleet, store)
    feed(fleet, store, 40, 50)
    mill = fleet.machines["mill"]
    other = with_offsets(model, OFFSETS + '\n[axes.Z]\nfollows = "y"\n', tmp_path)
    era = era_of(store, "mill", other.digest, other.layout, START + 50)
    assert era != mill.era
    assert era_before(store, era) == (mill.era, True)
    kept = stored_eras(store, [mill.era])[mill.era]
    last = Archive(path).checkpointed("mill", mill.era)
    received = last_received(store)["mill"]
    machine, _ = restore_state("mill", other, kept, last, received, at(50))
    np.testing.assert_array_equal(machine.estimator_state, mill.state.estimator_state)
    assert machine.latest.number == 50
    assert machine.latest.offsets.tolist() == [mill.state.latest.offsets[0], 0.0]
    # Nothing is kept of the era between.
    another = era_of(store, "mill", "another model", other.layout, START + 50)
    assert era_before(store, another) == (mill.era, False)


def test_a_start_sends_what_the_control_received_last_and_goes_on_from_there(model, store, fleet):
    """After any time, with any model; what silence would have done since comes at the rate."""
    feed(fleet, store, 0, 40)
    mill = fleet.machines["mill"]
    before = mill.state.latest.offsets
    kept, received = stored_eras(store, [mill.era])[mill.era], last_received(store)["mill"]
    machine, _ = restore_state("mill", model, kept, None, received, at(39 + 120))
    assert (machine.latest.offsets.tolist(), machine.latest.offset_mode) == (
        before.tolist(),
        "decay",
    )
    running = mill.state
    for age in range(1, 122):
        running, expected = after_silence(model, running, age, at(39 + age), WatchdogSection())
    _, said = after_silence(model, machine, 121.0, at(39 + 121), WatchdogSection())
    assert said.offsets == pytest.approx(expected.offsets, abs=3e-7)
    other = replace(model, digest="another model")
    nothing = stored_eras(store, [era_of(store, "mill", other.digest, other.layout, START)])
    machine, _ = restore_state("mill", other, *nothing.values(), None, received, at(41))
    assert (machine.latest.number, machine.latest.offset_mode) == (0, "freeze")
    assert machine.latest.offsets.tolist() == before.tolist()


def test_readings_that_come_late_move_no_offset_and_are_not_good(store, fleet):
    """Fifteen hours of them at once: estimates of then, for the history."""
    feed(fleet, store, 0, 40)
    before = fleet.machines["mill"].state.latest.offsets
    now = START + 54_000.0
    arrivals = [Arrival("mill", START + k, readings(k), now) for k in range(40, 400)]
    said = processing.process(fleet, arrivals, now, START + 45.0).publications["mill"]
    assert (said.quality, said.number, said.offset_mode) == (Quality.BAD, 400, "freeze")
    assert said.offsets.tolist() == before.tolist()


class Deaf(offset_invariant.Gauge):
    """Goes on without any reading."""

    def sample(self, state, time, values):
        heard = [0.0 if math.isnan(one) else one for one in values]
        return super().sample(state, time, heard)


@pytest.fixture
def deaf():
    output = offset_invariant.settings_of({"oldest_s": 5.0, "freeze_s": 5.0, "decay_s": 5.0}, False)
    return replace(offset_invariant.model_with(output, 1.0), estimator=Deaf(1.0))


@pytest.mark.parametrize("nothing", [math.nan, -3276.8])
def test_samples_without_any_reading_are_silence(deaf, store, nothing):
    """Whatever an estimator makes of them: the value becomes bad, and the offset fades.

    An error value of a logger is no reading.
    """
    fleet = fleet_of(deaf, store, START)
    found = []
    for k in range(100):
        told = (20.0 if k < 30 else nothing, 0.0 if k < 30 else nothing)
        results = processing.process(fleet, [Arrival("mill", START + k, told, START + k)], *at(k))
        found.append(results.publications["mill"])
    assert (found[29].quality, found[29].offset_mode) == (Quality.GOOD, "follow")
    assert found[29].offsets[0] == pytest.approx(-20e-6)
    assert (found[36].offset_mode, found[45].quality) == ("freeze", Quality.UNCERTAIN)
    assert (found[99].quality, found[99].offset_mode) == (Quality.BAD, "decay")
    assert abs(found[99].offsets[0]) < 1e-6
    processing.count_modes(fleet, 1.0)
    assert fleet.metrics.registry.get_sample_value(
        "thermojoint_offset_seconds_total", {"machine": "mill", "mode": "decay"}
    )


@pytest.mark.parametrize("deaf_from", [0, 30])
def test_the_preview_of_samples_without_any_reading_is_what_the_service_sends(
    deaf, store, deaf_from
):
    """It followed the estimator's prediction, for hours if the status allowed it."""
    fleet, found = fleet_of(deaf, store, START), []
    told = [
        (START + k, *(2 * [math.nan] if deaf_from <= k < 80 else (20.0, 0.0))) for k in range(100)
    ]
    for k, (time, *given) in enumerate(told):
        results = processing.process(fleet, [Arrival("mill", time, given, time)], *at(k))
        found.append(results.publications["mill"])
    start = deaf.estimator.initial_state()
    rows = [
        Row(one.time, one.displacement, one.band, one.words)
        for _, one in follow(deaf.estimator, told, start)
    ]
    previewed = list(preview(deaf.output, deaf.estimator.axes, rows))
    assert [one.state for one in previewed] == [one.offset_mode for one in found]
    for one, sent in zip(previewed, found, strict=True):
        assert one.offsets.tolist() == sent.offsets.tolist()
    assert previewed[70].state == ("decay" if deaf_from else "wait")


def test_a_displacement_that_is_read_alone_is_silence_as_in_the_service(watched):
    """`compensate` followed the prediction for as long as a probe was read."""
    estimator, unread = watched.estimator, math.nan
    alone = [unread if one.unit == "K" else 1e-6 for one in estimator.channels]
    told = [watched.samples[0], (10.0, *alone)]
    _, (_, estimate) = follow(estimator, told, estimator.initial_state())
    assert estimate.silent


def started(model, store, path, log, k):
    """The floor of a service that starts so many seconds after the start, and what it says."""
    service = service_from_data(
        {
            "folder": ".",
            "models": {"m": {"file": "model.json"}},
            "machines": {"mill": {"model": "m", "source": "s"}},
            "sources": {"s": {"kind": "csv", "path": "-"}},
        },
        "file",
        path.parent,
    )
    return restored_fleet(service, {"m": model}, store, log, fresh_metrics(), at(k))


@pytest.mark.parametrize(("age", "taken"), [(10.0, True), (90.0, False)])
def test_a_probe_reading_joins_the_next_sample_unless_it_is_old(model, store, age, taken):
    """A displacement of long ago, told when its sender is connected again, is not that of now."""
    fleet = fleet_of(replace(model, rule=model.rule._replace(wanted=4)), store, START)
    mill = fleet.machines["mill"]
    for k in range(120):
        arrivals = [Arrival("mill", START + k, [*readings(k)[:4], None], START + k)]
        if k == 110:
            arrivals.append(Arrival("mill", START + k - age, [*4 * [None], 20.0], START + k))
        processing.process(fleet, arrivals, *at(k))
        if k == 111:
            assert math.isfinite(mill.state.latest.readings[4]) == taken
    assert any(one.kind == "late" for one in fleet.log.take_pending()) != taken


@pytest.mark.parametrize("digest", [None, "another"])
def test_a_gap_over_a_restart_is_marked_under_another_model_too(model, store, path, fleet, digest):
    feed(fleet, store, 0, 10)
    other = model if digest is None else replace(model, digest=digest)
    fleet, _ = started(other, store, path, EventLog(), 50)
    feed(fleet, store, 50, 60)
    gaps = Archive(path).history("mill", 0.0, 1e11, 1000).gaps
    assert [(one.since - START, one.until - START, one.why) for one in gaps] == [
        (9.0, 50.0, "the service was down")
    ]


@pytest.mark.parametrize("kept_at", [30, 60, 90])
def test_a_restart_ends_no_silence(deaf, store, path, kept_at):
    """Of samples without any reading: it counts from the last one that had a reading."""
    fleet = fleet_of(deaf, store, START)
    for k in range(90):
        told = (20.0, 0.0) if k < 30 else (math.nan, math.nan)
        keep(fleet, store, Arrival("mill", START + k, told, START + k))
        if k + 1 == kept_at:
            checkpoint(fleet, store)
    again, (said,) = started(deaf, store, path, EventLog(), 90)
    assert again.machines["mill"].last_usable == START + 29
    assert (said.quality, said.offset_mode) == (Quality.BAD, "decay")


def test_an_estimate_from_before_the_computer_was_suspended_is_not_good(model, store):
    fleet = fleet_of(model, store, START)
    feed(fleet, store, 0, 60)
    assert not processing.check_silence(fleet, START + 60.0, START + 60.0)
    (said,) = processing.check_silence(fleet, START + 660.0, START + 61.0)
    assert (said.quality, said.offset_mode) == (Quality.BAD, "freeze")
    feed(fleet, store, 661, 675)
    assert fleet.machines["mill"].published_quality[0] is not Quality.BAD


def test_a_sample_without_readings_after_that_does_not_make_it_good(deaf, store):
    """Such a sample counts as silence, which goes on while the computer is suspended."""
    fleet = fleet_of(deaf, store, START)
    for k in range(60):
        keep(fleet, store, Arrival("mill", START + k, (20.0, 0.0), START + k))
    now, nothing = START + 660.0, (math.nan, math.nan)
    results = processing.process(fleet, [Arrival("mill", now, nothing, now)], now, START + 61.0)
    said = results.publications["mill"]
    assert (said.quality, said.offset_mode) == (Quality.BAD, "freeze")
    processing.check_silence(fleet, now + 1.0, START + 62.0)
    assert fleet.machines["mill"].published_quality[0] is Quality.BAD


def test_a_sample_from_before_the_clock_was_set_back_is_not_good(model, store, path):
    """The computer was off, perhaps for days, and its clock is behind at the start."""
    fleet, log = fleet_of(model, store, START), EventLog()
    feed(fleet, store, 0, 60)
    _, (said,) = started(model, store, path, log, 30)
    assert (said.quality, said.offset_mode) == (Quality.BAD, "freeze")
    assert "bad: no usable sample since the clock was set back" in [e.text for e in log.pending]


def late_since_set_back(fleet, first, last, start=0.0):
    """Readings by a clock that was set back by a day, when the service's own has gone on."""
    for k in range(first, last):
        now, clock = START + k - 86400.0, START + k - start
        arrival = Arrival("mill", now, readings(k), now)
        assert not processing.process(fleet, [arrival], now, clock).samples
        yield processing.set_back_machines(fleet, Times(now, clock))


def test_a_machine_begins_anew_when_the_clock_was_set_back_for_good_and_its_offset_stays(
    model, store, path
):
    fleet = fleet_of(model, store, START)
    feed(fleet, store, 0, 60)
    checkpoint(fleet, store)
    mill, sent = fleet.machines["mill"], fleet.machines["mill"].state.output
    *waits, due = late_since_set_back(fleet, 60, 121)
    assert (any(waits), due) == (False, [mill])
    now = START + 121 - 86400.0
    processing.begin_anew(fleet, mill, new_era(store, "mill", model.digest, model.layout, now), now)
    assert mill.state.output is sent
    checkpoint(fleet, store)
    again, _ = started(model, store, path, EventLog(), 121 - 86400)
    for one in (fleet, again):
        for k in range(121, 125):
            now = START + k - 86400.0
            arrival = Arrival("mill", now, readings(k), now)
            results = processing.process(one, [arrival], now, START + k)
            commit(store, Batch(results.samples if one is again else ()))
        latest = one.machines["mill"].state.latest
        assert (latest.time, latest.number) == (now, 64)
        assert "unsettled" in latest.status
    archive = Archive(path)
    times = archive.history("mill", 0.0, 1e11, 1000).columns.times.tolist()
    assert times == [START + k for k in (*range(121 - 86400, 125 - 86400), *range(60))]
    newest = archive.samples("mill", (-math.inf, math.inf), 1000, newest_first=True)
    assert [one.time for one in newest] == times[::-1]


def test_the_history_is_in_the_order_of_time_where_a_set_back_clock_repeats_it(model, store, path):
    """A client reads on from the time of the last sample, and misses none."""
    fleet = fleet_of(model, store, START)
    feed(fleet, store, 0, 60)
    checkpoint(fleet, store)
    mill, now = fleet.machines["mill"], START + 30.0
    processing.begin_anew(fleet, mill, new_era(store, "mill", model.digest, model.layout, now), now)
    feed(fleet, store, 30, 50)
    checkpoint(fleet, store)
    feed(fleet, store, 50, 55)
    for backwards in (False, True):
        found = Archive(path).samples("mill", (START, START + 60.0), 1000, backwards)
        times = [one.time - START for one in found]
        assert times == sorted([*range(60), *range(30, 55)], reverse=backwards)


def test_a_service_that_starts_with_the_clock_behind_waits_an_hour_for_the_network(
    model, store, path
):
    """A computer without a battery is told the time by the network, and then goes on as before."""
    feed(fleet_of(model, store, START), store, 0, 60)
    fleet, _ = started(model, store, path, EventLog(), 60 - 86400)
    *waits, due = late_since_set_back(fleet, 60, 60 + 3601, 86400.0)
    assert (any(waits), len(due)) == (False, 1)


def test_a_state_is_refused_once_and_those_after_it_are_kept(model, store, path):
    fleet, log = fleet_of(model, store, START), EventLog()
    feed(fleet, store, 0, 50)
    checkpoint(fleet, store)
    feed(fleet, store, 50, 55)
    store.execute("UPDATE states SET state = zeroblob(length(state))")
    for first in (60, 80):
        fleet, _ = started(model, store, path, log, first)
        feed(fleet, store, first, first + 10)
        checkpoint(fleet, store)
    fleet, (said,) = started(model, store, path, log, 100)
    archive = Archive(path)
    events = [*archive.events("mill", 0.0, 1e11, 1000), *log.pending]
    assert [one.kind for one in events].count("state-refused") == 1
    assert said.number == 20
    prune(store, 10**6, [], 1e9, START)
    history = archive.history("mill", 0.0, 1e11, 1000)
    assert history.columns.times.tolist() == [
        START + k for k in (*range(55), *range(60, 70), *range(80, 90))
    ]


def test_holes_and_eras_that_are_over_are_forgotten_like_the_rest(model, store, fleet):
    mill = fleet.machines["mill"]
    feed(fleet, store, 0, 10)
    feed(fleet, store, 50, 60)
    checkpoint(fleet, store)
    era = era_of(store, "mill", "another", model.layout, START + 100.0)
    for now in (START + 120.0, START + 200.0):
        prune(store, 0, [era], 90.0, now)
        left = [one[0] for one in store.execute("SELECT id FROM eras")]
        holes = store.execute("SELECT count(*) FROM holes").fetchone()[0]
        assert (left, holes) == (([mill.era, era], 1) if now < START + 190.0 else ([era], 0))
    assert not store.execute("SELECT count(*) FROM chunks").fetchone()[0]


def test_an_era_outlasts_a_start_of_its_successor_with_the_clock_behind(model, store, fleet):
    """A computer without a clock of its own begins in 1970, until the network tells it the time."""
    mill = fleet.machines["mill"]
    feed(fleet, store, 0, 10)
    checkpoint(fleet, store)
    era = era_of(store, "mill", "another", model.layout, 0.0)
    for now in (START + 60.0, START + 120.0):
        prune(store, 0, [era], 90.0, now)
        left = [one[0] for one in store.execute("SELECT id FROM eras")]
        assert left == ([mill.era, era] if now < START + 90.0 else [era])


def test_no_sequence_makes_an_offset_jump_or_lie():
    offset_invariant.violations(40)
