"""Sensor readings of a joint-aware estimator from a response."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import xarray as xr

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import columns_of


def ambient_in(response: xr.Dataset) -> Array:
    """Return the ambient above its initial value, K, shape (n,); zero if it is not recorded."""
    if "ambient" in response:
        return np.asarray(response["ambient"].to_numpy(), dtype=float)
    return np.zeros(response.sizes["time"])


def temperatures_in(response: xr.Dataset, sensors: Sequence[str]) -> Array:
    """Return the temperatures of probes and held surfaces, K, shape (n, p).

    Raises
    ------
    InputError
        One is missing.
    """
    held: list[str] = []
    if "held_temperature" in response:
        held = [str(name) for name in response["held"].to_numpy()]
    probes = {str(name) for name in response["probe"].to_numpy()}
    columns = [
        columns_of(
            response,
            "held_temperature" if name in held and name not in probes else "temperature",
            [name],
        )
        for name in sensors
    ]
    return np.hstack([np.zeros((response.sizes["time"], 0)), *columns])


def loads_in(response: xr.Dataset, loads: Sequence[str]) -> Array:
    """Return the factors of some loads, shape (n, v).

    Raises
    ------
    InputError
        A load is missing.
    """
    return _recorded(response, "load_factor", loads)


def positions_in(response: xr.Dataset, axes: Sequence[str]) -> Array:
    """Return the positions of some moving axes, m, shape (n, x).

    Raises
    ------
    InputError
        One is missing.
    """
    return _recorded(response, "axis_position", axes)


def ways_in(response: xr.Dataset, axes: Sequence[str]) -> Array:
    """Return the distance that some moving axes have travelled, to and fro, m, shape (n, c).

    Raises
    ------
    InputError
        One is missing.
    """
    return _recorded(response, "axis_way", axes)


def _recorded(response: xr.Dataset, variable: str, names: Sequence[str]) -> Array:
    """Columns of a recorded variable, (n, k), which may be absent if no names are given."""
    if not names:
        return np.zeros((response.sizes["time"], 0))
    if variable not in response:
        raise InputError(f"response: no '{variable}', needed for {', '.join(names)}; record it")
    return columns_of(response, variable, names)


def powers_in(response: xr.Dataset, shares: Mapping[str, float]) -> Array:
    """Return the powers of which these shares are the heat of sources, W, shape (n, t).

    Raises
    ------
    InputError
        A source is missing.
    """
    if not shares:
        return np.zeros((response.sizes["time"], 0))
    return columns_of(response, "source_power", list(shares)) / np.array([*shares.values()])


def samples_in(
    response: xr.Dataset,
    sensors: Sequence[str],
    loads: Sequence[str] = (),
    axes: Sequence[str] = (),
    shares: Mapping[str, float] = MappingProxyType({}),
    counted: Sequence[str] = (),
) -> Iterator[tuple[float, ...]]:
    """Yield the time and `estimator.joint_aware.estimator.JointAware.channels` of every sample.

    Raises
    ------
    InputError
        A probe, a load, a position, a way of the `counted` axes or a source is missing.
    """
    sensed, given = temperatures_in(response, sensors), loads_in(response, loads)
    others = positions_in(response, axes), ways_in(response, counted), powers_in(response, shares)
    values = np.column_stack([sensed, ambient_in(response), given, *others])
    for time, row in zip(response["time"].to_numpy(), values, strict=True):
        yield (float(time), *map(float, row))
