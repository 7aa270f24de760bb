"""Tightening of a machine's bolts before any other load.

All bolts are tightened at once. While they are tightened, their forces are given, whatever the
structure does: a load under which the joints settle. From then on the bolts are springs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fesim.march.machine import Assembly, CondensedMachine
from fesim.march.settling import initial_state, settle_along
from fesim.solid.bolts import BoltSprings, fastened
from fesim.solid.outputs import MechanicalOutputs
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError


@dataclass(frozen=True)
class Bolts:
    """The bolts of a machine.

    Attributes
    ----------
    names : tuple of str
        Their names.
    loose : CondensedMachine
        The machine before they are tightened: see `fesim.solid.bolts.fastened`.
    springs : BoltSprings
        Properties of the bolts.
    force : MechanicalOutputs
        Their forces, N, as functions of a step of the machine with bolts.
    """

    names: tuple[str, ...]
    loose: CondensedMachine
    springs: BoltSprings
    force: MechanicalOutputs


def tightened(
    names: tuple[str, ...], loose: CondensedMachine, springs: BoltSprings, forces: Array
) -> tuple[CondensedMachine, Bolts]:
    """Tighten bolts; return the machine that marches, and its bolts.

    Parameters
    ----------
    names, loose, springs
        As for `Bolts`.
    forces : ndarray, shape (b,)
        Force of each bolt after all are tight, N.

    Raises
    ------
    ConvergenceError
        Joints and supports find no equilibrium under these forces.
    """
    loads, elastic = loose.contact.loads, loose.contact.elastic
    assert loads is not None
    given = loads.gap.shape[1] - len(forces)
    contact = replace(loose.contact, loads=None)
    free = replace(loose, contact=contact, start=None)
    try:
        settled, _ = settle_along(contact, initial_state(free), loads.gap[:, given:] @ forces)
    except ConvergenceError as error:
        raise ConvergenceError(f"tightening the bolts: {error}") from error
    remainder = settled.traction.value.ravel() + elastic.reference * settled.gap.ravel()
    start = elastic.probe_compliance @ (elastic.area * remainder)
    start = start + loads.probes[:, given:] @ forces
    bolted, influence, force = fastened(elastic, loads, springs, start)
    factors = np.concatenate([np.zeros(given), forces, [1.0]])
    machine = replace(
        loose,
        contact=replace(loose.contact, elastic=bolted, loads=influence),
        assembly=Assembly(
            gap=settled.gap,
            slip=settled.traction.slip,
            pressure=contact.preload + settled.traction.value[0],
            remainder=remainder,
            factors=factors,
        ),
    )
    return machine, Bolts(names, loose, springs, force)
