"""Row of a table of errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MEGA

#: E.g. case, estimator, axis, max_abs_error_um; None where a figure is not known.
Row = Mapping[str, str | float | None]


def figures_of(error: Array, band: Array | None = None) -> dict[str, Array]:
    """Return figures of a run, each of shape (axes,).

    Parameters
    ----------
    error : ndarray, shape (k, axes)
        Estimated less actual displacement, m.
    band : ndarray, shape (k, axes), optional
        Half the width of 95 %, m.

    Returns
    -------
    dict
        max_abs_error_um, rms_error_um; with a band band_cover (part of the samples inside it) and
        mean_band_um.
    """
    found = {
        "max_abs_error_um": np.abs(error).max(axis=0) * MEGA,
        "rms_error_um": np.sqrt(np.mean(np.square(error), axis=0)) * MEGA,
    }
    if band is not None:
        found["band_cover"] = np.mean(np.abs(error) <= band, axis=0)
        found["mean_band_um"] = band.mean(axis=0) * MEGA
    return found
