"""The estimator against a response: it sees the temperatures, the displacement is the judge.

Two sorts of figure come out. `validate` gives the errors of the whole estimator and of its linear
part alone. `block_errors` puts true signals in place of estimated ones, block by block, so that the
difference between two rows is the error of what was replaced.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from artefacts.errors import InputError, unknown_name
from calibrate.model import Model
from calibrate.steps import step_level
from estimator import blocks
from estimator.fchs import Estimate, Estimator, run, start

if TYPE_CHECKING:
    import xarray as xr

#: Period above which the noise is filtered out, s: it has no offset and no drift.
NOISE_PERIOD_S = 60.0
_MICRO = 1e6


@dataclass(frozen=True)
class Readings:
    """All that the estimator may know of a structure.

    Attributes
    ----------
    times : ndarray, shape (k,)
        s.
    delta_T : ndarray, shape (k,)
        T_a - T_b, K.
    temperatures : ndarray, shape (k, n)
        T1, T2, ... above the current ambient, K.
    """

    times: np.ndarray
    delta_T: np.ndarray
    temperatures: np.ndarray


def sensor_noise(
    times: np.ndarray, peak_to_peak: float = 0.12, seed: int = 0, channels: int = 1
) -> np.ndarray:
    """Return noise like a thermistor's after a high-pass filter, each channel independent.

    White Gaussian noise, second-order Butterworth high-pass with a period of `NOISE_PERIOD_S`
    applied forwards and backwards, scaled to `peak_to_peak` (K) over the run.

    Parameters
    ----------
    times : ndarray, shape (k,)
        s; the filter takes their mean interval.
    peak_to_peak : float
        Largest minus smallest value of each channel, K.
    seed : int
        The same seed gives the same noise.
    channels : int
        Number of channels.

    Returns
    -------
    ndarray, shape (k, channels)
        K.

    Raises
    ------
    InputError
        There are too few samples for the filter, or they are too far apart.
    """
    # Here, not above: a stream of samples needs no filter.
    from scipy.signal import butter, sosfiltfilt

    interval = float(times[-1] - times[0]) / (len(times) - 1)
    white = np.random.default_rng(seed).standard_normal((len(times), channels))
    edge = 2.0 * interval / NOISE_PERIOD_S
    if not 0.0 < edge < 1.0 or len(times) < 16:
        raise InputError(
            f"sensor noise: {len(times)} samples {interval:g} s apart; the filter needs 16 or more "
            f"that are closer than {NOISE_PERIOD_S / 2.0:g} s"
        )
    noise = sosfiltfilt(butter(2, edge, "highpass", output="sos"), white, axis=0)
    return np.asarray(noise * (peak_to_peak / np.ptp(noise, axis=0)))


def readings(
    response: xr.Dataset,
    model: Model,
    roles: Mapping[str, str] | None = None,
    noise: Mapping[str, np.ndarray] | None = None,
) -> Readings:
    """Return the temperatures the estimator needs, and nothing else of the response.

    Parameters
    ----------
    response : xarray.Dataset
        As `artefacts.response` says. Its temperatures are above the initial ambient: ``ambient``,
        if it is there, is subtracted from those at the joint.
    model : Model
        Its direct models name the roles of the sensors at the joint.
    roles : mapping, optional
        Role ("a", "b", "T1", ...) to the name of the probe; by default the same.
    noise : mapping, optional
        Role to what is added to its temperature, K, shape (k,).

    Raises
    ------
    InputError
        A probe is missing, or noise is given for a role that does not exist.
    """
    wanted = ("a", "b", *model.linear.direct)
    names = dict(roles or {})
    added = dict(noise or {})
    for role in (*names, *added):
        if role not in wanted:
            raise unknown_name("sensor role", role, wanted, "validation")
    known = [str(name) for name in response["probe"].to_numpy()]
    signals = {}
    for role in wanted:
        name = names.get(role, role)
        if name not in known:
            raise unknown_name("probe", name, known, f"response, role {role}")
        temperature = response["temperature"].isel(probe=known.index(name)).to_numpy()
        signals[role] = temperature + added.get(role, 0.0)
    joint = np.stack([signals[role] for role in model.linear.direct], axis=1)
    if "ambient" in response:
        joint = joint - response["ambient"].to_numpy()[:, None]
    return Readings(response["time"].to_numpy(), signals["a"] - signals["b"], joint)


def superposed(reference: xr.Dataset, response: xr.Dataset, variable: str) -> np.ndarray:
    """Return what a structure proportional to `reference` would do under the heat of `response`.

    Duhamel's sum over the changes of the heat input, each value of which holds over the interval
    that ends at its sample. The reference is the response to one step at time 0.

    Parameters
    ----------
    reference, response : xarray.Dataset
        Responses; the reference is at least as long.
    variable : str
        "temperature" or "displacement".

    Returns
    -------
    ndarray, shape of the variable in `response`

    Raises
    ------
    InputError
        The reference is not one step, is too short, or has other probes or axes.
    """
    level = step_level(reference, "reference response")
    times, lag = response["time"].to_numpy(), reference["time"].to_numpy()
    if times[-1] > lag[-1] * (1.0 + 1e-9):
        raise InputError("reference response: shorter than the response; simulate it for longer")
    label = response[variable].dims[1]
    if list(reference[label].to_numpy()) != list(response[label].to_numpy()):
        raise InputError(f"reference response: other {label} names than the response")
    unit = reference[variable].to_numpy() / level
    if lag[0] > 0.0:
        lag, unit = np.append(0.0, lag), np.concatenate((np.zeros((1, unit.shape[1])), unit))
    heat = held_heat(response)
    onsets = np.append(0.0, times[:-1])
    changes = np.diff(heat, prepend=0.0)
    elapsed = np.maximum(np.subtract.outer(times, onsets), 0.0)
    return np.stack([np.interp(elapsed, lag, column) @ changes for column in unit.T], axis=1)


def held_heat(response: xr.Dataset) -> np.ndarray:
    """Return the heat input over the interval that ends at each sample, from rest at time 0.

    Raises
    ------
    InputError
        Time starts before 0.
    """
    times, heat = response["time"].to_numpy(), response["heat_input"].to_numpy().astype(float)
    if times[0] < 0.0:
        raise InputError(f"response: time starts at {times[0]:g} s; it must start at rest, at 0")
    # Nothing has gone in by time 0, whatever the history's value there.
    return np.where(times > 0.0, heat, 0.0)


def validate(
    case: str,
    response: xr.Dataset,
    model: Model,
    *,
    reference: xr.Dataset | None = None,
    roles: Mapping[str, str] | None = None,
    noise: Mapping[str, np.ndarray] | None = None,
) -> tuple[list[dict[str, str | float]], Estimate]:
    """Run the estimator on the temperatures of `response` and judge it by the displacement.

    Parameters
    ----------
    case : str
        Name for the rows.
    response, model, roles, noise
        As in `readings`.
    reference : xarray.Dataset, optional
        Response to the reference step. With it the actual δ_NL is the displacement less the
        superposed reference; without it, less the estimated δ_L.

    Returns
    -------
    rows : list of dict
        For each estimator ("linear": δ_L alone; "fchs": δ) and axis: case, estimator, axis,
        max_abs_error_um, rms_error_um, peak_total_um, peak_nonlinear_um.
    estimate : Estimate
        The whole run, axes in the order of the model.
    """
    seen = readings(response, model, roles, noise)
    estimator = _estimator(model, seen.times)
    estimate, _ = run(estimator, seen.times, seen.delta_T, seen.temperatures)
    actual = _displacement(response, estimator.axes)
    linear = estimate.linear
    if reference is not None:
        order = _axis_order(response, estimator.axes)
        linear = superposed(reference, response, "displacement")[:, order]
    rows: list[dict[str, str | float]] = []
    for name, claimed in (("linear", estimate.linear), ("fchs", estimate.total)):
        for k, axis in enumerate(estimator.axes):
            error = (claimed - actual)[:, k] * _MICRO
            rows.append(
                {
                    "case": case,
                    "estimator": name,
                    "axis": axis,
                    "max_abs_error_um": float(np.abs(error).max()),
                    "rms_error_um": float(np.sqrt(np.mean(error**2))),
                    "peak_total_um": float(np.abs(actual[:, k]).max() * _MICRO),
                    "peak_nonlinear_um": float(np.abs(actual - linear)[:, k].max() * _MICRO),
                }
            )
    return rows, estimate


def block_errors(
    case: str,
    response: xr.Dataset,
    model: Model,
    reference: xr.Dataset,
    *,
    roles: Mapping[str, str] | None = None,
    noise: Mapping[str, np.ndarray] | None = None,
) -> list[dict[str, str | float]]:
    """Return the largest errors with true signals in place of estimated ones.

    Rows, by ``driven_by``: "temperatures" (the estimator as it is), "true heat" (Q for Q̂ in blocks
    2 and 3), "true deviations" (∂T from the superposed reference for blocks 4 to 7), "both".
    Errors are against the superposed reference (linear), the displacement less it (nonlinear) and
    the displacement (total). With "both", what is left of the linear error is Eq. 8's, and of the
    nonlinear error that of the source model and Eq. 18.

    Parameters
    ----------
    case, response, model, reference, roles, noise
        As in `validate`; the noise stays on the temperatures wherever they are used.

    Returns
    -------
    list of dict
        case, driven_by, axis, linear_error_um, nonlinear_error_um, total_error_um.
    """
    seen = readings(response, model, roles, noise)
    estimator = _estimator(model, seen.times)
    times, heat = seen.times, held_heat(response)
    order = _axis_order(response, estimator.axes)
    actual = _displacement(response, estimator.axes)
    linear = superposed(reference, response, "displacement")[:, order]
    known = [str(name) for name in response["probe"].to_numpy()]
    probes = [known.index((roles or {}).get(role, role)) for role in model.linear.direct]
    on_linear = superposed(reference, response, "temperature")[:, probes]

    estimated_heat = blocks.heat_part(estimator, times, seen.delta_T)
    true_deviation = seen.temperatures - on_linear
    rows: list[dict[str, str | float]] = []
    for driven_by, q, given in (
        ("temperatures", estimated_heat, None),
        ("true heat", heat, None),
        ("true deviations", estimated_heat, true_deviation),
        ("both", heat, true_deviation),
    ):
        deviation = given
        if deviation is None:
            deviation = blocks.deviations(estimator, times, q, seen.temperatures)
        part_linear = blocks.linear_part(estimator, times, q)
        part_nonlinear = blocks.nonlinear_part(estimator, times, deviation)
        for k, axis in enumerate(estimator.axes):
            errors = {
                "linear_error_um": part_linear - linear,
                "nonlinear_error_um": part_nonlinear - (actual - linear),
                "total_error_um": part_linear + part_nonlinear - actual,
            }
            worst = {name: float(np.abs(e[:, k]).max() * _MICRO) for name, e in errors.items()}
            rows.append({"case": case, "driven_by": driven_by, "axis": axis} | worst)
    return rows


def _estimator(model: Model, times: np.ndarray) -> Estimator:
    """Return the estimator for samples at `times`, by their shortest interval."""
    return start(model, float(np.diff(times).min()), float(times[-1] - times[0]))


def _axis_order(response: xr.Dataset, axes: Sequence[str]) -> list[int]:
    known = [str(name) for name in response["axis"].to_numpy()]
    for axis in axes:
        if axis not in known:
            raise unknown_name("axis", axis, known, "response")
    return [known.index(axis) for axis in axes]


def _displacement(response: xr.Dataset, axes: Sequence[str]) -> np.ndarray:
    """Return the displacement, m, shape (k, axes)."""
    return np.asarray(response["displacement"].to_numpy()[:, _axis_order(response, axes)])
