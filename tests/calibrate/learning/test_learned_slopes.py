"""A displacement read along an axis: K0 and slope, each a filter of the inputs, learned jointly."""

import numpy as np
import pytest
from exported import PRECISIONS, SANITISED, compiled, needs_gcc, selftest, written
from machine_logs import NAMES, along_log, changed, made
from matiec import needs_matiec, selftest_by_both
from moving_knee import coarse_data

from calibrate.learning.learn import learn, learn_and_judge
from estimator.columns import samples_of
from estimator.exporting import export_program
from estimator.interface import Status, follow
from estimator.learned.estimator import Learned
from estimator.learned.judging import judge
from estimator.learned.program import UNPLACED
from estimator.probe_readings import with_probe_readings
from fesim.case.schema import case_from_data
from fesim.simulate import simulate
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.models.learned import read_learned, write_learned

WANTED = ["x_um@y_pos_mm"]
LOG, K0, SLOPE = along_log(every=5)
DAY, DAY_K0, DAY_SLOPE = along_log(hours=10.0, seed=5, start=500000.0, every=1)


@pytest.fixture(scope="module")
def model():
    return learn([LOG], WANTED, 4)


def line(model, log):
    """K0 and its band, µm, slope and its band, µm/m, for every sample."""
    samples = samples_of(model.columns, [log], model.positions)
    estimator = Learned(model)
    results = [one for _, one in follow(estimator, samples, estimator.initial_state())]
    k0 = np.array([(one.displacement[0], one.band[0]) for one in results]).T
    slope = np.array([one.details[:2] for one in results]).T
    return 1e6 * k0, 1e6 * slope


def test_k0_and_slope_hold_on_a_day_that_was_not_seen(model):
    (k0, k0_band), (slope, slope_band) = line(model, DAY)
    p0 = model.channels[0].slope.reference
    truth = DAY_K0 + DAY_SLOPE * (p0 - 0.05)
    assert np.sqrt(((k0 - truth) ** 2).mean()) < 0.1 * truth.std()
    assert np.sqrt(((slope - DAY_SLOPE) ** 2).mean()) < 0.15 * DAY_SLOPE.std()
    assert (np.abs(k0 - truth) <= k0_band).mean() > 0.95
    assert (np.abs(slope - DAY_SLOPE) <= slope_band).mean() > 0.95


def test_it_is_judged_at_the_positions_of_the_log(model):
    [row] = judge("day", Learned(model), DAY)
    assert row["rms_error_um"] < 0.05 * row["rms_uncompensated_um"]
    assert row["band_cover"] > 0.95
    with pytest.raises(InputError, match="no better than the mean"):
        learn([along_log(every=1)[0]], ["x_um"], 4)
    without = DAY.names.index("y_pos_mm")
    with pytest.raises(InputError, match="without y_pos_mm"):
        judge("day", Learned(model), Log(DAY.times, DAY.columns[:without], DAY.values[:, :without]))


def test_held_out_blocks_are_estimated_as_well_as_the_model_says():
    model, held_out = learn_and_judge([LOG], WANTED, 4)
    error = 1e6 * (held_out.estimate - held_out.truth)
    assert np.sqrt((error**2).mean()) == pytest.approx(model.learned_from.errors_um["learned"][0])
    assert model.learned_from.errors_um["learned"][0] < 1.0


def test_columns_at_stated_positions_are_the_same_displacement():
    sampled = [own.from_si(LOG.at(own.name)) for own in LOG.columns if own.name != "y_pos_mm"]
    places = (-100.0, 60.0, 250.0)
    columns = [K0 + 1e-3 * SLOPE * (at - 50.0) for at in places]
    names = (*NAMES, *(f"x@{at:g}mm_um" for at in places))
    values = np.column_stack((*sampled, *columns))
    kept = [k for k, name in enumerate(names) if name != "x_um"]
    log = made(LOG.times, [names[k] for k in kept], values[:, kept])
    found = learn([log], ["x"], 4)
    (k0, _), (slope, _) = line(found, log)
    assert found.channels[0].slope.reference == pytest.approx(0.075)
    assert np.sqrt(((k0 - K0 - 0.025 * SLOPE) ** 2).mean()) < 0.5
    assert np.sqrt(((slope - SLOPE) ** 2).mean()) < 3.0
    assert [row["axis"] for row in judge("day", Learned(found), log)] == [*names[-3:]]


def test_beside_a_displacement_of_one_place_neither_changes_the_other(model):
    both = learn([LOG], ["z_um", *WANTED], 4)
    alone = learn([LOG], ["z_um"], 4)
    samples = [(1000.0 * k, *row) for k, row in enumerate(DAY.values[:20].tolist(), 1)]
    log = Log(np.array([row[0] for row in samples]), DAY.columns, DAY.values[:20])
    found = [
        [
            one.displacement
            for _, one in follow(
                Learned(own), samples_of(own.columns, [log]), Learned(own).initial_state()
            )
        ]
        for own in (both, alone, model)
    ]
    np.testing.assert_allclose(np.array(found[0])[:, :1], found[1], rtol=1e-9)
    np.testing.assert_allclose(np.array(found[0])[:, 1:], found[2], rtol=1e-9)


def test_readings_at_positions_correct_k0_and_slope(model):
    estimator = Learned(model)
    samples = list(samples_of(model.columns, [DAY], model.positions))[:6]
    free = [one for _, one in follow(estimator, samples, estimator.initial_state())]
    # A machine whose slope is 40 µm/m larger than learned.
    p0 = model.channels[0].slope.reference
    places = [-0.1, 0.2, -0.1, 0.2, -0.1, 0.2]
    read = [
        one.displacement[0] + (one.details[0] + 40e-6) * (at - p0)
        for one, at in zip(free, places, strict=True)
    ]
    times = np.array([row[0] for row in samples])
    corrected = with_probe_readings(samples, times, np.column_stack((read, places)))
    after = [one for _, one in follow(estimator, corrected, estimator.initial_state())]
    assert not any(one.status & Status.READING_REFUSED for one in after)
    gained = after[-1].details[0] - free[-1].details[0]
    assert 10e-6 < gained < 45e-6
    assert abs(after[-1].displacement[0] - free[-1].displacement[0]) < 3e-6
    nowhere = [(*row[:-1], np.nan, 0.0) for row in samples]
    [*_, (_, refused)] = follow(estimator, nowhere, estimator.initial_state())
    assert refused.status & Status.READING_REFUSED
    np.testing.assert_array_equal(refused.displacement, free[-1].displacement)


@pytest.mark.parametrize(
    ("log", "wanted", "said"),
    [
        (along_log(reach_mm=5.0)[0], WANTED[0], "over 20 mm or more"),
        (along_log(moved_hours=2.0)[0], WANTED[0], "in 2 of 14 hours .* needs 3 or more"),
        (LOG, "x_um@n_rpm", "n_rpm is no length"),
        (LOG, "x_um@where", "where"),
        (along_log(every=30)[0], WANTED[0], "28 readings .* 48 or more"),
    ],
)
def test_a_log_that_does_not_show_the_slope_is_refused(log, wanted, said):
    with pytest.raises(InputError, match=said):
        learn([log], [wanted], 4)


def test_days_that_each_stand_at_one_position_show_no_slope():
    """The same hours of two days are not one hour that saw both ends."""
    days = [
        changed(along_log(seed=seed)[0], "y_pos_mm", lambda at, end=end: 0.0 * at + end)
        for seed, end in enumerate((-0.1, 0.2))
    ]
    with pytest.raises(InputError, match="in 0 of 28 hours"):
        learn(days, WANTED, 4)


def test_a_slope_that_was_seldom_seen_is_flagged():
    [said] = learn([along_log(moved_hours=5.0)[0]], WANTED, 4).learned_from.warnings
    assert "in 4 of 14 hours" in said
    assert "read both ends every hour" in said


def test_arx_and_export_are_for_one_place(model):
    with pytest.raises(InputError, match="not for a displacement along an axis"):
        learn([LOG], WANTED, 4, "arx")


def test_a_file_keeps_it(model, tmp_path):
    path = tmp_path / "model.json"
    write_learned(model, path)
    assert read_learned(path) == model
    path.write_text(path.read_text().replace('"zero"', '"none"'), encoding="utf-8")
    with pytest.raises(InputError, match="learn again"):
        read_learned(path)


def test_the_line_of_a_simulated_knee_is_learned_from_its_thermometers(tmp_path):
    heat = tmp_path / "heat.csv"
    heat.write_text(
        "time_s,heat_input\n0,1\n9000,1\n9060,0\n14400,0\n14460,0.6\n24000,0.6\n24060,0.2\n"
    )
    places = [-100.0, 50.0, 200.0]
    data = coarse_data()
    data["axes"]["y"]["asked_mm"] = places
    data["march"] |= {"step_s": 120.0, "duration_min": 480.0}
    data["heat_input"] = {"kind": "sampled", "file": str(heat)}
    response = simulate(case_from_data(data, "knee", tmp_path)).response
    times = response["time"].to_numpy()[1:]
    rise = response["temperature"].to_numpy()[1:]
    asked = 1e6 * response["asked_displacement"].sel(axis="x").to_numpy()[1:, 0]
    drawn = np.random.default_rng(1)
    asked = asked + 0.2 * drawn.standard_normal(asked.shape)
    load = 100.0 * response["heat_input"].to_numpy()[1:].reshape(len(times), -1)[:, :1]
    names = ["load_percent", *(f"T{k}_degC" for k in range(rise.shape[1]))]
    values = np.column_stack((load, 20.0 + rise + 0.02 * drawn.standard_normal(rise.shape)))
    read = asked.copy()
    # A probing cycle every ten minutes.
    read[np.arange(len(times)) % 5 != 0] = np.nan
    columns = [f"x@{at:g}mm_um" for at in places]
    log = made(times, [*names, *columns], np.column_stack((values, read)))
    found = learn([log], ["x_um"], 4)
    (k0, _), (slope, _) = line(found, log)
    assert found.channels[0].slope.reference == pytest.approx(0.05)
    truth = 1e6 * response["line_offset"].sel(axis="x").to_numpy()[1:, 0]
    tangent = 1e6 * response["line_slope"].sel(axis="x").to_numpy()[1:, 0]
    assert np.sqrt(((k0 - truth) ** 2).mean()) < 0.1 * truth.std()
    assert np.sqrt(((slope - tangent) ** 2).mean()) < 0.1 * tangent.std()


@needs_gcc
def test_its_program_is_the_estimator_along_the_axis(model, tmp_path):
    """A position that was not read is the last one in the program; Python says nothing of it."""
    samples = np.array(list(samples_of(model.columns, [DAY], model.positions)))
    step = samples[1, 0] - samples[0, 0]
    found = export_program(Learned(model), name="m", samples=samples.tolist(), interval=step)
    selftest(written(found, tmp_path), "m", "-O1", *SANITISED)
    given = samples[:60].copy()
    given[20:30, -1] = np.nan
    rows = np.column_stack([np.full(60, step), given[:, 1:]]).tolist()
    got = list(compiled(found, tmp_path)(rows))
    estimator = Learned(model)
    followed = follow(estimator, given.tolist(), estimator.initial_state())
    names = [channel.name for channel in estimator.details]
    for k, (one, (_, there)) in enumerate(zip(got, followed, strict=True)):
        missing = 20 <= k < 30
        assert one.status == int(there.status) | missing * UNPLACED
        known = dict(zip(names, there.details, strict=True))
        assert one.band[0] == pytest.approx(there.band[0], rel=1e-9)
        assert one.slope_band[0] == pytest.approx(known["x_slope_band"], rel=1e-9)
        assert 1e3 * one.P0[0] == pytest.approx(known["x_P0"], rel=1e-9)
        if not missing:
            assert one.here_band[0] == pytest.approx(known["x_here_band"], rel=1e-9)
        # The place is that of the last position.
        line = one.displacement[0] + one.slope[0] * (samples[19 if missing else k, -1] - one.P0[0])
        assert one.here[0] == pytest.approx(line, rel=1e-9)


@needs_gcc
@needs_matiec
@pytest.mark.parametrize("precision", PRECISIONS)
def test_its_function_block_is_the_estimator_along_the_axis(model, precision, tmp_path):
    selftest_by_both(export_program(Learned(model), precision, "m"), tmp_path)
