"""Two dissimilar rods end to end between two walls of given temperatures.

The rods expand and press on each other, the pressure increases the heat flow, and the heat flow
changes the expansion. The steady state has a closed form: `steady_state` solves it without finite
elements.

Run: ``python examples/two_rods/two_rods.py examples/two_rods/two_rods.vtu`` to write the mesh.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.special import erfc, erfcinv
from skfem import MeshHex

from meshes.box_grid import put_side_by_side
from meshes.exchange import write_structure
from meshes.structure import Probe, Structure

#: length m, conductivity W/(m K), Young's modulus Pa, expansion 1/K
ALUMINIUM = (0.12, 180.0, 70e9, 23e-6)
STEEL = (0.18, 45.0, 206e9, 12e-6)
WIDTH = 0.02
#: roughness m, asperity slope, hardness Pa, preload Pa, C and n of Eq. 11
SURFACE = (1.25e-6, 0.14, 1.2e9, 1.0e6, 1.45, 0.985)


def steady_state(hot: float, cold: float) -> tuple[float, float, float]:
    """Return pressure (Pa), heat flux (W/m2) and temperature jump (K) of the steady state."""
    (first, k1, e1, a1), (second, k2, e2, a2) = ALUMINIUM, STEEL
    roughness, slope, hardness, preload, factor, exponent = SURFACE
    separation = np.sqrt(2.0) * roughness * erfcinv(2.0 * preload / hardness)
    harmonic = 2.0 * k1 * k2 / (k1 + k2)

    def flux(pressure: float) -> float:
        conductance = factor * slope / roughness * harmonic * (pressure / hardness) ** exponent
        return (hot - cold) / (first / k1 + 1.0 / conductance + second / k2)

    def lacking(opening: float) -> float:
        """Expansion of the rods and the joint beyond the distance of the walls, m."""
        scaled = (separation + opening) / (np.sqrt(2.0) * roughness)
        pressure = 0.5 * hardness * erfc(scaled)
        q = flux(pressure)
        growth = a1 * first * (hot - 0.5 * q * first / k1)
        growth += a2 * second * (cold + 0.5 * q * second / k2)
        return growth + opening - (pressure - preload) * (first / e1 + second / e2)

    opening = brentq(lacking, -separation, 20.0 * roughness, xtol=1e-16)
    pressure = 0.5 * hardness * erfc((separation + opening) / (np.sqrt(2.0) * roughness))
    q = flux(pressure)
    return pressure, q, hot - cold - q * (first / k1 + second / k2)


def rods() -> Structure:
    """Two square rods along x with meshes that do not match."""
    lengths = (ALUMINIUM[0], STEEL[0])
    starts = (0.0, lengths[0])
    counts = ((12, 2, 2), (9, 3, 2))
    meshes = [
        MeshHex.init_tensor(
            np.linspace(start, start + length, count[0] + 1),
            *(np.linspace(0.0, WIDTH, n + 1) for n in count[1:]),
        )
        for start, length, count in zip(starts, lengths, counts, strict=True)
    ]
    mesh, (left, right) = put_side_by_side(meshes)
    facets = mesh.boundary_facets()
    x, y, z = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    of_left = mesh.f2t[0, facets] < len(left)
    middle = np.abs(x - lengths[0]) < 1e-9
    return Structure(
        mesh=mesh,
        bodies={"aluminium": left, "steel": right},
        surfaces={
            "hot": facets[x < 1e-9],
            "cold": facets[x > sum(lengths) - 1e-9],
            "bottom": facets[y < 1e-9],
            "back": facets[z < 1e-9],
            "joint.a": facets[middle & of_left],
            "joint.b": facets[middle & ~of_left],
        },
        joints={"joint": ("joint.a", "joint.b")},
        probes={"meeting": Probe((lengths[0], 0.5 * WIDTH, 0.5 * WIDTH), "aluminium")},
    )


if __name__ == "__main__":
    write_structure(rods(), Path(sys.argv[1]))
