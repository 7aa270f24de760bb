"""A machine with a moving axis: the condensed machine at any position, made of few products.

At an aligned position it is the machine condensed there. Elsewhere the elastic condensation is
interpolated between two neighbours. In the heat step a contact element touches the stations that it
passes, each for its share of the time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from fesim.axes.guideway import Guideway, rubbed
from fesim.axes.occupation import Shares, even
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine
from fesim.march.passing import Passing, Rows
from fesim.solid.condensation import ThermalCondensation
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
    guideway : Guideway
        What its pads ride along.
    rows : Rows
        Temperatures of the guideway, and what heat there does.
    copies : int
        Copies of the meshed part in the whole machine.
    free : int
        Number of modes; the amplitudes after them are those of held surfaces.
    """

    machine: CondensedMachine
    guideway: Guideway
    rows: Rows
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
        shares = even(self.guideway.positions, position, position)
        return self.moving(shares, position, np.zeros_like(self.guideway.running))

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
            self.guideway.elastic_at(position),
            self.machine.contact.laws,
            constraints=self.machine.contact.constraints,
        )
        return replace(
            self.machine,
            thermal=self._thermal(shares.mean, heat),
            contact=contact,
            passing=Passing(self.rows, self.guideway.stations.touches(shares)),
        )

    def _thermal(self, weights: Array, heat: Array) -> ThermalCondensation:
        thermal, guideway = self.machine.thermal, self.guideway
        inputs = thermal.inputs.copy()
        coefficients = guideway.stations.coefficients(weights)
        warmed = rubbed(heat, coefficients) @ guideway.temperature / self.copies
        inputs[: self.free, -1] = warmed[: self.free]
        entering = thermal.balance.entering.copy()
        entering[-1] = heat.sum() / self.copies
        jump, mean = guideway.sides(coefficients)
        return replace(
            thermal,
            inputs=inputs,
            jump=jump,
            mean=mean,
            balance=replace(thermal.balance, entering=entering),
        )
