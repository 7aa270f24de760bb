"""Unconstrained rigid motions, found from geometry before any factorisation.

A structure consists of pieces that share no node. Piece i moves rigidly by u(x) = t + w x (x - O):
six numbers (t, w L) with one origin O and length L for all. Supports, springs and contact elements
constrain some of these motions; the free motions are the null space of their rows. A joint always
constrains motion along its normal and, where friction sticks, along its tangents.

With such a motion the stiffness of a structure is singular. The reference springs of
`fesim.solid.condensation` hide this, and rounding would determine the size of the motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skfem import Mesh

from fesim.solid.bolts import Bolt
from fesim.solid.elasticity import DIRECTIONS, held_directions
from meshes.inspection import pieces
from meshes.pairing import EDGE, PairedJoint, outward_areas
from meshes.structure import Structure
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError

#: A rigid motion of unit size that moves its constraints by less than this is free: normals that
#: differ by a smaller angle (rad) are parallel up to the rounding of a mesh file.
HELD = 1e-5
#: In a message, a motion within this angle of coordinate axes, rad, is described by these, and
#: bodies that move by less than this fraction are left out.
NAMED = 0.05


@dataclass(frozen=True)
class Frame:
    """Origin O (3,), m, and length L, m, of the coordinates of rigid motions."""

    origin: Array
    length: float

    def rows(self, points: Array, directions: Array) -> Array:
        """Displacement of points (k, 3) along directions (k, 3) by unit motions, shape (k, 6)."""
        arms = (points - self.origin) / self.length
        return np.hstack([directions, np.cross(arms, directions)])


@dataclass(frozen=True, eq=False)
class Constraints:
    """Possible constraints of the pieces of a structure."""

    #: Coordinates of the motions of all p pieces.
    frame: Frame
    #: Names of the pieces in messages.
    pieces: tuple[str, ...]
    #: Shape (k, 6 p): orthonormal rows for each surface of fixed points, symmetry or springs, and
    #: for each bolt.
    supports: Array
    #: Shape (m, p): fraction of each piece in side b of each contact element, minus its fraction in
    #: side a.
    share: Array
    #: Shape (m, 3): centre of each contact element, m.
    centre: Array
    #: Shape (3, m, 3): its normal and its two tangents.
    directions: Array
    #: Shape (m,): apparent constraint by the facets of its joint that the curved face does not
    #: provide.
    slack: Array

    def unheld(self, element: NDArray[np.int64], direction: Array) -> Array:
        """Free motions if contact elements constrain given directions, shape (6 p, motions).

        Parameters
        ----------
        element : ndarray of int, shape (k,)
            Constraining contact elements; repetitions are allowed.
        direction : ndarray, shape (k, 3)
            Unit vectors of the constraints.
        """
        sides, group = np.unique(np.round(self.share, 9), axis=0, return_inverse=True)
        group = group.ravel()[element]
        joints = [
            _Between(
                sides[k],
                _span(self.frame, self.centre[element[own]], direction[own], slack),
                slack,
            )
            for k in np.unique(group)
            for own in [group == k]
            for slack in [max(HELD, float(self.slack[element[own]].max()))]
        ]
        _, sizes, motions = np.linalg.svd(
            np.vstack([self.supports, *(np.kron(joint.sides, joint.rows) for joint in joints)])
        )
        sizes = np.append(sizes, np.zeros(len(motions) - len(sizes)))
        slack = max([HELD, *(joint.slack for joint in joints)])
        free = [
            size <= HELD or (size <= slack and self._slips(motion, joints))
            for size, motion in zip(sizes, motions, strict=True)
        ]
        return np.asarray(motions[free].T)

    def _slips(self, motion: Array, joints: Sequence[_Between]) -> bool:
        """Whether only the apparent stiffness of facets resists a motion."""
        parts = motion.reshape(-1, 6)
        across = [(joint.sides @ parts, joint) for joint in joints]
        moved = [(shift, joint) for shift, joint in across if np.linalg.norm(shift) > HELD]
        slack = max([HELD, *(joint.slack for _, joint in moved)])
        size = float(np.linalg.norm(motion))
        return float(np.linalg.norm(self.supports @ motion)) <= slack * size and all(
            np.linalg.norm(joint.rows @ shift) <= slack * np.linalg.norm(shift)
            for shift, joint in moved
        )


@dataclass(frozen=True)
class _Between:
    """Constraints by contact elements between the same pieces: rows on the motion of `sides`."""

    sides: Array
    rows: Array
    slack: float


def constraints_of(
    structure: Structure,
    joints: Sequence[PairedJoint],
    fixed: Sequence[str],
    symmetry: Mapping[str, str],
    springs: Mapping[str, tuple[float, float, float]],
    bolts: Sequence[Bolt] = (),
) -> Constraints:
    """Return the possible constraints of the pieces of a structure.

    Parameters
    ----------
    structure : Structure
        Mesh and names.
    joints : sequence of PairedJoint
        Joints in the order of the contact elements.
    fixed, symmetry, springs
        As for `fesim.solid.elasticity.elastic_operators`; zero stiffness does not constrain.
    bolts : sequence of Bolt
        Each prevents its ends from moving apart.
    """
    mesh = structure.mesh
    piece = pieces(mesh.t)
    names = _names(structure, piece)
    low, high = mesh.p.min(axis=1), mesh.p.max(axis=1)
    frame = Frame(0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))
    held = [
        *held_directions(fixed, symmetry),
        *(
            (name, tuple(i for i in range(3) if stiffness[i] > 0.0))
            for name, stiffness in springs.items()
        ),
    ]
    supports = [np.empty((0, 6 * len(names)))]
    for name, axes in held:
        facets = structure.surface(name, "supports")
        owner = piece[mesh.f2t[0, facets]]
        for own in np.unique(owner):
            nodes = np.unique(mesh.facets[:, facets[owner == own]])
            points = np.tile(mesh.p[:, nodes].T, (len(axes), 1))
            rows = _span(frame, points, np.repeat(np.eye(3)[list(axes)], len(nodes), axis=0), HELD)
            supports.append(np.kron(np.eye(len(names))[own], rows))
    supports.extend(_tie(frame, bolt, piece, len(names)) for bolt in bolts)
    return Constraints(
        frame=frame,
        pieces=names,
        supports=np.vstack(supports),
        share=np.vstack(
            [np.empty((0, len(names))), *(_share(joint, piece, len(names)) for joint in joints)]
        ),
        centre=np.vstack([np.empty((0, 3)), *(joint.centre for joint in joints)]),
        directions=np.concatenate(
            [
                np.empty((3, 0, 3)),
                *(np.stack([j.normal, *np.moveaxis(j.tangents, 1, 0)]) for j in joints),
            ],
            axis=1,
        ),
        slack=np.concatenate(
            [np.empty(0), *(np.full(len(j.area), _facet_slack(mesh, j)) for j in joints)]
        ),
    )


def check_held(
    constraints: Constraints, sticks: NDArray[np.bool_], closed: NDArray[np.bool_] | None = None
) -> None:
    """Refuse a structure with an unconstrained rigid motion at rest.

    Parameters
    ----------
    constraints : Constraints
        Possible constraints.
    sticks : ndarray of bool, shape (m,)
        Contact elements with friction.
    closed : ndarray of bool, shape (m,), optional
        Contact elements that may hold a body at rest; default all.

    Raises
    ------
    InputError
        A body is not constrained; the message contains it and its motions.
    """
    count = len(constraints.pieces)
    closed = np.ones(len(sticks), dtype=bool) if closed is None else closed
    joined = constraints.share[closed].any(axis=0)
    touched = constraints.supports.reshape(-1, count, 6).any(axis=(0, 2)) | joined
    open_ones = "" if closed.all() else "; a joint that starts open holds nothing without loads"
    if not touched.all():
        alone = constraints.pieces[int(np.argmin(touched))]
        raise InputError(
            f"supports: {alone} has no support, spring or joint; hold it in [supports] or join it "
            f"to another body{open_ones}"
        )
    motions = _free_at_rest(constraints, closed.tobytes(), (sticks & closed).tobytes())
    if motions.shape[1]:
        # A contact element acts at its centre only: a single one is a hinge.
        instead = "more contact elements" if sticks.all() else "a friction_coefficient above 0"
        raise InputError(
            f"supports: no support, spring or joint keeps {described(constraints, motions)}; "
            f"hold it in [supports], or give its joints {instead}{open_ones}"
        )


# The cases of a study differ in their laws, hardly ever in their constraints.
@lru_cache(maxsize=4)
def _free_at_rest(constraints: Constraints, closed: bytes, sticking: bytes) -> Array:
    """Free motions, (6 p, motions); flags of the contact elements (m,) as bytes."""
    every, stuck = (np.flatnonzero(np.frombuffer(one, dtype=bool)) for one in (closed, sticking))
    normal, first, second = constraints.directions
    return constraints.unheld(
        np.concatenate([every, stuck, stuck]),
        np.vstack([normal[every], first[stuck], second[stuck]]),
    )


def described(constraints: Constraints, motions: Array) -> str:
    """Describe free motions of bodies, e.g. "body 'bolt' from moving along x and y".

    Parameters
    ----------
    constraints : Constraints
        Names of the pieces.
    motions : ndarray, shape (6 p, k)
        Orthonormal motions, k at least 1; bodies that move on their own are listed first.
    """
    count = len(constraints.pieces)
    # The projector on the motions does not depend on their basis: its blocks link moving pieces.
    linked = np.linalg.norm((motions @ motions.T).reshape(count, 6, count, 6), axis=(1, 3)) > NAMED
    _, group = connected_components(linked, directed=False)
    moving = [int(i) for i in np.flatnonzero(linked.diagonal())]
    alone = [i for i in moving if _only(motions, [i]).shape[1]]
    members = [alone[0]] if alone else [i for i in moving if group[i] == group[moving[0]]]
    names = [constraints.pieces[i] for i in members]
    who = _list(names) + (" together" if len(names) > 1 else "")
    own = _only(motions, members)[6 * members[0] : 6 * members[0] + 6]
    shift = own[:3] @ _null(own[3:])
    ways = []
    if shifts := _axes(shift):
        ways.append(f"moving along {_list(shifts)}")
    if turns := _axes(own[3:]):
        ways.append(f"turning about {_list(turns)}")
    return f"{who} from {' and from '.join(ways)}"


def _span(frame: Frame, points: Array, directions: Array, slack: float) -> Array:
    """Orthonormal rows (r, 6) of the constraints at points along directions (k, 3).

    The tolerance for zero is relative to the extent of the points: a small seat prevents a large
    body from tilting.
    """
    if not len(points):
        return np.empty((0, 6))
    centre = points.mean(axis=0)
    reach = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
    # Points that coincide up to rounding do not prevent rotation about themselves.
    own = Frame(centre, reach if reach > 1e-9 * frame.length else frame.length)
    _, sizes, local = np.linalg.svd(
        own.rows(points, directions) / np.sqrt(len(points)), full_matrices=False
    )
    kept = local[sizes > slack]
    # Row (d, r) acts on d . v + r . w, with v at the centre: there it is d . (t + w x (c - O)).
    there = frame.rows(np.tile(centre, (len(kept), 1)), kept[:, :3])
    there[:, 3:] += own.length / frame.length * kept[:, 3:]
    return np.asarray(np.linalg.svd(there, full_matrices=False)[2])


def _tie(frame: Frame, bolt: Bolt, piece: NDArray[np.int64], count: int) -> Array:
    """Unit row (1, 6 p) of the distance between a bolt's ends; none if both are on one piece."""
    row = np.zeros((count, 6))
    for end, sign in ((bolt.head, 1.0), (bolt.thread, -1.0)):
        moved = frame.rows(end.points.T, np.tile(bolt.axis, (len(end.weights), 1)))
        np.add.at(row, piece[end.cells], sign * end.weights[:, None] * moved)
    size = float(np.linalg.norm(row))
    return row.reshape(1, -1) / size if size > HELD else np.empty((0, 6 * count))


def _facet_slack(mesh: Mesh, joint: PairedJoint) -> float:
    """phi^2 / 8 for facets with an angle of phi at most between neighbours, edges left out.

    This is the relative deviation of a facet from the smooth face, in height and in direction.
    """
    facets = np.unique(joint.facets_a)
    normal = outward_areas(mesh, facets)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    corners = mesh.facets[:, facets]
    facet = np.tile(np.arange(len(facets)), len(corners))
    touches = coo_array((np.ones(facet.size), (facet, corners.ravel()))).tocsr()
    pairs = (touches @ touches.T).tocoo()
    next_to = pairs.data > 1.5
    apart = normal[pairs.row[next_to]] - normal[pairs.col[next_to]]
    turn = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(apart, axis=1), 1.0))
    return float(turn[turn < EDGE].max(initial=0.0)) ** 2 / 8.0


def _names(structure: Structure, piece: NDArray[np.int64]) -> tuple[str, ...]:
    names = []
    for number in range(int(piece.max()) + 1):
        own = np.flatnonzero(piece == number)
        bodies = [name for name, cells in structure.bodies.items() if np.isin(cells, own).any()]
        name = f"bod{'y' if len(bodies) == 1 else 'ies'} {_list([repr(b) for b in bodies])}"
        if not all(np.isin(structure.bodies[body], own).all() for body in bodies):
            x, y, z = structure.mesh.p[:, structure.mesh.t[:, own]].mean(axis=(1, 2))
            name = f"the piece of {name} around ({x:.4g}, {y:.4g}, {z:.4g}) m"
        names.append(name)
    return tuple(names)


def _share(joint: PairedJoint, piece: NDArray[np.int64], count: int) -> Array:
    share = np.zeros((len(joint.area), count))
    for cells, sign in ((joint.cells_b, 1.0), (joint.cells_a, -1.0)):
        part = joint.weights / joint.area[joint.element]
        np.add.at(share, (joint.element, piece[cells]), sign * part)
    return share


def _only(motions: Array, members: Sequence[int]) -> Array:
    """Motions (6 p, r) in which only some pieces move."""
    others = np.ones(len(motions), dtype=bool)
    for i in members:
        others[6 * i : 6 * i + 6] = False
    return motions @ _null(motions[others])


def _null(rows: Array) -> Array:
    """Orthonormal null space (n, r) of `rows` (k, n), accurate enough for a message."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, sizes, vectors = np.linalg.svd(rows)
    return np.asarray(vectors[np.count_nonzero(sizes > NAMED) :].T)


def _axes(vectors: Array) -> list[str]:
    """Names of the directions that vectors (3, k) span: coordinate axes, then components."""
    if not vectors.size:
        return []
    left, sizes, _ = np.linalg.svd(vectors)
    basis = left[:, : np.count_nonzero(sizes > NAMED)]
    spanned = [i for i in range(3) if np.linalg.norm(basis[i]) > np.cos(NAMED)]
    names = [DIRECTIONS[i] for i in spanned]
    rest = basis @ np.linalg.svd(basis[spanned])[2][len(spanned) :].T if spanned else basis
    for vector in rest.T:
        whole = vector * np.sign(vector[np.argmax(np.abs(vector))])
        names.append("({})".format(", ".join(f"{x + 0.0:.2g}" for x in np.round(whole, 3))))
    return names


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
