"""A structure: a mesh with named bodies, surfaces, joint sides and probes; checked on creation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import InputError, shown_point, unknown_name

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from skfem import Mesh


@dataclass(frozen=True)
class Probe:
    """A named point on or in a body."""

    #: Coordinates x, y, z, m.
    position: tuple[float, float, float]
    #: Body of the probe; needed only where two bodies touch.
    body: str | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Structure(Described):
    """A mesh with named bodies, surfaces, joints and probes.

    Attributes
    ----------
    mesh : skfem.Mesh
        Hexahedra or tetrahedra, coordinates in m. Bodies separated by a joint share no node.
    bodies : dict of str to ndarray of int
        Cells of each body; every cell belongs to exactly one body.
    surfaces : dict of str to ndarray of int
        Boundary facets of each named surface; surfaces may overlap.
    joints : dict of str to (str, str)
        The two surfaces (side a, side b) that face each other.
    probes : dict of str to Probe
        Named points.
    symmetry_factor : int
        Number of copies of the mesh in the whole structure (2 for a half model).
    """

    mesh: Mesh
    bodies: dict[str, NDArray[np.int64]]
    surfaces: dict[str, NDArray[np.int64]]
    joints: dict[str, tuple[str, str]] = field(default_factory=dict)
    probes: dict[str, Probe] = field(default_factory=dict)
    symmetry_factor: int = 1

    def _facts(self) -> dict[str, str]:
        return {
            "bodies": ", ".join(self.bodies),
            "joints": ", ".join(self.joints) or "none",
            "nodes": str(self.mesh.nvertices),
            "cells": str(self.mesh.nelements),
        }

    def __post_init__(self) -> None:
        """Check that the names and the mesh are consistent."""
        _check_mesh(self.mesh)
        _check_bodies(self)
        _check_surfaces(self)
        _check_joints(self)
        _check_probes(self)

    def body(self, name: str, where: str = "structure") -> NDArray[np.int64]:
        """Return the cells of a body; if there is none, an InputError suggests the closest name.

        Parameters
        ----------
        name : str
            The body.
        where : str
            Place of the name, for the error message.
        """
        if name not in self.bodies:
            raise unknown_name("body", name, self.bodies, where)
        return self.bodies[name]

    def surface(self, name: str, where: str = "structure") -> NDArray[np.int64]:
        """Return the facets of a surface; if there is none, an InputError suggests a name.

        Parameters
        ----------
        name : str
            The surface.
        where : str
            Place of the name, for the error message.
        """
        if name not in self.surfaces:
            raise unknown_name("surface", name, self.surfaces, where)
        return self.surfaces[name]


def _check_mesh(mesh: Mesh) -> None:
    if mesh.dim() != 3 or mesh.t.shape[0] not in (4, 8):
        raise InputError(
            f"structure: mesh is {type(mesh).__name__}; use tetrahedra or hexahedra in 3-D"
        )
    if not bool(np.isfinite(mesh.p).all()):
        bad = int(np.flatnonzero(~np.isfinite(mesh.p).all(axis=0))[0])
        raise InputError(
            f"structure: node {bad} has a coordinate that is not finite; correct the mesh"
        )


def _check_bodies(structure: Structure) -> None:
    count = np.zeros(structure.mesh.nelements, dtype=int)
    for name, cells in structure.bodies.items():
        if cells.size == 0:
            raise InputError(f"structure: body {name!r} has no cells; remove it or fix its name")
        if cells.min() < 0 or cells.max() >= count.size:
            raise InputError(f"structure: body {name!r} names cells that the mesh does not have")
        count[cells] += 1
    if not bool((count == 1).all()):
        none, many = int((count == 0).sum()), np.flatnonzero(count > 1)
        several = ""
        if many.size:
            names = [repr(name) for name, cells in structure.bodies.items() if many[0] in cells]
            several = f", the first in {' and '.join(names)}"
        raise InputError(
            f"structure: {none} cells are in no body and {many.size} in several{several}; put each "
            "in exactly one"
        )


def _check_surfaces(structure: Structure) -> None:
    outside = structure.mesh.boundary_facets()
    for name, facets in structure.surfaces.items():
        if facets.size == 0:
            raise InputError(
                f"structure: surface {name!r} has no facets; remove it or correct its name"
            )
        if not bool(np.isin(facets, outside).all()):
            raise InputError(
                f"structure: surface {name!r} has facets inside a body; surfaces are boundaries"
            )


def _check_joints(structure: Structure) -> None:
    for name, sides in structure.joints.items():
        for side in sides:
            structure.surface(side, f"joint {name!r}")
        side_a, side_b = (structure.surfaces[side] for side in sides)
        if np.intersect1d(side_a, side_b).size:
            raise InputError(f"structure: the sides of joint {name!r} share facets; separate them")


def _check_probes(structure: Structure) -> None:
    low, high = structure.mesh.p.min(axis=1), structure.mesh.p.max(axis=1)
    slack = 1e-6 * float((high - low).max())
    for name, probe in structure.probes.items():
        x = np.asarray(probe.position)
        if not bool(np.isfinite(x).all()) or bool(
            (x < low - slack).any() | (x > high + slack).any()
        ):
            raise InputError(
                f"structure: probe {name!r} at {shown_point(x)} m lies outside the mesh, which "
                f"spans {shown_point(low)} to {shown_point(high)} m; fix its position or its unit"
            )
        if probe.body is not None:
            structure.body(probe.body, f"probe {name!r}")
