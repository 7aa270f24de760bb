"""Inspection of a structure before simulation: contents, quality and suspicious features."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skfem import Mesh
from skfem.quadrature import get_quadrature

from meshes.pairing import facet_corners, outward_areas, pair_joint
from meshes.quality import cell_quality, cell_volumes
from meshes.structure import Structure
from meshes.units import USUAL_SIZE
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

#: Cells below this quality give inaccurate stresses.
POOR = 0.1
#: Largest distance between facing facets, relative to the structure's size.
TOUCHING = 1e-4
#: Largest number of points of a body that are searched for in another one.
MOST_POINTS = 200
#: Largest distance between coinciding corners, relative to the structure's size.
SAME = 1e-8


@dataclass(frozen=True)
class BodyFacts:
    """A body: cells, volume (m3), extent along x, y, z (m), and number of separate pieces."""

    cells: int
    volume: float
    extent: tuple[float, float, float]
    pieces: int


@dataclass(frozen=True)
class SurfaceFacts:
    """A surface: facets, area (m2), mean outward normal (shorter than 1 if not plane), bodies."""

    facets: int
    area: float
    normal: tuple[float, float, float]
    bodies: tuple[str, ...]


@dataclass(frozen=True)
class JointFacts:
    """A joint."""

    #: Areas of the sides and of their common part, m2; facets of a joint count as planes.
    area_a: float
    area_b: float
    overlap: float
    #: Smallest and largest distance from side a to side b along the normal, m; negative in an
    #: overlap.
    gap: tuple[float, float]
    #: Largest angle between facing facets, degrees.
    misalignment: float
    #: Number of different normals among the contact elements.
    parts: int
    #: Whether the facets of the two sides coincide.
    matching: bool


@dataclass(frozen=True)
class Inspection:
    """Results of `inspect`."""

    #: Type of the cells.
    kind: str
    #: Numbers of nodes and cells.
    nodes: int
    cells: int
    #: Extent along x, y and z, m.
    extent: tuple[float, float, float]
    #: By name.
    bodies: dict[str, BodyFacts]
    surfaces: dict[str, SurfaceFacts]
    joints: dict[str, JointFacts]
    #: Position, m, and body specified for a probe.
    probes: dict[str, tuple[tuple[float, float, float], str | None]]
    #: Quality of the cells: ``worst``, ``1 %`` and ``median``.
    quality: dict[str, float]
    #: Position of the worst cell, m.
    worst_cell: tuple[float, float, float]
    #: Boundary without a name, m2, and therefore without convection.
    unnamed_area: float
    #: Suspicious features, one line each.
    warnings: tuple[str, ...]


def inspect(structure: Structure, riding: Collection[str] = ()) -> Inspection:
    """Inspect a structure.

    Parameters
    ----------
    structure : Structure
    riding : collection of str
        Joints on an axis, whose guides extend beyond the part covered in the mesh.
    """
    mesh = structure.mesh
    quality = cell_quality(mesh)
    worst = int(np.argmin(quality))
    named = np.unique(np.concatenate([np.empty(0, int), *structure.surfaces.values()]))
    unnamed = np.setdiff1d(mesh.boundary_facets(), named)
    joints: dict[str, JointFacts] = {}
    warnings: list[str] = []
    for name in structure.joints:
        try:
            joints[name] = _joint(structure, name)
        except InputError as error:
            warnings.append(str(error))
    sides = [structure.surfaces[side] for pair in structure.joints.values() for side in pair]
    bodies = _bodies(structure)
    extent = _triple(np.ptp(mesh.p, axis=1))
    bare_area = float(_curved_areas(mesh, unnamed)[0].sum())
    return Inspection(
        kind=_kind(structure),
        nodes=int(mesh.p.shape[1]),
        cells=int(mesh.nelements),
        extent=extent,
        bodies=bodies,
        surfaces={name: _surface(structure, name) for name in structure.surfaces},
        joints=joints,
        probes={name: (probe.position, probe.body) for name, probe in structure.probes.items()},
        quality={
            "worst": float(quality[worst]),
            "1 %": float(np.quantile(quality, 0.01)),
            "median": float(np.median(quality)),
        },
        worst_cell=_triple(mesh.p[:, mesh.t[:, worst]].mean(axis=1)),
        unnamed_area=bare_area,
        warnings=(
            *_size_warning(extent),
            *_quality_warning(structure, quality),
            *_piece_warnings(bodies),
            *_glue_warnings(structure),
            *overlap_warnings(structure),
            *warnings,
            *_joint_warnings(joints),
            *_bare_warnings(
                structure, {name: one for name, one in joints.items() if name not in riding}
            ),
            *_partner_warnings(structure),
            *facing_warnings(structure, sides),
            *seam_warnings(structure, sides),
            *hinge_warnings(structure),
        ),
    )


def _kind(structure: Structure) -> str:
    shape = "tetrahedra" if structure.mesh.t.shape[0] == 4 else "hexahedra"
    order = "straight" if structure.mesh.p.shape[1] == structure.mesh.nvertices else "curved"
    return f"{shape}, {order}"


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def area_of(structure: Structure, facets: NDArray[np.int64]) -> float:
    """Area of some facets as planes, like those of a joint, m2."""
    if not facets.size:
        return 0.0
    return float(np.linalg.norm(outward_areas(structure.mesh, facets), axis=1).sum())


def _curved_areas(mesh: Mesh, facets: NDArray[np.int64]) -> tuple[Array, Array]:
    """Areas (n,) and outward area vectors (n, 3) of boundary facets, curvature included, m2."""
    plane = outward_areas(mesh, facets)
    if mesh.p.shape[1] == mesh.nvertices:
        return np.linalg.norm(plane, axis=1), plane
    maps = mesh.mapping()
    points, weights = get_quadrature(maps.bndelem.refdom, 6)
    along, across = (
        np.array([maps.bndJ(i, j, points, facets) for i in range(3)]) for j in range(2)
    )
    vectors = np.cross(along, across, axis=0)
    whole = np.einsum("ifq,q->fi", vectors, weights)
    outward = np.sign(np.einsum("fi,fi->f", whole, plane))
    return np.linalg.norm(vectors, axis=0) @ weights, whole * outward[:, None]


def _bodies(structure: Structure) -> dict[str, BodyFacts]:
    mesh, volumes = structure.mesh, cell_volumes(structure.mesh)
    rows = {}
    for name, cells in structure.bodies.items():
        corners = mesh.t[:, cells]
        points = mesh.p[:, np.unique(corners)]
        extent = _triple(np.ptp(points, axis=1))
        rows[name] = BodyFacts(
            len(cells), float(volumes[cells].sum()), extent, 1 + int(pieces(corners).max())
        )
    return rows


def pieces(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number, starting from 0, of the connected piece of each cell.

    Parameters
    ----------
    corners : ndarray of int, shape (k, n)
        Nodes of each cell; cells that share a node are one piece.
    """
    cells, nodes = corners.shape[1], int(corners.max()) + 1
    edges = (np.tile(np.arange(cells), len(corners)), cells + corners.ravel())
    graph = coo_array((np.ones(corners.size), edges), shape=(cells + nodes,) * 2)
    # Cells come first in the graph, so the first labels are theirs.
    return connected_components(graph.tocsr(), directed=False)[1][:cells]


def _surface(structure: Structure, name: str) -> SurfaceFacts:
    facets = structure.surfaces[name]
    areas, vectors = _curved_areas(structure.mesh, facets)
    area = float(areas.sum())
    owners = structure.mesh.f2t[0, facets]
    bodies = tuple(n for n, cells in structure.bodies.items() if np.isin(owners, cells).any())
    return SurfaceFacts(len(facets), area, _triple(vectors.sum(axis=0) / area), bodies)


def _joint(structure: Structure, name: str) -> JointFacts:
    mesh = structure.mesh
    side_a, side_b = (structure.surfaces[side] for side in structure.joints[name])
    joint = pair_joint(structure, name)
    gap = joint.separation
    # Facets are identified by the nearest quadrature points, one normal for each.
    normals = {}
    for side, facets, points in (("a", side_a, joint.points_a), ("b", side_b, joint.points_b)):
        vectors = outward_areas(mesh, facets)
        centres = facet_corners(mesh, facets).mean(axis=1)
        at = cKDTree(centres).query(points.T)[1]
        normals[side] = vectors[at] / np.linalg.norm(vectors[at], axis=1, keepdims=True)
    facing = -np.einsum("qi,qi->q", normals["a"], normals["b"])
    return JointFacts(
        area_a=area_of(structure, side_a),
        area_b=area_of(structure, side_b),
        overlap=float(joint.area.sum()),
        gap=(float(gap.min()), float(gap.max())),
        misalignment=float(np.rad2deg(np.arccos(np.clip(facing.min(), -1.0, 1.0)))),
        parts=len(np.unique(np.round(joint.normal, 6), axis=0)),
        matching=_match(mesh, side_a, side_b),
    )


def _match(mesh: Mesh, side_a: NDArray[np.int64], side_b: NDArray[np.int64]) -> bool:
    """Whether the facets of two sides have the same corners."""
    corners_a, corners_b = mesh.facets[:, side_a], mesh.facets[:, side_b]
    nodes = np.unique(corners_a)
    away, at = cKDTree(mesh.p[:, nodes].T).query(mesh.p[:, corners_b.ravel()].T)
    if away.max() > SAME * np.ptp(mesh.p, axis=1).max():
        return False
    as_a = nodes[at].reshape(corners_b.shape)
    first, second = (np.unique(np.sort(c, axis=0), axis=1) for c in (corners_a, as_a))
    return np.array_equal(first, second)


def _size_warning(extent: tuple[float, float, float]) -> list[str]:
    largest = max(extent)
    if USUAL_SIZE[0] <= largest <= USUAL_SIZE[1]:
        return []
    return [f"the structure is {largest:g} m long: check the unit of the mesh"]


def _quality_warning(structure: Structure, quality: Array) -> list[str]:
    poor = np.flatnonzero(quality < POOR)
    if not poor.size:
        return []
    worst = poor[np.argmin(quality[poor])]
    x, y, z = structure.mesh.p[:, structure.mesh.t[:, worst]].mean(axis=1)
    return [
        f"{poor.size} cells have a quality below {POOR:g}; the worst, {quality[worst]:.3f}, is at "
        f"({x:.4g}, {y:.4g}, {z:.4g}) m: mesh finer there"
    ]


def _piece_warnings(bodies: dict[str, BodyFacts]) -> list[str]:
    return [
        f"body {name!r} is in {body.pieces} pieces: each needs its own support or joint"
        for name, body in bodies.items()
        if body.pieces > 1
    ]


def _glue_warnings(structure: Structure) -> list[str]:
    nodes = {name: np.unique(structure.mesh.t[:, c]) for name, c in structure.bodies.items()}
    return [
        f"bodies {body!r} and {other!r} share {shared} nodes: they are one piece there, no joint"
        for body, other in combinations(nodes, 2)
        if (shared := np.intersect1d(nodes[body], nodes[other]).size)
    ]


def overlap_warnings(structure: Structure) -> list[str]:
    """Return a warning for every two bodies that overlap.

    They do if one contains the middle of a cell on the skin of the other.
    """
    mesh, bodies = structure.mesh, structure.bodies
    corners = {name: mesh.p[:, mesh.t[:, cells]] for name, cells in bodies.items()}
    boxes = {name: (at.min(axis=(1, 2)), at.max(axis=(1, 2))) for name, at in corners.items()}
    skin_of = cache(lambda name: _skin(mesh, bodies[name]))
    warnings = []
    for one, other in combinations(bodies, 2):
        low = np.maximum(boxes[one][0], boxes[other][0])
        high = np.minimum(boxes[one][1], boxes[other][1])
        if not (low < high).all():
            continue
        for (middles, _), (_, triangles) in (
            (skin_of(one), skin_of(other)),
            (skin_of(other), skin_of(one)),
        ):
            near = middles[((middles > low) & (middles < high)).all(axis=1)]
            near = near[:: -(-len(near) // MOST_POINTS) or 1]
            inside = [point for point in near if _is_inside(point, triangles)]
            if inside:
                place = ", ".join(f"{x:.4g}" for x in np.mean(inside, axis=0))
                warnings.append(
                    f"bodies {one!r} and {other!r} overlap around ({place}) m: what is there "
                    "counts twice; cut one of them"
                )
                break
    return warnings


def _skin(mesh: Mesh, cells: NDArray[np.int64]) -> tuple[Array, Array]:
    """Middles (n, 3) of the cells on the skin of a body, and triangles (m, 3, 3) of it, m.

    Seen from outside, the corners of all triangles have the same sense.
    """
    facets, count = np.unique(mesh.t2f[:, cells], return_counts=True)
    facets = facets[count == 1]
    owner = np.where(np.isin(mesh.f2t[0, facets], cells), *mesh.f2t[:, facets])
    middles = mesh.p[:, mesh.t[:, owner]].mean(axis=1).T
    corners = facet_corners(mesh, facets)
    fans = [corners[:, [0, k, k + 1]] for k in range(1, corners.shape[1] - 1)]
    areas = [np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0]) for fan in fans]
    inward = np.einsum("fi,fi->f", sum(areas), corners.mean(axis=1) - middles) < 0.0
    for fan in fans:
        fan[inward] = fan[inward, ::-1]
    return np.unique(middles, axis=0), np.concatenate(fans)


def _is_inside(point: Array, triangles: Array) -> bool:
    """Whether a closed surface of triangles encloses a point, from its solid angle.

    That of a triangle: Van Oosterom & Strackee 1983.
    """
    a, b, c = (triangles - point).transpose(1, 0, 2)
    (la, lb, lc), dot = (np.linalg.norm(each, axis=1) for each in (a, b, c)), "ti,ti->t"
    volume = np.einsum(dot, a, np.cross(b, c))
    against = la * lb * lc + np.einsum(dot, a, b) * lc
    against += np.einsum(dot, b, c) * la + np.einsum(dot, c, a) * lb
    return abs(2.0 * np.arctan2(volume, against).sum()) > 2.0 * np.pi


def _joint_warnings(joints: dict[str, JointFacts]) -> list[str]:
    warnings = []
    for name, joint in joints.items():
        smaller = min(joint.area_a, joint.area_b)
        if joint.overlap < 0.9 * smaller:
            warnings.append(
                f"joint {name!r}: its sides share {1e4 * joint.overlap:.4g} of "
                f"{1e4 * smaller:.4g} cm2"
            )
        if max(abs(end) for end in joint.gap) > 0.01 * np.sqrt(smaller):
            warnings.append(
                f"joint {name!r}: its sides are {1e3 * joint.gap[0]:.3g} to "
                f"{1e3 * joint.gap[1]:.3g} mm apart; it is taken as closed at its preload"
            )
        if joint.misalignment > 10.0:
            warnings.append(
                f"joint {name!r}: facing facets differ by {joint.misalignment:.0f} degrees"
            )
    return warnings


def _bare_warnings(structure: Structure, joints: dict[str, JointFacts]) -> list[str]:
    """Warn of joint sides that extend beyond their joint, without any surface for convection."""
    sides = {side for pair in structure.joints.values() for side in pair}
    others = [facets for name, facets in structure.surfaces.items() if name not in sides]
    convecting = np.concatenate([np.empty(0, int), *others])
    warnings = []
    for name, joint in joints.items():
        for letter, side, area in zip(
            "ab", structure.joints[name], (joint.area_a, joint.area_b), strict=True
        ):
            alone = area_of(structure, np.setdiff1d(structure.surfaces[side], convecting))
            bare = min(alone, area - joint.overlap)
            if bare > 0.1 * area:
                warnings.append(
                    f"joint {name!r}: side {letter} is {1e4 * bare:.4g} cm2 larger than what it "
                    "shares, and nothing convects there: list it in convection_W_m2K, where what "
                    "a joint covers does not count"
                )
    return warnings


def _partner_warnings(structure: Structure) -> list[str]:
    partner = {"a": "b", "b": "a"}
    return [
        f"surface {name!r} looks like a joint side, but there is no {other!r}"
        for name in structure.surfaces
        if name[-2:] in (".a", ".b")
        for other in [f"{name[:-1]}{partner[name[-1]]}"]
        if other not in structure.surfaces
    ]


def seam_warnings(structure: Structure, sides: Sequence[NDArray[np.int64]]) -> list[str]:
    """Return a warning for every body that has several nodes at one place, but for joints.

    Parameters
    ----------
    structure, sides
        As for `facing_warnings`.
    """
    mesh = structure.mesh
    joined = mesh.facets[:, np.concatenate([np.empty(0, int), *sides])]
    skin = np.setdiff1d(mesh.facets[:, mesh.boundary_facets()], joined)
    near = SAME * float(np.ptp(mesh.p, axis=1).max())
    warnings = []
    for name, cells in structure.bodies.items():
        own = np.intersect1d(skin, mesh.t[:, cells])
        pairs = cKDTree(mesh.p[:, own].T).query_pairs(near, output_type="ndarray")
        if pairs.size:
            x, y, z = mesh.p[:, own[pairs[0, 0]]]
            warnings.append(
                f"body {name!r} has {len(pairs)} pairs of nodes at one place, the first at "
                f"({x:.4g}, {y:.4g}, {z:.4g}) m: nothing passes between them; merge them"
            )
    return warnings


def hinge_warnings(structure: Structure) -> list[str]:
    """Return a warning for every body with parts that share nodes but no face."""
    mesh = structure.mesh
    inner = mesh.f2t[:, mesh.f2t[1] >= 0]
    graph = coo_array((np.ones(inner.shape[1]), inner), shape=(mesh.nelements,) * 2)
    part = connected_components(graph.tocsr(), directed=False)[1]
    warnings = []
    for name, cells in structure.bodies.items():
        if (part[cells] == part[cells[0]]).all():
            continue
        corners = mesh.t[:, cells]
        nodes = np.unique([corners.ravel(), np.tile(part[cells], len(corners))], axis=1)[0]
        shared = nodes[1:][np.diff(nodes) == 0]
        if shared.size:
            x, y, z = mesh.p[:, shared[0]]
            warnings.append(
                f"parts of body {name!r} meet in an edge or corner only, at ({x:.4g}, {y:.4g}, "
                f"{z:.4g}) m: they turn about it, and the heat through it depends on the mesh; let "
                "them share a face, or give them names of their own and a joint"
            )
    return warnings


def facing_warnings(structure: Structure, sides: Sequence[NDArray[np.int64]]) -> list[str]:
    """Return a warning for every two bodies that touch without a joint.

    Parameters
    ----------
    structure : Structure
        The structure.
    sides : sequence of ndarray of int
        Facets of the sides of its joints.
    """
    names, owner = list(structure.bodies), np.empty(structure.mesh.nelements, dtype=int)
    for k, cells in enumerate(structure.bodies.values()):
        owner[cells] = k
    return [
        f"bodies {names[a]!r} and {names[b]!r} face each other on about "
        f"{1e4 * area_of(structure, facets):.3g} cm2 without a joint: no heat passes there"
        for (a, b), facets in facing_facets(structure.mesh, owner, sides).items()
    ]


def facing_facets(
    mesh: Mesh, part: NDArray[np.int64], sides: Sequence[NDArray[np.int64]]
) -> dict[tuple[int, int], NDArray[np.int64]]:
    """Return the facets of the first of every two parts that touch without a joint.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    part : ndarray of int, shape (cells,)
        Number of the part of each cell; -1 is of none.
    sides : sequence of ndarray of int
        Facets of the sides of joints.
    """
    free = np.setdiff1d(mesh.boundary_facets(), np.concatenate([np.empty(0, int), *sides]))
    free = free[part[mesh.f2t[0, free]] >= 0]
    near = TOUCHING * float(np.ptp(mesh.p, axis=1).max())
    owner, corners = part[mesh.f2t[0, free]], facet_corners(mesh, free)
    # Most facets are excluded by the bounding boxes of the other parts.
    close = np.zeros(len(free), dtype=bool)
    for k in range(part.max() + 1):
        points = mesh.p[:, np.unique(mesh.t[:, part == k])]
        low, high = points.min(axis=1) - near, points.max(axis=1) + near
        inside = (corners.min(axis=1) <= high).all(axis=1) & (corners.max(axis=1) >= low).all(
            axis=1
        )
        close |= inside & (owner != k)
    free, owner, corners = free[close], owner[close], corners[close]
    if not free.size:
        return {}
    vectors = outward_areas(mesh, free)
    area = np.linalg.norm(vectors, axis=1)
    normals, centres = vectors / area[:, None], corners.mean(axis=1)
    # Meshes need not match: the centre of a touching facet is within about one facet size.
    pairs = cKDTree(centres).query_pairs(float(np.sqrt(area.max())), output_type="ndarray")
    if not pairs.size:
        return {}
    facet, other = pairs.T
    between = centres[other] - centres[facet]
    apart = np.abs(np.einsum("pi,pi->p", between, normals[facet]))
    beside = np.sqrt(np.maximum(np.einsum("pi,pi->p", between, between) - apart**2, 0.0))
    touching = (
        (owner[facet] != owner[other])
        & (np.einsum("pi,pi->p", normals[facet], normals[other]) < -0.98)
        & (apart < near)
        & (beside < 0.5 * np.sqrt(np.maximum(area[facet], area[other])))
    )
    facing: dict[tuple[int, int], set[int]] = {}
    for i, j in pairs[touching]:
        first, second = (i, j) if owner[i] < owner[j] else (j, i)
        facing.setdefault((int(owner[first]), int(owner[second])), set()).add(int(first))
    return {both: free[sorted(facets)] for both, facets in facing.items()}
