"""Many simulations on one condensation with different laws and inputs; displacements only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fesim.march.contact import Laws
from fesim.march.machine import CondensedMachine
from fesim.march.settling import at_rest
from fesim.march.stepping import march_along, staggered
from fesim.one_thread import one_thread
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError


def march_many(
    machine: CondensedMachine,
    laws: Sequence[Laws],
    inputs: Array,
) -> Array:
    """March one condensation with many joint laws through many inputs, each from rest.

    The displacements are those of `fesim.march.stepping.march` to 1e-12 m.

    Parameters
    ----------
    machine : CondensedMachine
        The condensation; its own laws are not used.
    laws : sequence of sequence of (JointLaw, int)
        Laws of each march, as in `CondensedMachine`.
    inputs : ndarray, shape (marches, n + 1, k + l)
        Inputs of each march at time zero, where only the load factors matter, and at the end of
        each of its n steps: sources, W; ambient and held surfaces, K; factors of the loads.

    Returns
    -------
    ndarray, shape (marches, n + 1, axes)
        Displacement at rest and at the end of each step, m.

    Raises
    ------
    InputError
        The numbers of laws and inputs differ.
    ConvergenceError
        A step of a march does not converge.
    """
    if len(laws) != len(inputs):
        raise InputError(
            f"march_many: {len(laws)} laws for {len(inputs)} inputs; give one for each"
        )
    displacements = np.empty((*inputs.shape[:2], len(machine.contact.elastic.probe_thermal)))
    with one_thread():
        for own, driven, displacement in zip(laws, inputs, displacements, strict=True):
            own_machine = machine.with_laws(own)
            rest = at_rest(own_machine, driven[0])
            displacement[0] = rest.displacement
            for track in march_along(own_machine, driven[1:], staggered, rest.state):
                displacement[track.index] = track.displacement
    return displacements
