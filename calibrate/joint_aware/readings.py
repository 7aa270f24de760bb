"""Conversion of responses to calibration runs of a joint-aware model."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import xarray as xr

from calibrate.joint_aware.misfit import Run, physics_with
from estimator.joint_aware.odometers import plausible
from estimator.joint_aware.readings import ambient_in, recorded, temperatures_in
from estimator.joint_aware.sample_values import OVERTRAVEL
from estimator.joint_aware.thresholds import USUAL
from fesim.axes.axis import gone_along
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import columns_of
from thermojoint.artefacts.units import MILLI
from thermojoint.reduced.machine import ReducedMachine
from thermojoint.reduced.physics import at_start, starting_under

#: At rest every sensor agrees with the others within this, K; a larger difference is no offset.
COLD = 3.0
#: An axis that reverses after more than this share of its moves from sample to sample is assumed to
#: do so between samples, too; changes below this share of its range of positions are no moves.
OFTEN, JITTER = 0.25, 0.01


def check_cold(first: Array, names: Sequence[str], where: str) -> None:
    """Refuse a run whose first readings (K above the ambient, of sensors `names`) are not at rest.

    Raises
    ------
    InputError
        A sensor is warmer or colder than the ambient by more than `COLD`.
    """
    warmest = int(np.argmax(np.abs(first)))
    if abs(first[warmest]) > COLD:
        raise InputError(
            f"{where}: {names[warmest]} begins {first[warmest]:+.1f} K from the ambient; begin "
            "with the machine at rest, cold through"
        )


def run_in(response: xr.Dataset, machine: ReducedMachine, where: str) -> Run:
    """Return a calibration run on the steps of the march, with all its samples.

    Parameters
    ----------
    response : xarray.Dataset
        From rest at time 0, with known heat input.
    machine : ReducedMachine
        Defines sensors, axes, powers and the step.
    where : str
        For error messages.

    Raises
    ------
    InputError
        Time starts before 0, the run starts warm or is too short, an axis leaves its stroke or has
        a drive that is not in the model, or a probe, an axis or a load is missing.
    """
    guide = machine.guide
    if (guide is None or not guide.drives.any) and "positioning_error" in response:
        raise InputError(
            f"{where}: its displacement has the error of a ball screw or a scale, which the model "
            "does not know; record where the body is"
        )
    times = response["time"].to_numpy().astype(float)
    if times[0] < 0.0:
        raise InputError(f"{where}: time starts at {times[0]:g} s; it must start at rest, at 0")
    temperature = temperatures_in(response, machine.sensor_names)
    # A machine may start warm according to its case, and so may a sensor on a held surface.
    if times[0] == 0.0 and not machine.start.any() and not machine.held.names:
        check_cold(temperature[0], machine.sensor_names, where)
    count = round(times[-1] / machine.step)
    if count < 2:
        raise InputError(
            f"{where}: shorter than two steps of {machine.step:g} s; record for longer"
        )
    grid = machine.step * np.arange(1, count + 1)
    # A value of the heat applies to the interval that ends at its sample.
    at = np.minimum(np.searchsorted(times, grid * (1.0 - 1e-9)), times.size - 1)
    powers = _means_in_steps(times, heat_in(response, machine), grid)
    ambient = np.interp(grid, times, ambient_in(response))
    held = held_in(response, machine)[at]
    loads = recorded(response, "load_factor", machine.load_names)
    positions = recorded(response, "axis_position", machine.axis_names)
    _check_strokes(times, positions, machine, where)
    _warn_of_turns(positions, machine, where)
    factors = [np.interp(grid, times, column) for column in (*loads.T, *positions.T)]
    displacement = columns_of(response, "displacement", machine.axes)
    zeroed = "displacement_from" in response.attrs
    if zeroed or not displacement[0].any():
        # A log is relative to its beginning, a machine under loads to its unloaded state.
        begun = starting_under(physics_with(machine, {}), loads[0])
        displacement = displacement + at_start(begun)[1]
    ways = ways_of(response, machine, positions).T
    ends = [np.interp(grid, times, column) for column in ways]
    return Run(
        inputs=np.column_stack([powers, held, ambient, *factors]),
        times=times,
        temperature=temperature,
        displacement=displacement,
        length=machine.step,
        gone=np.diff(np.column_stack(ends), axis=0, prepend=0.0) if ends else None,
        loads=loads[0],
        zeroed=zeroed,
    )


def _check_strokes(times: Array, positions: Array, machine: ReducedMachine, where: str) -> None:
    """Refuse positions (n, x), m, at times (n,), s, outside the stroke of their axis.

    The machine would stand at the end of the stroke instead.
    """
    strokes = () if machine.guide is None else machine.guide.way.stations.positions
    for name, stroke, position in zip(machine.axis_names, strokes, positions.T, strict=True):
        low, high = float(stroke[0]), float(stroke[-1])
        outside = np.flatnonzero((position < low - OVERTRAVEL) | (position > high + OVERTRAVEL))
        if outside.size:
            at = outside[0]
            raise InputError(
                f"{where}: axis '{name}' is at {position[at] / MILLI:g} mm at {times[at]:g} s, "
                f"outside its stroke in the case, {low / MILLI:g} to {high / MILLI:g} mm; correct "
                "the position, its unit or its zero"
            )


def _warn_of_turns(positions: Array, machine: ReducedMachine, where: str) -> None:
    """Warn of axes without an odometer that reverse so often that they also do between samples.

    Positions are (n, x), m.
    """
    axes = () if machine.guide is None else machine.guide.axes
    for axis, position in zip(axes, positions.T, strict=True):
        moves = np.diff(position)
        moves = moves[np.abs(moves) > JITTER * np.ptp(position)]
        turns = np.count_nonzero(moves[1:] * moves[:-1] < 0.0)
        if not axis.odometer and turns > OFTEN * moves.size:
            warnings.warn(
                f"{where}: axis '{axis.name}' turns back after {100.0 * turns / moves.size:.0f} % "
                "of its moves from sample to sample: what it goes between them is not seen, nor is "
                "its heat; sample more often, or record its way and set odometer = true",
                stacklevel=3,
            )


def _means_in_steps(times: Array, values: Array, grid: Array) -> Array:
    """Means (k, s) in the steps that end at `grid` (k,) of values (n, s) held until their times."""
    lasts = np.diff(times, prepend=0.0)[:, None]
    whole = np.pad(np.cumsum(lasts * values, axis=0), ((1, 0), (0, 0)))
    ends = np.minimum(np.append(0.0, grid), times[-1])
    sums = [np.interp(ends, np.append(0.0, times), column) for column in whole.T]
    return np.asarray(np.diff(sums, axis=1).T / np.diff(ends)[:, None])


def ways_of(response: xr.Dataset, machine: ReducedMachine, positions: Array) -> Array:
    """Return the travel of axes until every sample, (n, x), m, by odometers or by positions.

    Parameters
    ----------
    response : xarray.Dataset
        Of a run.
    machine : ReducedMachine
        With these axes.
    positions : ndarray, shape (n, x)
        Of the run, m.
    """
    ways = gone_along(positions)
    if "axis_way" in response and positions.shape[1]:
        counted = recorded(response, "axis_way", machine.axis_names)
        times = response["time"].to_numpy()
        steps = np.diff(counted, axis=0, prepend=counted[:1])
        least = np.diff(ways, axis=0, prepend=0.0)
        # An odometer that reports less than the change of position was reset, and so was one that
        # jumps ahead: in both cases, only positions count.
        told = plausible(steps, np.diff(times, prepend=times[:1])[:, None], USUAL.fastest)
        ways = np.cumsum(np.where(told, np.maximum(steps, least), least), axis=0)
    return ways


def held_in(response: xr.Dataset, machine: ReducedMachine) -> Array:
    """Return the temperatures of held surfaces, (n, h), K; the case's where they are constant.

    Raises
    ------
    InputError
        One that changes is not recorded.
    """
    held = machine.held
    values = np.tile(held.first, (response.sizes["time"], 1))
    for k in np.flatnonzero(held.varies):
        values[:, k] = temperatures_in(response, [held.names[k]])[:, 0]
    return values


def heat_in(response: xr.Dataset, machine: ReducedMachine) -> Array:
    """Return the heat of every source of the machine, W, shape (n, s).

    As recorded; where it is not, the heat input times the powers of the machine.

    Raises
    ------
    InputError
        The heat of other sources is recorded.
    """
    if "source_power" in response:
        return columns_of(response, "source_power", machine.source_names)
    heat = response["heat_input"].to_numpy().astype(float)
    return np.asarray(heat[:, None] * machine.power)
