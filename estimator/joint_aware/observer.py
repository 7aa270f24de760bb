"""Observer of the linear state and the joint: predict, correct, solve, evaluate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.joint_aware.filter_design import (
    NOISE,
    LinearSystem,
    SteadyFilter,
    compressed,
    correct,
    linear_system,
    with_errors,
)
from estimator.joint_aware.observer_model import ObserverModel
from estimator.joint_aware.observer_state import KNOWN, TRACKED, UNKNOWN, ObserverState
from estimator.joint_aware.thresholds import USUAL, Thresholds
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.physics import (
    Driving,
    JointState,
    Physics,
    Way,
    conduct,
    conduct_driven,
    make_physics,
    positioned,
    seen_from,
    settle_joint,
    way_of,
)

#: Number of steps for which the response of the readings to heat is stored.
ANSWER = 60
#: Most samples until a sampling interval of several steps reaches its steady covariance.
MOST_SAMPLES = 500


@dataclass(frozen=True)
class Moment:
    """Time of a sample, and what acts on the machine then."""

    #: s.
    time: float
    #: Step length since the previous sample, s.
    length: float
    #: Number of these steps; 0 at the first sample.
    steps: int
    #: Shape (l,): factors of the loads, and the positions of axes, m, at the sample.
    loads: Array = field(default_factory=lambda: np.zeros(0))
    #: Shape (x,): travel of the axes since the previous sample by their odometers, m; empty without
    #: any.
    travelled: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def elapsed(self) -> float:
        """Time since the previous sample, s."""
        return self.length * self.steps


class Prediction(NamedTuple):
    """Prediction for a sample; attributes as in `ObserverState`."""

    linear: Array
    joint: JointState
    drive: Array
    covariance_factor: Array
    errors: Array
    slip_knowledge: float


class Equilibrium(NamedTuple):
    """Consistent joint, relaxations (s q,) and displacement (axes,), m."""

    joint: JointState
    relaxed: Array
    displacement: Array


@dataclass(frozen=True, eq=False)
class Observer:
    """Predictions and corrections of a model; independent of the source of the readings."""

    #: Model of the machine and the filter.
    model: ObserverModel
    #: Thresholds of the observer.
    thresholds: Thresholds = USUAL

    @cached_property
    def physics(self) -> Physics:
        """The machine that is marched."""
        return make_physics(self.model.modes, self.model.joints, self.model.held)

    @cached_property
    def system(self) -> LinearSystem:
        """Linear part over one step of the filter."""
        model = self.model
        return linear_system(model.modes, model.discrepancy, model.power, model.step)

    @cached_property
    def relaxations(self) -> slice:
        """Relaxations of the heat (s q,) in the linear state; the amplitudes are before them."""
        return slice(self.model.modes.rates.size, self.system.decay.size)

    @cached_property
    def heat(self) -> slice:
        """Heat of the sources (s,) in the linear state, W."""
        first = self.system.decay.size
        return slice(first, first + self.model.power.size)

    @cached_property
    def augmented(self) -> SteadyFilter:
        """The steady filter of the linear state (n,) and the errors of the readings (p + 1,)."""
        return with_errors(self.model.filter)

    @cached_property
    def rows(self) -> Array:
        """Readings per linear state and error, shape (p + 1, n + p + 1)."""
        return np.hstack([self.system.rows, np.eye(len(self.system.rows))])

    @cached_property
    def unknown_start(self) -> Array:
        """Covariance factor of both where the past is unknown, shape (n + p + 1, k).

        A reading that the model reproduces poorly keeps about the same error for hours: its changes
        are more informative than its value.
        """
        ill = np.maximum(self.model.filter.lasting - np.square(NOISE.lasting), 0.0)
        errors = self.thresholds.start_error * np.sqrt(ill)
        size, columns = self.model.warm.shape
        start = np.zeros((size + errors.size, columns + errors.size))
        start[:size, :columns], start[size:, columns:] = self.model.warm, np.diag(errors)
        return start

    @cached_property
    def known_start(self) -> Array:
        """The same of a machine at rest: zeros."""
        return np.zeros_like(self.unknown_start)

    @cached_property
    def augmented_gain(self) -> Array:
        """Gain of all readings with the steady covariance, shape (n + p + 1, p + 1)."""
        everything = np.arange(len(self.rows))
        return correct(self.augmented, self.rows, everything, self.known_start, 1.0)[0]

    @property
    def steady_gain(self) -> Array:
        """The same of the linear state, shape (n, p + 1)."""
        return self.augmented_gain[: self.system.size]

    @cached_property
    def step_response(self) -> Array:
        """Readings 1, 2 ... steps after a step of 1 W at each source, K, shape (k, p + 1, s)."""
        columns, readings = self._of_each_source, []
        for _ in range(ANSWER):
            columns = self.system.advance(columns)
            readings.append(self.system.rows @ columns)
        return np.array(readings)

    @property
    def _of_each_source(self) -> Array:
        """Linear states (n, s) with 1 W at one source each."""
        return np.eye(self.system.size)[:, self.heat]

    @cached_property
    def _step_innovations(self) -> Array:
        """Innovations while the filter finds heat of 1 W at each source, K, shape (k, p + 1, s)."""
        unknown, innovations = self._of_each_source, []
        for _ in range(ANSWER):
            unknown = self.system.advance(unknown)
            innovations.append(self.system.rows @ unknown)
            unknown = unknown - self.steady_gain @ innovations[-1]
        return np.array(innovations)

    @cached_property
    def _peak_sample(self) -> NDArray[np.int64]:
        """Sample of the largest of these innovations, shape (s,)."""
        return np.asarray(np.abs(self._step_innovations).max(axis=1).argmax(axis=0))

    @cached_property
    def peak_innovation(self) -> Array:
        """Largest innovations after a step of 1 W at each source, K, shape (p + 1, s).

        For a sensor that responds to the source at once that is the first one. Where it lags, the
        filter finds the heat step by step, and the innovations grow meanwhile.
        """
        peak, source = self._peak_sample, np.arange(self._peak_sample.size)
        return np.asarray(self._step_innovations[peak, :, source].T)

    @cached_property
    def dominant_response(self) -> Array:
        """Step response of every reading to its dominant source, K/W, shape (p + 1, k).

        It begins where the innovations are largest: a jump is hardly noticed before.
        """
        best = np.abs(self.step_response[-1]).argmax(axis=1)
        after = np.minimum(np.arange(ANSWER) + self._peak_sample[best, None], ANSWER - 1)
        return np.asarray(self.step_response[after, np.arange(best.size)[:, None], best[:, None]])

    def predict(self, before: ObserverState, moment: Moment) -> Prediction:
        """Prediction for a sample.

        Loads keep their previous values until the sample; axes move uniformly meanwhile.
        """
        length, steps, loads = moment.length, moment.steps, moment.loads
        gone = moment.travelled / max(steps, 1)
        linear, joint, drive = before.linear, before.joint, before.drive
        factor, last = before.covariance_factor, before.loads
        slip_knowledge = float(before.slip_knowledge)
        for k in range(steps):
            now = self._meanwhile(before.loads, loads, (k + 1) / steps)
            way = way_of(self.model.modes, last, now, gone.tolist())
            linear, drive = self.later((linear, drive), joint, length, way)
            last, factor = now, self.propagated(factor, length)
            if k + 1 < steps:
                joint, _ = self._settle(joint, linear, slip_knowledge, now)
                factor = self._without_readings(factor, length)
        errors = self.lasting_on(moment.elapsed) * before.errors * factor.any()
        return Prediction(linear, joint, drive, factor, errors, slip_knowledge)

    def lasting_on(self, elapsed: float) -> float:
        """Decay factor of the readings' errors at a start over some time (s)."""
        return math.exp(-elapsed / self.thresholds.start_error_lasts)

    def place(self, loads: Array) -> Array:
        """Return the positions of the axes, (x,), m, in the loads (l,) of a sample."""
        return loads[loads.size - len(self.model.moving_axes) :]

    def _meanwhile(self, before: Array, after: Array, share: float) -> Array:
        """Loads (l,) between two samples: as before, but for the positions of axes."""
        if not (axes := len(self.model.moving_axes)):
            return before
        now = before.copy()
        now[-axes:] += share * (after[-axes:] - before[-axes:])
        return now

    def later(
        self, before: tuple[Array, Array], joint: JointState, length: float, way: Way | None
    ) -> tuple[Array, Array]:
        """Return the linear state (n,) and the drives (d,) one step later, the joint unchanged.

        Parameters
        ----------
        before : tuple of ndarray, shapes (n,) and (d,)
            Before the step.
        joint : JointState
            Whose conductance is used.
        length : float
            Of the step, s.
        way : Way, optional
            Of the axes in the step.
        """
        linear, drive = before
        power, relaxations = self.model.power, self.relaxations
        count, inputs = relaxations.start, linear[relaxations.stop :]
        decay = 1.0 / (1.0 + length * self.model.discrepancy.rates)
        relaxed, heat = linear[relaxations].reshape(power.size, -1), linear[self.heat] / power
        after = linear.copy()
        if way is None:
            after[:count] = conduct(self.physics, linear[:count], inputs, joint, length)
        else:
            driving = Driving(linear[:count], drive)
            after[:count], drive = conduct_driven(self.physics, driving, inputs, joint, length, way)
        after[relaxations] = (decay * relaxed + (1.0 - decay) * heat[:, None]).ravel()
        return after, drive

    def gain(
        self, present: NDArray[np.int64], factor: Array, length: float, slip_knowledge: float
    ) -> tuple[Array, Array]:
        """Gain (n + p + 1, q) of the present readings, and the covariance factor after them."""
        weight = max(1.0, self.model.step / length)
        if present.size == len(self.rows) and weight == 1.0 and not factor.any():
            return self.augmented_gain, factor
        known, unknown = self.thresholds.doubt_of_heat, self.thresholds.doubt_of_past
        doubt = known if slip_knowledge == KNOWN else unknown
        gain, after = correct(self.augmented, self.rows, present, factor, weight, doubt)
        return gain, compressed(after, self.augmented.scale, factor.shape[1])

    def readings(self, prediction: Prediction) -> Array:
        """Return the readings that are expected, K, shape (p + 1,)."""
        return np.asarray(self.system.rows @ prediction.linear + prediction.errors)

    def innovation_covariance(self, factor: Array) -> Array:
        """Covariance of the innovations, K2, shape (p + 1, p + 1)."""
        seen = self.rows @ factor
        own = np.diag(self.model.filter.noise)
        return np.asarray(self.model.filter.innovation + own + seen @ seen.T)

    def _without_readings(self, factor: Array, length: float) -> Array:
        """Covariance factor after a sample without any reading, a step of some length (s) long."""
        _, after = correct(self.augmented, self.rows, np.arange(0), factor, 1.0)
        after = compressed(after, self.augmented.scale, factor.shape[1])
        walks = max(length / self.model.step - 1.0, 0.0) ** 0.5 * self.model.filter.walk
        if walks.any():
            more, inputs = np.zeros((len(after), walks.size)), self.system.decay.size
            more[inputs : inputs + walks.size] = np.diag(walks)
            after = compressed(np.hstack([after, more]), self.augmented.scale, factor.shape[1])
        return after

    def advance(self, columns: Array, length: float) -> Array:
        """Return columns (n + p + 1, k) of the linear state and the errors a step (s) later."""
        model, size, system = self.model, self.system.size, self.system
        if length != model.step:
            system = linear_system(model.modes, model.discrepancy, model.power, length)
        return np.vstack([system.advance(columns[:size]), self.lasting_on(length) * columns[size:]])

    def propagated(self, factor: Array, length: float) -> Array:
        """Covariance factor a step of some length (s) later; zero once it is negligible."""
        if not factor.any():
            return factor
        size, after = self.system.size, self.advance(factor, length)
        seen = np.square(self.system.rows @ after[:size]).sum(axis=1) / self.model.filter.noise
        moved = np.square(self.model.band.tangent @ after[:size]).sum(axis=1)
        least = self.thresholds.forgotten
        known = np.all(moved <= least * self.model.band.steady)
        return np.zeros_like(after) if seen.max() <= least and known else after

    def unsettled(self, left: Array, usual: Array, steps: int) -> bool:
        """Whether a start or missing readings widen a band by more than 41 %.

        Parameters
        ----------
        left, usual : ndarray, shape (axes,)
            Variance of the displacement that they add, and the variance without them, m2.
        steps : int
            Sampling interval; the variance that it adds permanently does not count.
        """
        if not left.any():
            return False
        by_interval = self.thresholds.settled * self.thresholds.doubt**2 * self._left_open(steps)
        return bool((left > usual + by_interval).any())

    def _left_open(self, steps: int) -> Array:
        """Variance of the displacement (axes,), m2, by a sampling interval of several steps."""
        steps = min(steps, math.ceil(self.thresholds.lost / self.model.step))
        if steps not in self._known_left_open:
            every, factor = np.arange(len(self.rows)), self.known_start
            moved = np.zeros(len(self.model.band.steady))
            for _ in range(MOST_SAMPLES if steps > 1 else 0):
                before = moved
                for k in range(steps):
                    factor = self.propagated(factor, self.model.step)
                    if k + 1 < steps:
                        factor = self._without_readings(factor, self.model.step)
                _, factor = self.gain(every, factor, self.model.step, KNOWN)
                moved = np.square(self.model.band.tangent @ factor[: self.system.size]).sum(axis=1)
                if np.allclose(moved, before, rtol=0.005, atol=0.0):
                    break
            self._known_left_open[steps] = moved
        return self._known_left_open[steps]

    @cached_property
    def _known_left_open(self) -> dict[int, Array]:
        """Results of `_left_open` by the number of steps."""
        return {}

    def _settle(
        self, joint: JointState, linear: Array, slip_knowledge: float, loads: Array
    ) -> tuple[JointState, Array]:
        """The joint and the displacement probes at the present temperatures.

        As long as the temperatures are uncertain, the joint is loaded from rest each time: a path
        through temperatures that never occurred would leave slips that never occurred.
        """
        if slip_knowledge == UNKNOWN:
            joint = joint._replace(slip=self.physics.rest.slip)
        return settle_joint(self.physics, joint, linear[: self.model.modes.rates.size], loads)

    def slip_knowledge_after(self, slip_knowledge: float, factor: Array) -> float:
        """Knowledge of the slips after a sample."""
        uncertain = np.square(self.model.band.tangent @ factor[: self.system.size]).sum(axis=1)
        known = uncertain.max() <= self.thresholds.followable**2
        return TRACKED if slip_knowledge == UNKNOWN and known else slip_knowledge

    def equilibrium(
        self, before: Prediction | ObserverState, linear: Array, loads: Array
    ) -> Equilibrium:
        """The joint in equilibrium at a linear state, and the displacement.

        Drives, and the joint from which it settles, are those of `before`.
        """
        joint, probes = self._settle(before.joint, linear, float(before.slip_knowledge), loads)
        relaxed = linear[self.relaxations]
        now = Driving(linear[: self.relaxations.start], before.drive)
        moved = positioned(self.physics, now, joint, loads, probes)
        return Equilibrium(joint, relaxed, moved + self.model.discrepancy.displacement @ relaxed)

    def displacement_under(self, state: ObserverState, loads: Array) -> Array:
        """Return the displacement (axes,), m, under other loads (l,), the joint settled anew."""
        return self.equilibrium(state, state.linear, loads).displacement

    def seen_from(self, state: ObserverState, slip_knowledge: float, places: Array) -> Array:
        """Return the displacement (n, axes), m, if the axes stood at places (n, x), m."""
        linear, joint, drives = state.linear, state.joint, self.model.modes.drives
        assert drives is not None  # asked for with axes only
        if slip_knowledge == UNKNOWN:
            joint = joint._replace(slip=self.physics.rest.slip)
        every = np.vstack([places, drives.with_zeros(self.place(state.loads))[1:]])
        probes = seen_from(self.physics, joint, linear[: self.relaxations.start], every)
        relaxed = linear[self.relaxations]
        moved = drives.displacement(state.drive, every, probes)
        return np.asarray(moved + self.model.discrepancy.displacement @ relaxed)

    def displacement_by(self, means: Array) -> Array:
        """Return the displacement (..., axes), m, for mean innovations (..., 3 (p + 1)), K.

        The relation is that of the recorded days of the calibration, within their range.
        """
        band = self.model.band
        return np.asarray(band.within(means) @ band.told.T)

    def model_error(
        self, relaxed: Array, slip_knowledge: float, means: Array, since: float = math.inf
    ) -> Array:
        """Displacement per part of the model error, m, shape (..., axes, d + axes).

        The parts, of unit variance, are those of the drawn machines, of the lasting innovations
        along every axis, and of every axis' rest (`displacement_readings`).

        Parameters
        ----------
        relaxed : ndarray, shape (..., s q)
            Heat relaxed at each rate, relative to the reference.
        slip_knowledge : float
            Knowledge of the joint's slips.
        means : ndarray, shape (..., 3 (p + 1))
            Mean innovations (`Watch.means`), K.
        since : float
            Time since the start, s; relevant after a warm start.
        """
        band, rates = self.model.band, self.model.discrepancy.rates.size
        sources = relaxed.shape[-1] // rates
        square = np.square(relaxed).reshape(*relaxed.shape[:-1], sources, rates).sum(axis=-2)
        features = np.concatenate([relaxed, relaxed**2, band.within(means)], axis=-1)
        features = features[..., None, :, None]
        drawn = (band.open @ features)[..., 0] / math.sqrt(band.open.shape[1])
        rest = band.constant + square / sources @ band.square.T
        if slip_knowledge != KNOWN:
            rest = rest + band.history + self.model.cold_drives(since)
        axes, draws, shared = rest.shape[-1], drawn.shape[-1], sum(band.shared)
        reading, meaning = band.surprising
        parts = np.zeros((*rest.shape, shared + axes))
        parts[..., :draws] = drawn
        parts[..., draws:shared] = meaning * band.surprising_of(means)[..., None, reading]
        parts[..., range(axes), range(shared, shared + axes)] = np.sqrt(rest)
        return parts
