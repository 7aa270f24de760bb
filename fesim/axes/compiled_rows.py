"""JIT-compiled products with rows of the modes of one body each (`fesim.axes.row_blocks`).

A product with a block of rows reads it in storage order, and takes two fifths of the time of
products with its single rows.
"""

from __future__ import annotations

import numpy as np

from fesim.axes.row_blocks import RowBlocks
from fesim.jit import compiled_part
from thermojoint.artefacts.arrays import Array, Flags


@compiled_part
def multiply(blocks: RowBlocks, wanted: Flags, vector: Array, into: Array) -> None:
    """Write products of the wanted rows (k,) with a vector (n,); rows without entries are kept."""
    for b in range(len(blocks.where)):
        begin, end, low, high, at = blocks.where[b]
        block = blocks.entries[at : at + (end - begin) * (high - low)]
        block, part = block.reshape(end - begin, high - low), vector[low:high]
        row = begin
        while row < end:
            first = row
            while row < end and wanted[row]:
                row += 1
            if row > first:
                np.dot(block[first - begin : row - begin], part, into[first:row])
            row += 1


@compiled_part
def add_row(factor: float, source: Array, into: Array) -> None:
    """Add a row, times a factor, to another."""
    for j in range(into.size):
        into[j] += factor * source[j]


@compiled_part
def add_rows(blocks: RowBlocks, wanted: Flags, factors: Array, into: Array) -> None:
    """Add the wanted rows, each times its factor (k,), to a vector (n,)."""
    for b in range(len(blocks.where)):
        begin, end, low, high, at = blocks.where[b]
        part = into[low:high]
        for row in range(begin, end):
            if wanted[row]:
                begun = at + (row - begin) * (high - low)
                add_row(factors[row], blocks.entries[begun : begun + high - low], part)
