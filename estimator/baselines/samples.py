"""Clock of a run and validation of samples for the baselines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from estimator.interface import Channel
from thermojoint.artefacts.errors import InputError


class Clock(NamedTuple):
    """First two entries of the states of baselines; NaN before the first sample."""

    #: Time of the last sample, s.
    time: float = math.nan
    #: Start of the run, s.
    begun: float = math.nan


def advanced(
    clock: Clock, time: float, values: Sequence[float], channels: Sequence[Channel], lead: float
) -> tuple[Clock, float]:
    """Return the clock after a sample, and the interval that ends at the sample, s.

    Parameters
    ----------
    clock : Clock
        Before the sample.
    time, values
        Time (s) and values of the sample.
    channels : sequence of Channel
        Channels of a sample.
    lead : float
        The machine is at rest until this long before the first sample, s.

    Raises
    ------
    InputError
        Time does not increase, or a value is missing or not finite.
    """
    fresh = math.isnan(clock.time)
    dt = lead if fresh else time - clock.time
    if not 0.0 < dt < math.inf or not math.isfinite(time):
        raise InputError(
            f"sample at t = {time:.15g} s: time does not increase (the last was at "
            f"{clock.time:.15g} s); drop or re-order the sample"
        )
    if len(values) != len(channels) or not all(map(math.isfinite, values)):
        names = ", ".join(channel.name for channel in channels)
        raise InputError(
            f"sample at t = {time:.15g} s: give {names} as finite numbers, or leave the sample out"
        )
    return Clock(time, time - lead if fresh else clock.begun), dt
