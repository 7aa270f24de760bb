"""A machine with a moving axis: the condensed machine at any position, made of few products.

At an aligned position it is the machine condensed there. Elsewhere the elastic condensation is
interpolated between two neighbours. In the heat step a contact element touches the stations that it
passes, each for its share of the time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fesim.axes.condensation import between
from fesim.axes.occupation import Shares, weights_at
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine
from fesim.march.passing import Passing, Rows
from fesim.solid.condensation import ElasticCondensation, ThermalCondensation
from thermojoint.artefacts.arrays import Array

#: Machines at positions asked for that are kept ready.
KEPT = 64


@dataclass(frozen=True, eq=False)
class MovingMachine:
    """A condensed structure on a linear axis; the temperatures are r amplitudes of modes.

    Attributes
    ----------
    machine : CondensedMachine
        At the first aligned position. Its last thermal input is the heat of running friction, W.
    positions : ndarray, shape (k,)
        Aligned positions of the axis, evenly spaced, ascending, m.
    elastic : tuple of ElasticCondensation
        At each of them.
    rows : Rows
        Temperatures of m contact elements without their stations, then of n stations.
    means : ndarray, shape (m, r)
        Mean temperature of each contact element without its station, K.
    place : ndarray of int, shape (k, m)
        Station of each contact element; -1 for none.
    running : ndarray, shape (m,)
        Running friction coefficient times area of each contact element of the meshed part, m2.
    copies : int
        Copies of the meshed part in the whole machine.
    free : int
        Number of modes; the amplitudes after them are those of held surfaces.
    """

    machine: CondensedMachine
    positions: Array
    elastic: tuple[ElasticCondensation, ...]
    rows: Rows
    means: Array
    place: NDArray[np.int64]
    running: Array
    copies: int
    free: int

    def __post_init__(self) -> None:
        """Keep machines at some positions ready."""
        object.__setattr__(self, "_standing", lru_cache(maxsize=KEPT)(self._made))

    def standing(self, position: float) -> CondensedMachine:
        """Return the machine that stands at a position, m."""
        machine: CondensedMachine = vars(self)["_standing"](position)
        return machine

    def _made(self, position: float) -> CondensedMachine:
        weights = weights_at(self.positions, position)
        shares = Shares(weights, weights**2, weights[1:] * weights[:-1])
        return self.moving(shares, position, np.zeros_like(self.running))

    def moving(self, shares: Shares, position: float, heat: Array) -> CondensedMachine:
        """Return the machine in a step.

        Parameters
        ----------
        shares : Shares
            Of the aligned positions in the step.
        position : float
            At the end of the step, m.
        heat : ndarray, shape (m,)
            Share of each contact element in the heat of running friction; they add up to one, or
            are all zero.
        """
        contact = ContactProblem(
            self._elastic_at(position),
            self.machine.contact.laws,
            constraints=self.machine.contact.constraints,
        )
        return replace(
            self.machine,
            thermal=self._thermal(shares.mean, heat),
            contact=contact,
            passing=self._passing(shares),
        )

    def friction_heat(self, pressure: Array, way: float) -> Array:
        """Return the heat (m,), W, of running friction at pressures (m,), Pa: mu p A v.

        Parameters
        ----------
        pressure : ndarray, shape (m,)
            Pa.
        way : float
            Travelled in the step, m.
        """
        return self.running * pressure * way / self.machine.thermal.step

    def _elastic_at(self, position: float) -> ElasticCondensation:
        weights = weights_at(self.positions, position)
        touched = np.flatnonzero(weights)
        if touched.size == 1:
            return self.elastic[touched[0]]
        first, second = touched
        return between(self.elastic[first], self.elastic[second], float(weights[second]))

    def _passing(self, shares: Shares) -> Passing:
        """Products of each contact element's own row and those of its stations."""
        every = np.arange(self.running.size)
        riding = np.flatnonzero(self.place[0] >= 0)
        row = every.size + self.place[:, riding]
        parts = [(every, every, every, 1.0)]
        for k in np.flatnonzero(shares.mean):
            parts.append((riding, riding, row[k], -shares.mean[k]))
            parts.append((riding, row[k], riding, -shares.mean[k]))
            parts.append((riding, row[k], row[k], shares.square[k]))
        for k in np.flatnonzero(shares.product):
            parts.append((riding, row[k], row[k + 1], shares.product[k]))
            parts.append((riding, row[k + 1], row[k], shares.product[k]))
        element, first, second = (np.concatenate([part[i] for part in parts]) for i in range(3))
        mean = np.concatenate([np.full(part[0].size, part[3]) for part in parts])
        return Passing(self.rows, element, first, second, mean)

    def _thermal(self, weights: Array, heat: Array) -> ThermalCondensation:
        thermal, count = self.machine.thermal, self.running.size
        riding = self.place[0] >= 0
        under = np.zeros_like(self.means)
        for k in np.flatnonzero(weights):
            under[riding] += weights[k] * self.rows.temperature[count + self.place[k, riding]]
        pads = self.rows.temperature[:count]
        # Half of the heat of friction enters each side.
        warmed = 0.5 * heat @ (pads + under) / self.copies
        inputs = thermal.inputs.copy()
        inputs[: self.free, -1] = warmed[: self.free]
        entering = thermal.balance.entering.copy()
        entering[-1] = heat.sum() / self.copies
        return replace(
            thermal,
            inputs=inputs,
            jump=pads - under,
            mean=self.means + 0.5 * under,
            balance=replace(thermal.balance, entering=entering),
        )
