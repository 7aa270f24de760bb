"""Pairing of the two sides of a joint, with non-matching meshes, into contact elements.

Side a is divided at its edges. A plane part is covered by a rectangular grid of contact elements,
as far as it faces side b; a curved part (a cylindrical seat) is bisected into contact elements that
follow it. Each contact element has its own plane, in which facets of side a, facets of side b and,
on a grid, the cell are clipped against each other, so that integrals over it are exact on both
sides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull
from skfem import Mesh

from meshes.polygons import Polygon, anticlockwise, clip, quadrature, signed_area
from meshes.structure import Structure
from thermojoint.artefacts.errors import InputError

#: A part that deviates from its mean plane by more than this fraction of its size is curved.
FLATNESS = 1e-3
#: Neighbouring facets whose normals differ by more than this belong to different parts, rad.
EDGE = np.deg2rad(20.0)
#: Facets belong to a contact element if their normals differ from its own by less than this, rad.
FACING = np.deg2rad(60.0)
#: A curved part with normals farther than this from their mean is divided by its normals, rad.
ROUND = np.deg2rad(45.0)
#: The grid excludes the part that side b does not reach, if it is more than this fraction of side
#: a. Less is the height of an arc between two meshes of the same round edge.
UNREACHED = 0.02
#: Sides of a rectangle whose lengths differ by less than this fraction are equal.
SQUARE = 1e-9
#: Overlaps smaller than this fraction of a facet are rounding, not contact.
SLIVER = 1e-9
#: A facet may be covered by this fraction in excess of its area, due to rounding.
EXCESS = 1e-6
#: Default number of contact elements along the shorter side: n elements in a row resist rocking by
#: 1 - 1/n^2 of the undivided joint, five by 96 %.
ACROSS = 5
#: Largest default number along the longer side, for elements about as long as they are wide.
ALONG = 15


@dataclass(frozen=True, eq=False)
class PairedJoint:
    """Quadrature points of a joint on both sides, grouped into contact elements."""

    #: The joint's name in the structure.
    name: str
    #: Shapes (m, 3) and (m, 2, 3), for each contact element: unit normal from side a to side b, and
    #: the directions along and across the joint.
    normal: NDArray[np.float64]
    tangents: NDArray[np.float64]
    #: Shape (3, nq): points on each side, m.
    points_a: NDArray[np.float64]
    points_b: NDArray[np.float64]
    #: Shape (nq,): cells behind the facets of the points.
    cells_a: NDArray[np.int64]
    cells_b: NDArray[np.int64]
    #: Shape (nq,): facets of the points.
    facets_a: NDArray[np.int64]
    facets_b: NDArray[np.int64]
    #: Shape (nq,): area weights, m2, on side a.
    weights: NDArray[np.float64]
    #: Shape (nq,): the same on side b; they differ if the sides are not parallel.
    weights_b: NDArray[np.float64]
    #: Shape (nq,): contact element of each point, counted along the joint, part by part.
    element: NDArray[np.int64]
    #: Shapes (m,) and (m, 3): area (m2) and centroid (m) of each contact element.
    area: NDArray[np.float64]
    centre: NDArray[np.float64]
    #: Shape (corners, 3): plane convex pieces of side a that make up the joint, m: overlaps of a
    #: facet of each side and a contact element.
    pieces: tuple[NDArray[np.float64], ...]
    #: Shape (pieces,): contact element of each piece.
    piece_element: NDArray[np.int64]
    #: Shape (m, 3): part of side a, row and column of each contact element; neighbours on a curved
    #: part follow each other in its only row.
    place: NDArray[np.int64]

    @property
    def separation(self) -> NDArray[np.float64]:
        """Distance from side a to side b along the normal at the quadrature points, m."""
        between = self.points_b - self.points_a
        return np.asarray(np.einsum("iq,qi->q", between, self.normal[self.element]))


@dataclass(frozen=True)
class _Plane:
    """A mean plane: origin on side a, frame rows (along, across, normal)."""

    origin: NDArray[np.float64]
    frame: NDArray[np.float64]

    def flat(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coordinates of `points`, shape (..., 3), in the plane's frame, shape (..., 3)."""
        return (points - self.origin) @ self.frame.T


@dataclass(frozen=True)
class _Side:
    """One side of a joint: corners (n, 3 or 4, 3), centres and unit outward normals (n, 3)."""

    facets: NDArray[np.int64]
    corners: NDArray[np.float64]
    centre: NDArray[np.float64]
    normal: NDArray[np.float64]
    area: NDArray[np.float64]

    def moved(self, shift: NDArray[np.float64]) -> _Side:
        """Return the side moved by a shift (3,), m."""
        return replace(self, corners=self.corners + shift, centre=self.centre + shift)

    def lift(self, plane: _Plane, flat: Polygon, facet: int) -> NDArray[np.float64]:
        """Points (n, 3) of a facet over plane coordinates (n, 2)."""
        start = plane.origin + flat @ plane.frame[:2]
        # Along the plane's normal, up to the facet's own plane.
        slope = self.normal[facet] @ plane.frame[2]
        height = (self.centre[facet] - start) @ self.normal[facet] / slope
        return start + height[:, None] * plane.frame[2]


@dataclass(frozen=True)
class _Cell:
    """A contact element before pairing: plane, facets, window on a grid and place in it."""

    plane: _Plane
    facets: NDArray[np.int64]
    window: Polygon | None
    place: tuple[int, int, int]


class _Patch(NamedTuple):
    """Overlap of both sides in a contact element: quadrature points on both sides, and pieces."""

    #: Shapes (nq, 3): quadrature points, m.
    points_a: NDArray[np.float64]
    points_b: NDArray[np.float64]
    #: Shapes (nq,): area weights on each side, m2.
    weights_a: NDArray[np.float64]
    weights_b: NDArray[np.float64]
    #: Shape (nq, 2): index of the facet of each side on which each point lies.
    owner: NDArray[np.int64]
    #: Shape (corners, 3): overlaps of a facet of each side and the contact element, on side a, m.
    pieces: list[NDArray[np.float64]]


class Covered(NamedTuple):
    """Part of side b covered by a contact element at another position of side a."""

    #: Shape (3, nq): quadrature points on side b, m.
    points: NDArray[np.float64]
    #: Shape (nq,): facets of the points, and area weights on side a, m2.
    facets: NDArray[np.int64]
    weights: NDArray[np.float64]
    #: Shape (3,): centroid on side a, m.
    centre: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Movable:
    """A paired joint whose side a can move, with its contact elements."""

    #: Its sides, as meshed.
    side_a: _Side
    side_b: _Side
    #: Its contact elements, in their order.
    cells: tuple[_Cell, ...]

    def covered(self, element: int, shift: NDArray[np.float64]) -> Covered | None:
        """Return the part covered by a contact element with side a moved by a shift (3,), m.

        None if it faces nothing.
        """
        patch = _patch(self.cells[element], self.side_a, self.side_b.moved(-shift))
        if patch is None:
            return None
        return Covered(
            np.ascontiguousarray((patch.points_b + shift).T),
            self.side_b.facets[patch.owner[:, 1]],
            patch.weights_a,
            patch.weights_a @ patch.points_a / patch.weights_a.sum() + shift,
        )


def movable_joint(
    structure: Structure, joint: PairedJoint, along: int | None, across: int | None
) -> Movable:
    """Return a joint from `pair_joint`, with the same `along` and `across`, that can slide."""
    sides = _sides(structure, joint.name)
    every = _contact_cells(structure.mesh, joint.name, sides, along, across)
    by_place = {cell.place: cell for cell in every}
    return Movable(*sides, tuple(by_place[tuple(place)] for place in joint.place.tolist()))


def pair_joint(
    structure: Structure, name: str, along: int | None = None, across: int | None = None
) -> PairedJoint:
    """Divide joint `name` into `along` x `across` contact elements per part.

    Parameters
    ----------
    structure : Structure
        Structure with the joint.
    name : str
        The joint.
    along, across : int, optional
        Contact elements along the longer and the shorter side of each plane part of side a, over
        the part that side b reaches; their product is the total for a curved part. By default
        `ACROSS` across, and along as many as make them square, from `ACROSS` to `ALONG`.

    Raises
    ------
    InputError
        The sides do not face each other, or in several layers; a contact element turns too far.
    """
    mesh = structure.mesh
    side_a, side_b = sides = _sides(structure, name)
    every = _contact_cells(mesh, name, sides, along, across)
    found = [(cell, patch) for cell in every if (patch := _patch(cell, side_a, side_b)) is not None]
    if not found:
        raise InputError(f"joint {name!r}: its sides do not face each other; check the surfaces")
    cells, patches = zip(*found, strict=True)
    weight = np.concatenate([patch.weights_a for patch in patches])
    owner = np.concatenate([patch.owner for patch in patches])
    covered = np.bincount(owner[:, 0], weight, len(side_a.area)) / side_a.area
    if covered.max() > 1.0 + EXCESS:
        raise InputError(
            f"joint {name!r}: several layers of side b lie before the same place of side a; make "
            "each pair of faces its own joint"
        )
    # Grid cells outside an irregular part are empty; the others are numbered consecutively.
    numbers = np.arange(len(cells))
    element = np.repeat(numbers, [len(patch.weights_a) for patch in patches])
    area = np.bincount(element, weight).astype(float)
    on_a = np.concatenate([patch.points_a for patch in patches]).T
    facets_a, facets_b = side_a.facets[owner[:, 0]], side_b.facets[owner[:, 1]]
    frames = np.array([cell.plane.frame for cell in cells])
    return PairedJoint(
        name=name,
        normal=frames[:, 2],
        tangents=frames[:, :2],
        points_a=np.ascontiguousarray(on_a),
        points_b=np.ascontiguousarray(np.concatenate([patch.points_b for patch in patches]).T),
        cells_a=mesh.f2t[0, facets_a],
        cells_b=mesh.f2t[0, facets_b],
        facets_a=facets_a,
        facets_b=facets_b,
        weights=weight,
        weights_b=np.concatenate([patch.weights_b for patch in patches]),
        element=element,
        area=area,
        centre=np.stack([np.bincount(element, weight * x) / area for x in on_a], axis=1),
        pieces=tuple(piece for patch in patches for piece in patch.pieces),
        piece_element=np.repeat(numbers, [len(patch.pieces) for patch in patches]),
        place=np.array([cell.place for cell in cells]),
    )


def _sides(structure: Structure, name: str) -> tuple[_Side, _Side]:
    side_a, side_b = structure.joints[name]
    mesh, surfaces = structure.mesh, structure.surfaces
    return _side(mesh, surfaces[side_a]), _side(mesh, surfaces[side_b])


def _patch(cell: _Cell, side_a: _Side, side_b: _Side) -> _Patch | None:
    """Overlap of both sides in a contact element; None if it faces nothing."""
    points_a, points_b, weights_a, weights_b, owners, pieces = [], [], [], [], [], []
    for i, j, overlap in _overlaps(cell, side_a, side_b):
        flat, weight = quadrature(overlap)
        points_a.append(side_a.lift(cell.plane, flat, i))
        points_b.append(side_b.lift(cell.plane, flat, j))
        # Areas are those of side a, not of its projection.
        weights_a.append(weight / abs(side_a.normal[i] @ cell.plane.frame[2]))
        weights_b.append(weight / abs(side_b.normal[j] @ cell.plane.frame[2]))
        owners.append(np.tile([i, j], (len(weight), 1)))
        pieces.append(side_a.lift(cell.plane, overlap, i))
    if not pieces:
        return None
    return _Patch(
        np.concatenate(points_a),
        np.concatenate(points_b),
        np.concatenate(weights_a),
        np.concatenate(weights_b),
        np.concatenate(owners),
        pieces,
    )


def _side(mesh: Mesh, facets: NDArray[np.int64]) -> _Side:
    corners = facet_corners(mesh, facets)
    vectors = outward_areas(mesh, facets)
    area = np.linalg.norm(vectors, axis=1)
    return _Side(facets, corners, corners.mean(axis=1), vectors / area[:, None], area)


def _overlaps(cell: _Cell, side_a: _Side, side_b: _Side) -> Iterator[tuple[int, int, Polygon]]:
    """Yield (facet of side a, facet of side b, their overlap) in a contact element's plane."""
    flat_a = cell.plane.flat(side_a.corners[cell.facets])[..., :2]
    box = np.array([flat_a.min(axis=(0, 1)), flat_a.max(axis=(0, 1))])
    # Side b's facets on the rim of a curved contact element turn farther than side a's.
    angle = FACING + EDGE
    if cell.window is not None:
        box, angle = np.array([cell.window.min(axis=0), cell.window.max(axis=0)]), FACING
    facing = _facing(cell.plane, side_a.corners[cell.facets], side_b, angle)
    flat_b = cell.plane.flat(side_b.corners[facing])[..., :2]
    inside = _touching(box, _bounds(flat_b))
    facing, polygons = facing[inside], [anticlockwise(flat_b[j]) for j in inside]
    boxes = _bounds(flat_b[inside])
    for i in _touching(box, _bounds(flat_a)):
        facet = anticlockwise(flat_a[i])
        on_cell = facet if cell.window is None else clip(facet, cell.window)
        if len(on_cell) < 3:
            continue
        for j in _touching(_bounds(on_cell[None])[0], boxes):
            overlap = clip(on_cell, polygons[j])
            if len(overlap) >= 3 and signed_area(overlap) >= SLIVER * signed_area(facet):
                yield int(cell.facets[i]), int(facing[j]), overlap


def _facing(
    plane: _Plane, corners: NDArray[np.float64], side: _Side, angle: float
) -> NDArray[np.int64]:
    """Facets of `side` that face a plane, at a distance of at most the extent of `corners`."""
    normal, reach = plane.frame[2], np.ptp(corners.reshape(-1, 3), axis=0).max()
    near = np.abs((side.centre - plane.origin) @ normal) <= reach
    return np.flatnonzero(near & (side.normal @ normal < -np.cos(angle)))


def facet_corners(mesh: Mesh, facets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Corners of `facets` in order around each facet, shape (n, 3 or 4, 3), m."""
    corners = mesh.p[:, mesh.facets[:, facets]].transpose(2, 1, 0)
    if corners.shape[1] == 3:
        return corners
    return np.take_along_axis(corners, cyclic_order(corners)[..., None], axis=1)


def cyclic_order(corners: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the order (n, 4) of the corners (n, 4, 3) of quadrilaterals around each of them."""
    # The mesh lists a quadrilateral's vertices in any order: sort them by angle about its centre.
    centred = corners - corners.mean(axis=1, keepdims=True)
    normal = np.linalg.svd(centred)[2][:, 2]
    first = centred[:, 0]
    second = np.cross(normal, first)
    angle = np.arctan2(
        np.einsum("fvi,fi->fv", centred, second), np.einsum("fvi,fi->fv", centred, first)
    )
    return np.argsort(angle, axis=1)


def outward_areas(mesh: Mesh, facets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Area vectors of boundary `facets`, pointing out of the body, shape (n, 3), m2."""
    corners = facet_corners(mesh, facets)
    around = np.roll(corners, -1, axis=1)
    vectors = 0.5 * np.cross(corners, around).sum(axis=1)
    inside = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1).T
    outward = np.einsum("fi,fi->f", vectors, corners.mean(axis=1) - inside)
    return vectors * np.sign(outward)[:, None]


def _mean_plane(side: _Side, part: NDArray[np.int64]) -> _Plane:
    normal = (side.area[part, None] * side.normal[part]).sum(axis=0)
    normal /= np.linalg.norm(normal)
    points = side.corners[part].reshape(-1, 3)
    origin = points.mean(axis=0)
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    basis = np.stack([first, np.cross(normal, first)])
    along = _long_direction((points - origin) @ basis.T) @ basis
    along *= np.sign(along[np.argmax(np.abs(along))])
    # Rounding would tilt the grid of an axis-parallel joint.
    along[np.abs(along) < 1e-9] = 0.0
    along -= (along @ normal) * normal
    along /= np.linalg.norm(along)
    return _Plane(origin, np.stack([along, np.cross(normal, along), normal]))


def _long_direction(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Direction of the longer side of the smallest rectangle around plane points (n, 2).

    That rectangle has a side along an edge of the convex hull (Freeman & Shapira 1975). Unlike the
    principal axes, it does not depend on how a rectangular patch is meshed. For a square, or
    equivalent rectangles around a disc, the side nearest to the first direction is used, at any
    position of the points.
    """
    hull = points[ConvexHull(points).vertices]
    edges = np.roll(hull, -1, axis=0) - hull
    along = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    length, width = (np.ptp(hull @ direction.T, axis=0) for direction in (along, across))
    area, longest = length * width, np.maximum(length, width)
    least = area <= (1.0 + SQUARE) * area.min()
    sides = np.concatenate([along, across])
    long = np.concatenate([length, width]) >= (1.0 - SQUARE) * np.tile(longest, 2)
    nearest = sides[np.tile(least, 2) & long]
    # Of two equally near ones, one on either side, always the same.
    reached = np.round(np.abs(nearest[:, 0]), 6)
    return nearest[np.lexsort([nearest.prod(axis=1), reached])[-1]]


def _parts(mesh: Mesh, side: _Side) -> list[NDArray[np.int64]]:
    """Connected parts of a side without an edge inside, as indices into it."""

    def smooth(pairs: coo_array) -> NDArray[np.bool_]:
        cosine = np.einsum("pi,pi->p", side.normal[pairs.row], side.normal[pairs.col])
        return np.asarray(cosine > np.cos(EDGE))

    label = linked_parts(mesh.facets[:, side.facets], smooth)
    return [np.flatnonzero(label == k) for k in range(label.max() + 1)]


def linked_parts(
    nodes: NDArray[np.int64], alike: Callable[[coo_array], NDArray[np.bool_]]
) -> NDArray[np.int32]:
    """Return the number of each facet's part, from 0; facets of a part are linked by others.

    Parameters
    ----------
    nodes : ndarray of int, shape (k, n)
        Nodes of each facet.
    alike : callable
        From pairs of facets with common nodes, a sparse array of their number, to which are linked.
    """
    count = nodes.shape[1]
    facet = np.tile(np.arange(count), nodes.shape[0])
    touches = coo_array((np.ones(facet.size), (facet, nodes.ravel()))).tocsr()
    pairs = (touches @ touches.T).tocoo()
    linked = alike(pairs)
    links = coo_array((linked[linked], (pairs.row[linked], pairs.col[linked])), (count, count))
    label: NDArray[np.int32] = connected_components(links, directed=False)[1]
    return label


def _turn(side: _Side, part: NDArray[np.int64]) -> float:
    """Largest angle between the normal of a facet and the mean normal, rad."""
    mean = side.area[part] @ side.normal[part]
    length = np.linalg.norm(mean)
    # The normals of a closed ring cancel out up to rounding.
    if length < 1e-6 * side.area[part].sum():
        return float(np.pi)
    return float(np.arccos(np.clip((side.normal[part] @ mean).min() / length, -1.0, 1.0)))


def _contact_cells(
    mesh: Mesh, name: str, sides: tuple[_Side, ...], along: int | None, across: int | None
) -> Iterator[_Cell]:
    """Yield the contact elements of side a in their order."""
    side, other = sides
    for number, part in enumerate(_parts(mesh, side)):
        plane = None if _turn(side, part) > FACING else _mean_plane(side, part)
        if plane is None or _is_curved(plane.flat(side.corners[part])):
            groups = _bisected(side, part, (along or ACROSS) * (across or ACROSS))
            for column, facets in enumerate(groups):
                if _turn(side, facets) > FACING:
                    raise InputError(
                        f"joint {name!r}: a contact element of its curved side turns through more "
                        f"than {2 * np.rad2deg(FACING):.0f} degrees; raise along x across"
                    )
                yield _Cell(_mean_plane(side, facets), facets, None, (number, 0, column))
            continue
        low, high = _reached(plane, side.corners[part], other)
        rows = across or ACROSS
        columns = along or _square(rows, *(high - low))
        for row, (bottom, top) in enumerate(pairwise(np.linspace(low[1], high[1], rows + 1))):
            grid = np.linspace(low[0], high[0], columns + 1)
            for column, (left, right) in enumerate(pairwise(grid)):
                window = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
                yield _Cell(plane, part, window, (number, row, column))


def _square(rows: int, length: float, width: float) -> int:
    """Number of columns for grid elements about as long as they are wide."""
    return int(np.clip(round(rows * length / width), ACROSS, ALONG))


def _is_curved(flat: NDArray[np.float64]) -> bool:
    return bool(np.ptp(flat[..., 2]) > FLATNESS * np.ptp(flat[..., :2]))


def _reached(plane: _Plane, corners: NDArray[np.float64], other: _Side) -> NDArray[np.float64]:
    """Lowest and highest plane coordinates (2, 2) of the overlap of side b with a plane part."""
    flat = plane.flat(corners)[..., :2]
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    facing = _facing(plane, corners, other, FACING)
    boxes = _bounds(plane.flat(other.corners[facing])[..., :2])
    boxes = boxes[_touching(np.array([low, high]), boxes)]
    if not len(boxes):
        return np.array([low, high])
    least, most = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    slack = UNREACHED * (high - low)
    return np.array(
        [np.where(least > low + slack, least, low), np.where(most < high - slack, most, high)]
    )


def _bisected(side: _Side, part: NDArray[np.int64], count: int) -> Iterator[NDArray[np.int64]]:
    """Divide facets into `count` groups of about equal area, as compact as possible.

    Round parts are first divided across their turn: an element that turns far has no normal.
    """
    if count == 1 or len(part) == 1:
        yield part
        return
    place = _along_longest(side.centre[part])
    if _turn(side, part) > ROUND:
        # Order facets with the same normal by position.
        order = part[np.lexsort([place, np.round(_along_longest(side.normal[part]), 6)])]
    else:
        order = part[np.argsort(place, kind="stable")]
    reached = np.cumsum(side.area[order]) / side.area[order].sum()
    first = count // 2
    cut = int(np.clip(np.searchsorted(reached, first / count - 1e-9) + 1, 1, len(part) - 1))
    yield from _bisected(side, order[:cut], first)
    yield from _bisected(side, order[cut:], count - first)


def _along_longest(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coordinates of points (n, 3) along the direction of their largest extent."""
    centred = points - points.mean(axis=0)
    return centred @ np.linalg.svd(centred, full_matrices=False)[2][0]


def _bounds(polygons: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bounding boxes (n, 2 corners, 2) of polygons (n, corners, 2)."""
    return np.stack([polygons.min(axis=1), polygons.max(axis=1)], axis=1)


def _touching(box: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.int64]:
    apart = (boxes[:, 0] >= box[1]).any(axis=1) | (boxes[:, 1] <= box[0]).any(axis=1)
    return np.flatnonzero(~apart)
