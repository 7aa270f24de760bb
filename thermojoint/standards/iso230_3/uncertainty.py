"""Uncertainty of a parameter: standard uncertainties, combined, times two, by the GUM.

A parameter is the difference of two readings of one channel. The error of a reading is assumed to
be uniformly distributed within a known limit ±a: u = a / √3 (JCGM 100:2008). The errors of the two
readings count as independent, although their common part cancels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import unknown_name
from thermojoint.standards.iso230_3.extremes import extremes
from thermojoint.standards.iso230_3.instruments import Instruments
from thermojoint.standards.iso230_3.parameters import Parameter
from thermojoint.standards.iso230_3.record import Record

#: Coverage factor: about 95 % for a normal distribution.
COVERAGE = 2.0
#: Values whose difference, relative to the largest reading, is smaller count as equal.
ROUNDING = 1e-9
#: Standard deviation of a normal distribution over the median of its absolute value.
_MEDIAN = 1.4826


@dataclass(frozen=True)
class Contribution:
    """One source of uncertainty."""

    #: E.g. ``probe``.
    source: str
    #: Standard uncertainty of the parameter due to it, m, rad or K.
    standard: float
    #: Basis of the value.
    basis: str


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of a parameter; its contributions are independent."""

    contributions: tuple[Contribution, ...]

    @property
    def combined(self) -> float:
        """Combined standard uncertainty, m, rad or K."""
        return math.hypot(*(one.standard for one in self.contributions))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty with `COVERAGE`, m, rad or K."""
        return COVERAGE * self.combined


def uncertainty(
    record: Record, parameter: Parameter, instruments: Instruments
) -> Uncertainty | None:
    """Return the uncertainty of a parameter; None for a tilt not measured by two probes.

    Raises
    ------
    InputError
        The holder's thermometer is missing in the record, or was not read over the period.
    """
    if parameter.quantity == "temperature":
        known = instruments.thermometer
        own = [Contribution("thermometer", _of_two(known.value), known.basis)]
    elif parameter.quantity == "displacement":
        own = list(_probed(record, parameter, instruments))
    elif (distance := record.distances.get(parameter.channel)) is None:
        return None
    else:
        # Two probes with independent errors, and their distance, which scales the tilt.
        own = [
            Contribution(one.source, math.sqrt(2.0) * one.standard / distance, one.basis)
            for one in _probed(record, parameter, instruments)
        ]
        known = instruments.distance
        scaled = parameter.value * known.value / (math.sqrt(3.0) * distance)
        own.append(Contribution("distance", scaled, known.basis))
    return Uncertainty((*own, _repeated(record, parameter, instruments)))


def _of_two(limit: float) -> float:
    """Standard uncertainty of the difference of two readings, each within ±limit."""
    return math.sqrt(2.0 / 3.0) * limit


def _probed(
    record: Record, parameter: Parameter, instruments: Instruments
) -> Iterator[Contribution]:
    """Contributions of one probe, m; drift and holder are uniformly distributed in their range."""
    yield Contribution("probe", _of_two(instruments.probe.value), instruments.probe.basis)
    drift = instruments.drift
    yield Contribution("drift of the probe", _of_two(0.5 * drift.value), drift.basis)
    if (holder := instruments.holder) is None:
        return
    rise, basis = holder.rise, holder.basis
    if isinstance(rise, str):
        name = rise
        if name not in record.temperatures:
            raise unknown_name("temperature", name, record.temperatures, "holder")
        rise = extremes(record.times, record.temperatures[name], *parameter.period, name).range
        basis = f"{basis}, {name}"
    yield Contribution("holder of the probe", _of_two(0.5 * holder.growth * rise), basis)


def _repeated(record: Record, parameter: Parameter, instruments: Instruments) -> Contribution:
    if (known := instruments.repeat.get(parameter.quantity)) is not None:
        return Contribution("repeat", known.value, known.basis)
    values = record.channels[parameter.quantity][parameter.channel]
    scattered = scatter(record.times, values)
    return Contribution(
        "repeat",
        math.sqrt(2.0) * scattered,
        "scatter of the readings; no repeated tests were given",
    )


def scatter(times: Array, values: Array) -> float:
    """Return the standard deviation of single readings about a smooth course, in their unit.

    Each reading is compared with the straight line between its neighbours; the median of the
    deviations is insensitive to a few sudden changes. The result is at least q / √12 for a
    resolution q.

    Parameters
    ----------
    times : ndarray, shape (n,)
        s, strictly increasing.
    values : ndarray, shape (n,)
        NaN for missing readings.
    """
    read = np.isfinite(values)
    t, v = times[read], values[read]
    if t.size < 3:
        return 0.0
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    departures = v[1:-1] - (1.0 - share) * v[:-2] - share * v[2:]
    single = np.abs(departures) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
    steps = np.diff(np.unique(v))
    # Tilts from equal differences of readings differ in their last digits.
    steps = steps[steps > ROUNDING * np.abs(v).max()]
    resolution = float(steps.min()) if steps.size else 0.0
    return max(_MEDIAN * float(np.median(single)), resolution / math.sqrt(12.0))
