"""Barber's bistable rod from a case file: separated from a hot wall by air when cold.

The air warms the rod, the rod grows towards the wall, and the conductance increases. Between two
temperatures of the wall the rod has three steady states (Barber, Dundurs and Comninou 1980): open,
closed, and an unstable one between. `steady_states` computes them without finite elements: with the
end at T_L = T2 Bi/(1 + Bi), Bi = h L/k, the growth alpha L T_L/2 of the rod closes the clearance
and is reduced by the compression p L/E.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.optimize import brentq
from scipy.special import erfc, erfcinv

from fesim.case.schema import Case, case_from_data
from fesim.joint.conductance import FixedConductance
from fesim.march.machine import State
from fesim.march.stepping import march, staggered
from fesim.setup.loads import thermal_inputs
from fesim.setup.machine import Setup, set_up
from fesim.simulate import simulate
from meshes.exchange import write_structure
from meshes.structure import Probe, Structure
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.solving import roots_on
from thermojoint.verification.structures import FOREVER, box_grid, box_surfaces

#: Length and width of the rod, m.
LENGTH, WIDTH = 0.1, 0.02
#: Conductivity, W/(m K), modulus, Pa, and expansion, 1/K, of the rod; conductivity of the wall.
CONDUCTIVITY, MODULUS, EXPANSION, BEHIND = 180.0, 70e9, 23e-6, 45.0
#: Clearance between rod and wall when cold, m.
CLEARANCE = 20e-6
#: Roughness, m, slope and hardness, Pa, of the joint; C and n of Eq. 11.
ROUGHNESS, SLOPE, HARDNESS, FACTOR, EXPONENT = 1.25e-6, 0.14, 1.2e9, 1.45, 0.985
#: Conductivity of the air, W/(m K), and its temperature jump distance, m.
AIR, JUMP = 0.026, 0.4e-6
#: Temperature of the wall, K, with three states.
WALL = 24.0
STATES = ("open", "middle", "closed")
TITLE = "bistable rod from a case file"
END = Quantity("temperature of the end", "K", 1e-6, "balance of the rod")
PRESSURE = Quantity("pressure", "MPa", 1e-6, "balance of the rod")


def at_opening(opening: float, wall: float) -> tuple[float, float, float]:
    """Return the residual of the balance (m), the pressure (Pa) and the end's temperature (K).

    The opening (m) is relative to the cold state, the wall's temperature (K) to the rod's foot.
    """
    touching = np.sqrt(2.0) * ROUGHNESS * erfcinv(2e-6)
    apart = touching + CLEARANCE + opening
    pressure = 0.5 * HARDNESS * erfc(apart / (np.sqrt(2.0) * ROUGHNESS))
    harmonic = 2.0 * CONDUCTIVITY * BEHIND / (CONDUCTIVITY + BEHIND)
    contact = FACTOR * SLOPE / ROUGHNESS * harmonic * (pressure / HARDNESS) ** EXPONENT
    biot = (contact + AIR / (apart + JUMP)) * LENGTH / CONDUCTIVITY
    end = wall * biot / (1.0 + biot)
    growth = 0.5 * EXPANSION * LENGTH * end
    return opening + growth - pressure * LENGTH / MODULUS, float(pressure), float(end)


def steady_states(wall: float) -> list[tuple[float, float, float]]:
    """Return opening (m), pressure (Pa) and end temperature (K) of each, the most open first."""
    grid = np.linspace(0.0, -CLEARANCE - 3.0 * ROUGHNESS, 1001)
    openings = roots_on(grid, lambda g: at_opening(g, wall)[0], xtol=1e-18, rtol=1e-14)
    return [(opening, *at_opening(opening, wall)[1:]) for opening in openings]


def rod(elements: int = 20) -> Structure:
    """Return the rod along x; `wall_side` is its free end."""
    mesh = box_grid("hexahedra", (elements, 1, 1), (LENGTH, WIDTH, WIDTH))
    sides = box_surfaces(mesh)
    names = {"foot": "x0", "wall_side": "x1", "bottom": "y0", "back": "z0"}
    return Structure(
        mesh=mesh,
        bodies={"rod": np.arange(mesh.nelements)},
        surfaces={name: sides[side] for name, side in names.items()},
        probes={"end": Probe((LENGTH, 0.5 * WIDTH, 0.5 * WIDTH), "rod")},
    )


def case_of(
    folder: Path, step: float = 20.0, thermal: str = "full", end: float | None = None
) -> Case:
    """Return the case of `rod.vtu` in a folder, initially cold or with a warm end (K)."""
    metal = {"density_kg_m3": 2700.0, "heat_capacity_J_kgK": 900.0, "expansion_1_K": EXPANSION}
    metal |= {"youngs_modulus_GPa": 1e-9 * MODULUS, "poisson_ratio": 0.0}
    data: dict[str, Any] = {
        "title": "bistable rod",
        "structure": {"kind": "mesh", "file": "rod.vtu"},
        "walls": {"wall": {"faces": "wall_side"}},
        "materials": {
            "rod": metal | {"conductivity_W_mK": CONDUCTIVITY},
            "wall": metal | {"conductivity_W_mK": BEHIND},
        },
        "bodies": {"rod": "rod", "wall": "wall"},
        "joints": {
            "tip": {
                "side_a": "wall_side",
                "side_b": "wall",
                "preload_MPa": 0.0,
                "initial_opening_um": 1e6 * CLEARANCE,
                "reference_pressure_MPa": 5.0,
                "along": 1,
                "across": 1,
                "roughness_um": 1e6 * ROUGHNESS,
                "asperity_slope": SLOPE,
                "hardness_GPa": 1e-9 * HARDNESS,
                "friction_coefficient": 0.0,
                "gap": {"gas_conductivity_W_mK": AIR, "temperature_jump_um": 1e6 * JUMP},
            }
        },
        "supports": {"symmetry": {"foot": "x", "bottom": "y", "back": "z"}},
        "held_temperatures": {"foot": {"rise_K": 0.0}, "wall": {"rise_K": WALL}},
        "march": {
            "step_s": step,
            "duration_min": max(240.0, step / 60.0),
            "coupling": "iterated",
            "thermal": thermal,
        },
        "displacement": {"point": "end"},
        "probes": {"tip": {"position_mm": [1e3 * LENGTH, 10.0, 10.0], "body": "rod"}},
    }
    if end is not None:
        data["initial_temperature"] = {"expression_K": f"{end!r} * x_m / {LENGTH}"}
    return case_from_data(data, "bistable rod", folder)


def found_near(still: Setup, case: Case, conductance: float) -> State:
    """Steady state of the machine near a conductance of its joint, W/(m2 K), stable or not.

    `still` has a time step of `FOREVER`; in this state the joint has the prescribed conductance.
    """
    [(law, count)], inputs = still.machine.contact.laws, thermal_inputs(case)

    def state(given: float) -> State:
        fixed = replace(law, conductance=FixedConductance(given), gap=None)
        machine = still.machine.with_laws([(fixed, count)])
        return next(march(machine, inputs, staggered)).state

    def lack(logarithm: float) -> float:
        settled = state(float(np.exp(logarithm)))
        own = law.conducts(settled.pressure, settled.gap[0], *np.zeros((2, 1)))
        return float(np.log(own[0])) - logarithm

    middle = np.log(conductance)
    return state(float(np.exp(brentq(lack, middle - 0.02, middle + 0.02, xtol=1e-13))))


def checks() -> Iterator[Check]:
    """Check three steady states, of which the march reaches two and leaves the third."""
    with temporary_folder() as folder:
        write_structure(rod(), folder / "rod.vtu")
        yield from _checks(folder)


def _checks(folder: Path) -> Iterator[Check]:
    expected = steady_states(WALL)
    still_case = case_of(folder, FOREVER)
    still = set_up(still_case)
    rows = still.probe_rows
    for name, (_, pressure, end) in zip(STATES, expected, strict=True):
        # The end's temperature gives the conductance: k T_L/L = h (T2 - T_L).
        state = found_near(still, still_case, CONDUCTIVITY / LENGTH * end / (WALL - end))
        yield END.check(f"{TITLE}, {name} state", end, (rows @ state.temperature)[0])
        if name != "open":
            pressed = 1e-6 * float(state.pressure[0])
            yield PRESSURE.check(f"{TITLE}, {name} state", 1e-6 * pressure, pressed)

    def course(thermal: str = "full", end: float | None = None) -> xr.DataArray:
        case = case_of(folder, thermal=thermal, end=end)
        return simulate(case, accuracy=False).response["temperature"]

    for thermal in ("full", "reduced"):
        last = course(thermal)[-1].item()
        yield END.check(f"{TITLE}, cold rod, {thermal}", expected[0][2], last)
    middle = expected[1][2]
    kept = course(end=middle).sel(time=600.0).item()
    yield END.check(f"{TITLE}, middle state, kept for ten minutes", middle, kept)
    for way, factor, end in (("down", 0.99, expected[0][2]), ("up", 1.01, expected[2][2])):
        left = course(end=factor * middle)[-1].item()
        yield END.check(f"{TITLE}, middle state left {way}wards", end, left)
