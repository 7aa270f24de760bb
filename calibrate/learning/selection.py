"""Which sensors, and which structures: by the error on blocks of time that are held out.

A log of a day holds some ten independent errors, and thousands of sets of sensors: the set with the
least error is mostly luck. So a set is judged by the mean of many small models on it, each of one
or two of its sensors, and what is fitted in the end is a mean over structures as well, weighted by
their errors. What structures disagree in becomes part of the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from artefacts.arrays import Array
from calibrate.learning.blocks import Blocks, held_out, weights_of
from calibrate.learning.structures import Structure, index_of
from models.learned import Feature

#: Weight of the prior in the small models, and those that the final fit averages over; µm².
_SMALL = (0.3, 1.0)
PRIORS = (0.1, 1.0, 10.0)
#: A structure counts by this power of its mean square error.
_SHARPNESS = 2.0
#: Errors below are measured noise, µm.
_NOISE = 0.1


@dataclass(frozen=True, eq=False)
class Fitted:
    """Weights of a mean over structures.

    Attributes
    ----------
    weights : ndarray, shape (features, axes)
        In units of the prior.
    covariance : ndarray, shape (axes, features, features)
        Of the weights.
    offset : ndarray, shape (axes,)
        Displacement where every feature is zero, µm.
    errors : ndarray, shape (axes,)
        Rms error on blocks that were held out, µm.
    """

    weights: Array
    covariance: Array
    offset: Array
    errors: Array


def choose(
    blocks: Blocks,
    features: tuple[Feature, ...],
    sensors: Sequence[str],
    kinds: Sequence[Structure],
    most: int,
) -> tuple[str, ...]:
    """Return at most `most` sensors, added one by one while the held-out error falls.

    Parameters
    ----------
    blocks : Blocks
        Rows of the log.
    features : tuple of Feature
        Of the rows.
    sensors : sequence of str
        To choose from.
    kinds : sequence of Structure
        What small models are made of.
    most : int
        How many.
    """
    small: dict[tuple[str, ...], Array] = {}

    def mean_of(chosen: Sequence[str]) -> Array:
        pairs = [*combinations(sorted(chosen), 1), *combinations(sorted(chosen), 2)]
        for pair in pairs:
            if pair not in small:
                small[pair] = _small(blocks, features, pair, kinds)
        return np.asarray(np.mean([small[pair] for pair in pairs], axis=0))

    chosen: tuple[str, ...] = ()
    least = np.inf
    for _ in range(min(most, len(sensors))):
        scores = {
            name: _score(held_out(blocks, mean_of((*chosen, name))[:-1]))
            for name in sensors
            if name not in chosen
        }
        best = min(scores, key=lambda name: scores[name])
        if not scores[best] < least:
            break
        least, chosen = scores[best], (*chosen, best)
    return chosen


def _small(
    blocks: Blocks,
    features: tuple[Feature, ...],
    sensors: tuple[str, ...],
    kinds: Sequence[Structure],
) -> Array:
    found = [
        weights_of(blocks, index_of(features, sensors, kind), _SMALL).mean(axis=0) for kind in kinds
    ]
    return np.asarray(np.mean(found, axis=0))


def _score(errors: Array) -> float:
    """Return one number for all displacements: the mean logarithm of their errors."""
    return float(np.log(errors.mean(axis=0) + _NOISE**2).sum())


def fit(
    blocks: Blocks,
    features: tuple[Feature, ...],
    sensors: tuple[str, ...],
    kinds: Sequence[Structure],
    priors: Sequence[float] = PRIORS,
) -> Fitted:
    """Return the mean over structures on some sensors, each weighted by its held-out error.

    Parameters
    ----------
    blocks, features, sensors, kinds
        As in `choose`; all of the sensors are used.
    priors : sequence of float
        Weights of the prior, µm².
    """
    axes = len(blocks.whole.mean) - blocks.features
    n = blocks.features
    weights, errors, spreads = [], [], []
    for kind in kinds:
        index = np.array(index_of(features, sensors, kind), dtype=int)
        found = weights_of(blocks, index, priors)
        inner = blocks.whole.centred[np.ix_(index, index)] / blocks.penalty
        for own in found:
            error = held_out(blocks, own[:-1]).mean(axis=0) + _NOISE**2
            weights.append(own)
            errors.append(error)
            spread = np.zeros((axes, n, n))
            for c in range(axes):
                spread[c][np.ix_(index, index)] = np.linalg.inv(
                    inner / error[c] + np.eye(len(index))
                )
            spreads.append(spread)
    every, square, spread = np.array(weights), np.array(errors), np.array(spreads)
    share = (square / square.min(axis=0)) ** -_SHARPNESS
    share /= share.sum(axis=0)
    mean = np.einsum("kc,kfnc->fnc", share, every)
    apart = every[:, -1] - mean[-1]
    covariance = np.einsum("kc,kcij->cij", share, spread)
    covariance += np.einsum("kc,kic,kjc->cij", share, apart, apart)
    whole = blocks.whole.mean
    return Fitted(
        mean[-1],
        covariance,
        whole[n:] - whole[:n] @ mean[-1],
        np.sqrt(held_out(blocks, mean[:-1]).mean(axis=0)),
    )
