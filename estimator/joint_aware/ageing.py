"""Online learning of preload, friction and convection of an ageing machine.

Recursive prediction error method (Ljung, System Identification, 1999, section 11.4). In parallel
with the observer, one copy for each parameter runs with that parameter slightly changed, on the
same readings. The innovations of the copies give the sensitivities to the parameters, including
filter and slips, without explicit equations. Innovations are averaged over `Learning.window`,
because model errors are correlated from sample to sample. From them a Kalman filter estimates the
logarithms of the parameters and a slowly varying bias of every sensor's innovations, so that a
model error that lasts for hours is not mistaken for ageing.

Modes and gain remain as calibrated: preload and friction enter only the joint's law, and the change
of convection is applied between two samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from estimator.interface import Channel, Estimate, Status
from estimator.joint_aware.band import WIDTH
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.observer_model import SCHEMA, ObserverModel
from estimator.joint_aware.observer_state import Layout, placed, unpacked
from estimator.joint_aware.sample_values import split_sample
from estimator.joint_aware.slow_parameters import (
    SLOW,
    USUAL,
    Learning,
    Slow,
    check_ageing,
    learnt,
    wandered,
)
from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.reduced.convection import Convection, convected, convection_of
from thermojoint.reduced.parameters import joint_with_factors

#: Samples with any other status are not used for learning.
TEACHES = (
    Status.BEYOND_TIME | Status.BEYOND_HEAT | Status.BEYOND_TEMPERATURE | Status.READING_MISSING
)


@dataclass(frozen=True, eq=False)
class _State:
    """Parts of the flat state, in this order.

    time () of the last sample and begun () of the window, s; learnt: logarithms (q,) and biases (p
    + 1,), and their covariance; for the window: number of used readings (p + 1,), sums of their
    innovations (p + 1,) and of the sensitivities of these (p + 1, q), in K; the observer and its
    copies (q + 1, n).
    """

    time: Array
    begun: Array
    learnt: Array
    covariance: Array
    counted: Array
    innovation: Array
    sensitivity: Array
    runs: Array

    def flat(self) -> Array:
        return np.concatenate([np.ravel(part) for part in vars(self).values()])


@dataclass(frozen=True, eq=False)
class AgeingJointAware:
    """A joint-aware estimator that learns preload, friction or convection online.

    Attributes
    ----------
    observer : JointAware
        With the calibrated parameters.
    ageing : tuple of str
        Names from `SLOW`.
    learning : Learning
        Settings of the learning.

    Raises
    ------
    InputError
        A name is unknown or repeated, or the machine has no such parameter.
    """

    observer: JointAware
    ageing: tuple[str, ...]
    learning: Learning = USUAL
    kind: Literal["joint-aware"] = "joint-aware"
    schema: str = SCHEMA

    def __post_init__(self) -> None:
        """Check the ageing parameters; raises as `check_ageing`."""
        check_ageing(self.observer.model, self.ageing)

    @property
    def model(self) -> ObserverModel:
        """Model of the observer."""
        return self.observer.model

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the displacement."""
        return self.observer.axes

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of the observer."""
        return self.observer.channels

    @property
    def details(self) -> tuple[Channel, ...]:
        """Details of the observer; factor on each calibrated parameter, and its uncertainty.

        The uncertainty is the standard deviation of the factor's logarithm.
        """
        own = (Channel(f"{name}_{what}", "1") for name in self.ageing for what in ("factor", "std"))
        return (*self.observer.details, *own)

    @cached_property
    def _parts(self) -> Layout:
        """Slices of the parts of the state."""
        parts = vars(self._fresh(self.observer.initial_state()))
        return placed({name: np.shape(part) for name, part in parts.items()})

    @property
    def _slow(self) -> list[Slow]:
        """Learned quantities: parameters, then biases."""
        rows = len(self.observer.observer.system.rows)
        return [*(SLOW[name] for name in self.ageing), *[self.learning.bias] * rows]

    def initial_state(self) -> Array:
        """Return the state of a machine at rest with the calibrated parameters."""
        return self._fresh(self.observer.initial_state()).flat()

    def warm_state(self) -> Array:
        """Return the state of a machine with an unknown past."""
        return self._fresh(self.observer.warm_state()).flat()

    def _fresh(self, start: Array) -> _State:
        slow, count = self._slow, len(self.ageing)
        rows = len(slow) - count
        return _State(
            time=np.array(np.nan),
            begun=np.array(np.nan),
            learnt=np.zeros(len(slow)),
            covariance=np.diag([one.spread**2 for one in slow]),
            counted=np.zeros(rows),
            innovation=np.zeros(rows),
            sensitivity=np.zeros((rows, count)),
            runs=np.tile(start, (count + 1, 1)),
        )

    def _unpacked(self, state: Array) -> _State:
        return _State(**self._parts.views(state))

    def sample(self, state: Array, time: float, values: Sequence[float]) -> tuple[Array, Estimate]:
        """Take one sample; see `estimator.interface.Estimator`.

        Raises
        ------
        InputError, ConvergenceError
            As `JointAware.sample`.
        """
        before = self._unpacked(state)
        values = [*values, *[math.nan] * (len(self.channels) - len(values))]
        count = len(self.ageing)
        logarithms = before.learnt[:count]
        machines = _aged(self.observer, self.ageing, tuple(logarithms.tolist()), self.learning.step)
        taken = [
            machine.sample(run, time, values)
            for machine, run in zip(machines, before.runs, strict=True)
        ]
        estimate = taken[0][1]
        moved = np.array([other.displacement - estimate.displacement for _, other in taken[1:]]).T
        length = 0.0 if math.isnan(float(before.time)) else time - float(before.time)
        factors = self._convection_factors(logarithms)
        after = replace(
            before,
            time=np.array(time),
            begun=before.begun if length else np.array(time),
            runs=np.array([run for run, _ in taken]),
        )
        if not estimate.status & ~TEACHES:
            after = self._counting(after, values, length)
        # Innovations are recovered from the state after the correction, before convection acts.
        left = [
            self._with_convection(run, factor, length)
            for run, factor in zip(after.runs, factors, strict=True)
        ]
        after = replace(after, runs=np.array(left))
        at = self._probed(values)
        # A reading that the observer refuses is not used for learning.
        if at.any() and not estimate.status & Status.READING_REFUSED:
            innovation, sensitivity, variance = self._without(before, machines, time, values, at)
            unbiased = np.zeros((len(innovation), before.learnt.size - count))
            rows = np.hstack([-sensitivity, unbiased])
            after = self._taught(after, innovation, rows, variance)
        if time - float(after.begun) >= self.learning.window:
            after = self._concluded(after)
        spread = before.covariance[:count, :count]
        uncertain = np.einsum("ai,ij,aj->a", moved, spread, moved) / self.learning.step**2
        band = np.sqrt(estimate.band**2 + WIDTH**2 * np.maximum(uncertain, 0.0))
        own = np.column_stack([np.exp(logarithms), np.sqrt(np.diag(spread))]).ravel()
        return after.flat(), estimate._replace(
            band=band, details=np.concatenate([estimate.details, own])
        )

    def _concluded(self, state: _State) -> _State:
        """Update the parameters from a window and begin the next one."""
        some = state.counted > 0.0
        count = state.counted[some]
        learned, covariance = wandered(
            self._slow, state.learnt, state.covariance, float(state.time - state.begun)
        )
        biases = np.eye(some.size)[some]
        taught = self._taught(
            replace(state, learnt=learned, covariance=covariance),
            state.innovation[some] / count - biases @ learned[len(self.ageing) :],
            np.hstack([-state.sensitivity[some] / count[:, None], biases]),
            np.full(count.size, self.learning.lasting_K**2),
        )
        return replace(
            taught,
            begun=state.time,
            counted=np.zeros_like(state.counted),
            innovation=np.zeros_like(state.innovation),
            sensitivity=np.zeros_like(state.sensitivity),
        )

    def _taught(self, state: _State, innovation: Array, rows: Array, variance: Array) -> _State:
        """Update by innovations; as `learnt`."""
        learned, covariance = learnt(
            state.learnt, state.covariance, innovation, rows, variance, self.learning.farthest
        )
        return replace(state, learnt=learned, covariance=covariance)

    def _probed(self, values: Sequence[float]) -> Flags:
        """Mask of the available displacement readings."""
        metres = np.array([channel.unit == "m" for channel in self.channels])
        return metres & np.isfinite(np.asarray(values, dtype=float))

    def _without(
        self,
        before: _State,
        machines: Sequence[JointAware],
        time: float,
        values: Sequence[float],
        at: Flags,
    ) -> tuple[Array, Array, Array]:
        """Innovations of the displacement, their sensitivities (k, q) and variances, m."""
        read = np.asarray(values, dtype=float)
        unread = np.where(at, np.nan, read).tolist()
        samples = [
            machine.sample(run, time, unread)[1]
            for machine, run in zip(machines, before.runs, strict=True)
        ]
        axes = at[-len(self.axes) :]
        nominal = samples[0]
        innovation = read[at] - nominal.displacement[axes]
        sensitivity = (
            np.array([(nominal.displacement - other.displacement)[axes] for other in samples[1:]]).T
            / self.learning.step
        )
        variance = (nominal.band[axes] / WIDTH) ** 2 + self.learning.lasting_m**2
        return innovation, sensitivity, variance

    def _convection_factors(self, logarithms: Array) -> list[float]:
        """Logarithm of the convection factor in the observer and in each copy."""
        if "film" not in self.ageing:
            return [0.0] * (len(self.ageing) + 1)
        at = self.ageing.index("film")
        now = float(logarithms[at])
        return [now, *(now + self.learning.step * (k == at) for k in range(len(self.ageing)))]

    def _with_convection(self, run: Array, exponent: float, length: float) -> Array:
        """A run after an interval with the change of convection since the calibration."""
        if not exponent or not length:
            return run
        after = run.copy()
        linear = unpacked(after, self.observer.parts).linear
        modes = linear[: self._convection.ambient.size]
        modes[:] = convected(self._convection, modes, float(linear[-1]), math.exp(exponent), length)
        return after

    @cached_property
    def _convection(self) -> Convection:
        return convection_of(self.observer.model.modes)

    def _counting(self, after: _State, values: Sequence[float], length: float) -> _State:
        """The window after one more sample."""
        innovations = np.array([self._innovation(run, values, length) for run in after.runs])
        present = np.isfinite(innovations[0])
        slope = (innovations[1:] - innovations[0]).T / self.learning.step
        return replace(
            after,
            counted=after.counted + present,
            innovation=after.innovation + np.where(present, innovations[0], 0.0),
            sensitivity=after.sensitivity + np.where(present[:, None], slope, 0.0),
        )

    def _innovation(self, run: Array, values: Sequence[float], length: float) -> Array:
        """Innovation (p + 1,) of a sample, recovered from its residual; NaN where missing.

        With all S = H P H' + R, the correction leaves R S^-1 times the innovation.
        """
        observer = self.observer
        rows, steady = observer.observer.system.rows, observer.model.filter
        readings, *_ = split_sample(observer.precomputed, values)
        left = readings - rows @ unpacked(run, observer.parts).linear
        here = np.flatnonzero(np.isfinite(left))
        noise = steady.noise[here]
        if 0.0 < length < observer.model.step:
            noise = noise * observer.model.step / length
        innovation = np.full(len(rows), np.nan)
        share = left[here] / noise
        innovation[here] = steady.innovation[np.ix_(here, here)] @ share + left[here]
        return innovation


@lru_cache(maxsize=32)
def _aged(
    observer: JointAware, names: tuple[str, ...], logarithms: tuple[float, ...], step: float
) -> list[JointAware]:
    """The observer and its copies at these parameters; cached, as they are constant in a window."""
    every = [logarithms] + [
        tuple(value + step * (k == changed) for k, value in enumerate(logarithms))
        for changed in range(len(names))
    ]
    return [
        replace(observer, model=_with_joints(observer.model, names, factors)) for factors in every
    ]


def _with_joints(
    model: ObserverModel, names: tuple[str, ...], logarithms: tuple[float, ...]
) -> ObserverModel:
    factors = {
        name: math.exp(value)
        for name, value in zip(names, logarithms, strict=True)
        if name != "film"
    }
    joints = tuple(joint_with_factors(joint, factors) for joint in model.joints)
    return replace(model, joints=joints)
