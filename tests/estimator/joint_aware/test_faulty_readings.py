"""An observer whose sensors lie, that starts on a warm machine, or is told the displacement."""

from dataclasses import replace

import numpy as np
import pytest
from observed import FAULTS, ONSET, SENSORS, errors, estimates, faulty, run, step
from typer.testing import CliRunner

from estimator.interface import Status
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.model_file import write_observer
from estimator.joint_aware.readings import samples_in
from estimator.joint_aware.thresholds import Thresholds
from estimator.probe_readings import beside, read_probe_readings, with_probe_readings
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log_file import log_pieces
from thermojoint.artefacts.response import write_response
from thermojoint.cli.app import app

MICRO = 1e-6


@pytest.fixture(scope="module")
def response(stepped):
    return stepped


@pytest.mark.parametrize(
    "sensor",
    [0, *(pytest.param(other, marks=pytest.mark.long) for other in (1, 2)), 3],
    ids=lambda k: SENSORS[k],
)
@pytest.mark.parametrize("fault", FAULTS)
def test_one_sensor_of_four_that_lies_is_named_and_survived(estimator, response, fault, sensor):
    _, found = estimates(estimator, faulty(response, sensor, FAULTS[fault]))
    name = SENSORS[sensor]
    named = [one.time for one in found if name in (*one.distrusted, *one.missing)]
    assert named
    assert named[0] - found[ONSET].time <= 60.0
    assert not any({*one.distrusted, *one.missing} - {name} for one in found)
    wrong = np.abs(errors(estimator, response, found))
    bands = np.array([one.band for one in found])
    assert np.all(wrong <= np.maximum(1.0 * MICRO, bands))
    assert name in found[-1].words or fault == "spikes"


def test_a_lost_sensor_widens_the_band(estimator, response):
    _, healthy = estimates(estimator, list(samples_in(response, SENSORS)))
    _, found = estimates(estimator, faulty(response, 0, FAULTS["broken"]))
    assert np.all(found[-1].band > 2.0 * healthy[-1].band)
    assert Status.SENSOR_DISTRUSTED in found[-1].status


def test_where_the_past_is_known_the_other_sensors_are_believed_more(estimator, response):
    samples = faulty(response, 0, FAULTS["away"])
    _, found = estimates(estimator, samples)
    doubtful = replace(estimator, thresholds=Thresholds(doubt_of_heat=1.0))
    _, doubting = estimates(doubtful, samples)
    assert np.all(found[-1].band < 0.5 * doubting[-1].band)
    bands = np.array([one.band for one in found])
    assert np.all(np.abs(errors(estimator, response, found)) <= np.maximum(1.0 * MICRO, bands))


@pytest.mark.parametrize("jump", [3.0, 5.0])
def test_while_a_jump_is_not_judged_the_band_holds_the_state_without_it(estimator, response, jump):
    _, healthy = estimates(estimator, list(samples_in(response, SENSORS)))
    _, found = estimates(estimator, faulty(response, 0, lambda values: values + jump))
    for one, other in zip(found[ONSET : ONSET + 6], healthy[ONSET : ONSET + 6], strict=True):
        assert np.all(np.abs(one.displacement - other.displacement) <= one.band)


def test_the_heat_that_is_switched_on_at_once_is_no_fault(estimator, data, setup):
    response = run(data, setup, step(3.0), 4.0)
    _, found = estimates(estimator, samples_in(response, SENSORS))
    assert not any(one.distrusted for one in found)


def test_a_start_on_a_warm_machine_is_noticed(estimator, response):
    """It was said to be cold: most readings contradict, and the past is taken to be unknown."""
    samples = list(samples_in(response, SENSORS))[150:]
    _, found = estimates(estimator, samples)
    assert Status.UNSETTLED in found[0].status
    assert not any(one.distrusted for one in found)
    wrong = np.abs(errors(estimator, response.isel(time=slice(150, None)), found))
    assert np.all(wrong <= np.array([one.band for one in found]))


def touched(response, estimator, every, shift=0.0):
    """Samples with readings of the displacement now and then."""
    actual = response["displacement"].sel(axis=list(estimator.axes)).to_numpy() + shift
    times = response["time"].to_numpy()
    return with_probe_readings(
        samples_in(response, SENSORS), times[every::every], actual[every::every]
    )


def test_a_reading_of_the_displacement_corrects_a_warm_start(estimator, response):
    late = response.isel(time=slice(100, None))
    start = estimator.warm_state()
    _, alone = estimates(estimator, samples_in(late, SENSORS), start)
    _, told = estimates(estimator, touched(late, estimator, 20), start)
    before, after = (np.abs(errors(estimator, late, one))[20:60].max() for one in (alone, told))
    assert after < 0.5 * before
    assert np.all(told[20].band < 0.5 * alone[20].band)


def test_a_reading_that_contradicts_everything_is_refused(estimator, response):
    _, alone = estimates(estimator, samples_in(response, SENSORS))
    _, told = estimates(estimator, touched(response, estimator, 100, shift=500.0 * MICRO))
    assert Status.READING_REFUSED in told[100].status
    assert told[100].displacement == pytest.approx(alone[100].displacement, rel=1e-9)


def test_a_second_reading_off_along_one_axis_confirms_the_first(estimator, response):
    """Along the other one both are right, but for their noise."""
    band = replace(estimator.model.band, constant=np.full(2, (0.5 * MICRO) ** 2))
    plain = JointAware(replace(estimator.model, band=band))
    actual = response["displacement"].sel(axis=["x", "y"]).to_numpy()
    nothing, noise = [np.nan, np.nan], {50: 0.3 * MICRO, 100: -0.3 * MICRO}
    rows = [
        [*row, *(actual[k] + [20.0 * MICRO, noise[k]] if k in noise else nothing)]
        for k, row in enumerate(samples_in(response, SENSORS))
    ]
    _, found = estimates(plain, rows)
    assert Status.READING_REFUSED in found[50].status
    assert Status.READING_REFUSED not in found[100].status
    off = found[100].displacement - actual[100]
    assert off[0] == pytest.approx(20.0 * MICRO, abs=1.0 * MICRO)


def test_a_reading_that_is_confirmed_counts_however_sure_the_model_is(estimator, response):
    """Most of what is expected of a reading is its own noise, which is as it was."""
    band = replace(estimator.model.band, constant=np.full(2, (0.03 * MICRO) ** 2))
    sure = JointAware(replace(estimator.model, band=band))
    _, told = estimates(sure, touched(response, sure, 50, shift=5.0 * MICRO))
    assert Status.READING_REFUSED in told[50].status
    left = errors(sure, response, told)[100] - 5.0 * MICRO
    assert np.all(np.abs(left) < 0.5 * MICRO)
    assert np.all(told[100].band > 0.5 * MICRO)


def test_readings_that_contradict_each_other_again_and_again_are_refused(estimator, response):
    """Two of a kind in turn: each second one is confirmed until the model's error has no more."""
    samples = np.array(list(samples_in(response, SENSORS)))[:120]
    signs = np.column_stack(
        [np.resize([1.0, 1.0, -1.0, -1.0], 120), np.resize([1.0] * 4 + [-1.0] * 4, 120)]
    )
    _, found = estimates(estimator, np.hstack([samples, signs * [5e-3, 3e-3]]).tolist())
    assert np.isfinite([one.band for one in found]).all()
    assert all(Status.READING_REFUSED in one.status for one in found[100:])


def test_readings_between_two_samples_go_with_the_later_one():
    samples = [(0.0, 1.0), (2.0, 1.0), (4.0, 1.0)]
    times, values = np.array([-1.0, 1.0, 1.5]), np.array([[9.0, 9.0], [1.0, np.nan], [2.0, 3.0]])
    found = np.array(list(with_probe_readings(samples, times, values)))
    assert np.isnan(found[[0, 2], 2:]).all()
    assert np.array_equal(found[1, 2:], [2.0, 3.0])


def test_readings_go_with_the_position_where_they_were_made():
    """Of two places between two samples the later one counts; a position alone says nothing."""
    samples = [(0.0, 1.0), (60.0, 1.0), (120.0, 1.0)]
    x, z, at = 0, 1, 2
    values = np.full((5, 3), np.nan)
    values[0, [x, at]], values[1, [z, at]], values[2, at] = (5.0, 0.0), (6.0, 0.0), 0.4
    values[3, [x, at]], values[4, [z, at]] = (7.0, 0.1), (8.0, 0.2)
    times = np.array([10.0, 20.0, 50.0, 70.0, 80.0])
    found = np.array(list(with_probe_readings(samples, times, values, places=1)))
    np.testing.assert_array_equal(found[1:, 2:], [[5.0, 6.0, 0.0], [np.nan, 8.0, 0.2]])


def test_a_continued_run_has_the_readings_since_its_last_sample():
    times, values = np.array([3.0, 5.0]), np.array([[1.0], [2.0]])
    [(_, _, read)] = with_probe_readings([(6.0, 1.0)], times, values, after=4.0)
    assert read == 2.0
    [(_, _, read)] = with_probe_readings([(6.0, 1.0)], times, values, after=5.0)
    assert np.isnan(read)


def test_readings_whose_clock_alone_has_no_date_are_refused():
    read = np.array([60.0]), np.array([[1.0]])
    with pytest.raises(InputError, match="only one has a date"):
        next(with_probe_readings([(1.7e9, 1.0)], *read))


@pytest.mark.parametrize("times", [[-60.0, -2.0], [8.0]])
def test_readings_of_another_time_than_the_samples_are_said(times):
    """They changed nothing, without a word: of a touch probe with a clock of its own."""
    samples = [(0.0, 1.0), (6.0, 1.0)]
    with pytest.warns(UserWarning, match="readings: none.*0 s, and the last, at 6 s.*same clock"):
        found = list(with_probe_readings(samples, np.array(times), np.ones((len(times), 1))))
    assert np.isnan([read for *_, read in found]).all()


def test_readings_name_their_axes(tmp_path):
    path = tmp_path / "probe.csv"
    path.write_text("time_s,y_um\n60,12.5\n120,13\n")
    times, values = read_probe_readings(path, ("x", "y"))
    assert times == pytest.approx([60.0, 120.0], rel=1e-12)
    assert np.isnan(values[:, 0]).all()
    assert values[:, 1] == pytest.approx([12.5e-6, 13e-6], rel=1e-12)
    path.write_text("time_s,z_um\n60,12.5\n")
    with pytest.raises(InputError, match=r"name its columns x_um, y_um"):
        read_probe_readings(path, ("x", "y"))
    path.write_text("time_s,x_degC\n60,12.5\n")
    with pytest.raises(InputError, match=r"x_degC is a temperature"):
        read_probe_readings(path, ("x", "y"))


def test_readings_of_two_runs_are_refused(tmp_path):
    path = tmp_path / "probe.csv"
    path.write_text("time_s,x_um\n60,1\n120,2\n180,2\n60,1\n")
    with pytest.raises(InputError, match="time restarts; give the readings of one run"):
        read_probe_readings(path, ("x",))


@pytest.mark.parametrize("clock", ["time", "time [Europe/Berlin]"])
def test_readings_in_local_time_are_not_taken_as_those_of_another_zone(tmp_path, clock):
    """In summer a reading of a log in UTC was used two hours late."""
    readings, log = tmp_path / "probe.csv", tmp_path / "log.csv"
    readings.write_text(f"{clock},x_um\n2026-06-01 08:00:00,1\n")
    log.write_text("time,T1_degC\n2026-06-01T06:00:00Z,20\n")
    pieces = beside(log_pieces([log]), readings)
    if clock == "time":
        with pytest.raises(
            InputError, match=r"probe\.csv: its clock has no time zone, that of .*log"
        ):
            list(pieces)
    else:
        assert [piece.times[0] for piece in pieces] == read_probe_readings(readings, ("x",))[0]


def test_readings_whose_dates_are_in_another_order_than_those_of_the_log_are_refused(tmp_path):
    readings, log = tmp_path / "probe.csv", tmp_path / "log.csv"
    readings.write_text("time,x_um\n02/03/2026 08:00:00,1\n")
    log.write_text("time,T1_degC\n13/03/2026 08:00:00,20\n")
    with pytest.raises(InputError, match=r"probe\.csv: its dates are read month before day, those"):
        list(beside(log_pieces([log]), readings))


def test_a_reading_in_another_unit_than_the_column_of_its_axis_is_one(tmp_path):
    """It was left out where another axis was read in the unit of its column."""
    path = tmp_path / "probe.csv"
    path.write_text("time_s,x_um,z_mm\n60,12.5,0.013\n")
    _, values = read_probe_readings(path, ("x_um", "z_um"))
    assert values[0] == pytest.approx([12.5e-6, 13e-6], rel=1e-12)


def test_the_command_starts_warm_and_takes_readings(estimator, response, tmp_path):
    model, late, out = tmp_path / "model.h5", tmp_path / "late.nc", tmp_path / "out.csv"
    write_observer(estimator.model, model)
    write_response(response.isel(time=slice(100, 160)), late)
    probe = tmp_path / "probe.csv"
    actual = 1e6 * response["displacement"].sel(axis="x").to_numpy()
    probe.write_text(f"time_s,x_um\n240,{actual[120]:.4f}\n")
    common = ["estimate", str(model), str(late), "--out", str(out)]
    given = [*common, "--warm", "--readings", str(probe), "--reading-noise-um", "0.2"]
    result = CliRunner().invoke(app, given)
    assert result.exit_code == 0, result.output
    rows = out.read_text().splitlines()
    assert "unsettled" in rows[1]
    at = rows[0].split(",").index("x_um")
    assert float(rows[21].split(",")[at]) == pytest.approx(actual[120], abs=1.0)
    out.unlink()
    result = CliRunner().invoke(app, [*common, "--reading-noise-um", "0.2"])
    assert "--reading-noise-um" in str(result.exception)
    assert not out.exists()


def test_the_command_says_how_many_readings_were_refused(estimator, response, tmp_path):
    """It ended as if they had corrected the estimate; only the statuses said that none had."""
    model, given, probe = tmp_path / "model.h5", tmp_path / "given.nc", tmp_path / "probe.csv"
    write_observer(estimator.model, model)
    write_response(response.isel(time=slice(0, 60)), given)
    probe.write_text("time_s,x_um\n40,-5000\n60,4000\n80,-3000\n")
    out = tmp_path / "out.csv"
    command = ["estimate", model, given, "--readings", probe, "--out", out]
    result = CliRunner().invoke(app, [*map(str, command)])
    assert result.exit_code == 0, result.output
    assert "probe.csv: refused at 3 samples (reading-refused), of 3 readings" in result.output
    assert out.read_text().count("reading-refused") == 3
