"""Structures of verification cases, blocks and pairs of bars, and the march of a case."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from skfem import Mesh, MeshHex, MeshTet

from fesim.case.schema import case_from_data
from fesim.simulate import simulate
from fesim.solid.materials import Material
from meshes.box_grid import put_side_by_side
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array

IRON = Material(
    conductivity=47.0,
    density=7200.0,
    heat_capacity=500.0,
    youngs_modulus=104e9,
    poisson_ratio=0.27,
    expansion=13.7e-6,
)
STEEL = Material(
    conductivity=16.0,
    density=7800.0,
    heat_capacity=460.0,
    youngs_modulus=200e9,
    poisson_ratio=0.31,
    expansion=11.0e-6,
)


def material_section(material: Material) -> dict[str, float]:
    """Return a material as a section of a case."""
    return {
        "conductivity_W_mK": material.conductivity,
        "density_kg_m3": material.density,
        "heat_capacity_J_kgK": material.heat_capacity,
        "youngs_modulus_GPa": 1e-9 * material.youngs_modulus,
        "poisson_ratio": material.poisson_ratio,
        "expansion_1_K": material.expansion,
    }


def marched(folder: Path, data: dict[str, Any]) -> xr.Dataset:
    """Return the response of a case, given by its data, whose files are in a folder."""
    return simulate(case_from_data(data, "case", folder), accuracy=False).response


#: An implicit Euler step of this length reaches the steady state, s.
FOREVER = 1e15

#: Cell types of verification cases, and their elements for temperature and displacement.
KINDS: dict[str, type[Mesh]] = {"hexahedra": MeshHex, "tetrahedra": MeshTet}
ELEMENTS = {"hexahedra": ("Hex1", "HexS2"), "tetrahedra": ("TetP1", "TetP2")}


def box_grid(
    kind: str,
    divisions: tuple[int, int, int],
    size: tuple[float, float, float],
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Mesh:
    """Return a regular mesh of a box with a corner at `start`; lengths in m."""
    lines = [
        np.linspace(low, low + length, count + 1)
        for low, length, count in zip(start, size, divisions, strict=True)
    ]
    return KINDS[kind].init_tensor(*lines)


def shaken(mesh: Mesh, share: float, seed: int) -> Mesh:
    """Move the nodes inside a regular mesh at random, by up to `share` of the spacing."""
    low, high = mesh.p.min(axis=1, keepdims=True), mesh.p.max(axis=1, keepdims=True)
    slack = 1e-9 * (high - low)
    inside = ((mesh.p > low + slack) & (mesh.p < high - slack)).all(axis=0)
    spacing = [float(np.diff(np.unique(np.round(line, 9))).min()) for line in mesh.p]
    points = mesh.p.copy()
    moves = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, int(inside.sum())))
    points[:, inside] += share * np.array(spacing)[:, None] * moves
    return type(mesh)(points, mesh.t)


def bent(mesh: Mesh, move: Callable[[Array], Array]) -> Mesh:
    """Move every node x (3, n) by move(x) (3, n), m."""
    return type(mesh)(mesh.p + move(mesh.p), mesh.t)


def box_surfaces(mesh: Mesh) -> dict[str, NDArray[np.int64]]:
    """Return the facets on the low and the high side of the mesh along x, y and z: "x0" to "z1"."""
    facets = mesh.boundary_facets()
    centres = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
    surfaces = {}
    for axis, name in enumerate("xyz"):
        ends = mesh.p[axis].min(), mesh.p[axis].max()
        for number, end in enumerate(ends):
            on_it = np.abs(centres[axis] - end) < 1e-9 * (ends[1] - ends[0])
            surfaces[f"{name}{number}"] = facets[on_it]
    return surfaces


def block(mesh: Mesh) -> Structure:
    """Return a structure of one body called "block" with the surfaces of its bounding box."""
    return Structure(mesh, {"block": np.arange(mesh.nelements)}, box_surfaces(mesh))


#: Lengths of the two bars along x, and their section, m.
LEFT, RIGHT = 0.10, 0.15
SECTION = (0.06, 0.04)


def two_bars(left: Mesh, right: Mesh) -> Structure:
    """Return bodies "left" and "right" that face each other in a joint called "joint".

    `right` begins at the x where `left` ends; they share no node.
    """
    mesh, bodies = put_side_by_side([left, right])
    return Structure(
        mesh,
        bodies=dict(zip(("left", "right"), bodies, strict=True)),
        surfaces=box_surfaces(mesh) | facing_sides(mesh, 0, float(left.p[0].max())),
        joints={"joint": ("joint.a", "joint.b")},
    )


def facing_sides(mesh: Mesh, axis: int, place: float) -> dict[str, NDArray[np.int64]]:
    """Return the facets "joint.a" and "joint.b" of two bodies that meet in a plane.

    The plane is normal to an axis (0, 1, 2) at a coordinate, m; side a is at lower coordinates.
    """
    facets = mesh.boundary_facets()
    at = mesh.p[axis, mesh.facets[:, facets]].mean(axis=0)
    between = facets[np.abs(at - place) < 1e-9]
    lower = mesh.p[axis, mesh.t[:, mesh.f2t[0, between]]].mean(axis=0) < place
    return {"joint.a": between[lower], "joint.b": between[~lower]}


def bars(kind: str, left: tuple[int, int, int], right: tuple[int, int, int]) -> Structure:
    """Return two bars along x, `LEFT` and `RIGHT` long, with `SECTION`."""
    return two_bars(
        box_grid(kind, left, (LEFT, *SECTION)),
        box_grid(kind, right, (RIGHT, *SECTION), (LEFT, 0.0, 0.0)),
    )
