"""Partial slip of a strip on a rigid base, heated and cooled again.

With nu = 0 and its faces between rollers the strip obeys E t u'' = tau(u), with
tau = k_t (u - slip), |tau| <= mu p. When heated, it slips from its free end; when cooled, it slips
back. The change since the reversal obeys the same equation with twice the limit (Masing).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from fesim.joint.law import Friction
from thermojoint.artefacts.arrays import Array
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.friction import pressed
from thermojoint.verification.series import law_at
from thermojoint.verification.structures import IRON, box_grid, two_bars

#: Length, thickness and width of the strip, m. The shear across its thickness is k_t t / (3 G) =
#: 6e-5 of the slip.
LENGTH, THICKNESS, WIDTH = 0.3, 1e-3, 0.02
#: k_t, Pa/m; mu; p, Pa.
STIFFNESS, COEFFICIENT, PRESSURE = 1e10, 0.3, 1.0e6
#: Elements and contact elements along the strip.
CELLS, CONTACTS = 120, 240
#: Final temperature of the heating, K, and number of steps to it.
RISE, STEPS = 80.0, 10


@dataclass(frozen=True)
class PartialSlip:
    """Closed form of the strip, held at y = 0, free at y = L and heated uniformly.

    It sticks up to y = a: u = s sinh(beta y) / sinh(beta a), beta^2 = k_t / (E t). Beyond, the
    shear is k_t s; a follows from the continuity of the strain at a.
    """

    #: s, displacement at which the joint slips, m.
    limit: float
    #: alpha T, thermal strain of the free strip.
    strain: float

    @property
    def rate(self) -> float:
        """Beta, 1/m."""
        return float(np.sqrt(STIFFNESS / (IRON.youngs_modulus * THICKNESS)))

    @property
    def stuck(self) -> float:
        """a, m."""
        beta = self.rate

        def misfit(a: float) -> float:
            held = 1.0 / np.tanh(beta * a) + beta * (LENGTH - a)
            return float(beta * self.limit * held - self.strain)

        return float(brentq(misfit, 1e-6 * LENGTH, LENGTH, xtol=1e-15))

    def displacement(self, y: float) -> float:
        """Displacement at a place in the slip zone, m."""
        beta2, a = self.rate**2, self.stuck
        slope = self.strain - beta2 * self.limit * (LENGTH - a)
        return self.limit + slope * (y - a) + 0.5 * beta2 * self.limit * (y - a) ** 2

    def shear(self, edges: Array) -> Array:
        """Mean shear traction between `edges` (n + 1,), m, shape (n,), Pa."""
        beta, a = self.rate, self.stuck
        inside = np.minimum(edges, a)
        stuck = (np.cosh(beta * inside) - 1.0) / (beta * np.sinh(beta * a))
        total = STIFFNESS * self.limit * (stuck + np.maximum(edges - a, 0.0))
        return np.diff(total) / np.diff(edges)


def checks() -> Iterator[Check]:
    """Check the strip at its highest temperature and after cooling."""
    iron = replace(IRON, poisson_ratio=0.0)
    base = replace(iron, youngs_modulus=1e6 * IRON.youngs_modulus, expansion=0.0)
    law = replace(law_at(PRESSURE), friction=Friction(COEFFICIENT, STIFFNESS))
    size = (THICKNESS, LENGTH, WIDTH)
    strip = pressed(
        two_bars(
            box_grid("hexahedra", (1, 4, 1), size),
            box_grid("hexahedra", (1, CELLS, 1), size, (THICKNESS, 0.0, 0.0)),
        ),
        {"left": base, "right": iron},
        law,
        (CONTACTS, 1),
        ["x0"],
        # Free to move along y only; held at one end.
        {"x1": "x", "joint.b": "x", "y0": "y", "z0": "z", "z1": "z"},
    )
    per_kelvin = strip.contact.elastic.thermal_gap @ np.ones(strip.nodes)
    up = RISE / STEPS * np.arange(1, STEPS + 1)
    levels = np.concatenate([up, up[-2::-1], [0.0]])
    states = [state for _, state in strip.follow(level * per_kelvin for level in levels)]

    edges = np.linspace(0.0, LENGTH, CONTACTS + 1)
    last = 0.5 * float(edges[-2] + edges[-1])
    limit = COEFFICIENT * PRESSURE / STIFFNESS
    loading = PartialSlip(limit, IRON.expansion * RISE)
    change = PartialSlip(2.0 * limit, IRON.expansion * RISE)
    hot_slip = loading.displacement(last) - limit
    hot_shear = loading.shear(edges)
    for name, state, slip, shear, stuck, bound in (
        ("heated", states[STEPS - 1], hot_slip, hot_shear, loading.stuck, 1.0),
        (
            "cooled again",
            states[-1],
            hot_slip - (change.displacement(last) - 2.0 * limit),
            hot_shear - change.shear(edges),
            change.stuck,
            -1.0,
        ),
    ):
        computed_shear = -state.traction.value[1]
        slides = bound * computed_shear >= (1.0 - 1e-9) * COEFFICIENT * PRESSURE
        slip_zone = slides.sum() * LENGTH / CONTACTS
        for quantity, unit, reference, computed, tolerance in (
            ("slip at the free end", "m", slip, state.traction.slip[0, -1], 1e-4),
            # Resolved to whole contact elements: one is 0.4 % of the strip.
            ("length of the slip zone", "m", LENGTH - stuck, slip_zone, 1e-2),
        ):
            compared = Quantity(quantity, unit, tolerance)
            yield compared.check(f"partial slip, {name}", reference, computed)
        error = np.sqrt(((computed_shear - shear) ** 2).sum() / (shear**2).sum())
        yield Quantity("shear traction, its mean; error rms", "Pa", 1e-3).check(
            f"partial slip, {name}",
            shear.mean(),
            computed_shear.mean(),
            relative_error=float(error),
        )
