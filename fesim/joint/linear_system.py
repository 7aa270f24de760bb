"""Solution of a dense linear system in JIT-compiled code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fesim.jit import compiled_part
from thermojoint.artefacts.arrays import Array


@compiled_part
def solve(matrix: Array, right_side: Array) -> NDArray[np.floating]:
    """Solve a system (n, n) for a right side (n,) by LAPACK.

    Every process that compiles a caller of ``np.linalg.solve`` compiles that as well, which takes
    seconds; this function is kept on the disk.

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular.
    """
    return np.linalg.solve(matrix, right_side)
