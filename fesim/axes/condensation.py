"""Elastic condensation at aligned positions of axes, from pieces condensed once.

Every piece is factorised once and solved for its own rows: pads, stations of the guides, anchors,
probes. If all axes are aligned, each contact element is tied to its station: a small dense system
(`fesim.solid.substructures.tied`), equivalent to a machine meshed at that position. Several axes
have too many such combinations to tie them all: each is tied when it is first needed. Between
aligned positions the tied matrices are interpolated (`fesim.axes.guideway`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, csr_array, eye_array, vstack

from fesim.axes.operators import GuidedOperators, coupled
from fesim.solid.condensation import ElasticCondensation, elastic_condensation
from fesim.solid.substructures import Substructure, UntiedCondensation, tied, untied
from thermojoint.artefacts.arrays import Array

#: Index of the aligned position of every axis.
Corner = tuple[int, ...]
#: Numbers in the stored condensations (0.8 GB), and least number of condensations.
KEPT_NUMBERS, KEPT = 100_000_000, 64


@dataclass(frozen=True, eq=False)
class Ties:
    """Ties at aligned positions, made when first needed: m contact elements, n stations."""

    #: Shape (q,): springs of the rows condensed apart, N/m: zero for 3 m of pads and 3 n of
    #: stations, then those of anchors.
    springs: Array
    #: Shape (q + p, q): compliance of these rows and p probes, m/N.
    compliance: Array
    #: Shape (k, m): as in `fesim.axes.operators.GuidedOperators`.
    place: tuple[NDArray[np.int64], ...]
    #: Shape (m,): areas of the contact elements, m2.
    area: Array
    #: Shape (3 m,): stiffness of the reference springs, Pa/m.
    reference: Array

    def __post_init__(self) -> None:
        """Create the caches."""
        probes = len(self.compliance) - self.springs.size
        ties = self.reference.size + self.springs.size - self.guided
        each = (self.reference.size + probes) * (self.reference.size + ties + probes)
        kept = max(KEPT, KEPT_NUMBERS // each)
        for name, made in (("_own", self._own_rows), ("_tied", self._condensed)):
            object.__setattr__(self, name, lru_cache(maxsize=kept)(made))

    def __reduce__(self) -> tuple[type[Ties], tuple[object, ...]]:
        """Return the constructor and arguments for pickling."""
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
        """Return ties at an aligned position, then probes, on the rows condensed apart."""
        rows: csr_array = vars(self)["_own"](corner)
        return rows

    def at(self, corner: Corner) -> ElasticCondensation:
        """Return the condensation at an aligned position, on its rows' untied displacements."""
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
    """Condensations at aligned positions, on the displacements `felt` there of r temperatures.

    They are small, because the columns are the untied displacements of their own rows and of the
    probes, not the temperatures.
    """

    #: Ties of the structure.
    ties: Ties
    #: Shape (q + p, r): displacement of the rows condensed apart and the probes, m/K.
    thermal: Array
    #: Factor on the elastic modulus of everything in `ties`.
    modulus: float = 1.0

    def __getitem__(self, corner: Corner, /) -> ElasticCondensation:
        elastic = self.ties.at(corner)
        return elastic if self.modulus == 1.0 else elastic.strained(self.modulus, 1.0)

    def alone(self, temperatures: Array, /) -> Array:
        """Return untied displacements of all rows: pads, stations, anchors and probes."""
        return np.asarray(self.thermal @ temperatures)

    def felt(self, corner: Corner, alone: Array, /) -> Array:
        """Return the displacements of the ties at an aligned position and of the probes."""
        return np.asarray(self.ties.own(corner) @ alone)

    def rows(self, corner: Corner, /) -> NDArray[np.int64]:
        """Return the rows of the untied displacements that `felt` uses."""
        return np.asarray(self.ties.own(corner).indices)

    def turned(self, rows: Callable[[Array], Array]) -> TiedCondensations:
        """Return them on other temperatures; `rows` transforms rows (..., r)."""
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
        Rows of the displacement probes.
    temperatures : int
        n_heat.
    """
    rows = csr_array(vstack([operators.pads.gap, operators.gap], format="csr"))
    return untied(pieces, rows, np.zeros(rows.shape[0]), probes, temperatures)


def condense_aligned(ties: Ties, own: csr_array) -> ElasticCondensation:
    """Return the condensation at an aligned position, on untied displacements of ties and probes.

    Parameters
    ----------
    ties : Ties
        Ties of the structure.
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
