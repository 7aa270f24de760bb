"""Calibration of the linear models from the reference response (Table 1).

- Heat input to ΔT = T_a - T_b: Eq. 2 (K linear; a, alpha and r searched; r0 given).
- Heat input to displacement: Eq. 8 for each axis (C, D, E linear; c, d, e searched).
- Heat input to T1 and T2, far from the source: a relaxation spectrum with fixed rates and linear
  amplitudes. The errors of Eq. 2, with its four parameters, are larger than the joint's effect that
  is determined by subtraction, so the Eq. 2 fit is only reported for comparison.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from calibrate.fit_result import Fit
from calibrate.least_squares import Separable, fit, solve_linear
from thermojoint.artefacts import steps
from thermojoint.artefacts.errors import InputError
from thermojoint.artefacts.response import axes_of
from thermojoint.models import deformation, ring_source
from thermojoint.models.parameters import DeformationModel, LinearModel, Relaxation, RingModel
from thermojoint.models.regularisation import choose_regularisation
from thermojoint.models.relaxation import relaxation_response
from thermojoint.models.sensors import JOINT_SENSORS

if TYPE_CHECKING:
    import xarray as xr

#: Radius of the ring that represents the main source, m, chosen rather than fitted (Attia & Fraser,
#: section 5.3.1).
RING_RADIUS = 0.12
#: Slowest rate of a fitted term, per length of the calibration run: two fifths of its change lie
#: within the run.
SLOWEST = 0.5
#: The slowest rate of a term t exp(-rate t): it peaks in the first half of the run.
FADING = 2.0
#: Error of Eq. 8, relative to the displacement, above which a fourth rate is needed.
INADEQUATE = 3e-3
#: Rates of the relaxation spectrum, evenly spaced in their logarithm between the `rate_bounds`.
RELAXATION_RATES = 24
#: As in `least_squares`; it keeps neighbouring amplitudes of the spectrum from cancelling.
RIDGE = 2e-5
#: Name of the response in error messages.
WHERE = "reference response"


@dataclass(frozen=True)
class LinearCalibration:
    """Table 1 and the quality of its fits."""

    #: The calibrated models.
    model: LinearModel
    #: "thermal", "deformation.x" ... and, for comparison only, the Eq. 2 fits "direct.T1" ...
    fits: dict[str, Fit]
    #: Sensor role to the largest error of its relaxation spectrum, K per unit heat input.
    direct_errors: dict[str, float]


def rate_bounds(t: np.ndarray) -> tuple[float, float]:
    """Return the slowest and fastest rate, 1/s, identifiable from samples at `t` (s).

    `SLOWEST` over the run's length, and one per two of its median intervals. A slower term is a
    straight line over the run: its amplitude depends on the last digits of the data, cancels that
    of another, and becomes visible in longer runs.
    """
    return SLOWEST / float(t[-1]), 0.5 / float(np.median(np.diff(t)))


def deformation_bounds(t: np.ndarray, count: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the bounds of the `count` rates c, d, e [, f] of Eq. 8 or 18, 1/s.

    As `rate_bounds`, but a term t exp(-e t) must decay within the run: e is at least `FADING` over
    the run's length. Otherwise the term represents continuing warm-up at the end of the run, and
    returns the displacement to zero afterwards.
    """
    slowest, fastest = rate_bounds(t)
    return (slowest, slowest, *(FADING / float(t[-1]),) * (count - 2)), (fastest,) * count


def ring_bounds(t: np.ndarray, length: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the bounds of a (1/m2) and alpha (m2/s) of Eq. 2, lower and upper.

    a length2 is between 1e-5 and 1, and heat diffuses over `length` (m) in a time between the
    median interval of `t` (s) and two runs: a slower response would hardly begin within the run.
    """
    area = length**2
    slowest, fastest = 0.5 * area / float(t[-1]), area / float(np.median(np.diff(t)))
    return (1e-5 / area, slowest), (1.0 / area, fastest)


def ring_problem(t: np.ndarray, data: np.ndarray, r0: float) -> Separable:
    """Return the fit of Eq. 2 to one series: K linear, a, alpha and r searched.

    r lies outside the ring, as in the paper, from 1.01 r0 to 30 r0: at r = r0 the response would
    have no delay and its derivative by r jumps. The other bounds are relative to r0 and to the
    times (`ring_bounds`), so the unit of length does not matter, and r0 may be any length.
    """
    lower, upper = ring_bounds(t, r0)

    def basis(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, alpha, r = theta
        column, gradient = ring_source.step_response_gradient(t, 1.0, a, alpha, r, r0)
        return column[:, None], gradient[:, 1:] * theta

    return Separable(
        basis=basis,
        data=data[:, None],
        names=("a", "alpha", "r"),
        linear_names=("K",),
        lower=(*lower, 1.01 * r0),
        upper=(*upper, 30.0 * r0),
        unit="K",
        column_of=(0, 0, 0),
    )


def fit_ring(
    t: np.ndarray, data: np.ndarray, *, starts: int = 16, polished: int = 3
) -> tuple[RingModel, Fit]:
    """Return Eq. 2, with a ring of `RING_RADIUS`, fitted to a step response of temperature.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the step, s.
    data : ndarray, shape (n,)
        Temperature, K per unit heat input.
    starts, polished : int
        Of the search (`least_squares.fit`).
    """
    thin = steps.thinned(t.size)
    best = fit(
        ring_problem(t, data, RING_RADIUS),
        coarse=ring_problem(t[thin], data[thin], RING_RADIUS),
        starts=starts,
        polished=polished,
    )
    value = best.values
    return RingModel(value["K"], value["a"], value["alpha"], value["r"], RING_RADIUS), best


def fit_deformation(t: np.ndarray, data: np.ndarray) -> tuple[DeformationModel, Fit]:
    """Return Eq. 8, as printed, fitted to a step response of displacement.

    Its three rates describe minutes or hours, not both: where the error exceeds `INADEQUATE` of the
    displacement, the four rates of Eq. 18 are fitted.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times after the step, s.
    data : ndarray, shape (n,)
        Displacement, m per unit heat input.
    """
    coefficients, rates, best = _best_deformation(t, data, ("CDE", "cde"))
    if best.max_abs_error > INADEQUATE * np.abs(data).max():
        coefficients, rates, best = _best_deformation(t, data, ("CDEF", "cdef"))
    return deformation.model_from(coefficients, rates), best


def _best_deformation(
    t: np.ndarray, data: np.ndarray, names: tuple[str, str]
) -> tuple[list[float], list[float], Fit]:
    """Return coefficients, rates and the fit of Eq. 8 or 18, with these names of parameters."""
    linear_names, rates = map(tuple, names)
    lower, upper = deformation_bounds(t, len(rates))

    def problem(at: np.ndarray, values: np.ndarray) -> Separable:
        return Separable(
            basis=lambda theta: deformation.basis(at, theta),
            data=values[:, None],
            names=rates,
            linear_names=linear_names,
            lower=lower,
            upper=upper,
            unit="m",
            column_of=tuple(range(len(rates))),
            alike=((0, 1), (3, 2))[: len(rates) - 2],
        )

    thin = steps.thinned(t.size)
    best = fit(problem(t, data), coarse=problem(t[thin], data[thin]))
    value = best.values
    return [value[name] for name in linear_names], [value[name] for name in rates], best


def fit_relaxation(t: np.ndarray, data: np.ndarray) -> Relaxation:
    """Return the relaxation spectrum of a step response: rates fixed, amplitudes least squares.

    `t`, `data`: as in `fit_ring`.
    """
    rates = np.geomspace(*rate_bounds(t), RELAXATION_RATES)
    columns = -np.expm1(-np.multiply.outer(t, rates))
    amplitudes = solve_linear(columns, data[:, None], RIDGE)[:, 0]
    return Relaxation(tuple(map(float, amplitudes)), tuple(map(float, rates)))


def calibrate_displacements(response: xr.Dataset) -> dict[str, tuple[DeformationModel, Fit]]:
    """Return Eq. 8 of every axis of the reference response.

    Parameters
    ----------
    response : xarray.Dataset
        Step response (`thermojoint.artefacts.response`). Its level need not be 1; everything is
        divided by it.

    Raises
    ------
    InputError
        The response is not to a step.
    """
    level = steps.step_level(response, WHERE)
    t = steps.times(response)
    return {
        axis: fit_deformation(t, steps.displacement(response, axis, WHERE) / level)
        for axis in axes_of(response)
    }


def calibrate_heat(
    response: xr.Dataset, displacements: Mapping[str, tuple[DeformationModel, Fit]]
) -> LinearCalibration:
    """Return the part of Table 1 that does not depend on the positions of T1 and T2.

    Parameters
    ----------
    response : xarray.Dataset
        As in `calibrate_displacements`, with the probes a and b.
    displacements : mapping
        Of the same response (`calibrate_displacements`).

    Raises
    ------
    InputError
        A probe is missing, or a and b have the same temperature.
    ConvergenceError
        The thermal model has no stable inverse.
    """
    level = steps.step_level(response, WHERE)
    t = steps.times(response)
    difference = (
        steps.temperature(response, "a", WHERE) - steps.temperature(response, "b", WHERE)
    ) / level
    if not bool(difference.any()):
        raise InputError(f"{WHERE}: T_a - T_b is zero throughout; place a nearer to the source")
    thermal, thermal_fit = fit_ring(t, difference)
    interval = float(np.median(np.diff(t)))
    shapes = {axis: shape for axis, (shape, _) in displacements.items()}
    fits = {"thermal": thermal_fit}
    fits |= {f"deformation.{axis}": fit for axis, (_, fit) in displacements.items()}
    model = LinearModel(thermal, choose_regularisation(thermal, interval), shapes, {})
    return LinearCalibration(model, fits, {})


def with_direct_models(
    linear: LinearCalibration, response: xr.Dataset, sensors: Sequence[str] = JOINT_SENSORS
) -> LinearCalibration:
    """Return Table 1 with the models of the sensors at the joint added.

    Parameters
    ----------
    linear : LinearCalibration
        From `calibrate_heat`.
    response : xarray.Dataset
        As in `calibrate_displacements`, with the probes `sensors`.
    sensors : sequence of str
        T1, T2 ...

    Raises
    ------
    InputError
        A probe is missing.
    """
    level = steps.step_level(response, WHERE)
    t = steps.times(response)
    direct: dict[str, RingModel | Relaxation] = {}
    direct_errors = {}
    fits = dict(linear.fits)
    for sensor in sensors:
        data = steps.temperature(response, sensor, WHERE) / level
        spectrum = fit_relaxation(t, data)
        direct[sensor] = spectrum
        direct_errors[sensor] = float(np.abs(relaxation_response(t, spectrum) - data).max())
        _, fits[f"direct.{sensor}"] = fit_ring(t, data)
    return LinearCalibration(replace(linear.model, direct=direct), fits, direct_errors)
