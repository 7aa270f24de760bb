"""Weakly coupled blocks of contact elements, for the gap equations of large machines.

In stacked bodies the blocks of F between their joints are small: the load on a joint follows from
equilibrium, however the others slide. Factorising the blocks is much cheaper than one matrix, only
the block of a joint that changes is factorised again, and a sweep over the blocks replaces the
solution with the whole (`fesim.joint.modified_newton`). It moves the gaps by F in single precision,
half as many bytes to read; the resulting state is still checked with F.

Parallel joints between the same bodies, such as the two rails of a table, can slide against each
other as a whole; then each depends on the other more than on itself, and they form one block.

Start at `blocks_of`; `tests/fesim/joint/test_blocks.py` compares equilibria and marches in blocks
with those of one block and of the plain method.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from fesim.jit import compiled
from fesim.joint.gap import GapProblem, transposed
from fesim.one_thread import MANY
from thermojoint.artefacts.arrays import Array, Flags

#: Up to this many contact elements are one block in any case: their factors fit into the cache.
WHOLE = 96
#: Joints with a larger coupling than this are in one block: a sweep would leave about this fraction
#: of the residual, while drift leaves 0.01 anyway.
COUPLED = 0.15
#: Steps of the power method that estimates a coupling.
POWERS = 8


class Blocks(NamedTuple):
    """Assignment of contact elements to blocks, and the gap-equation data of each block."""

    #: Shape (m,): contact elements, block after block.
    elements: NDArray[np.int64]
    #: Shape (b + 1,): start of each block in `elements`.
    starts: NDArray[np.int64]
    #: Shape (3 m,): k0, in the order of the blocks, Pa/m.
    springs: Array
    #: F of each block and its transpose, in the order of the blocks, m/Pa.
    compliance: Array
    columns: Array
    #: Shape (3 m, 3 m): the whole of F transposed in single precision, m/Pa, in the order of the
    #: machine; (0, 0) for a single block.
    between: NDArray[np.float32]
    #: Largest gap anywhere due to tractions that close their own springs k0 by up to 1 m each, m;
    #: not computed or used for a single block.
    reach: float


class Block(NamedTuple):
    """One block: contact elements (n,), springs (3 n,), F and its transpose (3 n, 3 n)."""

    elements: NDArray[np.int64]
    springs: Array
    compliance: Array
    columns: Array


def one_block(springs: Array, compliance: Array, columns: Array) -> Blocks:
    """Return all contact elements as one block, of k0 (3 m,), F and its transpose (3 m, 3 m)."""
    count = springs.size // 3
    return Blocks(
        elements=np.arange(count),
        starts=np.array([0, count]),
        springs=springs,
        compliance=compliance.ravel(),
        columns=columns.ravel(),
        between=np.empty((0, 0), dtype=np.float32),
        reach=np.nan,
    )


def whole(problem: GapProblem) -> Blocks:
    """Return the contact elements of a machine as one block."""
    return one_block(problem.springs, problem.compliance, problem.columns)


def columns_for(problem: GapProblem, blocks: Blocks) -> Array:
    """Return F transposed (3 m, 3 m), m/Pa, for Newton's method if sweeps fail.

    It is empty for several blocks of `MANY` contact elements: storing it takes as long as twenty
    steps, and a plain step, which computes it if necessary, takes over when sweeps fail.
    """
    apart = blocks.starts.size > 2 and blocks.elements.size >= MANY
    return np.empty((0, 0)) if apart else problem.columns


def blocks_of(problem: GapProblem, counts: Sequence[int], share: Array, supports: Array) -> Blocks:
    """Divide the contact elements.

    Parameters
    ----------
    problem : GapProblem
        Their gap equations; F transposed is only computed if one block remains.
    counts : sequence of int
        Number of contact elements of each joint, in order.
    share, supports : ndarray, shapes (m, p) and (k, 6 p)
        Connections of the p pieces of the structure, as in `fesim.solid.rigid_motions.Constraints`.
    """
    springs, compliance = problem.springs, problem.compliance
    total = springs.size // 3
    if total <= WHOLE or len(counts) < 2:
        return whole(problem)
    joints = np.split(np.arange(total), np.cumsum(counts)[:-1])
    own = _together(springs, compliance, joints, side_by_side(joints, share, supports))
    parts = [np.concatenate([joints[j] for j in np.flatnonzero(own == k)]) for k in np.unique(own)]
    if len(parts) == 1:
        return whole(problem)
    sizes = np.array([part.size for part in parts])
    rows = [unknowns_of(part, total) for part in parts]
    diagonal = [compliance[np.ix_(row, row)] for row in rows]
    return Blocks(
        elements=np.concatenate(parts),
        starts=np.concatenate([[0], np.cumsum(sizes)]),
        springs=np.concatenate([springs[row] for row in rows]),
        compliance=np.concatenate([block.ravel() for block in diagonal]),
        columns=np.concatenate([block.T.ravel() for block in diagonal]),
        between=transposed(compliance, np.float32),
        reach=float(max((abs(row) @ springs for row in compliance), default=0.0)),
    )


@compiled
def part_of(blocks: Blocks, block: int) -> Block:
    """One of the blocks."""
    first, last, square = blocks.starts[block], blocks.starts[block + 1], 0
    for before in range(block):
        square += (blocks.starts[before + 1] - blocks.starts[before]) ** 2
    size = 3 * (last - first)
    own = slice(9 * square, 9 * square + size * size)
    return Block(
        blocks.elements[first:last],
        blocks.springs[3 * first : 3 * last],
        blocks.compliance[own].reshape(size, size),
        blocks.columns[own].reshape(size, size),
    )


def unknowns_of(elements: NDArray[np.int64], total: int) -> NDArray[np.int64]:
    """Return the rows of all three directions of some of `total` contact elements."""
    return np.concatenate([elements, total + elements, 2 * total + elements])


def coupling(
    springs: Array, compliance: Array, a: NDArray[np.int64], b: NDArray[np.int64]
) -> float:
    """Estimate the 2-norm of k0^1/2 F k0^1/2 between two sets of rows, of sticking joints.

    Within a joint it is at most one.
    """
    between = np.sqrt(springs[a])[:, None] * compliance[np.ix_(a, b)] * np.sqrt(springs[b])
    vector, size = np.cos(np.arange(b.size)), 0.0
    for _ in range(POWERS):
        vector /= np.linalg.norm(vector)
        vector = between.T @ (between @ vector)
        size = float(np.linalg.norm(vector))
        if size == 0.0:
            return 0.0
    return float(np.sqrt(size))


def side_by_side(
    joints: Sequence[NDArray[np.int64]], share: Array, supports: Array
) -> NDArray[np.int64]:
    """Return a number for each joint: joints with equal numbers lie on loops of bodies and ground.

    A joint without which its bodies would be disconnected is on no loop, and has its own number.
    Parameters as for `blocks_of`; `joints` are the contact elements of each.
    """
    pieces = share.shape[1]
    touched = np.array([(share[joint] != 0.0).any(axis=0) for joint in joints])
    links = np.column_stack([touched, np.zeros(len(joints), dtype=np.bool_)])
    held = (supports.reshape(-1, pieces, 6) != 0.0).any(axis=2)
    # A joint of one piece only connects it to the ground.
    ties = np.column_stack([held, held.sum(axis=1) < 2])
    alone = np.array([_alone(links, ties, joint) for joint in range(len(links))])
    hanging = _hanging(np.vstack([links[~alone], ties]))
    return np.where(alone, hanging.size + np.arange(len(links)), hanging[links.argmax(axis=1)])


def _alone(links: Flags, ties: Flags, joint: int) -> bool:
    """Whether a joint is the only connection between its bodies."""
    others = np.delete(links, joint, axis=0)
    pieces = _hanging(np.vstack([others, ties]))[links[joint]]
    return bool(pieces.size > 1 and np.unique(pieces).size == pieces.size)


def _hanging(links: Flags) -> NDArray[np.int64]:
    """The connected component of each piece, and of the ground, by links (n, p + 1)."""
    together = csr_array(links.T.astype(float) @ links.astype(float))
    return np.asarray(connected_components(together, directed=False)[1], dtype=np.int64)


def _together(
    springs: Array,
    compliance: Array,
    joints: Sequence[NDArray[np.int64]],
    beside: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the block number of each joint."""
    rows = [unknowns_of(joint, springs.size // 3) for joint in joints]
    graph = np.zeros((len(joints), len(joints)))
    for i, j in combinations(range(len(joints)), 2):
        near = beside[i] == beside[j]
        graph[i, j] = near or coupling(springs, compliance, rows[i], rows[j]) > COUPLED
    return np.asarray(connected_components(csr_array(graph), directed=False)[1], dtype=np.int64)
