"""NAFEMS T3 and T4: heat conduction in one and two dimensions, on meshes of hexahedra.

T3, one-dimensional transient conduction: a bar of 0.1 m, at 0 at first; one end is kept at 0, the
other at 100 sin(pi t / 40 s). Result: the temperature 0.08 m from the cold end after 32 s, 36.60.

T4, two-dimensional convection: a plate of 0.6 m x 1.0 m, its base at 100, its left side insulated,
its right side and its top in air of 0. Result: the temperature at (0.6 m, 0.2 m), 18.25.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import csr_array

from fesim.march.heat_step import heat_step
from fesim.solid.condensation import ThermalCondensation, condense_heat
from fesim.solid.heat import HeatOperators, ThermalLoads, heat_operators
from fesim.solid.joint_operators import JointOperators
from fesim.solid.materials import Material
from fesim.solid.spaces import make_spaces, probe_rows
from meshes.structure import Probe
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.structures import FOREVER, block, box_grid

NO_JOINT = np.zeros(1)


def checks() -> Iterator[Check]:
    """Check both benchmarks, with a sufficiently fine mesh and time step."""
    bar = Quantity("temperature at 0.08 m after 32 s", "degC", 5e-3, "NAFEMS T3")
    yield bar.check("NAFEMS T3", 36.60, bar_temperature(elements=80, step=0.05))
    plate = Quantity("temperature at (0.6 m, 0.2 m)", "degC", 5e-3, "NAFEMS T4")
    yield plate.check("NAFEMS T4", 18.25, plate_temperature(elements=60))


def bar_temperature(elements: int, step: float) -> float:
    """T3 with a number of elements along the bar and a time step, s."""
    length, end = 0.1, 32.0
    material = _conductor(conductivity=35.0, density=7200.0, heat_capacity=440.5)
    structure = block(box_grid("hexahedra", (elements, 1, 1), (length, 0.01, 0.01)))
    basis = make_spaces(structure.mesh).heat
    heat = heat_operators(
        structure, basis, {"block": material}, ThermalLoads(held={"x0": None, "x1": None})
    )
    thermal = alone(heat, step)
    temperature = np.zeros(basis.N)
    for k in range(1, round(end / step) + 1):
        inputs = np.array([0.0, 0.0, 100.0 * np.sin(np.pi * k * step / 40.0)])
        temperature, _ = heat_step(thermal, temperature, inputs, NO_JOINT)
    at = probe_rows(basis, structure, {"point": Probe((0.08, 0.005, 0.005))})
    return float((at @ temperature)[0])


def plate_temperature(elements: int) -> float:
    """T4 with a number of elements along the plate's shorter side."""
    width, height = 0.6, 1.0
    material = _conductor(conductivity=52.0, density=7850.0, heat_capacity=460.0)
    divisions = (elements, round(elements * height / width), 1)
    structure = block(box_grid("hexahedra", divisions, (width, height, 0.01)))
    basis = make_spaces(structure.mesh).heat
    convection = {"x1": 750.0, "y1": 750.0}
    heat = heat_operators(
        structure, basis, {"block": material}, ThermalLoads(convection, held={"y0": None})
    )
    inputs = np.array([0.0, 100.0])
    temperature, _ = heat_step(alone(heat, FOREVER), np.zeros(basis.N), inputs, NO_JOINT)
    at = probe_rows(basis, structure, {"point": Probe((width, 0.2, 0.005))})
    return float((at @ temperature)[0])


def alone(heat: HeatOperators, step: float) -> ThermalCondensation:
    """Condense a body without contact: its single contact element carries no heat."""
    size = heat.capacity.shape[0]
    none = csr_array((1, size))
    nothing = JointOperators(none, csr_array((3, 3 * size)), np.ones(1), none)
    return condense_heat(heat, nothing, step)


def _conductor(conductivity: float, density: float, heat_capacity: float) -> Material:
    """Return a material for thermal use only."""
    return Material(conductivity, density, heat_capacity, 1e9, 0.3, 0.0)
