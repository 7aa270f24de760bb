"""Two bars in series through a joint: q = dT / (L1/k1 + 1/h_c(p) + L2/k2), by one long step."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.constants import Stefan_Boltzmann, zero_Celsius
from scipy.optimize import brentq
from scipy.special import erfcinv

from fesim.case.joint_sections import JointSection
from fesim.joint.law import (
    Friction,
    JointLaw,
    SurfaceNormalLaw,
    exact_conductance,
    harmonic_conductivity,
)
from fesim.march.contact import ContactProblem
from fesim.march.machine import CondensedMachine
from fesim.march.stepping import Advance, iterated, march, staggered
from fesim.setup.laws import law_of
from fesim.solid.condensation import condense_heat
from fesim.solid.heat import ThermalLoads, heat_operators
from meshes.structure import Structure
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.rods import between_rollers
from thermojoint.verification.structures import (
    FOREVER,
    IRON,
    LEFT,
    RIGHT,
    SECTION,
    STEEL,
    bars,
)

#: Temperatures of the ends, K.
HOT, COLD = 100.0, 20.0
#: Pressures of the joint, Pa.
PRESSURES = (0.1e6, 1.0e6, 4.41e6, 40.0e6)
ROUGHNESS, SLOPE, HARDNESS = 1.25e-6, 0.14, 1.961e9

MESHES = {
    "matching hexahedra": ("hexahedra", (3, 3, 2), (4, 3, 2)),
    "non-matching hexahedra": ("hexahedra", (3, 3, 2), (2, 4, 3)),
    "matching tetrahedra": ("tetrahedra", (2, 2, 2), (3, 2, 2)),
    "non-matching tetrahedra": ("tetrahedra", (2, 2, 2), (3, 3, 2)),
}


def law_at(pressure: float) -> JointLaw:
    """Return a joint of iron on steel at a preload (Pa), with the conductance of the CMY model."""
    normal = SurfaceNormalLaw(HARDNESS, ROUGHNESS, pressure)
    ends = (np.array([m.conductivity]) for m in (IRON, STEEL))
    conductivity = float(harmonic_conductivity(*ends)[0])
    conductance = exact_conductance(SLOPE, ROUGHNESS, conductivity, HARDNESS)
    return JointLaw(normal, Friction(0.6, 1e12), conductance)


def steady_machine(structure: Structure) -> CondensedMachine:
    """Two bars between rollers with held end temperatures; one step reaches the steady state.

    The bars do not expand, so that the joint keeps its preload.
    """
    materials = {"left": replace(IRON, expansion=0.0), "right": replace(STEEL, expansion=0.0)}
    spaces, operators, condensed, _ = between_rollers(structure, materials, (3, 2))
    ends = ThermalLoads(held={"x0": None, "x1": None})
    heat = heat_operators(structure, spaces.heat, materials, ends)
    thermal = condense_heat(heat, operators, FOREVER)
    laws = [(law_at(PRESSURES[0]), len(operators.area))]
    return CondensedMachine(thermal, ContactProblem(condensed, laws))


#: Keys of joints with a conductance other than Eq. 11, and their conductance, W/(m2 K).
_OPEN = {"preload_MPa": 0.0, "reference_pressure_MPa": 1.0, "initial_opening_um": 30.0}
AIR, JUMP, WARM, EMISSIVITIES = 0.026, 0.4e-6, 60.0, (0.3, 0.8)
OTHER_LAWS: dict[str, tuple[dict[str, Any], float]] = {
    "fixed conductance": (
        {"preload_MPa": 1.0, "conductance": {"law": "fixed", "value_W_m2K": 800.0}},
        800.0,
    ),
    "air in an open gap": (
        _OPEN | {"gap": {"gas_conductivity_W_mK": AIR, "temperature_jump_um": 1e6 * JUMP}},
        # The mean planes of rough surfaces that touch are lambda roughnesses apart:
        # erfc(lambda / sqrt 2) / 2 = 1e-6.
        AIR / (30e-6 + math.sqrt(2.0) * float(erfcinv(2e-6)) * ROUGHNESS + JUMP),
    ),
    "radiation across an open gap": (
        _OPEN
        | {
            "gap": {
                "emissivity_a": EMISSIVITIES[0],
                "emissivity_b": EMISSIVITIES[1],
                "mean_temperature_degC": WARM,
            }
        },
        4.0
        * Stefan_Boltzmann
        * (WARM + zero_Celsius) ** 3
        / (sum(1.0 / e for e in EMISSIVITIES) - 1.0),
    ),
}


#: Radiation that is not linearised, at an ambient of 300 °C, where it is significant.
AMBIENT = 300.0
BLACK = {"emissivity_a": 1.0, "emissivity_b": 1.0, "ambient_degC": AMBIENT}


def radiated() -> float:
    """Return h of black surfaces between the bars from the heat flow through them, W/(m2 K)."""

    def drop(flux: float) -> float:
        return HOT - COLD - flux * (LEFT / IRON.conductivity + RIGHT / STEEL.conductivity)

    def excess(flux: float) -> float:
        second = AMBIENT + zero_Celsius + COLD + flux * RIGHT / STEEL.conductivity
        return Stefan_Boltzmann * ((second + drop(flux)) ** 4 - second**4) - flux

    flux = float(brentq(excess, 0.0, 1e5, xtol=1e-12))
    return flux / drop(flux)


def other_checks() -> Iterator[Check]:
    """Check the heat flow through the two bars with conductances other than Eq. 11."""
    cold = steady_machine(bars("hexahedra", (3, 3, 2), (4, 3, 2)))
    surface: dict[str, Any] = {
        "along": 3,
        "across": 2,
        "roughness_um": 1e6 * ROUGHNESS,
        "asperity_slope": SLOPE,
        "hardness_GPa": 1e-9 * HARDNESS,
        "friction_coefficient": 0.6,
    }
    for name, (keys, conductance) in OTHER_LAWS.items():
        section = JointSection(**surface | keys)
        given = section.initial_opening_um
        opening = None if given is None else np.full(cold.contact.count, 1e-6 * float(given))
        law = law_of(section, np.full(cold.contact.count, IRON.conductivity), opening)
        yield _flow_check(f"two bars, {name}", cold.with_laws([(law, 6)]), conductance)
    section = JointSection(**surface | _OPEN | {"gap": BLACK})
    law = law_of(section, np.full(6, IRON.conductivity), np.full(6, 30e-6))
    name = "two bars, radiation of the fourth power"
    yield _flow_check(name, cold.with_laws([(law, 6)]), radiated(), iterated)


def checks() -> Iterator[Check]:
    """Check the heat flow through the two bars on every mesh at every pressure."""
    for mesh, (kind, left, right) in MESHES.items():
        cold = steady_machine(bars(kind, left, right))
        for pressure in PRESSURES:
            law = law_at(pressure)
            contact = float(law.conductance(np.array([pressure]))[0])
            machine = cold.with_laws([(law, cold.contact.count)])
            yield _flow_check(f"two bars, {mesh}, {1e-6 * pressure:g} MPa", machine, contact)
    yield from other_checks()


def _flow_check(
    name: str, machine: CondensedMachine, conductance: float, advance: Advance = staggered
) -> Check:
    # Inputs: the ambient, then the two held ends.
    inputs = np.array([0.0, HOT, COLD])
    step = next(march(machine, lambda _: inputs, advance))
    resistance = LEFT / IRON.conductivity + 1.0 / conductance + RIGHT / STEEL.conductivity
    flow = SECTION[0] * SECTION[1] * (HOT - COLD) / resistance
    return Quantity("heat flow", "W", 1e-6).check(name, flow, step.heat_flow.sum())
