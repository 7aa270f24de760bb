"""The parameters of the tests: ranges of displacement, tilt and temperature over their periods.

Every parameter is a range, highest minus lowest value, and does not depend on a sensor's zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.standards.iso230_3.extremes import Extremes, extremes
from thermojoint.standards.iso230_3.period import Period, whole
from thermojoint.standards.iso230_3.record import Quantity, Record

#: Duration of the first part of a test with motion, which is evaluated separately, s.
FIRST = 3600.0


@dataclass(frozen=True)
class Parameter:
    """One parameter of a test."""

    #: E.g. ``d(X)60``.
    symbol: str
    #: ``displacement`` (m), ``tilt`` (rad) or ``temperature`` (K).
    quantity: Quantity
    #: Channel of the record.
    channel: str
    #: Period of the range.
    period: Period
    #: Extremes; their `range` is the value.
    extremes: Extremes

    @property
    def value(self) -> float:
        """Range, m, rad or K."""
        return self.extremes.range


def environment(record: Record) -> tuple[Parameter, ...]:
    """Return the environmental temperature variation error of every channel.

    ETVE(c) is the range over the whole record of a machine at standstill; ΔT(c) the range of a
    temperature over the same time.
    """
    return _parameters(record, "ETVE", {"": whole(record)})


def distortion(record: Record, period: Period) -> tuple[Parameter, ...]:
    """Return the thermal distortion of every channel by the motion of a spindle or an axis.

    d(c)60 is the range over the first 60 min, d(c)t over the whole running period t; ΔT(c)60 and
    ΔT(c)t the ranges of a temperature.

    Raises
    ------
    InputError
        The period is shorter than 60 min, or a channel does not cover it.
    """
    if period.length < FIRST * (1.0 - 1e-9):
        raise InputError(
            f"running period: {period.length / 60.0:g} min; the test is evaluated over its first "
            "60 min, so let it run for longer"
        )
    first = Period(period.begin, min(period.begin + FIRST, period.end))
    return _parameters(record, "d", {"60": first, "t": period})


def unsettled(record: Record, period: Period) -> dict[str, float]:
    """Return the range over the last 60 min relative to that over the first 60 min, by channel.

    The ratio is small for a test that has reached a steady state; omitted if the first range is
    zero.
    """
    length = min(FIRST, period.length)
    first = Period(period.begin, period.begin + length)
    last = Period(period.end - length, period.end)
    shares = {}
    for quantity, channel, values in _channels(record):
        if quantity != "temperature":
            early, late = (
                extremes(record.times, values, *period, channel) for period in (first, last)
            )
            if early.range > 0.0:
                shares[channel] = late.range / early.range
    return shares


def _channels(record: Record) -> Iterator[tuple[Quantity, str, Array]]:
    for quantity, channels in record.channels.items():
        for channel, values in channels.items():
            yield quantity, channel, values


def _parameters(record: Record, name: str, periods: Mapping[str, Period]) -> tuple[Parameter, ...]:
    """Ranges of every channel; `periods` by the ends of their symbols; a temperature's is ΔT."""
    return tuple(
        Parameter(
            f"{'ΔT' if quantity == 'temperature' else name}({channel}){mark}",
            quantity,
            channel,
            period,
            extremes(record.times, values, *period, channel),
        )
        for quantity, channel, values in _channels(record)
        for mark, period in periods.items()
    )
