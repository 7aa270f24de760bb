"""Heat input histories."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fesim.case.history import (
    bent_steps,
    entering_in_steps,
    mean_over_steps,
    ramp_history,
    read_history,
    sampled_history,
    step_history,
    triangle_history,
)
from thermojoint.artefacts.errors import InputError

levels = st.floats(-10.0, 10.0)
durations = st.floats(0.1, 1e4)
times = st.floats(0.0, 1e5)


@given(level=levels, time=times)
def test_a_step_is_on_from_the_start(level, time):
    assert step_history(level)(np.array([0.0, time])).tolist() == [level, level]


@given(level=levels, duration=durations, share=st.floats(0.0, 1.0), time=times)
def test_a_ramp_rises_evenly_and_holds(level, duration, share, time):
    ramp = ramp_history(level, duration)
    np.testing.assert_allclose(ramp(share * duration), share * level, rtol=1e-9, atol=1e-12)
    assert ramp(duration + time) == level


@given(peak=levels, duration=durations, share=st.floats(0.0, 1.0), time=times)
def test_a_triangle_is_symmetric_about_its_peak_and_zero_afterwards(peak, duration, share, time):
    triangle = triangle_history(peak, duration)
    assert triangle(duration / 2) == peak
    up, down = triangle(share * duration / 2), triangle(duration - share * duration / 2)
    np.testing.assert_allclose([up, down], share * peak, rtol=1e-9, atol=1e-9)
    assert triangle(duration + time) == 0.0


@st.composite
def samples(draw):
    steps = draw(st.lists(st.floats(1e-3, 100.0), min_size=1, max_size=20))
    values = draw(st.lists(levels, min_size=len(steps), max_size=len(steps)))
    return np.cumsum(steps), np.array(values)


@given(samples(), st.floats(0.1, 50.0))
def test_of_a_history_that_bends_within_a_step_every_step_takes_what_it_gives(given_samples, step):
    """In sum exactly, and no step takes back what others took before it."""
    history = sampled_history(*given_samples)
    ends = step * np.arange(1.0, int(history.times[-1] / step) + 3.0)
    found, bent = entering_in_steps(history, step, ends), bent_steps(history, step)
    even = ~np.isin(np.arange(1, len(ends) + 1), bent)
    np.testing.assert_array_equal(mean_over_steps(history, step, ends)[even], history(ends)[even])
    if not bent.size:
        np.testing.assert_array_equal(found, history(ends))
        return
    scale = 1e-9 * (1.0 + ends[-1] * np.abs(history.values).max())
    given_so_far = history.integral(ends) - history.integral(np.zeros(1))
    np.testing.assert_allclose(step * np.cumsum(found), given_so_far, atol=scale)
    assert history.values.min() - scale <= found.min()
    assert found.max() <= history.values.max() + scale


@given(samples())
def test_a_sampled_history_goes_through_its_samples_and_stays_between_them(given_samples):
    at, values = given_samples
    history = sampled_history(at, values)
    np.testing.assert_array_equal(history(at), values)
    between = history(np.linspace(at[0] - 1.0, at[-1] + 1.0, 50))
    assert values.min() <= between.min()
    assert between.max() <= values.max()
    assert history(at[-1] + 1e6) == values[-1]


@given(samples(), st.integers(0, 19))
def test_times_that_do_not_increase_are_refused_with_their_place(given_samples, where):
    at, values = given_samples
    i = min(where, len(at) - 1)
    at = np.insert(at, i + 1, at[i])
    values = np.insert(values, i + 1, values[i])
    with pytest.raises(InputError, match=rf"pump\.csv: .* of sample {i + 2} .*increase strictly"):
        sampled_history(at, values, "pump.csv")


@given(samples(), st.integers(0, 19), st.sampled_from([np.nan, np.inf, -np.inf]), st.booleans())
def test_samples_that_are_not_finite_are_refused_with_their_place(
    given_samples, where, wrong, in_time
):
    at, values = given_samples
    i = min(where, len(at) - 1)
    (at if in_time else values)[i] = wrong
    with pytest.raises(InputError, match=f"sample {i + 1} is not finite"):
        sampled_history(at, values)


@pytest.mark.parametrize(
    ("at", "values"), [([], []), ([0.0, 1.0], [1.0]), ([[0.0, 1.0]], [[0.0, 1.0]])]
)
def test_samples_that_do_not_pair_up_are_refused(at, values):
    with pytest.raises(InputError, match="as many times as values"):
        sampled_history(np.array(at), np.array(values))


def csv_of(folder, text):
    path = folder / "heat.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_csv_is_read_by_its_column_names(tmp_path):
    text = "heat_input,remark,time_s\n0.0,1,0\n2.0,2,10\n1.0,3,30\n"
    history = read_history(csv_of(tmp_path, text))
    np.testing.assert_allclose(history(np.array([0.0, 5.0, 10.0, 20.0, 99.0])), [0, 1, 2, 1.5, 1])


def test_a_csv_with_a_single_row_holds_its_value(tmp_path):
    history = read_history(csv_of(tmp_path, "time_s,heat_input\n0,1.5\n"))
    assert history(np.array([7.0]))[0] == 1.5


def test_a_history_may_be_a_loggers_german_table(tmp_path):
    plain = read_history(csv_of(tmp_path, "time_s,heat_input\n0,0.5\n60,1.25\n"))
    header = "Anlage 3;2026\nDatum;Uhrzeit;heat_input\n"
    rows = "02.03.2026;23:59:30;0,5\n03.03.2026;00:00:30;1,25\n"
    logged = read_history(csv_of(tmp_path, header + rows))
    at = np.array([0.0, 15.0, 60.0])
    np.testing.assert_array_equal(logged(at), plain(at))


@pytest.mark.parametrize(
    "rows",
    [
        "time,heat_input\n08:00:00,0.5\n08:01:00,1.25\n",
        "Uhrzeit,heat_input\n23:59:30,0.5\n00:00:30,1.25\n",
        "time_s,heat_input\n1772434799.5,0.5\n1772434859.5,1.25\n",
        "time_ms,heat_input\n1772434799500,0.5\n1772434859500,1.25\n",
    ],
)
def test_a_history_by_the_time_of_day_or_since_1970_counts_from_its_first_row(tmp_path, rows):
    np.testing.assert_allclose(read_history(csv_of(tmp_path, rows)).times, [0.0, 60.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,power\n0,1\n1,1\n", "column 'heat_input' is missing; found time_s, power"),
        ("t,heat_input\n0,1\n1,1\n", "column 'time_s' is missing"),
        ("time_s,heat_input\n0,1\n1,nan\n", "sample 2 is not finite"),
        ("time_s,heat_input\n0,1\n1,much\n", "line 3: 'much' is not a number"),
        ("time_s,heat_input\n0,1\n1,\n", "sample 2 is not finite"),
        ("time_s,heat_input\n0,1\n2,1\n1,1\n", "time 1 s of sample 3 does not come after 2 s"),
        ("time_s,heat_input\n0,0\n1,30\n1,300\n", "perhaps the columns are swapped"),
        ("time_s,heat_input\n0,1\n1,2,3\n", "line 3: 3 cells, expected 2"),
        ("time_s,heat_input\n", "one or more"),
        ("time_s,heat_input,heat_input\n0,1,2\n", "two columns are called 'heat_input'"),
        ("", "no header; give a first line that names the columns"),
    ],
)
def test_a_bad_csv_is_refused_in_one_line_that_names_it(tmp_path, text, message):
    path = csv_of(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_history(path)
    said = str(caught.value)
    assert said.startswith(str(path))
    assert message in said
    assert "\n" not in said


def test_a_csv_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv: no such file; give a history as CSV"):
        read_history(tmp_path / "none.csv")


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "heat.csv"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match=r"heat\.csv"):
        read_history(path)
