"""Responses: temperatures and displacements under a heat input, simulated or measured.

One labelled dataset with units in its metadata, stored as NetCDF; the only input of `calibrate`. A
measured response needs `heat_input`, `temperature` and `displacement` only; a simulated one also
contains the joint and solver statistics.

A march makes plain arrays (`ArrayResponse`), which are checked, summarised and written as they are.
xarray is only imported to build its dataset or to read a file: the import takes a fifth of a
command's start.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.files import write_bytes
from thermojoint.artefacts.netcdf import Variable, netcdf_bytes
from thermojoint.artefacts.schema import HDF5

if TYPE_CHECKING:
    import xarray as xr

    #: Both have the same names, arrays and metadata.
    AnyResponse: TypeAlias = "xr.Dataset | ArrayResponse"

SCHEMA = "thermojoint-response"
SCHEMA_VERSION = 1

#: name -> (dimensions, unit, long name); the first three are in every response.
VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "heat_input": (("time",), "1", "heat input relative to the reference step"),
    "source_power": (("time", "source"), "W", "heat of each source of the whole structure"),
    "load_factor": (("time", "load"), "1", "factor of each mechanical load"),
    "ambient": (("time",), "K", "ambient temperature above its initial value"),
    "held_temperature": (("time", "held"), "K", "held surfaces above the initial ambient"),
    "temperature": (("time", "probe"), "K", "temperature above the initial ambient"),
    "displacement": (("time", "axis"), "m", "relative displacement (attribute displacement_of)"),
    "probe_position": (("probe", "space"), "m", "position of the temperature probes"),
    "rotation": (("time", "axis"), "rad", "relative rotation about each axis"),
    "axis_position": (("time", "moving_axis"), "m", "position of each moving axis"),
    "axis_way": (("time", "moving_axis"), "m", "way of each moving axis, there and back"),
    "running_heat": (("time", "moving_axis"), "W", "heat of running friction, whole machine"),
    "asked_position": (("moving_axis", "asked"), "m", "positions that are asked about"),
    "asked_displacement": (
        ("time", "moving_axis", "asked", "axis"),
        "m",
        "relative displacement if the axis stood there",
    ),
    "asked_rotation": (
        ("time", "moving_axis", "asked", "axis"),
        "rad",
        "relative rotation if the axis stood there",
    ),
    "reference_position": (("moving_axis",), "m", "P0 of the line over the asked positions"),
    "line_offset": (("time", "moving_axis", "axis"), "m", "K0: displacement on the line at P0"),
    "line_slope": (("time", "moving_axis", "axis"), "1", "tan beta: slope of the line"),
    "line_left": (
        ("time", "moving_axis", "axis"),
        "m",
        "largest displacement that the line leaves at an asked position",
    ),
    "volume_position": (("place", "moving_axis"), "m", "points of the volume"),
    "volume_displacement": (
        ("survey", "place", "axis"),
        "m",
        "relative displacement if the axes stood there",
    ),
    "volume_rotation": (
        ("survey", "place", "axis"),
        "rad",
        "relative rotation if the axes stood there",
    ),
    "volume_gap_residual": (
        ("survey", "place"),
        "m",
        "largest error of the gaps if the axes stood there",
    ),
    "positioning_error": (
        ("time", "moving_axis"),
        "m",
        "body less control along the axis, at the present position",
    ),
    "asked_positioning_error": (
        ("time", "moving_axis", "asked"),
        "m",
        "body less control along the axis if it stood there",
    ),
    "station_position": (("moving_axis", "station"), "m", "places along the screw, on the axis"),
    "screw_temperature": (
        ("time", "moving_axis", "station"),
        "K",
        "screw above the initial ambient",
    ),
    "screw_tension": (("time", "moving_axis"), "N", "tension of the screw, 0 where it is slack"),
    "scale_temperature": (("time", "moving_axis"), "K", "scale above the initial ambient"),
    "pressure": (("time", "contact"), "Pa", "mean normal contact pressure"),
    "conductance": (("time", "contact"), "W m-2 K-1", "conductance of contact and gap"),
    "heat_flow": (("time", "contact"), "W", "heat flow across the joint, side a to side b"),
    "opening": (("time", "contact"), "m", "normal opening from the state at the start"),
    "slip": (("time", "contact", "tangent"), "m", "irreversible tangential slip"),
    "friction_heat": (("time", "contact"), "W", "heat of friction, half into each side"),
    "contact_position": (("contact", "space"), "m", "centroid of the contact elements"),
    "contact_area": (("contact",), "m2", "area of the contact elements"),
    "contact_joint": (("contact",), "", "name of the joint each contact element belongs to"),
    "reaction": (("time", "support", "space"), "N", "force of each support on the structure"),
    "bolt_force": (("time", "bolt"), "N", "force of each bolt, positive where it pulls"),
    "force_balance": (("time",), "1", "sum of supports and loads, relative"),
    "shear": (("time", "contact", "tangent"), "Pa", "mean shear traction on side b"),
    "joint_force": (("time", "joint", "space"), "N", "force of each joint on its side b"),
    "joint_moment": (("time", "joint", "space"), "N m", "its moment about the joint's centroid"),
    "stress": (("time", "stress_probe", "component"), "Pa", "stress at probes"),
    "von_mises": (("time", "stress_probe"), "Pa", "equivalent stress at probes"),
    "principal_stress": (
        ("time", "stress_probe", "order"),
        "Pa",
        "principal stresses at probes, the largest first",
    ),
    "gap_residual": (("time",), "m", "largest residual of the gap equations"),
    "iterations": (("time",), "1", "Newton iterations"),
    "cuts": (("time",), "1", "viscous steps where a joint snapped, and pieces of cut steps"),
    "taken_over": (("time",), "1", "1 in steps iterated because staggered ones alternate"),
    "secant_residual": (("time",), "K", "largest change of a temperature in the last secant step"),
    "heat_balance": (("time",), "1", "heat in minus stored minus convected, relative"),
}
REQUIRED = ("heat_input", "temperature", "displacement")
#: A probe further than this from a place is at another one, m.
ELSEWHERE = 1e-3


@dataclass(frozen=True, eq=False)
class ArrayResponse:
    """A response as plain arrays."""

    #: Coordinates and data by name.
    variables: Mapping[str, Variable]
    #: Metadata of the response.
    attrs: dict[str, Any]

    def __contains__(self, name: object) -> bool:
        return name in self.variables

    def __getitem__(self, name: str) -> Variable:
        return self.variables[name]

    @property
    def sizes(self) -> dict[str, int]:
        """Length of every dimension."""
        return {
            name: length
            for variable in self.variables.values()
            for name, length in zip(variable.dims, variable.values.shape, strict=True)
        }

    def only(self, name: str) -> ArrayResponse:
        """Return the response with one variable and its coordinates."""
        kept = (*(dim for dim in self.variables[name].dims if dim in self), name)
        return replace(self, variables={key: self.variables[key] for key in kept})

    def dataset(self) -> xr.Dataset:
        """Return the response as a labelled dataset, which shares the arrays."""
        import xarray as xr

        parts = {name: tuple(variable) for name, variable in self.variables.items()}
        coords = {name: parts.pop(name) for name in list(parts) if name not in VARIABLES}
        return xr.Dataset(parts, coords, self.attrs)


def check_response(response: xr.Dataset, where: str) -> xr.Dataset:
    """Return a response if it agrees with `VARIABLES` and its ``time`` (s) increases strictly.

    Raises
    ------
    InputError
        A variable, a dimension or ``time`` is missing, a unit differs, a value is not finite, a
        name is there twice, or time does not increase.
    """
    known = {}
    # Without data arrays: creating them takes longer than checking all values.
    for key, variable in response.variables.items():
        name = str(key)
        if name in VARIABLES or name == "time":
            # xarray converts dates and durations to other types and stores their unit elsewhere.
            stored = {k: variable.encoding[k] for k in ("units",) if k in variable.encoding}
            dims = tuple(map(str, variable.dims))
            known[name] = Variable(dims, variable.values, stored | variable.attrs)
    _check_variables(known, where)
    for dim in {dim for variable in known.values() for dim in variable.dims}:
        names = response.indexes.get(dim)
        if names is not None and not names.is_unique:
            twice = names[names.duplicated()][0]
            raise InputError(f"{where}: {dim} {twice!r} is there twice; remove or rename one")
    return response


def _check_variables(variables: Mapping[str, Variable], where: str) -> None:
    """Check data and ``time`` as specified by `check_response`."""
    for name in REQUIRED:
        if name not in variables:
            raise InputError(f"{where}: variable {name!r} is missing; a response needs {REQUIRED}")
    for name, (given, values, attrs) in variables.items():
        if name not in VARIABLES:
            continue
        dims, unit, _ = VARIABLES[name]
        if given != dims:
            raise InputError(f"{where}: {name!r} has dimensions {given}, expected {dims}")
        if unit and attrs.get("units") != unit:
            other = attrs.get("units", "no unit")
            raise InputError(f"{where}: {name!r} is in {other!r}, expected {unit!r}; convert it")
        if values.dtype.kind == "f" and not bool(np.isfinite(values).all()):
            raise InputError(f"{where}: {name!r} has values that are not finite; remove them")
    time = _checked_time(variables, where)
    if time.size < 2 or not bool((np.diff(time) > 0.0).all()):
        raise InputError(f"{where}: time must increase strictly and have two samples or more")


def _check_shapes(variables: Mapping[str, Variable], coords: Iterable[str], where: str) -> None:
    """Check that every array has the dimensions and the lengths of the coordinates."""
    lengths = {name: variables[name].values.size for name in coords}
    for name, (dims, values, _) in variables.items():
        expected = tuple(lengths.get(dim) for dim in dims)
        shape = np.shape(values)
        fits = len(shape) == len(dims) and all(
            length in (None, size) for length, size in zip(expected, shape, strict=True)
        )
        if not fits:
            named = ", ".join(f"{dim} {lengths.get(dim, 'any')}" for dim in dims)
            raise InputError(
                f"{where}: {name!r} has the shape {shape}, expected {named}; give a value for each"
            )


def _plain(value: object) -> object:
    """Return an attribute of a file as a Python number, text or list."""
    array = np.asarray(value)
    return array.item() if array.ndim == 0 else array.tolist()


def _checked_time(variables: Mapping[str, Variable], where: str) -> np.ndarray:
    """Return the times of a response, in s."""
    if "time" not in variables:
        raise InputError(f"{where}: coordinate 'time' is missing; give the time of each sample, s")
    _, time, attrs = variables["time"]
    unit = attrs.get("units", "no unit")
    if unit != "s" or time.dtype.kind not in "fi":
        given = repr(unit) if unit != "s" else f"'s' as {time.dtype}"
        raise InputError(f"{where}: 'time' is in {given}, expected 's' as numbers; convert it")
    if not bool(np.isfinite(time).all()):
        raise InputError(f"{where}: 'time' has values that are not finite; remove them")
    return time


def make_response(
    values: Mapping[str, np.ndarray],
    coords: Mapping[str, np.ndarray | list[str]],
    attrs: Mapping[str, str | float | int] | None = None,
) -> xr.Dataset:
    """Return a checked response from plain arrays, with units and long names filled in.

    Parameters
    ----------
    values : dict of ndarray
        Arrays in the shapes and units of `VARIABLES`.
    coords : dict
        At least ``time`` (s), ``probe`` (names) and ``axis`` (names).
    attrs : dict, optional
        Further metadata, e.g. ``reference_power_W`` and ``case``.

    Raises
    ------
    InputError
        A required array or coordinate is missing or unknown, its shape does not fit the
        coordinates, a value is not finite, or time does not increase.
    """
    return array_response(values, coords, attrs).dataset()


def array_response(
    values: Mapping[str, np.ndarray],
    coords: Mapping[str, np.ndarray | list[str]],
    attrs: Mapping[str, str | float | int] | None = None,
) -> ArrayResponse:
    """Return the same as `make_response`, but as `ArrayResponse`."""
    variables = {}
    for name, value in values.items():
        if name not in VARIABLES:
            raise unknown_name("response variable", name, VARIABLES, "make_response")
        dims, unit, long_name = VARIABLES[name]
        meta = {"long_name": long_name} | ({"units": unit} if unit else {})
        variables[name] = Variable(dims, value, meta)
    for name, labels in coords.items():
        meta = {"units": "s", "long_name": "time"} if name == "time" else {}
        variables[name] = Variable((name,), np.asarray(labels), meta)
    _check_variables(variables, "make_response")
    _check_shapes(variables, coords, "make_response")
    return ArrayResponse(
        variables, {"schema": SCHEMA, "schema_version": SCHEMA_VERSION} | dict(attrs or {})
    )


def write_response(response: AnyResponse, path: Path | str) -> None:
    """Write a response, whole or not at all.

    Parameters
    ----------
    response : xarray.Dataset or ArrayResponse
        See `check_response`.
    path : Path or str
        NetCDF to write.
    """
    write_bytes(Path(path), response_bytes(response))


def response_bytes(response: AnyResponse) -> bytes:
    """Return the content of a response's NetCDF file."""
    if isinstance(response, ArrayResponse):
        return netcdf_bytes(response.variables, response.attrs)
    from xarray import conventions

    # Other content of measured files, such as dates, is stored as xarray itself would.
    encoded, attrs = conventions.encode_dataset_coordinates(response)
    encoded, attrs = conventions.cf_encoder(encoded, attrs)
    variables = {
        str(name): Variable(tuple(map(str, variable.dims)), variable.values, variable.attrs)
        for name, variable in encoded.items()
    }
    return netcdf_bytes(variables, {str(name): value for name, value in attrs.items()})


def read_response(path: Path | str) -> xr.Dataset:
    """Read a response and check it.

    Parameters
    ----------
    path : Path or str
        NetCDF, written by `write_response` or laid out according to `VARIABLES`.

    Raises
    ------
    InputError
        The file is missing, truncated, not a response, of another version, or fails
        `check_response`.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a response written by 'thermojoint simulate'")
    with path.open("rb") as file:
        if file.read(len(HDF5)) != HDF5:
            raise InputError(
                f"{path}: no response (NetCDF); give one written by 'thermojoint simulate', or "
                "make one of a log with make_response"
            )
    import xarray as xr

    try:
        response = xr.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(
            f"{path}: not a readable NetCDF file, perhaps truncated; simulate it again"
        ) from error
    given = [_plain(response.attrs.get(name)) for name in ("schema", "schema_version")]
    if given != [SCHEMA, SCHEMA_VERSION]:
        raise InputError(
            f"{path}: schema {given[0]!r} version {given[1]!r}, expected {SCHEMA!r} version "
            f"{SCHEMA_VERSION}; write it again with this version"
        )
    return check_response(response, str(path))


def probes_of(response: xr.Dataset) -> list[str]:
    """Return the names of the temperature probes of a response, in their order."""
    return [str(name) for name in response["probe"].to_numpy()]


def displaced(
    response: xr.Dataset, places: Mapping[str, Sequence[float]]
) -> Iterator[tuple[str, float]]:
    """Yield the probes of a response that are not where they should be, and how far off, m.

    Parameters
    ----------
    response : xarray.Dataset
        A response without positions has none that is elsewhere.
    places : mapping of str to sequence of float
        Probe to its position, m.
    """
    if "probe_position" not in response:
        return
    for name in probes_of(response):
        if name in places:
            at = response["probe_position"].sel(probe=name).to_numpy()
            apart = float(np.linalg.norm(at - np.asarray(places[name])))
            if apart > ELSEWHERE:
                yield name, apart


def held_of(response: xr.Dataset) -> list[str]:
    """Return the names of the held surfaces whose temperature a response has, in their order."""
    if "held_temperature" not in response:
        return []
    return [str(name) for name in response["held"].to_numpy()]


def axes_of(response: xr.Dataset) -> list[str]:
    """Return the names of the displacement axes of a response, in their order."""
    return [str(name) for name in response["axis"].to_numpy()]


def columns_of(
    response: xr.Dataset, variable: str, names: Sequence[str], where: str = "response"
) -> Array:
    """Return columns of a variable, such as temperatures of probes or displacements along axes.

    Parameters
    ----------
    response : xarray.Dataset
        See `check_response`.
    variable : str
        A variable over time and a second, named dimension.
    names : sequence of str
        Names of the columns, in the order of the result.
    where : str
        For the error message.

    Returns
    -------
    ndarray, shape (n, names)

    Raises
    ------
    InputError
        The response lacks a name.
    """
    kind = str(response[variable].dims[1])
    known = [str(name) for name in response[kind].to_numpy()]
    for name in names:
        if name not in known:
            raise unknown_name(kind, name, known, where)
    columns = [known.index(name) for name in names]
    return np.asarray(response[variable].to_numpy()[:, columns], dtype=float)


def axes_that_move(
    responses: Iterable[xr.Dataset], axes: Sequence[str], least: float, where: str
) -> list[str]:
    """Return the axes with motion above `least` times the largest displacement of all responses.

    Raises
    ------
    InputError
        Nothing moves along any axis; `where` is the beginning of the message.
    """
    every = [np.nanmax(np.abs(columns_of(one, "displacement", axes)), axis=0) for one in responses]
    peaks = np.max(every, axis=0)
    if not peaks.any():
        raise InputError(
            f"{where}: the displacement is zero along every axis; record points that move"
        )
    return [axis for axis, peak in zip(axes, peaks, strict=True) if peak > least * peaks.max()]
