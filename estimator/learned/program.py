"""Export of a learned model: weighted relaxations of the inputs.

As `estimator.learned.estimator` without displacement readings: zero and weights are the learned
ones, and so is the band. With x = dt/τ a relaxation of the straight line from u0 to u1 changes by

    y1 - y0 = g (u0 - y0) + h (u1 - u0),   g = 1 - exp(-x),   h = 1 - g/x.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.export.program import Contents, Interface, Operations, Variable, distinct, listed
from estimator.export.recorded import duty_cycle
from estimator.interface import Status
from estimator.learned.estimator import Learned
from estimator.span import SLACK, with_slack
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.quantities import column_named
from thermojoint.models.learned import LARGEST, LearnedModel

#: Terms of the series of h, which is accurate for x below 1.
TERMS = 18
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
    if model.positions:
        raise InputError(
            "export: a model with slopes along an axis; export one of a single position"
        )
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
    usual = Operations(
        axes * (2 + 2 * count + count * (count + 1)) + 3 * count + 4 * slow,
        axes * (3 + 2 * count + count * (count + 1)) + count + 13 * slow + 2 * columns + 3,
        count + columns,
        powers + axes,
    )
    ranges = [model.spans[name] for name in model.columns]
    sensors = [name in model.sensors for name in model.columns]
    weights = np.array([channel.weights for channel in model.channels])
    return Contents(
        # The program does not know the log's clock: it starts a new run.
        replace(estimator, model=replace(model, log_end=None)),
        _interface(estimator, interval),
        values={
            "features": features,
            "gains": gains(model.taus, interval),
            "zeros": [channel.zero for channel in model.channels],
            "weights": weights,
            "spreads": np.array([channel.covariance for channel in model.channels]),
            "unexplained": [
                (1.0 + own.drift_size**2) * channel.drift**2 for channel in model.channels
            ],
            "widths": [own.within * channel.widening for channel in model.channels],
            "reaches": [own.reached(channel.span) for channel in model.channels],
            "possible": model.possible,
            "limits": [with_slack(limits) for limits in ranges],
            "middles": [0.5 * (low + high) for low, high in ranges],
            "spans": ranges,
            "thermometers": [
                k for k, (low, high) in enumerate(ranges) if high > low and sensors[k]
            ],
            "signal_ranges": model.signal_ranges,
            "most_unknown": np.outer(
                np.abs(weights) @ model.signal_ranges, (own.unsettled, own.lost)
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
        constants=8 * count + axes * (count + count**2 + 7) + 7 * columns,
        state=columns + 5 * count + 3,
        usual=usual,
        worst=usual
        + Operations(TERMS + 2, TERMS + 2, TERMS + 2, 1).times(slow)
        + Operations(count, 2 * count, 1, 1),
        labels=("a sample at the nominal interval", "at any other interval, at most"),
        duty=lambda: duty_cycle(ranges, interval).tolist(),
    )


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
    inputs = distinct([_base(name) for name in model.columns], "columns")
    axes = distinct([_base(name) for name in estimator.axes], "displacements")
    units = [channel.unit for channel in estimator.channels]
    return Interface(
        kind="learned",
        fingerprint=model.digest,
        interval=interval,
        timed=True,
        inputs=tuple(Variable(*variable, "") for variable in zip(inputs, units, strict=False)),
        outputs=(*listed("displacement", "m", axes), *listed("band", "m", axes)),
        axes=axes,
        statuses=_STATUSES,
    )


def _base(name: str) -> str:
    """The name without its unit: the program uses SI."""
    column = column_named(name)
    return column.base if column else name
