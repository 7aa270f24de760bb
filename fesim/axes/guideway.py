"""Guides of the axes' pads: elasticity at aligned positions, temperatures of stations.

If all axes are aligned, the machine is the one condensed there; between aligned positions its
elasticity is interpolated, linearly along each axis. In a step a contact element touches the
stations that it passes, each for its share of the time (docs/moving-axes.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fesim.axes.condensation import Corner, TiedCondensations
from fesim.axes.occupation import Shares, even, weights_at
from fesim.march.passing import Touches
from fesim.solid.condensation import ElasticCondensation
from thermojoint.artefacts.arrays import Array

#: Position of every axis, m.
Place = tuple[float, ...]
#: Number of cached passages: enough for the steps of some runs.
KEPT = 1024


class Passage(NamedTuple):
    """Contacts of contact elements in a uniform motion."""

    #: Of each axis: time shares of its aligned positions.
    shares: tuple[Shares, ...]
    #: Products of rows that exchange heat.
    touches: Touches
    #: Shape (m, m + n): mean b of each contact element: one on its own row, minus a share on each
    #: of its stations.
    coefficients: Array


@dataclass(frozen=True, eq=False)
class GuideStations:
    """Places on guides that m contact elements cover at aligned positions of each axis."""

    #: Shape (k,): aligned positions of every axis, evenly spaced, ascending, m.
    positions: tuple[Array, ...]
    #: Shape (k, m): of every axis: station of each contact element at each position; -1 for none.
    place: tuple[NDArray[np.int64], ...]

    @property
    def count(self) -> int:
        """Number of contact elements."""
        return self.place[0].shape[1]

    @cached_property
    def size(self) -> int:
        """Number of contact elements and of stations."""
        return self.count + 1 + max(int(place.max(initial=-1)) for place in self.place)

    @cached_property
    def riding(self) -> tuple[NDArray[np.int64], ...]:
        """Contact elements of every axis that pass stations."""
        return tuple(np.flatnonzero(place[0] >= 0) for place in self.place)

    @cached_property
    def groups(self) -> tuple[NDArray[np.int64], ...]:
        """Contact elements of every axis (`riding`), then those of no axis."""
        return *self.riding, np.setdiff1d(np.arange(self.count), np.concatenate(self.riding))

    def ridden(self, ways: Sequence[float]) -> Array:
        """Return the travel (axes, m) of contact elements along each axis from that of axes, m."""
        along = np.zeros((len(ways), self.count))
        for row, riding, way in zip(along, self.riding, ways, strict=True):
            row[riding] = way
        return along

    def passage(self, start: Place, end: Place) -> Passage:
        """Return the contacts while axes move uniformly between two positions, m."""
        return _passage(self, start, end)

    def corners(self, at: Place) -> Sequence[tuple[Corner, float]]:
        """Return the aligned positions around positions, m, with their nonzero weights."""
        return _corners(self, at)

    @property
    def everywhere(self) -> Passage:
        """Contacts of axes that spend equal time at all positions."""
        first, last = (tuple(float(one[end]) for one in self.positions) for end in (0, -1))
        return self.passage(first, last)

    def coefficients(self, weights: Sequence[Array]) -> Array:
        """Return b (m, m + n) from weights (k,) of each axis's positions, which add up to one."""
        own = np.eye(self.count, self.size)
        for riding, place, of_axis in zip(self.riding, self.place, weights, strict=True):
            for k in np.flatnonzero(of_axis):
                own[riding, self.count + place[k, riding]] -= of_axis[k]
        return own

    def touches(self, shares: Sequence[Shares]) -> Touches:
        """Return the products of rows with their means over a step, from each axis's shares."""
        every = np.arange(self.count)
        parts = [(every, every, every, np.ones(self.count))]
        for riding, place, of_axis in zip(self.riding, self.place, shares, strict=True):
            here, next_to = np.flatnonzero(of_axis.mean), np.flatnonzero(of_axis.product)
            rows = self.count + place[:, riding]
            own, under = np.tile(riding, here.size), rows[here].ravel()
            mean, square = (
                np.repeat(values[here], riding.size) for values in (of_axis.mean, of_axis.square)
            )
            parts += [(own, own, under, -mean), (own, under, own, -mean)]
            parts.append((own, under, under, square))
            own, under, above = np.tile(riding, next_to.size), rows[next_to], rows[next_to + 1]
            both = np.repeat(of_axis.product[next_to], riding.size)
            parts.append((own, under.ravel(), above.ravel(), both))
            parts.append((own, above.ravel(), under.ravel(), both))
        return Touches(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def rubbed(self, heat: Array, shares: Sequence[Shares]) -> Array:
        """Return the heat (m + n,), W, of each row from frictional heat (m,), W: half per side."""
        rows = np.zeros(self.size)
        rows[: self.count] = 0.5 * heat
        for riding, place, of_axis in zip(self.riding, self.place, shares, strict=True):
            for k in np.flatnonzero(of_axis.mean):
                rows[self.count + place[k, riding]] += 0.5 * of_axis.mean[k] * heat[riding]
        return rows


@lru_cache(maxsize=KEPT)
def _passage(stations: GuideStations, start: Place, end: Place) -> Passage:
    ways = zip(stations.positions, start, end, strict=True)
    shares = tuple(even(*way) for way in ways)
    means = [of_axis.mean for of_axis in shares]
    return Passage(shares, stations.touches(shares), stations.coefficients(means))


@lru_cache(maxsize=KEPT)
def _corners(stations: GuideStations, at: Place) -> tuple[tuple[Corner, float], ...]:
    weights = [weights_at(*one) for one in zip(stations.positions, at, strict=True)]
    touched = product(*(np.flatnonzero(of_axis).tolist() for of_axis in weights))
    return tuple(
        (corner, math.prod(float(of_axis[k]) for of_axis, k in zip(weights, corner, strict=True)))
        for corner in touched
    )


@dataclass(frozen=True, eq=False)
class Guideway:
    """Pads of m contact elements on n stations; r temperatures."""

    #: Stations of the contact elements.
    stations: GuideStations
    #: Condensations at aligned positions, by the index of the position of each axis.
    elastic: TiedCondensations
    #: Shape (m + n, r): mean temperature of each contact element without its station, K, then of
    #: each station. For one on no axis, the jump across its joint.
    temperature: Array
    #: Shape (m, r): mean of the sides of each contact element, K, without the station's part.
    means: Array
    #: Shape (m,): running friction coefficient times area of each contact element of the meshed
    #: part, m2.
    running: Array

    @property
    def first(self) -> ElasticCondensation:
        """The elastic condensation at the first aligned position of every axis."""
        return self.elastic[(0,) * len(self.stations.positions)]

    def elastic_at(self, at: Place) -> ElasticCondensation:
        """Return the elastic condensation at positions, m, on the temperatures."""
        free, there = self.free_at(at, self.elastic.thermal), self.contact_at(at)
        gaps = there.reference.size
        return replace(there, thermal_gap=free[:gaps], probe_thermal=free[gaps:])

    def free_at(self, at: Place, alone: Array) -> Array:
        """Return gaps without contact (3 m, ...), then displacements (p, ...), m, at positions, m.

        Parameters
        ----------
        at : tuple of float
            Position of every axis, m.
        alone : ndarray, shape (q + p, ...)
            Untied thermal displacements, from `elastic.alone`.
        """
        touched = [
            (weight, self.elastic[corner], self.elastic.felt(corner, alone))
            for corner, weight in self.stations.corners(at)
        ]
        return np.concatenate(
            [
                sum(weight * (of.thermal_gap @ felt) for weight, of, felt in touched),
                sum(weight * (of.probe_thermal @ felt) for weight, of, felt in touched),
            ]
        )

    def felt_at(self, at: Place) -> NDArray[np.int64]:
        """Return the rows of the untied displacements that positions, m, need."""
        corners = self.stations.corners(at)
        return np.unique(np.concatenate([self.elastic.rows(corner) for corner, _ in corners]))

    def contact_at(self, at: Place) -> ElasticCondensation:
        """Return the elastic condensation at positions, m, on the result of `free_at` there."""
        first, every = self.first, self._every
        gaps = first.reference.size
        return replace(
            first,
            compliance=self._mixed("compliance", at),
            thermal_gap=every[:gaps],
            probe_compliance=self._mixed("probe_compliance", at),
            probe_thermal=every[gaps:],
        )

    @cached_property
    def _every(self) -> Array:
        """Identity: gaps, then displacements, as functions of themselves."""
        return np.eye(self.first.reference.size + len(self.first.probe_compliance))

    def _mixed(self, name: str, at: Place) -> Array:
        """A matrix of the condensation, interpolated linearly along each axis."""
        touched = self.stations.corners(at)
        if len(touched) == 1:
            return np.asarray(getattr(self.elastic[touched[0][0]], name))
        parts = (weight * getattr(self.elastic[corner], name) for corner, weight in touched)
        return np.asarray(sum(parts))

    def sides(self, coefficients: Array | csr_array) -> tuple[Array, Array]:
        """Return `sides` per temperature, (m, r), from b (m, m + n)."""
        return sides(coefficients, self.temperature, self.means)

    def friction_heat(self, pressure: Array, way: Array | float, length: float) -> Array:
        """Return the frictional heat (..., m), W, of motion: mu p A v.

        Parameters
        ----------
        pressure : ndarray, shape (m,)
            Contact pressure, Pa.
        way : float or ndarray, shape (..., m)
            Travel of each contact element along its guide in the step, m.
        length : float
            Length of the step, s.
        """
        return np.asarray(self.running * pressure * way / length)

    def turned(self, rows: Callable[[Array], Array]) -> Guideway:
        """Return it on other temperatures; `rows` transforms rows (..., r)."""
        return replace(
            self,
            elastic=self.elastic.turned(rows),
            temperature=rows(self.temperature),
            means=rows(self.means),
        )


def sides(coefficients: Array | csr_array, temperature: Array, means: Array) -> tuple[Array, Array]:
    """Return the temperature jump of each contact element, and the mean of its sides, K, (m, ...).

    Parameters
    ----------
    coefficients : ndarray or scipy.sparse.csr_array, shape (m, m + n)
        b.
    temperature : ndarray, shape (m + n, ...)
        Temperatures of the rows, K.
    means : ndarray, shape (m, ...)
        As `Guideway.means`, K.
    """
    count = coefficients.shape[0]
    return coefficients @ temperature, means - 0.5 * coefficients[:, count:] @ temperature[count:]
