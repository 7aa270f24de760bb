"""A joint-aware estimator against responses: it sees the temperatures, the displacement judges."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr

from artefacts.arrays import Array
from artefacts.response import columns_of
from estimator.interface import Estimate, follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.readings import samples_in

_MICRO = 1e6


def judge(
    case: str,
    response: xr.Dataset,
    estimator: JointAware,
    added: Array | None = None,
    state: Array | None = None,
) -> tuple[list[dict[str, str | float]], list[Estimate]]:
    """Run an estimator on the temperatures of `response` and judge it by the displacement.

    Parameters
    ----------
    case : str
        Name for the rows.
    response : xarray.Dataset
        With the probes of the model.
    estimator : JointAware
        What is judged.
    added : ndarray, shape (n, p), optional
        Noise on the sensors, K; NaN takes a reading away.
    state : ndarray, optional
        Where it starts; default at rest.

    Returns
    -------
    rows : list of dict
        For each axis: case, estimator, axis, max_abs_error_um, rms_error_um, peak_total_um,
        band_cover (part of the samples inside the band of 95 %), mean_band_um (its half width).
    estimates : list of Estimate
        The whole run.

    Raises
    ------
    InputError
        The response lacks a probe or an axis.
    """
    samples: Iterable[tuple[float, ...]] = samples_in(response, estimator.model.sensors)
    if added is not None:
        nothing = np.zeros((len(added), 1))
        samples = (
            (time, *(np.array(values) + more))
            for (time, *values), more in zip(samples, np.hstack([added, nothing]), strict=True)
        )
    start = estimator.initial_state() if state is None else state
    found = [estimate for _, estimate in follow(estimator, samples, start)]
    actual = columns_of(response, "displacement", estimator.axes)
    errors = np.array([one.displacement for one in found]) - actual
    bands = np.array([one.band for one in found])
    rows: list[dict[str, str | float]] = []
    for k, axis in enumerate(estimator.axes):
        error, band = np.abs(errors[:, k]), bands[:, k]
        rows.append(
            {
                "case": case,
                "estimator": estimator.kind,
                "axis": axis,
                "max_abs_error_um": float(error.max() * _MICRO),
                "rms_error_um": float(np.sqrt(np.mean(error**2)) * _MICRO),
                "peak_total_um": float(np.abs(actual[:, k]).max() * _MICRO),
                "band_cover": float(np.mean(error <= band)),
                "mean_band_um": float(band.mean() * _MICRO),
            }
        )
    return rows, found
