"""What a machine reads for an estimator: names with units, and how they become channels in SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile

from estimator.interface import Channel
from estimator.measured import LARGEST
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import UNITS, Column, column_named

#: Larger values of anything but a temperature are none.
_LARGEST_OTHER = 1e9
#: How a reading of a channel is told where its unit is no ending of a name.
_SUFFIXES = {"m": "um", "rad/s": "rad_s", "N m": "Nm"}

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


def intake(names: Sequence[str], wanted: int, convert: Convert) -> Intake:
    """Return what a machine reads, with the limits of its quantities."""
    limits = [
        LARGEST
        if (found := column_named(name)) and found.quantity == "temperature"
        else _LARGEST_OTHER
        for name in names
    ]
    return Intake(tuple(names), wanted, tuple(limits), convert)


def by_channels(channels: Sequence[Channel]) -> Intake:
    """Return the intake of an estimator whose sample holds what is read, each in its own unit.

    Parameters
    ----------
    channels : sequence of Channel
        A temperature ``T1`` in K is read as ``T1_K``; a name that ends in a unit is read as it is.
        Lengths at the end are displacements, which are read now and then, in µm.
    """
    lengths = takewhile(lambda channel: channel.unit == "m", reversed(channels))
    return of_columns([_named(one) for one in channels], len(channels) - len(list(lengths)))


def of_columns(names: Sequence[str], wanted: int) -> Intake:
    """Return the intake of an estimator whose channels are columns of a log, in SI.

    Raises
    ------
    InputError
        A name ends in no unit.
    """
    units = [UNITS[_column(name).unit] for name in names]

    def convert(readings: Sequence[float], cold: float) -> tuple[list[float], float]:
        return [
            unit.scale * (value + unit.offset) for value, unit in zip(readings, units, strict=True)
        ], cold

    return intake(names, wanted, convert)


def _named(channel: Channel) -> str:
    if column_named(channel.name):
        return channel.name
    return f"{channel.name}_{_SUFFIXES.get(channel.unit, channel.unit)}"


def _column(name: str) -> Column:
    found = column_named(name)
    if found is None:
        raise InputError(f"{name}: no unit at the end of the name; name the column with its unit")
    return found


def axis_name(axis: str) -> str:
    """Return an axis without the unit that a learned model's carries: ``disp1_um`` is ``disp1``."""
    found = column_named(axis)
    return found.base if found else axis
