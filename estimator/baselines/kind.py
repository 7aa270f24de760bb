"""Baseline regressions as a kind: a file holds three (mlr, ridge, arx), of which one is run."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.baselines.autoregression import AutoregressionEstimator
from estimator.baselines.regression import RegressionEstimator
from estimator.intake import Intake, intake
from estimator.judging import Conditions, Figures, judge_responses
from estimator.kind import Cold, Kind, OnFirst, Options
from estimator.measured import announced
from estimator.ranges import Range, duration
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.log import Log
from thermojoint.models.baselines import Baselines, read_baselines
from thermojoint.models.sensors import ROLES, rises

if TYPE_CHECKING:
    import xarray as xr

RegressedEstimator = RegressionEstimator | AutoregressionEstimator


def regressions(baselines: Baselines, dt_s: float) -> list[RegressedEstimator]:
    """Return the estimators mlr, ridge and arx.

    Parameters
    ----------
    baselines : Baselines
    dt_s : float
        Nominal sampling interval, s; the machine is at rest until this long before the first
        sample.
    """
    return [
        RegressionEstimator("mlr", baselines, dt_s),
        RegressionEstimator("ridge", baselines, dt_s),
        AutoregressionEstimator(baselines),
    ]


def _start(baselines: Baselines, options: Options) -> RegressedEstimator:
    known = {estimator.kind: estimator for estimator in regressions(baselines, options.interval)}
    wanted = options.regression or "ridge"
    if wanted not in known:
        raise unknown_name("regression", wanted, known, "baselines")
    return known[wanted]


def _fingerprint(baselines: Baselines) -> str:
    content = json.dumps(asdict(baselines), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def _resumed(
    baselines: Baselines,
    options: Options,
    carried: Any,  # noqa: ANN401
    where: str,
) -> RegressedEstimator:
    if options.regression not in (None, carried):
        raise InputError(f"{where}: saved by {carried}; give the same regression")
    return _start(baselines, replace(options, regression=str(carried)))


def _intake(baselines: Baselines, above_ambient: bool) -> Intake:
    if above_ambient:
        names = [f"{role}_K" for role in ROLES]
        return intake(names, len(names), lambda readings, cold: (list(readings), cold))
    names = [f"{role}_degC" for role in (*ROLES, "ambient")]

    def convert(readings: Sequence[float], cold: float) -> tuple[list[float], float]:
        *temperatures, ambient = readings
        return [value - ambient for value in temperatures], cold

    return intake(names, len(names), convert)


def _log(
    baselines: Baselines, pieces: Iterable[Log], where: str, on_first: OnFirst | None, cold: Cold
) -> Iterator[tuple[float, ...]]:
    """Columns ``a_K`` and so on, above the current ambient, or ``a_degC`` with ``ambient_degC``."""
    for piece in announced(pieces, (*ROLES, "ambient"), on_first):
        above = f"{ROLES[0]}_K" in piece.names
        wanted = (
            [f"{role}_K" for role in ROLES]
            if above
            else [f"{role}_degC" for role in (*ROLES, "ambient")]
        )
        values = piece.values[:, [piece.index(name) for name in wanted]]
        rise = values if above else values[:, :-1] - values[:, -1:]
        # Rows with a missing reading are skipped.
        there = np.isfinite(rise).all(axis=1)
        for time, row in zip(piece.times[there].tolist(), rise[there].tolist(), strict=True):
            yield (time, *row)


def _response(baselines: Baselines, response: xr.Dataset) -> Iterator[tuple[float, ...]]:
    for time, row in zip(response["time"].to_numpy(), rises(response), strict=True):
        yield (float(time), *map(float, row))


def _judge(
    kind: Kind[Baselines, RegressedEstimator],
    baselines: Baselines,
    responses: Mapping[str, xr.Dataset],
    conditions: Conditions,
) -> Figures:
    conditions.only_noise(kind.name)
    rows = []
    for name, response in responses.items():
        interval = float(np.diff(response["time"].to_numpy()).min())
        rows += judge_responses(
            regressions(baselines, interval),
            {name: response},
            lambda seen: list(_response(baselines, seen)),
            lambda seen: ROLES,
            conditions,
        )["rows"]
    return {"rows": rows}


KIND: Kind[Baselines, RegressedEstimator] = Kind(
    name="a file of baselines",
    read=read_baselines,
    fingerprint=_fingerprint,
    start=_start,
    options=frozenset({"regression"}),
    paced=True,
    carried=lambda estimator: estimator.kind,
    resumed=_resumed,
    intake=_intake,
    log=_log,
    response=_response,
    sensors=lambda baselines, response: ROLES,
    ranges=lambda baselines: (
        duration(baselines.span.duration_s),
        *(Range(name, *span, "K") for name, span in baselines.span.temperatures.items()),
    ),
    judge=_judge,
)
