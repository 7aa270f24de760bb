"""Rows of the modes of one body each, stored without their zeros.

The products of a compiled march with them are in `fesim.axes.compiled_rows`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.march.passing import Rows
from thermojoint.artefacts.arrays import Array


class RowBlocks(NamedTuple):
    """Consecutive rows with the same nonzero columns, block by block."""

    #: Shape (b, 5): first row and that after the last, first column and that after the last, and
    #: start of the entries.
    where: NDArray[np.int64]
    #: Entries of all blocks, one after the other, in row order.
    entries: Array


class BodyRows(NamedTuple):
    """Rows that a march on axes multiplies by amplitudes or by the heat of rows."""

    #: q rows, as in `fesim.march.passing.Rows`.
    temperature: RowBlocks
    influence: RowBlocks
    #: u rows: untied displacements of pads, stations, anchors and probes, m/K.
    untied: RowBlocks
    #: q rows: the same per W that enters each row of the guides, m.
    warmed: RowBlocks


def body_rows(rows: Rows, untied: Array) -> BodyRows:
    """Return the rows of a machine, from untied displacements (u, r), m/K."""
    each = rows.temperature, rows.influence, untied, rows.influence @ untied.T
    return BodyRows(*map(row_blocks, each))


def row_blocks(rows: Array) -> RowBlocks:
    """Return the blocks of rows (k, n); zero rows belong to none."""
    filled = rows != 0.0
    spans = np.stack([filled.argmax(axis=1), rows.shape[1] - filled[:, ::-1].argmax(axis=1)], 1)
    spans[~filled.any(axis=1)] = 0
    first = np.flatnonzero(np.diff(spans, axis=0, prepend=-1).any(axis=1))
    where, entries, size = [], [np.zeros(0)], 0
    for begin, end in pairwise([*first, len(rows)]):
        low, high = spans[begin]
        if high > low:
            where.append((begin, end, low, high, size))
            entries.append(rows[begin:end, low:high].ravel())
            size += entries[-1].size
    return RowBlocks(np.array(where, dtype=np.int64).reshape(-1, 5), np.concatenate(entries))
