"""The direct thermal model as a relaxation spectrum: block 3 of Figure 5, far from the source."""

from __future__ import annotations

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.models.parameters import Relaxation


def relaxation_response(t: Array | float, model: Relaxation) -> Array:
    """Return the step response of a relaxation spectrum, K per unit heat input, shaped as `t`."""
    decay = -np.expm1(-np.multiply.outer(np.asarray(t, dtype=float), np.asarray(model.rates)))
    return np.asarray(decay @ np.asarray(model.amplitudes))
