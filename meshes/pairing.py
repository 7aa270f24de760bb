"""Pairs the two sides of a joint, whose meshes need not match, into contact elements.

Each joint patch (a connected part of side a) is covered by a rectangular grid of contact elements.
Facets of side a, facets of side b and grid cells are clipped against each other, so that integrals
over a contact element are exact on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull
from skfem import Mesh

from artefacts.errors import InputError
from meshes.polygons import Polygon, anticlockwise, clip, quadrature, signed_area
from meshes.structure import Structure

#: A side may leave its mean plane by this fraction of the joint's size.
FLATNESS = 1e-3
#: Overlaps smaller than this fraction of a facet are rounding, not contact.
SLIVER = 1e-9


@dataclass(frozen=True)
class PairedJoint:
    """Quadrature points of a joint, known on both sides, grouped into contact elements.

    Attributes
    ----------
    name : str
        The joint's name in the structure.
    normal, tangents : ndarray, shapes (3,) and (2, 3)
        Unit normal from side a to side b, and the directions along and across the joint.
    points_a, points_b : ndarray, shape (3, nq)
        The points on each side, m.
    cells_a, cells_b : ndarray of int, shape (nq,)
        The cells behind the facets they lie on.
    weights : ndarray, shape (nq,)
        Area weights, m2.
    element : ndarray of int, shape (nq,)
        Contact element of each point, counted along the joint, patch by patch.
    area, centre : ndarray, shapes (m,) and (m, 3)
        Area (m2) and centroid (m) of each contact element.
    pieces : tuple of ndarray, each of shape (corners, 3)
        Plane convex pieces of side a that the joint consists of, m: where a facet of each side and
        a contact element overlap.
    piece_element : ndarray of int, shape (pieces,)
        Contact element of each piece.
    """

    name: str
    normal: NDArray[np.float64]
    tangents: NDArray[np.float64]
    points_a: NDArray[np.float64]
    points_b: NDArray[np.float64]
    cells_a: NDArray[np.int64]
    cells_b: NDArray[np.int64]
    weights: NDArray[np.float64]
    element: NDArray[np.int64]
    area: NDArray[np.float64]
    centre: NDArray[np.float64]
    pieces: tuple[NDArray[np.float64], ...]
    piece_element: NDArray[np.int64]


@dataclass(frozen=True)
class _Plane:
    """A joint's mean plane: origin on side a, frame rows (along, across, normal)."""

    origin: NDArray[np.float64]
    frame: NDArray[np.float64]

    def flat(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coordinates of `points`, shape (..., 3), in the plane's frame, shape (..., 3)."""
        return (points - self.origin) @ self.frame.T

    def lift(self, flat: NDArray[np.float64], height: float) -> NDArray[np.float64]:
        """Points (3, n) in space of plane coordinates (n, 2) at a height over the plane."""
        local = np.column_stack([flat, np.full(len(flat), height)])
        return (self.origin + local @ self.frame).T


def pair_joint(structure: Structure, name: str, along: int, across: int) -> PairedJoint:
    """Divide joint `name` into `along` x `across` contact elements per patch.

    Parameters
    ----------
    structure : Structure
        Where the joint lives.
    name : str
        The joint.
    along, across : int
        Contact elements along the longer and the shorter side of each patch.

    Raises
    ------
    InputError
        A side is not plane, or the sides do not face each other.
    """
    mesh = structure.mesh
    side_a, side_b = (structure.surfaces[side] for side in structure.joints[name])
    corners_a, corners_b = facet_corners(mesh, side_a), facet_corners(mesh, side_b)
    plane = _mean_plane(mesh, side_a, corners_a)
    height_a = _height(plane, corners_a, name, "a")
    height_b = _height(plane, corners_b, name, "b")
    flat_a = [anticlockwise(polygon) for polygon in plane.flat(corners_a)[..., :2]]
    flat_b = [anticlockwise(polygon) for polygon in plane.flat(corners_b)[..., :2]]
    boxes_b = _bounds(flat_b)

    points, weights, owners = [], [], []
    pieces, piece_cells = [], []
    for patch, window, cell in _contact_cells(mesh, side_a, flat_a, along, across):
        for i in patch:
            on_cell = clip(flat_a[i], window)
            if len(on_cell) < 3:
                continue
            for j in _touching(_bounds([on_cell])[0], boxes_b):
                overlap = clip(on_cell, flat_b[j])
                if len(overlap) < 3 or signed_area(overlap) < SLIVER * signed_area(flat_a[i]):
                    continue
                x, w = quadrature(overlap)
                points.append(x)
                weights.append(w)
                owners.append(np.tile([i, j], (len(w), 1)))
                pieces.append(plane.lift(overlap, height_a).T)
                piece_cells.append(cell)
    if not points:
        raise InputError(f"joint {name!r}: its sides do not face each other; check the surfaces")
    flat, weight = np.concatenate(points), np.concatenate(weights)
    owner = np.concatenate(owners)
    # Grid cells outside an irregular patch hold nothing; number the others without gaps.
    _, piece_element = np.unique(piece_cells, return_inverse=True)
    element = np.repeat(piece_element, [len(w) for w in weights])
    area = np.bincount(element, weight).astype(float)
    on_a = plane.lift(flat, height_a)
    centre = np.stack([np.bincount(element, weight * x) / area for x in on_a], axis=1)
    return PairedJoint(
        name=name,
        normal=plane.frame[2],
        tangents=plane.frame[:2],
        points_a=on_a,
        points_b=plane.lift(flat, height_b),
        cells_a=mesh.f2t[0, side_a[owner[:, 0]]],
        cells_b=mesh.f2t[0, side_b[owner[:, 1]]],
        weights=weight,
        element=element,
        area=area,
        centre=centre,
        pieces=tuple(pieces),
        piece_element=piece_element,
    )


def facet_corners(mesh: Mesh, facets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Corners of `facets` in order around each facet, shape (n, 3 or 4, 3), m."""
    corners = mesh.p[:, mesh.facets[:, facets]].transpose(2, 1, 0)
    if corners.shape[1] == 3:
        return corners
    # The mesh lists a quadrilateral's vertices in any order: sort them by angle about its centre.
    centred = corners - corners.mean(axis=1, keepdims=True)
    normal = np.linalg.svd(centred)[2][:, 2]
    first = centred[:, 0]
    second = np.cross(normal, first)
    angle = np.arctan2(
        np.einsum("fvi,fi->fv", centred, second), np.einsum("fvi,fi->fv", centred, first)
    )
    return np.take_along_axis(corners, np.argsort(angle, axis=1)[..., None], axis=1)


def outward_areas(mesh: Mesh, facets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Area vectors of boundary `facets`, pointing out of the body, shape (n, 3), m2."""
    corners = facet_corners(mesh, facets)
    around = np.roll(corners, -1, axis=1)
    vectors = 0.5 * np.cross(corners, around).sum(axis=1)
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1).T
    outward = np.einsum("fi,fi->f", vectors, corners.mean(axis=1) - inside)
    return vectors * np.sign(outward)[:, None]


def _mean_plane(mesh: Mesh, side_a: NDArray[np.int64], corners: NDArray[np.float64]) -> _Plane:
    normal = outward_areas(mesh, side_a).sum(axis=0)
    normal /= np.linalg.norm(normal)
    points = corners.reshape(-1, 3)
    origin = points.mean(axis=0)
    patch = corners[_largest_patch(mesh, side_a)].reshape(-1, 3) - origin
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    basis = np.stack([first, np.cross(normal, first)])
    along = _long_direction(patch @ basis.T) @ basis
    along *= np.sign(along[np.argmax(np.abs(along))])
    # Rounding would tilt the grid against an axis-parallel joint.
    along[np.abs(along) < 1e-9] = 0.0
    along -= (along @ normal) * normal
    along /= np.linalg.norm(along)
    return _Plane(origin, np.stack([along, np.cross(normal, along), normal]))


def _long_direction(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Direction of the longer side of the smallest rectangle around plane points (n, 2).

    That rectangle has a side along an edge of the convex hull (Freeman & Shapira 1975). Unlike the
    principal axes, it does not depend on how a rectangular patch is meshed.
    """
    hull = points[ConvexHull(points).vertices]
    edges = np.roll(hull, -1, axis=0) - hull
    along = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    length, width = (np.ptp(hull @ direction.T, axis=0) for direction in (along, across))
    best = int(np.argmin(length * width))
    return along[best] if length[best] >= width[best] else across[best]


def _height(plane: _Plane, corners: NDArray[np.float64], name: str, side: str) -> float:
    local = plane.flat(corners)
    heights = local[..., 2]
    if np.ptp(heights) > FLATNESS * np.ptp(local[..., :2]):
        raise InputError(
            f"joint {name!r}: side {side} leaves its mean plane by {np.ptp(heights):.2e} m; "
            "split the joint into plane ones"
        )
    return float(heights.mean())


def _patches(mesh: Mesh, side: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Connected parts of a side (facets sharing a node), as indices into `side`."""
    nodes = mesh.facets[:, side]
    count = nodes.shape[1]
    facet = np.tile(np.arange(count), nodes.shape[0])
    touches = coo_array((np.ones(facet.size), (facet, nodes.ravel()))).tocsr()
    _, label = connected_components(touches @ touches.T, directed=False)
    return [np.flatnonzero(label == k) for k in range(label.max() + 1)]


def _largest_patch(mesh: Mesh, side: NDArray[np.int64]) -> NDArray[np.int64]:
    return max(_patches(mesh, side), key=len)


def _contact_cells(
    mesh: Mesh, side: NDArray[np.int64], flat: list[Polygon], along: int, across: int
) -> list[tuple[NDArray[np.int64], Polygon, int]]:
    """List (facets of the patch, grid cell as a polygon, number) for every contact element."""
    cells: list[tuple[NDArray[np.int64], Polygon, int]] = []
    for patch in _patches(mesh, side):
        box = _bounds([flat[i] for i in patch])
        low, high = box[:, 0].min(axis=0), box[:, 1].max(axis=0)
        rows = pairwise(np.linspace(low[1], high[1], across + 1))
        for bottom, top in rows:
            for left, right in pairwise(np.linspace(low[0], high[0], along + 1)):
                window = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
                cells.append((patch, window, len(cells)))
    return cells


def _bounds(polygons: list[Polygon]) -> NDArray[np.float64]:
    """Bounding boxes, shape (n, 2 corners, 2)."""
    return np.array([[polygon.min(axis=0), polygon.max(axis=0)] for polygon in polygons])


def _touching(box: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.int64]:
    apart = (boxes[:, 0] >= box[1]).any(axis=1) | (boxes[:, 1] <= box[0]).any(axis=1)
    return np.flatnonzero(~apart)
