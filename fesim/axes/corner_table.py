"""Tied combinations of aligned positions in contiguous arrays.

A combination is small without the terms that follow from its compliance C. With the springs D of
the ties, untied displacements u of ties and v of probes, and compliance P of the probes, thermal
displacements are u - C D u at the gaps and v - P D u at the probes (`fesim.solid.substructures`);
so only the columns of the anchors are stored. C is symmetric, and its rows along an axis, where a
joint does not hold, are zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.axes.condensation import Corner
from fesim.axes.guideway import GuideStations, Guideway
from fesim.axes.occupation import STILL
from fesim.axes.operators import places_at
from fesim.solid.condensation import ElasticCondensation
from thermojoint.artefacts.arrays import Array

#: Largest number of stored packed combinations, and of numbers in them: 0.4 GB.
KEPT, KEPT_NUMBERS = 4096, 50_000_000


class CornerTable(NamedTuple):
    """Combinations of aligned positions of m contact elements, with h restrained gap rows."""

    #: Shape (k, h (h + 1) / 2): upper triangle of C, row after row, m/N.
    compliance: Array
    #: Shape (k, p, h): probe displacement per joint force, m/N.
    probes: Array
    #: Shape (k, h + p, a): gaps, then probes, per untied displacement of each anchor.
    anchored: Array
    #: Shape (k, m): station under each contact element; -1 for none.
    place: NDArray[np.int64]


class Around(NamedTuple):
    """Combinations of aligned positions around n places."""

    #: Distinct combinations.
    corners: list[Corner]
    #: Shape (n, c): index of the combinations around each place.
    touched: NDArray[np.int64]
    #: Shape (n, c): their weights; zero if a combination is not needed.
    weight: Array


def around(stations: GuideStations, places: Array) -> Around:
    """Return the combinations around places (n, axes), m, as `GuideStations.corners` of each."""
    low, share = [], []
    for positions, at in zip(stations.positions, places.T, strict=True):
        last = len(positions) - 1
        scaled = (at - positions[0]) / (positions[-1] - positions[0]) * last
        nearest = np.round(scaled)
        scaled = np.clip(np.where(np.abs(scaled - nearest) <= STILL, nearest, scaled), 0, last)
        below = np.clip(np.floor(scaled).astype(np.int64), 0, last - 1)
        low.append(below)
        share.append(scaled - below)
    axes, shape = len(low), tuple(len(one) for one in stations.positions)
    up = np.array(list(np.ndindex(*(2,) * axes)))
    above, upper = np.array(share).T[:, None], up[None] == 1
    weight = np.where(upper, above, 1.0 - above).prod(axis=2)
    index = np.ravel_multi_index(tuple(np.moveaxis(np.array(low).T[:, None] + up, -1, 0)), shape)
    # A combination of zero weight need not be tied: the heaviest one takes its place.
    heaviest = np.take_along_axis(index, weight.argmax(axis=1)[:, None], axis=1)
    used, touched = np.unique(np.where(weight > 0.0, index, heaviest), return_inverse=True)
    corners = [tuple(map(int, np.unravel_index(one, shape))) for one in used]
    return Around(corners, touched.reshape(index.shape), weight)


class CornerTables:
    """Tables of the requested combinations, each packed when first needed."""

    def __init__(self, guideway: Guideway) -> None:
        elastic, self.guideway = guideway.first, guideway
        gaps, probes = elastic.reference.size, len(elastic.probe_compliance)
        rows = np.flatnonzero(np.diagonal(elastic.compliance) > 0.0)
        count, groups = guideway.stations.count, guideway.stations.groups
        group = np.empty(count, dtype=np.int64)
        for k, own in enumerate(groups):
            group[own] = k
        group = group[rows % count]
        #: Restrained gap rows, one group of contact elements after the other, and start of each
        #: group.
        self.held = rows[np.argsort(group, kind="stable")]
        self.begin = np.searchsorted(np.sort(group), np.arange(len(groups) + 1))
        self._anchors = slice(gaps, elastic.thermal_gap.shape[1] - probes)
        self._upper = np.triu_indices(self.held.size)
        anchors = self._anchors.stop - gaps
        #: Numbers in one combination.
        self.each = self._upper[0].size + (self.held.size + probes) * (probes + anchors)
        kept = min(KEPT, max(1, KEPT_NUMBERS // self.each))
        self._packed = lru_cache(maxsize=kept)(self._pack)
        self._stacked = lru_cache(maxsize=1)(self._stack)

    def table(self, corners: Sequence[Corner]) -> CornerTable:
        """Return the table of some combinations."""
        return self._stacked(tuple(corners))

    def _stack(self, corners: tuple[Corner, ...]) -> CornerTable:
        parts = [self._packed(corner) for corner in corners]
        return CornerTable(*(np.array(of_all) for of_all in zip(*parts, strict=True)))

    def _pack(self, corner: Corner) -> CornerTable:
        elastic: ElasticCondensation = self.guideway.elastic[corner]
        held, anchors = self.held, self._anchors
        return CornerTable(
            elastic.compliance[np.ix_(held, held)][self._upper],
            elastic.probe_compliance[:, held],
            np.vstack([elastic.thermal_gap[held, anchors], elastic.probe_thermal[:, anchors]]),
            places_at(self.guideway.stations.place, corner),
        )
