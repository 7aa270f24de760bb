"""Temperature-dependent heat equation: correction of constant operators.

Time stepping uses constant operators K and H. The additional heat flow is

    N(T) = sum_b K_b (theta_b(T) - m_b T) + sum_s A_s (q_s(T, T_a) - h_s (T - T_a)),

both sums over nodal values: theta is Kirchhoff's transform of a body's conductivity, whose constant
part in K is m_b k_b; q_s the heat flux of convection or radiation, whose constant part in H is h_s.
Enclosed air has no heat capacity: its temperature is the mean of its walls, and its convection in H
is one to the ambient. A heat capacity with a factor stores, beyond its constant part in M,
sum_b C_b (theta_b(T) - m_b T), its enthalpy. `fesim.march.secant_step` finds the T of each step
that satisfies M dT/dt + (K + H) T + N(T) = P u.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.constants import Stefan_Boltzmann, zero_Celsius
from scipy.sparse import csr_array

from fesim.solid.temperature_factor import TemperatureFactor
from thermojoint.artefacts.arrays import Array

#: From nodal temperatures (n,) and the ambient, above the initial one, K, to nodal values (n,).
Potential = Callable[[Array, float], Array]


@dataclass(frozen=True)
class VariableHeat:
    """N(T) of the heat equation."""

    #: Matrices (n, n), and the functions of nodal temperatures that they multiply.
    terms: tuple[tuple[csr_array, Potential], ...]
    #: Index of the ambient among the inputs.
    ambient: int
    #: Shape (h,): unknowns with prescribed temperature.
    held: NDArray[np.int64]
    #: Shape (n,), TemperatureFactor): c_b of the bodies whose heat capacity has a factor, J/K.
    capacities: tuple[tuple[Array, TemperatureFactor], ...] = ()

    def retained(self, before: Array, after: Array) -> Array:
        """Return the heat (n,), J, stored in nodes in addition to that of the constant capacity."""
        heat = np.zeros(len(after))
        for capacity, factor in self.capacities:
            stored = factor.integral(after) - factor.integral(before)
            heat += capacity * (stored - factor.middle * (after - before))
        return heat

    def lost(self, temperature: Array, inputs: Array) -> Array:
        """Return N(T) (n,), W: heat that leaves the nodes in addition to the constant operators."""
        around = float(inputs[self.ambient])
        heat_loss = np.zeros(len(temperature))
        for matrix, potential in self.terms:
            heat_loss += matrix @ potential(temperature, around)
        return heat_loss


def conduction_potential(factor: TemperatureFactor) -> Potential:
    """Return theta(T) - m T of a conductivity with a factor whose middle is m."""
    return lambda temperature, _: factor.integral(temperature) - factor.middle * temperature


def convection_potential(coefficient: float, factor: TemperatureFactor) -> Potential:
    """Return h (f(d) - m) d, W/m2, with a factor f of d, the surface rise above the ambient."""

    def potential(temperature: Array, ambient: float) -> Array:
        above = temperature - ambient
        value = np.interp(above, factor.rises, factor.values)
        return np.asarray(coefficient * (value - factor.middle) * above)

    return potential


def air_potential(coefficient: float, walls: Array) -> Potential:
    """Return h (T_a - T_c), W/m2: air at T_c, the mean of its walls, instead of the ambient.

    Parameters
    ----------
    coefficient : float
        h, W/(m2 K), on all walls.
    walls : ndarray, shape (n,)
        Area of the walls at each node, m2.
    """
    weights = walls / walls.sum()

    def potential(temperature: Array, ambient: float) -> Array:
        return np.full(len(temperature), coefficient * (ambient - float(weights @ temperature)))

    return potential


def radiation_coefficient(emissivity: float, ambient_degc: float) -> float:
    """Return 4 eps sigma T_a^3, W/(m2 K): radiation linearised at the initial ambient."""
    return float(4.0 * emissivity * Stefan_Boltzmann * (zero_Celsius + ambient_degc) ** 3)


def radiation_potential(emissivity: float, ambient_degc: float) -> Potential:
    """Return eps sigma (T^4 - T_a^4), absolute, minus its part in `radiation_coefficient`, W/m2."""
    absolute = zero_Celsius + ambient_degc
    coefficient = radiation_coefficient(emissivity, ambient_degc)

    def potential(temperature: Array, ambient: float) -> Array:
        exchanged = (absolute + temperature) ** 4 - (absolute + ambient) ** 4
        flux = emissivity * Stefan_Boltzmann * exchanged - coefficient * (temperature - ambient)
        return np.asarray(flux)

    return potential
