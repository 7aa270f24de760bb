"""Learning from a log: cleaning, selection, fit, and validation on held-out blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibrate.learning import baselines
from calibrate.learning.blocks import blocks_of
from calibrate.learning.cleaning import Cleaned, clean
from calibrate.learning.rules import Judging, Rules
from calibrate.learning.selection import Fitted, choose, fit
from calibrate.learning.structures import candidates, design, sizes, structures
from calibrate.learning.thinning import Table, thinned
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.units import MEGA
from thermojoint.models.learned import (
    MEAN,
    Feature,
    LearnedChannel,
    LearnedFrom,
    LearnedModel,
    LogEnd,
    features_of,
)

Kind = Literal["learned", "linear", "ridge", "arx"]
KINDS: tuple[Kind, ...] = ("learned", "linear", "ridge", "arx")

#: Half-width of the 95 % interval, in standard deviations.
_QUANTILE = 1.96


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of a log as used by a kind of model, µm."""

    features: tuple[Feature, ...]
    sizes: Array
    times: Array
    inputs: Array
    outputs: Array
    margin: int
    fit: Callable[[Array, Array], Fitted]


def learn(
    pieces: Iterable[Log],
    displacements: Sequence[str],
    max_sensors: int = 4,
    kind: Kind = "learned",
    ignored: Sequence[str] = (),
) -> LearnedModel:
    """Learn a model from a log; see `learn_and_judge`."""
    return learn_and_judge(pieces, displacements, max_sensors, kind, ignored)[0]


class HeldOut(NamedTuple):
    """Estimates for blocks of time that a model was not learned from.

    Attributes
    ----------
    times : ndarray, shape (k,)
        s; they begin again where a run does.
    truth, estimate, band : ndarray, shape (k, axes)
        m; the half-width of the 95 % band.
    """

    times: Array
    truth: Array
    estimate: Array
    band: Array


def learn_and_judge(
    pieces: Iterable[Log],
    displacements: Sequence[str],
    max_sensors: int = 4,
    kind: Kind = "learned",
    ignored: Sequence[str] = (),
) -> tuple[LearnedModel, HeldOut]:
    """Learn a model from a log, and return its estimates on held-out blocks of time, too.

    Parameters
    ----------
    pieces : iterable of Log
        The log, in time order; a list of whole logs also works.
    displacements : sequence of str
        Names of the columns to learn, with or without their units.
    max_sensors : int
        Most temperatures that the model may use; a baseline uses all.
    kind : str
        ``learned``, or a baseline: ``linear``, ``ridge``, ``arx``.
    ignored : sequence of str
        Columns to ignore.

    Raises
    ------
    InputError
        A column is missing, or the log is unsuitable; the message says why.
    """
    if max_sensors < 1:
        raise InputError(f"--max-sensors {max_sensors}: give one or more")
    rules = Rules()
    table = thinned(pieces, (), rules.thinning)
    cleaned = _cleaned(table, displacements, ignored, rules)
    judged = {
        name: _rows(cleaned, name, max_sensors, rules) for name in KINDS if _possible(cleaned, name)
    }
    if kind not in judged:
        raise InputError(f"kind {kind}: needs temperatures, and the log has none that is usable")
    errors = {name: _judge(own, rules.judging) for name, own in judged.items()}
    rows = judged[kind]
    mean = _judge_mean(rows, rules.judging)
    useless = _no_better(cleaned.displacements, errors[kind], mean, rules.judging)
    if len(useless) == len(cleaned.displacements):
        raise InputError(
            "log: on held-out blocks of time the model is no better than the mean "
            f"({', '.join(useless)}); record longer, or put thermometers nearer to what warms the "
            "machine"
        )
    warnings = [*cleaned.warnings, *(f"no better than the mean: {text}" for text in useless)]
    fitted = rows.fit(rows.inputs, rows.outputs)
    warnings += _wide(cleaned, rows, fitted, errors[kind], rules.judging)
    cleaned = replace(cleaned, warnings=tuple(warnings))
    model = _model(kind, cleaned, rows, fitted, errors | {MEAN: mean}, rules.judging)
    return model, _held_out(rows, errors[kind])


def _held_out(rows: _Rows, judged: _Judged) -> HeldOut:
    """Estimates of the model of a kind for each block, learned without it, m."""
    truth, band = rows.outputs, _QUANTILE * judged.widening * judged.deviations
    estimate = truth - judged.errors
    return HeldOut(rows.times, *(values / MEGA for values in (truth, estimate, band)))


def with_origin(
    model: LearnedModel, files: Sequence[str], renamed: Mapping[str, str] | None = None
) -> LearnedModel:
    """Return a model with the names of its log's files and the renamed columns."""
    origin = replace(model.learned_from, files=tuple(files))
    return replace(model, learned_from=origin, renamed=dict(renamed or {}))


def _cleaned(
    table: Table, displacements: Sequence[str], ignored: Sequence[str], rules: Rules
) -> Cleaned:
    whole = Log(table.times, table.columns, table.values, table.starts)
    if not displacements:
        raise InputError(
            f"log: name what to learn, e.g. --displacement {next(iter(whole.of('length')), 'x_um')}"
        )
    names = tuple(dict.fromkeys(table.columns[whole.index(name)].name for name in displacements))
    for name in names:
        if table.columns[whole.index(name)].quantity != "length":
            raise InputError(f"{name}: no displacement; name a column in um, mm or m")
    away = {whole.index(name) for name in ignored}
    kept = [k for k in range(len(table.columns)) if k not in away]
    return clean(
        replace(
            table,
            columns=tuple(table.columns[k] for k in kept),
            values=table.values[:, kept],
            spikes=table.spikes[kept],
            missing=table.missing[kept],
        ),
        names,
        rules.cleaning,
    )


def _possible(cleaned: Cleaned, kind: Kind) -> bool:
    return bool(cleaned.sensors) or kind == "learned"


def _rows(cleaned: Cleaned, kind: Kind, most: int, rules: Rules) -> _Rows:
    """Return the rows for a kind of model, and how it is fitted."""
    features = candidates(cleaned, rules.features)
    if kind in ("linear", "arx"):
        features = tuple(
            feature for feature in features if not feature.exponent and not feature.tau_s
        )
    elif kind == "ridge":
        features = tuple(feature for feature in features if not feature.exponent)
    times, inputs, outputs = design(cleaned, features, rules.features)
    interval = cleaned.table.interval
    if kind == "arx":
        now, slowest = list(range(len(features))), rules.features.slow[-1]
        tau = baselines.autoregressive_tau(
            np.hstack((inputs, outputs)), len(features), now, interval, slowest
        )
        features += tuple(
            Feature(feature.column, tau, reference=feature.reference) for feature in features
        )
        times, inputs, outputs = design(cleaned, features, rules.features)
    every = list(range(len(features)))
    length = float(np.ptp(cleaned.table.times))
    kinds = structures(bool(cleaned.drives), length, rules.features)

    def fitted(some: Array, outputs: Array) -> Fitted:
        blocks = blocks_of(np.hstack((some, outputs)), len(features), interval, rules.fitting)
        if kind == "linear":
            return baselines.linear(blocks, every)
        if kind != "learned":
            return baselines.ridge(blocks, every, rules.fitting.penalties)
        sensors = choose(blocks, features, cleaned.sensors, kinds, most)
        return fit(blocks, features, sensors, kinds)

    margin = int(np.ceil(rules.fitting.margin / interval))
    return _Rows(features, sizes(features, rules.features), times, inputs, outputs, margin, fitted)


class _Judged(NamedTuple):
    """Errors on held-out blocks.

    Attributes
    ----------
    rms, worst : ndarray, shape (axes,)
        Of all blocks and of the worst one, µm.
    widening : ndarray, shape (axes,)
        Factor on the band.
    errors, deviations : ndarray, shape (k, axes)
        Truth less estimate, and the standard deviation of the estimate before it is widened, µm.
    """

    rms: Array
    worst: Array
    widening: Array
    errors: Array
    deviations: Array


def _judged(errors: Sequence[Array], widening: Array, deviations: Array) -> _Judged:
    blocks = np.array([np.sqrt((error**2).mean(axis=0)) for error in errors])
    whole = np.concatenate(errors)
    rms = np.sqrt((whole**2).mean(axis=0))
    return _Judged(rms, blocks.max(axis=0), widening, whole, deviations)


def _folds(rows: _Rows, rules: Judging) -> Iterator[tuple[slice, NDArray[np.bool_]]]:
    """Yield each block that is held out, and the rows that are far enough from it."""
    edges = np.linspace(0, len(rows.inputs), rules.blocks + 1).astype(int)
    for first, end in pairwise(edges):
        away = np.ones(len(rows.inputs), dtype=bool)
        away[max(0, first - rows.margin) : end + rows.margin] = False
        yield slice(first, end), away


def _judge_mean(rows: _Rows, rules: Judging) -> _Judged:
    """Judge the mean displacement of the other blocks like a model."""
    errors = [
        rows.outputs[own] - rows.outputs[away].mean(axis=0) for own, away in _folds(rows, rules)
    ]
    unknown = np.full_like(rows.outputs, np.nan)
    return _judged(errors, np.ones(rows.outputs.shape[1]), unknown)


def _no_better(names: Sequence[str], judged: _Judged, mean: _Judged, rules: Judging) -> list[str]:
    """Return the displacements for which a model is no better than the mean, with the errors."""
    return [
        f"{name} {own:.2g} um, the mean {other:.2g} um"
        for name, own, other in zip(names, judged.rms, mean.rms, strict=True)
        if own > rules.useful * other
    ]


def _wide(
    cleaned: Cleaned, rows: _Rows, fitted: Fitted, judged: _Judged, rules: Judging
) -> list[str]:
    """Return warnings about displacements whose band is wider than their range in the log."""
    about = rows.inputs - rows.inputs.mean(axis=0)
    band = _QUANTILE * judged.widening * _deviation(fitted, about, rules).mean(axis=0)
    return [
        f"{name}: the 95 % band, +-{half:.2g} um, is wider than the range in the log, "
        f"{range_:.2g} um: the model explains little of it"
        for name, half, range_ in zip(
            cleaned.displacements, band, np.ptp(rows.outputs, axis=0), strict=True
        )
        if 2.0 * half > range_
    ]


def _deviation(fitted: Fitted, about: Array, rules: Judging) -> Array:
    """Standard deviation of an estimate before it is widened, µm, shape (k, axes).

    `about` (k, n) are inputs, less their mean in the fit.
    """
    spread = rules.open * np.einsum("ti,cij,tj->tc", about, fitted.covariance, about)
    return np.asarray(np.sqrt(spread + fitted.errors**2))


def _judge(rows: _Rows, rules: Judging) -> _Judged:
    """Judge a kind of model: the whole fit is repeated without each block."""
    errors, deviations = [], []
    for held, away in _folds(rows, rules):
        fitted = rows.fit(rows.inputs[away], rows.outputs[away])
        own = rows.inputs[held]
        error = rows.outputs[held] - fitted.offset - own @ fitted.weights
        about = own - rows.inputs[away].mean(axis=0)
        errors.append(error)
        deviations.append(_deviation(fitted, about, rules))
    whole = np.concatenate(deviations)
    ratios = np.abs(np.concatenate(errors)) / whole
    widening = np.quantile(ratios, rules.within, axis=0) / _QUANTILE
    return _judged(errors, np.maximum(widening, 1.0), whole)


def _model(
    kind: Kind,
    cleaned: Cleaned,
    rows: _Rows,
    fitted: Fitted,
    errors: Mapping[str, _Judged],
    rules: Judging,
) -> LearnedModel:
    """Return the model of a fit, without unused features."""
    used = np.flatnonzero(np.abs(fitted.weights).sum(axis=1))
    size = rows.sizes[used] / MEGA
    weights = size[:, None] * fitted.weights[used]
    features = tuple(rows.features[k] for k in used)
    columns = {feature.column for feature in features}
    widening = errors[kind].widening
    channels = []
    for c, name in enumerate(cleaned.displacements):
        spread = rules.open * fitted.covariance[c][np.ix_(used, used)] * np.outer(size, size)
        values = cleaned.at(name)
        values = values[np.isfinite(values)]
        channels.append(
            LearnedChannel(
                name,
                float(fitted.offset[c]) / MEGA,
                tuple(map(float, weights[:, c])),
                tuple(tuple(map(float, row)) for row in 0.5 * (spread + spread.T)),
                max(float(fitted.errors[c]), rules.least_drift) / MEGA,
                (float(values.min()), float(values.max())),
                float(widening[c]),
            )
        )
    table = cleaned.table
    ends = [*table.starts[1:], len(table.times)]
    duration = max(
        float(table.times[end - 1] - table.times[first])
        for first, end in zip(table.starts, ends, strict=True)
    )
    return LearnedModel(
        kind,
        features,
        tuple(channels),
        {
            column: (float(cleaned.at(column).min()), float(cleaned.at(column).max()))
            for column in (*cleaned.sensors, *cleaned.drives)
            if column in columns
        },
        duration,
        LearnedFrom(
            table.samples,
            (),
            cleaned.faults,
            cleaned.warnings,
            {name: tuple(map(float, judged.rms)) for name, judged in errors.items()},
            {name: tuple(map(float, judged.worst)) for name, judged in errors.items()},
            {name: version(name) for name in ("thermojoint", "numpy")},
        ),
        log_end=_end_of(cleaned, features),
    )


def _end_of(cleaned: Cleaned, features: tuple[Feature, ...]) -> LogEnd:
    """Return the state of the model at the end of the log's last run."""
    table = cleaned.table
    names = [column.name for column in table.columns]
    last = slice(table.starts[-1], None)
    run = table.times[last], table.values[last]
    columns = dict.fromkeys(feature.column for feature in features)
    return LogEnd(
        float(table.times[-1]),
        tuple(float(cleaned.at(name)[-1]) for name in columns),
        tuple(map(float, features_of(features, names, run)[-1])),
    )
