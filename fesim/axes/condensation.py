"""Elastic condensation at aligned positions of axes, from pieces condensed once.

Every piece is factorised once and solved for its own rows: pads, stations of the guides, anchors,
probes. Where all axes are aligned, each contact element is tied to its station, which is a small
dense system (`fesim.solid.substructures.tied`), as in a machine that is meshed there. Several axes
have too many such combinations to tie them all: each is tied when it is first wanted.
Between aligned positions the tied matrices are interpolated (`fesim.axes.guideway`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, csr_array, eye_array, vstack

from fesim.axes.operators import GuidedOperators, coupled, untied_springs
from fesim.solid.condensation import ElasticCondensation, elastic_condensation
from fesim.solid.substructures import Substructure, UntiedCondensation, tied, untied
from thermojoint.artefacts.arrays import Array

#: Which aligned position of every axis.
Corner = tuple[int, ...]
#: Numbers in the condensations that are kept: 0.8 GB; and how many are in any case.
KEPT_NUMBERS, KEPT = 100_000_000, 64


@dataclass(frozen=True, eq=False)
class Ties:
    """What aligned positions tie, each when it is first wanted: m contact elements, n stations."""

    #: Shape (q,): of the rows condensed apart, N/m: none of 3 m of pads and 3 n of stations, then
    #: of anchors.
    springs: Array
    #: Shape (q + p, q): of these rows and p probes, m/N.
    compliance: Array
    #: Shape (k, m): as in `fesim.axes.operators.GuidedOperators`.
    place: tuple[NDArray[np.int64], ...]
    #: Shape (m,): of the contact elements, m2.
    area: Array
    #: Shape (3 m,): stiffness of the reference springs, Pa/m.
    reference: Array

    def __post_init__(self) -> None:
        """Keep what is tied."""
        probes = len(self.compliance) - self.springs.size
        ties = self.reference.size + self.springs.size - self.guided
        each = (self.reference.size + probes) * (self.reference.size + ties + probes)
        kept = max(KEPT, KEPT_NUMBERS // each)
        for name, made in (("_own", self._own_rows), ("_tied", self._condensed)):
            object.__setattr__(self, name, lru_cache(maxsize=kept)(made))

    def __reduce__(self) -> tuple[type[Ties], tuple[object, ...]]:
        """Return what makes it anew in another process."""
        return Ties, tuple(getattr(self, field.name) for field in fields(self))

    @property
    def guided(self) -> int:
        """Number of rows of pads and stations."""
        return 3 * (self.area.size + self.stations)

    @property
    def stations(self) -> int:
        """Number of stations."""
        return 1 + max(int(place.max(initial=-1)) for place in self.place)

    def own(self, corner: Corner) -> csr_array:
        """Return ties where all axes are aligned, then probes, on the rows condensed apart."""
        rows: csr_array = vars(self)["_own"](corner)
        return rows

    def at(self, corner: Corner) -> ElasticCondensation:
        """Return the condensation where all axes are aligned, on what its own rows do untied."""
        elastic: ElasticCondensation = vars(self)["_tied"](corner)
        return elastic

    def _own_rows(self, corner: Corner) -> csr_array:
        ties = coupled(self.place, corner, self.stations, self.springs.size - self.guided)
        probes = eye_array(len(self.compliance) - self.springs.size)
        return csr_array(block_diag([ties, probes], format="csr"))

    def _condensed(self, corner: Corner) -> ElasticCondensation:
        return condense_aligned(self, self.own(corner))


@dataclass(frozen=True, eq=False)
class TiedCondensations:
    """Condensations where all axes are aligned, on what is `felt` there of r temperatures.

    They are small, because each is on its own rows and the probes as the temperatures displace them
    untied, not on the temperatures.
    """

    #: Of the structure.
    ties: Ties
    #: Shape (q + p, r): what the temperatures do to the rows condensed apart and the probes, m/K.
    thermal: Array
    #: Factor on the elastic modulus of everything that `ties` has.
    modulus: float = 1.0

    def __getitem__(self, corner: Corner, /) -> ElasticCondensation:
        elastic = self.ties.at(corner)
        return elastic if self.modulus == 1.0 else elastic.strained(self.modulus, 1.0)

    def alone(self, temperatures: Array, /) -> Array:
        """Return displacements of all rows, pads, stations, anchors and probes, untied."""
        return np.asarray(self.thermal @ temperatures)

    def felt(self, corner: Corner, alone: Array, /) -> Array:
        """Return the displacements of the ties at aligned positions and of the probes."""
        return np.asarray(self.ties.own(corner) @ alone)

    def rows(self, corner: Corner, /) -> NDArray[np.int64]:
        """Return which rows of the untied displacements `felt` takes."""
        return np.asarray(self.ties.own(corner).indices)

    def turned(self, rows: Callable[[Array], Array]) -> TiedCondensations:
        """Return them on other temperatures, by what becomes of rows (..., r)."""
        return replace(self, thermal=rows(self.thermal))

    def strained(self, modulus: float, expansion: float) -> TiedCondensations:
        """Return them with factors on elastic modulus and thermal expansion."""
        thermal, modulus = expansion * self.thermal, modulus * self.modulus
        return replace(self, thermal=thermal, modulus=modulus)

    def with_probes(self, probes: Sequence[int]) -> TiedCondensations:
        """Return them with some of their probes."""
        size = self.ties.springs.size
        rows = np.concatenate([np.arange(size), size + np.array(probes, dtype=np.int64)])
        ties = replace(self.ties, compliance=self.ties.compliance[rows])
        return replace(self, ties=ties, thermal=self.thermal[rows])


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


def condense_aligned(ties: Ties, own: csr_array) -> ElasticCondensation:
    """Return the condensation where all axes are aligned, on what ties and probes do untied.

    Parameters
    ----------
    ties : Ties
        Of the structure.
    own : scipy.sparse.csr_array, shape (t + p, q + p)
        The t ties there, and the p probes, on the rows condensed apart and the probes.

    Raises
    ------
    InputError
        Neither supports nor joints constrain the structure there.
    """
    springs, reference = ties.springs, ties.reference
    bound = own[: own.shape[0] - len(ties.compliance) + springs.size, : springs.size]
    area = np.tile(ties.area, 3)
    condensed = tied(
        UntiedCondensation(
            np.concatenate([area * reference, springs[ties.guided :]]),
            np.asarray(own @ (bound @ ties.compliance.T).T),
            np.eye(own.shape[0]),
        )
    )
    return elastic_condensation(condensed, ties.area, reference)
