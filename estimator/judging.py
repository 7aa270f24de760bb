"""Validation of any estimator on responses: temperatures as input, displacement as reference."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimator.interface import Estimator, follow
from estimator.lines import here
from estimator.noise import with_noise
from estimator.rows import Row, figures_of, rms
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.response import columns_of
from thermojoint.artefacts.units import MEGA

if TYPE_CHECKING:
    import xarray as xr

    from thermojoint.models.baselines import Baselines

#: Logs, each with displacements of an estimator and their columns in it.
JudgedIn = Sequence[tuple[Log, Sequence[tuple[str, str]]]]
#: Name of a table to its rows, as content of a JSON file; ``rows`` are the errors.
Figures = dict[str, list[Row]]


@dataclass(frozen=True)
class Conditions:
    """Conditions of a validation."""

    #: Noise on every temperature, K peak to peak.
    noise_pp: float | None = None
    #: Of the noise.
    seed: int = 0
    #: Response to the reference step, from which the exact nonlinear part follows.
    reference: xr.Dataset | None = None
    #: Baselines to judge beside the model.
    baselines: Baselines | None = None

    def only_noise(self, name: str) -> None:
        """Refuse conditions that do not apply to an estimator called `name`: all but noise."""
        for option, value in (("reference", self.reference), ("baselines", self.baselines)):
            if value is not None:
                raise InputError(f"{option}: not for {name}; leave it out")

    def named(self, case: str) -> str:
        """Return a case's name with the noise."""
        # Not "-noise": that is the paper's own case, with its noise on T1 and T2 alone.
        return case if self.noise_pp is None else f"{case}, {self.noise_pp:g} K noise"

    def noisy(self, response: xr.Dataset, probes: Sequence[str]) -> xr.Dataset:
        """Return a response with noise on some probes."""
        if self.noise_pp is None:
            return response
        return with_noise(response, probes, self.noise_pp, self.seed)


def judge_responses(
    estimators: Sequence[Estimator],
    responses: Mapping[str, xr.Dataset],
    samples: Callable[[xr.Dataset], Sequence[Sequence[float]]],
    sensors: Callable[[xr.Dataset], Sequence[str]],
    conditions: Conditions,
) -> Figures:
    """Validate estimators that use the same readings by responses, starting at rest.

    `samples` and `sensors` return the samples of a response, and the probes they come from.
    """
    rows: list[Row] = []
    for name, response in responses.items():
        seen = samples(conditions.noisy(response, sensors(response)))
        for estimator in estimators:
            rows += judge(conditions.named(name), response, estimator, seen)
    return {"rows": rows}


def judge(
    case: str,
    response: xr.Dataset,
    estimator: Estimator,
    samples: Iterable[Sequence[float]],
) -> list[dict[str, str | float]]:
    """Run an estimator from rest and judge it by the displacement of a response.

    Parameters
    ----------
    case : str
        Name for the rows.
    response : xarray.Dataset
        With the displacement.
    estimator : Estimator
        Of any kind.
    samples : iterable of sequences
        Time (s) and the channels, of every sample of the response.

    Returns
    -------
    list of dict
        For each axis: case, estimator, axis, peak_total_um, and `estimator.rows.figures_of`.

    Raises
    ------
    InputError
        The response lacks an axis.
    """
    run = [estimate for _, estimate in follow(estimator, samples, estimator.initial_state())]
    actual = columns_of(response, "displacement", estimator.axes)
    moved, band = here(estimator.axes, estimator.details, run)
    known = None if np.isnan(band).all() else band
    figures = figures_of(moved - actual, known)
    peaks = {"peak_total_um": np.abs(actual).max(axis=0) * MEGA}
    return [
        {"case": case, "estimator": estimator.kind, "axis": axis}
        | {name: float(values[k]) for name, values in (peaks | figures).items()}
        for k, axis in enumerate(estimator.axes)
    ]


def judge_log(
    case: str,
    estimator: Estimator,
    judged: JudgedIn,
    samples: Callable[[Log], Iterable[Sequence[float]]],
) -> list[dict[str, str | float]]:
    """Run an estimator through every run of some logs and judge it by their displacements.

    Parameters
    ----------
    case : str
        Name for the rows.
    estimator : Estimator
        Of any kind.
    judged : sequence of (Log, pairs)
        Logs, each with displacements of the estimator and their columns in it.
    samples : callable
        A run to its samples, one for each row.

    Returns
    -------
    list of dict
        For each displacement of each run. ``rms_error_um`` uses the zero of the log; for
        ``rms_error_zeroed_um`` the estimate at the first reading is its zero, also for the
        uncompensated error. ``flagged`` is the share of samples whose status is not ok.

    Raises
    ------
    InputError
        A displacement was never read.
    """
    rows: list[dict[str, str | float]] = []
    for whole, pairs in judged:
        runs = list(whole.runs())
        for number, part in enumerate(runs, 1):
            found = [one for _, one in follow(estimator, samples(part), estimator.initial_state())]
            moved, band = here(estimator.axes, estimator.details, found)
            flagged = float(np.mean([one.status.words != "ok" for one in found]))
            name = case if len(runs) == 1 else f"{case}, run {number}"
            for axis, column in pairs:
                c = estimator.axes.index(axis)
                errors = _errors(f"{name}: {column}", part.at(column), moved[:, c], band[:, c])
                own = {"case": name, "estimator": estimator.kind, "axis": column}
                rows.append({**own, **errors, "flagged": flagged})
    return rows


def _errors(where: str, actual: Array, estimate: Array, band: Array) -> dict[str, float]:
    """Errors of an estimate, (n,) m, where there is a reading."""
    there = np.isfinite(actual) & np.isfinite(estimate)
    if not there.any():
        raise InputError(f"{where} has no value; record it, or leave the column out")
    actual = actual[there]
    error = estimate[there] - actual
    return {
        "rms_error_um": float(MEGA * rms(error)),
        "max_abs_error_um": float(MEGA * np.abs(error).max()),
        "rms_uncompensated_um": float(MEGA * rms(actual)),
        "rms_error_zeroed_um": float(MEGA * rms(error - error[0])),
        "rms_uncompensated_zeroed_um": float(MEGA * rms(actual - actual[0])),
        "band_cover": float(np.mean(np.abs(error) <= band[there])),
    }
