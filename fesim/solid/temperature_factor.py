"""Temperature-dependent properties: a factor on their constant value, and its integral."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class TemperatureFactor:
    """A piecewise linear factor f(T), constant beyond its points."""

    #: Shape (p,): temperatures above the initial ambient, K, strictly increasing.
    rises: Array
    #: Shape (p,): the factor at these, positive.
    values: Array

    @property
    def middle(self) -> float:
        """Mean of the largest and the smallest value; no value deviates by as much as this."""
        return 0.5 * float(self.values.min() + self.values.max())

    @cached_property
    def _sums(self) -> Array:
        """Integral from the first point to each, K."""
        means = 0.5 * (self.values[1:] + self.values[:-1])
        return np.concatenate([[0.0], np.cumsum(means * np.diff(self.rises))])

    def integral(self, temperature: Array) -> Array:
        """Return theta(T), the integral of the factor from 0 to T, K (Kirchhoff's transform)."""
        return np.asarray(self._from_first(temperature) - self._from_first(np.zeros(1)))

    def _from_first(self, temperature: Array) -> Array:
        below = np.clip(np.searchsorted(self.rises, temperature) - 1, 0, None)
        value = np.interp(temperature, self.rises, self.values)
        mean = 0.5 * (self.values[below] + value)
        return np.asarray(self._sums[below] + mean * (temperature - self.rises[below]))


@dataclass(frozen=True)
class ThermalGrowth:
    """Bodies whose expansion depends on temperature: strain alpha0 theta(T), not alpha0 T."""

    #: Temperature unknowns of a body, and its factor.
    parts: tuple[tuple[NDArray[np.int64], TemperatureFactor], ...]

    def strained(self, temperature: Array) -> Array:
        """Return the temperatures (n,) with the same strain at the constant coefficient, K."""
        equivalent = temperature.copy()
        for nodes, factor in self.parts:
            equivalent[nodes] = factor.integral(temperature[nodes])
        return equivalent


def thermal_growth(
    unknowns: dict[str, NDArray[np.int64]], factors: dict[str, TemperatureFactor]
) -> ThermalGrowth | None:
    """Return the expansion of bodies, or None if all of it is proportional to temperature.

    By body name: the temperature unknowns of all, and the factors on the coefficient of expansion
    of those that have one.

    Raises
    ------
    InputError
        Bodies with different factors share nodes.
    """
    for name, factor in factors.items():
        for other, nodes in unknowns.items():
            alike = other in factors and _alike(factor, factors[other])
            if not alike and np.intersect1d(unknowns[name], nodes).size:
                raise InputError(
                    f"expansion_factor: body {name!r} shares nodes with {other!r}; part them by a "
                    "joint, or give both the same factor"
                )
    return ThermalGrowth(tuple((unknowns[b], f) for b, f in factors.items())) if factors else None


def _alike(factor: TemperatureFactor, other: TemperatureFactor) -> bool:
    return np.array_equal(factor.rises, other.rises) and np.array_equal(factor.values, other.values)
