"""Readings of a machine for an estimator: names with units, and conversion to channels in SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from estimator.interface import Channel
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import UNITS, Column, column_named
from thermojoint.artefacts.tables.cells import is_error_value

#: Magnitudes beyond this are invalid.
_LARGEST = 1e9
#: Suffix of a reading whose unit is no suffix of a column name.
_SUFFIXES = {"m": "um", "rad/s": "rad_s", "N m": "Nm"}

#: (readings, ambient at which the machine was cold) to (channels, that ambient).
Convert = Callable[[Sequence[float], float], tuple[list[float], float]]


@dataclass(frozen=True)
class Intake:
    """Readings that a machine delivers, and their conversion to an estimator's channels."""

    #: Readings with their units, as named in the sources by default.
    names: tuple[str, ...]
    #: Number of those, the first ones, that are read in every sample; the others are occasional.
    wanted: int
    #: ``temperature``, ``length``, ``speed`` and so on, of each reading.
    quantities: tuple[str, ...]
    #: From readings to the estimator's channels.
    convert: Convert

    def usable(self, readings: Sequence[float]) -> tuple[float, ...]:
        """Return readings with NaN in place of invalid ones, as in every table."""
        return tuple(
            value if abs(value) <= _LARGEST and not is_error_value(value, quantity) else math.nan
            for value, quantity in zip(readings, self.quantities, strict=True)
        )


def intake(names: Sequence[str], wanted: int, convert: Convert) -> Intake:
    """Return the intake for these readings, with their quantities."""
    quantities = [column.quantity if (column := column_named(name)) else "" for name in names]
    return Intake(tuple(names), wanted, tuple(quantities), convert)


def by_channels(channels: Sequence[Channel]) -> Intake:
    """Return the intake of an estimator whose channels are the readings, each in its own unit.

    Parameters
    ----------
    channels : sequence of Channel
        A temperature ``T1`` in K is read as ``T1_K``; a name with a unit suffix is read as it is.
        Those that are read occasionally are the last.
    """
    wanted = sum(not channel.occasional for channel in channels)
    return of_columns([_named(channel) for channel in channels], wanted)


def of_columns(names: Sequence[str], wanted: int) -> Intake:
    """Return the intake of an estimator whose channels are log columns, in SI.

    Raises
    ------
    InputError
        A name has no unit suffix.
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
    column = column_named(name)
    if column is None:
        raise InputError(f"{name}: no unit at the end of the name; name the column with its unit")
    return column


def axis_name(axis: str) -> str:
    """Return an axis of a learned model without its unit: ``disp1_um`` is ``disp1``."""
    column = column_named(axis)
    return column.base if column else axis
