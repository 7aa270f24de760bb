"""What the pads of an axis ride along: elasticity at aligned positions, temperatures of stations.

At an aligned position the machine is that condensed there; between two of them its elasticity is
interpolated. In a step a contact element touches the stations that it passes, each for its share of
the time (docs/moving-axes.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fesim.axes.condensation import between
from fesim.axes.occupation import Shares, weights_at
from fesim.march.passing import Touches
from fesim.solid.condensation import ElasticCondensation
from thermojoint.artefacts.arrays import Array, Flags


@dataclass(frozen=True, eq=False)
class Guideway:
    """Pads of m contact elements at k aligned positions, on n stations; r temperatures.

    Attributes
    ----------
    positions : ndarray, shape (k,)
        Aligned positions of the axis, evenly spaced, ascending, m.
    elastic : tuple of ElasticCondensation
        At each of them.
    temperature : ndarray, shape (m + n, r)
        Mean temperature of each contact element without its station, K, then of each station. Of
        one that rides on nothing, the jump across its joint.
    means : ndarray, shape (m, r)
        Mean of the sides of each contact element, K, a station's part left out.
    place : ndarray of int, shape (k, m)
        Station of each contact element; -1 for none.
    running : ndarray, shape (m,)
        Running friction coefficient times area of each contact element of the meshed part, m2.
    """

    positions: Array
    elastic: tuple[ElasticCondensation, ...]
    temperature: Array
    means: Array
    place: NDArray[np.int64]
    running: Array

    @property
    def count(self) -> int:
        """Number of contact elements."""
        return self.place.shape[1]

    @property
    def riding(self) -> Flags:
        """Which contact elements pass stations, (m,)."""
        return np.asarray(self.place[0] >= 0)

    def elastic_at(self, position: float) -> ElasticCondensation:
        """Return the elastic condensation at a position, m."""
        weights = weights_at(self.positions, position)
        touched = np.flatnonzero(weights)
        if touched.size == 1:
            return self.elastic[touched[0]]
        first, second = touched
        return between(self.elastic[first], self.elastic[second], float(weights[second]))

    def below(self, weights: Array) -> Array:
        """Return the mean temperature below each contact element, (m, r), by weights (k,)."""
        under = np.zeros_like(self.means)
        for k in np.flatnonzero(weights):
            under[self.riding] += (
                weights[k] * self.temperature[self.count + self.place[k, self.riding]]
            )
        return under

    def jump(self, weights: Array) -> Array:
        """Return the temperature jump of each contact element, K, (m, r), by weights (k,)."""
        return np.asarray(self.temperature[: self.count] - self.below(weights))

    def mean(self, weights: Array) -> Array:
        """Return the mean temperature of its sides likewise."""
        return np.asarray(self.means + 0.5 * self.below(weights))

    def rubbed(self, heat: Array, weights: Array) -> Array:
        """Return what heat of friction (m,), W, gives to the temperatures, (r,).

        One half enters each side.
        """
        return np.asarray(0.5 * heat @ (self.temperature[: self.count] + self.below(weights)))

    def touches(self, shares: Shares) -> Touches:
        """Return the products of rows whose means over a step are those of `shares`."""
        every, riding = np.arange(self.count), np.flatnonzero(self.riding)
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

    def turned(
        self,
        rows: Callable[[Array], Array],
        elastic: Callable[[ElasticCondensation], ElasticCondensation],
    ) -> Guideway:
        """Return it with changed rows (…, r) of temperatures, and changed elasticity."""
        return replace(
            self,
            elastic=tuple(map(elastic, self.elastic)),
            temperature=rows(self.temperature),
            means=rows(self.means),
        )


def standing(guideway: Guideway, position: float) -> Shares:
    """Return the shares of aligned positions while an axis stands at a position, m."""
    weights = weights_at(guideway.positions, position)
    return Shares(weights, weights**2, weights[1:] * weights[:-1])
