"""A machine that is unlike its case: its fixed supports give way, and every patch has its film."""

from __future__ import annotations

from dataclasses import dataclass, replace

from fesim.case.schema import Case
from fesim.setup.machine import Setup
from fesim.solid.elasticity import DIRECTIONS
from thermojoint.reduced.films import Film, patches_of
from thermojoint.reduced.machine import ReducedMachine
from thermojoint.reduced.parameters import GIVE
from thermojoint.reduced.supports import Supports, supports_of


@dataclass(frozen=True, eq=False)
class Loosening:
    """Possible additions to the machine of a case, on the modes of its set-up."""

    #: Along `DIRECTIONS`.
    supports: Supports
    #: Of the patches of its surface.
    films: tuple[Film, ...]

    def of(self, machine: ReducedMachine) -> ReducedMachine:
        """Return the machine with these as parameters, its supports with the usual give."""
        rows = [DIRECTIONS.index(axis) for axis in machine.axes]
        supports = self.supports.with_probes(rows)
        elastic = supports.elastic([GIVE] * len(supports.names))
        return replace(machine, elastic=elastic, supports=supports, films=self.films)


def loosening_of(case: Case, setup: Setup) -> Loosening | None:
    """Return the possible additions; None if no support is fixed, or loads, bolts or axes act.

    Parameters
    ----------
    case : Case
        With the reduced thermal model.
    setup : Setup
        Of this case.
    """
    if not case.supports.fixed or case.loads or case.bolts or case.axes:
        return None
    return Loosening(supports_of(case, setup), patches_of(case, setup))
