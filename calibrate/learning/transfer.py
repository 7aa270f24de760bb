"""A model from few readings of a machine, with the models of machines like it as prior.

The weights of the sisters' models are the prior for those of this machine, w = w0 + d,

    y = zero + Φ w + drift + noise,   d ~ N(0, C + s² diag(w0²)),

w0 the mean of the sisters' weights, C the mean of their covariances and the covariance of their
means, the drift correlated over hours. The spread s between machines and the size of the drift are
averaged over a grid by the evidence of the readings: readings that the sisters' model explains do
not change it. The model of the same machine before it aged is a sister, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibrate.learning.cleaning import Cleaned, clean, longest_run
from calibrate.learning.learn import QUANTILE, end_of, learned_from
from calibrate.learning.rules import Rules, Transfer
from calibrate.learning.structures import known_rows, within_runs
from calibrate.learning.thinning import thinned
from estimator.interface import READING_NOISE
from estimator.learned.estimator import Following
from estimator.rows import rms
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.log import Log
from thermojoint.artefacts.quantities import column_named
from thermojoint.artefacts.units import MEGA
from thermojoint.models.learned import (
    MEAN,
    SISTER,
    LearnedChannel,
    LearnedModel,
    features_of,
)

#: The kind of the model.
LEARNED = "learned"


class Readings(NamedTuple):
    """Readings of one displacement: times, s, runs, features (n, k), and displacements, m."""

    times: Array
    runs: NDArray[np.int64]
    features: Array
    displacements: Array

    def at(self, kept: NDArray[np.int64] | NDArray[np.bool_]) -> Readings:
        """Return some of them."""
        return Readings(
            self.times[kept], self.runs[kept], self.features[kept], self.displacements[kept]
        )


class Prior(NamedTuple):
    """Prior of one displacement by the sisters: as `LearnedChannel`; `zero_spread` in m."""

    zero: float
    zero_spread: float
    weights: Array
    covariance: Array
    drift: float


class Posterior(NamedTuple):
    """After readings: zero, m, weights and their covariance (n, n), and the drift's size, m."""

    zero: float
    weights: Array
    covariance: Array
    drift: float


def learn_like(
    pieces: Iterable[Log], displacements: Sequence[str], sisters: Sequence[LearnedModel]
) -> LearnedModel:
    """Learn a model from few readings, with the models of machines like it as prior.

    Parameters
    ----------
    pieces : iterable of Log
        The log of this machine; displacements are NaN where they were not read.
    displacements : sequence of str
        Which of the sisters' displacements to learn.
    sisters : sequence of LearnedModel
        Models of machines like it, or of the same machine before it aged, with the same features:
        the second and later ones learned like the first.

    Raises
    ------
    InputError
        The sisters do not fit together, a column is missing or faulty, or there are too few
        readings.
    """
    rules = Rules()
    first = _fitting(sisters)
    known = [channel.name for channel in first.channels]
    wanted = [_known_name(name, known) for name in displacements]
    cleaned = _cleaned(pieces, first, wanted, rules)
    channels, errors, misreadings = [], [], list[str]()
    for name in wanted:
        prior = _prior(sisters, known.index(name))
        readings, wrong = _readings(cleaned, first, name, prior, rules)
        misreadings += wrong
        posterior = fitted(readings, prior, rules.transfer)
        judged, deviations = _judged(readings, prior, rules)
        errors.append(judged)
        ratios = np.abs(np.concatenate(judged[LEARNED])) / deviations
        ratio = np.quantile(ratios, rules.judging.within)
        own = first.channels[known.index(name)]
        channels.append(
            LearnedChannel(
                name,
                posterior.zero,
                tuple(map(float, posterior.weights)),
                tuple(tuple(map(float, row)) for row in posterior.covariance),
                max(posterior.drift, rules.judging.least_drift / MEGA),
                _union(own.span, readings.displacements),
                max(float(ratio) / QUANTILE, 1.0),
            )
        )
    kinds = list(errors[0])
    whole = {
        kind: MEGA * np.array([rms(np.concatenate(one[kind])) for one in errors]) for kind in kinds
    }
    worst = {kind: MEGA * np.array([max(map(rms, one[kind])) for one in errors]) for kind in kinds}
    return LearnedModel(
        LEARNED,
        first.features,
        tuple(channels),
        {name: _union(first.spans[name], cleaned.at(name)) for name in first.columns},
        max(first.duration_s, longest_run(cleaned.table, cleaned.table.times)),
        learned_from(cleaned, whole, worst, (*misreadings, *_no_better(wanted, whole))),
        log_end=end_of(cleaned, first.features),
    )


def fitted(readings: Readings, prior: Prior, rules: Transfer) -> Posterior:
    """Return the posterior of a displacement after readings, averaged over the grid of `rules`."""
    features, correlated = readings.features, _correlated(readings)
    noise = READING_NOISE**2 * np.eye(len(features))
    zero = prior.zero_spread**2
    residual = readings.displacements - prior.zero - features @ prior.weights
    means, spreads, zeros, drifts, evidence = [], [], [], [], []
    for relative, factor in product(rules.relative, rules.drifts):
        spread = prior.covariance + np.diag((relative * prior.weights) ** 2)
        drift = factor * prior.drift
        whole = features @ spread @ features.T + zero + drift**2 * correlated + noise
        cross = spread @ features.T
        weight = np.linalg.solve(whole, residual)
        means.append(cross @ weight)
        spreads.append(spread - cross @ np.linalg.solve(whole, cross.T))
        zeros.append(zero * weight.sum())
        drifts.append(drift**2)
        evidence.append(-0.5 * (residual @ weight + np.linalg.slogdet(whole)[1]))
    share = np.exp(np.array(evidence) - max(evidence))
    share /= share.sum()
    mean = share @ np.array(means)
    own = np.array(means) - mean
    covariance = np.einsum("k,kij->ij", share, np.array(spreads))
    covariance += np.einsum("k,ki,kj->ij", share, own, own)
    return Posterior(
        prior.zero + float(share @ np.array(zeros)),
        prior.weights + mean,
        0.5 * (covariance + covariance.T),
        float(np.sqrt(share @ np.array(drifts))),
    )


def misread(readings: Readings, prior: Prior, rules: Transfer) -> NDArray[np.bool_]:
    """Return which readings of one run are far from what the prior and the others let expect.

    Far is `Transfer.misread` times its standard deviation by the widest prior that `fitted`
    averages over, with a free zero, and as many times the usual distance from the sisters'
    estimate. The furthest reading is taken out first: it spoils what is expected of the others.
    """
    features = readings.features
    spread = prior.covariance + np.diag((max(rules.relative) * prior.weights) ** 2)
    whole = features @ spread @ features.T + READING_NOISE**2 * np.eye(len(features))
    whole += (max(rules.drifts) * prior.drift) ** 2 * _correlated(readings)
    residual = readings.displacements - features @ prior.weights
    kept = np.arange(len(features))
    while len(kept) > 2:
        own = residual[kept] - np.median(residual[kept])
        away = np.abs(own)
        inverse = np.linalg.inv(whole[np.ix_(kept, kept)] + away.max() ** 2)
        # The error of each one estimated from the others, by its standard deviation.
        unexpected = np.abs(inverse @ own) / np.sqrt(np.diag(inverse))
        usual = float(np.median(away))
        if unexpected.max() <= rules.misread or away.max() <= rules.misread * usual:
            break
        kept = np.delete(kept, away.argmax())
    return ~np.isin(np.arange(len(features)), kept)


def _correlated(readings: Readings) -> Array:
    """Return the correlation of the drift between readings; none between runs."""
    apart = readings.times[:, None] - readings.times
    same = readings.runs[:, None] == readings.runs
    return np.asarray(same * np.exp(-np.abs(apart) / Following().drift_time))


def _fitting(sisters: Sequence[LearnedModel]) -> LearnedModel:
    """Return the first of the sisters, if they fit together."""
    if not sisters:
        raise InputError("--like: give the model of a machine like this one")
    first = sisters[0]
    names = [channel.name for channel in first.channels]
    if first.positions:
        raise InputError("--like: not for displacements along an axis; learn them from a log")
    for number, one in enumerate(sisters[1:], start=2):
        if one.features != first.features or [own.name for own in one.channels] != names:
            raise InputError(
                f"--like: model {number} has other features or displacements than the first; learn "
                "it with --like, from the log of its machine and the first model"
            )
    return first


def _known_name(name: str, known: Sequence[str]) -> str:
    for one in known:
        column = column_named(one)
        if name in (one, column.base if column else one):
            return one
    raise unknown_name("displacement", name, known, "--like")


def _prior(sisters: Sequence[LearnedModel], at: int) -> Prior:
    """Return mean and covariance of a displacement over sisters."""
    channels = [one.channels[at] for one in sisters]
    weights = np.array([one.weights for one in channels])
    covariance = np.mean([one.covariance for one in channels], axis=0)
    if len(channels) > 1:
        covariance = covariance + np.cov(weights, rowvar=False)
    return Prior(
        float(np.mean([one.zero for one in channels])),
        max(float(np.ptp(one.span)) for one in channels),
        weights.mean(axis=0),
        covariance,
        float(np.sqrt(np.mean([one.drift**2 for one in channels]))),
    )


def _cleaned(
    pieces: Iterable[Log], sister: LearnedModel, wanted: Sequence[str], rules: Rules
) -> Cleaned:
    """Return the log's columns by the sister's names; all columns of the sister must be usable."""
    names = [*sister.columns, *wanted]
    table = thinned(pieces, names, rules.thinning, wanted)
    columns = [column_named(name) for name in names]
    own = tuple(column or there for column, there in zip(columns, table.columns, strict=True))
    cleaned = clean(replace(table, columns=own), (), rules.cleaning)
    for name in sister.columns:
        if name not in (*cleaned.sensors, *cleaned.drives):
            said = [text for text in (*cleaned.faults, *cleaned.warnings) if text.startswith(name)]
            raise InputError(
                f"{''.join(said[:1]) or f'{name}: not usable'}; the model given by --like reads it"
            )
    return cleaned


def _readings(
    cleaned: Cleaned, sister: LearnedModel, name: str, prior: Prior, rules: Rules
) -> tuple[Readings, list[str]]:
    """Return the readings of a displacement, at most `Transfer.most`, and a line on each misread.

    Each run has its own zero, so that only the variations within each are used.
    """
    table, parts, wrong = cleaned.table, list[Readings](), list[str]()
    for number, run in enumerate(table.runs()):
        times, read = table.times[run], cleaned.at(name)[run]
        features = features_of(sister.features, table.names, (times, table.values[run]))
        kept = np.isfinite(read) & known_rows(cleaned, run, rules.features)
        part = Readings(times, np.full(times.size, number), features, read).at(kept)
        # More are a whole log, of which `without_spikes` has removed them.
        if len(part.times) <= rules.transfer.most:
            bad = misread(part, prior, rules.transfer)
            wrong += [
                f"{name}: {MEGA * value:.4g} um {(time - times[0]) / 3600.0:.1f} h after the start "
                "is far from what the other readings and the given model let expect; left out"
                for time, value in zip(part.times[bad], part.displacements[bad], strict=True)
            ]
            part = part.at(~bad)
        parts.append(part)
    count, most = sum(len(part.times) for part in parts), rules.transfer.most
    if count < rules.transfer.fewest:
        raise InputError(
            f"{name}: {count} readings, those soon after a start on a running machine not counted; "
            f"give {rules.transfer.fewest} or more" + "".join(f"; {line}" for line in wrong[:1])
        )
    parts = [part for part in parts if len(part.times)]
    found = Readings(
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.runs for part in parts]),
        within_runs([part.features for part in parts]),
        within_runs([part.displacements for part in parts]),
    )
    kept = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
    return found.at(kept), wrong


def _judged(readings: Readings, prior: Prior, rules: Rules) -> tuple[dict[str, list[Array]], Array]:
    """Return errors on each block held out, m, for this kind and its alternatives, and deviations.

    The alternatives: the sisters' weights with the mean zero of the other readings, and the mean of
    the other readings.
    """
    count = len(readings.times)
    edges = np.linspace(0, count, min(rules.judging.blocks, count) + 1).astype(int)
    errors: dict[str, list[Array]] = {kind: [] for kind in (LEARNED, SISTER, MEAN)}
    deviations = []
    for first, end in pairwise(edges):
        away = np.ones(count, dtype=bool)
        away[first:end] = False
        held, rest = readings.at(~away), readings.at(away)
        found = fitted(rest, prior, rules.transfer)
        spread = np.einsum("ti,ij,tj->t", held.features, found.covariance, held.features)
        deviations.append(np.sqrt(spread + found.drift**2 + READING_NOISE**2))
        sister = rest.displacements - rest.features @ prior.weights
        estimates = {
            LEARNED: found.zero + held.features @ found.weights,
            SISTER: sister.mean() + held.features @ prior.weights,
            MEAN: np.full(end - first, rest.displacements.mean()),
        }
        for kind, estimate in estimates.items():
            errors[kind].append(held.displacements - estimate)
    return errors, np.concatenate(deviations)


def _no_better(names: Sequence[str], rms: dict[str, Array]) -> list[str]:
    """Return the displacements that the sisters' weights estimate as well, with the errors."""
    return [
        f"{name}: on readings held out the given model is as good as it is, {sister:.2g} um "
        f"(learned {own:.2g} um)"
        for name, own, sister in zip(names, rms[LEARNED], rms[SISTER], strict=True)
        if own >= sister
    ]


def _union(span: tuple[float, float], values: Array) -> tuple[float, float]:
    return min(span[0], float(values.min())), max(span[1], float(values.max()))
