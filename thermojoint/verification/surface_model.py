"""Conductance of a joint: the surface model of Cooper, Mikic & Yovanovich and its power laws."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fesim.joint.law import exact_conductance, power_law_conductance
from fesim.setup.laws import CONDUCTANCE_CONSTANTS
from thermojoint.verification.check import Check, Quantity

#: p/H: h_c sigma / (k_h m) of h = exp(-x^2/2) / (2 sqrt(2 pi) [1 - sqrt(p/H)]^1.5).
EXACT = {1e-4: 2.009304e-4, 1e-3: 1.766680e-3, 1e-2: 1.560768e-2}
#: p/H: deviation of each power law from the exact model, %, and half a unit of its last digit.
DEVIATION = {
    "cmy-1969": {1e-4: (-17.1, 0.05), 1e-3: (-9.0, 0.05), 1e-2: (-0.45, 0.005)},
    "yovanovich-1982": {1e-4: (-1.4, 0.05), 1e-3: (-0.06, 0.005), 1e-2: (0.8, 0.05)},
}
#: The paper's joint: p/H, slope, roughness (m), conductivity of grey iron (W/(m K)).
JOINT_SHARE, SLOPE, ROUGHNESS, CONDUCTIVITY = 2.2485e-3, 0.14, 1.25e-6, 47.0
#: Conductance of this joint, W/(m2 K).
AT_JOINT = {"exact": 19960.0, "cmy-1969": 18806.0, "yovanovich-1982": 20069.0}

SOURCE = "CMY 1969"
LAW_SOURCE = {"exact": SOURCE, "cmy-1969": SOURCE, "yovanovich-1982": "Yovanovich 1982"}


def conductance(law: str, share: float, slope: float, roughness: float, k: float) -> float:
    """h_c, W/(m2 K), at a pressure relative to the hardness."""
    if law == "exact":
        of_pressure = exact_conductance(slope, roughness, k, 1.0)
    else:
        constant, exponent = CONDUCTANCE_CONSTANTS[law]
        of_pressure = power_law_conductance(constant, exponent, slope, roughness, k, 1.0)
    return float(of_pressure(np.array([share]))[0])


def checks() -> Iterator[Check]:
    """Check the three laws, in dimensionless form and for the paper's joint."""
    for share, reference in EXACT.items():
        computed = conductance("exact", share, 1.0, 1.0, 1.0)
        dimensionless = Quantity("conductance", "1", 5e-7, SOURCE)
        yield dimensionless.check(f"conductance, exact, p/H = {share:g}", reference, computed)
    for law, deviations in DEVIATION.items():
        for share, (reference, digit) in deviations.items():
            exact = conductance("exact", share, 1.0, 1.0, 1.0)
            computed = 100.0 * (conductance(law, share, 1.0, 1.0, 1.0) / exact - 1.0)
            quantity = "deviation from the exact model"
            deviation = Quantity(quantity, "%", digit / 100.0, LAW_SOURCE[law])
            name = f"conductance, {law}, p/H = {share:g}"
            yield deviation.check(name, reference, computed, scale=100.0)
    for law, reference in AT_JOINT.items():
        computed = conductance(law, JOINT_SHARE, SLOPE, ROUGHNESS, CONDUCTIVITY)
        # The tolerance is half a unit of the last digit.
        at_joint = Quantity("conductance", "W/(m2 K)", 3e-5, LAW_SOURCE[law])
        yield at_joint.check(f"conductance, {law}, the paper's joint", reference, computed)
