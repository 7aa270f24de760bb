"""Values of a sample by quantity; those that are implausible count as missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator import sensor_faults
from estimator.joint_aware.innovation_gate import possible_readings
from estimator.joint_aware.precomputed import Precomputed
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MILLI

#: A position this far beyond the stroke, m, is still its end: a millimetre of overtravel.
OVERTRAVEL = MILLI


class SampleValues(NamedTuple):
    """Values of a sample by quantity; NaN where missing."""

    #: Shape (p + 1,): of the sensors, without their offsets, and of the ambient, K.
    temperatures: Array
    #: Shape (l + x,): factors of the loads, and positions, m.
    factors: Array
    #: Shape (c,): odometers, m.
    odometers: Array
    #: Shape (t,): powers, W.
    powers: Array
    #: Shape (axes,): displacements, m.
    displacements: Array


def split_sample(data: Precomputed, values: Sequence[float]) -> SampleValues:
    """Return the values of a sample by quantity.

    Parameters
    ----------
    data : Precomputed
        Of the observer.
    values : sequence of float
        As `channels.sample_channels`; it may end before the displacements.

    Raises
    ------
    InputError
        The number of values is wrong.
    """
    model, every = data.observer.model, len(data.channels)
    thermal, stood, counted, wanted = data.ends
    if len(values) not in (wanted, every):
        names = ", ".join(channel.name for channel in data.channels[:wanted])
        raise InputError(
            f"sample has {len(values)} values, expected {wanted}: {names}; or "
            f"{every}, with a displacement along {', '.join(model.axes)}"
        )
    given = np.full(every, np.nan)
    given[: len(values)] = values
    given[~np.isfinite(given)] = np.nan
    read = SampleValues(
        given[:thermal],
        given[thermal:stood],
        given[stood:counted],
        given[counted:wanted],
        given[wanted:],
    )
    read.temperatures[:-1] -= model.offset
    low, high = data.strokes
    if low.size:
        # A position outside the stroke counts as missing.
        place = read.factors[-low.size :]
        place[(place < low - OVERTRAVEL) | (place > high + OVERTRAVEL)] = np.nan
    farthest = data.observer.thresholds.farthest
    read.odometers[(read.odometers < 0.0) | (read.odometers > farthest)] = np.nan
    read.powers[np.abs(read.powers) > data.most_power] = np.nan
    return read


def cold_ambient(data: Precomputed, temperatures: Array, ambient: float) -> float:
    """Return an ambient if it can be that of the cold machine: see `JointAware.zero_of`."""
    low, high = possible_readings(data.calibrated_readings, data.observer.thresholds)
    rises = temperatures - ambient
    impossible = (rises < low[:-1]) | (rises > high[:-1])
    read = np.isfinite(rises)
    return math.nan if sensor_faults.majority_doubtful(impossible, read, False) else ambient
