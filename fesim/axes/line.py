"""The line that a control compensates along an axis: K0 + tan(beta) (P - P0)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermojoint.artefacts.arrays import Array


@dataclass(frozen=True)
class Line:
    """Least-squares line delta = K0 + tan(beta) (P - P0) of each component of a displacement."""

    #: Shape (..., c): K0, m.
    offset: Array
    #: Shape (..., c): tan beta.
    slope: Array
    #: Shape (..., c): largest magnitude of the residual of the line, m.
    left: Array


def line_over(positions: Array, displacements: Array, reference: float) -> Line:
    """Fit the line of a control's axis to displacements over its positions.

    Parameters
    ----------
    positions : ndarray, shape (k,)
        Positions, at least two different ones, m.
    displacements : ndarray, shape (..., k, c)
        Displacements, m.
    reference : float
        P0, m.
    """
    arm = positions - positions.mean()
    mean = displacements.mean(axis=-2)
    slope = np.einsum("k,...kc->...c", arm, displacements) / (arm @ arm)
    rest = displacements - mean[..., None, :] - arm[:, None] * slope[..., None, :]
    offset = mean + (reference - positions.mean()) * slope
    return Line(offset, slope, np.abs(rest).max(axis=-2))
