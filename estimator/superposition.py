"""Response of a linear structure to any heat input, by superposition of its reference response."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.steps import step_level

if TYPE_CHECKING:
    import xarray as xr


def superposed(reference: xr.Dataset, response: xr.Dataset, variable: str) -> np.ndarray:
    """Return a variable's linear response to the heat of `response`, superposed from `reference`.

    Duhamel's sum over the changes of the heat input, whose values are constant over the interval
    that ends at their sample. The reference is the response to one step at time 0.

    Returns
    -------
    ndarray, shape of the variable in `response`

    Raises
    ------
    InputError
        The reference is not a step, is too short, or has other probes or axes.
    """
    level = step_level(reference, "reference response")
    times, lag = response["time"].to_numpy(), reference["time"].to_numpy()
    if times[-1] > lag[-1] * (1.0 + 1e-9):
        raise InputError("reference response: shorter than the response; simulate it for longer")
    label = response[variable].dims[1]
    if list(reference[label].to_numpy()) != list(response[label].to_numpy()):
        raise InputError(f"reference response: other {label} names than the response")
    unit = reference[variable].to_numpy() / level
    if lag[0] > 0.0:
        lag, unit = np.append(0.0, lag), np.concatenate((np.zeros((1, unit.shape[1])), unit))
    heat = held_heat(response)
    onsets = np.append(0.0, times[:-1])
    changes = np.diff(heat, prepend=0.0)
    elapsed = np.maximum(np.subtract.outer(times, onsets), 0.0)
    return np.stack([np.interp(elapsed, lag, column) @ changes for column in unit.T], axis=1)


def held_heat(response: xr.Dataset) -> np.ndarray:
    """Return the heat input over the interval that ends at each sample, from rest at time 0.

    Raises
    ------
    InputError
        Time starts before 0.
    """
    times, heat = response["time"].to_numpy(), response["heat_input"].to_numpy().astype(float)
    if times[0] < 0.0:
        raise InputError(f"response: time starts at {times[0]:g} s; it must start at rest, at 0")
    # No heat has been supplied by time 0, even if the history has a value there.
    return np.where(times > 0.0, heat, 0.0)
