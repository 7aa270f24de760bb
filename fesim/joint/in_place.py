"""JIT-compiled assignments in loops.

``into[:] = values`` takes a second to compile at every occurrence in compiled code: it broadcasts,
checks for overlaps and builds an error message. The same is true of operations on whole arrays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled_part
from thermojoint.artefacts.arrays import Array


@compiled_part
def put(values: NDArray[np.generic], into: NDArray[np.generic]) -> None:
    """Copy an array into another of its shape, both contiguous."""
    for k in range(into.size):
        into.flat[k] = values.flat[k]


@compiled_part
def add(values: Array, into: Array) -> None:
    """Add an array to another of its shape, both contiguous."""
    for k in range(into.size):
        into.flat[k] += values.flat[k]


@compiled_part
def fill(into: NDArray[np.generic], value: float) -> None:
    """Set all of a contiguous array."""
    for k in range(into.size):
        into.flat[k] = value
