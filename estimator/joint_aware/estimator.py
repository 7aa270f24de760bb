"""Joint-aware estimator with the common interface: predict, gate, correct, solve, evaluate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from estimator import lines, sensor_faults
from estimator.interface import READING_NOISE, Channel, Estimate, Status
from estimator.joint_aware import (
    compiled_sample,
    displacement_readings,
    dropouts,
    fault_isolation,
    odometers,
)
from estimator.joint_aware.compiled_sample import Results, empty_results
from estimator.joint_aware.displacement_readings import (
    DisplacementProbe,
    ModelError,
    mean_of,
)
from estimator.joint_aware.innovation_gate import (
    GatedSample,
    channels_of,
    gate_readings,
    possible_heat,
    possible_readings,
)
from estimator.joint_aware.observer import Moment, Observer
from estimator.joint_aware.observer_model import SCHEMA, Kind, ObserverModel
from estimator.joint_aware.observer_state import (
    KNOWN,
    UNKNOWN,
    Layout,
    ObserverState,
    unpacked,
)
from estimator.joint_aware.thresholds import USUAL, Thresholds
from estimator.span import SLACK
from fesim.axes.line import line_over
from fesim.march.kernel import owned
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.units import MILLI
from thermojoint.reduced.physics import heat_step

#: Half-width of the 95 % interval, in standard deviations.
WIDTH = 1.96
#: Share by which travel that odometers have not reported may widen a band: as `Observer.unsettled`.
WIDENED = math.sqrt(2.0) - 1.0

#: Most samples processed at once; those after the first unusual one are processed again.
AT_ONCE = 1000

#: A position this far beyond the stroke, m, is still its end: a millimetre of overtravel.
OVERTRAVEL = MILLI

Names = tuple[str, ...]


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


class Processed(NamedTuple):
    """Result of processing a sample."""

    #: State after the sample.
    after: ObserverState
    #: Shape (axes,): before corrections by innovations and displacement readings, m.
    displacement: Array
    #: Knowledge of the joint's slips before the sample.
    slip_knowledge: float
    #: Shape (n, k): covariance factor in addition to the steady covariance, after the readings.
    covariance_factor: Array
    #: Shape (p + 1,): readings that were used.
    accepted: sensor_faults.Flags
    #: Whether a displacement reading was refused.
    refused: bool
    #: Sampling interval in steps of the model.
    often: int


@dataclass(frozen=True, eq=False, repr=False)
class JointAware(Described):
    """Observer of the machine's reduced physics and joint, corrected by the available readings.

    A channel that is NaN is ignored. `warm_state` is for a machine with an unknown past,
    `initial_state` for one at rest at ambient temperature.

    Attributes
    ----------
    model : ObserverModel
        Model of the machine and the filter.
    reading_noise : float
        Standard deviation of a displacement reading, m.
    thresholds : Thresholds
        Thresholds of faults, jumps and the calibrated range.
    """

    model: ObserverModel
    reading_noise: float = READING_NOISE
    thresholds: Thresholds = USUAL
    schema: str = SCHEMA

    def _facts(self) -> dict[str, str]:
        return {
            "axes": ", ".join(self.axes),
            "channels": ", ".join(f"{channel.name} in {channel.unit}" for channel in self.channels),
        }

    @property
    def kind(self) -> Kind:
        """Name of the kind."""
        return self.model.kind

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        return self.model.axes

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Sensors and the ambient, relative to the ambient of the cold machine, K.

        Then factors of the loads that change, the positions of moving axes, m, their odometers, m,
        and powers of sources, W. Displacement readings come last, m; a sample may end before them.
        """
        return (
            *(Channel(name, "K") for name in (*self.model.sensors, "ambient")),
            *(Channel(name, "1") for name in self.model.loads),
            *(Channel(name, "m") for name in (*self.model.positions, *self.model.ways)),
            *(Channel(name, "W") for name in self.model.powers),
            *(Channel(f"displacement_{axis}", "m") for axis in self.axes),
        )

    @property
    def details(self) -> tuple[Channel, ...]:
        """Heat of every source, the ambient, and the lowest and highest pressure in the joints.

        With moving axes also, for each displacement whose line a control is given: that line, and
        the displacement at the present position and at the positions asked for. With several, the
        lines of every displacement along each of them too, the others at their present positions.
        """
        along = [axis.name for axis in self.model.moving_axes]
        asked = [axis.asked for axis in self.model.moving_axes]
        return (
            *(Channel(f"heat_{name}", "W") for name in self.model.sources),
            *(Channel(f"held_{name}", "K") for name in self.model.surfaces),
            Channel("ambient", "K"),
            Channel("lowest_pressure", "Pa"),
            Channel("highest_pressure", "Pa"),
            *(
                one
                for axis, k in self.model.sloped.items()
                for one in (
                    *lines.channels_of(axis),
                    *lines.channels_here(axis),
                    *lines.channels_at(axis, asked[k]),
                )
            ),
            *(
                Channel(f"{axis}_{name}_{moving}", unit)
                for axis in self.axes
                for moving in along
                if len(along) > 1
                for name, unit in lines.ALONG
            ),
        )

    @property
    def probe(self) -> DisplacementProbe:
        """Properties of its displacement readings."""
        return replace(self.thresholds.probe, noise=self.reading_noise)

    @cached_property
    def forgetting(self) -> Array:
        """Decay rates of displacement readings (`displacement_readings.forgetting`), 1/s."""
        return displacement_readings.forgetting(self.model.band, self.thresholds.probe)

    @cached_property
    def observer(self) -> Observer:
        """The recursion from sample to sample."""
        return Observer(self.model, self.thresholds)

    @cached_property
    def parts(self) -> Layout:
        """Slices of the parts of the state."""
        return self._state(self.observer.known_start, KNOWN).layout

    @cached_property
    def _cold_drives(self) -> Array:
        """Temperatures (d,) of the axes' drives at the start, K."""
        drives = self.model.modes.drives
        return np.zeros(0) if drives is None else drives.cold

    def _place(self, loads: Array) -> Array:
        """Positions of the axes, (x,), m, from the loads (l,) of a sample."""
        return loads[loads.size - len(self.model.moving_axes) :]

    @property
    def _nothing_read(self) -> ModelError:
        """The model error before any displacement reading."""
        return displacement_readings.unknown(sum(self.model.band.shared), len(self.axes))

    @cached_property
    def calibrated_readings(self) -> tuple[Array, Array]:
        """Calibrated range of every channel, K."""
        known = self.model.calibrated.temperatures
        low, high = np.array([known[name] for name in self.model.sensors]).T
        slack = np.maximum(SLACK * (high - low), 3.0 * np.sqrt(self.model.filter.noise[:-1]))
        offset = self.model.offset
        return (
            np.append(low - slack - offset, -self.thresholds.ambient),
            np.append(high + slack - offset, self.thresholds.ambient),
        )

    def zero_of(self, temperatures: Array, ambient: float) -> float:
        """Return an ambient if it can be that of the cold machine, else NaN.

        Relative to a faulty reading of the ambient, most sensors have impossible values.

        Parameters
        ----------
        temperatures : ndarray, shape (p,)
            Of the sensors, NaN where missing.
        ambient : float
            Relative to the same zero, K.
        """
        low, high = possible_readings(self.calibrated_readings, self.thresholds)
        rises = temperatures - ambient
        impossible = (rises < low[:-1]) | (rises > high[:-1])
        read = np.isfinite(rises)
        return math.nan if sensor_faults.majority_doubtful(impossible, read, False) else ambient

    def initial_state(self) -> Array:
        """Return the state of a machine at rest, before any sample."""
        return self._state(self.observer.known_start, KNOWN).flat()

    def warm_state(self) -> Array:
        """Return the state of a machine with an unknown past, before any sample."""
        return self._state(self.observer.unknown_start, UNKNOWN).flat()

    def _state(self, factor: Array, slip_knowledge: float) -> ObserverState:
        """State before any sample with a covariance factor (n + p + 1, k)."""
        unseen, modes, size = np.array(np.nan), self.model.modes, self.observer.system.size
        start = np.zeros(size)
        start[size - self.model.first.size - 1 : -1] = self.model.first
        if slip_knowledge == KNOWN:
            start[: modes.start.size] = modes.start
        return ObserverState(
            time=unseen,
            begun=unseen,
            slip_knowledge=np.array(slip_knowledge),
            linear=start,
            loads=modes.factors,
            **self.observer.physics.at_rest()._asdict(),
            covariance_factor=factor,
            errors=np.zeros(len(self.observer.rows)),
            drive=self._cold_drives,
            odometer=np.full(len(self.model.ways), np.nan),
            power_heat=np.zeros(len(self.model.powers)),
            watch=sensor_faults.new_watch(len(self.observer.system.rows), self.thresholds.faults),
            model_error=self._nothing_read,
            pending=fault_isolation.none(size),
            steps=np.array(0.0),
            odometer_age=np.zeros(len(self.model.ways)),
            away=np.zeros(2 * len(self.model.ways)),
            back=np.zeros(2 * len(self.model.ways)),
        )

    @cached_property
    def _readable(self) -> sensor_faults.Channels:
        """Properties of the temperature readings."""
        return channels_of(self.observer, self.calibrated_readings)

    @cached_property
    def _compiled(self) -> compiled_sample.Place | None:
        """Data for ordinary samples in compiled code; None where it does not apply."""
        model, observer = self.model, self.observer
        kernel = observer.physics.kernel
        if kernel is None:
            return None
        relaxing = 1.0 / (1.0 + model.step * model.discrepancy.rates)
        own = compiled_sample.Filter(
            relaxing=np.tile(relaxing, (model.power.size, 1)),
            power=model.power,
            rows=np.ascontiguousarray(observer.system.rows),
            gain=np.ascontiguousarray(observer.steady_gain),
            discrepancy=np.ascontiguousarray(model.discrepancy.displacement),
            channels=self._readable,
            rules=self.thresholds.faults,
            possible=self._possible,
            forgetting=self.forgetting,
        )
        return compiled_sample.place_of(own, heat_step(model.modes, model.step), kernel)

    @property
    def _possible(self) -> compiled_sample.Possible:
        """Data to explain innovations by changes of heat since the last step."""
        onset, most, slack = possible_heat(self.observer, 1)
        covariance = self.observer.innovation_covariance(self.observer.known_start)
        found = fault_isolation.explaining_heat(onset, covariance)
        return compiled_sample.Possible(*map(owned, (onset, found, most, slack, covariance)))

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`.

        Parameters
        ----------
        state : ndarray
            After the previous sample; it is not modified.
        time : float
            s, later than that of the previous sample.
        values : sequence of float
            As `channels`; NaN where a reading is missing.

        Raises
        ------
        InputError
            Time does not increase, or the number of values is wrong.
        ConvergenceError
            No equilibrium of the joint is found at these temperatures.
        """
        flat, processed, read = self._process(state, time, values)
        return flat, self._estimate(processed, time, read)

    def _process(
        self, state: Array, time: float, values: Sequence[float]
    ) -> tuple[Array, Processed, SampleValues]:
        """State after a sample, the result of processing it, and its values."""
        read = self.split(values)
        readings, factors, counts, powers, probed = read
        if powers.size:
            state = self._with_powers(state, powers)
        flat = state.copy()
        after = unpacked(flat, self.parts)
        moment = self._moment(float(after.time), time)
        # A missing factor keeps its last value.
        now = after.loads[: factors.size]
        now[:] = np.where(np.isnan(factors), now, factors)
        counted, unread = after.odometer.copy(), np.isnan(counts)
        after.odometer[:] = np.where(unread, counted, counts)
        since = after.odometer_age + moment.length * moment.steps
        after.odometer_age[:] = np.where(unread, since, 0.0)
        if unread.any():
            least = np.abs(
                self._place(after.loads) - self._place(unpacked(state, self.parts).loads)
            )
            after.odometer[unread] += least[list(self.model.counted)][unread]
        processed = self._process_ordinary(after, moment, readings, probed)
        if processed is None:
            before = unpacked(state, self.parts)
            before = before._replace(odometer=after.odometer, odometer_age=after.odometer_age)
            travel, travelled = after.odometer - counted, np.zeros(len(self.model.moving_axes))
            plausible = odometers.plausible(travel, since, self.thresholds.fastest)
            travelled[list(self.model.counted)] = np.where(plausible & ~unread, travel, 0.0)
            before = odometers.after_reset(before, ~unread & ~plausible)
            moment = replace(moment, loads=after.loads, travelled=travelled)
            processed = self._process_any(before, moment, readings, probed)
            flat = processed.after.flat()
        if np.isnan(powers).any():
            self._attribute_to_missing_powers(np.isnan(powers), state, flat)
        return flat, processed, read

    @cached_property
    def unreported_travel(self) -> dropouts.Dropouts | None:
        """Uncertainty due to unreported travel, m; None without odometers or known speeds."""
        known = self.model.ways and self.model.calibrated.speeds
        return dropouts.unreported_travel(self.observer) if known else None

    def _dropout_times(
        self, before: ObserverState, elapsed: float, whole: bool
    ) -> tuple[Array, Array]:
        """`odometers.dropout_times`; the table is made at the first dropout."""
        missing = before.away.any() or before.odometer_age.any()
        if not missing or (travel := self.unreported_travel) is None:
            return np.zeros_like(before.away), np.zeros_like(before.away)
        longest = travel.back[-1] * self.model.step
        return odometers.dropout_times(before, elapsed, whole, longest)

    def _due_to_unreported_travel(self, after: ObserverState) -> Array:
        """Half-width (axes,) due to travel that odometers have not reported, m."""
        if not after.away.any() or (travel := self.unreported_travel) is None:
            return np.zeros(len(self.axes))
        return odometers.half_width(travel, after, self.model.step)

    def _with_powers(self, state: Array, powers: Array) -> Array:
        """The state with its heat changed by the powers (t,), W, since the previous sample.

        The thermometers correct it as usual, for errors of a share and for heat that is not part of
        any power.
        """
        flat = state.copy()
        own, dynamic = unpacked(flat, self.parts), self.observer.system.decay.size
        for k, (source, share) in enumerate(self.model.power_shares.items()):
            if np.isnan(powers[k]):
                continue
            heat, at = share * powers[k], self.model.sources.index(source)
            change = heat - own.power_heat[k]
            own.linear[dynamic + at] += change
            if np.isfinite(own.pending.channel):
                own.pending.linear[dynamic + at] += change
            own.power_heat[k] = heat
        return flat

    def _attribute_to_missing_powers(self, unread: Flags, before: Array, flat: Array) -> None:
        """Attribute heat found by thermometers in a sample to missing powers (t,), in place.

        It would be counted twice otherwise when a power is read again.
        """
        after, dynamic = unpacked(flat, self.parts), self.observer.system.decay.size
        found = after.linear - unpacked(before, self.parts).linear
        at = [dynamic + self.model.sources.index(source) for source in self.model.power_shares]
        after.power_heat[unread] += found[at][unread]

    @cached_property
    def most_power(self) -> Array:
        """Largest plausible power, of either sign, W, shape (t,)."""
        most = self.thresholds.implausible_heat * self.model.calibrated.heat * self.model.power
        shares = self.model.power_shares
        own = [most[self.model.sources.index(one)] / share for one, share in shares.items()]
        return np.array(own)

    def displacements(self, samples: Array) -> Array:
        """Return the displacements in a run from rest without their bands, (n, axes), m.

        They equal those of `estimator.interface.follow` at the present position (`lines.here`).

        Parameters
        ----------
        samples : ndarray, shape (n, 1 + channels)
            Times, s, and the values of the channels.

        Raises
        ------
        InputError, ConvergenceError
            As `sample`.
        """
        results = self.results(samples)
        return results.displacement + self.observer.displacement_by(results.means)

    def results(self, samples: Array) -> Results:
        """Return the results of a run from rest without displacement readings.

        Parameters
        ----------
        samples : ndarray, shape (n, 1 + channels)
            Times, s, and the values of the channels.

        Raises
        ------
        InputError, ConvergenceError
            As `sample`.
        """
        results = empty_results(len(samples), self._sizes)
        for at, _, found in self._stretches(samples, self.initial_state()):
            now = found if isinstance(found, Results) else self._results_of(found[0])
            for whole, part in zip(results, now, strict=True):
                whole[at] = part
        return results

    @property
    def _sizes(self) -> tuple[int, int, int]:
        """Numbers of displacements, relaxations and mean innovations of a sample."""
        relaxations = self.observer.system.decay.size - self.model.modes.rates.size
        return len(self.axes), relaxations, 3 * len(self.observer.system.rows)

    def _results_of(self, processed: Processed) -> Results:
        """Results of a sample that was processed alone."""
        count, dynamic = self.model.modes.rates.size, self.observer.system.decay.size
        relaxed, means = processed.after.linear[count:dynamic], processed.after.watch.means
        return Results(processed.displacement, relaxed, means)

    def whole_run(self, samples: Array, state: Array) -> tuple[Array, Array]:
        """Return displacements and half-widths of their bands in a run, (n, axes), m.

        They equal those of `estimator.interface.follow` up to rounding; ordinary samples are
        processed many at a time.

        Parameters
        ----------
        samples : ndarray, shape (n, 1 + channels)
            Times, s, and the values of the channels.
        state : ndarray
            Before the first of them.

        Raises
        ------
        InputError, ConvergenceError
            As `sample`.
        """
        moved, bands = np.empty((2, len(samples), len(self.axes)))
        for at, after, found in self._stretches(samples, state):
            if isinstance(found, Results):
                moved[at] = found.displacement + self.observer.displacement_by(found.means)
                bands[at] = self._bands(after, found)
            else:
                processed, read = found
                estimate = self._estimate(processed, float(samples[at.start, 0]), read)
                moved[at], bands[at] = estimate.displacement, estimate.band
        return moved, bands

    def _stretches(
        self, samples: Array, state: Array
    ) -> Iterator[tuple[slice, Array, Results | tuple[Processed, SampleValues]]]:
        """Yield the indices of samples, the state after them, and their results.

        Consecutive ordinary samples are one stretch; any other sample is processed alone.
        """
        readings, k = self._readings_of(samples, state), 0
        while k < len(samples):
            time, *values = samples[k].tolist()
            state, processed, read = self._process(state, time, values)
            yield slice(k, k + 1), state, (processed, read)
            k += 1
            # Where a start or a gap still has an effect, no sample is usual.
            unsettled = processed.covariance_factor.any()
            if readings is not None and not unsettled and k < len(samples):
                state, results = self._run(state, samples[k:, 0], readings[k:])
                at = slice(k, k + len(results.displacement))
                yield at, state, results
                k = at.stop

    def _readings_of(self, samples: Array, state: Array) -> Array | None:
        """Readings of samples (n, 1 + channels), (n, p + 1), K; None if they cannot be usual.

        Usual ones are a step apart, of a machine without loads, axes and displacement readings.
        """
        thermal, step = len(self.observer.system.rows), self.model.step
        told = mean_of(unpacked(state, self.parts).model_error).any()
        if self._compiled is None or told or samples.shape[1] != 1 + thermal:
            return None
        if (np.abs(np.diff(samples[:, 0]) - step) > 1e-6 * step).any():
            return None
        return np.asarray(samples[:, 1:] - np.append(self.model.offset, 0.0))

    def _run(self, state: Array, times: Array, readings: Array) -> tuple[Array, Results]:
        """State before the first unusual one of samples (n,), and the results of those before."""
        assert self._compiled is not None
        count = min(len(times), AT_ONCE)
        while True:
            after, results = state.copy(), empty_results(count, self._sizes)
            now = times[:count].copy(), self.model.step, readings[:count], results
            own = unpacked(after, self.parts)
            usual = compiled_sample.ordinary_samples(self._compiled, own, *now)
            if usual == count:
                if count:
                    own.steps[()] = 1.0
                return after, results
            # The first other sample has made the state invalid.
            count = usual

    def _bands(self, state: Array, results: Results) -> Array:
        """Half-widths of the bands (n, axes), m, of ordinary samples; `state` is after the last."""
        last = unpacked(state, self.parts)
        parts = self.observer.model_error(
            results.relaxed, float(last.slip_knowledge), results.means
        )
        return self.half_band(parts, last.model_error, last.covariance_factor)

    def _known(self, processed: Processed, parts: Array) -> Array:
        """Model error estimated from innovations and displacement readings, (axes,), m."""
        after = processed.after
        by_readings = parts @ mean_of(after.model_error)
        return np.asarray(by_readings + self.observer.displacement_by(after.watch.means))

    def _error_parts(self, processed: Processed) -> Array:
        """The model error per part (`Observer.model_error`)."""
        results, after = self._results_of(processed), processed.after
        known, since = processed.slip_knowledge, float(after.time - after.begun)
        return self.observer.model_error(results.relaxed, known, results.means, since)

    def _process_ordinary(
        self, state: ObserverState, moment: Moment, readings: Array, probed: Array
    ) -> Processed | None:
        """Process an ordinary sample in compiled code, in place; None if it is not one."""
        if self._compiled is None or moment.steps != 1 or moment.length != self.model.step:
            return None
        if not np.isnan(probed).all():
            return None
        results, times = empty_results(1, self._sizes), np.array([moment.time])
        if not compiled_sample.ordinary_samples(
            self._compiled, state, times, moment.length, readings[None], results
        ):
            return None
        state.steps[()] = 1.0
        slip_knowledge, everything = float(state.slip_knowledge), np.ones(readings.size, dtype=bool)
        moved = results.displacement[0]
        return Processed(
            state, moved, slip_knowledge, state.covariance_factor, everything, False, 1
        )

    def _process_any(
        self,
        before: ObserverState,
        moment: Moment,
        readings: Array,
        probed: Array,
    ) -> Processed:
        """Process any sample."""
        loads = moment.loads
        prediction = self.observer.predict(before, moment)
        used = gate_readings(self.observer, before, prediction, moment, readings, self._readable)
        (linear, errors), factor = self._corrected(used, moment, readings)
        prediction = used.prediction
        settled = self.observer.equilibrium(prediction, linear, loads)
        elapsed = moment.length * moment.steps
        begun = before.begun if moment.steps else np.array(moment.time)
        away, back = self._dropout_times(before, elapsed, bool(used.accepted.all()))
        known = displacement_readings.later(before.model_error, elapsed, self.forgetting)
        refused = False
        if np.isfinite(probed).any():
            means = used.watch.means
            since = moment.time - float(begun)
            parts = self.observer.model_error(
                settled.relaxed, prediction.slip_knowledge, means, since
            )
            apart = probed - settled.displacement - self.observer.displacement_by(means)
            correction = self._corrected_by_probe(apart, parts, factor, known)
            size, factor = linear.size, correction.covariance_factor
            linear, errors = linear + correction.state[:size], errors + correction.state[size:]
            known, refused = correction.known, correction.refused
            settled = self.observer.equilibrium(prediction, linear, loads)
        after = ObserverState(
            time=np.array(moment.time),
            begun=begun,
            slip_knowledge=np.array(
                self.observer.slip_knowledge_after(prediction.slip_knowledge, factor)
            ),
            linear=linear,
            loads=loads,
            **settled.joint._asdict(),
            covariance_factor=factor,
            errors=errors,
            drive=prediction.drive,
            odometer=before.odometer,
            power_heat=before.power_heat,
            watch=used.watch,
            model_error=known,
            pending=used.pending,
            steps=np.array(float(moment.steps)),
            odometer_age=before.odometer_age,
            away=away,
            back=back,
        )
        moved = settled.displacement
        # One long interval is a gap; two in a row are the sampling interval.
        often = min(moment.steps, int(before.steps) or moment.steps)
        return Processed(
            after, moved, prediction.slip_knowledge, factor, used.accepted, refused, often
        )

    def _estimate(self, processed: Processed, time: float, read: SampleValues) -> Estimate:
        """The estimate after a sample."""
        readings = read.temperatures
        others = np.concatenate([read.factors, read.odometers, read.powers])
        after, factor = processed.after, processed.covariance_factor
        parts = self._error_parts(processed)
        inputs = after.linear[self.observer.system.decay.size :]
        pressure = after.pressure if after.pressure.size else np.array([np.nan])
        missing, distrusted = self._left_out(readings, processed.accepted)
        given = self.channels[readings.size :][: others.size]
        unread = zip(given, np.isnan(others), strict=True)
        missing += tuple(channel.name for channel, gone in unread if gone)
        status = self._beyond(time - float(after.begun), inputs, readings, processed.accepted)
        usual, left = self._variances(parts, after.model_error, factor)
        travel = self._due_to_unreported_travel(after)
        unsettled = self.observer.unsettled(left, usual, processed.often)
        if travel.any():
            unsettled |= bool((travel > WIDENED * WIDTH * np.sqrt(usual)).any())
        for holds, flag in (
            (missing, Status.READING_MISSING),
            (distrusted, Status.SENSOR_DISTRUSTED),
            (processed.refused, Status.READING_REFUSED),
            (unsettled, Status.UNSETTLED),
            ((missing or distrusted) and self._lost(after, time), Status.READINGS_LOST),
        ):
            if holds:
                status |= flag
        known = self._known(processed, parts)
        band = np.asarray(WIDTH * np.sqrt(usual + left)) + self._undecided(after) + travel
        moved, line = processed.displacement + known, np.empty(0)
        if self.model.moving_axes:
            moved, line = self._lines(processed, known, band)
        return Estimate(
            time=time,
            displacement=moved,
            band=band,
            status=status,
            details=np.concatenate([inputs, [pressure.min(), pressure.max()], line]),
            missing=missing,
            distrusted=distrusted,
        )

    def _lines(self, processed: Processed, known: Array, band: Array) -> tuple[Array, Array]:
        """Displacement (axes,) and details of lines; `known` is the estimated model error, m.

        The displacement is K0 where a control is given the line, else that at the present position.
        The band (axes,) holds at every position, and so bounds the error of a slope by its ends.
        """
        asked = self._asked(processed, known)
        along = [
            line_over(axis.asked, own, axis.reference)
            for axis, own in zip(self.model.moving_axes, asked, strict=True)
        ]
        here, details = processed.displacement + known, list[float]()
        moved = here.copy()
        for axis, stroke in self.model.strokes.items():
            c, k = self.axes.index(axis), self.model.sloped[axis]
            moved[c], half = along[k].offset[c], float(band[c])
            details += [along[k].slope[c], 2.0 * half / (stroke.high - stroke.low)]
            details += [*(np.array(stroke) / MILLI), here[c], half, *asked[k][:, c].tolist()]
        if len(along) > 1:
            each = [np.stack([line.offset, line.slope], axis=1) for line in along]
            details += np.stack(each, axis=1).ravel().tolist()
        return moved, np.array(details)

    def _asked(self, processed: Processed, known: Array) -> list[Array]:
        """Displacements (k, axes), m, along each moving axis, the others at their positions."""
        after, moving, places = processed.after, self.model.moving_axes, list[Array]()
        for k, axis in enumerate(moving):
            places.append(np.tile(self._place(after.loads), (axis.asked.size, 1)))
            places[k][:, k] = axis.asked
        every = np.vstack(places)
        asked = known + self.observer.seen_from(after, processed.slip_knowledge, every)
        ends = np.cumsum([axis.asked.size for axis in moving])[:-1]
        return np.split(asked, ends)

    def _lost(self, after: ObserverState, time: float) -> bool:
        """Whether every thermometer has been missing or distrusted for too long."""
        count = len(self.model.sensors)
        read = np.where(after.watch.distrusted > 0.0, np.nan, after.watch.read)[:count]
        last = np.fmax.reduce(read, initial=float(after.begun))
        return bool(time - last > self.thresholds.lost)

    def split(self, values: Sequence[float]) -> SampleValues:
        """Return the values of a sample by quantity.

        Parameters
        ----------
        values : sequence of float
            As `channels`; it may end before the displacements.

        Raises
        ------
        InputError
            The number of values is wrong.
        """
        thermal = len(self.observer.system.rows)
        stood = thermal + len(self.model.loads) + len(self.model.positions)
        counted = stood + len(self.model.ways)
        wanted = counted + len(self.model.powers)
        if len(values) not in (wanted, len(self.channels)):
            names = ", ".join(channel.name for channel in self.channels[:wanted])
            raise InputError(
                f"sample has {len(values)} values, expected {wanted}: {names}; or "
                f"{len(self.channels)}, with a displacement along {', '.join(self.axes)}"
            )
        given = np.full(len(self.channels), np.nan)
        given[: len(values)] = values
        given[~np.isfinite(given)] = np.nan
        given[: thermal - 1] -= self.model.offset
        if self.model.modes.way is not None:
            # A position outside the stroke counts as missing.
            ends = [one[[0, -1]] for one in self.model.modes.way.stations.positions]
            low, high = np.array(ends).T
            place = given[stood - len(ends) : stood]
            place[(place < low - OVERTRAVEL) | (place > high + OVERTRAVEL)] = np.nan
        gone, powers = given[stood:counted], given[counted:wanted]
        gone[(gone < 0.0) | (gone > self.thresholds.farthest)] = np.nan
        powers[np.abs(powers) > self.most_power] = np.nan
        others = np.split(given[thermal:], np.array([stood, counted, wanted]) - thermal)
        return SampleValues(given[:thermal], *others)

    def _moment(self, last: float, time: float) -> Moment:
        """Time of a sample relative to the last one (s)."""
        if not math.isfinite(time):
            raise InputError(f"time {time:g} s is not a time; drop the sample")
        if math.isnan(last):
            return Moment(time, 0.0, 0)
        if not time > last:
            raise InputError(
                f"time {time:g} s does not come after {last:g} s; drop or re-order the sample"
            )
        # An interval of one step, up to rounding, is one step.
        steps = max(1, math.ceil((time - last) / self.model.step - 1e-6))
        steps = min(steps, self.thresholds.most_steps)
        length = (time - last) / steps
        near = abs(length - self.model.step) <= 1e-6 * self.model.step
        return Moment(time, self.model.step if near else length, steps)

    def _corrected(
        self, used: GatedSample, moment: Moment, readings: Array
    ) -> tuple[tuple[Array, Array], Array]:
        """The linear state, the errors, and their covariance factor after the used readings."""
        at, prediction = np.flatnonzero(used.accepted), used.prediction
        size = self.observer.system.size
        length = moment.length if moment.steps else self.model.step
        gain, factor = self.observer.gain(
            at, prediction.covariance_factor, length, prediction.slip_knowledge
        )
        moved = gain @ (readings - self.observer.readings(prediction))[at]
        return (prediction.linear + moved[:size], prediction.errors + moved[size:]), factor

    def _corrected_by_probe(
        self, apart: Array, parts: Array, factor: Array, known: ModelError
    ) -> displacement_readings.Correction:
        """Correction by a displacement reading that is `apart` from the model, (axes,), m."""
        innovation = apart - parts @ mean_of(known)
        return displacement_readings.correct_by(
            innovation, self.probe, self.model.band, parts, factor, known
        )

    def _left_out(self, readings: Array, accepted: sensor_faults.Flags) -> tuple[Names, Names]:
        """Missing channels, and channels that are present but excluded."""
        if accepted.all():
            return (), ()
        names = [channel.name for channel in self.channels[: readings.size]]
        empty = np.isnan(readings)
        return (
            tuple(name for name, gone in zip(names, empty, strict=True) if gone),
            tuple(name for name, bad in zip(names, ~empty & ~accepted, strict=True) if bad),
        )

    def half_band(self, parts: Array, known: ModelError, factor: Array) -> Array:
        """Half-width of the 95 % interval, m, shape (..., axes).

        Parameters
        ----------
        parts : ndarray, shape (..., axes, d + axes)
            Model error per part, m (`Observer.model_error`).
        known : ModelError
            Its estimate from displacement readings.
        factor : ndarray, shape (n + p + 1, k)
            Covariance factor.
        """
        usual, left = self._variances(parts, known, factor)
        return np.asarray(WIDTH * np.sqrt(usual + left))

    def _variances(self, parts: Array, known: ModelError, factor: Array) -> tuple[Array, Array]:
        """Variance of the displacement (..., axes), m2, and that of a start or a gap (axes,)."""
        # E var(e) E', of which only the diagonal is needed, in every sample.
        shared = ((parts @ known.shared) * parts).sum(axis=-1)
        own = np.square(parts[..., known.shared_mean.size :]) @ known.variance
        left = np.zeros(len(self.axes))
        if factor.any():
            fields = factor[: self.observer.system.size]
            uncertain = np.square(self.model.band.tangent @ fields).sum(axis=1)
            left = self.thresholds.doubt**2 * uncertain
        return np.asarray(self.model.band.steady + shared + own), np.asarray(left)

    def _undecided(self, after: ObserverState) -> Array:
        """Effect of a pending jump, m, shape (axes,): the band covers both causes."""
        if not np.isfinite(after.pending.channel):
            return np.zeros(len(self.axes))
        return np.abs(self.model.band.tangent @ (after.linear - after.pending.linear))

    def _beyond(
        self, elapsed: float, inputs: Array, readings: Array, accepted: sensor_faults.Flags
    ) -> Status:
        """Status bits for values outside the calibrated range."""
        known, status = self.model.calibrated, Status.OK
        if elapsed > (1.0 + SLACK) * known.duration_s:
            status |= Status.BEYOND_TIME
        heat = inputs[: self.model.power.size] / self.model.power
        if heat.max() > (1.0 + SLACK) * known.heat or heat.min() < -SLACK * known.heat:
            status |= Status.BEYOND_HEAT
        if np.abs(heat).max() > self.thresholds.implausible_heat * known.heat:
            status |= Status.READINGS_LOST
        low, high = self.calibrated_readings
        if (accepted & ((readings < low) | (readings > high))).any():
            status |= Status.BEYOND_TEMPERATURE
        return status
