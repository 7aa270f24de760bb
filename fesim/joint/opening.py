"""Normal laws of joints without preload, with openings counted from first contact.

In the surface model there is no first contact: its pressure decays without end. Here rough surfaces
are in contact from `TOUCHING` of the hardness, at a distance of 4.75 roughnesses; beyond, the
pressure is smaller and soon zero. For a law of the approach, first contact is at zero approach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erfcinv

from fesim.joint.law import BackBurdekinLaw, SurfaceNormalLaw
from thermojoint.artefacts.arrays import Array

#: p/H at the first contact of two rough surfaces.
TOUCHING = 1e-6


@dataclass(frozen=True, eq=False)
class OpenLaw:
    """A joint without preload: pressure from `law`, openings counted from the start of a march."""

    #: Its preload is the reference pressure, which defines springs and tangential stiffness.
    law: SurfaceNormalLaw | BackBurdekinLaw
    #: Shape (m,): initial opening of each contact element since first contact, m.
    opening: Array

    @property
    def preload(self) -> float:
        """Always 0 Pa."""
        return 0.0

    @property
    def shift(self) -> Array:
        """Initial opening from the state where `law` has its reference pressure, m, shape (m,)."""
        return np.asarray(self.opening + touching_opening(self.law), dtype=np.float64)

    def pressure(self, opening: Array) -> Array:
        """Pressure, Pa."""
        return self.law.pressure(self.shift + opening)

    def slope(self, opening: Array) -> Array:
        """dp/d(opening), Pa/m."""
        return self.law.slope(self.shift + opening)


def touching_distance(roughness: float) -> float:
    """Return the distance of the mean planes of two rough surfaces at first contact, m."""
    return float(np.sqrt(2.0) * roughness * erfcinv(2.0 * TOUCHING))


def touching_opening(law: SurfaceNormalLaw | BackBurdekinLaw) -> float:
    """Return the opening, from the state at its preload, at first contact, m."""
    if isinstance(law, SurfaceNormalLaw):
        return touching_distance(law.roughness) - law.separation
    return float(law.coefficient * law.preload**law.exponent)
