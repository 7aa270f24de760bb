"""A machine with moving axes: the condensed machine at any positions, from few products.

If all axes are aligned, it is the machine condensed there. Elsewhere the elastic condensation is
interpolated between the neighbours. In the heat step a contact element touches the stations that it
passes, each for its share of the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fesim.axes.corner_table import CornerTables
from fesim.axes.guideway import Guideway, Place
from fesim.axes.occupation import Shares, even
from fesim.axes.row_blocks import BodyRows, body_rows
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine
from fesim.march.passing import Passing, Rows
from fesim.solid.condensation import ThermalCondensation
from thermojoint.artefacts.arrays import Array

#: Largest number of cached machines and joints at positions, and of numbers in their compliances.
KEPT, KEPT_NUMBERS = 128, 20_000_000


@dataclass(frozen=True, eq=False)
class FreeGrowth:
    """Thermal displacements at positions of the axes without contact."""

    guideway: Guideway
    at: Place

    def strained(self, temperature: Array) -> Array:
        """Return `Guideway.free_at`, which `MovingMachine.settling` takes."""
        # Imported here because it loads a compiler, as in `fesim.march.contact.gap_solver`.
        from fesim.march.picked import product_of

        thermal = self.guideway.elastic.thermal
        alone = np.zeros(len(thermal))
        alone[self._rows] = product_of(thermal, self._rows, temperature)
        return self.guideway.free_at(self.at, alone)

    @cached_property
    def _rows(self) -> NDArray[np.int64]:
        return self.guideway.felt_at(self.at)


@dataclass(frozen=True, eq=False)
class MovingMachine:
    """A condensed structure on linear axes; the temperatures are r amplitudes of modes."""

    #: The machine at the first aligned positions, on the displacements of its joints there. Its
    #: last thermal inputs are the frictional heat of motion of each axis, W, for the balance only.
    machine: CondensedMachine
    #: Guides of its pads.
    guideway: Guideway
    #: Temperatures of the guideway, and their response to heat there.
    rows: Rows
    #: Number of copies of the meshed part in the whole machine.
    copies: int

    def __post_init__(self) -> None:
        """Create caches of machines at some positions."""
        kept = max(2, min(KEPT, KEPT_NUMBERS // (1 + self.guideway.first.compliance.size)))
        for name, made in (("_standing", self._made), ("_settling", self._joined)):
            object.__setattr__(self, name, lru_cache(maxsize=kept)(made))

    @cached_property
    def tables(self) -> CornerTables:
        """Combinations of aligned positions, packed for many places at once."""
        return CornerTables(self.guideway)

    @cached_property
    def blocks(self) -> BodyRows:
        """`rows` and untied displacements without zeros, computed once for all marches."""
        return body_rows(self.rows, self.guideway.elastic.thermal)

    def standing(self, at: Place) -> CondensedMachine:
        """Return the machine at rest at positions, m."""
        machine: CondensedMachine = vars(self)["_standing"](at)
        return machine

    def _made(self, at: Place) -> CondensedMachine:
        positions = self.guideway.stations.positions
        shares = [even(one, here, here) for one, here in zip(positions, at, strict=True)]
        machine = self.moving(shares, at, np.zeros(self.guideway.running.size))
        return replace(machine, thermal=self._thermal(shares))

    def settling(self, at: Place) -> ContactProblem:
        """Return the joints at positions, m, on the result of `Guideway.free_at` there."""
        contact: ContactProblem = vars(self)["_settling"](at)
        return contact

    def _joined(self, at: Place) -> ContactProblem:
        contact = self.machine.contact
        elastic = self.guideway.contact_at(at)
        return ContactProblem(elastic, contact.laws, constraints=contact.constraints)

    def moving(self, shares: Sequence[Shares], at: Place, heat: Array) -> CondensedMachine:
        """Return the machine in a step.

        Parameters
        ----------
        shares : sequence of Shares
            Time shares of each axis's aligned positions in the step.
        at : tuple of float
            Positions at the end of the step, m.
        heat : ndarray, shape (m,)
            Frictional heat of motion of each contact element of the meshed part, W.
        """
        stations, thermal = self.guideway.stations, self.machine.thermal
        passing = Passing(self.rows, stations.touches(shares), stations.rubbed(heat, shares))
        # In a step, jumps and means affect conductances only.
        if not self.machine.contact.conducts_by_pressure:
            thermal = self._thermal(shares)
        return replace(
            self.machine,
            thermal=thermal,
            contact=self.settling(at),
            growth=FreeGrowth(self.guideway, at),
            passing=passing,
        )

    def _thermal(self, shares: Sequence[Shares]) -> ThermalCondensation:
        coefficients = self.guideway.stations.coefficients([of_axis.mean for of_axis in shares])
        jump, mean = self.guideway.sides(csr_array(coefficients))
        return replace(self.machine.thermal, jump=jump, mean=mean)
