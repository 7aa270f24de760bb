"""Faces of the bodies with thermometers, where these detect heat that comes from no source.

A face is a piece of a body's free surface whose normal has one direction along an axis.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from fesim.solid.spaces import probe_cells
from meshes.pairing import linked_parts, outward_areas
from meshes.structure import Probe, Structure

#: Indices of facets.
Facets = NDArray[np.int64]
#: Directions of the normal of a facet.
LOOKS = ("-x", "-y", "-z", "+x", "+y", "+z")


def with_faces(
    structure: Structure, closed: Iterable[str], probes: Mapping[str, Probe]
) -> tuple[Structure, dict[str, str]]:
    """Return a structure with a surface for the nearest face of each probe, and the faces' names.

    No heat enters through `closed` surfaces: planes of symmetry, sides of joints.
    """
    mesh = structure.mesh
    shut = [np.empty(0, dtype=np.int64), *(structure.surfaces[name] for name in closed)]
    free = np.setdiff1d(mesh.boundary_facets(), np.concatenate(shut))
    within = dict(zip(probes, probe_cells(structure, probes), strict=True))
    faces: dict[str, Facets] = {}
    names: dict[str, str] = {}
    for body, cells in structure.bodies.items():
        own = [name for name, cell in within.items() if cell in cells]
        if not own:
            continue
        facets = free[np.isin(mesh.f2t[0, free], cells)]
        piece = _pieces(structure, facets)
        centres = mesh.p[:, mesh.facets[:, facets]].mean(axis=1).T
        for name in own:
            nearest = np.linalg.norm(centres - np.asarray(probes[name].position), axis=1).argmin()
            names[name] = f"{body}, face {piece[nearest]}"
            faces[names[name]] = facets[piece == piece[nearest]]
    return replace(structure, surfaces=structure.surfaces | faces), names


def _pieces(structure: Structure, facets: Facets) -> NDArray[np.int32]:
    """Number of the piece of each facet: a piece is connected by edges and has one direction."""
    looks = directions_of(structure, facets)

    def one(pairs: coo_array) -> NDArray[np.bool_]:
        return np.asarray((pairs.data > 1.5) & (looks[pairs.row] == looks[pairs.col]))

    return linked_parts(structure.mesh.facets[:, facets], one)


def directions_of(structure: Structure, facets: Facets) -> NDArray[np.int64]:
    """Return the direction of each facet as its index in `LOOKS`."""
    areas = outward_areas(structure.mesh, facets)
    axis = np.abs(areas).argmax(axis=1)
    return np.asarray(axis + 3 * (np.take_along_axis(areas, axis[:, None], axis=1)[:, 0] > 0.0))
