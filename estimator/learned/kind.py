"""Learned models, including baselines learned from a log, as a kind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from estimator.columns import samples_of
from estimator.intake import Intake, axis_name, of_columns
from estimator.judging import Figures
from estimator.kind import Cold, JudgedIn, Kind, OnFirst, Options
from estimator.learned.estimator import Learned
from estimator.lines import Stroke
from estimator.ranges import Range, duration
from estimator.rows import Row
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import column_named
from thermojoint.models.learned import LearnedModel, read_learned

if TYPE_CHECKING:
    import xarray as xr

    from estimator.export.program import Contents, Precision


def _start(model: LearnedModel, options: Options) -> Learned:
    return Learned(model, options.noise)


def _intake(model: LearnedModel, above_ambient: bool) -> Intake:
    if above_ambient:
        raise InputError(
            'reads = "above-ambient": a learned model reads what its log had; leave the key out'
        )
    axes = [channel.name for channel in model.channels]
    names = [*model.columns, *model.positions, *axes]
    return of_columns(names, len(names) - len(axes))


def _log(
    model: LearnedModel, pieces: Iterable[Log], where: str, on_first: OnFirst | None, cold: Cold
) -> Iterator[tuple[float, ...]]:
    return samples_of(model.columns, pieces, model.positions)


def _response(model: LearnedModel, response: xr.Dataset) -> Iterator[tuple[float, ...]]:
    raise InputError("a response; a learned model takes a log (CSV)")


def _ranges(model: LearnedModel) -> tuple[Range, ...]:
    return (duration(model.duration_s), *(_seen(*span) for span in model.spans.items()))


def _strokes(model: LearnedModel) -> Mapping[str, Stroke]:
    return {
        axis_name(channel.name): Stroke(channel.slope.reference, *channel.slope.stroke)
        for channel in model.channels
        if channel.slope
    }


def _seen(name: str, span: tuple[float, float]) -> Range:
    """The range of a log column, in its own unit."""
    column = column_named(name)
    if column is None:
        return Range(name, *span, "1")
    low, high = column.from_si(np.array(span)).tolist()
    return Range(column.base, low, high, column.unit)


def _judge_logs(model: LearnedModel, logs: Mapping[str, Log]) -> Figures:
    from estimator.learned.judging import judge

    estimator = _start(model, Options())
    rows: list[Row] = [row for name, log in logs.items() for row in judge(name, estimator, log)]
    return {"rows": rows}


def _judged_in(case: str, estimator: Learned, log: Log) -> JudgedIn:
    from estimator.learned.judging import judged_in

    return judged_in(case, estimator, log)


def _program(estimator: Learned, precision: Precision, interval: float) -> Contents:
    from estimator.learned.program import contents

    return contents(estimator, interval)


KIND: Kind[LearnedModel, Learned] = Kind(
    name="a learned model",
    read=read_learned,
    fingerprint=lambda model: model.digest,
    start=_start,
    options=frozenset({"reading_noise"}),
    intake=_intake,
    renamed=lambda model: model.renamed_in((*model.columns, *model.positions)),
    log=_log,
    response=_response,
    ranges=_ranges,
    strokes=_strokes,
    judge=None,
    judge_logs=_judge_logs,
    judged_in=_judged_in,
    program=_program,
)
