"""Forces and stresses from case files: supports, joints and points of loaded columns and a ring.

The foot and the joint of a column carry its weight and a force. A thick ring under internal
pressure has the stresses of Lame: sigma_r, sigma_t = A -+ B/r^2 with A = p a^2/(b^2 - a^2), B = A
b^2; without axial strain the axial stress is nu (sigma_r + sigma_t).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import xarray as xr
from skfem import MeshHex

from fesim.case.schema import case_from_data
from fesim.march.machine import Step
from fesim.setup.machine import set_up
from fesim.simulate import simulate
from fesim.snapshots import structure_snapshot
from meshes.exchange import write_structure
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.files import temporary_folder
from thermojoint.verification.check import Check, Quantity
from thermojoint.verification.loaded import AREA, DENSITY, GRAVITY, HALF, WEIGHT, column_case, joint
from thermojoint.verification.structures import marched

#: Force on the top of the column, N.
FORCE = (600.0, 0.0, -8000.0)
PRELOAD = 2e6
#: The ring: inner and outer radius, thickness, m; pressure, Pa; Poisson's ratio; the probe's
#: radius, m; elements around a quarter and along the radius.
INNER, OUTER, THICK = 0.1, 0.2, 0.02
PRESSURE, POISSON, AT = 40e6, 0.3, 0.15
AROUND, ALONG = 32, 20
SUPPORT = Quantity("support", "N", source="equilibrium")
STRESS = Quantity("stress", "MPa", source="Lame, equilibrium")


def checks() -> Iterator[Check]:
    """Check forces and stresses in columns and a ring."""
    with temporary_folder() as folder:
        yield from _column_checks(folder)
        yield from _ring_checks(folder)


def _column_checks(folder: Path) -> Iterator[Check]:
    changes = {
        "supports": {"fixed": ["foot"]},
        "joints": {"joint": joint(preload_MPa=1e-6 * PRELOAD)},
        "loads": {"push": {"surface": "top", "force_N": list(FORCE)}, **WEIGHT},
        "output": {"forces": True},
    }
    last = marched(folder, column_case(folder, True, changes)).isel(time=-1)
    half = DENSITY * GRAVITY * HALF * AREA
    foot = last["reaction"].sel(support="foot")
    for axis, reference in (("x", -FORCE[0]), ("z", -FORCE[2] + 2.0 * half)):
        computed = float(foot.sel(space=axis))
        yield SUPPORT.check(f"forces, column, foot along {axis}", reference, computed)
    across = last["joint_force"].sel(joint="joint")
    moment = last["joint_moment"].sel(joint="joint")
    # The upper half is side b: the joint carries its load and the preload.
    carried = {
        "shear force": (-FORCE[0], across.sel(space="x"), "N"),
        "normal force": (PRELOAD * AREA - FORCE[2] + half, across.sel(space="z"), "N"),
        "bending moment": (-FORCE[0] * HALF, moment.sel(space="y"), "N m"),
    }
    for name, (reference, carried_load, unit) in carried.items():
        resultant = Quantity("resultant", unit, source="equilibrium")
        yield resultant.check(f"forces, column, joint's {name}", reference, float(carried_load))
    pressed = {
        "loads": {"push": {"surface": "top", "pressure_MPa": 5.0}},
        "output": {"stress_probes": ["P"]},
    }
    response = marched(folder, column_case(folder, False, pressed))
    point = response.isel(time=-1).sel(stress_probe="P")
    yield STRESS.check("forces, column, along its axis", -5.0, _mpa(point["stress"][2]))
    yield STRESS.check("forces, column, von Mises", 5.0, _mpa(point["von_mises"]))


def _ring_checks(folder: Path) -> Iterator[Check]:
    write_structure(quarter_ring(), folder / "ring.vtu")
    data = column_case(folder, False, {})
    data["structure"]["file"] = "ring.vtu"
    data["materials"]["iron"]["poisson_ratio"] = POISSON
    data["bodies"] = {"ring": "iron"}
    data["supports"] = {"symmetry": {"x0": "x", "y0": "y", "low": "z", "high": "z"}}
    data["loads"] = {"inside": {"surface": "bore", "pressure_MPa": 1e-6 * PRESSURE}}
    middle = AT / np.sqrt(2.0)
    place = [1e3 * middle, 1e3 * middle, 5e2 * THICK]
    data["probes"] = {"P": {"position_mm": place, "body": "ring"}}
    data["displacement"] = {"point": "P"}
    data["output"] = {"stress_probes": ["P"], "forces": True}
    case = case_from_data(data, "bearing", folder)
    steps: list[Step] = []
    setup = set_up(case)
    last = simulate(case, setup=setup, on_step=steps.append, accuracy=False).response.isel(time=-1)
    computed = last["principal_stress"].sel(stress_probe="P").to_numpy()
    for (name, reference), stress in zip(ring_stresses(AT).items(), computed, strict=True):
        compared = replace(STRESS, tolerance=5e-3)
        yield compared.check(f"forces, thick ring, {name}", 1e-6 * reference, 1e-6 * stress)
    yield from _field_checks(structure_snapshot(setup, steps[-1]))
    # The pressure separates the halves of the ring: p a in each section.
    held = float(last["reaction"].sel(support="x0", space="x"))
    support = replace(SUPPORT, tolerance=1e-3)
    yield support.check("forces, thick ring, cut", -PRESSURE * INNER * THICK, held)


def ring_stresses(radius: float) -> dict[str, float]:
    """Lame's principal stresses at a radius, Pa, the largest first."""
    mean = PRESSURE * INNER**2 / (OUTER**2 - INNER**2)
    apart = mean * OUTER**2 / radius**2
    return {"around": mean + apart, "along the axis": 2.0 * POISSON * mean, "radial": mean - apart}


def _field_checks(grid: meshio.Mesh) -> Iterator[Check]:
    """The snapshot's stresses at nodes on the bore, near mid radius and on the rim."""
    for name, radius in (("on the bore", INNER), ("near mid radius", AT), ("on the rim", OUTER)):
        place = np.array([radius, radius, THICK / np.sqrt(2.0)]) / np.sqrt(2.0)
        node = int(np.argmin(np.linalg.norm(grid.points - place, axis=1)))
        exact = ring_stresses(float(np.hypot(*grid.points[node, :2])))
        around, axial, radial = exact.values()
        mises = np.sqrt(
            0.5 * ((around - axial) ** 2 + (axial - radial) ** 2 + (radial - around) ** 2)
        )
        principal = grid.point_data["principal_stress_Pa"][node]
        computed = grid.point_data["von_mises_Pa"][node]
        title, stress = f"forces, thick ring, snapshot {name}", replace(STRESS, tolerance=1e-3)
        yield stress.check(f"{title}, around", _mpa(around), _mpa(principal[0]))
        yield stress.check(f"{title}, von Mises", _mpa(mises), _mpa(computed))


def quarter_ring() -> Structure:
    """Return a quarter of the ring between x = 0 and y = 0."""
    grid = MeshHex.init_tensor(
        np.linspace(0.0, 1.0, ALONG + 1),
        np.linspace(0.0, 1.0, AROUND + 1),
        np.linspace(0.0, 1.0, 3),
    )
    share, turn, height = grid.p
    radius, angle = INNER * (OUTER / INNER) ** share, 0.5 * np.pi * turn
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), THICK * height])
    mesh = MeshHex(points, grid.t)
    facets = grid.boundary_facets()
    at = grid.p[:, grid.facets[:, facets]].mean(axis=1)
    names = {"bore": (0, 0.0), "y0": (1, 0.0), "x0": (1, 1.0), "low": (2, 0.0), "high": (2, 1.0)}
    surfaces = {
        name: facets[np.abs(at[axis] - place) < 1e-9] for name, (axis, place) in names.items()
    }
    return Structure(mesh, {"ring": np.arange(mesh.nelements)}, surfaces)


def _mpa(stress: xr.DataArray | Array | float) -> float:
    return 1e-6 * float(stress)
