"""Pasts that a machine may have had when an estimator starts on it: random work.

Every past ends now. Its state is that of the linear part of the observer, marched exactly over
steps of constant inputs. The second moment of many such states is the covariance of an unknown
start: it describes which temperature fields past work can have left, and how large they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimator.joint_aware.filter_design import compressed
from thermojoint.artefacts.arrays import Array
from thermojoint.reduced.machine import Modes


@dataclass(frozen=True)
class Duty:
    """Distribution of unknown past work (docs/joint-aware.md, on the initial state)."""

    #: Number of drawn pasts; their seed.
    pasts: int = 400
    seed: int = 1
    #: Of a past, s.
    step: float = 120.0
    #: The machine was cold this long ago, s, evenly in the logarithm.
    begun: tuple[float, float] = (1200.0, 86400.0)
    #: Duration of a level of heat, s, evenly in the logarithm.
    lasts: tuple[float, float] = (300.0, 5400.0)
    #: Share of the levels without heat.
    idle: float = 0.3
    #: Least size of the levels of a past, relative to the largest calibrated heat; each past has a
    #: size of its own.
    least: float = 0.4
    #: Standard deviation of the ambient, K, and its correlation time, s.
    ambient: float = 3.0
    ambient_memory: float = 4.0 * 3600.0


#: The default.
BROAD = Duty()
#: Columns of the covariance factor of an unknown start.
COLUMNS = 12


class Pasts(NamedTuple):
    """Inputs of several pasts on common steps, the last one ending now."""

    #: s.
    step: float
    #: Shape (n, k, s): of every source in every past, relative to the reference.
    heat: Array
    #: Shape (n, k): K above that of the cold machine.
    ambient: Array


def random_pasts(highest: float, sources: int, duty: Duty = BROAD) -> Pasts:
    """Return drawn pasts.

    Parameters
    ----------
    highest : float
        Largest heat, relative to the reference.
    sources : int
        Each has its own levels.
    duty : Duty
        Distribution of the pasts.
    """
    rng = np.random.default_rng(duty.seed)
    shortest, longest = np.log(duty.lasts)
    count = round(duty.begun[1] / duty.step)
    ago = duty.step * (np.arange(count)[::-1] + 0.5)
    levels = int(2.0 * duty.begun[1] / np.exp(0.5 * (shortest + longest)))
    heat = np.zeros((count, duty.pasts, sources))
    for past in range(duty.pasts):
        working = ago < np.exp(rng.uniform(*np.log(duty.begun)))
        size = highest * rng.uniform(duty.least, 2.0)
        for source in range(sources):
            ends = np.cumsum(np.exp(rng.uniform(shortest, longest, levels)))
            level = rng.uniform(0.0, size, levels) * (rng.uniform(size=levels) > duty.idle)
            at = np.minimum(np.searchsorted(ends, ago), levels - 1)
            heat[:, past, source] = working * np.minimum(level[at], highest)
    kept = np.exp(-duty.step / duty.ambient_memory)
    ambient = np.empty((count, duty.pasts))
    ambient[0] = duty.ambient * rng.normal(size=duty.pasts)
    for k in range(1, count):
        fresh = duty.ambient * np.sqrt(1.0 - kept**2) * rng.normal(size=duty.pasts)
        ambient[k] = kept * ambient[k - 1] + fresh
    return Pasts(duty.step, heat, ambient)


def states_after(modes: Modes, rates: Array, power: Array, walk: Array, pasts: Pasts) -> Array:
    """Return the linear state after every past, shape (n, k).

    Parameters
    ----------
    modes : Modes
        With the joint held at its preload.
    rates : ndarray, shape (q,)
        Of the model discrepancy, 1/s.
    power : ndarray, shape (s,)
        Heat of each source at heat input 1, W.
    walk : ndarray, shape (s + h + 1,)
        As `SteadyFilter.walk`: held surfaces and an ambient that change follow the ambient of the
        past.
    pasts : Pasts
        Inputs.
    """
    sources, count = power.size, pasts.ambient.shape[1]
    inputs = np.zeros((len(pasts.ambient), count, walk.size))
    inputs[..., :sources] = pasts.heat * power
    inputs[..., sources:] = pasts.ambient[..., None] * (walk[sources:] > 0.0)
    grown = answer(modes.rates, pasts.step)
    decay, relaxing = np.exp(-modes.rates * pasts.step), np.exp(-rates * pasts.step)
    amplitudes = np.zeros((count, modes.rates.size))
    relaxed = np.zeros((count, sources, rates.size))
    for given, heat in zip(inputs, pasts.heat, strict=True):
        amplitudes = decay * amplitudes + grown * (given @ modes.drive.T)
        relaxed = relaxing * relaxed + (1.0 - relaxing) * heat[..., None]
    return np.hstack([amplitudes, relaxed.reshape(count, -1), inputs[-1]]).T


def start_factor(states: Array, scale: Array) -> Array:
    """Return the covariance factor (n, `COLUMNS`) of a start with one of some states (n, k).

    Columns are compared in units of `scale` (n,).
    """
    return compressed(states / np.sqrt(states.shape[1]), scale, COLUMNS)


def answer(rates: Array, lasted: float) -> Array:
    """Return (1 - exp(-rate lasted)) / rate, s: the response of modes to heat that `lasted`, s."""
    slow = rates * lasted < 1e-9
    safe = np.where(slow, 1.0, rates)
    return np.where(slow, lasted, -np.expm1(-safe * lasted) / safe)
