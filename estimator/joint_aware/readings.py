"""Sensor readings of a joint-aware estimator from a response."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import xarray as xr

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import columns_of, held_of, probes_of


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
    held, probes = held_of(response), probes_of(response)
    columns = [
        columns_of(
            response,
            "held_temperature" if name in held and name not in probes else "temperature",
            [name],
        )
        for name in sensors
    ]
    return np.hstack([np.zeros((response.sizes["time"], 0)), *columns])


def recorded(response: xr.Dataset, variable: str, names: Sequence[str]) -> Array:
    """Return columns of a recorded variable, (n, k), which may be absent if no names are given.

    Such as ``load_factor`` of loads, ``axis_position`` of moving axes and ``axis_way``, the
    distance that these have travelled, to and fro, m.

    Raises
    ------
    InputError
        One is missing.
    """
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
    values = np.column_stack(
        [
            temperatures_in(response, sensors),
            ambient_in(response),
            recorded(response, "load_factor", loads),
            recorded(response, "axis_position", axes),
            recorded(response, "axis_way", counted),
            powers_in(response, shares),
        ]
    )
    for time, row in zip(response["time"].to_numpy(), values, strict=True):
        yield (float(time), *map(float, row))
