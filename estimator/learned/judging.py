"""Validation of a learned estimator on an unseen log."""

from __future__ import annotations

import numpy as np

from estimator.columns import samples_of
from estimator.interface import follow
from estimator.learned.estimator import Learned
from estimator.probe_readings import with_probe_readings
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.units import MEGA


def run(estimator: Learned, log: Log, every: float | None = None) -> tuple[Array, Array, list[str]]:
    """Return estimate and band, (k, axes) m, and status of every sample of one run.

    Parameters
    ----------
    estimator : Learned
        Starts afresh.
    log : Log
        One run; displacements are seen only where they are read.
    every : float, optional
        The displacement is read so often, s, and first at the start; default never.
    """
    samples = samples_of(estimator.model.columns, [log])
    if every is not None:
        due = np.arange(log.times[0], log.times[-1] + 1.0, every)
        at = np.minimum(np.searchsorted(log.times, due), len(log.times) - 1)
        told = np.stack([log.at(name)[at] for name in estimator.axes], axis=1)
        samples = with_probe_readings(samples, log.times[at], told)
    found = [one for _, one in follow(estimator, samples, estimator.initial_state())]
    return (
        np.array([one.displacement for one in found]),
        np.array([one.band for one in found]),
        [one.status.words for one in found],
    )


def judge(case: str, estimator: Learned, log: Log) -> list[dict[str, str | float]]:
    """Return errors of every displacement of every run, free-running.

    ``rms_error_um`` is on the zero of the log that was learned from, ``rms_error_zeroed_um`` with
    the estimate's own value at the first sample taken as the day's zero, and so for what is
    uncompensated.

    Parameters
    ----------
    case : str
        Name for the rows.
    estimator : Learned
        Starts afresh in every run.
    log : Log
        With the displacements.

    Raises
    ------
    InputError
        None of the model's displacements is in the log.
    """
    axes = [name for name in estimator.axes if name in log.names]
    if not axes:
        raise InputError(f"{case}: no column of {', '.join(estimator.axes)} to judge by")
    rows: list[dict[str, str | float]] = []
    runs = list(log.runs())
    for number, part in enumerate(runs):
        estimate, band, words = run(estimator, part)
        beyond = float(np.mean([one != "ok" for one in words]))
        name = case if len(runs) == 1 else f"{case}, run {number + 1}"
        rows += [
            _row(name, estimator, axis, estimate, band, part) | {"flagged": beyond} for axis in axes
        ]
    return rows


def _row(
    case: str, estimator: Learned, axis: str, estimate: Array, band: Array, log: Log
) -> dict[str, str | float]:
    c = estimator.axes.index(axis)
    there = np.isfinite(log.at(axis))
    if not there.any():
        raise InputError(f"{case}: {axis} has no value; record it, or leave the column out")
    actual = log.at(axis)[there]
    error = estimate[there, c] - actual

    def rms(values: Array) -> float:
        return float(MEGA * np.sqrt(np.mean(values**2)))

    return {
        "case": case,
        "estimator": estimator.kind,
        "axis": axis,
        "rms_error_um": rms(error),
        "max_abs_error_um": float(MEGA * np.abs(error).max()),
        "rms_uncompensated_um": rms(actual),
        "rms_error_zeroed_um": rms(error - error[0]),
        "rms_uncompensated_zeroed_um": rms(actual - actual[0]),
        "within_band": float(np.mean(np.abs(error) <= band[there, c])),
    }
