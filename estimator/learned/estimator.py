"""Recursion of a learned model, corrected by occasional displacement readings.

For each displacement a small Kalman filter whose state is (zero, drift, weights):

    δ = zero + drift + Σ w_f φ_f.

The zero is constant, the drift decays within hours and takes up what no feature explains, and the
weights are the learned ones, with their covariance. Without readings only the features move δ,
which is therefore bounded by the measurements, however long the run. A reading corrects the
estimate immediately and, as readings agree, the model gradually.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimator.interface import READING_NOISE, Channel, Estimate, Status
from estimator.span import SLACK
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import column_named
from thermojoint.models.filters.relaxations import relaxed
from thermojoint.models.learned import FILE, LearnedModel, at_rest, signals

#: Size of the drift relative to the held-out errors, which come from hours next to those used for
#: learning, and its decay time, s.
DRIFT_SIZE = 2.0
DRIFT_TIME = 4.0 * 3600.0
#: Time after which the weights are as uncertain again as after learning, s.
MEMORY = 30.0 * 86400.0
#: A reading further from the estimate than this many standard deviations is refused; a second
#: agreeing reading means that the zero has shifted.
REFUSED = 4.0
#: A log that starts within this time after the end of the learning log continues it, s.
GOES_ON = 3600.0
#: An estimate is flagged where it leaves the log's range of displacements by more than this
#: fraction of it, on either side.
REACH = 0.5
WITHIN = 1.96
_UNITS = {"temperature": "K", "speed": "rad/s", "power": "W", "current": "A", "torque": "N m"}


@dataclass(frozen=True, eq=False, repr=False)
class Learned(Described):
    """A learned model with the common interface.

    Its state is (time of the last sample, start of the run, last values, relaxations; then for each
    displacement zero, drift, weights, the last refused innovation, and their covariance).

    Attributes
    ----------
    model : LearnedModel
        The model.
    reading_noise : float
        Standard deviation of a displacement reading, m.
    """

    model: LearnedModel
    reading_noise: float = READING_NOISE
    schema: str = FILE.schema

    def _facts(self) -> dict[str, str]:
        return {
            "axes": ", ".join(self.axes),
            "channels": ", ".join(f"{channel.name} in {channel.unit}" for channel in self.channels),
        }

    @property
    def kind(self) -> str:
        """``learned``, or the kind of baseline."""
        return self.model.kind

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Names of the displacements, as in the learning log."""
        return tuple(channel.name for channel in self.model.channels)

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Columns of the log in SI, then a reading of each displacement; NaN where missing."""
        return (
            *(Channel(name, _unit(name)) for name in self.model.columns),
            *(Channel(f"reading {name}", "m") for name in self.axes),
        )

    @property
    def details(self) -> tuple[Channel, ...]:
        """None."""
        return ()

    @cached_property
    def _prior(self) -> Array:
        """Covariance of (zero, drift, weights) of each displacement before any reading, m2."""
        size = 2 + len(self.model.features)
        prior = np.zeros((len(self.axes), size, size))
        for own, channel in zip(prior, self.model.channels, strict=True):
            own[0, 0], own[1, 1] = channel.drift**2, (DRIFT_SIZE * channel.drift) ** 2
            own[2:, 2:] = channel.covariance
        return prior

    def initial_state(self) -> Array:
        """Return the state before any sample."""
        inputs = len(self.model.columns) + len(self.model.features)
        means = [
            np.concatenate(([channel.zero, 0.0], channel.weights, [0.0]))
            for channel in self.model.channels
        ]
        start = np.full(2 + inputs, np.nan)
        return np.concatenate([start, *means, self._prior.ravel()])

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`.

        Parameters
        ----------
        state : ndarray
            What the sample before returned, or the initial state.
        time : float
            s; later than that of the sample before.
        values : sequence of float
            As in `channels`; NaN where missing. It may end before the displacement readings.
        """
        if not np.isfinite(time) or time <= state[0]:
            raise InputError(
                f"time {time:g} s does not come after {state[0]:g} s; drop or re-order the sample"
            )
        columns, features = len(self.model.columns), len(self.model.features)
        unread = [math.nan] * len(self.axes) if len(values) == columns else []
        told = np.array([*values, *unread], dtype=float)
        if told.shape != (columns + len(self.axes),) or np.isinf(told).any():
            raise InputError(
                f"{told.size} values, or one that is infinite; give {columns + len(self.axes)}, "
                "NaN where a reading is missing"
            )
        now, last = told[:columns], state[2 : 2 + columns]
        status = Status.READING_MISSING if np.isnan(now).any() else Status.OK
        fresh = np.isnan(state[0])
        now = np.where(np.isnan(now), self._middle if fresh else last, now)
        new = signals(self.model.features, self.model.columns, now)
        begun = time if fresh else float(state[1])
        end = self.model.log_end
        if not fresh:
            before = state[2 + columns : 2 + columns + features]
            low = self._relaxed(before, last, new, time - float(state[0]))
        elif end and 0.0 < time - end.time_s <= GOES_ON:
            low = self._relaxed(
                np.array(end.relaxations), np.array(end.values), new, time - end.time_s
            )
        else:
            low = np.where(self.model.taus > 0.0, at_rest(self.model.features, new), new)
        means, spread = self._filters(state)
        if not fresh:
            means, spread = self._forgotten(means, spread, time - float(state[0]))
        row = np.concatenate(([1.0, 1.0], low))
        refused = False
        for c, reading in enumerate(told[columns:]):
            if not np.isnan(reading):
                means[c], spread[c], wrong = self._corrected(
                    means[c], spread[c], row, float(reading), c
                )
                refused |= wrong
        if refused:
            status |= Status.READING_REFUSED
        estimate = means[:, :-1] @ row
        band = WITHIN * self._widening * np.sqrt(np.einsum("i,cij,j->c", row, spread, row))
        status |= self._status(now, estimate, time - begun)
        after = np.concatenate(([time, begun], now, low, means.ravel(), spread.ravel()))
        return after, Estimate(time, estimate, band, status, np.empty(0))

    def _relaxed(self, before: Array, last: Array, new: Array, dt: float) -> Array:
        old = signals(self.model.features, self.model.columns, last)
        return relaxed(before, old, new, dt, self.model.taus)

    @cached_property
    def _middle(self) -> Array:
        """Substitute for a reading that has never arrived: the middle of the log's range."""
        return np.array([0.5 * sum(self.model.spans[name]) for name in self.model.columns])

    @cached_property
    def _widening(self) -> Array:
        return np.array([channel.widening for channel in self.model.channels])

    def _filters(self, state: Array) -> tuple[Array, Array]:
        """Return means (axes, 3 + features), with the refused innovation last, and covariances."""
        size, axes = 2 + len(self.model.features), len(self.axes)
        first = 2 + len(self.model.columns) + len(self.model.features)
        split = first + axes * (size + 1)
        means = state[first:split].reshape(axes, size + 1)
        return means.copy(), state[split:].reshape(axes, size, size).copy()

    def _forgotten(self, means: Array, spread: Array, dt: float) -> tuple[Array, Array]:
        """Return the filters one interval later: each part relaxes towards its prior."""
        size = spread.shape[1]
        keep = np.full(size, np.exp(-dt / MEMORY))
        keep[0], keep[1] = 1.0, np.exp(-dt / DRIFT_TIME)
        means[:, 1] *= keep[1]
        both = np.outer(keep, keep)
        return means, both * spread + (1.0 - both) * self._prior

    def _corrected(
        self, mean: Array, spread: Array, row: Array, reading: float, c: int
    ) -> tuple[Array, Array, bool]:
        """Return one filter after a reading, and whether the reading was refused."""
        noise = self.reading_noise**2
        cross = spread @ row
        variance = float(row @ cross)
        innovation = reading - float(mean[:-1] @ row)
        limit = REFUSED * np.sqrt(self._widening[c] ** 2 * variance + noise)
        if abs(innovation) > limit:
            before = float(mean[-1])
            if not before or abs(innovation - before) > limit:
                return np.append(mean[:-1], innovation), spread, True
            # A second agreeing reading: the zero has shifted.
            spread = spread.copy()
            spread[0, 0] += innovation**2
            cross = spread @ row
            variance = float(row @ cross)
        gain = cross / (variance + noise)
        left = np.eye(len(gain)) - np.outer(gain, row)
        # Joseph's form stays symmetric and positive.
        after = left @ spread @ left.T + noise * np.outer(gain, gain)
        return np.append(mean[:-1] + gain * innovation, 0.0), 0.5 * (after + after.T), False

    def _status(self, now: Array, estimate: Array, elapsed: float) -> Status:
        status = Status.OK
        if elapsed > (1.0 + SLACK) * self.model.duration_s:
            status |= Status.BEYOND_TIME
        for name, value in zip(self.model.columns, now, strict=True):
            low, high = self.model.spans[name]
            slack = SLACK * (high - low)
            if not low - slack <= value <= high + slack:
                status |= (
                    Status.BEYOND_TEMPERATURE if name in self.model.sensors else Status.BEYOND_HEAT
                )
        for value, channel in zip(estimate, self.model.channels, strict=True):
            low, high = channel.span
            if not low - REACH * (high - low) <= value <= high + REACH * (high - low):
                status |= Status.BEYOND_DISPLACEMENT
        return status


def _unit(name: str) -> str:
    column = column_named(name)
    return _UNITS.get(column.quantity, "1") if column else "1"
