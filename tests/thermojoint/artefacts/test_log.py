"""A logger's CSV becomes a log in SI, or one line says what is wrong with it."""

import numpy as np
import pytest

from thermojoint.artefacts import log_file as logs
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import column_named


def written(folder, text, name="log.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "base", "unit"),
    [
        ("spindle_rpm", "spindle", "rpm"),
        ("disp1_um", "disp1", "um"),
        ("Temp 1 [°C]", "Temp 1", "degC"),
        ("Drehzahl (1/min)", "Drehzahl", "rpm"),
        ("x µm", "x", "um"),
        ("arm_m", "arm", "m"),
        ("load %", "load", "percent"),
    ],
)
def test_the_end_of_a_name_is_its_unit(name, base, unit):
    found = column_named(name)
    assert (found.base, found.unit) == (base, unit)


@pytest.mark.parametrize("name", ["notes", "sum", "spindle", "alarm"])
def test_a_name_without_a_unit_has_none(name):
    assert column_named(name) is None


def test_a_log_is_read_in_si_whatever_its_columns_are_called(tmp_path):
    text = "time_min,n_rpm,note,x_um,T1_degC,T2_K\n0,60,a,1,20,1\n2.5,120,b,2,21,\n"
    log = logs.read_log([written(tmp_path, text)])
    assert log.names == ("n_rpm", "x_um", "T1_degC", "T2_K")
    assert log.times == pytest.approx([0.0, 150.0])
    assert log.at("n") == pytest.approx([2 * np.pi, 4 * np.pi])
    assert log.at("x_um") == pytest.approx([1e-6, 2e-6])
    assert log.at("T1") == pytest.approx([293.15, 294.15])
    assert np.isnan(log.at("T2")[1])
    assert log.of("temperature") == ("T1_degC", "T2_K")


def test_columns_are_given_names_with_units(tmp_path):
    table = written(tmp_path, "[columns]\nZeit = 'time_s'\n'Fühler 1' = 'T1_degC'\n", "m.toml")
    path = written(tmp_path, "Zeit;Fühler 1\n0;20,5\n1;21,5\n")
    log = logs.read_log([path], logs.read_mapping(table))
    assert log.at("T1_degC") == pytest.approx([293.65, 294.65])


def test_a_log_of_one_file_is_read_by_its_path_or_its_name(tmp_path):
    path = written(tmp_path, "time_s,x_um\n0,1\n1,2\n")
    for asked in (path, str(path), [path], [str(path)]):
        assert logs.read_log(asked).at("x_um") == pytest.approx([1e-6, 2e-6])


def test_days_follow_each_other_and_a_clock_that_begins_anew_begins_a_run(tmp_path):
    days = [
        written(tmp_path, f"time_s,x_um\n{first},{k}\n{first + 9},2\n", f"{k}.csv")
        for k, first in enumerate((0, 100, 0))
    ]
    log = logs.read_log(days)
    assert log.starts == (0, 4)
    assert [list(run.times) for run in log.runs()] == [[0, 9, 100, 109], [0, 9]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s,x_um\n0,1\n0,2\n", "lines 2 and 3: two rows of one time contradict"),
        ("time_s,x_um\n5,1\n\n4,2\n", "line 4: the clock does not go forward"),
        ("time_s,x_um,T_degC\n0,1,2\n1,2\n", "line 3: 2 cells, expected 3"),
        ("time_s,x_um\n0,1\n1,ein\n", "line 3: x_um is 'ein', not a number"),
        ("time_s,x_um\n0,1\n,2\n", "time is missing"),
        ("x_um,T_degC\n0,1\n", "no clock among"),
        ("time_s,x,T\n0,1,2\n", "ends in a unit"),
        ("time_s,x_um,x_um\n0,1,2\n", "two columns are called 'x_um'"),
        ("time_s,T_degC\n0,295\n1,296\n", "kelvin and not °C"),
        ("time_s,x_m\n0,12\n1,13\n", "not a thermal displacement"),
        ("time_s,x_um\n", "no samples"),
        ("", "no header"),
        ("time_s,x_um\n0,1\n1,2,3\n", "line 3: 3 cells, expected 2"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, said):
    with pytest.raises(InputError) as caught:
        logs.read_log([written(tmp_path, text)])
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_mapping_names_columns_that_are_there_and_units_that_exist(tmp_path):
    path = written(tmp_path, "time_s,Temp\n0,1\n")
    with pytest.raises(InputError, match="did you mean 'Temp'"):
        logs.read_log([path], {"Tmp": "T_degC"})
    with pytest.raises(InputError, match="no unit known"):
        logs.read_mapping(written(tmp_path, "[columns]\nTemp = 'T'\n", "m.toml"))
    with pytest.raises(InputError, match="one table"):
        logs.read_mapping(written(tmp_path, "Temp = 'T'\n", "m.toml"))


def test_a_column_that_is_not_there_is_named_with_the_nearest(tmp_path):
    log = logs.read_log([written(tmp_path, "time_s,disp1_um\n0,1\n")])
    with pytest.raises(InputError, match="did you mean 'disp1_um'"):
        log.at("disp_um")


def test_a_column_is_found_by_its_name_with_another_unit(tmp_path):
    log = logs.read_log([written(tmp_path, "time_s,T1 [°F],n / min-1\n0,68,60\n")])
    assert log.at("T1_degC") == pytest.approx([293.15])
    assert log.at("n_rad_s") == pytest.approx([2.0 * np.pi])
    with pytest.raises(InputError, match="no column"):
        # A rise is no temperature.
        log.at("T1_K")
