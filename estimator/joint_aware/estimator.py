"""The joint-aware estimator behind the common interface: predict, correct, settle, read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from artefacts.arrays import Array
from artefacts.errors import InputError
from estimator.interface import Channel, Estimate, Status
from estimator.joint_aware.filter_design import LinearSystem, compressed, correct, linear_system
from estimator.joint_aware.observer_model import ObserverModel
from estimator.joint_aware.observer_state import (
    FOLLOWED,
    KNOWN,
    UNKNOWN,
    ObserverState,
    shapes,
    unpacked,
)
from estimator.joint_aware.physics import (
    JointState,
    Physics,
    conduct,
    make_physics,
    settle_joint,
)

#: A value is beyond what was calibrated if it is so by more than this part of the calibrated range.
SLACK = 0.05
#: Steps between two samples at most; after a longer silence they are longer.
MOST_STEPS = 2000
#: Excess columns that tell the readings less than this part of their noise are nothing any more.
FORGOTTEN = 1e-3
#: The joint is followed from when the displacement is known to this, m.
FOLLOWABLE = 1e-6
#: No machine is hotter or colder than this, K from the ambient: it is no temperature.
LARGEST = 1e4
#: Half a band of 95 % in standard deviations.
WIDTH = 1.96


@dataclass(frozen=True, eq=False)
class JointAware:
    """The machine's reduced physics with its joint, corrected by whatever temperatures come.

    A channel that is NaN is left out of its sample. `warm_state` starts on a machine of whose past
    nothing is known, `initial_state` on one at rest at the ambient temperature.

    Attributes
    ----------
    model : ObserverModel
        All it runs on.
    """

    model: ObserverModel
    kind: Literal["joint-aware"] = "joint-aware"

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        return self.model.axes

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Sensors and the ambient, all above the ambient at which the machine was cold, K."""
        return tuple(Channel(name, "K") for name in (*self.model.sensors, "ambient"))

    @property
    def details(self) -> tuple[Channel, ...]:
        """Heat of every source, the ambient, and the lowest and highest pressure in the joints."""
        return (
            *(Channel(f"heat_{name}", "W") for name in self.model.sources),
            Channel("ambient", "K"),
            Channel("lowest_pressure", "Pa"),
            Channel("highest_pressure", "Pa"),
        )

    @cached_property
    def physics(self) -> Physics:
        """The machine that is marched."""
        return make_physics(self.model.modes, self.model.joints, self.model.held)

    @cached_property
    def system(self) -> LinearSystem:
        """Its linear part over one step of the filter."""
        model = self.model
        return linear_system(model.modes, model.remainder, model.power, model.step)

    @cached_property
    def parts(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the state."""
        columns = self.model.warm.shape[1]
        return shapes(self.system.size, self.physics.contacts, columns)

    @cached_property
    def _usual(self) -> tuple[Array, Array]:
        """Gain of all readings with the steady covariance, and no excess columns."""
        none = np.zeros(self.model.warm.shape)
        everything = np.arange(len(self.system.rows))
        return correct(self.model.filter, self.system.rows, everything, none, 1.0)

    @cached_property
    def _calibrated_readings(self) -> tuple[Array, Array]:
        """Lowest and highest reading of every sensor that is not beyond the calibration, K."""
        known = self.model.calibrated.temperatures
        low, high = np.array([known[name] for name in self.model.sensors]).T
        slack = np.maximum(SLACK * (high - low), 3.0 * np.sqrt(self.model.filter.noise[:-1]))
        return low - slack, high + slack

    def initial_state(self) -> Array:
        """Return the state of a machine at rest, before any sample."""
        return self._state(np.zeros(self.model.warm.shape), KNOWN)

    def warm_state(self) -> Array:
        """Return the state of a machine of which nothing is known, before any sample."""
        return self._state(self.model.warm, UNKNOWN)

    def _state(self, excess: Array, memory: float) -> Array:
        unknown, joint = np.array(np.nan), self.physics.at_rest()
        linear = np.zeros(self.system.size)
        return ObserverState(unknown, unknown, np.array(memory), linear, *joint, excess).flat()

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`.

        Raises
        ------
        InputError
            Time does not increase, or a value is no temperature.
        ConvergenceError
            The joint has no equilibrium that is found at these temperatures.
        """
        before = unpacked(state, self.parts)
        readings = _checked(values, self.channels)
        length, steps = self._steps(float(before.time), time)
        linear, joint, excess = before.linear, before.joint, before.excess
        memory = float(before.memory)
        for k in range(steps):
            linear = self._predicted(linear, joint, length)
            if k + 1 < steps:
                joint, _ = self._settled(joint, linear, memory)
                excess = self._forgetting(excess, length)
        present = np.flatnonzero(np.isfinite(readings))
        gain, excess = self._gain(present, excess, length if steps else self.model.step)
        expected = self.system.rows @ linear
        expected[:-1] += self.model.offset
        linear = linear + gain @ (readings - expected)[present]
        amplitudes = self._amplitudes(linear)
        joint, moved = self._settled(joint, linear, memory)
        relaxed = linear[amplitudes.size : self.system.decay.size]
        displacement = moved + self.model.remainder.displacement @ relaxed
        begun = before.begun if steps else np.array(time)
        after = ObserverState(
            np.array(time),
            begun,
            np.array(self._remembered(memory, excess)),
            linear,
            *joint,
            self._onward(excess),
        ).flat()
        inputs = linear[self.system.decay.size :]
        status = self._status(time - float(begun), inputs, readings, excess)
        pressure = joint.pressure if joint.pressure.size else np.array([np.nan])
        details = np.concatenate([inputs, [pressure.min(), pressure.max()]])
        return after, Estimate(
            time, displacement, self._half_band(relaxed, excess, memory), status, details
        )

    def _steps(self, last: float, time: float) -> tuple[float, int]:
        """Length (s) and number of the steps from the last sample to this one; 0 at the first."""
        if not math.isfinite(time):
            raise InputError(f"time {time:g} s is no time; drop the sample")
        if math.isnan(last):
            return 0.0, 0
        if not time > last:
            raise InputError(
                f"time {time:g} s does not come after {last:g} s; drop or re-order the sample"
            )
        # An interval of a step, but for its rounding, is one step.
        steps = max(1, math.ceil((time - last) / self.model.step - 1e-6))
        steps = min(steps, MOST_STEPS)
        length = (time - last) / steps
        near = abs(length - self.model.step) <= 1e-6 * self.model.step
        return self.model.step if near else length, steps

    def _amplitudes(self, linear: Array) -> Array:
        return linear[: self.model.modes.rates.size]

    def _predicted(self, linear: Array, joint: JointState, length: float) -> Array:
        """The linear state one step later, with the joint as it was."""
        count, dynamic = self.model.modes.rates.size, self.system.decay.size
        inputs = linear[dynamic:]
        sources, rates = self.model.power.size, self.model.remainder.rates
        decay = 1.0 / (1.0 + length * rates)
        relaxed = linear[count:dynamic].reshape(sources, -1)
        heat = inputs[:sources] / self.model.power
        after = np.empty_like(linear)
        after[:count] = conduct(self.physics, linear[:count], inputs, joint.pressure, length)
        after[count:dynamic] = (decay * relaxed + (1.0 - decay) * heat[:, None]).ravel()
        after[dynamic:] = inputs
        return after

    def _gain(
        self, present: NDArray[np.int64], excess: Array, length: float
    ) -> tuple[Array, Array]:
        """Gain of the readings that came, and the excess columns after them."""
        weight = max(1.0, self.model.step / length)
        if present.size == len(self.system.rows) and weight == 1.0 and not excess.any():
            return self._usual
        gain, after = correct(self.model.filter, self.system.rows, present, excess, weight)
        return gain, compressed(after, self.model.filter.scale, excess.shape[1])

    def _forgetting(self, excess: Array, length: float) -> Array:
        """Excess columns after a step of some length without any reading."""
        nothing = np.arange(0)
        _, after = self._gain(nothing, excess, self.model.step)
        walks = max(length / self.model.step - 1.0, 0.0) ** 0.5 * self.model.filter.walk
        if walks.any():
            more = np.zeros((len(after), walks.size))
            more[-walks.size :] = np.diag(walks)
            after = compressed(np.hstack([after, more]), self.model.filter.scale, excess.shape[1])
        return self._onward(after)

    def _onward(self, excess: Array) -> Array:
        """Excess columns one step later; none where they have come to say nothing."""
        if not excess.any():
            return excess
        after = self.system.advance(excess)
        told = np.square(self.system.rows @ after).sum(axis=1) / self.model.filter.noise
        moved = np.square(self.model.band.tangent @ after).sum(axis=1)
        known = np.all(moved <= FORGOTTEN * self.model.band.steady)
        return np.zeros_like(after) if told.max() <= FORGOTTEN and known else after

    def _settled(self, joint: JointState, linear: Array, memory: float) -> tuple[JointState, Array]:
        """The joint and the displacement at the present temperatures.

        As long as these are guesses the joint is taken there from rest each time: a way through
        temperatures that never were would leave slips that never were.
        """
        if memory == UNKNOWN:
            joint = joint._replace(slip=np.zeros_like(joint.slip))
        return settle_joint(self.physics, joint, self._amplitudes(linear))

    def _remembered(self, memory: float, excess: Array) -> float:
        """What is known of the slips after a sample."""
        uncertain = np.square(self.model.band.tangent @ excess).sum(axis=1)
        return FOLLOWED if memory == UNKNOWN and uncertain.max() <= FOLLOWABLE**2 else memory

    def _half_band(self, relaxed: Array, excess: Array, memory: float) -> Array:
        """Half the width of 95 %, m, shape (axes,)."""
        band, rates = self.model.band, self.model.remainder.rates.size
        square = np.square(relaxed.reshape(-1, rates)).mean(axis=0)
        variance = band.steady + band.constant + band.square @ square
        indistinct = band.open @ np.concatenate([relaxed, relaxed**2])
        variance += np.square(indistinct).mean(axis=1)
        if memory != KNOWN:
            variance = variance + band.history
        if excess.any():
            variance = variance + np.square(band.tangent @ excess).sum(axis=1)
        return np.asarray(WIDTH * np.sqrt(variance))

    def _status(self, elapsed: float, inputs: Array, readings: Array, excess: Array) -> Status:
        known, status = self.model.calibrated, Status.OK
        if elapsed > (1.0 + SLACK) * known.duration_s:
            status |= Status.BEYOND_TIME
        heat = inputs[: self.model.power.size] / self.model.power
        if heat.max() > (1.0 + SLACK) * known.heat or heat.min() < -SLACK * known.heat:
            status |= Status.BEYOND_HEAT
        low, high = self._calibrated_readings
        if (readings[:-1] < low).any() or (readings[:-1] > high).any():
            status |= Status.BEYOND_TEMPERATURE
        if np.isnan(readings).any():
            status |= Status.READING_MISSING
        if excess.any():
            status |= Status.UNSETTLED
        return status


def _checked(values: Sequence[float], channels: Sequence[Channel]) -> Array:
    if len(values) != len(channels):
        names = ", ".join(channel.name for channel in channels)
        raise InputError(f"sample has {len(values)} values, expected {len(channels)}: {names}")
    readings = np.asarray(values, dtype=float)
    bad = np.flatnonzero(np.abs(readings) > LARGEST)
    if bad.size:
        raise InputError(
            f"{channels[bad[0]].name} is {readings[bad[0]]:g} K, no temperature; leave it out"
        )
    return readings
