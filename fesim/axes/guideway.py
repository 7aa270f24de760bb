"""What the pads of an axis ride along: elasticity at aligned positions, temperatures of stations.

At an aligned position the machine is that condensed there; between two of them its elasticity is
interpolated. In a step a contact element touches the stations that it passes, each for its share of
the time (docs/moving-axes.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.axes.occupation import Shares, even, weights_at
from fesim.march.passing import Touches
from fesim.solid.condensation import ElasticCondensation
from thermojoint.artefacts.arrays import Array

#: Ways whose passages are kept ready: those of the steps of some runs.
KEPT = 1024


class Passage(NamedTuple):
    """What contact elements pass on an even way.

    Attributes
    ----------
    touches : Touches
        Products of rows that exchange heat.
    coefficients : ndarray, shape (m, m + n)
        Mean b of each contact element: one on its own row, minus a share on each of its stations.
    """

    touches: Touches
    coefficients: Array


@dataclass(frozen=True, eq=False)
class GuideStations:
    """Places on a guide that m contact elements cover at k aligned positions.

    Attributes
    ----------
    positions : ndarray, shape (k,)
        Aligned positions of the axis, evenly spaced, ascending, m.
    place : ndarray of int, shape (k, m)
        Station of each contact element; -1 for none.
    """

    positions: Array
    place: NDArray[np.int64]

    @property
    def count(self) -> int:
        """Number of contact elements."""
        return self.place.shape[1]

    @cached_property
    def size(self) -> int:
        """Number of contact elements and of stations."""
        return self.count + 1 + int(self.place.max(initial=-1))

    @cached_property
    def riding(self) -> NDArray[np.int64]:
        """Contact elements that pass stations."""
        return np.flatnonzero(self.place[0] >= 0)

    def passage(self, start: float, end: float) -> Passage:
        """Return what is passed while the axis moves evenly between two positions, m."""
        return _passage(self, start, end)

    def weights(self, position: float) -> Array:
        """Return the weights (k,) of the aligned positions at a position, m; not to be changed."""
        return _weights(self, position)

    @property
    def everywhere(self) -> Passage:
        """What is passed by an axis that is everywhere equally often."""
        return self.passage(float(self.positions[0]), float(self.positions[-1]))

    def coefficients(self, weights: Array) -> Array:
        """Return b (m, m + n) by weights (k,) of the aligned positions, which add up to one."""
        own = np.eye(self.count, self.size)
        for k in np.flatnonzero(weights):
            own[self.riding, self.count + self.place[k, self.riding]] -= weights[k]
        return own

    def touches(self, shares: Shares) -> Touches:
        """Return the products of rows whose means over a step are those of `shares`."""
        every, riding = np.arange(self.count), self.riding
        row = self.count + self.place[:, riding]
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
        return Touches(element, first, second, mean)


@lru_cache(maxsize=KEPT)
def _passage(stations: GuideStations, start: float, end: float) -> Passage:
    shares = even(stations.positions, start, end)
    return Passage(stations.touches(shares), stations.coefficients(shares.mean))


@lru_cache(maxsize=KEPT)
def _weights(stations: GuideStations, position: float) -> Array:
    return weights_at(stations.positions, position)


@dataclass(frozen=True, eq=False)
class Guideway:
    """Pads of m contact elements on n stations; r temperatures.

    Attributes
    ----------
    stations : GuideStations
        What the contact elements cover.
    elastic : tuple of ElasticCondensation
        At each aligned position.
    temperature : ndarray, shape (m + n, r)
        Mean temperature of each contact element without its station, K, then of each station. Of
        one that rides on nothing, the jump across its joint.
    means : ndarray, shape (m, r)
        Mean of the sides of each contact element, K, a station's part left out.
    running : ndarray, shape (m,)
        Running friction coefficient times area of each contact element of the meshed part, m2.
    """

    stations: GuideStations
    elastic: tuple[ElasticCondensation, ...]
    temperature: Array
    means: Array
    running: Array

    @property
    def positions(self) -> Array:
        """Aligned positions of the axis, m, (k,)."""
        return self.stations.positions

    def elastic_at(self, position: float) -> ElasticCondensation:
        """Return the elastic condensation at a position, m."""
        names = ("compliance", "thermal_gap", "probe_compliance", "probe_thermal")
        mixed = {name: self._mixed(name, position) for name in names}
        return replace(self.elastic[0], **mixed)

    def free_at(self, position: float, temperatures: Array) -> Array:
        """Return gaps without contact (3 m,), then displacements (p,), m, at a position, m.

        Parameters
        ----------
        position : float
            m.
        temperatures : ndarray, shape (r,)
            As the guideway's.
        """
        weights = self.stations.weights(position)
        touched = [(weights[k], self.elastic[k]) for k in np.flatnonzero(weights)]
        return np.concatenate(
            [
                sum(weight * (of.thermal_gap @ temperatures) for weight, of in touched),
                sum(weight * (of.probe_thermal @ temperatures) for weight, of in touched),
            ]
        )

    def contact_at(self, position: float) -> ElasticCondensation:
        """Return the elastic condensation at a position, m, on what is free there (`free_at`)."""
        first = self.elastic[0]
        gaps, probes = first.reference.size, len(first.probe_compliance)
        every = np.eye(gaps + probes)
        return replace(
            first,
            compliance=self._mixed("compliance", position),
            thermal_gap=every[:gaps],
            probe_compliance=self._mixed("probe_compliance", position),
            probe_thermal=every[gaps:],
        )

    def _mixed(self, name: str, position: float) -> Array:
        """A matrix of the condensation, interpolated linearly between aligned positions."""
        weights = self.stations.weights(position)
        touched = np.flatnonzero(weights)
        if touched.size == 1:
            return np.asarray(getattr(self.elastic[touched[0]], name))
        return np.asarray(sum(weights[k] * getattr(self.elastic[k], name) for k in touched))

    def sides(self, coefficients: Array) -> tuple[Array, Array]:
        """Return `sides` per temperature, (m, r), by b (m, m + n)."""
        return sides(coefficients, self.temperature, self.means)

    def friction_heat(self, pressure: Array, way: float, length: float) -> Array:
        """Return the heat (m,), W, of running friction: mu p A v.

        Parameters
        ----------
        pressure : ndarray, shape (m,)
            Pa.
        way : float
            Travelled in the step, m.
        length : float
            Of the step, s.
        """
        return self.running * pressure * way / length

    def turned(
        self,
        rows: Callable[[Array], Array],
        elastic: Callable[[ElasticCondensation], ElasticCondensation],
    ) -> Guideway:
        """Return it with changed rows (..., r) of temperatures, and changed elasticity."""
        return replace(
            self,
            elastic=tuple(map(elastic, self.elastic)),
            temperature=rows(self.temperature),
            means=rows(self.means),
        )


def sides(coefficients: Array, temperature: Array, means: Array) -> tuple[Array, Array]:
    """Return the temperature jump of each contact element, and the mean of its sides, K, (m, ...).

    Parameters
    ----------
    coefficients : ndarray, shape (m, m + n)
        b.
    temperature : ndarray, shape (m + n, ...)
        Of the rows, K.
    means : ndarray, shape (m, ...)
        As `Guideway.means`, K.
    """
    count = len(coefficients)
    return coefficients @ temperature, means - 0.5 * coefficients[:, count:] @ temperature[count:]


def rubbed(heat: Array, coefficients: Array) -> Array:
    """Return the heat (m + n,), W, that friction of (m,), W, gives to each row: half a side."""
    return np.asarray(0.5 * heat @ np.abs(coefficients))
