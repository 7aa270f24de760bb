"""Observer of the linear state and the joint: predict, correct, solve, evaluate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.joint_aware.filter_design import LinearSystem, compressed, correct, linear_system
from estimator.joint_aware.observer_model import ObserverModel
from estimator.joint_aware.observer_state import FOLLOWED, KNOWN, UNKNOWN, ObserverState
from estimator.joint_aware.thresholds import USUAL, Thresholds
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.physics import (
    JointState,
    Physics,
    conduct,
    make_physics,
    settle_joint,
)

#: Steps over which the answer of the readings to the heat is kept.
ANSWER = 60


class Expected(NamedTuple):
    """What is expected at a sample; attributes as in `ObserverState`."""

    linear: Array
    joint: JointState
    excess: Array
    memory: float


class Settled(NamedTuple):
    """The joint, the relaxations (s q,) and the displacement (axes,), m, that belong together."""

    joint: JointState
    relaxed: Array
    displacement: Array


@dataclass(frozen=True, eq=False)
class Observer:
    """What a model does in a step; nothing here knows where the readings come from.

    Attributes
    ----------
    model : ObserverModel
        All it runs on.
    thresholds : Thresholds
        What it takes for known.
    """

    model: ObserverModel
    thresholds: Thresholds = USUAL

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
    def usual_gain(self) -> Array:
        """Gain of all readings with the steady covariance, shape (n, p + 1)."""
        none = np.zeros(self.model.warm.shape)
        everything = np.arange(len(self.system.rows))
        return correct(self.model.filter, self.system.rows, everything, none, 1.0)[0]

    @cached_property
    def onset(self) -> Array:
        """Readings 1, 2 ... steps after 1 W more heat of each source, K, shape (k, p + 1, s)."""
        columns = np.zeros((self.system.size, self.model.power.size))
        columns[self.system.decay.size :][: self.model.power.size] = np.eye(self.model.power.size)
        found = []
        for _ in range(ANSWER):
            columns = self.system.advance(columns)
            found.append(self.system.rows @ columns)
        return np.array(found)

    def expected(self, before: ObserverState, length: float, steps: int) -> Expected:
        """What is expected at a sample, `steps` of `length` (s) after the one before it."""
        linear, joint, excess = before.linear, before.joint, before.excess
        memory = float(before.memory)
        for k in range(steps):
            linear = self._later(linear, joint, length)
            if k + 1 < steps:
                joint, _ = self._settled(joint, linear, memory)
                excess = self._forgetting(excess, length)
        return Expected(linear, joint, excess, memory)

    def _later(self, linear: Array, joint: JointState, length: float) -> Array:
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

    def gain(
        self, present: NDArray[np.int64], excess: Array, length: float, memory: float
    ) -> tuple[Array, Array]:
        """Gain of the readings that came, and the excess columns after them."""
        weight = max(1.0, self.model.step / length)
        if present.size == len(self.system.rows) and weight == 1.0 and not excess.any():
            return self.usual_gain, excess
        doubt = self.thresholds.doubt_of_heat if memory == KNOWN else 1.0
        gain, after = correct(self.model.filter, self.system.rows, present, excess, weight, doubt)
        return gain, compressed(after, self.model.filter.scale, excess.shape[1])

    def innovation_covariance(self, excess: Array) -> Array:
        """Covariance of the innovations, K2, shape (p + 1, p + 1)."""
        told = self.system.rows @ excess
        own = np.diag(self.model.filter.noise)
        return np.asarray(self.model.filter.innovation + own + told @ told.T)

    def _forgetting(self, excess: Array, length: float) -> Array:
        """Excess columns after a step of some length without any reading."""
        nothing, own = np.arange(0), self.model.filter
        _, after = correct(own, self.system.rows, nothing, excess, 1.0)
        after = compressed(after, own.scale, excess.shape[1])
        walks = max(length / self.model.step - 1.0, 0.0) ** 0.5 * self.model.filter.walk
        if walks.any():
            more = np.zeros((len(after), walks.size))
            more[-walks.size :] = np.diag(walks)
            after = compressed(np.hstack([after, more]), self.model.filter.scale, excess.shape[1])
        return self.onward(after)

    def onward(self, excess: Array) -> Array:
        """Excess columns one step later; none where they have come to say nothing."""
        if not excess.any():
            return excess
        after = self.system.advance(excess)
        told = np.square(self.system.rows @ after).sum(axis=1) / self.model.filter.noise
        moved = np.square(self.model.band.tangent @ after).sum(axis=1)
        least = self.thresholds.forgotten
        known = np.all(moved <= least * self.model.band.steady)
        return np.zeros_like(after) if told.max() <= least and known else after

    def _settled(self, joint: JointState, linear: Array, memory: float) -> tuple[JointState, Array]:
        """The joint and the displacement at the present temperatures.

        As long as these are guesses the joint is taken there from rest each time: a way through
        temperatures that never were would leave slips that never were.
        """
        if memory == UNKNOWN:
            joint = joint._replace(slip=np.zeros_like(joint.slip))
        return settle_joint(self.physics, joint, linear[: self.model.modes.rates.size])

    def remembered(self, memory: float, excess: Array) -> float:
        """What is known of the slips after a sample."""
        uncertain = np.square(self.model.band.tangent @ excess).sum(axis=1)
        known = uncertain.max() <= self.thresholds.followable**2
        return FOLLOWED if memory == UNKNOWN and known else memory

    def read(self, linear: Array, joint: JointState, memory: float) -> Settled:
        """The joint settled at the corrected temperatures, and what is read off it."""
        count = self.model.modes.rates.size
        joint, moved = self._settled(joint, linear, memory)
        relaxed = linear[count : self.system.decay.size]
        return Settled(joint, relaxed, moved + self.model.remainder.displacement @ relaxed)

    def sigma(self, relaxed: Array, memory: float) -> Array:
        """What the model may be wrong by, m, one standard deviation, shape (axes,)."""
        band, rates = self.model.band, self.model.remainder.rates.size
        sources = relaxed.size // rates
        square = np.square(relaxed.reshape(sources, rates)).sum(axis=0) / sources
        indistinct = band.open @ np.concatenate([relaxed, relaxed**2])
        drawn = np.einsum("ad,ad->a", indistinct, indistinct) / indistinct.shape[1]
        variance = band.constant + band.square @ square + drawn
        if memory != KNOWN:
            variance = variance + band.history
        return np.asarray(np.sqrt(variance))
