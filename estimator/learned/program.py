"""Export of a learned model: weighted relaxations of the inputs.

As `estimator.learned.estimator` without displacement readings: zero and weights are the learned
ones, and so is the band. With x = dt/τ a relaxation of the straight line from u0 to u1 changes by

    y1 - y0 = g (u0 - y0) + h (u1 - u0),   g = 1 - exp(-x),   h = 1 - g/x.

A displacement along an axis has K0 and a slope: shares (1, 0) of them give K0, (0, 1) the slope,
and (1, p - P0) the displacement at a position p.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from estimator import lines
from estimator.export.program import (
    Compared,
    Contents,
    Interface,
    Operations,
    Variable,
    distinct,
    listed,
)
from estimator.export.recorded import duty_cycle
from estimator.intake import axis_name
from estimator.interface import Estimate, Status
from estimator.learned.estimator import Learned
from estimator.span import SLACK
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.models.learned import LARGEST, LearnedChannel, LearnedModel

#: Terms of the series of h, which is accurate for x below 1.
TERMS = 18
#: Status bit that no estimator in Python has: `here` is at the last position that was read.
UNPLACED = 1 << 12
#: Exponents that need no power function.
_PRODUCTS = (1.0, 2.0)
_STATUSES = (
    Status.BEYOND_TIME,
    Status.BEYOND_HEAT,
    Status.BEYOND_TEMPERATURE,
    Status.READING_MISSING,
    Status.UNSETTLED,
    Status.BEYOND_DISPLACEMENT,
    Status.READINGS_LOST,
)


class Filtered(NamedTuple):
    """A feature as filtered in the program."""

    #: Index of the reading.
    column: int
    #: As `thermojoint.models.learned.Feature`.
    exponent: float
    reference: float
    scale: float
    tau: float


def contents(estimator: Learned, interval: float) -> Contents:
    """Return the program contents of a learned estimator; the nominal interval is in s.

    Raises
    ------
    InputError
        The interval is not positive.
    """
    if not 0.0 < interval < np.inf:
        raise InputError(f"export: an interval of {interval:g} s; give a positive one")
    model, own = estimator.model, estimator.following
    columns, count, axes = len(model.columns), len(model.features), len(model.channels)
    features = [
        Filtered(
            model.columns.index(feature.column),
            feature.exponent,
            feature.reference,
            feature.scale,
            feature.tau_s,
        )
        for feature in model.features
    ]
    powers = sum(feature.exponent not in (0.0, *_PRODUCTS) for feature in features)
    slow = sum(feature.tau > 0.0 for feature in features)
    # K0, then the slope, whose covariance includes the zero.
    parts = 2 if model.positions else 1
    spread = parts * (count + 1) - 1
    filters = [_filters(channel, parts, own.drift_size) for channel in model.channels]
    zeros, weights, spreads, unexplained = map(np.array, zip(*filters, strict=True))
    # Each displacement, and along an axis its slope and its value at the present position.
    seen = axes + 2 * sum(channel.slope is not None for channel in model.channels)
    products = parts * (3 + 2 * count) + count * (parts + 1) + spread * (spread + 1)
    usual = Operations(
        seen * (products + 1) + 3 * count + 4 * slow,
        seen * (products + 3) + count + 13 * slow + 2 * columns + 3,
        count + columns,
        powers + seen,
    )
    ranges = [model.spans[name] for name in model.columns]
    strokes = {one.slope.position: one.slope.stroke for one in model.channels if one.slope}
    sensors = [name in model.sensors for name in model.columns]
    return Contents(
        # The program has no clock in common with the log: it starts a new run.
        replace(estimator, model=replace(model, log_end=None)),
        _interface(estimator, interval),
        values={
            "features": features,
            "gains": gains(model.taus, interval),
            "shares_of": parts,
            "readings": columns,
            "zeros": zeros,
            "weights": weights,
            "spreads": spreads,
            "unexplained": unexplained,
            "lines": _lines(model),
            "references": [
                next(one.reference for one in _lines(model) if one.position == k)
                for k in range(len(model.positions))
            ],
            "unplaced": UNPLACED,
            "widths": [own.within * channel.widening for channel in model.channels],
            "reaches": [own.reached(channel.span) for channel in model.channels],
            "possible": model.possible,
            "limits": estimator.limits,
            "middles": [0.5 * (low + high) for low, high in ranges],
            "spans": ranges,
            "thermometers": [
                k for k, (low, high) in enumerate(ranges) if high > low and sensors[k]
            ],
            "signal_ranges": model.signal_ranges,
            "most_unknown": np.outer(
                np.abs(weights[:, 0]) @ model.signal_ranges, (own.unsettled, own.lost)
            ),
            "pause": own.pause,
            "wanders": own.wanders,
            "unsettled": own.unsettled,
            "lost": own.lost,
            "temperatures": sensors,
            "longest": (1.0 + SLACK) * model.duration_s,
            "largest": LARGEST,
            "terms": TERMS,
        },
        constants=8 * count + axes * (parts * (count + 2) + spread**2 + 5) + 7 * columns,
        state=columns + 5 * count + 3 + len(strokes),
        usual=usual,
        worst=usual
        + Operations(TERMS + 2, TERMS + 2, TERMS + 2, 1).times(slow)
        + Operations(count, 2 * count, 1, 1),
        labels=("a sample at the nominal interval", "at any other interval, at most"),
        duty=lambda: duty_cycle([*ranges, *strokes.values()], interval).tolist(),
        lines=partial(_lines_in, model),
    )


class Along(NamedTuple):
    """A displacement with a slope, in the program."""

    #: Indices of the displacement and of the position.
    axis: int
    position: int
    #: P0, m.
    reference: float


def _lines(model: LearnedModel) -> list[Along]:
    return [
        Along(k, model.positions.index(channel.slope.position), channel.slope.reference)
        for k, channel in enumerate(model.channels)
        if channel.slope
    ]


def _filters(channel: LearnedChannel, parts: int, drift_size: float) -> tuple[Array, ...]:
    """Zero, weights, covariance and unexplained variance of K0, and of the slope; see `Learned`."""
    count, slope = len(channel.weights), channel.slope
    zero, weights, drift = np.zeros(parts), np.zeros((parts, count)), np.zeros(parts)
    spread = np.zeros((parts * (count + 1) - 1,) * 2)
    zero[0], weights[0], drift[0] = channel.zero, channel.weights, channel.drift
    known = np.asarray(channel.covariance)
    spread[: len(known), : len(known)] = known
    if slope:
        zero[1], weights[1], drift[1] = slope.zero, slope.weights, slope.drift
    return zero, weights, spread, (1.0 + drift_size**2) * drift**2


def _lines_in(model: LearnedModel, estimate: Estimate) -> Array:
    """Values that the self-test compares: at the present position, then slope times stroke, m.

    The former is zero where the position was not read.
    """
    slopes = [channel.slope for channel in model.channels if channel.slope]
    at = len(lines.DETAILS)
    details = estimate.details.reshape(len(slopes), at + len(lines.HERE))
    over = [
        (one.stroke[1] - one.stroke[0]) * own[0] for one, own in zip(slopes, details, strict=True)
    ]
    return np.concatenate([np.nan_to_num(details[:, at]), over])


def gains(taus: Array, interval: float) -> Array:
    """Return g and h of each feature, shape (n, 2); 1 and 1 for an unfiltered signal.

    Parameters
    ----------
    taus : ndarray, shape (n,)
        Time constants, s; 0 for an unfiltered signal.
    interval : float
        s.
    """
    slow = taus > 0.0
    x = np.where(slow, interval / np.where(slow, taus, 1.0), 1.0)
    series = np.zeros_like(x)
    for k in range(TERMS, 0, -1):
        series = (1.0 - series) / (k + 1.0) * np.where(x < 1.0, x, 0.0)
    g = -np.expm1(-x)
    h = np.where(x < 1.0, series, 1.0 - g / x)
    return np.stack((np.where(slow, g, 1.0), np.where(slow, h, 1.0)), axis=1)


def _interface(estimator: Learned, interval: float) -> Interface:
    model: LearnedModel = estimator.model
    inputs = distinct([axis_name(name) for name in (*model.columns, *model.positions)], "columns")
    axes = distinct([axis_name(name) for name in estimator.axes], "displacements")
    sloped = [(axes[k], one.slope) for k, one in enumerate(model.channels) if one.slope]
    along = [axis for axis, _ in sloped]
    here, slope = listed("here", "m", along), listed("slope", "m/m", along)
    units = [channel.unit for channel in estimator.channels]
    return Interface(
        kind="learned",
        fingerprint=model.digest,
        interval=interval,
        timed=True,
        inputs=tuple(Variable(*variable, "") for variable in zip(inputs, units, strict=False)),
        outputs=(
            *listed("displacement", "m", axes),
            *listed("band", "m", axes),
            *here,
            *listed("here_band", "m", along),
            *slope,
            *listed("slope_band", "m/m", along),
            *listed("P0", "m", along),
        ),
        axes=axes,
        statuses=_STATUSES,
        lines=(
            *(Compared(one, held=UNPLACED) for one in here),
            *(
                Compared(one, own.stroke[1] - own.stroke[0])
                for one, (_, own) in zip(slope, sloped, strict=True)
            ),
        ),
    )
