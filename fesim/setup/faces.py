"""Faces of the bodies that carry thermometers: there they tell of heat that no source brings.

A face is a piece of a body's free surface that looks in one direction along an axis throughout.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from meshes.structure import Probe, Structure

#: Numbers of facets.
Facets = NDArray[np.int64]


def with_faces(
    structure: Structure, closed: Iterable[str], probes: Iterable[Probe]
) -> tuple[Structure, list[str]]:
    """Return a structure with a surface for the face that each probe is nearest to, and its name.

    Parameters
    ----------
    structure : Structure
        Of the machine.
    closed : iterable of str
        Surfaces through which no heat enters: planes of symmetry, sides of joints.
    probes : iterable of Probe
        The thermometers.
    """
    mesh = structure.mesh
    shut = [np.empty(0, dtype=np.int64), *(structure.surfaces[name] for name in closed)]
    free = np.setdiff1d(mesh.boundary_facets(), np.concatenate(shut))
    cells = mesh.f2t[0, free]
    of_body = {name: free[np.isin(cells, own)] for name, own in structure.bodies.items()}
    pieces = {name: _pieces(structure, facets) for name, facets in of_body.items()}
    faces: dict[str, Facets] = {}
    names = []
    for probe in probes:
        body = probe.body or _body_at(structure, probe.position)
        facets, piece = of_body[body], pieces[body]
        centres = mesh.p[:, mesh.facets[:, facets]].mean(axis=1)
        nearest = np.linalg.norm(centres.T - np.asarray(probe.position), axis=1).argmin()
        names.append(f"{body}, face {piece[nearest]}")
        faces[names[-1]] = facets[piece == piece[nearest]]
    return replace(structure, surfaces=structure.surfaces | faces), names


def _body_at(structure: Structure, position: Sequence[float]) -> str:
    """Body of the cell whose centre is nearest to a position."""
    mesh = structure.mesh
    centres = mesh.p[:, mesh.t].mean(axis=1)
    cell = np.linalg.norm(centres.T - np.asarray(position), axis=1).argmin()
    return next(name for name, own in structure.bodies.items() if cell in own)


def _pieces(structure: Structure, facets: Facets) -> NDArray[np.int32]:
    """Number of the piece of each facet: those hang together by edges and look the same way."""
    corners, looks = structure.mesh.facets[:, facets], _directions(structure, facets)
    rows = np.repeat(np.arange(facets.size), len(corners))
    touch = csr_array((np.ones(rows.size), (rows, corners.T.ravel())))
    shared = (touch @ touch.T).tocoo()
    one = (shared.data > 1.5) & (looks[shared.row] == looks[shared.col])
    near = csr_array((shared.data[one], (shared.row[one], shared.col[one])), shared.shape)
    pieces: NDArray[np.int32] = connected_components(near, directed=False)[1]
    return pieces


def _directions(structure: Structure, facets: Facets) -> NDArray[np.int64]:
    """Direction that each facet looks in: 0 to 2 backwards along x, y and z, 3 to 5 forwards."""
    mesh = structure.mesh
    corners = mesh.p[:, mesh.facets[:3, facets]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], axis=0)
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1)
    normals = normals * np.sign((normals * (corners.mean(axis=1) - inside)).sum(axis=0))
    axis = np.abs(normals).argmax(axis=0)
    forwards = np.take_along_axis(normals, axis[None], axis=0)[0] > 0.0
    return np.asarray(axis + 3 * forwards)
