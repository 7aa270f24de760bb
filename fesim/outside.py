"""Outer faces and contact elements of a machine as triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.setup.machine import Setup
from meshes.faces import boundary_faces, triangles_of
from thermojoint.artefacts.arrays import Array


class Triangles(NamedTuple):
    """Triangles, with the unknown of each corner or the contact element of each triangle."""

    #: Shape (n, 3): corners, m.
    points: Array
    #: Shape (t, 3): indices of the corners of each triangle.
    corners: NDArray[np.int64]
    #: On the outside: the unknown of `Setup.spaces.heat` at each corner. In the joints: the contact
    #: element of each triangle.
    of: NDArray[np.int64]


def outside_of(setup: Setup) -> Triangles:
    """Return all boundary faces of a machine, including those in its joints."""
    mesh = setup.structure.mesh
    used, corners = np.unique(boundary_faces(mesh, mesh.boundary_facets()), return_inverse=True)
    faces = corners.reshape(-1, len(mesh.elem.refdom.facets[0]))
    return Triangles(
        np.ascontiguousarray(mesh.p[:, used].T),
        triangles_of(faces),
        np.asarray(setup.spaces.heat.nodal_dofs[0][used], dtype=np.int64),
    )


def contacts_of(setup: Setup) -> Triangles:
    """Return the contact elements, on side a of all joints."""
    points: list[Array] = [np.empty((0, 3))]
    triangles: list[NDArray[np.int64]] = [np.empty((0, 3), dtype=np.int64)]
    contacts: list[NDArray[np.int64]] = [np.empty(0, dtype=np.int64)]
    count, first = 0, 0
    for joint in setup.joints:
        for corners, element in zip(joint.pieces, joint.piece_element, strict=True):
            fan = triangles_of(count + np.arange(len(corners))[None, :])
            points.append(corners)
            triangles.append(fan)
            contacts.append(np.full(len(fan), first + int(element)))
            count += len(corners)
        first += len(joint.area)
    return Triangles(np.concatenate(points), np.concatenate(triangles), np.concatenate(contacts))
