"""Row of a table of errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.units import MEGA

#: Nominal coverage of a band, as a share of the samples.
COVERED = 0.95
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
        max_abs_error_um, rms_error_um; with a band band_cover (share of samples inside it),
        mean_band_um and interval_score_um (`interval_score`).
    """
    figures = {
        "max_abs_error_um": np.abs(error).max(axis=0) * MEGA,
        "rms_error_um": rms(error) * MEGA,
    }
    if band is not None:
        figures["band_cover"] = np.mean(np.abs(error) <= band, axis=0)
        figures["mean_band_um"] = band.mean(axis=0) * MEGA
        figures["interval_score_um"] = interval_score(error, band) * MEGA
    return figures


def rms(errors: Array) -> Array:
    """Return the root of the mean square of errors (k, ...) over the samples."""
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))


def interval_score(error: Array, band: Array) -> Array:
    """Return the mean interval score of 95 % bands of half-width `band`, m, shape (axes,).

    The full width, and for every sample outside 2/0.05 times the distance from the band: neither a
    wide band nor one that misses scores well (Gneiting & Raftery, JASA 102, 2007, Eq. 43).
    """
    missed = np.maximum(np.abs(error) - band, 0.0)
    return np.asarray(np.mean(2.0 * band + 2.0 / (1.0 - COVERED) * missed, axis=0))
