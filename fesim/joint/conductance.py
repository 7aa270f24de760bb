"""Thermal conductances other than Eq. 11: constant, tabulated, open gap.

All of them have continuous derivatives, so that an in-step iteration converges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

#: Stefan-Boltzmann constant, W/(m2 K4).
STEFAN_BOLTZMANN = 5.670374419e-8
#: The mean planes are never nearer than this fraction of their distance at first contact: no law
#: here is valid at such pressures.
NEAREST = 0.05
#: Lower pressures are replaced by this, Pa: its logarithm is finite.
LEAST_PRESSURE = 1e-300


@dataclass(frozen=True)
class FixedConductance:
    """The same value at every pressure, also in open joints: a bond, or a measured mean."""

    #: Conductance, W/(m2 K).
    value: float

    def __call__(self, pressure: Array) -> Array:
        """Conductance (m,), W/(m2 K)."""
        return np.full(np.shape(pressure), self.value)


@dataclass(frozen=True, eq=False)
class ConductanceTable:
    """A table over pressure and optionally temperature.

    Between its pressures ln h is a monotone cubic (Fritsch & Carlson 1980) in ln p, and beyond its
    ends a straight line with the slope there: a power law, like Eq. 11. Between temperatures ln h
    is a cubic with finite-difference slopes; beyond the ends the slope decays over the width of the
    last interval, so that h stays bounded. The derivative is continuous everywhere.

    Raises
    ------
    InputError
        Pressures or temperatures do not increase, or values are not positive or decrease with the
        pressure.
    """

    #: Shape (n,): pressures, increasing, Pa.
    pressures: Array
    #: Shape (k,): temperatures above the initial ambient, increasing, K; one entry if h does not
    #: depend on it.
    rises: Array
    #: Shape (k, n): h, W/(m2 K), positive.
    values: Array

    def __post_init__(self) -> None:
        """Check the table."""
        for what, ends in (("pressure_MPa", self.pressures), ("rise_K", self.rises)):
            if not (np.isfinite(ends).all() and (np.diff(ends) > 0.0).all()):
                raise InputError(f"conductance table: {what} must rise strictly; sort the rows")
        if self.pressures.size < 2 or not (self.pressures > 0.0).all():
            raise InputError(
                "conductance table: needs two pressures or more, all above 0; it is extrapolated "
                "below the first"
            )
        if not (np.isfinite(self.values).all() and (self.values > 0.0).all()):
            raise InputError("conductance table: conductance_W_m2K must be above 0; fix the rows")
        if (np.diff(self.values, axis=1) < 0.0).any():
            raise InputError(
                "conductance table: conductance_W_m2K falls as pressure_MPa rises; correct the rows"
            )
        # Imported here because it loads scipy.optimize, which few cases need.
        from scipy.interpolate import PchipInterpolator

        logarithm = np.log(self.pressures)
        curves = PchipInterpolator(logarithm, np.log(self.values), axis=1)
        object.__setattr__(self, "_curves", curves)
        object.__setattr__(self, "_slopes", curves.derivative())

    @property
    def knows_temperature(self) -> bool:
        """Whether it depends on temperature."""
        return self.rises.size > 1

    def __call__(self, pressure: Array) -> Array:
        """Conductance (m,), W/(m2 K), at pressures (m,), Pa, and the initial ambient."""
        return self.at(pressure, np.zeros(np.shape(pressure)))

    def at(self, pressure: Array, rise: Array) -> Array:
        """Conductance (m,), W/(m2 K).

        Parameters
        ----------
        pressure : ndarray, shape (m,)
            Contact pressure, Pa.
        rise : ndarray, shape (m,)
            Mean temperature of the two sides above the initial ambient, K.
        """
        asked = np.log(np.maximum(pressure, LEAST_PRESSURE))
        ends = np.log(self.pressures[[0, -1]])
        inside = np.clip(asked, *ends)
        curves, slopes = vars(self)["_curves"], vars(self)["_slopes"]
        by_rise = curves(inside) + slopes(inside) * (asked - inside)
        if not self.knows_temperature:
            return np.asarray(np.exp(by_rise[0]))
        return np.asarray(np.exp((by_rise * self._shares(rise)).sum(axis=0)))

    def _shares(self, rise: Array) -> Array:
        """Weight of each temperature's row, shape (k, m); they sum to one."""
        from scipy.interpolate import CubicHermiteSpline

        unit = np.eye(self.rises.size)
        spline = CubicHermiteSpline(
            self.rises, unit, np.gradient(unit, self.rises, axis=0, edge_order=1)
        )
        inside = np.clip(rise, self.rises[0], self.rises[-1])
        width = np.where(
            rise < inside, self.rises[1] - self.rises[0], self.rises[-1] - self.rises[-2]
        )
        beyond = rise - inside
        decayed = np.sign(beyond) * width * -np.expm1(-np.abs(beyond) / width)
        return np.asarray((spline(inside) + spline(inside, 1) * decayed[:, None]).T)


@dataclass(frozen=True, eq=False)
class GapConductance:
    """Heat transfer in parallel with the contact: gas in the gap, and radiation.

    h = k_g / (Y + M) + h_r with the distance Y of the mean planes (Yovanovich 1981): that at first
    contact plus the opening. In a pressed joint its law determines their approach.
    """

    #: k_g of the gas, W/(m K).
    conductivity: float
    #: M: temperature jump distances of both sides, m.
    jump: float
    #: h_r if it is linearised, W/(m2 K).
    radiation: float
    #: Distance of the mean planes at first contact, m.
    touching: float
    #: Shape (m,): opening since first contact at gap zero, m: negative in a preloaded joint.
    opening: float | Array
    #: Whether the mean planes of a pressed joint continue to approach each other.
    follows: bool
    #: Exchange factor of radiation that is not linearised, W/(m2 K4).
    exchange: float = 0.0
    #: Initial ambient, K.
    ambient: float = 0.0

    def __call__(self, gap: Array, rise: Array, jump: Array) -> Array:
        """Conductance (m,), W/(m2 K).

        Parameters
        ----------
        gap : ndarray, shape (m,)
            Gap relative to the initial state, m.
        rise, jump : ndarray, shape (m,)
            Mean temperature of the sides above the initial ambient, and their difference, K.
        """
        opening = self.opening + gap
        if not self.follows:
            opening = np.maximum(opening, 0.0)
        distance = np.maximum(self.touching + opening, NEAREST * self.touching)
        mean = self.ambient + rise
        # (Ta^4 - Tb^4) / (Ta - Tb)
        secant = 4.0 * self.exchange * mean * (mean**2 + 0.25 * jump**2)
        return self.conductivity / (distance + self.jump) + self.radiation + secant


def exchange_factor(first: float, second: float) -> float:
    """Return sigma / (1/e1 + 1/e2 - 1), W/(m2 K4), of parallel planes from their emissivities."""
    return STEFAN_BOLTZMANN / (1.0 / first + 1.0 / second - 1.0)
