"""Selection of sensors and model structures by the error on held-out blocks.

A log of a day contains some ten independent errors, and there are thousands of sets of sensors: the
set with the smallest error is mostly luck. Therefore the fit on a set is a mean over structures,
weighted by their errors, and a set is judged by that error together with the uncertainty of the
weights: their variance, and the disagreement of the structures. The same is part of the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.learning.blocks import Blocks, held_out, weights_of
from calibrate.learning.structures import Structure, index_of
from thermojoint.artefacts.arrays import Array
from thermojoint.models.learned import Feature


@dataclass(frozen=True, eq=False)
class Fitted:
    """Weights averaged over structures."""

    #: Shape (features, axes): in units of the prior.
    weights: Array
    #: Shape (axes, features, features): of the weights.
    covariance: Array
    #: Shape (axes,): displacement where every feature is zero, µm.
    offset: Array
    #: Shape (axes,): rms error on held-out blocks.
    errors: Array
    #: Shape (axes,): square of `errors`, and the mean variance of the estimate in the log by the
    #: covariance, µm².
    doubt: Array


def choose(
    blocks: Blocks,
    features: tuple[Feature, ...],
    sensors: Sequence[str],
    kinds: Sequence[Structure],
    most: int,
) -> tuple[str, ...]:
    """Return at most `most` sensors, added one by one.

    Each step adds the one that leaves the smallest doubt over all displacements: the error on
    held-out blocks, and the uncertainty of the weights (`Fitted.doubt`).
    """
    chosen: tuple[str, ...] = ()
    for _ in range(min(most, len(sensors))):
        doubts = {
            name: float(np.log(fit(blocks, features, (*chosen, name), kinds).doubt).sum())
            for name in sensors
            if name not in chosen
        }
        chosen = (*chosen, min(doubts, key=lambda name: doubts[name]))
    return chosen


def fit(
    blocks: Blocks,
    features: tuple[Feature, ...],
    sensors: tuple[str, ...],
    kinds: Sequence[Structure],
) -> Fitted:
    """Return the mean over structures on some sensors, each weighted by its held-out error.

    Parameters
    ----------
    blocks, features, sensors, kinds
        As in `choose`; all of the sensors are used.
    """
    axes = len(blocks.whole.mean) - blocks.features
    n = blocks.features
    weights, errors, spreads = [], [], []
    for kind in kinds:
        index = np.array(index_of(features, sensors, kind, n), dtype=np.int64)
        fits = weights_of(blocks, index, blocks.rules.priors)
        inner = blocks.whole.centred[np.ix_(index, index)] / blocks.penalty
        for own in fits:
            error = held_out(blocks, own[:-1]).mean(axis=0) + blocks.rules.noise**2
            weights.append(own)
            errors.append(error)
            spread = np.zeros((axes, n, n))
            spread[:, index[:, None], index] = np.linalg.inv(
                inner / error[:, None, None] + np.eye(len(index))
            )
            spreads.append(spread)
    every, square, spread = np.array(weights), np.array(errors), np.array(spreads)
    share = (square / square.min(axis=0)) ** -blocks.rules.sharpness
    share /= share.sum(axis=0)
    mean = np.einsum("kc,kfnc->fnc", share, every)
    apart = every[:, -1] - mean[-1]
    covariance = np.einsum("kc,kcij->cij", share, spread)
    covariance += np.einsum("kc,kic,kjc->cij", share, apart, apart)
    whole = blocks.whole.mean
    left = held_out(blocks, mean[:-1]).mean(axis=0)
    usual = blocks.whole.centred[:n, :n] / blocks.whole.count
    open_ = np.einsum("cij,ji->c", covariance, usual)
    return Fitted(
        mean[-1], covariance, whole[n:] - whole[:n] @ mean[-1], np.sqrt(left), left + open_
    )
