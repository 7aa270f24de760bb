"""Change of convection relative to the calibrated machine, on its modes.

Convection is a matrix on the modes, with directions of its own: along each the excess decays over a
step by an exponential, whatever the step. A field at the ambient's temperature does not decay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.machine import Modes


@dataclass(frozen=True, eq=False)
class Convection:
    """Convection as rates (k,) of directions, columns of `turn` (r, k); a field of 1 K, (r,)."""

    rates: Array
    turn: Array
    ambient: Array


def convection_of(modes: Modes) -> Convection:
    """Return the convection of a machine."""
    rates, turn = np.linalg.eigh(modes.film)
    seen = rates > 1e-6 * rates.max()
    rates, turn = rates[seen], turn[:, seen]
    uniform = turn @ ((turn.T @ modes.drive[:, -1]) / rates)
    return Convection(rates, turn, uniform)


def convected(
    convection: Convection, amplitudes: Array, ambient: float, factor: float, length: float
) -> Array:
    """Return the amplitudes (r,) after a step of the convection beyond the calibrated one.

    Parameters
    ----------
    convection : Convection
        As calibrated.
    amplitudes : ndarray, shape (r,)
        Before.
    ambient : float
        K.
    factor : float
        The convection relative to the calibrated one.
    length : float
        s.
    """
    beyond = amplitudes - ambient * convection.ambient
    lost = np.expm1((1.0 - factor) * length * convection.rates)
    after: Array = amplitudes + convection.turn @ (lost * (convection.turn.T @ beyond))
    return after
