"""Free-running ARX estimator: past estimates replace past displacements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from estimator.baselines.regression import CHANNELS
from estimator.baselines.samples import began
from estimator.interface import Channel, Estimate, Status
from estimator.span import Settling, status_of
from thermojoint.artefacts.arrays import Array
from thermojoint.models.baselines import FILE, Baselines
from thermojoint.models.sensors import JOINT_SENSORS, ROLES

#: A sample closer to an autoregression step than this, relative to the interval, counts as on it.
_AT_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class AutoregressionEstimator:
    """Steps at a fixed interval from the start of the run; samples may come at any time.

    Temperatures are interpolated linearly. Between two steps the estimate is interpolated linearly
    towards the next step, computed with the present temperatures. The state is (time of the last
    sample, start of the run, steps done, last temperatures, past estimates, past temperatures, the
    time up to which it is unsettled).

    Attributes
    ----------
    model : Baselines
        The file's content: autoregressions of the same orders, and the interval of their steps.
    """

    model: Baselines
    kind: Literal["arx"] = "arx"
    channels: tuple[Channel, ...] = CHANNELS
    details: tuple[Channel, ...] = ()
    schema: str = FILE.schema

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        return tuple(self.model.arx)

    @cached_property
    def _past(self) -> Array:
        """Weights of past estimates, shape (axes, order)."""
        return np.array([regression.past for regression in self.model.arx.values()])

    @cached_property
    def _inputs(self) -> Array:
        """Weights of temperatures, shape (axes, lags, channels)."""
        return np.array([regression.inputs for regression in self.model.arx.values()])

    def initial_state(self) -> Array:
        """Return the state of a machine at rest at ambient temperature, before any sample."""
        size = len(CHANNELS) + self._past.size + self._inputs[0].size
        return np.concatenate(([np.nan] * 2, [0.0], np.zeros(size), [np.nan]))

    @cached_property
    def settling(self) -> Settling:
        """How long it is unsettled after a start on a warm machine: by its slowest root."""
        roots = [np.abs(np.roots([1.0, *(-own)])).max(initial=0.0) for own in self._past]
        slowest = -self.model.interval_s / math.log(max(*roots, 1e-9))
        return Settling(self.model.span, JOINT_SENSORS, slowest, self.model.interval_s)

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`."""
        begun, dt = began(state, time, values, CHANNELS, self.model.interval_s)
        done = int(state[2])
        width = len(CHANNELS)
        last, past, seen = np.split(state[3:-1], [width, width + self._past.size])
        past, seen = past.reshape(self._past.shape), seen.reshape(self._inputs.shape[1:])
        new = np.asarray(values, dtype=float)
        steps = (time - begun) / self.model.interval_s
        while done + 1 <= steps + _AT_STEP:
            done += 1
            share = 1.0 - (steps - done) * self.model.interval_s / dt
            past, seen = self._stepped(past, seen, last + min(share, 1.0) * (new - last))
        part = max(steps - done, 0.0)
        ahead = self._stepped(past, seen, new)[0][:, 0] if part > _AT_STEP else past[:, 0]
        displacement = past[:, 0] + part * (ahead - past[:, 0])
        named = dict(zip(ROLES, values, strict=True))
        status = status_of(self.model.span, time - begun, named)
        until = self.settling.until(state, time, named)
        if time < until:
            status |= Status.UNSETTLED
        band = np.full(len(self.axes), np.nan)
        inner = np.concatenate(([time, begun, done], new, past.ravel(), seen.ravel(), [until]))
        return inner, Estimate(time, displacement, band, status, np.empty(0))

    def _stepped(self, past: Array, seen: Array, now: Array) -> tuple[Array, Array]:
        """Return past estimates and temperatures, newest first, one step later."""
        seen = np.vstack((now[None], seen[:-1]))
        estimate = (self._past * past).sum(axis=1) + (self._inputs * seen).sum(axis=(1, 2))
        return np.column_stack((estimate, past[:, :-1])), seen
