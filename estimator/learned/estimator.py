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
from estimator.learned.state import DRIFT, WEIGHTS, ZERO, State, flat, state_in
from estimator.learned.unread import Unread, at_start, later
from estimator.span import SLACK, with_slack
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import column_named
from thermojoint.models.filters.relaxations import relaxed
from thermojoint.models.learned import FILE, LearnedModel, at_rest, signals

_UNITS = {
    "temperature": "K",
    "speed": "rad/s",
    "feed": "m/s",
    "power": "W",
    "current": "A",
    "torque": "N m",
}


@dataclass(frozen=True)
class Following:
    """Rules for following displacement readings, and for flags.

    The band's cover and the use of readings were measured on held-out days of a logged machine
    (``python -m benchmarks.measured_machine``, docs/measured-machines.md).

    Attributes
    ----------
    drift_size : float
        Size of the drift relative to the held-out errors, which come from hours next to those used
        for learning.
    drift_time : float
        Decay time of the drift, s.
    memory : float
        Time after which the weights are as uncertain again as after learning, s.
    refused : float
        A reading further from the estimate than this many standard deviations is refused; a second
        agreeing reading means that the zero has shifted.
    goes_on : float
        A log that starts within this time after the end of the learning log continues it, s.
    reach : float
        An estimate is flagged where it leaves the log's range of displacements by more than this
        fraction of it, on either side.
    within : float
        Half-width of the band, 95 %, in standard deviations.
    pause : float
        After a longer interval without a sample, s, the past is as unknown as in a new run. Logs
        are learned from with an interval of an hour at most.
    wanders : float
        Time constant with which a missing temperature may leave its last value, s
        (`estimator.learned.unread`).
    unsettled, lost : float
        An estimate is unsettled where missing readings or an unknown past may have moved a
        displacement by more than this fraction of what all readings together move it over the range
        of the log; beyond the second one, while readings are missing, it is bad.
    """

    drift_size: float = 2.0
    drift_time: float = 4.0 * 3600.0
    memory: float = 30.0 * 86400.0
    refused: float = 4.0
    goes_on: float = 3600.0
    reach: float = 0.5
    within: float = 1.96
    pause: float = 7200.0
    wanders: float = 1800.0
    unsettled: float = 0.1
    lost: float = 0.5

    def reached(self, span: tuple[float, float]) -> tuple[float, float]:
        """Return the limits of an estimate for a log's range of displacements, m."""
        low, high = span
        return low - self.reach * (high - low), high + self.reach * (high - low)


@dataclass(frozen=True, eq=False, repr=False)
class Learned(Described):
    """A learned model with the common interface.

    Its state is `estimator.learned.state.State`.

    Attributes
    ----------
    model : LearnedModel
        The model.
    reading_noise : float
        Standard deviation of a displacement reading, m.
    following : Following
        How readings are followed.
    """

    model: LearnedModel
    reading_noise: float = READING_NOISE
    following: Following = Following()
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
            own[ZERO, ZERO] = channel.drift**2
            own[DRIFT, DRIFT] = (self.following.drift_size * channel.drift) ** 2
            own[WEIGHTS, WEIGHTS] = channel.covariance
        return prior

    def initial_state(self) -> Array:
        """Return the state before any sample."""
        model = self.model
        return flat(
            State(
                time=np.nan,
                begun=np.nan,
                values=np.full(len(model.columns), np.nan),
                relaxations=np.full(len(model.features), np.nan),
                mean=np.array([(c.zero, 0.0, *c.weights) for c in model.channels]),
                refused=np.zeros(len(model.channels)),
                covariance=self._prior,
                unread=Unread(*np.zeros((2, len(model.features)))),
            )
        )

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`.

        Parameters
        ----------
        state : ndarray
            State after the previous sample, or the initial state.
        time : float
            s; later than that of the previous sample.
        values : sequence of float
            As in `channels`; NaN where missing. It may end before the displacement readings.
        """
        last = state_in(state, self.model)
        if not np.isfinite(time) or time <= last.time:
            raise InputError(
                f"time {time:g} s does not come after {last.time:g} s; drop or re-order the sample"
            )
        columns = len(self.model.columns)
        unread = [math.nan] * len(self.axes) if len(values) == columns else []
        sample = np.array([*values, *unread], dtype=float)
        if sample.shape != (columns + len(self.axes),) or np.isinf(sample).any():
            raise InputError(
                f"{sample.size} values, or one that is infinite; give {columns + len(self.axes)}, "
                "NaN where a reading is missing"
            )
        now, readings = sample[:columns], sample[columns:]
        lowest, highest = self._possible
        now = np.where((now > lowest) & (now < highest), now, np.nan)
        missing = np.isnan(now)
        now = np.where(missing, self._middle if last.fresh else last.values, now)
        low = self._relaxations(last, time, now)
        last = last._replace(unread=self._unread(last, time, now, missing))
        if not last.fresh:
            last = self._forgotten(last, time - last.time)
        row = np.concatenate(([1.0, 1.0], low))
        unknown = np.abs(last.mean[:, WEIGHTS]) @ last.unread.relaxed
        status = Status.OK
        for c in np.flatnonzero(~np.isnan(readings)):
            noise = self.reading_noise**2 + unknown[c] ** 2
            if self._correct(last, int(c), row, float(readings[c]), noise):
                status |= Status.READING_REFUSED
        estimate = last.mean @ row
        variance = np.einsum("i,cij,j->c", row, last.covariance, row)
        band = self.following.within * self._widening * np.sqrt(variance)
        begun = time if last.fresh else last.begun
        status |= self._status(now, estimate, time - begun)
        status |= self._status_unread(last, missing, unknown)
        after = last._replace(time=time, begun=begun, values=now, relaxations=low)
        return flat(after), Estimate(
            time, estimate, band + unknown, status, np.empty(0), self._names(missing)
        )

    def _names(self, missing: Flags) -> tuple[str, ...]:
        return tuple(
            name for name, gone in zip(self.model.columns, missing.tolist(), strict=True) if gone
        )

    def _before(self, last: State, time: float) -> float:
        """Time of the sample before, s; the log's end if it is continued, NaN in a new run."""
        end = self.model.log_end
        if last.fresh and end and 0.0 < time - end.time_s <= self.following.goes_on:
            return end.time_s
        return last.time

    def _unread(self, last: State, time: float, now: Array, missing: Flags) -> Unread:
        """Bounds on what is not known, at a sample."""
        before = self._before(last, time)
        if np.isnan(before) or time - before > self.following.pause:
            return at_start(self.model, now, missing)
        return later(self.model, last.unread, missing, time - before, self.following.wanders)

    def _status_unread(self, last: State, missing: Flags, unknown: Array) -> Status:
        """Status bits for missing readings and an unknown past."""
        status = Status.READING_MISSING if missing.any() else Status.OK
        whole = np.abs(last.mean[:, WEIGHTS]) @ self.model.signal_ranges
        if (unknown > self.following.unsettled * whole).any():
            status |= Status.UNSETTLED
        if missing.any() and (unknown > self.following.lost * whole).any():
            status |= Status.READINGS_LOST
        return status

    def _relaxations(self, last: State, time: float, now: Array) -> Array:
        """Relaxations of the features at `time`, s, with values now: (n,)."""
        model, end = self.model, self.model.log_end
        new, before = signals(model.features, model.columns, now), self._before(last, time)
        if np.isnan(before):
            return np.where(model.taus > 0.0, at_rest(model.features, new), new)
        begun, values = last.relaxations, last.values
        if last.fresh and end:
            begun, values = np.array(end.relaxations), np.array(end.values)
        old = signals(model.features, model.columns, values)
        return relaxed(begun, old, new, time - before, model.taus)

    @cached_property
    def _possible(self) -> Array:
        """Lower and upper limits of the readings, shape (2, columns); SI."""
        return np.array(self.model.possible).T

    @cached_property
    def _middle(self) -> Array:
        """Substitute for a reading that has never arrived: the middle of the log's range."""
        return np.array([0.5 * sum(self.model.spans[name]) for name in self.model.columns])

    @cached_property
    def _widening(self) -> Array:
        return np.array([channel.widening for channel in self.model.channels])

    def _forgotten(self, state: State, dt: float) -> State:
        """Return the filters one interval later: each part relaxes towards its prior."""
        keep = np.full(state.mean.shape[1], np.exp(-dt / self.following.memory))
        keep[ZERO], keep[DRIFT] = 1.0, np.exp(-dt / self.following.drift_time)
        mean, both = state.mean.copy(), np.outer(keep, keep)
        mean[:, DRIFT] *= keep[DRIFT]
        covariance = both * state.covariance + (1.0 - both) * self._prior
        return state._replace(mean=mean, covariance=covariance)

    def _correct(self, state: State, c: int, row: Array, reading: float, noise: float) -> bool:
        """Correct filter c by a reading, m, in place; return whether it was refused.

        `noise` is the reading's variance, m2, with that of what is not known at this moment.
        """
        mean, spread = state.mean[c], state.covariance[c]
        cross = spread @ row
        variance = float(row @ cross)
        innovation = reading - float(mean @ row)
        limit = self.following.refused * np.sqrt(self._widening[c] ** 2 * variance + noise)
        if abs(innovation) > limit:
            before = float(state.refused[c])
            if not before or abs(innovation - before) > limit:
                state.refused[c] = innovation
                return True
            # A second agreeing reading: the zero has shifted.
            spread[ZERO, ZERO] += innovation**2
            cross = spread @ row
            variance = float(row @ cross)
        gain = cross / (variance + noise)
        left = np.eye(len(gain)) - np.outer(gain, row)
        # Joseph's form stays symmetric and positive.
        after = left @ spread @ left.T + noise * np.outer(gain, gain)
        mean += gain * innovation
        spread[:] = 0.5 * (after + after.T)
        state.refused[c] = 0.0
        return False

    def _status(self, now: Array, estimate: Array, elapsed: float) -> Status:
        status = Status.OK
        if elapsed > (1.0 + SLACK) * self.model.duration_s:
            status |= Status.BEYOND_TIME
        for name, value in zip(self.model.columns, now, strict=True):
            low, high = with_slack(self.model.spans[name])
            if not low <= value <= high:
                status |= (
                    Status.BEYOND_TEMPERATURE if name in self.model.sensors else Status.BEYOND_HEAT
                )
        for value, channel in zip(estimate, self.model.channels, strict=True):
            low, high = self.following.reached(channel.span)
            if not low <= value <= high:
                status |= Status.BEYOND_DISPLACEMENT
        return status


def _unit(name: str) -> str:
    column = column_named(name)
    return _UNITS.get(column.quantity, "1") if column else "1"
