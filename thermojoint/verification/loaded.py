"""Mechanical loads from case files: a column under its weight, joints in series with a force.

Bars along z without lateral contraction are one-dimensional. A column of height L on a firm base
shortens by rho g L^2/(2 E). On a joint without preload its pressure is p = rho g L, and a force F
on two bars in series changes the pressure of their joint by F/A; the approach of the joint follows
from p = (H/2) erfc(Y/(sqrt 2 sigma)).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import erfcinv

from meshes.box_grid import put_side_by_side
from meshes.exchange import write_structure
from meshes.structure import Probe, Structure
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.structures import box_grid, box_surfaces, facing_sides, marched
from thermojoint.verification.thermal_bar import METAL

#: Half the length of the column, and its width, m.
HALF, WIDTH = 0.2, 0.05
AREA = WIDTH**2
MODULUS, DENSITY, GRAVITY = 104e9, 7200.0, 9.81
ROUGHNESS, HARDNESS = 1.25e-6, 1.961e9
#: Preload, Pa; final force on the top, N; times at which it is zero, half and full, s.
PRELOAD, FORCE = 2e6, -8000.0
TIMES = (0.0, 60.0, 120.0)


def column(split: bool) -> Structure:
    """Return a column along z; `split` into two bodies with a joint between them."""
    halves = [
        box_grid("hexahedra", (2, 2, 4), (WIDTH, WIDTH, length), (0.0, 0.0, start))
        for start, length in ([(0.0, HALF), (HALF, HALF)] if split else [(0.0, 2.0 * HALF)])
    ]
    mesh, bodies = put_side_by_side(halves)
    sides = box_surfaces(mesh)
    names = {"foot": "z0", "top": "z1", "back": "x0", "side": "y0"}
    return Structure(
        mesh=mesh,
        bodies=dict(zip(("lower", "upper"), bodies, strict=False)),
        surfaces={name: sides[side] for name, side in names.items()}
        | (facing_sides(mesh, 2, HALF) if split else {}),
        joints={"joint": ("joint.a", "joint.b")} if split else {},
        probes={"top": Probe((0.5 * WIDTH, 0.5 * WIDTH, 2.0 * HALF))},
    )


def column_case(folder: Path, split: bool, changes: dict[str, Any]) -> dict[str, Any]:
    """Write the mesh of a column into a folder; return the data of a case with some changes."""
    write_structure(column(split), folder / f"column{split:d}.vtu")
    data: dict[str, Any] = {
        "title": "column",
        "structure": {"kind": "mesh", "file": f"column{split:d}.vtu"},
        "materials": {"iron": dict(METAL)},
        "bodies": {"lower": "iron", "upper": "iron"} if split else {"lower": "iron"},
        "supports": {"symmetry": {"foot": "z", "back": "x", "side": "y"}},
        "march": {"step_s": 20.0, "duration_min": TIMES[-1] / 60.0},
        "displacement": {"point": "top"},
        "probes": {"P": {"position_mm": [10.0, 10.0, 100.0], "body": "lower"}},
    }
    return data | changes


def joint(**keys: float | str) -> dict[str, Any]:
    """Return a joint of four contact elements with changed keys."""
    surface = {"along": 2, "across": 2, "asperity_slope": 0.14, "friction_coefficient": 0.2}
    return surface | {"roughness_um": 1e6 * ROUGHNESS, "hardness_GPa": 1e-9 * HARDNESS} | keys


WEIGHT = {"weight": {"acceleration_m_s2": [0.0, 0.0, -GRAVITY]}}
STANDING: dict[str, Any] = {
    "walls": {"floor": {"faces": "foot"}},
    "bodies": {"lower": "iron", "floor": "iron"},
    "supports": {"symmetry": {"back": "x", "side": "y"}},
    "joints": {
        "feet": joint(
            side_a="foot",
            side_b="floor",
            preload_MPa=0.0,
            initial_opening_um=0.0,
            reference_pressure_MPa=0.03,
        )
    },
    "loads": WEIGHT,
}


#: Distance that a column falls before it stands on its joint, m.
FALL = 20e-6


def separation(pressure: float) -> float:
    """Distance of the mean planes at a pressure (Pa), m."""
    return float(np.sqrt(2.0) * ROUGHNESS * erfcinv(2.0 * pressure / HARDNESS))


def checks() -> Iterator[Check]:
    """Check displacements and pressures under weight and force."""
    with temporary_folder() as folder:
        yield from _weight_checks(folder)
        yield from _force_checks(folder)


def _weight_checks(folder: Path) -> Iterator[Check]:
    height = 2.0 * HALF
    sunk = -DENSITY * GRAVITY * height**2 / (2.0 * MODULUS)
    held = marched(folder, column_case(folder, False, {"loads": WEIGHT}))
    top = float(held["displacement"].sel(axis="z")[-1])
    displacement = Quantity("displacement", "m")
    yield displacement.check("loads, column under its weight: top", sunk, top)
    standing = marched(folder, column_case(folder, False, STANDING))
    pressure = DENSITY * GRAVITY * height
    # The approach of a joint without preload starts where its surfaces touch.
    approach = separation(pressure) - separation(1e-6 * HARDNESS)
    fallen = STANDING["joints"]["feet"] | {"initial_opening_um": 1e6 * FALL}
    data = column_case(folder, False, STANDING | {"joints": {"feet": fallen}})
    top = float(marched(folder, data)["displacement"].sel(axis="z")[0])
    name = "loads, column above its joint: top at time zero"
    yield displacement.check(name, sunk + approach - FALL, top)
    last = standing.isel(time=-1)
    name = "loads, column on a joint without preload"
    top = float(last["displacement"].sel(axis="z"))
    yield displacement.check(f"{name}: top", sunk + approach, top)
    force = float(last["pressure"] @ last["contact_area"])
    yield Quantity("contact force", "N").check(f"{name}: joint", pressure * AREA, force)


def _force_checks(folder: Path) -> Iterator[Check]:
    rows = "\n".join(
        f"{time:g},{factor:g}" for time, factor in zip(TIMES, (0.0, 0.5, 1.0), strict=True)
    )
    (folder / "cutting.csv").write_text(f"time_s,factor\n{rows}\n")
    force = {"surface": "top", "force_N": [0.0, 0.0, FORCE], "file": "cutting.csv"}
    changes = {"joints": {"joint": joint(preload_MPa=1e-6 * PRELOAD)}, "loads": {"cut": force}}
    data = column_case(folder, True, changes)
    response = marched(folder, data)
    for time, factor in zip(TIMES[1:], (0.5, 1.0), strict=True):
        pressure = PRELOAD - factor * FORCE / AREA
        approach = separation(pressure) - separation(PRELOAD)
        moved = approach + factor * FORCE / AREA * 2.0 * HALF / MODULUS
        then = response.sel(time=time)
        name = f"loads, two bars and a joint under {-factor * FORCE:g} N"
        top = float(then["displacement"].sel(axis="z"))
        yield Quantity("displacement", "m").check(f"{name}: top", moved, top)
        # The gap equations are solved to 1e-13 m, some 1e-1 Pa here.
        computed = float(then["pressure"].mean())
        yield Quantity("pressure", "Pa", 1e-6).check(f"{name}: joint", pressure, computed)
