"""Anderson acceleration of a fixed-point iteration (Anderson 1965; Walker and Ni 2011).

The misfits of the last sweeps are taken as linear in their values; the next value is a full sweep
from the combination with the least misfit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermojoint.artefacts.arrays import Array

#: Sweeps before the last one that are combined.
DEPTH = 10
#: Singular values below this fraction of the largest one are dropped.
LEAST = 1e-8


def accelerated(values: Sequence[Array], misfits: Sequence[Array]) -> Array:
    """Return the next value (m,) after sweeps from values (m,) and their misfits, end - start."""
    kept = slice(-DEPTH - 1, None)
    taken, left = np.array(values[kept]), np.array(misfits[kept])
    if len(taken) == 1:
        return np.asarray(taken[0] + 0.5 * left[0])
    changes, turns = np.diff(taken, axis=0), np.diff(left, axis=0)
    combined = np.linalg.pinv(turns.T, rcond=LEAST) @ left[-1]
    return np.asarray(taken[-1] + left[-1] - combined @ (changes + turns))
