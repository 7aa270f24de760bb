"""Calibration of the baselines from the responses of the generalised models.

Multiple linear regression is plain least squares. For ridge and ARX every temperature has the
uncertainty of the placement rule, as in the fit of Eq. 18: their penalty stands for errors of that
size and is not tuned to the validation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter

from calibrate.chain import Calibrated
from calibrate.linear import SLOWEST
from calibrate.placement.fchs import RULE, with_roles
from calibrate.ridge import linear_weights, ridge_weights
from thermojoint.artefacts import steps
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.response import axes_of, columns_of
from thermojoint.artefacts.units import MEGA
from thermojoint.models.baselines import Autoregression, Baselines, Regression, taus_of
from thermojoint.models.filters.relaxations import relax_all
from thermojoint.models.parameters import Span
from thermojoint.models.sensors import ROLES, rises

if TYPE_CHECKING:
    import xarray as xr

#: Low-passes of the ridge regression, per length of the run.
TIME_CONSTANTS = (0.03, 0.1, 0.3, 1.0)
#: Past displacements of an autoregression; it uses the last two temperatures.
PAST = 2


def fit_baselines(responses: Sequence[xr.Dataset]) -> Baselines:
    """Return the baselines of a structure.

    Parameters
    ----------
    responses : sequence of xarray.Dataset
        From rest, evenly sampled at one interval, with probes a, b, T1 and T2.

    Raises
    ------
    InputError
        A probe is missing or the samples are uneven.
    """
    axes = tuple(axes_of(responses[0]))
    times = [steps.times(response) for response in responses]
    interval = steps.even_interval(times[0], "baselines")
    length = max(float(time[-1]) for time in times)
    runs = [response.isel(time=at > 0.0) for response, at in zip(responses, times, strict=True)]
    inputs = [rises(run) for run in runs]
    outputs = [MEGA * columns_of(run, "displacement", axes) for run in runs]
    constants = tuple(length * share for share in TIME_CONSTANTS)
    plain = np.concatenate(inputs)
    filtered = np.concatenate(
        [
            _relaxed(steps.times(run), temperatures, constants, interval)
            for run, temperatures in zip(runs, inputs, strict=True)
        ]
    )
    target = np.concatenate(outputs)
    seen = np.concatenate((plain, np.zeros((1, len(ROLES)))))
    levels = [0.0, *(float(level) for run in runs for level in run["heat_input"].to_numpy())]
    return Baselines(
        mlr=Regression((), _by_axis(axes, linear_weights(plain, target))),
        ridge=Regression(constants, _by_axis(axes, _ridge(filtered, target))),
        arx={
            axis: fit_autoregression(
                inputs, [output[:, k] / MEGA for output in outputs], interval, SLOWEST / length
            )
            for k, axis in enumerate(axes)
        },
        interval_s=interval,
        span=Span(
            length,
            (min(levels), max(levels)),
            {
                role: (float(column.min()), float(column.max()))
                for role, column in zip(ROLES, seen.T, strict=True)
            },
        ),
    )


def baselines_of(calibrated: Calibrated, responses: Sequence[xr.Dataset]) -> Baselines:
    """Return the baselines of calibration responses, with the sensors and axes of the model."""
    roles = {} if calibrated.placement is None else calibrated.placement.roles
    axes = list(calibrated.model.linear.deformation)
    return fit_baselines([with_roles(response, roles).sel(axis=axes) for response in responses])


def fit_autoregression(
    inputs: Sequence[Array], outputs: Sequence[Array], interval: float, slowest: float
) -> Autoregression:
    """Return ARX fitted to runs from rest, bounded when it runs on its own estimates.

    The poles come from one-step predictions and are then limited to the circle of the slowest rate.
    With the poles given, the free-running output is linear in the weights of the temperatures, and
    those are fitted to it.

    Parameters
    ----------
    inputs : sequence of ndarray, shape (k, channels)
        Temperatures of each run, K, from the first sample after rest.
    outputs : sequence of ndarray, shape (k,)
        Displacement of each run, m.
    interval : float
        Between samples, s.
    slowest : float
        Slowest rate, 1/s.
    """
    target = MEGA * np.concatenate(outputs)
    lagged = [
        np.column_stack([_delayed(MEGA * output, lag)[:, None] for lag in range(1, PAST + 1)])
        for output in outputs
    ]
    stacked = [np.hstack((run, _delayed(run, 1))) for run in inputs]
    table = np.hstack((np.concatenate(lagged), np.concatenate(stacked)))
    predicted = linear_weights(table, target)
    past = bounded_past(predicted[:PAST], float(np.exp(-slowest * interval)))
    denominator = np.concatenate(([1.0], -past))
    # Two features, the current temperature and its change, for b_0 and b_1.
    level = _filtered(denominator, inputs)
    change = _filtered(denominator, [run - _delayed(run, 1) for run in inputs])
    # A constant temperature error affects the level through the static gain; for the change, whose
    # static gain is zero, every sample's error counts individually.
    impulse = lfilter([1.0, -1.0], denominator, np.eye(1, max(map(len, outputs)))[0])
    scale = np.repeat([1.0 / denominator.sum(), np.linalg.norm(impulse)], level.shape[1])
    features = np.hstack((level, change)) / scale
    of_level, of_change = np.split(_ridge(features, target) / scale, 2)
    table = np.stack((of_level + of_change, -of_change)) / MEGA
    return Autoregression(tuple(map(float, past)), tuple(tuple(map(float, r)) for r in table))


def bounded_past(past: Array, radius: float) -> Array:
    """Return weights of the past whose poles lie within `radius`, each moved there radially."""
    poles = np.roots(np.concatenate(([1.0], -np.asarray(past))))
    size = np.abs(poles)
    inside = poles * (radius / np.maximum(size, radius))
    return np.asarray(-np.real(np.poly(inside))[1:])


def _filtered(denominator: Array, runs: Sequence[Array]) -> Array:
    return np.concatenate([lfilter([1.0], denominator, run, axis=0) for run in runs])


def _delayed(values: Array, lag: int) -> Array:
    """Return a run that starts at rest, `lag` samples later."""
    return np.concatenate((np.zeros((lag, *values.shape[1:])), values))[: len(values)]


def _relaxed(times: Array, inputs: Array, constants: Sequence[float], interval: float) -> Array:
    """Return temperatures of a run from rest and their low-passes, shape (k, features)."""
    taus = taus_of(constants, inputs.shape[1])
    begun = np.concatenate(([times[0] - interval], times))
    signals = np.tile(np.vstack((np.zeros(inputs.shape[1]), inputs)), 1 + len(constants))
    return relax_all(begun, signals, taus, np.zeros(len(taus)))[1:]


def _ridge(features: Array, target: Array) -> Array:
    """Return weights for features with the rms errors of the placement rule."""
    return ridge_weights(features, target, len(features) * RULE.deviation_uncertainty**2)


def _by_axis(axes: Sequence[str], weights: Array) -> dict[str, tuple[float, ...]]:
    return {axis: tuple(map(float, row / MEGA)) for axis, row in zip(axes, weights.T, strict=True)}
