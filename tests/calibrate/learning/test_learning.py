"""A learned model holds on another day, names what is wrong, and refuses what it cannot."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from machine_logs import changed, machine_log, made

from calibrate.learning import blocks as sums
from calibrate.learning.learn import learn, learn_and_judge
from calibrate.learning.rules import Fitting, Thinning
from calibrate.learning.thinning import thinned
from estimator.columns import samples_of
from estimator.interface import Status, follow
from estimator.kind import Options
from estimator.learned.estimator import Learned
from estimator.learned.judging import judge, run
from estimator.learned.kind import KIND
from estimator.probe_readings import with_probe_readings
from estimator.quality import Quality, quality_of
from estimator.registry import resumed, save_state
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log, joined
from thermojoint.artefacts.quantities import column_named
from thermojoint.compensation.offsets.usable import Trust, usable
from thermojoint.models.filters.relaxations import relax_all
from thermojoint.models.learned import LearnedFrom, read_learned, write_learned

AXES = ["x_um", "z_um"]
LOG = machine_log()
#: Another day: other speeds, another clock.
DAY = machine_log(hours=10.0, seed=5, start=500000.0)


@pytest.fixture(scope="module")
def model():
    return learn([LOG], AXES, 4)


def test_it_holds_on_a_day_it_has_not_seen(model):
    for row in judge("day", Learned(model), DAY):
        assert row["rms_error_um"] < 0.12 * row["rms_uncompensated_um"], row
        assert row["band_cover"] > 0.9


def test_it_is_judged_by_a_displacement_in_another_unit(model):
    """A log is in SI; only the name of the column tells the unit."""
    columns = [
        replace(one, name="x_mm", unit="mm") if one.name == "x_um" else one for one in DAY.columns
    ]
    other = replace(DAY, columns=tuple(columns))
    found = judge("day", Learned(model), other)
    assert [row["axis"] for row in found] == ["x_mm", "z_um"]
    assert [{**row, "axis": ""} for row in found] == [
        {**row, "axis": ""} for row in judge("day", Learned(model), DAY)
    ]
    assert KIND.judged_in("day", Learned(model), other) == [
        (other, [("x_um", "x_mm"), ("z_um", "z_um")])
    ]


def test_held_out_estimates_have_the_error_and_the_band_that_the_model_states():
    model, held_out = learn_and_judge([LOG], AXES, 4, "linear")
    error = held_out.estimate - held_out.truth
    rms = 1e6 * np.sqrt((error**2).mean(axis=0))
    np.testing.assert_allclose(rms, model.learned_from.errors_um["linear"])
    assert held_out.times.shape == (len(error),)
    assert ((np.abs(error) <= held_out.band).mean(axis=0) > 0.9).all()


def test_no_more_sensors_are_used_than_asked_for(model):
    assert len(model.sensors) <= 4
    assert len(learn([LOG], AXES, 1).sensors) == 1


def test_baselines_are_fitted_with_the_same_data_and_run_by_the_same_estimator():
    found = learn([LOG], AXES, 4, "ridge")
    assert len(found.sensors) == 6
    rows = judge("day", Learned(found), DAY)
    assert all(row["rms_error_um"] < row["rms_uncompensated_um"] for row in rows)
    assert set(found.learned_from.errors_um) == {"learned", "linear", "ridge", "arx", "mean"}


def stuck(values):
    values[400:] = values[400]
    return values


def spiked(values):
    values[np.random.default_rng(0).choice(len(values), 25, replace=False)] += 40.0
    return values


def dropped(values):
    values[200:500] = np.nan
    return values


def moved(values):
    values[450:] += 6.0
    return values


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (stuck, "stuck at one value"),
        (spiked, "spikes"),
        (dropped, "missing"),
        (moved, "jumps by +6"),
        (lambda values: values * 0.0 + 900.0, "impossible for a machine tool"),
        (lambda values: values * 0.0 + 300.0, "never moves"),
    ],
)
def test_a_faulty_sensor_is_named_and_left_out(fault, said):
    found = learn([changed(LOG, "T3_degC", fault)], AXES, 4)
    [named] = found.learned_from.faults
    assert named.startswith("T3_degC: ")
    assert said in named
    assert "T3_degC" not in found.sensors
    for row in judge("day", Learned(found), DAY):
        assert row["rms_error_um"] < 0.3 * row["rms_uncompensated_um"]


def test_a_jump_against_the_trend_of_its_sensor_is_found_too():
    """A thermometer that cools by 1.5 K in the hour about it, then reads 2 K more."""

    def jumps(values):
        fall = np.interp(np.arange(len(values)), [400, 460], [0.0, 1.5])
        return values - fall + 2.0 * (np.arange(len(values)) > 430)

    found = learn([changed(LOG, "T6_degC", jumps)], AXES, 4)
    assert "T6_degC: jumps by +2.0 K" in found.learned_from.faults[0]


@pytest.mark.parametrize("slower", [1, 5])
def test_a_thermometer_with_a_display_in_whole_degrees_has_not_been_moved(slower):
    """As drives report the temperature of a motor, averaged by the logger or not."""
    log = changed(
        machine_log(interval=60.0 / slower),
        "T2_degC",
        lambda values: np.round(values - 0.15) + 0.15,
    )
    assert learn([log], AXES, 4).learned_from.faults == ()


def test_a_night_between_two_days_is_no_stillness():
    day = machine_log(hours=34.0, seed=4)
    hours = day.times / 3600.0
    kept = (hours < 10.0) | (hours > 24.0)
    # As loggers write them, to a tenth: the same value may well be read for some minutes.
    values = np.where(day.values > 200.0, np.round(day.values, 1), day.values)
    two_days = Log(day.times[kept], day.columns, values[kept])
    model = learn([two_days], ["x_um"])
    assert not [fault for fault in model.learned_from.faults if "stuck" in fault]
    assert model.sensors


@pytest.mark.parametrize("name", ["x_um", "T1_degC"])
def test_what_was_not_read_for_some_time_has_not_jumped_when_it_is_back(name):
    """Nor at the start of a run whose first reading is missing."""
    away = np.zeros(len(LOG.times), dtype=bool)
    away[650:800] = True
    gone = changed(LOG, name, lambda values: np.where(away, np.nan, values))
    size = 40.0 if name == "T1_degC" else 40e-6
    late = changed(LOG, name, lambda values: np.append(np.nan, values[1:] + size))
    late = changed(late, "n_rpm", lambda values: np.append(np.zeros(10), values[10:]))
    for log in (gone, joined([LOG, late])):
        assert "jumps" not in " ".join(learn([log], AXES, 2).learned_from.faults)


def test_what_was_not_read_for_some_time_was_not_stuck():
    away = (np.arange(len(LOG.times)) > 300) & (np.arange(len(LOG.times)) < 430)
    gone = changed(LOG, "T3_degC", lambda values: np.where(away, np.nan, values))
    (said,) = learn([gone], AXES, 2).learned_from.faults
    assert said == "T3_degC: 129 readings missing; bridged"


def test_a_change_of_speed_is_seen_where_the_speed_was_not_read():
    def grown(values):
        return values + 20e-6 * (LOG.at("n_rpm") > 0.0)

    turning = np.flatnonzero(np.abs(np.diff(LOG.at("n_rpm"))) > 0.0)
    unread = np.isin(np.arange(len(LOG.times)), [*turning, *(turning + 1)])
    log = changed(LOG, "n_rpm", lambda values: np.where(unread, np.nan, values))
    assert learn([changed(log, "x_um", grown)], AXES, 2).channels


def test_a_sound_log_has_no_fault(model):
    assert model.learned_from.faults == ()
    assert model.learned_from.warnings == ()


def test_a_few_spikes_are_left_out_and_the_sensor_stays():
    def two(values):
        values[[100, 300]] += 30.0
        return values

    found = learn([changed(LOG, "T1_degC", two)], AXES, 4)
    assert any("T1_degC: 2 spikes" in one for one in found.learned_from.faults)
    assert found.spans.get("T1_degC", (0.0, 0.0))[1] < 273.15 + 45.0


@pytest.mark.parametrize("size_um", [-999.0, 300.0])
def test_misreadings_of_a_displacement_are_left_out_and_named(model, size_um):
    """A displacement may be -999 mm, so that no number is an error value by itself."""

    start = 1 + int(np.flatnonzero(np.diff(LOG.at("n_rpm")) > 0.0)[0])

    def two(values):
        # In the second of them the spindle starts.
        values[[500, start]] = 1e-6 * size_um
        return values

    found = learn([changed(LOG, "x_um", two)], AXES, 4)
    assert found.learned_from.faults == ("x_um: 2 spikes; they are left out",)
    errors, clean = (one.learned_from.errors_um["learned"] for one in (found, model))
    np.testing.assert_allclose(errors, clean, rtol=0.05)
    assert found.channels[0].span[1] < 30e-6


def test_a_probe_that_often_misreads_is_refused():
    with pytest.raises(InputError, match="x_um: 25 spikes in 840 samples; check the probe"):
        learn([changed(LOG, "x_um", spiked)], AXES, 4)


def test_a_displacement_that_a_short_run_explains_is_no_spike():
    """A spindle is drawn back at once by the forces of its speed."""

    def short(size):
        def there(values):
            values[np.arange(50, len(values), 150)] += size
            return values

        return there

    log = changed(still(LOG, "n_rpm"), "n_rpm", short(300.0))
    log = changed(log, "x_um", short(15e-6))
    assert learn([log], AXES, 4).learned_from.faults == ()


def test_a_speed_far_above_every_one_that_was_held_is_left_out_and_named(model):
    def once(values):
        values[500] = 60000.0 * np.pi / 30.0
        return values

    found = learn([changed(LOG, "n_rpm", once)], AXES, 4)
    assert found.learned_from.faults == ("n_rpm: 1 spike; it is left out",)
    assert found.spans["n_rpm"] == model.spans["n_rpm"]


def test_short_runs_of_a_spindle_that_often_happen_are_no_spikes():
    def often(values):
        values[::60] = 60000.0 * np.pi / 30.0
        return values

    found = learn([changed(LOG, "n_rpm", often)], AXES, 4)
    assert not any("spike" in fault for fault in found.learned_from.faults)


def still(log, *names):
    for name in names:
        log = changed(log, name, lambda values: values * 0.0 + values[0])
    return log


def every(log, count):
    """The log of a slower logger."""
    return Log(log.times[::count], log.columns, log.values[::count])


def unlike(values):
    """A displacement that nothing in the log explains."""
    return 5e-6 * np.cumsum(np.random.default_rng(8).standard_normal(len(values))) / 20.0


def unread_is_zero(values):
    """As a control shows a probe that is away."""
    return np.where(np.arange(len(values)) % 60 < 25, 0.0, values + 40e-6)


def jump(values):
    values[500:] += 40e-6
    return values


def read_every(count):
    """A displacement that is probed now and then beside temperatures that are logged."""

    def rarely(values):
        return np.where(np.arange(len(values)) % count == 0, values, np.nan)

    return rarely


def for_two_hours(values):
    return np.where(np.arange(len(values)) < 120, values, np.nan)


@pytest.mark.parametrize(
    ("log", "said"),
    [
        (LOG.part(slice(0, 100)), "1.6 h long"),
        (changed(LOG, "x_um", lambda values: values * 0.0), "x_um: constant"),
        (changed(LOG, "x_um", jump), "as if the probe had lost its zero"),
        (changed(LOG, "x_um", unread_is_zero), "to 0 um, which it reaches 13 times, as where"),
        (changed(LOG, "x_um", read_every(18)), "x_um: 47 readings, 13.8 h from the first"),
        (changed(LOG, "x_um", for_two_hours), "x_um: 120 readings, 2.0 h from the first"),
        (still(LOG, "n_rpm", *(f"T{k}_degC" for k in range(1, 7))), "no usable temperature"),
        # What is left is the speed, which nobody has asked for alone.
        (still(LOG, *(f"T{k}_degC" for k in range(1, 7))), "exclude them with --ignore"),
        (changed(LOG, "x_um", unlike).part(slice(0, 700)), "no better than the mean (x_um "),
        (every(machine_log(hours=90.0), 90), "one every 90 min; to learn from"),
        (every(machine_log(hours=10.0), 15), "40 samples, one every 15 min"),
    ],
)
def test_a_log_that_cannot_be_learned_from_is_refused_in_one_line(log, said):
    with pytest.raises(InputError) as caught:
        learn([log], ["x_um"] if "mean" in said else AXES, 4)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def long_log():
    return machine_log(hours=60.0, seed=3)


def test_a_displacement_probed_once_an_hour_is_learned(long_log):
    log = changed(changed(long_log, "x_um", read_every(60)), "z_um", read_every(60))
    estimator = Learned(learn([log], AXES, 4))
    for row in judge("day", estimator, DAY):
        assert row["rms_error_um"] < 0.1 * row["rms_uncompensated_um"]
        assert row["band_cover"] > 0.9


def test_what_grows_between_two_readings_after_a_change_of_speed_is_no_jump():
    log = changed(changed(LOG, "x_um", read_every(10)), "z_um", read_every(10))
    assert learn([log], AXES, 4).channels


def test_displacements_probed_one_after_the_other_are_all_learned(long_log):
    """As a touch probe reads them: some of the readings fall into the same minute."""

    def a_minute_later(values):
        late = read_every(30)(np.roll(values, -1))
        same = np.arange(len(values)) < 600
        return np.where(same, read_every(30)(values), np.roll(late, 1))

    log = changed(changed(long_log, "x_um", read_every(30)), "z_um", a_minute_later)
    model = learn([log], AXES, 4)
    assert [channel.name for channel in model.channels] == AXES
    for row in judge("day", Learned(model), DAY):
        assert row["rms_error_um"] < 0.1 * row["rms_uncompensated_um"]


@pytest.mark.parametrize(
    "minutes", [*(pytest.param(often, marks=pytest.mark.long) for often in (15, 30)), 60]
)
def test_a_slow_logger_is_learned_from(long_log, minutes):
    """As long as the slowest relaxation that is learned, two hours, has two samples."""
    model = learn([every(long_log, minutes)], AXES, 4)
    assert len(model.sensors) == 4
    for row in judge("day", Learned(model), DAY):
        assert row["rms_error_um"] < 0.1 * row["rms_uncompensated_um"]


def test_one_verdict_is_given_and_a_band_wider_than_the_signal_is_said(model):
    told = LearnedFrom(
        worst_um={
            "learned": (3.0, 18.0),
            "linear": (4.0, 8.0),
            "ridge": (5.0, 2.0),
            "arx": (2.6, 16.0),
            "mean": (0.1, 0.1),
        }
    )
    # Much better on one displacement and worse on the other is no better.
    assert [told.best(kind) for kind in ("learned", "linear")] == ["arx", "linear"]
    # Both are the noise of the probe.
    even = LearnedFrom(worst_um={"learned": (0.07, 0.1), "arx": (0.04, 0.06)})
    assert even.best("learned") == "learned"
    assert not any("band" in one for one in model.learned_from.warnings)
    small = changed(LOG, "z_um", lambda values: 1.5e-7 * unlike(values) / unlike(values).std())
    small = changed(small, "z_um", lambda values: values + 0.04 * (LOG.at("z_um") - values))
    warnings = " ".join(learn([small], AXES, 4).learned_from.warnings)
    assert "z_um: the 95 % band" in warnings
    assert "x_um: the 95 % band" not in warnings


def test_names_that_are_not_there_and_columns_that_are_no_displacement_are_refused():
    for names, said in (
        (["y_um"], "no column named"),
        (["T1_degC"], "no displacement"),
        ([], "name what to learn"),
    ):
        with pytest.raises(InputError, match=said):
            learn([LOG], names)


def of_its_own_at_its_highest_speed(log):
    """The log of a spindle that grows by 20 µm more at that speed."""
    highest = log.at("n_rpm") > 0.9 * log.at("n_rpm").max()
    grown = relax_all(log.times, 20e-6 * highest[:, None], np.array([900.0]), np.zeros(1))[:, 0]
    return changed(log, "x_um", lambda values: values + grown)


@pytest.mark.parametrize(
    ("name", "ends"), [("n_rpm", "also above 3500"), ("n_percent", "load in use, also above 3500")]
)
def test_what_a_speed_that_was_never_run_may_cost_is_said_beforehand(name, ends):
    """A spindle that grows by a law of its own at its highest speed; then one by the usual law.

    Controls show speeds in percent as well, which are loads by their unit.
    """
    column = column_named(name)

    def named(log):
        values = log.values.copy()
        values[:, 0] = column.to_si(log.columns[0].from_si(values[:, 0]))
        return replace(log, columns=(column, *log.columns[1:]), values=values)

    unusual = named(of_its_own_at_its_highest_speed(LOG))
    (said,) = [text for text in learn([unusual], AXES).learned_from.warnings if "lacks" in text]
    of_x = re.search(r"x_um ([0-9.]+) \(otherwise ([0-9.]+)\)", said)
    assert float(of_x[1]) > 14.0 > 9.0 > float(of_x[2])
    assert said.startswith(f"{name}: ")
    assert said.endswith(ends)
    assert "lacks" not in " ".join(learn([named(LOG)], AXES).learned_from.warnings)


def test_a_speed_that_was_run_once_is_compared_with_the_others():
    """For some 80 min: no block of time but its own has seen it."""
    once = of_its_own_at_its_highest_speed(machine_log(seed=2))
    assert "lacks" in " ".join(learn([once], AXES).learned_from.warnings)


def test_what_the_log_cannot_tell_is_said():
    one = changed(LOG, "n_rpm", lambda values: np.where(values > 0.0, 100.0, 0.0))
    assert "one level only" in " ".join(learn([one], AXES).learned_from.warnings)
    none = still(LOG, "n_rpm")
    found = learn([none], AXES)
    assert "constant" in " ".join(found.learned_from.warnings)
    assert "n_rpm" not in found.columns


@pytest.mark.parametrize(
    ("name", "largest"),
    [
        pytest.param("I_A", 30.0, marks=pytest.mark.long),
        pytest.param("load_percent", 0.6, marks=pytest.mark.long),
        ("Xfeed_m_min", 0.5),
    ],
)
def test_a_motor_current_a_load_or_a_feed_drives_a_model_as_a_speed_does(name, largest):
    """In SI: a current and a load that are as the heat, a feed that is as the speed."""
    column = column_named(name)
    power = 1.0 if column.quantity == "feed" else 1.5

    def driven(log):
        values = log.values.copy()
        relative = values[:, 0] / log.columns[0].to_si(3500.0)
        values[:, 0] = largest * relative**power
        return replace(log, columns=(column, *log.columns[1:]), values=values)

    model = learn([driven(LOG)], AXES, 4)
    assert name in model.columns
    for row in judge("day", Learned(model), driven(DAY)):
        assert row["rms_error_um"] < 0.12 * row["rms_uncompensated_um"], row


def test_a_drive_that_goes_to_and_fro_within_a_minute_heats_by_its_size():
    """Its mean is nearly zero, but the estimator reads it sample by sample."""

    def to_and_fro(log):
        turns = np.where(np.arange(len(log.times)) % 2, -1.0, 1.0)
        return changed(log, "n_rpm", lambda values: turns * values)

    model = learn([to_and_fro(machine_log(interval=20.0))], AXES, 4)
    assert "n_rpm" in model.columns
    for row in judge("day", Learned(model), to_and_fro(DAY)):
        assert row["rms_error_um"] < 0.12 * row["rms_uncompensated_um"], row


def test_a_log_without_speed_and_one_without_temperatures_are_learned_from():
    assert "n_rpm" not in learn([LOG], AXES, ignored=["n_rpm"]).columns
    assert learn([LOG], AXES, ignored=[f"T{k}" for k in range(1, 7)]).columns == ("n_rpm",)


def test_days_with_zeros_of_their_own_are_learned_from_together():
    other = machine_log(seed=9)
    shifted = changed(other, "x_um", lambda values: values + 50e-6)
    days = learn([LOG, shifted], AXES, 4)
    assert len(days.sensors) == 4
    for row in judge("day", Learned(days), DAY):
        assert row["rms_error_zeroed_um"] < 0.2 * row["rms_uncompensated_zeroed_um"]


def test_the_order_in_which_runs_are_given_changes_nothing_but_the_end_of_the_log():
    """Their clocks begin anew, so that none is known to be the first."""
    runs = [machine_log(8.0, seed=1), machine_log(6.0, seed=2), machine_log(10.0, seed=3)]
    one, other = (learn(given, AXES, 2) for given in (runs, [runs[1], runs[2], runs[0]]))
    assert (one.log_end.time_s, other.log_end.time_s) == (runs[2].times[-1], runs[0].times[-1])
    assert replace(one, log_end=None) == replace(other, log_end=None)


def test_a_log_of_several_runs_is_learned_from_as_its_runs_one_by_one():
    whole = joined([LOG, machine_log(seed=9)])
    assert len(whole.starts) == 2
    assert learn([whole], AXES, 2) == learn(list(whole.runs()), AXES, 2)


def test_the_file_brings_the_model_back_and_damage_is_refused(model, tmp_path):
    path = tmp_path / "model.json"
    write_learned(model, path)
    assert read_learned(path) == model
    text = path.read_text("utf-8")
    for broken in (text[:-100], text.replace('"weights"', '"wieghts"', 1), "{}"):
        path.write_text(broken, encoding="utf-8")
        with pytest.raises(InputError):
            read_learned(path)


def test_a_saved_state_goes_on_bit_for_bit(model, tmp_path):
    estimator = Learned(model)
    samples = list(samples_of(model.columns, [DAY]))[:200]
    samples = list(
        with_probe_readings(samples, np.array([DAY.times[60]]), np.array([[1e-6, np.nan]]))
    )
    whole = [one for one, _ in follow(estimator, samples, estimator.initial_state())]
    save_state(estimator, whole[99], tmp_path / "state.json")
    _, begun = resumed(KIND, model, Options(), tmp_path / "state.json")
    rest = [one for one, _ in follow(estimator, samples[100:], begun)]
    np.testing.assert_array_equal(rest[-1], whole[-1])
    other = replace(model, duration_s=1.0)
    with pytest.raises(InputError, match="another model"):
        resumed(KIND, other, Options(), tmp_path / "state.json")


def test_a_log_that_goes_on_where_the_learned_one_ended_begins_with_what_it_left(model):
    cut = 600
    own = learn([LOG.part(slice(0, cut))], AXES, 4)
    rest = LOG.part(slice(cut, None))
    on, _, _ = run(Learned(own), rest)
    fresh, _, _ = run(Learned(replace(own, log_end=None)), rest)
    actual = np.stack([rest.at(name) for name in AXES], axis=1)
    assert np.abs(on - actual)[:30].mean() < np.abs(fresh - actual)[:30].mean()


def test_a_reading_missing_as_a_log_goes_on_is_the_last_one_of_the_learned_log():
    model = learn([LOG.part(slice(0, 600))], AXES, 4)
    estimator = Learned(model)
    time, *values = next(samples_of(model.columns, [LOG.part(slice(600, None))]))
    start = estimator.initial_state()
    whole = estimator.sample(start, time, values)[1]
    for k, name in enumerate(model.columns):
        without = [np.nan if own == k else value for own, value in enumerate(values)]
        found = estimator.sample(start, time, without)[1]
        assert found.missing == (name,)
        off = np.abs(found.displacement - whole.displacement)
        assert (off <= found.band - whole.band).all(), name


def biased(log, shift):
    return changed(log, "x_um", lambda values: values + shift)


def test_readings_now_and_then_correct_the_present(model):
    day = biased(DAY, 8e-6)
    actual = day.at("x_um")
    free, _, _ = run(Learned(model), day)
    read, band, words = run(Learned(model), day, 7200.0)
    error = np.abs(read[:, 0] - actual)
    assert np.sqrt((error**2).mean()) < 0.3 * np.sqrt(((free[:, 0] - actual) ** 2).mean())
    assert (error <= band[:, 0]).mean() > 0.9
    assert not any("refused" in one for one in words[200:])


def test_readings_improve_the_model_itself(model):
    """A machine whose gains have changed: after readings, it runs freely better than before."""
    day = changed(DAY, "z_um", lambda values: 1.3 * values)
    read, _, _ = run(Learned(model), day, 3600.0)
    free, _, _ = run(Learned(model), day)
    late = slice(len(day.times) // 2, None)
    error = [np.sqrt(((one[:, 1] - day.at("z_um"))[late] ** 2).mean()) for one in (read, free)]
    assert error[0] < 0.5 * error[1]


def test_a_reading_against_everything_is_refused_and_a_second_one_is_a_new_zero(model):
    estimator = Learned(model)
    samples = list(samples_of(model.columns, [DAY]))[:100]
    times = DAY.times[[20, 40, 60]]
    wrong = np.array([[5e-3, np.nan], [5e-3, np.nan], [5e-3, np.nan]])
    told = with_probe_readings(samples, times, wrong)
    found = [one for _, one in follow(estimator, told, estimator.initial_state())]
    assert Status.READING_REFUSED in found[20].status
    assert abs(found[30].displacement[0]) < 1e-4
    assert Status.READING_REFUSED not in found[40].status
    assert found[50].displacement[0] == pytest.approx(5e-3, rel=0.05)


@pytest.mark.parametrize("bad", [np.nan, 9999.0 + 273.15, -3276.8, 1e9])
def test_what_is_no_reading_is_missing_and_said(model, bad):
    """By whichever way it comes: a command, a data frame, the service or Python."""
    gone = changed(DAY, model.sensors[0], lambda values: np.full_like(values, bad))
    nothing = changed(DAY, model.sensors[0], lambda values: np.full_like(values, np.nan))
    estimate, _, words = run(Learned(model), gone)
    np.testing.assert_array_equal(estimate, run(Learned(model), nothing)[0])
    assert all("reading-missing" in one for one in words)


def without(log, names, rows):
    for name in names:
        log = changed(log, name, lambda values: np.where(rows, np.nan, values))
    return log


def estimates(model, log):
    """Every estimate of a run."""
    estimator = Learned(model)
    samples = samples_of(model.columns, [log])
    return [one for _, one in follow(estimator, samples, estimator.initial_state())]


@pytest.mark.parametrize(
    "kind",
    ["learned", *(pytest.param(other, marks=pytest.mark.long) for other in ("ridge", "arx"))],
)
def test_ten_hours_without_any_reading_widen_the_band_and_make_the_estimate_bad(kind):
    model = learn([LOG], AXES, 4, kind)
    day = machine_log(hours=16.0, seed=5, start=500000.0)
    gone = (np.arange(960) >= 200) & (np.arange(960) < 800)
    found = estimates(model, without(day, model.columns, gone))
    band = np.array([one.band for one in found])
    assert (np.diff(band[200:800], axis=0) > -0.01 * band[200:799]).all()
    assert (band[799] > 3.0 * band[199]).all()
    error = np.array([one.displacement for one in found])
    error -= np.stack([day.at(axis) for axis in AXES], axis=1)
    assert (np.abs(error) <= band)[200:].mean() > 0.95
    quality = np.array([quality_of(one.words, one.displacement) for one in found])
    assert quality[199] == Quality.GOOD
    assert quality[200] == Quality.UNCERTAIN
    assert (quality[260:800] == Quality.BAD).all()
    assert (quality[800:] < Quality.BAD).all()
    assert quality[-1] == Quality.GOOD
    trust = Trust((), np.inf, np.inf)
    assert not any(usable(trust, 0.0, one.band, one.words) for one in found[260:800])


def test_a_state_from_before_bounds_were_kept_goes_on(model, tmp_path):
    estimator = Learned(model)
    values = [model.spans[name][0] for name in model.columns]
    state, _ = estimator.sample(estimator.initial_state(), 0.0, values)
    save_state(estimator, state[: -2 * len(model.features)], tmp_path / "state.json")
    _, begun = resumed(KIND, model, Options(), tmp_path / "state.json")
    np.testing.assert_array_equal(begun, state)


@settings(max_examples=20, deadline=None)
@given(data=st.data(), hours=st.floats(0.05, 30.0))
def test_the_more_is_missing_and_the_longer_the_wider_is_the_band(model, data, hours):
    names = data.draw(st.permutations(model.columns))
    few = data.draw(st.integers(0, len(names)))
    many = data.draw(st.integers(few, len(names)))
    estimator = Learned(model)
    known = {name: model.spans[name][0] for name in names}

    def bands(missing):
        values = [np.nan if name in missing else known[name] for name in model.columns]
        start = [known[name] for name in model.columns]
        state, _ = estimator.sample(estimator.initial_state(), 0.0, start)
        for time in (3600.0 * hours, 7200.0 * hours):
            state, found = estimator.sample(state, time, values)
            yield found.band

    one, two = bands(names[:few]), bands(names[:many])
    (early, late), (wide, wider) = one, two
    assert (early <= late * (1.0 + 1e-9)).all()
    assert (early <= wide).all()
    assert (late <= wider).all()


def test_a_start_on_a_warm_machine_and_a_pause_are_said_until_they_have_died_out(model):
    """The same machine, cold, is settled at once."""
    day = machine_log(hours=24.0, seed=5, start=500000.0)
    hottest = int(day.at(model.sensors[0])[:900].argmax())
    warm = estimates(model, day.part(slice(hottest, None)))
    unsettled = np.array([Status.UNSETTLED in one.status for one in warm])
    assert unsettled[0]
    assert not unsettled[unsettled.argmin() :].any()
    assert not unsettled[-1]
    assert Status.UNSETTLED not in estimates(model, DAY)[0].status
    kept = np.r_[: hottest - 180, hottest : len(day.times)]
    paused = estimates(model, Log(day.times[kept], day.columns, day.values[kept]))
    assert Status.UNSETTLED not in paused[hottest - 181].status
    assert Status.UNSETTLED in paused[hottest - 180].status


@settings(max_examples=40, deadline=None)
@given(
    kelvin=st.lists(st.floats(250.0, 400.0), min_size=6, max_size=6),
    speed=st.floats(0.0, 2000.0),
    hours=st.floats(0.01, 1e5),
)
def test_an_estimate_is_bounded_by_what_is_measured_or_says_so(model, kelvin, speed, hours):
    estimator = Learned(model)
    state = estimator.initial_state()
    known = dict(zip((f"T{k}_degC" for k in range(1, 7)), kelvin, strict=True)) | {"n_rpm": speed}
    values = [known[name] for name in model.columns] + [np.nan] * 2
    signals = model.signals(np.array([known[name] for name in model.columns]))
    for time in (0.0, 3600.0 * hours, 7200.0 * hours):
        state, found = estimator.sample(state, time, values)
        for value, one in zip(found.displacement, model.channels, strict=True):
            most = sum(abs(w) * abs(s) for w, s in zip(one.weights, signals, strict=True))
            assert abs(value - one.zero) <= most * (1.0 + 1e-9) + 1e-12
            low, high = one.span
            if not low - (high - low) / 2 <= value <= high + (high - low) / 2:
                assert Status.BEYOND_DISPLACEMENT in found.status


def test_where_the_log_has_not_been_is_said(model):
    estimator = Learned(model)
    cold = {name: model.spans[name][0] for name in model.columns}

    def words(time, **changes):
        known = cold | changes
        values = [known[name] for name in model.columns] + [np.nan] * 2
        state, _ = estimator.sample(estimator.initial_state(), 0.0, values)
        return estimator.sample(state, time, values)[1].status

    sensor = model.sensors[0]
    assert words(60.0) == Status.OK
    assert Status.BEYOND_TEMPERATURE in words(60.0, **{sensor: cold[sensor] + 50.0})
    assert Status.BEYOND_HEAT in words(60.0, n_rpm=2.0 * model.spans["n_rpm"][1])
    # It heats as much if it turns the other way.
    fastest = model.spans["n_rpm"][1]
    assert Status.BEYOND_HEAT not in words(60.0, n_rpm=-1.04 * fastest)
    assert Status.BEYOND_HEAT in words(60.0, n_rpm=-1.06 * fastest)
    assert Status.BEYOND_TIME in words(10.0 * model.duration_s)


def test_the_band_grows_where_the_log_has_not_been(model):
    estimator = Learned(model)
    sensor = model.sensors[0]

    def band(rise):
        known = {name: 0.5 * sum(model.spans[name]) for name in model.columns}
        known[sensor] += rise
        values = [known[name] for name in model.columns] + [np.nan] * 2
        return estimator.sample(estimator.initial_state(), 0.0, values)[1].band

    assert (band(60.0) > 1.5 * band(0.0)).all()


def test_bad_samples_are_refused_and_the_state_may_be_used_again(model):
    estimator = Learned(model)
    good = [0.5 * sum(model.spans[name]) for name in model.columns] + [np.nan] * 2
    state, _ = estimator.sample(estimator.initial_state(), 5.0, good)
    for time, values in ((5.0, good), (np.nan, good), (6.0, good[:-1]), (6.0, [np.inf, *good[1:]])):
        with pytest.raises(InputError):
            estimator.sample(state, time, values)
    estimator.sample(state, 6.0, good)


def test_relaxations_are_those_of_the_differential_equation():
    times = np.array([0.0, 100.0, 250.0, 900.0])
    ramp = 0.01 * times[:, None]
    found = relax_all(times, ramp, np.array([300.0]), np.zeros(1))[:, 0]
    exact = 0.01 * (times - 300.0 * (1.0 - np.exp(-times / 300.0)))
    assert found == pytest.approx(exact, rel=1e-12, abs=1e-15)


def test_errors_on_blocks_held_out_are_those_of_fitting_without_them():
    draw = np.random.default_rng(3)
    rows = draw.standard_normal((400, 5)) + 2.0
    blocks = sums.blocks_of(rows, 3, 60.0, Fitting(fewest=4, most=4))
    [weights] = sums.weights_of(blocks, [0, 2], [0.5])
    found = sums.held_out(blocks, weights[:-1])
    for k, (first, end) in enumerate(((0, 100), (100, 200), (200, 300), (300, 400))):
        away = np.ones(400, dtype=bool)
        away[max(0, first - 30) : end + 30] = False
        kept, mean = rows[away], rows[away].mean(axis=0)
        x, y = (kept - mean)[:, [0, 2]], (kept - mean)[:, 3:]
        w = np.linalg.solve(x.T @ x + 0.5 * 60.0 * np.eye(2), x.T @ y)
        error = (rows[first:end] - mean)[:, 3:] - (rows[first:end] - mean)[:, [0, 2]] @ w
        assert found[k] == pytest.approx((error**2).mean(axis=0), rel=1e-9)


def test_a_long_log_becomes_a_table_of_bounded_size():
    pieces = [LOG.part(slice(first, first + 100)) for first in range(0, len(LOG.times), 100)]
    table = thinned(pieces, rules=Thinning(most_rows=200))
    assert len(table.times) <= 200
    assert table.interval == pytest.approx(480.0)
    assert table.starts == (0,)
    assert table.samples == len(LOG.times)
    whole = LOG.at("T3_degC").mean()
    assert table.values[:, LOG.index("T3_degC")].mean() == pytest.approx(whole, abs=0.05)


def test_a_log_of_one_day_may_have_gaps_and_uneven_samples():
    draw = np.random.default_rng(1)
    kept = np.sort(draw.choice(len(LOG.times), 500, replace=False))
    kept = kept[(kept < 300) | (kept > 340)]
    uneven = made(
        LOG.times[kept],
        LOG.names,
        np.stack([c.from_si(v) for c, v in zip(LOG.columns, LOG.values[kept].T, strict=True)], 1),
    )
    for row in judge("day", Learned(learn([uneven], AXES, 4)), DAY):
        assert row["rms_error_um"] < 0.2 * row["rms_uncompensated_um"]
