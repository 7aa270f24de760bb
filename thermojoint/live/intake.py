"""What a machine reads, by its estimator: names with units, and how they become channels in SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from estimator.interface import Estimator
from estimator.measured import LARGEST
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import UNITS, Column, column_named
from thermojoint.artefacts.units import MICRO

#: Larger values of anything but a temperature are none.
_LARGEST_OTHER = 1e9

#: (readings, the temperature at which the machine was cold) to (channels, that temperature).
Convert = Callable[[Sequence[float], float], tuple[list[float], float]]


@dataclass(frozen=True)
class Intake:
    """What a machine reads.

    Attributes
    ----------
    names : tuple of str
        Readings with their units, as sources call them unless told otherwise.
    wanted : int
        The first so many are read in every sample, the others now and then.
    limits : tuple of float
        A reading that is larger, of either sign, is none; in its unit.
    convert : callable
        From readings to the estimator's channels.
    """

    names: tuple[str, ...]
    wanted: int
    limits: tuple[float, ...]
    convert: Convert

    def usable(self, readings: Sequence[float]) -> tuple[float, ...]:
        """Return readings with NaN for what cannot be one."""
        return tuple(
            value if -limit <= value <= limit else math.nan
            for value, limit in zip(readings, self.limits, strict=True)
        )


def intake_of(estimator: Estimator, above_ambient: bool) -> Intake:
    """Return what a machine with an estimator reads.

    Parameters
    ----------
    estimator : Estimator
        Of any kind.
    above_ambient : bool
        Sources tell temperatures above the ambient, in K, not those of thermometers.
    """
    if estimator.kind == "fchs":
        return _of_fchs([channel.name for channel in estimator.channels[1:]], above_ambient)
    names = [channel.name for channel in estimator.channels]
    touches = len(estimator.axes)
    if estimator.kind in ("joint-aware", "kalman-linear"):
        return _of_joint_aware(names[:-touches], estimator.axes, above_ambient)
    if above_ambient:
        raise InputError(
            'reads = "above-ambient": a learned model reads what its log had; leave the key out'
        )
    return _of_learned(names[:-touches], estimator.axes)


def _intake(names: Sequence[str], wanted: int, convert: Convert) -> Intake:
    limits = [
        LARGEST
        if (found := column_named(name)) and found.quantity == "temperature"
        else _LARGEST_OTHER
        for name in names
    ]
    return Intake(tuple(names), wanted, tuple(limits), convert)


def _of_fchs(sensors: Sequence[str], above_ambient: bool) -> Intake:
    if above_ambient:
        names = ["delta_T_K", *(f"{name}_K" for name in sensors)]
        return _intake(names, len(names), lambda readings, cold: (list(readings), cold))
    names = ["a_degC", "b_degC", *(f"{name}_degC" for name in sensors), "ambient_degC"]

    def convert(readings: Sequence[float], cold: float) -> tuple[list[float], float]:
        hot, back, *joint, ambient = readings
        return [hot - back, *(value - ambient for value in joint)], cold

    return _intake(names, len(names), convert)


def _of_joint_aware(thermal: Sequence[str], axes: Sequence[str], above_ambient: bool) -> Intake:
    unit = "K" if above_ambient else "degC"
    names = [*(f"{name}_{unit}" for name in thermal), *(f"{axis}_um" for axis in axes)]
    count = len(thermal)

    def convert(readings: Sequence[float], cold: float) -> tuple[list[float], float]:
        # The machine was cold at the first ambient temperature that was ever read.
        if math.isnan(cold):
            cold = 0.0 if above_ambient else readings[count - 1]
        temperatures = [value - cold for value in readings[:count]]
        return [*temperatures, *(MICRO * value for value in readings[count:])], cold

    return _intake(names, count, convert)


def _of_learned(columns: Sequence[str], axes: Sequence[str]) -> Intake:
    names = [*columns, *axes]
    units = [UNITS[_column(name).unit] for name in names]

    def convert(readings: Sequence[float], cold: float) -> tuple[list[float], float]:
        return [
            unit.scale * (value + unit.offset) for value, unit in zip(readings, units, strict=True)
        ], cold

    return _intake(names, len(columns), convert)


def _column(name: str) -> Column:
    found = column_named(name)
    if found is None:
        raise InputError(f"{name}: no unit at the end of the name; learn the model anew")
    return found


def axis_name(axis: str) -> str:
    """Return an axis without the unit that a learned model's carries: ``disp1_um`` is ``disp1``."""
    found = column_named(axis)
    return found.base if found else axis
