"""Elastic condensation at every aligned position of an axis, from pieces condensed once.

Every piece is factorised once and solved for its own rows: pads, stations of the guide, anchors,
probes. At an aligned position each contact element is tied to its station, which is a small dense
system (`fesim.solid.substructures.tied`), as in a machine that is meshed there.
Between two aligned positions the tied matrices are interpolated (`fesim.axes.guideway`).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.sparse import csr_array, vstack

from fesim.axes.operators import GuidedOperators, coupled, untied_springs
from fesim.solid.condensation import ElasticCondensation, elastic_condensation
from fesim.solid.substructures import Substructure, UntiedCondensation, tied, untied
from thermojoint.artefacts.arrays import Array


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
    apart: UntiedCondensation, operators: GuidedOperators, reference: Array, position: int
) -> ElasticCondensation:
    """Return the condensation at one aligned position.

    Parameters
    ----------
    apart : UntiedCondensation
        By `condense_apart`; its temperatures may be the amplitudes of modes.
    operators : GuidedOperators
        Pads and stations.
    reference : ndarray, shape (3 m,)
        Stiffness of the reference springs, Pa/m.
    position : int
        Which aligned position.

    Raises
    ------
    InputError
        Neither supports nor joints constrain the structure there.
    """
    area = np.tile(operators.pads.area, 3)
    free = untied_springs(operators).size
    ties = coupled(operators, position, apart.springs.size - free)
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
