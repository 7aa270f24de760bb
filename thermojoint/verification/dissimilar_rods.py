"""Two dissimilar rods between walls: the simulator against an independent 1-D solution.

Steel and aluminium press on each other between a hot wall and a cold one; the conductance of their
joint grows with the pressure. A warmer aluminium rod expands and raises the pressure, and with it
its own heat supply; the steel rod, which then cools, lowers the pressure, later but finally by
more, since its alpha L^2/k is larger. The only steady state can therefore be unstable (Barber and
Zhang, 1988): with a sufficiently cold wall the pressure oscillates permanently. Both cases are
simulated.

The reference shares no code with the march: finite volumes, the closed form of the mechanics, and
an implicit Runge-Kutta method of order 5 with error control.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from scipy.integrate import solve_ivp

from fesim.joint.law import BackBurdekinLaw, JointLaw
from fesim.march.stepping import march, staggered
from fesim.solid.materials import Material
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.rods import NO_FRICTION, Rods, rods
from thermojoint.verification.structures import STEEL

ALUMINIUM = Material(
    conductivity=200.0,
    density=2700.0,
    heat_capacity=900.0,
    youngs_modulus=70e9,
    poisson_ratio=0.0,
    expansion=23e-6,
)
MATERIALS = (replace(STEEL, poisson_ratio=0.0), ALUMINIUM)
LENGTHS = (0.06, 0.07)
#: Approach of the joint's sides = COEFFICIENT sqrt(p), m/Pa^0.5.
COEFFICIENT = 3e-9
PRELOAD = 9.5e6
#: Conductance = CONDUCTANCE (p / 1 MPa)^2, W/(m2 K).
CONDUCTANCE = 200.0
#: Final temperatures of the walls, K, and time constant of their approach, s.
HOT, RAMP = 100.0, 200.0
COLD = {"settling": -20.0, "oscillating": -36.0}
#: Times of comparison, s.
TIMES = np.linspace(100.0, 900.0, 9)

ELEMENTS = (160, 160)
#: Time steps, s; shorter for the oscillation.
STEPS = {"settling": (4.0, 2.0, 1.0), "oscillating": (0.5, 0.25, 0.125)}
CELLS = 200

SOURCE = "one-dimensional finite volumes; relative to the range"
QUANTITIES = (
    ("temperature of the steel at the joint", "K", 1.0),
    ("temperature of the aluminium at the joint", "K", 1.0),
    ("contact pressure", "MPa", 1e-6),
)


def wall_temperatures(time: float, cold: float) -> Array:
    """Temperatures (2,) of the hot and the cold wall, K."""
    return np.array([HOT, cold]) * -np.expm1(-time / RAMP)


def conductance(pressure: Array) -> Array:
    """Conductance of the joint, W/(m2 K)."""
    return CONDUCTANCE * (1e-6 * pressure) ** 2


@dataclass(frozen=True)
class FiniteVolumes:
    """The rods in one dimension, `CELLS` cells of temperature in each."""

    cold: float

    @property
    def sizes(self) -> tuple[float, float]:
        """Lengths of the cells of each rod, m."""
        return LENGTHS[0] / CELLS, LENGTHS[1] / CELLS

    def pressure(self, temperature: Array) -> Array:
        """Pressure, Pa, of cell temperatures (2 `CELLS`, ...).

        c (sqrt p0 - sqrt p) + growth = (p - p0) B with B = L1/E1 + L2/E2, solved for sqrt p.
        """
        backing = sum(
            length / m.youngs_modulus for length, m in zip(LENGTHS, MATERIALS, strict=True)
        )
        growth = sum(
            m.expansion * size * part.sum(axis=0)
            for m, size, part in zip(MATERIALS, self.sizes, np.split(temperature, 2), strict=True)
        )
        known = COEFFICIENT * np.sqrt(PRELOAD) + backing * PRELOAD + growth
        inside = COEFFICIENT**2 + 4.0 * backing * np.maximum(known, 0.0)
        return np.asarray(((np.sqrt(inside) - COEFFICIENT) / (2.0 * backing)) ** 2)

    def joint(self, temperature: Array) -> tuple[Array, Array]:
        """Temperatures of both sides and pressure (3, ...), and the heat flux, W/m2."""
        pressure = self.pressure(temperature)
        first, second = (
            size / 2.0 / m.conductivity for size, m in zip(self.sizes, MATERIALS, strict=True)
        )
        contact = conductance(pressure)
        ends = temperature[CELLS - 1], temperature[CELLS]
        flux = (ends[0] - ends[1]) * contact / (1.0 + contact * (first + second))
        return np.array([ends[0] - flux * first, ends[1] + flux * second, pressure]), flux

    def rate(self, time: float, temperature: Array) -> Array:
        """dT/dt of the cells (2 `CELLS`, k), K/s."""
        hot, cold = wall_temperatures(time, self.cold)
        _, flux = self.joint(temperature)
        first, second = np.split(temperature, 2)
        left, right = (m.conductivity / size for size, m in zip(self.sizes, MATERIALS, strict=True))
        flows = (
            np.vstack([2.0 * left * (hot - first[:1]), -left * np.diff(first, axis=0), flux]),
            np.vstack([flux, -right * np.diff(second, axis=0), 2.0 * right * (second[-1:] - cold)]),
        )
        return np.concatenate(
            [
                -np.diff(flow, axis=0) / (size * m.density * m.heat_capacity)
                for flow, size, m in zip(flows, self.sizes, MATERIALS, strict=True)
            ]
        )


def reference(cold: float) -> Array:
    """Joint temperatures and pressure at `TIMES`, shape (3, times), by finite volumes."""
    volumes = FiniteVolumes(cold)
    solution = solve_ivp(
        volumes.rate,
        (0.0, TIMES[-1]),
        np.zeros(2 * CELLS),
        method="Radau",
        t_eval=TIMES,
        vectorized=True,
        rtol=1e-6,
        atol=1e-6,
    )
    if not solution.success:
        raise ConvergenceError(f"two dissimilar rods, reference: {solution.message}")
    return volumes.joint(solution.y)[0]


def joint_law() -> JointLaw:
    """Return the joint of the rods."""
    return JointLaw(BackBurdekinLaw(COEFFICIENT, 0.5, PRELOAD), NO_FRICTION, conductance)


def marched(built: Rods, cold: float, step: float) -> Array:
    """Return the same from the march with a time step (s)."""
    at_joint = np.abs(built.x - LENGTHS[0]) < 1e-9
    second = np.arange(built.x.size) >= built.second
    sides = [at_joint & ~second, at_joint & second]
    steps = march(
        built.machine(step),
        lambda time: np.concatenate([[0.0], wall_temperatures(time, cold)]),
        staggered,
    )
    every = round(TIMES[0] / step)
    states = [s.state for s in islice(steps, every - 1, every * len(TIMES), every)]
    return np.array(
        [[*(s.temperature[side].mean() for side in sides), s.pressure[0]] for s in states]
    ).T


def extrapolated(built: Rods, name: str) -> Array:
    """Extrapolate marches with three time steps, each half the previous one, to order 3."""
    coarse, middle, fine = (marched(built, COLD[name], step) for step in STEPS[name])
    return (4.0 * (2.0 * fine - middle) - (2.0 * middle - coarse)) / 3.0


def checks() -> Iterator[Check]:
    """Check both sides of the joint and its pressure at the time of the largest difference."""
    built = rods(MATERIALS, LENGTHS, ELEMENTS, joint_law(), ["x0", "x1"])
    for name, cold in COLD.items():
        expected, values = reference(cold), extrapolated(built, name)
        for (quantity, unit, factor), known, computed in zip(
            QUANTITIES, expected, values, strict=True
        ):
            at = int(np.argmax(np.abs(computed - known)))
            yield Quantity(quantity, unit, 1e-3, SOURCE).check(
                f"two dissimilar rods, {name}",
                factor * float(known[at]),
                factor * float(computed[at]),
                scale=factor * float(np.ptp(known)),
            )
