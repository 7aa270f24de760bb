"""A joint-aware estimator against responses: it sees the temperatures, the displacement judges."""

from __future__ import annotations

import numpy as np
import xarray as xr

from estimator.interface import Estimate, follow
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.readings import samples_in
from estimator.rows import figures_of
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import columns_of
from thermojoint.artefacts.units import MEGA


def followed(
    response: xr.Dataset,
    estimator: JointAware,
    added: Array | None = None,
    state: Array | None = None,
) -> list[Estimate]:
    """Run an estimator on the temperatures of a response.

    Parameters
    ----------
    response : xarray.Dataset
        With the probes of the model.
    estimator : JointAware
        What is run.
    added : ndarray, shape (n, p), optional
        Noise on the sensors, K; NaN takes a reading away.
    state : ndarray, optional
        Where it starts; default at rest.

    Raises
    ------
    InputError
        The response lacks a probe.
    """
    sensors = estimator.model.sensors
    table = np.array(list(samples_in(response, sensors)))
    if added is not None:
        table[:, 1 : 1 + len(sensors)] += added
    start = estimator.initial_state() if state is None else state
    return [estimate for _, estimate in follow(estimator, table.tolist(), start)]


def judge(
    case: str,
    response: xr.Dataset,
    estimator: JointAware,
    added: Array | None = None,
    state: Array | None = None,
    settled_s: float = 0.0,
) -> tuple[list[dict[str, str | float]], list[Estimate]]:
    """Run an estimator on the temperatures of `response` and judge it by the displacement.

    Parameters
    ----------
    case : str
        Name for the rows.
    response, estimator, added, state
        As in `followed`.
    settled_s : float
        The rows count samples from this long after the first one on, s.

    Returns
    -------
    rows : list of dict
        For each axis: case, estimator, axis, peak_total_um, and `estimator.rows.figures_of`.
    estimates : list of Estimate
        The whole run.

    Raises
    ------
    InputError
        The response lacks a probe or an axis.
    """
    found = followed(response, estimator, added, state)
    times = response["time"].to_numpy()
    counted = times >= times[0] + settled_s
    actual = columns_of(response, "displacement", estimator.axes)[counted]
    error = np.array([one.displacement for one in found])[counted] - actual
    band = np.array([one.band for one in found])[counted]
    figures = {"peak_total_um": np.abs(actual).max(axis=0) * MEGA} | figures_of(error, band)
    rows: list[dict[str, str | float]] = [
        {"case": case, "estimator": estimator.kind, "axis": axis}
        | {name: float(values[k]) for name, values in figures.items()}
        for k, axis in enumerate(estimator.axes)
    ]
    return rows, found
