"""Validation of samples for the baselines."""

from __future__ import annotations

import math
from collections.abc import Sequence

from estimator.interface import Channel
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError


def began(
    state: Array, time: float, values: Sequence[float], channels: Sequence[Channel], lead: float
) -> tuple[float, float]:
    """Return the start of the run and the interval that ends at this sample, s.

    Parameters
    ----------
    state : ndarray
        Its first two entries are the time of the last sample and the start of the run, NaN before
        the first sample.
    time, values
        Of the sample.
    channels : sequence of Channel
        The channels of a sample.
    lead : float
        The machine is at rest until this long before the first sample, s.

    Raises
    ------
    InputError
        Time does not increase, or a value is missing or not finite.
    """
    fresh = math.isnan(state[0])
    dt = lead if fresh else time - float(state[0])
    if not 0.0 < dt < math.inf or not math.isfinite(time):
        raise InputError(
            f"sample at t = {time:g} s: time does not increase (the last was at {state[0]:g} s); "
            "drop or re-order the sample"
        )
    if len(values) != len(channels) or not all(map(math.isfinite, values)):
        names = ", ".join(channel.name for channel in channels)
        raise InputError(
            f"sample at t = {time:g} s: give {names} as finite numbers, or leave the sample out"
        )
    return (time - lead if fresh else float(state[1])), dt
