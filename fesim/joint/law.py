"""The joint law at a contact element: normal pressure, micro-slip friction, conductance (Eq. 11).

Gaps are measured from the preloaded state: opening positive, slip along the two tangents. Tractions
are those of the joint on the gap: a pressure opens it, friction resists its slip.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import erfc, erfcinv

from fesim.joint.conductance import ConductanceTable
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError


class NormalLaw(Protocol):
    """Pressure against opening; the pressure at opening zero is the preload."""

    @property
    def preload(self) -> float:
        """p0, Pa."""
        ...

    def pressure(self, opening: Array) -> Array:
        """Pressure, Pa, never negative."""
        ...

    def slope(self, opening: Array) -> Array:
        """Derivative of the pressure by the opening, Pa/m, never positive."""
        ...


@dataclass(frozen=True)
class SurfaceNormalLaw:
    """Plastic contact of two rough surfaces (Cooper, Mikic & Yovanovich 1969).

    p = (H/2) erfc(Y / (sqrt(2) sigma)) with the mean-plane separation Y = Y0 + opening. It is the
    surface model behind Eq. 11, so that stiffness and conductance belong together.
    """

    #: H, Pa.
    hardness: float
    #: sigma, equivalent standard deviation of the surface heights, m.
    roughness: float
    #: Pressure at opening zero, Pa.
    preload: float

    @property
    def limit(self) -> float:
        """H/2, Pa, at which the mean planes meet and no asperities are left."""
        return 0.5 * self.hardness

    @property
    def separation(self) -> float:
        """Y0: mean-plane separation at the preload, m."""
        return float(np.sqrt(2.0) * self.roughness * erfcinv(2.0 * self.preload / self.hardness))

    def pressure(self, opening: Array) -> Array:
        """Pressure, Pa."""
        scaled = (self.separation + opening) / (np.sqrt(2.0) * self.roughness)
        return 0.5 * self.hardness * erfc(scaled)

    def slope(self, opening: Array) -> Array:
        """dp/d(opening), Pa/m."""
        scaled = (self.separation + opening) / (np.sqrt(2.0) * self.roughness)
        # Beyond 26 the exponential underflows: the joint is open and has no stiffness.
        bell = np.exp(-np.minimum(scaled**2, 700.0))
        return -self.hardness * bell / (np.sqrt(2.0 * np.pi) * self.roughness)


@dataclass(frozen=True)
class BackBurdekinLaw:
    """Measured machine-tool joints: approach = c p^m (Back, Burdekin & Cowley 1973)."""

    #: c, m/Pa^m.
    coefficient: float
    #: m, between 0 and 1; 0.5 for most scraped and ground joints.
    exponent: float
    #: Pressure at opening zero, Pa.
    preload: float

    def _approach(self, opening: Array) -> Array:
        at_preload = self.coefficient * self.preload**self.exponent
        return np.maximum(at_preload - opening, 0.0) / self.coefficient

    def pressure(self, opening: Array) -> Array:
        """Pressure, Pa."""
        return self._approach(opening) ** (1.0 / self.exponent)

    def slope(self, opening: Array) -> Array:
        """dp/d(opening), Pa/m."""
        power, approach = 1.0 / self.exponent, self._approach(opening)
        # 0^0 is 1: with an exponent of 1 an open joint would keep its stiffness.
        return np.where(approach > 0.0, -power / self.coefficient * approach ** (power - 1.0), 0.0)


@dataclass(frozen=True)
class Friction:
    """Regularised Coulomb friction: elastic up to mu p, then sliding."""

    #: mu; zero is frictionless. An open joint always slides.
    coefficient: float
    #: k_t: tangential stiffness while it sticks, Pa/m.
    stiffness: float


@dataclass(frozen=True)
class JointLaw:
    """Properties of the joint at a contact element.

    Raises
    ------
    InputError
        The pressure at opening zero is not the preload.
    """

    #: Pressure against opening.
    normal: NormalLaw
    #: Shear traction against slip.
    friction: Friction
    #: From pressure (Pa) to contact conductance, W/(m2 K).
    conductance: Callable[[Array], Array]
    #: Law whose state at opening zero defines springs, tangential stiffness and relative errors;
    #: default `normal`. A joint without preload has no stiffness there.
    reference: NormalLaw | None = None
    #: From opening since the start (m), rise and jump (K) as for `conducts` to the conductance of
    #: the gap in parallel with the contact, W/(m2 K).
    gap: Callable[[Array, Array, Array], Array] | None = None

    def __post_init__(self) -> None:
        """Check the assumptions on the normal law."""
        at_rest = float(self.normal.pressure(np.zeros(1))[0])
        # Without preload the pressure of rough surfaces at rest is almost zero, but not exactly.
        if self.preload > 0.0 and abs(at_rest - self.preload) > 1e-9 * self.preload:
            raise InputError(
                f"joint law: the pressure at opening zero is {at_rest:g} Pa, the preload "
                f"{self.preload:g} Pa; make them equal in the normal law"
            )

    @property
    def preload(self) -> float:
        """p0: that of the normal law, Pa."""
        return self.normal.preload

    @property
    def reference_pressure(self) -> float:
        """Preload, or the reference pressure if there is none, Pa."""
        return (self.reference or self.normal).preload

    @property
    def pressure_limit(self) -> float:
        """Pressure beyond which the normal law is invalid, Pa."""
        normal = self.reference or self.normal
        return normal.limit if isinstance(normal, SurfaceNormalLaw) else math.inf

    @property
    def stiffness(self) -> tuple[float, float, float]:
        """Normal and tangential stiffness at the preload while the joint sticks, Pa/m."""
        normal = -float((self.reference or self.normal).slope(np.zeros(1))[0])
        return normal, self.friction.stiffness, self.friction.stiffness

    @property
    def conducts_by_pressure(self) -> bool:
        """Whether the conductance depends on the pressure alone."""
        return self.gap is None and not self._knows_temperature

    @property
    def _knows_temperature(self) -> bool:
        table = self.conductance
        return isinstance(table, ConductanceTable) and table.knows_temperature

    def conducts(self, pressure: Array, opening: Array, rise: Array, jump: Array) -> Array:
        """Conductance of contact and gap together, W/(m2 K), shape (m,).

        Parameters
        ----------
        pressure, opening, rise, jump : ndarray, shape (m,)
            Pressure, Pa; opening since the start, m; mean temperature of both sides above the
            initial ambient, K; their difference, K.
        """
        table = self.conductance
        if isinstance(table, ConductanceTable):
            contact = table.at(pressure, rise)
        else:
            contact = table(pressure)
        return contact if self.gap is None else contact + self.gap(opening, rise, jump)


def stiffness_at_rest(laws: Sequence[tuple[JointLaw, int]]) -> Array:
    """Return the stiffness (3 m,) of joints at their preload while they stick, Pa/m.

    Parameters
    ----------
    laws : sequence of (JointLaw, int)
        The law of each joint and its number of contact elements.
    """
    parts = [np.tile(np.reshape(law.stiffness, (3, 1)), count) for law, count in laws]
    return np.concatenate([np.empty((3, 0)), *parts], axis=1).ravel()


#: Rows of a tangent: entries 00, 10, 20, 11, 12, 22 of dz_i/dg_j. Shear does not change the
#: pressure, and the part of the shears is symmetric.
NORMAL, FIRST, SECOND, ALONG, CROSS, ACROSS = range(6)


@dataclass(frozen=True)
class Traction:
    """The law at one state of the gap; m contact elements."""

    #: Shape (3, m): z: pressure above the preload, and the two shear tractions on the gap, Pa.
    value: Array
    #: Shape (6, m): dz_i/dg_j, Pa/m: rows `NORMAL` to `ACROSS`.
    tangent: Array
    #: Shape (2, m): irreversible slip after the step, m.
    slip: Array


def tangent_matrix(tangent: Array) -> Array:
    """Return dz_i/dg_j, shape (3, 3, m), from the rows `NORMAL` to `ACROSS` (6, m) of a tangent."""
    normal, first, second, along, cross, across = tangent
    nothing = np.zeros_like(normal)
    return np.array([[normal, nothing, nothing], [first, along, cross], [second, cross, across]])


def evaluate(law: JointLaw, gap: Array, slip: Array) -> Traction:
    """Return tractions and their consistent tangent by return mapping.

    Parameters
    ----------
    law : JointLaw
        The law.
    gap : ndarray, shape (3, m)
        Opening and tangential relative displacements, m.
    slip : ndarray, shape (2, m)
        Irreversible slip at the start of the step, m.
    """
    pressure, slope = law.normal.pressure(gap[0]), law.normal.slope(gap[0])
    stiffness, limit = law.friction.stiffness, law.friction.coefficient
    trial = -stiffness * (gap[1:] - slip)
    size = np.hypot(trial[0], trial[1])
    bound = limit * pressure
    # A joint without pressure or friction slides even before it has moved.
    sliding = (size > bound) | (bound == 0.0)
    direction = np.divide(trial, size, out=np.zeros_like(trial), where=size > 0.0)
    shear = np.where(sliding, bound * direction, trial)
    # Sticking: -k_t I. Sliding: the traction turns with the slip and grows with pressure only.
    ratio = np.divide(bound, size, out=np.zeros_like(size), where=sliding & (size > 0.0))
    along, across = direction
    tangent = np.empty((6, gap.shape[1]))
    tangent[NORMAL] = slope
    tangent[FIRST : SECOND + 1] = np.where(sliding, limit * slope * direction, 0.0)
    tangent[ALONG] = -stiffness * np.where(sliding, ratio * (1.0 - along * along), 1.0)
    tangent[CROSS] = -stiffness * np.where(sliding, ratio * (0.0 - along * across), 0.0)
    tangent[ACROSS] = -stiffness * np.where(sliding, ratio * (1.0 - across * across), 1.0)
    new_slip = np.where(sliding, gap[1:] + shear / stiffness, slip)
    return Traction(np.stack([pressure - law.preload, *shear]), tangent, new_slip)


def harmonic_conductivity(first: Array, second: Array) -> Array:
    """k_h = 2 k1 k2 / (k1 + k2) (with Eq. 11), W/(m K), at every contact element."""
    return 2.0 * first * second / (first + second)


@dataclass(frozen=True, eq=False)
class PowerLawConductance:
    """h_c = factor (p/H)^exponent, W/(m2 K): Eq. 11 of one joint."""

    #: Shape (m,): C (m/sigma) k_h, W/(m2 K).
    factor: float | Array
    #: H, Pa.
    hardness: float
    #: n.
    exponent: float

    def __call__(self, pressure: Array) -> Array:
        """Conductance, W/(m2 K), at pressures (m,), Pa."""
        return self.factor * (pressure / self.hardness) ** self.exponent


def power_law_conductance(
    constant: float,
    exponent: float,
    slope: float,
    roughness: float,
    conductivity: float | Array,
    hardness: float,
) -> PowerLawConductance:
    """Eq. 11: h_c = C (m/sigma) k_h (p/H)^n, W/(m2 K), as a function of the pressure (Pa).

    C and n are 1.45 and 0.985 (Cooper, Mikic & Yovanovich 1969) or 1.25 and 0.95 (Yovanovich 1982).
    """
    return PowerLawConductance(constant * slope / roughness * conductivity, hardness, exponent)


def exact_conductance(
    slope: float, roughness: float, conductivity: float | Array, hardness: float
) -> Callable[[Array], Array]:
    """Conductance of the surface model itself, to which Eq. 11 is a fit (CMY 1969).

    h_c = k_h (m/sigma) exp(-x^2/2) / (2 sqrt(2 pi) [1 - sqrt(p/H)]^1.5), P/H = erfc(x/sqrt 2)/2.

    Raises
    ------
    InputError
        When called with a pressure of half the hardness or more, beyond the range of the model.
    """
    factor = slope / roughness * conductivity / (2.0 * np.sqrt(2.0 * np.pi))

    def conductance(pressure: Array) -> Array:
        share = np.asarray(pressure, dtype=float) / hardness
        if bool((share >= 0.5).any()):
            raise InputError(
                "conductance: a pressure of half the hardness is beyond the CMY model; take "
                'conductance.law = "cmy-1969", or check preload_MPa and hardness_GPa'
            )
        separation = np.sqrt(2.0) * erfcinv(2.0 * np.maximum(share, 1e-300))
        bell = np.where(share > 0.0, np.exp(-0.5 * separation**2), 0.0)
        return factor * bell / (1.0 - np.sqrt(share)) ** 1.5

    return conductance
