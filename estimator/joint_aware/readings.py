"""Sensor readings of a joint-aware estimator from a response."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import columns_of


def ambient_in(response: xr.Dataset) -> Array:
    """Return the ambient above its initial value, K, shape (n,); zero if it is not recorded."""
    if "ambient" in response:
        return np.asarray(response["ambient"].to_numpy(), dtype=float)
    return np.zeros(response.sizes["time"])


def samples_in(response: xr.Dataset, sensors: Sequence[str]) -> Iterator[tuple[float, ...]]:
    """Yield (time, temperature of every sensor, ambient) for every sample of a response.

    Raises
    ------
    InputError
        A probe is missing.
    """
    values = np.column_stack([columns_of(response, "temperature", sensors), ambient_in(response)])
    for time, row in zip(response["time"].to_numpy(), values, strict=True):
        yield (float(time), *map(float, row))
