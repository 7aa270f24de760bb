"""Elastic condensation at aligned positions of axes, from pieces condensed once.

Every piece is factorised once and solved for its own rows: pads, stations of the guides, anchors,
probes. Where all axes are aligned, each contact element is tied to its station, which is a small
dense system (`fesim.solid.substructures.tied`), as in a machine that is meshed there. Several axes
have too many such combinations to tie them all: each is tied when it is first wanted.
Between aligned positions the tied matrices are interpolated (`fesim.axes.guideway`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache, partial
from itertools import product

import numpy as np
from scipy.sparse import csr_array, vstack

from fesim.axes.operators import GuidedOperators, coupled, untied_springs
from fesim.solid.condensation import ElasticCondensation, elastic_condensation
from fesim.solid.substructures import Substructure, UntiedCondensation, tied, untied
from thermojoint.artefacts.arrays import Array

#: Which aligned position of every axis.
Corner = tuple[int, ...]
#: Numbers in the condensations that are kept: 0.8 GB; and how many are in any case.
KEPT_NUMBERS, KEPT = 100_000_000, 64


class TiedCondensations(Mapping[Corner, ElasticCondensation]):
    """The condensation at every combination of aligned positions, tied when it is first wanted.

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
        each = reference.size * (reference.size + apart.thermal.shape[1])
        tie = partial(condense_aligned, apart, operators, reference)
        self._tied = lru_cache(maxsize=max(KEPT, KEPT_NUMBERS // each))(tie)
        self._counts = tuple(map(len, operators.place))

    def __getitem__(self, corner: Corner) -> ElasticCondensation:
        return self._tied(corner)

    def __iter__(self) -> Iterator[Corner]:
        return product(*map(range, self._counts))

    def __len__(self) -> int:
        return math.prod(self._counts)


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
    apart: UntiedCondensation, operators: GuidedOperators, reference: Array, corner: Corner
) -> ElasticCondensation:
    """Return the condensation where all axes are aligned.

    Parameters
    ----------
    apart : UntiedCondensation
        By `condense_apart`; its temperatures may be the amplitudes of modes.
    operators : GuidedOperators
        Pads and stations.
    reference : ndarray, shape (3 m,)
        Stiffness of the reference springs, Pa/m.
    corner : tuple of int
        Which aligned position of each axis.

    Raises
    ------
    InputError
        Neither supports nor joints constrain the structure there.
    """
    area = np.tile(operators.pads.area, 3)
    free = untied_springs(operators).size
    ties = coupled(operators, corner, apart.springs.size - free)
    within = apart.springs.size
    probed = apart.compliance[within:] @ ties.T
    condensed = tied(
        UntiedCondensation(
            np.concatenate([area * reference, apart.springs[free:]]),
            np.vstack([ties @ (ties @ apart.compliance[:within].T).T, probed]),
            np.vstack([ties @ apart.thermal[:within], apart.thermal[within:]]),
        )
    )
    return elastic_condensation(condensed, operators.pads, reference)
