"""Corrections learned from recorded days of a machine that is unlike its case.

No parameters reproduce such a machine, and its errors persist: they are nearly linear in the mean
innovations of the thermometers over ten minutes, an hour and four, and in the heat of the last
hours (docs/joint-aware.md). The coefficients are a property of the machine that steps and a
cool-down do not show. Here they are found by regression of the errors of the observer in recorded
days and in the other runs. Their prior size maximises the evidence; zero is among the candidates.
The allowance of the band for a machine unlike its case is scaled by the errors in days left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibrate.joint_aware.left_out import means_in, samples_of
from calibrate.joint_aware.misfit import Run
from estimator.joint_aware.estimator import JointAware
from estimator.joint_aware.observer import Observer
from estimator.joint_aware.observer_model import ObserverModel
from estimator.joint_aware.observer_state import KNOWN
from thermojoint.artefacts.arrays import Array

#: A run longer than this is a recorded day, s: longer than any that is made to find parameters.
LONGEST = 5.0 * 3600.0
#: Errors are averaged over the first time and correlated over the second, s: by this ratio they
#: have less information than as many independent ones.
MEAN, ALIKE = 480.0, 1800.0
#: Only relaxations of the heat that are slower than this, s, are features.
SLOW = 3600.0
#: A run that ends before slow errors arise shows errors of other causes: in the sum of squares its
#: errors are multiplied by this. With a factor of 1, a step of 3 with four thermometers is off by
#: up to 9.3 um instead of 4.0 (docs/joint-aware.md, eight plants, five days).
SHORT = 10.0
#: Trial sizes of the coefficients: effect of the root mean square of each feature, relative to the
#: residual.
SIZES = (0.0, *np.geomspace(0.02, 200.0, 25))
#: Directions of the coefficients, of every axis, whose uncertainty is in the band.
DIRECTIONS = 12


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals of an observer in a run, or in a part of it."""

    #: Shape (n, s q): relaxations of the heat.
    relaxed: Array
    #: Shape (n, 3 (p + 1)): mean innovations, K.
    means: Array
    #: Shape (n, axes): estimate less displacement, m; NaN where none was read.
    errors: Array
    #: Factor on its errors in the sum of squares.
    weight: float = 1.0

    def part(self, at: slice) -> Signals:
        """Return a part of it."""
        return Signals(self.relaxed[at], self.means[at], self.errors[at], self.weight)


class _Told(NamedTuple):
    """Coefficients of f features for an axis, and the variance of the residual, `left` (m2)."""

    #: Shape (f,): m and m/K.
    mean: Array
    #: Shape (f, f): covariance.
    covariance: Array
    left: float


def is_day(run: Run) -> bool:
    """Whether a run is a recorded day."""
    return run.length * len(run.inputs) > LONGEST


def shown_in(model: ObserverModel, run: Run) -> Signals:
    """Return the signals of an observer in a run, as means over `MEAN`."""
    samples = samples_of(run, len(model.sources) + len(model.surfaces))
    results = JointAware(replace(model, power_shares={})).results(samples)
    each = results.relaxed, results.means, -run.beyond(results.displacement)
    ends = np.arange(MEAN, run.times[-1] + MEAN, MEAN)
    relaxed, means, errors = (means_in(values, run.times, ends)[0] for values in each)
    weight = SHORT if run.length * len(run.inputs) <= SLOW else 1.0
    return Signals(relaxed, means, errors, weight)


def with_days(
    model: ObserverModel, days: Sequence[Signals], others: Sequence[Signals]
) -> tuple[ObserverModel, float]:
    """Return a model with corrections learned from recorded days.

    And the mean square of its errors, m2, in days that are left out; with a single one, in a half
    of it.

    Parameters
    ----------
    model : ObserverModel
        Of the observer that gave the signals.
    days : sequence of Signals
        At least one.
    others : sequence of Signals
        The other runs, which the corrections must not contradict.
    """
    every, parts = [*others, *days], list(days) if len(days) > 1 else _halves(days[0])
    found = _told(model, every)
    if not any(one.mean.any() for one in found):
        return model, float(np.mean([np.nanmean(np.square(day.errors)) for day in days]))
    squares, allowed = np.zeros(len(parts)), np.zeros(len(parts))
    for k, part in enumerate(parts):
        seen = [*others, *parts[:k], *parts[k + 1 :]]
        left = _left(model, _knowing(model, _told(model, seen), seen), part)
        read = np.isfinite(left)
        squares[k] = np.mean(np.square(left), where=read)
        allowed[k] = np.mean(_expected(model, part), where=read)
    # The original allowance counts as one more day, on which the band was exactly wide enough.
    shares = len(days) * np.mean(squares / allowed)
    share = float(1.0 + shares) / (1.0 + len(days))
    known = _knowing(model, found, every)
    square = known.band.square.copy()
    square[:, -1] *= share
    band = replace(known.band, square=square, allowed=np.array(math.sqrt(share)))
    return replace(known, band=band), float(squares.mean())


def _halves(day: Signals) -> list[Signals]:
    read = np.flatnonzero(np.isfinite(day.errors).any(axis=1))
    middle = int(read[read.size // 2])
    return [day.part(slice(middle)), day.part(slice(middle, None))]


def _slow(model: ObserverModel) -> NDArray[np.int64]:
    """Indices of the relaxations that are features, (s k,)."""
    rates = model.discrepancy.rates
    slow = np.tile(rates * SLOW < 1.0, len(model.sources))
    return np.flatnonzero(slow)


def _features(model: ObserverModel, signals: Signals) -> Array:
    return np.hstack([signals.relaxed[:, _slow(model)], signals.means])


def _told(model: ObserverModel, runs: Sequence[Signals]) -> list[_Told]:
    """Coefficients of the features by runs, axis by axis."""
    features = np.vstack([run.weight * _features(model, run) for run in runs])
    errors = np.vstack([run.weight * run.errors for run in runs])
    read = np.isfinite(errors)
    return [
        _regressed(features[own], error[own]) for own, error in zip(read.T, errors.T, strict=True)
    ]


def _regressed(features: Array, error: Array) -> _Told:
    """Coefficients of features (n, f) that explain the negative of an error (n,).

    The coefficients of features of root mean square 1 are normal with a standard deviation of
    `size` times that of the residual; size and residual maximise the evidence.
    """
    scale = np.sqrt(np.mean(features**2, axis=0))
    scale[scale == 0.0] = np.inf
    share = MEAN / ALIKE
    found, singular, right = np.linalg.svd(features / scale, full_matrices=False)
    singular, along = np.sqrt(share) * singular, np.sqrt(share) * (found.T @ -error)
    count, whole = share * error.size, share * float(error @ error)

    def rest(size: float) -> float:
        gain = 1.0 + (size * singular) ** 2
        left = (whole - float(((1.0 - 1.0 / gain) * along**2).sum())) / count
        return max(left, np.finfo(float).tiny)

    def evidence(size: float) -> float:
        gain = 1.0 + (size * singular) ** 2
        return -count * np.log(rest(size)) - float(np.log(gain).sum())

    size = max(SIZES, key=evidence)
    gain, variance = 1.0 + (size * singular) ** 2, rest(size)
    mean = right.T @ (size**2 * singular / gain * along) / scale
    known = (right.T * (1.0 - 1.0 / gain)) @ right
    covariance = size**2 * variance * (np.eye(scale.size) - known) / np.outer(scale, scale)
    return _Told(mean, covariance, variance)


def _knowing(
    model: ObserverModel, found: Sequence[_Told], runs: Sequence[Signals]
) -> ObserverModel:
    """The model with coefficients by `runs`, and their uncertainty and residual in its band."""
    slow, band = _slow(model), model.band
    gains = np.array([one.mean for one in found])
    gain = np.zeros_like(model.discrepancy.displacement)
    gain[:, slow] = gains[:, : slow.size]
    tangent, modes = band.tangent.copy(), model.modes.rates.size
    tangent[:, modes : modes + gain.shape[1]] += gain
    seen = np.max([np.abs(run.means).max(axis=0) for run in runs], axis=0)
    every = np.vstack([_features(model, run) for run in runs])
    _, draws, twice = band.open.shape
    rows = [_directions(one.covariance, every) for one in found]
    count = draws + sum(map(len, rows))
    opened = np.zeros((len(found), count, twice + seen.size))
    opened[:, :draws, :twice] = np.sqrt(count / draws) * band.open
    for axis, own in enumerate(rows):
        at = draws + sum(map(len, rows[:axis]))
        part = opened[axis, at : at + len(own)]
        part[:, slow] = np.sqrt(count) * own[:, : slow.size]
        part[:, twice:] = np.sqrt(count) * own[:, slow.size :]
    discrepancy = replace(model.discrepancy, displacement=model.discrepancy.displacement + gain)
    told = replace(
        band,
        tangent=tangent,
        constant=band.constant + np.array([one.left for one in found]),
        open=opened,
        seen=seen,
        told=gains[:, slow.size :],
    )
    return replace(model, discrepancy=discrepancy, band=told)


def _directions(covariance: Array, features: Array) -> Array:
    """Rows (r, f) whose squares are most of the variance of features with a covariance (f, f)."""
    values, vectors = np.linalg.eigh(covariance)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    turned = np.linalg.svd(features @ factor, full_matrices=False)[2]
    return np.asarray((factor @ turned.T).T[:DIRECTIONS])


def _left(model: ObserverModel, known: ObserverModel, signals: Signals) -> Array:
    """Errors (n, axes), m, of a corrected model, `known`, in a part of a run with `model`."""
    gain = known.discrepancy.displacement - model.discrepancy.displacement
    corrected = signals.relaxed @ gain.T + Observer(known).displacement_by(signals.means)
    return np.asarray(signals.errors + corrected)


def _expected(model: ObserverModel, signals: Signals) -> Array:
    """Variance (n, axes), m2, of the band of a model in a part of a run."""
    parts = Observer(model).model_error(signals.relaxed, KNOWN, signals.means)
    return np.asarray(model.band.steady + np.square(parts).sum(axis=-1))
