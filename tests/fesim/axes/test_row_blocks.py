"""Rows of the modes of one body each are kept without what is zero."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fesim.axes.row_blocks import row_blocks

#: Rows one after the other: how many, where they begin, and how many columns they have.
BLOCKS = st.lists(st.tuples(st.integers(1, 4), st.integers(0, 6), st.integers(0, 6)), max_size=5)


@given(BLOCKS, st.integers(0, 2**32 - 1))
def test_blocks_have_every_entry_that_is_not_zero(parts, seed):
    rng = np.random.default_rng(seed)
    rows = np.zeros((sum(count for count, _, _ in parts), 12))
    at = 0
    for count, first, width in parts:
        rows[at : at + count, first : first + width] = rng.uniform(1.0, 2.0, (count, width))
        at += count
    blocks, again = row_blocks(rows), np.zeros_like(rows)
    for begin, end, low, high, start in blocks.where:
        size = (end - begin) * (high - low)
        again[begin:end, low:high] = blocks.entries[start : start + size].reshape(end - begin, -1)
    assert np.array_equal(again, rows)
    assert np.count_nonzero(rows) == blocks.entries.size
