"""Rows of the modes of one body each: zero elsewhere, and kept without what is zero.

`fesim.axes.compiled_rows` has what a compiled march does with them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fesim.march.passing import Rows
from thermojoint.artefacts.arrays import Array


class RowBlocks(NamedTuple):
    """Rows that follow each other and are not zero in the same columns, block by block."""

    #: Shape (b, 5): first row and that after the last, first column and that after the last, and
    #: where the entries begin.
    where: NDArray[np.int64]
    #: Of all blocks, one after the other, row after row.
    entries: Array


class BodyRows(NamedTuple):
    """What a march on axes multiplies with amplitudes, and with the heat of rows."""

    #: Of the q rows, as in `fesim.march.passing.Rows`.
    temperature: RowBlocks
    influence: RowBlocks
    #: Of u rows: untied displacements of pads, stations, anchors and probes, m/K.
    untied: RowBlocks
    #: Of q rows: the same per W that enters each row of the guides, m.
    warmed: RowBlocks


def body_rows(rows: Rows, untied: Array) -> BodyRows:
    """Return the rows of a machine, with untied displacements (u, r), m/K."""
    each = rows.temperature, rows.influence, untied, rows.influence @ untied.T
    return BodyRows(*map(row_blocks, each))


def row_blocks(rows: Array) -> RowBlocks:
    """Return the blocks of rows (k, n); those that are zero are in none."""
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
