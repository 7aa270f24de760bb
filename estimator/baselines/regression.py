"""Regressions on temperatures and their low-passes (multiple linear, ridge)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from estimator.baselines.samples import Clock, advanced
from estimator.interface import Channel, Estimate, Status
from estimator.span import Settling, status_of
from thermojoint.artefacts.arrays import Array
from thermojoint.models.baselines import FILE, Baselines, Regression, taus_of
from thermojoint.models.filters.relaxations import relaxed
from thermojoint.models.sensors import JOINT_SENSORS, ROLES

#: Temperature rises of the four sensors above the current ambient.
CHANNELS = tuple(Channel(role, "K") for role in ROLES)


@dataclass(frozen=True, eq=False)
class RegressionEstimator:
    """δ as a weighted sum of temperatures and of their low-passes.

    Its state is a `Clock`, the features (last temperatures and their low-passes), and the time up
    to which it is unsettled, s.
    """

    #: ``mlr`` or ``ridge``.
    kind: Literal["mlr", "ridge"]
    #: The file's content.
    model: Baselines
    #: The machine is at rest until this long before the first sample, s.
    dt_s: float
    channels: tuple[Channel, ...] = CHANNELS
    details: tuple[Channel, ...] = ()
    schema: str = FILE.schema

    @property
    def regression(self) -> Regression:
        """The regression of this kind."""
        return self.model.mlr if self.kind == "mlr" else self.model.ridge

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        return tuple(self.regression.weights)

    @cached_property
    def _taus(self) -> Array:
        return taus_of(self.regression.time_constants, len(CHANNELS))

    @cached_property
    def _of(self) -> NDArray[np.int64]:
        """Channel of every feature."""
        return np.arange(len(self._taus)) % len(CHANNELS)

    @cached_property
    def _weights(self) -> Array:
        """Shape (axes, features)."""
        return np.array(list(self.regression.weights.values()))

    def initial_state(self) -> Array:
        """Return the state of a machine at rest at ambient temperature, before any sample."""
        return np.concatenate((Clock(), np.zeros(len(self._taus)), [np.nan]))

    @cached_property
    def settling(self) -> Settling:
        """Duration of being unsettled after a start on a warm machine; none without low-passes."""
        slowest = max(self.regression.time_constants, default=0.0)
        return Settling(self.model.span, JOINT_SENSORS, slowest, self.dt_s)

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`."""
        head = len(Clock())
        last, features, until = Clock(*state[:head].tolist()), state[head:-1], state[-1:].copy()
        clock, dt = advanced(last, time, values, CHANNELS, self.dt_s)
        new = np.asarray(values, dtype=float)
        features = relaxed(features, features[self._of], new[self._of], dt, self._taus)
        named = dict(zip(ROLES, values, strict=True))
        status = status_of(self.model.span, time - clock.begun, named)
        until[0] = self.settling.until(last.time, until[0], time, named)
        if time < until[0]:
            status |= Status.UNSETTLED
        band = np.full(len(self.axes), np.nan)
        return np.concatenate((clock, features, until)), Estimate(
            time, self._weights @ features, band, status, np.empty(0)
        )
