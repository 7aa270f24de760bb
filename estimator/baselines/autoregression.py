"""Free-running ARX estimator: past estimates replace past displacements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from estimator.baselines.regression import CHANNELS
from estimator.baselines.samples import Clock, advanced
from estimator.interface import Channel, Estimate, Status
from estimator.span import Settling, status_of
from thermojoint.artefacts.arrays import Array
from thermojoint.models.baselines import FILE, Baselines
from thermojoint.models.sensors import JOINT_SENSORS, ROLES

#: Of what was this many of the slowest time constants ago nothing is left, not even in rounding.
_FORGOTTEN = 50.0
#: A sample closer to an autoregression step than this, relative to the interval, counts as on it.
_AT_STEP = 1e-6


class State(NamedTuple):
    """State after a sample."""

    #: Time of the sample, and start of the run.
    clock: Clock
    #: Number of autoregression steps done.
    steps: int
    #: Shape (channels,): of the sample, K.
    temperatures: Array
    #: Shape (axes, order): past estimates, newest first, m.
    past: Array
    #: Shape (lags, channels): temperatures at past steps, newest first, K.
    seen: Array
    #: Time up to which the estimate is unsettled, s; NaN if it never was.
    until: float


def _flat(state: State) -> Array:
    """Return a state as one array."""
    clock, steps, temperatures, past, seen, until = state
    return np.concatenate((clock, [steps], temperatures, past.ravel(), seen.ravel(), [until]))


@dataclass(frozen=True, eq=False)
class AutoregressionEstimator:
    """Steps at a fixed interval from the start of the run; samples may come at any time.

    Temperatures are interpolated linearly. Between two steps the estimate is interpolated linearly
    towards the next step, computed with the present temperatures. Its state is `State`.
    """

    #: The file's content: autoregressions of the same orders, and the interval of their steps.
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
        return _flat(
            State(
                Clock(),
                steps=0,
                temperatures=np.zeros(len(CHANNELS)),
                past=np.zeros_like(self._past),
                seen=np.zeros_like(self._inputs[0]),
                until=math.nan,
            )
        )

    @cached_property
    def _remembered(self) -> int:
        """Number of steps on which an estimate depends."""
        lags = self._past.shape[1] + len(self._inputs[0])
        return lags + math.ceil(_FORGOTTEN * self.settling.slowest / self.model.interval_s)

    @cached_property
    def settling(self) -> Settling:
        """Duration of being unsettled after a start on a warm machine: by its slowest root."""
        roots = [np.abs(np.roots([1.0, *(-own)])).max(initial=0.0) for own in self._past]
        slowest = -self.model.interval_s / math.log(max(*roots, 1e-9))
        return Settling(self.model.span, JOINT_SENSORS, slowest, self.model.interval_s)

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`."""
        last, done, old, past, seen, until = self._state_in(state)
        clock, dt = advanced(last, time, values, CHANNELS, self.model.interval_s)
        new, elapsed = np.asarray(values, dtype=float), time - clock.begun
        steps = elapsed / self.model.interval_s
        # After a long gap, or where a clock is set, most steps would be forgotten in the end.
        done = max(done, math.floor(steps) - self._remembered)
        while done + 1 <= steps + _AT_STEP:
            done += 1
            share = 1.0 - (steps - done) * self.model.interval_s / dt
            past, seen = self._stepped(past, seen, old + min(share, 1.0) * (new - old))
        part = max(steps - done, 0.0)
        ahead = self._stepped(past, seen, new)[0][:, 0] if part > _AT_STEP else past[:, 0]
        displacement = past[:, 0] + part * (ahead - past[:, 0])
        named = dict(zip(ROLES, values, strict=True))
        status = status_of(self.model.span, elapsed, named)
        until = self.settling.until(last.time, until, time, named)
        if time < until:
            status |= Status.UNSETTLED
        band = np.full(len(self.axes), np.nan)
        after = _flat(State(clock, done, new, past, seen, until))
        return after, Estimate(time, displacement, band, status, np.empty(0))

    def _state_in(self, array: Array) -> State:
        """Return the state in an array of `_flat`."""
        begin = len(Clock()) + 1
        middle = begin + len(CHANNELS)
        end = middle + self._past.size
        return State(
            Clock(*array[: begin - 1].tolist()),
            int(array[begin - 1]),
            array[begin:middle],
            array[middle:end].reshape(self._past.shape),
            array[end:-1].reshape(self._inputs.shape[1:]),
            float(array[-1]),
        )

    def _stepped(self, past: Array, seen: Array, now: Array) -> tuple[Array, Array]:
        """Return past estimates and temperatures, newest first, one step later."""
        seen = np.vstack((now[None], seen[:-1]))
        estimate = (self._past * past).sum(axis=1) + (self._inputs * seen).sum(axis=(1, 2))
        return np.column_stack((estimate, past[:, :-1])), seen
