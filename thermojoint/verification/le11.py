"""NAFEMS LE11 from a case file: a cylinder, taper and sphere with the temperature r + z.

The section (radius, height) is bounded by A (1, 0), B (1.4, 0), an arc of radius 1.4 m about the
origin up to 30 degrees, D, a taper to (1, 1.39), a cylinder to I (1, 1.79), H (0.7071, 1.79), a
cylinder down to 45 degrees, and an arc of radius 1 m back to A. Top and bottom stay in their
planes. The axial stress at A is compared with the benchmark's value, -105 MPa (NAFEMS, The Standard
NAFEMS Benchmarks, TNSB Rev. 3, 1990).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from skfem import MeshHex, MeshHex2

from meshes.exchange import write_structure
from meshes.structure import Probe, Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.structures import marched

#: Axial stress at A, Pa.
STRESS = -105e6
#: Elements through the wall, around the quarter, and along each of the section's four parts.
COARSE, FINE = (4, 5, 3), (6, 6, 4)
#: Ends (r, z) of the outer parts: end of the sphere, middle and end of the taper, top, m.
_TAPER = ((1.4 * np.cos(np.pi / 6), 0.7), (1.1062, 1.045), (1.0, 1.39), (1.0, 1.79))
_NECK = np.sqrt(0.5)


def section(through: Array, along: Array) -> Array:
    """Return (r, z) of the section, shape (2, n), m.

    `through` is 0 inside, 1 outside; `along` is 0 at the bottom, 4 at the top, and whole numbers
    end a part; both have shape (n,).
    """
    arc = np.minimum(along, 2.0) * np.pi / 8.0
    middle = 0.5 * (_NECK + 1.79)
    inner = np.array(
        [
            np.cos(arc),
            np.where(along <= 2.0, np.sin(arc), np.interp(along, [2, 3, 4], [_NECK, middle, 1.79])),
        ]
    )
    ball = np.minimum(along, 1.0) * np.pi / 6.0
    radii, heights = zip(*_TAPER, strict=True)
    straight = np.array([np.interp(along, [1, 2, 3, 4], line) for line in (radii, heights)])
    outer = np.where(along <= 1.0, 1.4 * np.array([np.cos(ball), np.sin(ball)]), straight)
    return np.asarray((1.0 - through) * inner + through * outer)


def quarter(through: int, around: int, along: int) -> Structure:
    """Return a quarter of the body in curved hexahedra; their numbers as for `COARSE`."""
    lines = (
        np.linspace(0.0, 1.0, through + 1),
        np.linspace(0.0, 0.5 * np.pi, around + 1),
        np.linspace(0.0, 4.0, 4 * along + 1),
    )
    straight = MeshHex.init_tensor(*lines)
    curved = MeshHex2.from_mesh(straight)
    wall, angle, part = curved.doflocs
    radius, height = section(wall, part)
    mesh = MeshHex2(np.array([radius * np.cos(angle), radius * np.sin(angle), height]), curved.t)
    facets = mesh.boundary_facets()
    _, turned, up = straight.p[:, straight.facets[:, facets]].mean(axis=1)
    near = {
        "bottom": up < 1e-9,
        "top": up > 4.0 - 1e-9,
        "start": turned < 1e-9,
        "end": turned > 0.5 * np.pi - 1e-9,
    }
    return Structure(
        mesh=mesh,
        bodies={"body": np.arange(mesh.nelements)},
        surfaces={name: facets[chosen] for name, chosen in near.items()},
        probes={"A": Probe((1.0, 0.0, 0.0), "body")},
    )


def case_data(mesh: str) -> dict[str, Any]:
    """Return the case of a mesh; row zero of its response is the benchmark."""
    return {
        "title": "NAFEMS LE11",
        "structure": {"kind": "mesh", "file": mesh},
        "materials": {
            "steel": {
                "conductivity_W_mK": 45.0,
                "density_kg_m3": 7850.0,
                "heat_capacity_J_kgK": 470.0,
                "youngs_modulus_GPa": 210.0,
                "poisson_ratio": 0.3,
                "expansion_1_K": 2.3e-4,
            }
        },
        "bodies": {"body": "steel"},
        "supports": {"symmetry": {"start": "y", "end": "x", "bottom": "z", "top": "z"}},
        "initial_temperature": {"expression_K": "hypot(x_m, y_m) + z_m"},
        "march": {"step_s": 1.0, "duration_min": 0.1, "thermal": "full"},
        "displacement": {"point": "A"},
        "probes": {"A": {"position_mm": [1000.0, 0.0, 0.0]}},
        "output": {"stress_probes": ["A"]},
    }


def checks() -> Iterator[Check]:
    """Check the axial stress at A on two meshes."""
    with temporary_folder() as folder:
        for name, counts in (("coarse", COARSE), ("fine", FINE)):
            write_structure(quarter(*counts), folder / f"{name}.vtu")
            stress = marched(folder, case_data(f"{name}.vtu"))["stress"].isel(time=0)
            computed = stress.sel(stress_probe="A", component="zz").item()
            quantity = Quantity("axial stress at A", "MPa", 5e-3, "NAFEMS")
            yield quantity.check(f"NAFEMS LE11, {name} mesh", 1e-6 * STRESS, 1e-6 * computed)
