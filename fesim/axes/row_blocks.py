"""Rows of the modes of one body each: zero elsewhere, and kept without what is zero.

`fesim.axes.compiled_rows` has what a compiled march does with them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermojoint.artefacts.arrays import Array


class RowBlocks(NamedTuple):
    """Rows that follow each other and are not zero in the same columns, block by block."""

    #: Shape (b, 5): first row and that after the last, first column and that after the last, and
    #: where the entries begin.
    where: NDArray[np.int64]
    #: Of all blocks, one after the other, row after row.
    entries: Array


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
