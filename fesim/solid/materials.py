"""Materials: linear, isotropic, constant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.errors import InputError


@dataclass(frozen=True)
class Material:
    """Properties of one material, SI."""

    #: k, W/(m K).
    conductivity: float
    #: rho, kg/m3.
    density: float
    #: c_p, J/(kg K).
    heat_capacity: float
    #: E, Pa.
    youngs_modulus: float
    #: nu, between -1 and 0.5.
    poisson_ratio: float
    #: Coefficient of linear thermal expansion, 1/K; may be zero.
    expansion: float

    def __post_init__(self) -> None:
        """Refuse unphysical values."""
        for name in ("conductivity", "density", "heat_capacity", "youngs_modulus"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"material: {name} is {value}; give a positive number in SI units")
        if not -1.0 < self.poisson_ratio < 0.5:
            raise InputError(
                f"material: poisson_ratio is {self.poisson_ratio}; it lies between -1 and 0.5"
            )
        if not np.isfinite(self.expansion):
            raise InputError(f"material: expansion is {self.expansion}; give a number in 1/K")

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé's lambda and mu, Pa."""
        e, nu = self.youngs_modulus, self.poisson_ratio
        return e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))
