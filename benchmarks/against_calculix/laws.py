"""A normal law that CalculiX and the march both have."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fesim.joint.law import JointLaw
from fesim.march.machine import CondensedMachine
from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class ExponentialLaw:
    """p = p0 exp(-rate opening): the surface law's tail, and CalculiX's EXPONENTIAL."""

    #: 1/m.
    rate: float
    #: p0, Pa.
    preload: float

    def pressure(self, opening: Array) -> Array:
        """Pressure, Pa."""
        return self.preload * np.exp(-self.rate * opening)

    def slope(self, opening: Array) -> Array:
        """dp/d(opening), Pa/m."""
        return -self.rate * self.pressure(opening)


def exponential(law: JointLaw) -> JointLaw:
    """Return `law` with an exponential of the same pressure and stiffness at opening 0."""
    stiffness = -float(law.normal.slope(np.zeros(1))[0])
    return replace(law, normal=ExponentialLaw(stiffness / law.preload, law.preload))


def with_law(machine: CondensedMachine, law: JointLaw) -> CondensedMachine:
    """Return the machine with `law` at its one joint."""
    ((_, count),) = machine.contact.laws
    return machine.with_laws([(law, count)])
