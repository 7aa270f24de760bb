"""Learning from a log: cleaning, selection, fit, and validation on held-out blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import nnls

from calibrate.learning import baselines
from calibrate.learning.blocks import blocks_of
from calibrate.learning.cleaning import Cleaned, clean, longest_run, read_time
from calibrate.learning.positions import Along, checked, sorted_out
from calibrate.learning.rules import Judging, Rules
from calibrate.learning.selection import Fitted, choose, fit
from calibrate.learning.speed_levels import cost_of_unseen, held_levels, usual
from calibrate.learning.structures import (
    candidates,
    design,
    sizes,
    slope_sizes,
    structures,
    with_slope,
)
from calibrate.learning.thinning import Table, in_one_order, thinned
from estimator.rows import rms
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
    LearnedSlope,
    LogEnd,
    features_of,
)

Kind = Literal["learned", "linear", "ridge", "arx"]
KINDS: tuple[Kind, ...] = ("learned", "linear", "ridge", "arx")

#: Half-width of the 95 % interval, in standard deviations.
QUANTILE = 1.96


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of a log's table, with the indices `at`, as used by a kind of model, µm."""

    features: tuple[Feature, ...]
    sizes: Array
    at: NDArray[np.int64]
    inputs: Array
    outputs: Array
    margin: int
    along: Along | None
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
    """Estimates for blocks of time that a model was not learned from."""

    #: Shape (k,): s; they restart with every run.
    times: Array
    #: Shape (k, axes): m; `band` is the half-width of the 95 % band.
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
        Names of the columns to learn, with or without their units. ``x_um@y_pos_mm`` was read at
        the position in another column, ``x_um`` at fixed ones where the log has ``x@0mm_um`` and
        ``x@400mm_um``: K0 and slope are learned jointly.
    max_sensors : int
        Most temperatures that the model may use for the displacements read at one place at the same
        time together, and for each of the others; a baseline uses all.
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
    pieces, still, moving = sorted_out(pieces, displacements, rules.thinning)
    at_one_place = (*still, *(name for one in moving for name in one.at_one_place))
    table = in_one_order(thinned(pieces, (), rules.thinning, at_one_place))
    if not displacements:
        length = next((one.name for one in table.columns if one.is_displacement), "x_um")
        raise InputError(f"log: name what to learn, e.g. --displacement {length}")
    cleaned = _cleaned(table, still, ignored, rules)
    own: list[tuple[Cleaned, Along | None]] = [
        (replace(cleaned, displacements=names), None)
        for names in _read_together(cleaned, rules.cleaning.together)
    ]
    for one in moving:
        along, warnings = checked(one, table, rules.cleaning, rules.moving)
        of_one = replace(
            cleaned, displacements=(one.name,), warnings=(*cleaned.warnings, *warnings)
        )
        own.append((of_one, along))
    models, held_out = zip(
        *(_learned(part, along, max_sensors, kind, rules) for part, along in own), strict=True
    )
    return _together(models, cleaned), _beside(held_out)


def _read_together(cleaned: Cleaned, share: float) -> list[tuple[str, ...]]:
    """Return the displacements in groups that are read in the same rows, up to a share of them."""
    groups: list[list[str]] = []
    for name in cleaned.displacements:
        read = np.isfinite(cleaned.at(name))
        for group in groups:
            first = np.isfinite(cleaned.at(group[0]))
            if np.count_nonzero(read & first) >= share * np.count_nonzero(read | first):
                group.append(name)
                break
        else:
            groups.append([name])
    return [tuple(group) for group in groups]


def _learned(
    cleaned: Cleaned, along: Along | None, max_sensors: int, kind: Kind, rules: Rules
) -> tuple[LearnedModel, HeldOut]:
    """Learn displacements that were read at one place, or one along an axis."""
    judged = {
        name: _rows(cleaned, along, name, max_sensors, rules)
        for name in KINDS
        if _possible(cleaned, along, name)
    }
    if kind not in judged:
        raise InputError(
            f"kind {kind}: needs temperatures, and the log has none that is usable"
            if not cleaned.sensors
            else f"kind {kind}: not for a displacement along an axis; take {', '.join(judged)}"
        )
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
    warnings += _unseen_speeds(cleaned, rows, errors[kind], rules)
    cleaned = replace(cleaned, warnings=tuple(warnings))
    model = _model(kind, cleaned, rows, fitted, errors | {MEAN: mean}, rules.judging)
    return model, _held_out(cleaned.table.times[rows.at], rows, errors[kind])


def _held_out(times: Array, rows: _Rows, judged: _Judged) -> HeldOut:
    """Estimates of the model of a kind for each block, learned without it, m."""
    truth, band = rows.outputs, QUANTILE * judged.widening * judged.deviations
    estimate = truth - judged.errors
    return HeldOut(times, *(values / MEGA for values in (truth, estimate, band)))


def _beside(parts: Sequence[HeldOut]) -> HeldOut:
    """Return the held-out estimates of several models, NaN at the times of the others."""
    return HeldOut(
        np.concatenate([part.times for part in parts]),
        *(_diagonal(values) for values in zip(*(part[1:] for part in parts), strict=True)),
    )


def _diagonal(parts: Sequence[Array]) -> Array:
    there = block_diag(*(np.ones(part.shape, dtype=bool) for part in parts))
    return np.where(there, block_diag(*parts), np.nan)


def _together(models: Sequence[LearnedModel], cleaned: Cleaned) -> LearnedModel:
    """Return one model of the channels of several, on the features of all."""
    if len(models) == 1:
        return models[0]
    features = tuple(dict.fromkeys(one for model in models for one in model.features))
    origins = [model.learned_from for model in models]

    def texts(name: str) -> tuple[str, ...]:
        return tuple(dict.fromkeys(text for one in origins for text in getattr(one, name)))

    def errors(name: str) -> dict[str, tuple[float, ...]]:
        every = [getattr(one, name) for one in origins]
        kinds = [kind for kind in every[0] if all(kind in one for one in every)]
        return {kind: tuple(value for one in every for value in one[kind]) for kind in kinds}

    return replace(
        models[0],
        features=features,
        channels=tuple(
            _on(channel, [features.index(one) for one in model.features], len(features))
            for model in models
            for channel in model.channels
        ),
        spans={name: span for model in models for name, span in model.spans.items()},
        learned_from=replace(
            origins[0],
            faults=texts("faults"),
            warnings=texts("warnings"),
            errors_um=errors("errors_um"),
            worst_um=errors("worst_um"),
        ),
        log_end=end_of(cleaned, features),
    )


def _on(channel: LearnedChannel, at: Sequence[int], count: int) -> LearnedChannel:
    """Return a channel on more features: `at` are the indices of its own among them."""

    def weights(own: Sequence[float]) -> tuple[float, ...]:
        spread = np.zeros(count)
        spread[list(at)] = own
        return tuple(map(float, spread))

    slope = channel.slope
    index = with_slope(at, count) if slope else list(at)
    size = 2 * count + 1 if slope else count
    covariance = np.zeros((size, size))
    covariance[np.ix_(index, index)] = channel.covariance
    return replace(
        channel,
        weights=weights(channel.weights),
        covariance=tuple(tuple(map(float, row)) for row in covariance),
        slope=slope and replace(slope, weights=weights(slope.weights)),
    )


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
            steps=table.steps[kept],
        ),
        names,
        rules.cleaning,
    )


def _possible(cleaned: Cleaned, along: Along | None, kind: Kind) -> bool:
    # One-step predictions need readings at one place.
    return kind == "learned" or (bool(cleaned.sensors) and not (kind == "arx" and along))


def _rows(cleaned: Cleaned, along: Along | None, kind: Kind, most: int, rules: Rules) -> _Rows:
    """Return the rows for a kind of model, and how it is fitted."""
    features = candidates(cleaned, rules.features)
    if kind in ("linear", "arx"):
        features = tuple(
            feature for feature in features if not feature.exponent and not feature.tau_s
        )
    elif kind == "ridge":
        features = tuple(feature for feature in features if not feature.exponent)
    at, inputs, outputs = design(cleaned, features, rules.features, along)
    interval = _between_readings(cleaned.table, at, along)
    if kind == "arx":
        now, slowest = list(range(len(features))), rules.features.slow[-1]
        tau = baselines.autoregressive_tau(
            np.hstack((inputs, outputs)), len(features), now, interval, slowest
        )
        features += tuple(
            Feature(feature.column, tau, reference=feature.reference) for feature in features
        )
        at, inputs, outputs = design(cleaned, features, rules.features)
    every = list(range(inputs.shape[1]))
    length = float(np.ptp(cleaned.table.times))
    kinds = structures(bool(cleaned.drives), length, rules.features)

    def fitted(some: Array, outputs: Array) -> Fitted:
        blocks = blocks_of(np.hstack((some, outputs)), some.shape[1], interval, rules.fitting)
        if kind == "linear":
            return baselines.linear(blocks, every)
        if kind != "learned":
            return baselines.ridge(blocks, every, rules.fitting.penalties)
        sensors = choose(blocks, features, cleaned.sensors, kinds, most)
        return fit(blocks, features, sensors, kinds)

    margin = int(np.ceil(rules.fitting.margin / interval))
    size = sizes(features, rules.features)
    if along:
        size = slope_sizes(size, along.lever, rules.features)
    return _Rows(features, size, at, inputs, outputs, margin, along, fitted)


def _between_readings(table: Table, at: NDArray[np.int64], along: Along | None) -> float:
    """Mean time between readings of a displacement in the rows `at`, s."""
    if along:
        return float(read_time(table)[-1]) / len(at)
    return table.interval * float(at[-1] + 1 - at[0]) / len(at)


class _Judged(NamedTuple):
    """Errors on held-out blocks."""

    #: Shape (axes,): of all blocks and of the worst one, µm.
    rms: Array
    worst: Array
    #: Shape (axes,): factor on the band.
    widening: Array
    #: Shape (k, axes): truth less estimate, and the standard deviation of the estimate before it is
    #: widened, µm.
    errors: Array
    deviations: Array


def _judged(errors: Sequence[Array], widening: Array, deviations: Array) -> _Judged:
    blocks, whole = np.array([rms(error) for error in errors]), np.concatenate(errors)
    return _Judged(rms(whole), blocks.max(axis=0), widening, whole, deviations)


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
    band = QUANTILE * judged.widening * _deviation(fitted, about, rules).mean(axis=0)
    return [
        f"{name}: the 95 % band, +-{half:.2g} um, is wider than the range in the log, "
        f"{range_:.2g} um: the model explains little of it"
        for name, half, range_ in zip(
            cleaned.displacements, band, np.ptp(rows.outputs, axis=0), strict=True
        )
        if 2.0 * half > range_
    ]


def _unseen_speeds(cleaned: Cleaned, rows: _Rows, judged: _Judged, rules: Rules) -> list[str]:
    """Return warnings, by speed, of large errors at levels that were never run."""

    def without(own: NDArray[np.bool_], away: NDArray[np.bool_]) -> Array:
        return _fitted_without(rows, own, away)[1]

    def usually(own: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return usual(own, _folds(rows, rules.judging), rules.cleaning.seldom)

    said = []
    for column in cleaned.table.columns:
        if column.name not in cleaned.drives or column.quantity not in ("speed", "feed", "load"):
            continue
        speeds = np.abs(cleaned.at(column.name))
        level, held = held_levels(speeds[rows.at] / speeds.max(), rules.cleaning)
        cost = cost_of_unseen(level, held.tolist(), rows.margin, judged.errors, usually, without)
        if cost is None or not (cost.unseen > rules.judging.costly * cost.usual).any():
            continue
        each = ", ".join(
            f"{name} {unseen:.2g} (otherwise {usual:.2g}) um"
            for name, unseen, usual in zip(cleaned.displacements, *cost, strict=True)
        )
        value = "load" if column.quantity == "load" else "speed"
        said.append(
            f"{column.name}: expect larger errors at {value}s that the log lacks: learned without "
            f"its lowest or highest one, the errors there are {each}; record an hour of every "
            f"{value} in use, also above {column.from_si(speeds.max()):.4g}"
        )
    return said


def _deviation(fitted: Fitted, about: Array, rules: Judging) -> Array:
    """Standard deviation of an estimate before it is widened, µm, shape (k, axes).

    `about` (k, n) are inputs, less their mean in the fit.
    """
    spread = rules.open * np.einsum("ti,cij,tj->tc", about, fitted.covariance, about)
    return np.asarray(np.sqrt(spread + fitted.errors**2))


def _fitted_without(
    rows: _Rows, held: slice | NDArray[np.bool_], away: NDArray[np.bool_]
) -> tuple[Fitted, Array]:
    """Return the fit of the rows `away`, and its errors on those held out, µm, (n, axes)."""
    fitted = rows.fit(rows.inputs[away], rows.outputs[away])
    error = rows.outputs[held] - fitted.offset - rows.inputs[held] @ fitted.weights
    return fitted, np.asarray(error)


def _judge(rows: _Rows, rules: Judging) -> _Judged:
    """Judge a kind of model: the whole fit is repeated without each block."""
    errors, deviations = [], []
    for held, away in _folds(rows, rules):
        fitted, error = _fitted_without(rows, held, away)
        about = rows.inputs[held] - rows.inputs[away].mean(axis=0)
        errors.append(error)
        deviations.append(_deviation(fitted, about, rules))
    whole = np.concatenate(deviations)
    ratios = np.abs(np.concatenate(errors)) / whole
    widening = np.quantile(ratios, rules.within, axis=0) / QUANTILE
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
    along, count = rows.along, len(rows.features)
    sums = np.abs(fitted.weights).sum(axis=1)
    used = np.flatnonzero(sums[:count] + (sums[count + 1 :] if along else 0.0))
    index = np.array(with_slope(used.tolist(), count) if along else used)
    size = rows.sizes[index] / MEGA
    weights = size[:, None] * fitted.weights[index]
    features = tuple(rows.features[k] for k in used)
    drifts, slope = fitted.errors, None
    if along:
        drifts, slope = _slope(along, rows, weights, errors[kind].errors[:, 0])
    columns = {feature.column for feature in features}
    widening = errors[kind].widening
    channels = []
    for c, name in enumerate(cleaned.displacements):
        spread = rules.open * fitted.covariance[c][np.ix_(index, index)] * np.outer(size, size)
        values = rows.outputs[:, 0] / MEGA if along else cleaned.at(name)
        values = values[np.isfinite(values)]
        channels.append(
            LearnedChannel(
                name,
                float(fitted.offset[c]) / MEGA,
                tuple(map(float, weights[: len(used), c])),
                tuple(tuple(map(float, row)) for row in 0.5 * (spread + spread.T)),
                max(float(drifts[c]), rules.least_drift) / MEGA,
                (float(values.min()), float(values.max())),
                float(widening[c]),
                slope and replace(slope, drift=max(slope.drift, rules.least_drift / MEGA)),
            )
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
        longest_run(cleaned.table, cleaned.table.times),
        learned_from(
            cleaned,
            {name: judged.rms for name, judged in errors.items()},
            {name: judged.worst for name, judged in errors.items()},
        ),
        log_end=end_of(cleaned, features),
    )


def _slope(along: Along, rows: _Rows, weights: Array, errors: Array) -> tuple[Array, LearnedSlope]:
    """Return the unexplained displacement at P0, µm, shape (1,), and the slope of a fit.

    The squares of the held-out errors (µm) are those of K0 and of a slope, times the lever squared.
    """
    lever = rows.inputs[:, len(rows.features)]
    lever = lever / np.abs(lever).max()
    parts, _ = nnls(np.column_stack((np.ones_like(lever), lever**2)), errors**2)
    own = weights[(len(weights) - 1) // 2 :, 0]
    return np.sqrt(parts[:1]), LearnedSlope(
        along.position,
        along.reference,
        along.stroke,
        float(own[0]),
        tuple(map(float, own[1:])),
        float(np.sqrt(parts[1])) / MEGA / along.lever,
    )


def learned_from(
    cleaned: Cleaned,
    rms: Mapping[str, Array],
    worst: Mapping[str, Array],
    warnings: Sequence[str] = (),
) -> LearnedFrom:
    """Return the origin of a model, with the errors (axes,), um, of each kind of model."""
    return LearnedFrom(
        cleaned.table.samples,
        (),
        cleaned.faults,
        (*cleaned.warnings, *warnings),
        {name: tuple(map(float, errors)) for name, errors in rms.items()},
        {name: tuple(map(float, errors)) for name, errors in worst.items()},
        {name: version(name) for name in ("thermojoint", "numpy")},
    )


def end_of(cleaned: Cleaned, features: tuple[Feature, ...]) -> LogEnd:
    """Return the state of the model at the end of the run that was given last."""
    table = cleaned.table
    last = table.runs()[table.last]
    run = table.times[last], table.values[last]
    columns = dict.fromkeys(feature.column for feature in features)
    return LogEnd(
        float(run[0][-1]),
        tuple(float(cleaned.at(name)[last][-1]) for name in columns),
        tuple(map(float, features_of(features, table.names, run)[-1])),
    )
