"""Elastic condensation at aligned positions of axes, from pieces condensed once.

Every piece is factorised once and solved for its own rows: pads, stations of the guides, anchors,
probes. Where all axes are aligned, each contact element is tied to its station, which is a small
dense system (`fesim.solid.substructures.tied`), as in a machine that is meshed there. Several axes
have too many such combinations to tie them all: each is tied when it is first wanted.
Between aligned positions the tied matrices are interpolated (`fesim.axes.guideway`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache, partial
from itertools import product
from typing import Protocol

import numpy as np
from scipy.sparse import block_diag, csr_array, eye_array, vstack

from fesim.axes.operators import GuidedOperators, coupled, untied_springs
from fesim.solid.condensation import ElasticCondensation, elastic_condensation
from fesim.solid.substructures import Substructure, UntiedCondensation, tied, untied
from thermojoint.artefacts.arrays import Array

#: Which aligned position of every axis.
Corner = tuple[int, ...]
#: Numbers in the condensations that are kept: 0.8 GB; and how many are in any case.
KEPT_NUMBERS, KEPT = 100_000_000, 64


class Condensations(Protocol):
    """Condensations where all axes are aligned, on what is `felt` there of the temperatures."""

    def __getitem__(self, corner: Corner, /) -> ElasticCondensation:
        """Return the condensation at aligned positions."""

    def items(self) -> Iterable[tuple[Corner, ElasticCondensation]]:
        """Return all of them."""

    def alone(self, temperatures: Array, /) -> Array:
        """Return what temperatures (r, ...) do before anything is tied."""

    def felt(self, corner: Corner, alone: Array, /) -> Array:
        """Return the part of what is `alone` that counts at aligned positions."""


class WholeCondensations(dict[Corner, ElasticCondensation]):
    """Condensations on the temperatures themselves."""

    def alone(self, temperatures: Array, /) -> Array:
        """Return the temperatures."""
        return temperatures

    def felt(self, corner: Corner, alone: Array, /) -> Array:
        """Return the temperatures."""
        return alone


class TiedCondensations:
    """Condensations that are tied when they are first wanted.

    They are small, because each is on its own rows and the probes as the temperatures displace them
    untied, not on the temperatures.

    Parameters
    ----------
    apart : UntiedCondensation
        By `condense_apart`.
    operators : GuidedOperators
        Pads and stations.
    reference : ndarray, shape (3 m,)
        Stiffness of the reference springs, Pa/m.
    """

    def __init__(
        self, apart: UntiedCondensation, operators: GuidedOperators, reference: Array
    ) -> None:
        self._apart, self._place = apart, operators.place
        ties = reference.size + apart.springs.size - untied_springs(operators).size
        probes = len(apart.compliance) - apart.springs.size
        each = (reference.size + probes) * (reference.size + ties + probes)
        kept = max(KEPT, KEPT_NUMBERS // each)
        self._own = lru_cache(maxsize=kept)(partial(_own_rows, operators, apart))
        self._tied = lru_cache(maxsize=kept)(
            lambda corner: condense_aligned(apart, self._own(corner), operators, reference)
        )

    def __getitem__(self, corner: Corner, /) -> ElasticCondensation:
        return self._tied(corner)

    def items(self) -> Iterator[tuple[Corner, ElasticCondensation]]:
        """Yield all condensations; each is tied if it has not been."""
        corners = product(*(range(len(place)) for place in self._place))
        return ((corner, self[corner]) for corner in corners)

    def alone(self, temperatures: Array, /) -> Array:
        """Return displacements of all rows, pads, stations, anchors and probes, untied."""
        return np.asarray(self._apart.thermal @ temperatures)

    def felt(self, corner: Corner, alone: Array, /) -> Array:
        """Return the displacements of the ties at aligned positions and of the probes."""
        return np.asarray(self._own(corner) @ alone)


def _own_rows(operators: GuidedOperators, apart: UntiedCondensation, corner: Corner) -> csr_array:
    """Ties where all axes are aligned, then probes, on the rows condensed apart."""
    springs = apart.springs.size
    ties = coupled(operators, corner, springs - untied_springs(operators).size)
    return csr_array(block_diag([ties, eye_array(len(apart.compliance) - springs)], format="csr"))


def condense_apart(
    pieces: Iterable[Substructure], operators: GuidedOperators, probes: csr_array, temperatures: int
) -> UntiedCondensation:
    """Condense pieces on pads, stations, anchors and probes; see `coupled` for their order.

    Parameters
    ----------
    pieces : iterable of Substructure
        Consumed one by one, and not stored.
    operators : GuidedOperators
        Pads and stations.
    probes : scipy.sparse.csr_array, shape (p, n)
        Rows that give each probed displacement.
    temperatures : int
        n_heat.
    """
    rows = csr_array(vstack([operators.pads.gap, operators.gap], format="csr"))
    return untied(pieces, rows, untied_springs(operators), probes, temperatures)


def condense_aligned(
    apart: UntiedCondensation, own: csr_array, operators: GuidedOperators, reference: Array
) -> ElasticCondensation:
    """Return the condensation where all axes are aligned, on what ties and probes do untied.

    Parameters
    ----------
    apart : UntiedCondensation
        By `condense_apart`.
    own : scipy.sparse.csr_array, shape (q + p, rows + p)
        The q ties there, and the p probes, on the rows condensed apart and the probes.
    operators : GuidedOperators
        Pads and stations.
    reference : ndarray, shape (3 m,)
        Stiffness of the reference springs, Pa/m.

    Raises
    ------
    InputError
        Neither supports nor joints constrain the structure there.
    """
    springs = apart.springs
    ties = own[: own.shape[0] - len(apart.compliance) + springs.size, : springs.size]
    area = np.tile(operators.pads.area, 3)
    free = untied_springs(operators).size
    condensed = tied(
        UntiedCondensation(
            np.concatenate([area * reference, springs[free:]]),
            np.asarray(own @ (ties @ apart.compliance.T).T),
            np.eye(own.shape[0]),
        )
    )
    return elastic_condensation(condensed, operators.pads, reference)
