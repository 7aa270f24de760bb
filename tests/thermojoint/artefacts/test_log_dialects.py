"""A log in any dialect is the same log, to the last bit; what cannot be read is refused by line."""

from collections import Counter
from datetime import timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_dialects import BEGIN, DIALECTS, german, logs, plain

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import joined
from thermojoint.artefacts.log_file import read_log
from thermojoint.artefacts.log_record import described
from thermojoint.artefacts.tables.pieces import pieces_in
from thermojoint.artefacts.tables.source import lines_of


def read(text, rows=1 << 15):
    return joined(pieces_in(text.splitlines(keepends=True), "log", rows=rows))


def said(log):
    return "\n".join(described(log.records))


@pytest.mark.parametrize("dialect", DIALECTS)
@settings(max_examples=25, deadline=None)
@given(samples=logs(), encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le"]))
def test_a_log_is_the_same_to_the_last_bit_in_every_dialect(
    tmp_path_factory, dialect, samples, encoding
):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    path.write_bytes(dialect(samples, encoding))
    found, expected = read_log([path]), read(plain(samples))
    np.testing.assert_array_equal(found.times, expected.times)
    np.testing.assert_array_equal(found.values, expected.values)
    assert [one.unit for one in found.columns] == [one.unit for one in expected.columns]
    # As the rows come in, one at a time, it is the same again.
    with lines_of(path, "log") as lines:
        np.testing.assert_array_equal(joined(pieces_in(lines, "log", rows=1)).values, found.values)


def few():
    return [(BEGIN + timedelta(seconds=10 * k), f"{20 + k}.5", f"{k}.25", "1500") for k in range(9)]


@pytest.mark.parametrize("encoding", ["cp1252", "latin-1"])
def test_windows_text_is_read_and_so_is_a_degree_sign_in_a_late_row(tmp_path, encoding):
    path = tmp_path / "log.csv"
    path.write_bytes(german(few(), encoding))
    assert read_log([path]).names == ("T1 [°C]", "x [µm]", "n [min-1]")


def test_sheets_and_parquet_are_the_same_log(tmp_path):
    openpyxl, pd = pytest.importorskip("openpyxl"), pytest.importorskip("pandas")
    samples, expected = few(), read(plain(few()))
    book = openpyxl.Workbook()
    book.active.append(["Logger", 7])
    book.active.append(["Zeit", "T1 [°C]", "x [µm]", "n [1/min]"])
    for at, t, x, n in samples:
        book.active.append([at.replace(tzinfo=None), float(t), float(x), int(n)])
    book.save(tmp_path / "log.xlsx")
    table = pd.DataFrame(samples, columns=["time", "T1_degC", "x_um", "n_rpm"])
    numbers = ["T1_degC", "x_um", "n_rpm"]
    table[numbers] = table[numbers].astype(float)
    table.to_parquet(tmp_path / "log.parquet")
    for name in ("log.xlsx", "log.parquet"):
        found = read_log([tmp_path / name])
        np.testing.assert_array_equal(found.times, expected.times)
        np.testing.assert_array_equal(found.values, expected.values)


def test_a_date_and_a_time_of_day_may_be_two_columns_of_a_sheet_or_of_parquet(tmp_path):
    """Both formats know a date only as its midnight."""
    openpyxl, pd = pytest.importorskip("openpyxl"), pytest.importorskip("pandas")
    moments = [BEGIN.replace(tzinfo=None) + timedelta(hours=9 * k) for k in range(4)]
    book = openpyxl.Workbook()
    book.active.append(["Datum", "Uhrzeit", "x_um"])
    for at in moments:
        book.active.append([at.date(), at.time(), 1.0])
    book.save(tmp_path / "log.xlsx")
    days = pd.to_datetime([at.date() for at in moments])
    table = {"date": days, "time": [at.time() for at in moments], "x_um": 1.0}
    pd.DataFrame(table).to_parquet(tmp_path / "log.parquet")
    for name in ("log.xlsx", "log.parquet"):
        log = read_log([tmp_path / name])
        assert log.times[0] == BEGIN.timestamp()
        assert np.diff(log.times).tolist() == [32_400.0] * 3


def clock(cells, name="time"):
    rows = "".join(f"{cell};{k}\n" for k, cell in enumerate(cells))
    return read(f"{name};x_um\n{rows}")


@pytest.mark.parametrize(
    ("name", "cells", "steps"),
    [
        ("time_s", ["0", "1.5"], [1.5]),
        ("time_min", ["0", "2,5"], [150.0]),
        ("Zeit [h]", ["1", "2"], [3600.0]),
        ("t/ms", ["0", "250"], [0.25]),
        ("timestamp", ["1772431200", "1772431201"], [1.0]),
        ("timestamp", ["1772431200000", "1772431200500"], [0.5]),
        ("time", ["2026-03-02T06:00:00Z", "2026-03-02T07:00:00+01:00", "2026-03-02T06:00:01Z"], []),
        ("time", ["2026-03-02 06:00:00,25", "2026-03-02 06:00:01,5"], [1.25]),
        ("Datum/Uhrzeit", ["02.03.26 06:00", "02.03.26 06:01"], [60.0]),
        ("Date/Time", ["3/2/2026 11:59:30 AM", "3/2/2026 12:00:00 PM"], [30.0]),
        ("date", ["13/02/2026 06:00:00", "14/02/2026 06:00:00"], [86400.0]),
        ("Uhrzeit", ["23:59:50", "00:00:00", "00:00:10"], [10.0, 10.0]),
        ("time", ["2026-03-29 01:59:50 CET", "2026-03-29 03:00:00 CEST"], [10.0]),
        ("time", ["2026-10-25 02:59:50 MESZ", "2026-10-25 02:00:00 MEZ"], [10.0]),
        # A local time without a zone is set at both changes of summer time.
        ("time", ["29.03.2026 01:59:40", "29.03.2026 01:59:50", "29.03.2026 03:00:00"], [10.0] * 2),
        ("time", ["25.10.2026 02:59:50", "25.10.2026 02:00:00", "25.10.2026 02:00:10"], [10.0] * 2),
        (
            "time [Europe/Berlin]",
            ["2026-10-25 02:59:50", "2026-10-25 02:00:00", "2026-10-25 03:00:00"],
            [10.0, 3600.0],
        ),
        # A sample every hour: the hour that comes twice is the same text twice.
        ("time", [f"25.10.2026 0{hour}:00" for hour in (1, 2, 2, 3)], [3600.0] * 3),
        ("time [Europe/Berlin]", [f"2026-10-25 0{hour}:10" for hour in (1, 2, 2, 3)], [3600.0] * 3),
        # The hour that is left out, and the changes between two samples far apart.
        ("time", [f"29.03.2026 0{hour}:00" for hour in (0, 1, 3, 4)], [3600.0] * 3),
        (
            "time",
            ["28.03.2026 22:00", "28.03.2026 23:30", "29.03.2026 01:00", "29.03.2026 03:30"],
            [5400.0] * 3,
        ),
        (
            "time",
            ["24.10.2026 23:30", "25.10.2026 01:00", "25.10.2026 02:30", "25.10.2026 03:00"],
            [5400.0] * 3,
        ),
    ],
)
def test_clocks_tell_how_much_time_passed(name, cells, steps):
    if not steps:
        with pytest.raises(InputError, match="lines 2 and 3: two rows of one time"):
            clock(cells, name)
    else:
        np.testing.assert_array_equal(np.diff(clock(cells, name).times), steps)


#: A day of March as text, in the orders in which dates are written.
DAYS_OF_MARCH = {
    "day before month": "{:02d}/03/2026",
    "month before day": "03/{:02d}/2026",
    "year before month": "26-03-{:02d}",
    "year first with slashes": "26/03/{:02d}",
    "day first with dashes": "{:02d}-03-26",
}


def days_of_march(date, *days):
    """Rows of whole days, every 4 min: the first 256 lines show the first of them only."""
    return "".join(
        f"{date.format(day)} {k // 15:02d}:{4 * (k % 15):02d};{k}\n"
        for day in days
        for k in range(360)
    )


@pytest.mark.parametrize("date", DAYS_OF_MARCH.values(), ids=DAYS_OF_MARCH)
def test_the_order_of_dates_is_that_in_which_days_follow_each_other(date, tmp_path):
    for parts in ([(2, 3, 4)], [(2, 3), (4,)]):
        rows = (days_of_march(date, *days) for days in parts)
        log = read_log(files_of(tmp_path, *(f"time;x_um\n{own}" for own in rows)))
        assert log.times[0] == 1772409600.0  # 2026-03-02
        np.testing.assert_array_equal(np.diff(log.times), 240.0)
        assert log.starts == (0,)


@pytest.mark.parametrize("kind", ["day before month", "year before month"])
def test_days_that_are_weeks_apart_only_by_the_order_of_their_dates_are_refused(kind, tmp_path):
    """In a stream, whose first row leaves the order open, and in files of one day each."""
    date, header = DAYS_OF_MARCH[kind], "time;x_um\n"
    stream = f"{header}{days_of_march(date, 2, 3)}".splitlines(keepends=True)
    with pytest.raises(InputError, match=rf"log, line 362: from .* pass .* d if {kind}; write"):
        joined(pieces_in(stream, "log", rows=1))
    files = files_of(tmp_path, *(header + days_of_march(date, day) for day in (2, 3)))
    with pytest.raises(InputError, match=rf"2\.csv: since .*1\.csv pass .* d if {kind}; write"):
        read_log(files)


def test_days_that_their_dates_put_in_a_wrong_order_are_refused(tmp_path):
    """31 March and 1 April of 2026, which would be days of 2031 and of 2001."""
    files = files_of(tmp_path, "time;x_um\n26-03-31 23:00;1\n", "time;x_um\n26-04-01 00:00;1\n")
    with pytest.raises(InputError, match=r"1\.csv: since .*2\.csv pass .* d if year before month"):
        read_log(files)


def test_files_whose_dates_fit_no_common_order_are_refused(tmp_path):
    header = "time;x_um\n"
    files = files_of(tmp_path, f"{header}13/03/2026 06:00;1\n", f"{header}03/14/2026 06:00;1\n")
    with pytest.raises(InputError, match=r"2\.csv: its dates are read month before day, those of"):
        read_log(files)


def test_a_pause_of_weeks_stays_a_pause(tmp_path):
    for first, last in (("03/02/2026", "03/23/2026"), ("02.03.26", "02.04.26")):
        text = f"time;x_um\n{first} 06:00;1\n{first} 06:01;1\n{last} 06:00;1\n"
        log = read_log(files_of(tmp_path, text))
        assert np.diff(log.times)[1] > 20 * 86_400.0


def test_a_time_of_day_beyond_a_day_is_the_time_since_the_start():
    steps = np.diff(clock(["23:00:00", "24:00:00", "30:00:00", "99:59:59", "100:00:00"]).times)
    assert steps.tolist() == [3600.0, 21_600.0, 251_999.0, 1.0]
    assert np.diff(clock(["23:00:00", "24:00:00", "00:00:01"]).times).tolist() == [3600.0, 1.0]
    with pytest.raises(InputError, match=r"'02\.03\.2026 24:00', no time like those before it"):
        clock(["02.03.2026 23:00", "02.03.2026 24:00"])


def test_what_a_clock_did_is_said():
    assert "line 3: midnight passed" in said(clock(["23:59:50", "00:00:00"], "Uhrzeit"))
    autumn = clock(["25.10.2026 02:59:50", "25.10.2026 02:00:00"])
    assert "line 3: summer time ended" in said(autumn)
    assert "month before day" in said(clock(["3/2/2026 06:00:00", "3/2/2026 06:00:10"]))


@pytest.mark.parametrize(
    "cell",
    [
        "---",
        "OL",
        "OPEN",
        "#N/A",
        "9999",
        "-9999",
        "9.9e37",
        "",
        "NaN",
        "-9999,0",
        "-999",
        "-999,9",
        "3276,7",
        "Fehler",
    ],
)
def test_what_is_no_reading_is_missing_and_counted(cell):
    log = read(f"time_s;T1_degC;n_rpm\n0;20,5;10\n1;{cell};10\n2;21,5;10\n")
    np.testing.assert_array_equal(np.isnan(log.at("T1")), [False, True, False])
    assert "T1_degC: readings missing: 1 x" in said(log)


def test_a_spindle_may_turn_at_9999():
    log = read("time_s,n_rpm,x_um\n0,9999,9999\n1,-9999,1\n")
    np.testing.assert_array_equal(np.isnan(log.values), [[False, True], [True, False]])


def test_only_a_temperature_cannot_be_below_absolute_zero():
    log = read("time_s,T1_degC,n_rpm,x_um,P_W\n0,-459,-999,-999,-999\n1,-460,-999,-999,-999\n")
    np.testing.assert_array_equal(np.isnan(log.values), [[False] * 4, [True] + 3 * [False]])


@pytest.mark.parametrize(("cell", "speed"), [("20,125", 1500.0), ("20.125", 1.5)])
def test_no_temperature_is_in_the_thousands(cell, speed):
    """So it shows which sign a table of three decimals has."""
    log = read(f"time_s;T1_degC;n_rpm\n0;{cell};1.500\n10;{cell};0\n")
    assert log.at("T1_degC")[0] == pytest.approx(293.275)
    assert 60.0 / (2.0 * np.pi) * log.at("n_rpm")[0] == pytest.approx(speed)


@pytest.mark.parametrize(
    ("rows", "first"),
    [
        ('0,20,"20,125"\n1,20,"0,250"\n', 20.125),
        ('0,20,"20,125"\n1,"20,5","20,250"\n', 20.125),
        ('0,"20,125","20,125"\n', 20.125),
        ("0,20,20.125\n", 20.125),
        ('0,20.5,"20,125"\n', 20125.0),
        ('0,20,"20,125"\n1,20,950\n', 20125.0),
    ],
)
def test_another_cell_shows_whether_a_length_has_decimals_or_thousands(rows, first):
    log = read(f"time_s,T1_degC,x_um\n{rows}")
    assert 1e6 * log.at("x_um")[0] == pytest.approx(first)


@pytest.mark.parametrize(("rest", "rows"), [(1, 1), (300, 1 << 15)])
def test_a_later_row_shows_the_decimal_sign_of_standard_input_and_of_a_file(rest, rows):
    """The machine rests in the first rows, which have none."""
    first = "".join(f"{k};20;0\n" for k in range(rest))
    log = read(f"time_s;T1_degC;n_rpm\n{first}1000;20,5;1.500\n1001;21;1.500\n", rows)
    assert 60.0 / (2.0 * np.pi) * log.at("n_rpm")[-2:] == pytest.approx([1500.0, 1500.0])


def test_a_row_twice_is_dropped_and_two_that_contradict_are_refused():
    log = read("time_s,x_um\n0,1\n1,2\n1,2\n2,3\n")
    assert log.times.tolist() == [0.0, 1.0, 2.0]
    assert "repeated rows, dropped: 1" in said(log)
    with pytest.raises(InputError, match=r"lines 3 and 4: .*x_um: '2' and '3'"):
        read("time_s,x_um\n0,1\n1,2\n1,3\n")


def test_a_pause_and_a_logger_that_starts_again_are_said():
    night = [*range(0, 36_000, 60), *range(86_400, 122_400, 60)]
    log = read("time_s,x_um\n" + "".join(f"{1772431200 + t},{t % 7}\n" for t in night))
    assert log.starts == (0,)
    assert "2 runs, 1 pause, over a change of the day: 1: 14.02 h from 2026-03-02 15:59" in said(
        log
    )
    again = "time_s,x_um\n0,1\n1,2\n2,3\ntime_s,x_um\n0,1\n1,2\n2,5\n"
    log = read(again)
    assert log.starts == (0, 3)
    assert "line 6: time restarts" in said(log)


def test_files_are_put_in_the_order_of_their_dates_and_read_once(tmp_path):
    paths = []
    for name, first in (("tuesday", 1772517600), ("monday", 1772431200), ("again", 1772431200)):
        paths.append(tmp_path / f"{name}.csv")
        paths[-1].write_text(f"time_s,x_um\n{first},{first % 7}\n{first + 60},2\n")
    log = read_log(paths)
    assert log.times.tolist() == [1772431200, 1772431260, 1772517600, 1772517660]
    text = said(log)
    assert "again.csv, which is left out" in text
    assert "given as file 2, read as file 1, sorted by time" in text


def files_of(folder, *contents):
    paths = [folder / f"{k}.csv" for k in range(1, 1 + len(contents))]
    for path, content in zip(paths, contents, strict=True):
        path.write_text(content)
    return paths


@pytest.mark.parametrize("second", ["06:01:00;1\n2026-03-02T06:03", "06:02;0\n2026-03-02T06:03"])
def test_files_of_the_same_hours_are_refused(tmp_path, second):
    """Their rows would count twice, and be held out from their own doubles."""
    first = "time;x_um\n2026-03-02T06:00;0\n2026-03-02T06:01;1\n2026-03-02T06:02;1\n"
    paths = files_of(tmp_path, first, f"time;x_um\n2026-03-02T{second};2\n")
    for order in (paths, paths[::-1]):
        with pytest.raises(InputError, match=r"2\.csv: begins at .*, before .*1\.csv ends"):
            read_log(order)


def undated(seconds, differing=()):
    """A file of a run whose clock counts from its start, every second."""
    rows = (f"{k};{np.sin(k) + (k in differing):.3f};\n" for k in seconds)
    return f"time_s;x_um;T1_degC\n{''.join(rows)}"


@pytest.mark.parametrize("second", [range(300), range(60, 300), range(20, 90), range(80)])
def test_two_exports_of_one_run_without_dates_are_refused(second, tmp_path):
    paths = files_of(tmp_path, undated(range(200)), undated(second))
    for order in (paths, paths[::-1]):
        with pytest.raises(InputError, match=r"rows are in .*, too; the same hours would count tw"):
            read_log(order)


def test_runs_that_begin_alike_or_stand_still_are_runs(tmp_path):
    """Simulated ones, or of a machine at rest."""
    begins_alike = files_of(tmp_path, undated(range(200)), undated(range(200), differing=[150]))
    assert read_log(begins_alike).starts == (0, 200)
    still = "time_s;x_um\n" + "".join(f"{k};0;\n" for k in range(100))
    assert read_log(files_of(tmp_path, still, f"{still}100;1\n")).starts == (0, 100)


def test_a_file_may_begin_with_the_last_row_of_the_file_before_it(tmp_path):
    first = "time;x_um\n2026-03-02T06:00;0\n2026-03-02T06:01;1\n"
    log = read_log(files_of(tmp_path, first, "time;x_um\n2026-03-02T06:01;1\n2026-03-02T06:02;2\n"))
    assert np.diff(log.times).tolist() == [60.0, 60.0]
    assert log.starts == (0,)
    assert "repeated rows, dropped: 1" in said(log)


def test_files_may_have_their_columns_in_another_order(tmp_path):
    first = "time_s,T1_degC,T2_degC,x_um\n0,20,30,1\n10,21,31,2\n"
    log = read_log(files_of(tmp_path, first, "x_um,time_s,T2_degC,T1_degC\n3,20,32,22\n"))
    expected = read(f"{first}20,22,32,3\n")
    assert log.names == expected.names
    np.testing.assert_array_equal(log.values, expected.values)
    with pytest.raises(InputError, match=r"other columns than the first \(T2_K, T2_degC\)"):
        read_log(files_of(tmp_path, first, "time_s,T1_degC,T2_K,x_um\n20,22,305,3\n"))


def test_files_with_and_without_a_time_zone_are_not_one_log(tmp_path):
    paths = files_of(tmp_path, "time;x_um\n02.03.2026 06:00;0\n", "timestamp;x_um\n1772439000;1\n")
    with pytest.raises(
        InputError, match=r"1\.csv: its clock has no time zone, that of .*2\.csv has"
    ):
        read_log(paths)
    paths[0].write_text("time [Europe/Berlin];x_um\n02.03.2026 06:00;0\n")
    assert np.diff(read_log(paths).times).tolist() == [1772439000 - 1772427600]


def test_files_with_and_without_dates_are_not_one_log(tmp_path):
    """One run would last since 1970."""
    paths = files_of(tmp_path, "time_s;x_um\n0;0\n9;1\n", "time;x_um\n2026-03-02 06:00;1\n")
    for order in (paths, paths[::-1]):
        with pytest.raises(
            InputError, match=r"1\.csv: its clock has no date, that of .*2\.csv has"
        ):
            read_log(order)


def test_a_change_of_summer_time_holds_in_the_files_of_later_days(tmp_path):
    autumn = ["24.10.2026 23:50", "25.10.2026 02:50", "25.10.2026 02:00", "25.10.2026 23:50"]
    spring = ["29.03.2026 01:50", "29.03.2026 03:00", "29.03.2026 23:50"]
    for days, name in ((autumn, "26.10.2026"), (spring, "30.03.2026")):
        rows = "".join(f"{at}:00;{k}\n" for k, at in enumerate(days))
        later = f"{name} 00:00:00;1\n{name} 00:10:00;2\n"
        log = read_log(files_of(tmp_path, *(f"time;x_um\n{part}" for part in (rows, later))))
        assert log.starts == (0,)
        np.testing.assert_array_equal(np.diff(log.times)[-2:], [600.0, 600.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s;x_um\n0;1_0\n", "line 2: x_um is '1_0', not a number; write it like 20.5 or 20,5"),
        ("time_s;x_um\n0;20,5\n1;20.5\n", "line 3: x_um is '20.5', not a number"),
        ("time;x_um\n0;1\n1;2\n", "time is '0', which is no known form of time; write seconds"),
        ("time;x_um\nMonday;1\n1;2\n", "time is 'Monday', which is no known form of time"),
        ("time_s;x_um\n0;1\n9e300;2\n", "line 3: time_s is '9e300', which would be"),
        ("time_s;x_um\n1764000000000000;1\n1764000001000000;2\n", "would be 5.59e+07 years"),
        ("Datum;x_um\n02.03.2026;1\n", "a date without a time of day"),
        ("time;x_um\n2026-03-02 06:00;1\nlater;2\n", "line 3: time is 'later', no time like those"),
        ("time;x_um\n31.12.2026 06:00;1\n32.12.2026 06:00;2\n", "line 3: time is '32.12.2026"),
        (
            "date;x_um\n" + "12/03/2026 06:00;1\n" * 300 + "13/03/2026 06:00;2\n",
            "'13/03/2026 06:00', no time like those before it (date and time, month before day); ",
        ),
        ("0;1\n1;2\n", "log: no header; give a first line"),
        (
            'time_s,T1_degC,x_um,n_rpm\n0,20,"20,125","1,500"\n1,20,"20,250","1,500"\n',
            "log: x_um is '20,125', which may be 20.125 or 20125; write it with a point, or",
        ),
        (
            "time_s;T1_degC;T2_degC\n0;20;30\ntime_s;T2_degC;T1_degC\n9;30;20\n",
            "line 3: a header with other columns than the first; put it and the rows below it",
        ),
        ("time_s;x_um\n0;1\ntime_s;x_um;y_um\n9;1;2\n", "line 3: a header with other columns"),
    ],
)
def test_a_refusal_shows_the_value_and_what_can_be_read(text, message):
    with pytest.raises(InputError) as caught:
        read(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", [2, 400])
@pytest.mark.parametrize("last", ["", '"5 mm pipe'])
def test_rows_do_not_vanish_in_the_cell_of_a_single_quotation_mark(last, count):
    """A remark such as ``"3 mm`` once took all rows up to the next mark, or to the end."""
    rows = "".join(f"{k};1;\n" for k in range(count))
    text = f"# logger\ntime_s;x_um;note\n{rows}{count};1;{{}}\n997;1;\n998;1;{last}\n"
    with pytest.raises(InputError, match=rf"log, line {count + 3}: a cell begins with a quotation"):
        read(text.format('"3 mm'))
    assert len(read(text.format('"3 mm\npipe"')).times) == count + 3


def test_what_was_read_and_ignored_is_said():
    text = said(
        read("Kopf;1\n\nZeit [s];Drehzahl;T1 [°F];Notiz;Temperatur 2\n0;60;68;a;20\n1;60;68;b;20\n")
    )
    assert "2 rows, 0 s to 1 s, every 1 s; semicolon between cells; clock Zeit [s]" in text
    assert "columns: Drehzahl (speed, rpm), T1 [°F] (temperature, degF), Temperatur 2" in text
    assert "ignored, no unit in the name: Notiz" in text
    assert "Drehzahl: no unit in the name, taken as rpm" in text
    assert "lines before the header, not read: 2" in text


def test_a_long_table_is_read_in_pieces_as_a_whole():
    text = "time_s,x_um\n" + "".join(f"{k},{k % 7}\n" for k in range(1000))
    pieces = list(pieces_in(text.splitlines(keepends=True), "log", rows=90))
    assert Counter(len(one.times) for one in pieces) == {90: 11, 10: 1}
    np.testing.assert_array_equal(joined(pieces).values, read(text).values)
    assert joined(pieces).records[0].rows == 1000


def test_a_table_that_was_read_is_closed(tmp_path, recwarn):
    path = tmp_path / "log.csv"
    path.write_text("time_s,T1_degC\n0,20\n")
    with lines_of(path, "log") as lines:
        assert len(list(lines)) == 2
    assert not recwarn.list


def test_files_that_are_put_in_order_are_closed(tmp_path, recwarn):
    paths = [tmp_path / "one.csv", tmp_path / "two.csv"]
    for k, path in enumerate(paths):
        path.write_text(f"time_s,T1_degC\n0,{20 + k}\n")
    read_log(paths)
    assert not recwarn.list
