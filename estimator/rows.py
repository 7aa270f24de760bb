"""Row of a table of errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MEGA

#: E.g. case, estimator, axis, max_abs_error_um; None where a value is unknown.
Row = Mapping[str, str | float | None]


def figures_of(error: Array, band: Array | None = None) -> dict[str, Array]:
    """Return figures of a run, each of shape (axes,).

    Parameters
    ----------
    error : ndarray, shape (k, axes)
        Estimated minus actual displacement, m.
    band : ndarray, shape (k, axes), optional
        Half-width of the 95 % interval, m.

    Returns
    -------
    dict
        max_abs_error_um, rms_error_um; with a band band_cover (share of samples inside it) and
        mean_band_um.
    """
    figures = {
        "max_abs_error_um": np.abs(error).max(axis=0) * MEGA,
        "rms_error_um": np.sqrt(np.mean(np.square(error), axis=0)) * MEGA,
    }
    if band is not None:
        figures["band_cover"] = np.mean(np.abs(error) <= band, axis=0)
        figures["mean_band_um"] = band.mean(axis=0) * MEGA
    return figures
