"""No compensation: the estimate is always zero."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from estimator.interface import Channel, Estimate, Status
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Nothing:
    """Zero at every sample; the state is the time of the last sample.

    Attributes
    ----------
    axes : tuple of str
        Of the displacement.
    """

    axes: tuple[str, ...]
    kind: Literal["none"] = "none"
    channels: tuple[Channel, ...] = ()
    details: tuple[Channel, ...] = ()

    def initial_state(self) -> Array:
        """Return the state before any sample."""
        return np.array([np.nan])

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`."""
        if not math.isfinite(time) or time <= state[0]:
            raise InputError(f"sample at t = {time:g} s: time does not increase; drop the sample")
        nothing = np.zeros(len(self.axes))
        band = np.full(len(self.axes), np.nan)
        return np.array([time]), Estimate(time, nothing, band, Status.OK, np.empty(0))
