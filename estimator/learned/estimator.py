"""Recursion of a learned model, corrected by occasional displacement readings.

For each displacement a small Kalman filter whose state is (zero, drift, weights):

    δ = zero + drift + Σ w_f φ_f.

Along an axis the state has the same for the slope, and a reading at p observes K0 + (p - P0) slope.

The zero is constant, the drift decays within hours and absorbs what no feature explains, and the
weights are the learned ones, with their covariance. Without readings δ changes with the features
only, and is therefore bounded by the measurements, however long the run. A reading corrects the
estimate immediately, and consistent readings gradually correct the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import compress

import numpy as np

from estimator import lines
from estimator.intake import axis_name
from estimator.interface import READING_NOISE, Channel, Estimate, Status, facts_of
from estimator.learned.state import DRIFT, WEIGHTS, ZERO, State, cut, flat, state_in, width_of
from estimator.learned.unread import Unread, at_start, later
from estimator.span import SLACK, with_slack
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import column_named
from thermojoint.models.filters.relaxations import relaxed
from thermojoint.models.learned import FILE, LearnedModel, at_rest

_UNITS = {
    "temperature": "K",
    "speed": "rad/s",
    "feed": "m/s",
    "power": "W",
    "current": "A",
    "torque": "N m",
    "length": "m",
}


@dataclass(frozen=True)
class Following:
    """Settings for the correction by displacement readings, and for flags.

    The band's cover and the use of readings were measured on held-out days of a logged machine
    (``python -m benchmarks.measured_machine``, docs/measured-machines.md).
    """

    #: Size of the drift relative to the held-out errors, which come from hours next to those used
    #: for learning.
    drift_size: float = 2.0
    #: Decay time of the drift, s.
    drift_time: float = 4.0 * 3600.0
    #: Time after which the weights are as uncertain again as after learning, s.
    memory: float = 30.0 * 86400.0
    #: A reading further from the estimate than this many standard deviations is refused; a second
    #: agreeing reading means that the zero has shifted.
    refused: float = 4.0
    #: A log that starts within this time after the end of the learning log continues it, s.
    goes_on: float = 3600.0
    #: An estimate is flagged where it leaves the log's range of displacements by more than this
    #: fraction of it, on either side.
    reach: float = 0.5
    #: Half-width of the band, 95 %, in standard deviations.
    within: float = 1.96
    #: After a longer interval without a sample, s, the past is as unknown as in a new run. Logs are
    #: learned from with an interval of an hour at most.
    pause: float = 7200.0
    #: Time constant with which a missing temperature may leave its last value, s
    #: (`estimator.learned.unread`).
    wanders: float = 1800.0
    #: An estimate is unsettled where missing readings or an unknown past may have moved a
    #: displacement by more than this fraction of its change by all readings over the range of the
    #: log; beyond the second fraction, while readings are missing, it is bad.
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
        Settings for readings and flags.
    """

    model: LearnedModel
    reading_noise: float = READING_NOISE
    following: Following = Following()
    schema: str = FILE.schema

    def _facts(self) -> dict[str, str]:
        return facts_of(self)

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
        """Columns of the log in SI, positions, displacement readings, positions of the readings.

        NaN where missing; a reading without its own position was made at the present one.
        """
        positions = self.model.positions
        return (
            *(Channel(name, _unit(name)) for name in (*self.model.columns, *positions)),
            *(
                Channel(f"reading {name}", "m", occasional=True)
                for name in (*self.axes, *positions)
            ),
        )

    @property
    def details(self) -> tuple[Channel, ...]:
        """Line and displacement at the present position, for displacements along an axis."""
        return tuple(
            one
            for channel in self.model.channels
            if channel.slope and (axis := axis_name(channel.name))
            for one in (*lines.channels_of(axis), *lines.channels_here(axis))
        )

    @cached_property
    def _prior(self) -> Array:
        """Covariance of (zero, drift, weights) of each displacement before any reading, m2."""
        half, size = 2 + len(self.model.features), width_of(self.model)
        prior = np.zeros((len(self.axes), size, size))
        for own, channel in zip(prior, self.model.channels, strict=True):
            index, drifts = list(range(2, half)), [channel.drift]
            if channel.slope:
                index += [half + ZERO, *range(half + 2, size)]
                drifts.append(channel.slope.drift)
            own[np.ix_(index, index)] = channel.covariance
            for first, drift in zip((0, half), drifts, strict=False):
                own[first + ZERO, first + ZERO] += drift**2
                own[first + DRIFT, first + DRIFT] = (self.following.drift_size * drift) ** 2
        return prior

    def _learned(self) -> Array:
        """Zero, drift and weights of each displacement, and of its slope, as learned."""
        mean = np.zeros((len(self.axes), width_of(self.model)))
        half = 2 + len(self.model.features)
        for own, channel in zip(mean, self.model.channels, strict=True):
            own[:half] = channel.zero, 0.0, *channel.weights
            if channel.slope:
                own[half:] = channel.slope.zero, 0.0, *channel.slope.weights
        return mean

    def _levers(self, positions: Array) -> Array:
        """Distance of each displacement from its P0, m; 0 without a slope. Positions (p,), m."""
        at = dict(zip(self.model.positions, positions.tolist(), strict=True))
        slopes = [channel.slope for channel in self.model.channels]
        return np.array([at[one.position] - one.reference if one else 0.0 for one in slopes])

    def initial_state(self) -> Array:
        """Return the state before any sample."""
        model = self.model
        return flat(
            State(
                time=np.nan,
                begun=np.nan,
                values=np.full(len(model.columns), np.nan),
                relaxations=np.full(len(model.features), np.nan),
                mean=self._learned(),
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
            As in `channels`; NaN where missing. It may end before the positions, the displacement
            readings, or where they were read.
        """
        last = self._continued(state_in(state, self.model), time)
        if not np.isfinite(time) or time <= last.time:
            raise InputError(
                f"time {time:.15g} s does not come after {last.time:.15g} s; drop or re-order the "
                "sample"
            )
        places = len(self.model.positions)
        parts = np.cumsum([len(self.model.columns), places, len(self.axes), places])
        unread = parts[-1] - len(values) if len(values) in parts else 0
        sample = np.array([*values, *[math.nan] * unread], dtype=float)
        if sample.shape != (parts[-1],) or np.isinf(sample).any():
            raise InputError(
                f"{len(values)} values, or one that is infinite; give {parts[-1]}, "
                "NaN where a reading is missing"
            )
        now, here, readings, there = cut(sample, parts[:-1])
        lowest, highest = self._possible
        now = np.where((now > lowest) & (now < highest), now, np.nan)
        missing = np.isnan(now)
        now = np.where(missing, self._middle if last.fresh else last.values, now)
        low = self._relaxations(last, time, now)
        last = last._replace(unread=self._unread(last, time, now, missing))
        if not last.fresh:
            last = self._forgotten(last, time - last.time)
        row = np.concatenate(([1.0, 1.0], low))
        status = Status.OK
        if not np.isnan(readings).all():
            at = self._levers(np.where(np.isnan(there), here, there))
            status = self._corrected(last, row, readings, at)
        at_p0 = self._shares(1.0, np.zeros(len(self.axes)))
        estimate, band, unknown = self._seen(last, row, at_p0)
        details = self._details(last, row, self._levers(here))
        begun = time if np.isnan(last.begun) else last.begun
        status |= self._status(now, estimate, time - begun)
        status |= self._status_unread(last, missing, unknown)
        after = last._replace(time=time, begun=begun, values=now, relaxations=low)
        names = tuple(compress(self.model.columns, missing))
        return flat(after), Estimate(time, estimate, band + unknown, status, details, names)

    def _corrected(self, state: State, row: Array, readings: Array, levers: Array) -> Status:
        """Correct the filters by readings (axes,), m, in place; return the status bits."""
        status, shares = Status.OK, self._shares(1.0, levers)
        unknown = self._seen(state, row, shares)[2]
        for c in np.flatnonzero(~np.isnan(readings)):
            noise = self.reading_noise**2 + unknown[c] ** 2
            own = np.outer(shares[c], row).ravel()
            # A reading along an axis cannot be used without its position.
            if np.isnan(levers[c]) or self._correct(state, int(c), own, float(readings[c]), noise):
                status |= Status.READING_REFUSED
        return status

    def _shares(self, k0: float, levers: Array) -> Array:
        """Shares of K0 and of slope (m) that make up a displacement, shape (axes, 1 or 2)."""
        whole = np.stack((np.full_like(levers, k0), levers), axis=1)
        return whole if self.model.positions else whole[:, :1]

    def _seen(self, state: State, row: Array, shares: Array) -> tuple[Array, Array, Array]:
        """Value, band and bound on unknown errors, for shares of K0 and slope; each (axes,)."""
        filters = np.einsum("cp,cpi->ci", shares, state.mean.reshape(*shares.shape, len(row)))
        rows = (shares[:, :, None] * row).reshape(state.mean.shape)
        variance = np.einsum("ci,cij,cj->c", rows, state.covariance, rows)
        band = self.following.within * self._widening * np.sqrt(variance)
        return filters @ row, band, np.abs(filters[:, WEIGHTS]) @ state.unread.relaxed

    def _details(self, state: State, row: Array, levers: Array) -> Array:
        """Values of `details`."""
        if not self.model.positions:
            return np.empty(0)
        one = self._shares(0.0, np.ones_like(levers))
        slope, slope_band, slope_unknown = self._seen(state, row, one)
        here, band, unknown = self._seen(state, row, self._shares(1.0, levers))
        return np.array(
            [
                value
                for c, channel in enumerate(self.model.channels)
                if channel.slope
                for value in (
                    slope[c],
                    slope_band[c] + slope_unknown[c],
                    1e3 * channel.slope.reference,
                    *(1e3 * end for end in channel.slope.stroke),
                    here[c],
                    band[c] + unknown[c],
                )
            ]
        )

    def _continued(self, last: State, time: float) -> State:
        """The state before a sample: that at the log's end where a run continues the log."""
        end = self.model.log_end
        if last.fresh and end and 0.0 < time - end.time_s <= self.following.goes_on:
            values, relaxations = np.array(end.values), np.array(end.relaxations)
            return last._replace(time=end.time_s, values=values, relaxations=relaxations)
        return last

    def _unread(self, last: State, time: float, now: Array, missing: Flags) -> Unread:
        """Bounds on unknown errors at a sample."""
        if last.fresh or time - last.time > self.following.pause:
            return at_start(self.model, now, missing)
        return later(self.model, last.unread, missing, time - last.time, self.following.wanders)

    def _status_unread(self, last: State, missing: Flags, unknown: Array) -> Status:
        """Status bits for missing readings and an unknown past."""
        status = Status.READING_MISSING if missing.any() else Status.OK
        k0 = last.mean[:, : 2 + len(self.model.features)]
        whole = np.abs(k0[:, WEIGHTS]) @ self.model.signal_ranges
        if (unknown > self.following.unsettled * whole).any():
            status |= Status.UNSETTLED
        if missing.any() and (unknown > self.following.lost * whole).any():
            status |= Status.READINGS_LOST
        return status

    def _relaxations(self, last: State, time: float, now: Array) -> Array:
        """Relaxations of the features at `time`, s, with values now: (n,)."""
        model = self.model
        old, new = model.signals(np.array([last.values, now]))
        if last.fresh:
            return np.where(model.taus > 0.0, at_rest(model.features, new), new)
        return relaxed(last.relaxations, old, new, time - last.time, model.taus)

    @cached_property
    def limits(self) -> list[tuple[float, float]]:
        """Lower and upper limit of each column in the range of the log, SI."""
        model = self.model
        return [
            with_slack(span) if name in model.sensors else _limits_of_heat(span)
            for name, span in ((name, model.spans[name]) for name in model.columns)
        ]

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
        half = 2 + len(self.model.features)
        keep = np.full(state.mean.shape[1], np.exp(-dt / self.following.memory))
        keep[ZERO::half], keep[DRIFT::half] = 1.0, np.exp(-dt / self.following.drift_time)
        mean, both = state.mean.copy(), np.outer(keep, keep)
        mean[:, DRIFT::half] *= keep[DRIFT]
        covariance = both * state.covariance + (1.0 - both) * self._prior
        return state._replace(mean=mean, covariance=covariance)

    def _correct(self, state: State, c: int, row: Array, reading: float, noise: float) -> bool:
        """Correct filter c by a reading, m, in place; return whether it was refused.

        `noise` is the reading's variance, m2, including that of unknown errors at this moment.
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
        for name, value, (low, high) in zip(self.model.columns, now, self.limits, strict=True):
            if not low <= value <= high:
                status |= (
                    Status.BEYOND_TEMPERATURE if name in self.model.sensors else Status.BEYOND_HEAT
                )
        for value, channel in zip(estimate, self.model.channels, strict=True):
            low, high = self.following.reached(channel.span)
            if not low <= value <= high:
                status |= Status.BEYOND_DISPLACEMENT
        return status


def _limits_of_heat(span: tuple[float, float]) -> tuple[float, float]:
    """Limits of a speed or power, which heats by its magnitude, by its range in the log."""
    low, high = span
    if not low <= 0.0 <= high:
        return with_slack(span)
    _, most = with_slack((0.0, max(-low, high)))
    return -most, most


def _unit(name: str) -> str:
    column = column_named(name)
    return _UNITS.get(column.quantity, "1") if column else "1"
