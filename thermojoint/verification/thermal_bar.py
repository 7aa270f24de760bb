"""Bars and plates as case files, for the checks of thermal fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from meshes.exchange import write_structure
from thermojoint.verification.structures import block, box_grid

#: Length and width of the bar along x, m.
LENGTH, WIDTH = 0.1, 0.02
CONDUCTIVITY, DENSITY, CAPACITY, EXPANSION = 47.0, 7200.0, 500.0, 11e-6
#: An implicit Euler step of this length reaches the steady state, s.
FOREVER = 1e13
METAL: dict[str, Any] = {
    "conductivity_W_mK": CONDUCTIVITY,
    "density_kg_m3": DENSITY,
    "heat_capacity_J_kgK": CAPACITY,
    "youngs_modulus_GPa": 104.0,
    "poisson_ratio": 0.0,
    "expansion_1_K": EXPANSION,
}


def bar_case(
    folder: Path,
    changes: dict[str, Any],
    divisions: tuple[int, int, int] = (20, 1, 1),
    size: tuple[float, float, float] = (LENGTH, WIDTH, WIDTH),
    metal: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the data of a case of one block, its mesh written to a folder, with some changes.

    Its surfaces are `x0` to `z1`; probes are at its middle and at the centre of `x1`, `end`.
    """
    mesh = "-".join(map(str, divisions))
    write_structure(block(box_grid("hexahedra", divisions, size)), folder / f"{mesh}.vtu")
    middle = [500.0 * length for length in size]
    data: dict[str, Any] = {
        "title": "bar",
        "structure": {"kind": "mesh", "file": f"{mesh}.vtu"},
        "materials": {"metal": METAL | (metal or {})},
        "bodies": {"block": "metal"},
        "supports": {"symmetry": {"x0": "x", "y0": "y", "z0": "z"}},
        "march": {"step_s": FOREVER, "duration_min": FOREVER / 60.0, "thermal": "full"},
        "displacement": {"point": "end"},
        "probes": {
            "middle": {"position_mm": middle},
            "end": {"position_mm": [1e3 * size[0], *middle[1:]]},
            "start": {"position_mm": [0.0, *middle[1:]]},
        },
    }
    return data | changes
