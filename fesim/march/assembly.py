"""Tightening of a machine's bolts before any other load.

All bolts are tightened at once. During tightening their forces are prescribed, and the joints
settle under this load. Afterwards the bolts are springs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fesim.march.contact import ContactProblem
from fesim.march.machine import Assembly, CondensedMachine
from fesim.march.settling import first_equilibrium, settle_along
from fesim.solid.bolts import BoltSprings, fastened
from fesim.solid.outputs import MechanicalOutputs
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError


@dataclass(frozen=True)
class Bolts:
    """The bolts of a machine."""

    #: Their names.
    names: tuple[str, ...]
    #: The machine before they are tightened: see `fesim.solid.bolts.fastened`.
    loose: CondensedMachine
    #: Properties of the bolts.
    springs: BoltSprings
    #: Their forces, N, as functions of a step of the bolted machine.
    force: MechanicalOutputs


def tightened(
    names: tuple[str, ...], loose: CondensedMachine, springs: BoltSprings, forces: Array
) -> tuple[CondensedMachine, Bolts]:
    """Tighten bolts; return the machine with them, and the bolts.

    Parameters
    ----------
    names, loose, springs
        As for `Bolts`.
    forces : ndarray, shape (b,)
        Force of each bolt once all are tight, N.

    Raises
    ------
    ConvergenceError
        Joints and supports have no equilibrium under these forces.
    """
    contact, assembly, force = tightened_contact(loose.contact, springs, forces)
    machine = replace(loose, contact=contact, assembly=assembly)
    return machine, Bolts(names, loose, springs, force)


def tightened_contact(
    loose: ContactProblem, springs: BoltSprings, forces: Array
) -> tuple[ContactProblem, Assembly, MechanicalOutputs]:
    """Tighten the bolts of a contact problem; return it with bolts, its start and their forces.

    Parameters
    ----------
    loose : ContactProblem
        Its loads are those of `fesim.solid.bolts.fastened`.
    springs, forces
        As for `tightened`.

    Raises
    ------
    ConvergenceError
        As `tightened`.
    """
    loads, elastic = loose.loads, loose.elastic
    assert loads is not None
    given = loads.gap.shape[1] - len(forces)
    free = replace(loose, loads=None)
    try:
        rest = first_equilibrium(free)
        settled, _ = settle_along(free, rest, loads.gap[:, given:] @ forces)
    except ConvergenceError as error:
        raise ConvergenceError(f"tightening the bolts: {error}") from error
    remainder = settled.traction.value.ravel() + elastic.reference * settled.gap.ravel()
    start = elastic.probe_compliance @ (elastic.area * remainder)
    start = start + loads.probes[:, given:] @ forces
    bolted, influence, force = fastened(elastic, loads, springs, start)
    assembly = Assembly(
        gap=settled.gap,
        slip=settled.traction.slip,
        pressure=loose.preload + settled.traction.value[0],
        remainder=remainder,
        factors=np.concatenate([np.zeros(given), forces, [1.0]]),
    )
    return replace(loose, elastic=bolted, loads=influence), assembly, force
