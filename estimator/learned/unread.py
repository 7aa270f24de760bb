"""Bound on the error of a learned estimate due to missing readings and an unknown past.

If the signal u of a feature is wrong by at most b, its relaxation φ is wrong by at most the
relaxation of b, and

    |error of δ| ≤ Σ_f |w_f| L_f b_f,

with the relaxation L_f of the feature. Bounds are added and not their squares, because the
temperatures of a machine rise together. When the reading returns, b is zero, and the error decays
with the time constant of the feature.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from thermojoint.artefacts.arrays import Array, Flags
from thermojoint.models.filters.relaxations import relaxed
from thermojoint.models.learned import LearnedModel


class Unread(NamedTuple):
    """Bounds on unknown errors; arrays of shape (features,), in units of the signals."""

    #: Of the error of each signal; 0 where its reading is present.
    signals: Array
    #: Of the error of each feature.
    relaxed: Array


def at_start(model: LearnedModel, values: Array, missing: Flags) -> Unread:
    """Return the bounds at the first sample of a run, or after a pause.

    A missing column may have any value in the range of the log. A slow feature of a temperature may
    stem from a past as cold as the minimum of the log, that of a heat input from one as hot as the
    warmest thermometer indicates: on a machine that has cooled down, both bounds are zero.

    Parameters
    ----------
    model : LearnedModel
    values : ndarray, shape (columns,)
        SI.
    missing : ndarray of bool, shape (columns,)
        Columns without a reading.
    """
    low, high = np.array([model.spans[name] for name in model.columns]).T
    rise = np.maximum(values - low, 0.0)
    thermometers = np.isin(model.columns, model.sensors)
    known = thermometers & ~missing & (high > low)
    warmth = min(1.0, float((rise[known] / (high - low)[known]).max(initial=0.0)))
    past = np.where(model.heats, warmth * model.signal_ranges, rise[model.places])
    unread = np.where(missing[model.places], model.signal_ranges, 0.0)
    return Unread(unread, np.where(model.taus > 0.0, np.maximum(past, unread), unread))


def later(
    model: LearnedModel, before: Unread, missing: Flags, interval: float, wanders: float
) -> Unread:
    """Return the bounds one sample later.

    A missing temperature may drift from its last value by up to the whole range of the log; a speed
    or a power may change at once.

    Parameters
    ----------
    model : LearnedModel
    before : Unread
    missing : ndarray of bool, shape (columns,)
        Columns without a reading.
    interval : float
        Since the previous sample, s.
    wanders : float
        Time constant with which a temperature drifts from its last value, s.
    """
    kept = np.where(model.heats, 0.0, math.exp(-interval / wanders))
    far = model.signal_ranges
    now = np.where(missing[model.places], far + kept * (before.signals - far), 0.0)
    return Unread(now, relaxed(before.relaxed, before.signals, now, interval, model.taus))
