"""A response is what its schema says, or one line says what it is not."""

import numpy as np
import pytest
import xarray as xr

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import (
    array_response,
    make_response,
    read_response,
    write_response,
)

TIMES = np.array([0.0, 2.0, 4.0])


def arrays():
    values = {
        "heat_input": np.ones(3),
        "temperature": np.linspace(0.0, 1.0, 3)[:, None],
        "displacement": np.zeros((3, 1)),
        "contact_joint": np.array(["knee", "über"]),
        "pressure": np.ones((3, 2)),
    }
    coords = {"time": TIMES, "probe": ["a"], "axis": ["x"], "contact": np.arange(2)}
    return array_response(values, coords, {"title": "Größe", "thermal_modes": 3, "error": 0.5})


def good():
    return arrays().dataset()


@pytest.mark.parametrize(
    ("displacement", "told"),
    [
        (np.zeros((2, 1)), r"'displacement' has the shape \(2, 1\), expected time 3, axis 1"),
        (np.zeros(3), r"'displacement' has the shape \(3,\), expected time 3, axis 1"),
        (np.zeros((3, 2)), r"'displacement' has the shape \(3, 2\), expected time 3, axis 1"),
    ],
)
def test_arrays_that_do_not_fit_each_other_are_no_response(displacement, told):
    values = {
        "heat_input": np.ones(3),
        "temperature": np.zeros((3, 1)),
        "displacement": displacement,
    }
    with pytest.raises(InputError, match=told):
        make_response(values, {"time": TIMES, "probe": ["a"], "axis": ["x"]})


def test_a_response_survives_its_file_as_arrays_and_as_a_dataset(tmp_path):
    for name, given in {"arrays.nc": arrays(), "dataset.nc": good()}.items():
        write_response(given, tmp_path / name)
        xr.testing.assert_identical(read_response(tmp_path / name), good())


def test_what_a_response_has_besides_survives_its_file(tmp_path):
    dates = np.array(["2026-01-01", "2026-01-02", "2026-01-03"], dtype="datetime64[ns]")
    given = good().assign(
        when=("time", dates), on=("time", [True, False, True]), unnamed=(("time", "k"), np.eye(3))
    )
    write_response(given, tmp_path / "given.nc")
    xr.testing.assert_identical(read_response(tmp_path / "given.nc"), given)


def test_a_response_without_contact_elements_survives_its_file(tmp_path):
    given = good().isel(contact=[])
    write_response(given, tmp_path / "given.nc")
    assert read_response(tmp_path / "given.nc").sizes == given.sizes


@pytest.mark.parametrize(
    ("times", "unit", "said"),
    [
        (TIMES / 60.0, "min", "'time' is in 'min', expected 's'"),
        (TIMES / 60.0, "minutes", "'time' is in 'minutes', expected 's'"),
        (TIMES, "seconds since 2024-01-01", "'time' is in 'seconds since 2024-01-01', expected"),
        (TIMES, None, "'time' is in 'no unit', expected 's'"),
        (TIMES, "s", None),
        (TIMES.astype(int), "s", None),
        (np.array([3, 2, 1], dtype=np.uint8), "s", "'time' is in 's' as uint8, expected 's'"),
        (np.array([0.0, 2.0, np.inf]), "s", "'time' has values that are not finite"),
        (np.array([0.0, np.nan, 4.0]), "s", "'time' has values that are not finite"),
        (np.array([0.0, 2.0, 2.0]), "s", "time must increase strictly"),
    ],
)
def test_time_is_in_finite_seconds_or_refused(tmp_path, times, unit, said):
    path = tmp_path / "given.nc"
    given = good().assign_coords(time=("time", times, {"units": unit} if unit else {}))
    given.to_netcdf(path, engine="h5netcdf")
    if said is None:
        assert np.array_equal(read_response(path)["time"], times)
        return
    with pytest.raises(InputError, match=said) as error:
        read_response(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_samples_without_times_are_refused(tmp_path):
    path = tmp_path / "given.nc"
    good().drop_vars("time").to_netcdf(path, engine="h5netcdf")
    with pytest.raises(InputError, match="coordinate 'time' is missing"):
        read_response(path)


def test_a_log_in_place_of_a_response_is_called_none(tmp_path):
    """It was called truncated, with the advice to simulate it again."""
    path = tmp_path / "log.csv"
    path.write_text("time_s,a_degC,x_um\n0,20.1,0\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"log.csv: no response \(NetCDF\); .* with make_response"):
        read_response(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda given: given.drop_vars("displacement"), "variable 'displacement' is missing"),
        (lambda given: given.assign(heat_input=("time", np.ones(3))), "in 'no unit', expected '1'"),
        (
            lambda given: given.assign(heat_input=np.nan * given["heat_input"]),
            "values that are not finite",
        ),
        (lambda given: given.isel(time=[0]), "two samples or more"),
        (lambda given: given.isel(probe=[0, 0]), "probe 'a' is there twice"),
        (lambda given: given.assign_attrs(schema_version=99), "version 99"),
        (lambda given: given.assign_attrs(schema_version="one"), "version 'one', expected"),
        (lambda given: given.assign_attrs(schema_version=[1, 1]), r"version \[1, 1\], expected"),
        (lambda given: given.assign_attrs(schema=[1.0, 2.0]), r"schema \[1.0, 2.0\] version 1"),
    ],
)
def test_what_the_schema_does_not_allow_is_refused(tmp_path, change, said):
    path = tmp_path / "given.nc"
    with xr.set_options(keep_attrs=True):
        given = change(good())
    given.to_netcdf(path, engine="h5netcdf")
    with pytest.raises(InputError, match=said):
        read_response(path)
