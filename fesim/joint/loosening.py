"""Detection of bodies that come loose when contact elements open or slide.

The constraints by a contact element are read from the law's tangent: along its normal while it is
pressed, along its tangents while it sticks, across its slip while it slides. A body that slides as
a whole has no stiffness along its slip, so that its equilibrium position is undetermined.

The check costs next to nothing per step: three sticking contact elements that are not on a line
provide all the constraints of a joint. For fewer, a small factorisation decides; if that is
inconclusive, `Constraints.unheld`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled, compiled_part
from fesim.joint.in_place import put
from fesim.joint.law import ACROSS, ALONG, CROSS, JointLaw, Traction, tangent_matrix
from fesim.solid.rigid_motions import Constraints, described
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import ConvergenceError

#: A contact element below this fraction of its preload does not constrain, nor does it along a
#: tangent with this fraction of its stiffness.
NOTHING = 1e-6
#: A factorisation pivot above this, relative to the largest entry, is not rounding.
SURE = 1e-7
#: Margin in the check of an equilibrium that cannot be followed further.
SPARE = 1e-2

#: Columns of the table of contact elements.
_LEAST, _STIFFNESS, _GROUP, _PLACE = 0, 1, 2, 3


class Watched(NamedTuple):
    """Precomputed data of m contact elements for compiled code; no check if empty."""

    #: Shape (m, 6): smallest effective pressure (Pa), tangential stiffness while sticking (Pa/m; 0
    #: without friction), group of elements between the same bodies, centre (m).
    table: Array
    #: Shape (groups,): number of sticking elements of a group, clearly off each other's line, that
    #: constrain as much as the whole group: 1 to 3.
    needed: NDArray[np.int64]
    #: Shape (m, 3, 6 p): displacement of each contact element along normal and tangents under unit
    #: motions.
    rows: Array
    #: Shape (6 p, 6 p): Gram matrix of the constraints by the supports.
    supports: Array


class WatchWork(NamedTuple):
    """Work arrays of a check: sticking elements of each group, and the stiffness (6 p, 6 p)."""

    corner_count: NDArray[np.int64]
    whole: NDArray[np.bool_]
    corners: NDArray[np.int64]
    matrix: Array


def watch_work(watched: Watched) -> WatchWork:
    """Return work arrays for checks."""
    groups = watched.needed.size
    return WatchWork(
        np.empty(groups, dtype=np.int64),
        np.empty(groups, dtype=np.bool_),
        np.empty((groups, 2), dtype=np.int64),
        np.empty_like(watched.supports),
    )


#: Data for no check.
UNWATCHED = Watched(np.empty((0, 6)), np.empty(0, dtype=np.int64), np.empty((0, 3, 0)), np.eye(0))


@dataclass(frozen=True)
class Watch:
    """Precomputed data for checking a step."""

    #: Possible constraints of the bodies.
    constraints: Constraints
    #: Data of the quick checks.
    watched: Watched
    #: Shape (m,): friction coefficient mu.
    friction: Array
    #: Shape (m,): preload, Pa.
    preload: Array

    def check(self, pressure: Array, tangent: Array) -> None:
        """Raise ConvergenceError if a converged state leaves a body loose.

        Parameters
        ----------
        pressure : ndarray, shape (m,)
            Contact pressure, Pa.
        tangent : ndarray, shape (6, m)
            See `fesim.joint.law.Traction`.
        """
        if surely_held(self.watched, watch_work(self.watched), pressure, tangent):
            return
        self._refuse(self._unheld(pressure > self.watched.table[:, _LEAST], tangent))

    def explain(self, traction: Traction) -> None:
        """Raise ConvergenceError if a body is coming loose in a state without a next one.

        In such a state friction at its limit takes no further load in any direction of slip.
        """
        pressure = traction.value[0] + self.preload
        slides = np.hypot(*traction.value[1:]) > (1.0 - SPARE) * self.friction * pressure
        tangent, shears = traction.tangent.copy(), [ALONG, CROSS, ACROSS]
        tangent[shears] = np.where(slides, 0.0, tangent[shears])
        pressed = pressure > SPARE / NOTHING * self.watched.table[:, _LEAST]
        self._refuse(self._unheld(pressed, tangent))

    def _unheld(self, pressed: NDArray[np.bool_], tangent: Array) -> Array:
        normals, *tangents = self.constraints.directions
        stiffness = self.watched.table[:, _STIFFNESS]
        shear = -np.moveaxis(tangent_matrix(tangent)[1:, 1:], -1, 0)
        sizes, axes = np.linalg.eigh(0.5 * (shear + shear.transpose(0, 2, 1)))
        held = (sizes > NOTHING * stiffness[:, None]) & (pressed & (stiffness > 0.0))[:, None]
        element, which = np.nonzero(held)
        along = np.einsum("ki,ikx->kx", axes[element, :, which], np.array(tangents)[:, element])
        own = np.flatnonzero(pressed)
        return self.constraints.unheld(
            np.concatenate([own, element]), np.vstack([normals[own], along])
        )

    def _refuse(self, motions: Array) -> None:
        """Raise ConvergenceError if there is a free motion, (6 p, motions)."""
        if motions.shape[1]:
            raise ConvergenceError(
                "a body has come loose: joints that are open or slide no longer keep "
                f"{described(self.constraints, motions)}; hold it in [supports], or raise "
                "preload_MPa, friction_coefficient or the number of contact elements"
            )


def watch_of(constraints: Constraints, laws: Sequence[tuple[JointLaw, int]]) -> Watch:
    """Prepare the check for the joints' laws and their numbers of contact elements."""
    per_law = [(NOTHING * law.reference_pressure, _rough_stiffness(law)) for law, _ in laws]
    counts = [n for _, n in laws]
    watched = _watched_places(constraints)
    table = watched.table.copy()
    table[:, :_GROUP] = np.repeat(np.array(per_law).reshape(-1, 2), counts, axis=0)
    return Watch(
        constraints,
        watched._replace(table=table),
        friction=np.repeat([law.friction.coefficient for law, _ in laws], counts),
        preload=np.repeat([law.preload for law, _ in laws], counts),
    )


@lru_cache(maxsize=4)
def _watched_places(constraints: Constraints) -> Watched:
    """Data that do not depend on the joint laws, places and groups; data of the laws are zero."""
    count = len(constraints.centre)
    sides, group = np.unique(np.round(constraints.share, 9), axis=0, return_inverse=True)
    group = group.ravel()
    table = np.zeros((count, 6))
    table[:, _GROUP] = group
    table[:, _PLACE:] = constraints.centre
    rows = np.stack(
        [constraints.frame.rows(constraints.centre, d) for d in constraints.directions], axis=1
    )
    width = constraints.supports.shape[1]
    return Watched(
        table,
        needed=np.array(
            [_needed(constraints.centre[group == k]) for k in range(len(sides))], dtype=np.int64
        ),
        rows=np.ascontiguousarray(
            np.einsum("mp,mdi->mdpi", constraints.share, rows).reshape(count, 3, width)
        ),
        supports=np.ascontiguousarray(constraints.supports.T @ constraints.supports),
    )


def _rough_stiffness(law: JointLaw) -> float:
    return law.friction.stiffness if law.friction.coefficient > 0.0 else 0.0


def _needed(centres: Array) -> int:
    """One more than the dimension spanned by contact elements (k, 3), at most three."""
    sizes = np.linalg.svd(centres - centres.mean(axis=0), compute_uv=False)
    return 1 + min(2, int(np.count_nonzero(sizes > 1e-6 * np.abs(centres).max())))


@compiled
def _as_at_rest(watched: Watched, work: WatchWork, pressure: Array, tangent: Array) -> bool:
    """Whether every group of contact elements certainly provides all its constraints at rest."""
    table, needed = watched.table, watched.needed
    corner_count, whole, corners = work.corner_count, work.whole, work.corners
    for k in range(needed.size):
        corner_count[k], whole[k] = 0, True
    for e in range(table.shape[0]):
        k = int(table[e, _GROUP])
        if corner_count[k] >= needed[k]:
            continue
        stiffness = table[e, _STIFFNESS]
        if pressure[e] <= table[e, _LEAST]:
            whole[k] = False
        elif stiffness > 0.0:
            if tangent[ALONG, e] != -stiffness or tangent[CROSS, e] != 0.0:
                whole[k] = False
            elif corner_count[k] < 2:
                corners[k, corner_count[k]] = e
                corner_count[k] += 1
            else:
                corner_count[k] += _off_line(table, corners[k, 0], corners[k, 1], e)
    held = True
    for k in range(needed.size):
        held = held and (corner_count[k] >= needed[k] or whole[k])
    return held


@compiled_part
def _off_line(table: Array, a: int, b: int, c: int) -> bool:
    """Whether the centre of contact element c is clearly off the line through those of a and b."""
    x, y, z = table[b, 3] - table[a, 3], table[b, 4] - table[a, 4], table[b, 5] - table[a, 5]
    u, v, w = table[c, 3] - table[a, 3], table[c, 4] - table[a, 4], table[c, 5] - table[a, 5]
    cross = (y * w - z * v) ** 2 + (z * u - x * w) ** 2 + (x * v - y * u) ** 2
    return cross > 1e-4 * (x * x + y * y + z * z) * (u * u + v * v + w * w)


@compiled
def _stiff(watched: Watched, work: WatchWork, pressure: Array, tangent: Array) -> bool:
    """Whether all Cholesky pivots of the stiffness against rigid motions are clearly positive.

    Each contact element has unit stiffness along its normal and while it sticks.
    """
    table, rows, matrix = watched.table, watched.rows, work.matrix
    size = matrix.shape[0]
    put(watched.supports, matrix)
    for e in range(table.shape[0]):
        if pressure[e] <= table[e, _LEAST]:
            continue
        stiffness = table[e, _STIFFNESS]
        first = second = cross = 0.0
        if stiffness > 0.0:
            first, second = -tangent[ALONG, e] / stiffness, -tangent[ACROSS, e] / stiffness
            cross = -tangent[CROSS, e] / stiffness
        for i in range(size):
            n, a, b = rows[e, 0, i], rows[e, 1, i], rows[e, 2, i]
            if n == 0.0 and a == 0.0 and b == 0.0:
                continue
            along, across = first * a + cross * b, cross * a + second * b
            for j in range(i + 1):
                matrix[i, j] += n * rows[e, 0, j] + along * rows[e, 1, j] + across * rows[e, 2, j]
    largest = 0.0
    for i in range(size):
        largest = max(largest, matrix[i, i])
    for j in range(size):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > SURE * largest:
            return False
        root = np.sqrt(pivot)
        for i in range(j, size):
            left = matrix[i, j]
            for k in range(j):
                left -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = left / root
    return True


@compiled
def surely_held(watched: Watched, work: WatchWork, pressure: Array, tangent: Array) -> bool:
    """Whether nothing is checked, or a converged state certainly leaves no body loose.

    Contact pressure (m,), Pa, and tangent (6, m) as for `Watch.check`.
    """
    if watched.table.shape[0] == 0:
        return True
    return _as_at_rest(watched, work, pressure, tangent) or _stiff(watched, work, pressure, tangent)
