"""Exponential trapezoidal step of the heat equation on uncoupled modes.

Each amplitude follows a' = f(t) - lambda a, where f is the heat from sources, films and joints. For
f linear in time, as sources and ambient are between two knots, the solution is exact (the phi
functions below). The joint heat flows are taken as linear between their values at both ends of a
step, which is of second order; those at its end follow from the temperatures there. The step has
the form of implicit Euler with other weights (`fesim.march.heat_step`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fesim.march.heat_step import heat_balance, heat_step
from fesim.march.machine import CondensedMachine
from fesim.march.reduced import with_diagonal
from fesim.solid.condensation import ThermalCondensation
from thermojoint.artefacts.arrays import Array

#: The phi functions are computed from their series below this and from their recursion above it.
NEAR = 1.0
TERMS = 18


def phi_functions(decay: Array) -> tuple[Array, Array, Array]:
    """Return phi_1, phi_2, phi_3 of -`decay` (n,), which is zero or positive.

    phi_0(z) = exp(z), phi_{k+1}(z) = (phi_k(z) - 1/k!)/z: the response to heat 1, t, t^2/2.
    """
    near = decay < NEAR
    small = np.where(near, -decay, 0.0)
    series = np.zeros_like(small)
    for k in range(TERMS, 0, -1):
        series = (series + 1.0) * small / (k + 3.0)
    third = (series + 1.0) / 6.0
    second = 0.5 + small * third
    first = 1.0 + small * second
    large = np.where(near, 1.0, decay)
    far_first = -np.expm1(-large) / large
    far_second = (1.0 - far_first) / large
    far_third = (0.5 - far_second) / large
    return (
        np.where(near, first, far_first),
        np.where(near, second, far_second),
        np.where(near, third, far_third),
    )


def heat_spread(thermal: ThermalCondensation, rates: Array) -> float:
    """Return the magnitude of the modes' amplitudes for a uniform temperature of 1 K.

    The modes are orthonormal in the heat capacity: the root mean square of a temperature, weighted
    with it, is the magnitude of its amplitudes divided by this one.
    """
    return float(np.linalg.norm(thermal.balance.stored[: rates.size])) or 1.0


@dataclass(frozen=True)
class Ends:
    """Inputs and joint heat flows at the start and end of a step; linear in between."""

    #: Shape (k + l,): as in `fesim.march.machine.Step`.
    inputs: tuple[Array, Array]
    #: Shape (m,): joint heat flows, W.
    flow: tuple[Array, Array]

    def inputs_at(self, share: float) -> Array:
        """Return the inputs after a fraction of the step, (k + l,)."""
        return _between(self.inputs, share)

    def flow_at(self, share: float) -> Array:
        """Return the joint heat flows after a fraction of the step, (m,), W."""
        return _between(self.flow, share)


def _between(ends: tuple[Array, Array], share: float) -> Array:
    return ends[0] + share * (ends[1] - ends[0])


@dataclass(frozen=True, eq=False)
class ExponentialStep:
    """The weights of a step of one length."""

    #: Length, s.
    length: float
    #: Shape (r,): decay rates of the modes, 1/s.
    rates: Array
    #: Shape (r,): phi_1, phi_2 and phi_3.
    weights: tuple[Array, Array, Array]
    #: Its heat step gives the temperatures at the end from the result of `before_end` and the
    #: inputs at the end.
    machine: CondensedMachine

    def before_end(self, unknowns: Array, inputs: Array, flow: Array) -> Array:
        """Return the unknowns (r + s,) with the contribution of the forcing at the start."""
        first, second, _ = self.weights
        early = self.length * (first - second)
        found = unknowns.copy()
        count = self.rates.size
        found[:count] *= np.exp(-self.rates * self.length)
        found[:count] += early * self._heating(inputs, flow)
        return found

    def within(self, unknowns: Array, ends: Ends, share: float) -> Array:
        """Return the unknowns (r + s,) after a fraction of the step from `unknowns`."""
        count, time = self.rates.size, share * self.length
        first, second, _ = phi_functions(self.rates * time)
        start, end = self._heatings(ends)
        found = self._with_held(unknowns, ends.inputs_at(share))
        found[:count] *= np.exp(-self.rates * time)
        found[:count] += time * (first * start + share * second * (end - start))
        return found

    def balance(self, before: Array, after: Array, ends: Ends) -> float:
        """Return the heat balance of a step, as `fesim.march.heat_step.heat_balance` defines it.

        Temperatures enter with their mean over the step, stored heat with its change. The mean
        comes from phi_3, which the step itself does not use.
        """
        thermal, count = self.machine.thermal, self.rates.size
        first, second, third = self.weights
        start, end = self._heatings(ends)
        mean = self._with_held(before, ends.inputs_at(0.5))
        mean[:count] *= first
        mean[:count] += self.length * (second * start + third * (end - start))
        begun = self._with_held(before, ends.inputs[0])
        change = thermal.step / self.length * (after - begun)
        inputs = ends.inputs_at(0.5)[: thermal.inputs.shape[1]]
        return heat_balance(thermal, mean - change, mean, inputs, ends.flow_at(0.5))

    def lacking(self, bend: Array, conducted: Array) -> Array:
        """Return the correction of the unknowns (r + s,) for curved joint heat flows in the step.

        Parameters
        ----------
        bend : ndarray, shape (m,)
            Half of the second derivative of the flows, W/s2.
        conducted : ndarray, shape (m,)
            Conductance times area of each contact element, W/K, with which the end flows respond.
        """
        thermal, count = self.machine.thermal, self.rates.size
        _, second, third = self.weights
        alone = np.zeros(len(thermal.inputs))
        bent = thermal.jump[:, :count].T @ bend
        alone[:count] = -(self.length**3) * (2.0 * third - second) * bent
        answered, _ = heat_step(thermal, alone, np.zeros(thermal.inputs.shape[1]), conducted)
        return answered

    def _heating(self, inputs: Array, flow: Array) -> Array:
        """Heat input of the modes at one time, f, shape (r,)."""
        thermal, count = self.machine.thermal, self.rates.size
        given = thermal.inputs[:count] @ inputs[: thermal.inputs.shape[1]]
        return np.asarray(given - thermal.jump[:, :count].T @ flow)

    def _heatings(self, ends: Ends) -> tuple[Array, Array]:
        start, end = zip(ends.inputs, ends.flow, strict=True)
        return self._heating(*start), self._heating(*end)

    def _with_held(self, unknowns: Array, inputs: Array) -> Array:
        """The unknowns, with the held surfaces, which are last, set from the inputs."""
        thermal, count = self.machine.thermal, self.rates.size
        held = thermal.inputs[count:] @ inputs[: thermal.inputs.shape[1]]
        return np.concatenate([unknowns[:count], held])


def exponential_step(machine: CondensedMachine, rates: Array, length: float) -> ExponentialStep:
    """Compute the weights of a step.

    Parameters
    ----------
    machine : CondensedMachine
        With the modes of a reduced thermal model.
    rates : ndarray, shape (r,)
        Decay rates of the modes, 1/s; the unknowns after the first r are held surfaces.
    length : float
        Length of the step, s.
    """
    thermal, count = machine.thermal, rates.size
    weights = phi_functions(rates * length)
    late = length * weights[1]
    held = len(thermal.inputs) - count
    diagonal = np.concatenate([1.0 / late, np.ones(held)])
    kept = np.concatenate([1.0 / late, np.zeros(held)])
    condensed = with_diagonal(thermal, diagonal, kept)
    return ExponentialStep(length, rates, weights, replace(machine, thermal=condensed))
