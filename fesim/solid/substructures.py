"""Pieces of a structure, factorised one by one and then coupled by springs (docs/march.md).

Without the springs across its joints the stiffness is block diagonal by connected pieces. A piece
constrained less by its supports than by its joints is anchored: springs constrain three of its
nodes. With Kd, the stiffness with anchors and without joints, ties E = [G; N] (gaps and anchored
unknowns) and their springs D = diag(A k, -kappa), the stiffness with springs across the joints is
Kr = Kd + E^T D E. All products with Kr^-1 in time stepping follow from E Kd^-1 [E^T, F] by one
dense system of the size of the joints (Woodbury).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, vstack

from fesim.solid.elasticity import ElasticPiece, in_rows
from fesim.solid.linear_solver import (
    RESIDUAL_LIMIT,
    Factor,
    checked_solve,
    factorise_upper,
    singular,
    symmetric_product,
    upper_triangle,
)
from thermojoint.artefacts.arrays import Array

#: Numbers in the right-hand sides of one solve: 0.14 GB.
AT_ONCE = 18_000_000
#: A piece is anchored if, against some rigid motion, its supports provide less than this fraction
#: of the stiffness of supports and anchors together.
HELD = 1e-3


@dataclass(frozen=True)
class Substructure:
    """One piece with its supports and anchors, factorised."""

    #: Shape (f,): its free unknowns in the numbering of the whole.
    unknowns: NDArray[np.int64]
    #: Factor of Kd on these.
    factor: Factor
    #: Shape (f, n_heat): F.
    thermal_load: csr_array
    #: Shape (a,): unknowns with an anchor spring, in the numbering of the whole.
    anchored: NDArray[np.int64]
    #: Stiffness of each of these springs, N/m.
    anchor: float


@dataclass(frozen=True)
class TieCondensation:
    """Ties and probes as linear functions of forces and temperatures, for Kr.

    The first 3 m of the q ties are the gaps; the others are anchored unknowns.
    """

    #: Shape (q,): D, N/m.
    springs: Array
    #: Shape (q, q): E Kr^-1 E^T, m/N.
    compliance: Array
    #: Shape (q, n_heat): E Kr^-1 F, m/K.
    thermal: Array
    #: Shape (k, q): for probes P: P Kr^-1 E^T, m/N.
    probe_compliance: Array
    #: Shape (k, n_heat): P Kr^-1 F, m/K.
    probe_thermal: Array


#: Kd of a piece, anchored if needed, its free unknowns, and a function of the factor.
_Constrained = tuple[csr_array, NDArray[np.int64], Callable[[Factor], Substructure]]


def _constrained(piece: ElasticPiece, gap: csr_array, springs: Array) -> _Constrained:
    free = np.flatnonzero(piece.free)
    stiffness = piece.stiffness
    if free.size < piece.free.size:
        stiffness = upper_triangle(stiffness[free][:, free])
    touched = np.diff(csr_array(gap[:, piece.unknowns[free]]).indptr) > 0
    anchor = float(springs[touched].sum()) / 9.0
    nodes = _far_apart(piece.points)
    corners = (3 * nodes[:, None] + np.arange(3)).ravel()
    anchored = np.flatnonzero(np.isin(free, corners[piece.free[corners]]))
    if anchor > 0.0 and _needs_anchors(piece, free, stiffness, anchored, anchor):
        held = np.zeros(free.size)
        held[anchored] = anchor
        stiffness = csr_array(stiffness + diags_array(held))
    else:
        anchored = np.empty(0, dtype=np.int64)
    unknowns = piece.unknowns[free]
    load = csr_array(piece.thermal_load[free])

    def with_factor(factor: Factor) -> Substructure:
        return Substructure(unknowns, factor, load, unknowns[anchored], anchor)

    return stiffness, free, with_factor


def _factorised(constrained: _Constrained, solver: str | None) -> Substructure:
    stiffness, places, with_factor = constrained
    return with_factor(factorise_upper(stiffness, "stiffness", solver, places))


def _far_apart(points: Array) -> NDArray[np.int64]:
    """Three nodes that span a large triangle (a cheap search)."""
    first = int(np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1)))
    second = int(np.argmax(((points - points[first]) ** 2).sum(axis=1)))
    along = points[second] - points[first]
    third = int(np.argmax((np.cross(points - points[first], along) ** 2).sum(axis=1)))
    return np.array([first, second, third])


def _needs_anchors(
    piece: ElasticPiece,
    free: NDArray[np.int64],
    stiffness: csr_array,
    anchored: NDArray[np.int64],
    anchor: float,
) -> bool:
    """Whether supports constrain some rigid motion of the piece less than anchors would."""
    centre = piece.points.mean(axis=0)
    arms = (piece.points - centre) / np.abs(piece.points - centre).max()
    shifts = np.tile(np.eye(3), (len(arms), 1))
    turns = np.cross(np.eye(3)[None, :, :], arms[:, None, :]).transpose(0, 2, 1).reshape(-1, 3)
    motions = np.hstack([shifts, turns])[free]
    supported = motions.T @ symmetric_product(stiffness, motions)
    both = supported + anchor * motions[anchored].T @ motions[anchored]
    try:
        least = scipy.linalg.eigh(supported, both, eigvals_only=True)[0]
    except np.linalg.LinAlgError:
        return True  # Neither constrains a motion, which the factorisation will report.
    return bool(least < HELD)


def substructures(
    pieces: Iterable[ElasticPiece], gap: csr_array, springs: Array, solver: str | None = None
) -> Iterator[Substructure]:
    """Factorise the pieces one by one; fully fixed ones are left out.

    Each gets anchors if its supports constrain it less than its joints.

    Parameters
    ----------
    pieces : iterable of ElasticPiece
        Consumed one by one, and not stored.
    gap : scipy.sparse.csr_array, shape (3 m, n)
        G, on the unknowns of the whole.
    springs : ndarray, shape (3 m,)
        Stiffnesses of the reference springs across the joints, A k, N/m.
    solver : str, optional
        See `fesim.solid.linear_solver.factorise`.

    Raises
    ------
    InputError
        Neither supports nor joints constrain a piece.
    """
    # No loop: its variable would keep a piece alive while the next one is made. Nor is a piece kept
    # while it is factorised, which takes the most memory.
    free = filter(lambda piece: piece.free.any(), pieces)
    constrained = map(partial(_constrained, gap=gap, springs=springs), free)
    return map(partial(_factorised, solver=solver), constrained)


@dataclass(frozen=True)
class FactorisedStructure:
    """All pieces of a structure, factorised."""

    substructures: tuple[Substructure, ...]
    #: Shape (n, n_heat): F, also for unknowns held by supports.
    thermal_load: csr_array
    #: Shape (n, n): rows of K for unknowns held by supports; the others are empty.
    held_stiffness: csr_array


def factorised_structure(
    pieces: Iterable[ElasticPiece],
    gap: csr_array,
    springs: Array,
    shape: tuple[int, int],
    solver: str | None = None,
) -> FactorisedStructure:
    """Factorise all pieces and keep them; `shape` is that of F, the rest as for `substructures`."""
    load, held_stiffness = csr_array(shape), csr_array((shape[0], shape[0]))
    pieces_kept: list[Substructure] = []
    for piece in pieces:
        load = load + in_rows(piece.thermal_load, piece.unknowns, shape[0])
        held = np.flatnonzero(~piece.free)
        if held.size:
            upper = piece.stiffness
            rows = upper[held] + upper.T[held]
            at = (rows - diags_array(upper.diagonal(), format="csr")[held]).tocoo()
            index = (piece.unknowns[held][at.row], piece.unknowns[at.col])
            held_stiffness = held_stiffness + csr_array((at.data, index), held_stiffness.shape)
        pieces_kept.extend(substructures([piece], gap, springs, solver))
    return FactorisedStructure(tuple(pieces_kept), csr_array(load), csr_array(held_stiffness))


def tie_rows(gap: csr_array, pieces: Iterable[Substructure]) -> csr_array:
    """Return E (q, n): gaps, then the anchored unknowns of one piece after the other."""
    columns = np.concatenate([np.empty(0, dtype=np.int64), *(piece.anchored for piece in pieces)])
    ends = np.arange(columns.size + 1)
    anchors = csr_array((np.ones(columns.size), columns, ends), (columns.size, gap.shape[1]))
    return csr_array(vstack([gap, anchors], format="csr"))


@dataclass(frozen=True)
class UntiedCondensation:
    """Ties and k probes as functions of forces and temperatures, for Kd: ties carry no force."""

    #: Shape (q,): D, N/m.
    springs: Array
    #: Shape (q + k, q): [E; P] Kd^-1 E^T, m/N.
    compliance: Array
    #: Shape (q + k, n_heat): [E; P] Kd^-1 F, m/K.
    thermal: Array


@dataclass(frozen=True)
class _Influence:
    """R Kd^-1 [R^T, F] of one piece, for the rows R = [gaps; its anchors; probes] that touch it."""

    gaps: NDArray[np.int64]
    anchors: Array
    probes: NDArray[np.int64]
    heated: NDArray[np.int64]
    compliance: Array
    thermal: Array


def untied(
    pieces: Iterable[Substructure],
    gap: csr_array,
    springs: Array,
    probes: csr_array,
    temperatures: int,
) -> UntiedCondensation:
    """Condense pieces on their ties and probes without coupling them.

    Parameters
    ----------
    pieces : iterable of Substructure
        Consumed one by one, and not stored.
    gap : scipy.sparse.csr_array, shape (3 m, n)
        G.
    springs : ndarray, shape (3 m,)
        Stiffnesses of the reference springs across the joints, A k, N/m.
    probes : scipy.sparse.csr_array, shape (k, n)
        Rows of the probed displacements.
    temperatures : int
        n_heat.
    """
    # No loop: its variable would keep a factor alive while the next one is made.
    influences = list(map(partial(_influence, gap=gap, probes=probes), pieces))
    springs = np.concatenate([springs, *(-influence.anchors for influence in influences)])
    ties = springs.size
    compliance = np.zeros((ties + probes.shape[0], ties))
    thermal = np.zeros((ties + probes.shape[0], temperatures))
    last = gap.shape[0]
    while influences:
        piece = influences.pop(0)
        own = np.concatenate([piece.gaps, last + np.arange(piece.anchors.size)])
        last += piece.anchors.size
        rows = np.concatenate([own, ties + piece.probes])
        compliance[np.ix_(rows, own)] += piece.compliance[:, : own.size]
        thermal[np.ix_(rows, piece.heated)] += piece.thermal
    return UntiedCondensation(springs, compliance, thermal)


def _influence(piece: Substructure, gap: csr_array, probes: csr_array) -> _Influence:
    own_gap, own_probes = (csr_array(rows[:, piece.unknowns]) for rows in (gap, probes))
    gaps, probed = (np.flatnonzero(np.diff(rows.indptr)) for rows in (own_gap, own_probes))
    at = np.searchsorted(piece.unknowns, piece.anchored)
    ends = np.arange(at.size + 1)
    anchors = csr_array((np.ones(at.size), at, ends), shape=(at.size, piece.unknowns.size))
    rows = csr_array(vstack([own_gap[gaps], anchors, own_probes[probed]], format="csr"))
    # The load is large; it is not copied, nor are its indices sorted.
    has_load = np.zeros(piece.thermal_load.shape[1], dtype=bool)
    has_load[piece.thermal_load.indices] = True
    heated = np.flatnonzero(has_load)
    compliance = np.empty((rows.shape[0], rows.shape[0]))
    thermal = np.empty((rows.shape[0], heated.size))
    width = max(1, AT_ONCE // piece.unknowns.size)
    for start in range(0, rows.shape[0], width):
        part = slice(start, start + width)
        solved = checked_solve(piece.factor, rows[part].toarray().T, "elastic condensation")
        solved = np.ascontiguousarray(solved)  # once, not in each of the products
        compliance[:, part] = rows @ solved
        thermal[part] = (piece.thermal_load.T @ solved)[heated].T
    return _Influence(
        gaps,
        np.full(at.size, piece.anchor),
        probed,
        heated,
        # Symmetric by reciprocity; rounding is removed to make it so to the last bit.
        0.5 * (compliance + compliance.T),
        thermal,
    )


def tied(apart: UntiedCondensation) -> TieCondensation:
    """Tie pieces by their springs D: (I + E Kd^-1 E^T D)^-1 times everything on ties.

    Raises
    ------
    InputError
        Neither supports nor ties constrain the structure.
    """
    springs, compliance, thermal = apart.springs, apart.compliance, apart.thermal
    count = springs.size
    probes, by_force = thermal[count:], compliance[count:] * springs
    if not count:
        return TieCondensation(springs, np.zeros((0, 0)), thermal[:0], compliance, probes)
    # With rows and columns in units of each spring, all entries are of order one.
    root, sign = np.sqrt(np.abs(springs)), np.sign(springs)
    right = root[:, None] * compliance[:count] * root
    system = right * sign
    system[np.diag_indices(count)] += 1.0
    factor = scipy.linalg.lu_factor(system)
    tied = _checked(factor, system, right) / root / root[:, None]
    tied = 0.5 * (tied + tied.T)
    heated = _checked(factor, system, root[:, None] * thermal[:count]) / root[:, None]
    return TieCondensation(
        springs=springs,
        compliance=tied,
        thermal=heated,
        probe_compliance=compliance[count:] - by_force @ tied,
        probe_thermal=probes - by_force @ heated,
    )


def _checked(factor: tuple[Array, Array], system: Array, right: Array) -> Array:
    solved = scipy.linalg.lu_solve(factor, right)
    left = np.abs(system @ solved - right).max(initial=0.0)
    # Written so that NaN fails, too.
    if not left <= RESIDUAL_LIMIT * np.abs(right).max(initial=0.0):
        raise singular("stiffness")
    return np.asarray(solved)
