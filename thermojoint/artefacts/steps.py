"""Extraction of step levels, times and signals from responses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import check_response, columns_of

if TYPE_CHECKING:
    import xarray as xr

#: Samples on which starts are compared before the full series is used.
COARSE = 150
#: Largest deviation of a sample from an even series, relative to the interval.
UNEVEN = 1e-3


def step_level(response: xr.Dataset, where: str) -> float:
    """Return the heat input of a step response, relative to the reference.

    The step starts at time 0; the sample at time 0, if there is one, may still be zero.

    Raises
    ------
    InputError
        The response is invalid, time starts before 0, the ambient changes, or the heat input is
        not a step.
    """
    check_response(response, where)
    time = response["time"].to_numpy()
    heat = response["heat_input"].to_numpy()
    if time[0] < 0.0:
        raise InputError(f"{where}: time starts at {time[0]:g} s; the step must start at time 0")
    if "ambient" in response and bool(response["ambient"].any()):
        raise InputError(f"{where}: the ambient moves; calibration needs a run where it is steady")
    level = float(heat[-1])
    held = heat if time[0] > 0.0 or heat[0] != 0.0 else heat[1:]
    off = np.abs(held - level) > 1e-9 * abs(level)
    if level == 0.0 or bool(off.any()):
        index = int(np.argmax(off)) + (heat.size - held.size)
        raise InputError(
            f"{where}: the heat input is {heat[index]:g} at {time[index]:g} s and {level:g} at the "
            "end; calibration needs a step, constant from time 0"
        )
    return level


def even_interval(t: np.ndarray, where: str) -> float:
    """Return the interval, s, of samples that are evenly spaced from the start of the step.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the step, s; the first is 0 or one interval.
    where : str
        For error messages.

    Raises
    ------
    InputError
        A sample deviates by more than `UNEVEN` intervals from an even series.
    """
    interval = float(t[-1] - t[0]) / (t.size - 1)
    first = 0 if t[0] < 0.5 * interval else 1
    off = np.abs(t - interval * np.arange(first, first + t.size))
    if off.max() > UNEVEN * interval:
        apart = np.diff(t)
        raise InputError(
            f"{where}: samples are {apart.min():g} to {apart.max():g} s apart, the first at "
            f"{t[0]:g} s; sample evenly in time, from 0 or one interval after it"
        )
    return interval


def times(response: xr.Dataset) -> np.ndarray:
    """Return the sample times, s, shape (n,)."""
    return response["time"].to_numpy().astype(float)


def temperature(response: xr.Dataset, probe: str, where: str) -> np.ndarray:
    """Return the temperature at `probe`, K above ambient, shape (n,)."""
    return columns_of(response, "temperature", [probe], where)[:, 0]


def displacement(response: xr.Dataset, axis: str, where: str) -> np.ndarray:
    """Return the displacement along `axis`, m, shape (n,)."""
    return columns_of(response, "displacement", [axis], where)[:, 0]


def thinned(count: int) -> slice:
    """Return the slice that keeps about `COARSE` of `count` evenly spaced samples."""
    return slice(None, None, max(1, round(count / COARSE)))
