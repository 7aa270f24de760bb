"""Calibration of the fictitious contact heat sources from further steps (Tables 2 and 3).

The part of a response at heat input Q̄ that is not proportional to the reference is attributed to
fictitious sources on the joint, switched on as steps together with the main one (Attia & Fraser,
section 5.3.2). `source_thermal` fits their rates and products to the temperature deviations. Only
products are observable, so every strength is set to 1 at one heat input; gains and the other
strengths follow. `source_deformation` fits the displacement caused by the sources.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from calibrate import source_thermal
from calibrate.fit_result import Fit
from calibrate.source_deformation import fit_source_deformation, source_displacements
from calibrate.source_thermal import SourceFit
from thermojoint.artefacts import steps
from thermojoint.artefacts.errors import InputError, unknown_name
from thermojoint.artefacts.response import axes_of
from thermojoint.models.parameters import DeformationModel, FictitiousSource, RingModel
from thermojoint.models.regularisation import choose_regularisation
from thermojoint.models.sensors import JOINT_SENSORS

if TYPE_CHECKING:
    import xarray as xr

#: Name of the responses in error messages.
WHERE = "calibration responses"


@dataclass(frozen=True)
class Deviations:
    """Deviations of step responses from proportionality to the reference."""

    #: Heat inputs, ascending.
    inputs: tuple[float, ...]
    #: Shape (n,): times after the step, s.
    t: np.ndarray
    #: Shape (inputs, sensors, n): ∂T_j, K; sensors T1, T2 ...
    temperatures: np.ndarray
    #: Axis name to δ_NL, m, shape (inputs, n).
    displacements: dict[str, np.ndarray]


@dataclass(frozen=True)
class FictitiousCalibration:
    """Tables 2 and 3 and the quality of their fits."""

    #: From the joint fit.
    sources: tuple[FictitiousSource, ...]
    #: The fitted data.
    deviations: Deviations
    #: Rates and products shared by all inputs.
    joint: SourceFit
    #: Condition number of the matrix of strengths (rows scaled to unit length): large if all inputs
    #: drive the sources in nearly the same proportion, so that the displacement cannot be
    #: attributed to either.
    strength_condition: float
    #: Axis name to the fit of Eq. 18.
    deformation_fits: dict[str, Fit]
    #: Axis name to {heat input as text: largest error, m}.
    deformation_errors: dict[str, dict[str, float]]


def check_steps(reference: xr.Dataset, others: Mapping[float, xr.Dataset]) -> float:
    """Return the level of the reference step; refuse steps that are inconsistent with it.

    Parameters
    ----------
    reference : xarray.Dataset
        Step response at the reference input.
    others : mapping
        Heat input to the step response at it, sampled at the same times.

    Raises
    ------
    InputError
        A response is not to a step, its level is not the one given or is the reference's, or its
        times or axes differ from the reference's.
    """
    base = steps.step_level(reference, f"{WHERE}, reference")
    t = steps.times(reference)
    axes = axes_of(reference)
    for named, response in sorted(others.items()):
        name = f"{WHERE}, input {named:g}"
        level = steps.step_level(response, name)
        if abs(level - named) > 1e-9 * abs(named):
            raise InputError(f"{name}: its heat input is {level:g}; name it by its heat input")
        if abs(level - base) < 1e-9 * abs(base):
            raise InputError(f"{name}: this is the reference input; give another step")
        at = steps.times(response)
        if at.shape != t.shape or not bool(np.allclose(at, t, rtol=0.0, atol=1e-6)):
            raise InputError(
                f"{name}: sample times differ from the reference's; sample both at the same times"
            )
        known = axes_of(response)
        for axis in axes:
            if axis not in known:
                raise unknown_name("axis", axis, known, name)
    return base


def deviations_from(
    reference: xr.Dataset,
    others: Mapping[float, xr.Dataset],
    sensors: Sequence[str] = JOINT_SENSORS,
) -> Deviations:
    """Return ∂T_j = T_j - Q̄ T_j(1) and δ_NL = δ - Q̄ δ(1) of further steps.

    Parameters
    ----------
    reference, others
        As in `check_steps`, which checks them; the reference is divided by its level.
    sensors : sequence of str
        T1, T2 ...
    """
    base = check_steps(reference, others)
    t = steps.times(reference)
    axes = axes_of(reference)
    inputs = tuple(sorted(float(level) for level in others))
    temperatures = np.empty((len(inputs), len(sensors), t.size))
    displacements = {axis: np.empty((len(inputs), t.size)) for axis in axes}
    for index, level in enumerate(inputs):
        name, response = f"{WHERE}, input {level:g}", others[level]
        factor = level / base
        for j, sensor in enumerate(sensors):
            temperatures[index, j] = steps.temperature(
                response, sensor, name
            ) - factor * steps.temperature(reference, sensor, WHERE)
        for axis in axes:
            displacements[axis][index] = steps.displacement(
                response, axis, name
            ) - factor * steps.displacement(reference, axis, WHERE)
    return Deviations(inputs, t, temperatures, displacements)


def gains_and_strengths(products: np.ndarray, reference: int) -> tuple[np.ndarray, np.ndarray]:
    """Return K_i and q_i: the products with q_i = 1 at the input number `reference`.

    Parameters
    ----------
    products : ndarray, shape (sources, inputs)
        P_i = K_i q_i, K.
    reference : int
        Index of the input at which every source has strength 1.

    Returns
    -------
    gains : ndarray, shape (sources,)
        K_i, K; negative where the source is a sink at the reference.
    strengths : ndarray, shape (sources, inputs)
        q_i, dimensionless.

    Raises
    ------
    InputError
        A source has no strength at the reference.
    """
    gains = products[:, reference].copy()
    silent = np.abs(gains) <= 1e-9 * np.abs(products).max(axis=1)
    if bool(silent.any()):
        raise InputError(
            f"fictitious source {int(np.argmax(silent)) + 1} is silent at the reference input; "
            "choose another reference input or other source positions"
        )
    return gains, products / gains[:, None]


def strength_condition(strengths: np.ndarray) -> float:
    """Return the condition number of the strengths, each source's row scaled to unit length."""
    length = np.linalg.norm(strengths, axis=1, keepdims=True)
    return float(np.linalg.cond(strengths / length))


def calibrate_fictitious(
    reference: xr.Dataset,
    others: Mapping[float, xr.Dataset],
    distances: Sequence[Sequence[float]],
    sensors: Sequence[str] = JOINT_SENSORS,
) -> FictitiousCalibration:
    """Return Tables 2 and 3 from step responses at the reference and at other heat inputs.

    Parameters
    ----------
    reference : xarray.Dataset
        Step response at the reference input, with the probes `sensors`.
    others : mapping
        Heat input (e.g. 0.5 and 2.0) to the step response at it.
    distances : sequence of sequences
        r_ij, m, from source i to sensor T_j; source i belongs to sensor T_i.
    sensors : sequence of str
        T1, T2 ..., one for each source.

    Raises
    ------
    InputError
        See `check_steps`, `source_thermal.fit_jointly` and `gains_and_strengths`.
    ConvergenceError
        A source has no stable inverse at its sensor.
    """
    geometry = source_thermal.make_geometry(distances)
    if geometry.distances.shape != (len(sensors),) * 2:
        raise InputError(
            f"fictitious sources: distances of shape {geometry.distances.shape} for {len(sensors)} "
            "sensors; every source needs its own sensor"
        )
    data = deviations_from(reference, others, sensors)
    joint = source_thermal.fit_jointly(data.t, data.temperatures, data.inputs, geometry)
    # Inputs ascend: every strength is 1 at the largest.
    gains, strengths = gains_and_strengths(joint.products, -1)
    fits: dict[str, Fit] = {}
    errors: dict[str, dict[str, float]] = {}
    shapes: dict[str, tuple[DeformationModel, ...]] = {}
    for axis, target in data.displacements.items():
        shapes[axis], fits[axis] = fit_source_deformation(data.t, target, strengths)
        left = target - source_displacements(data.t, shapes[axis], strengths)
        worst = np.abs(left).max(axis=1)
        errors[axis] = {
            str(level): float(error) for level, error in zip(data.inputs, worst, strict=True)
        }
    interval = float(np.median(np.diff(data.t)))
    sources = []
    for i, (gain, radius) in enumerate(zip(gains, geometry.radii, strict=True)):
        near = float(geometry.distances[i, i])
        ring = RingModel(float(gain), float(joint.a[i]), float(joint.alpha[i]), near, float(radius))
        sources.append(
            FictitiousSource(
                K=ring.K,
                a=ring.a,
                alpha=ring.alpha,
                r0=ring.r0,
                strengths={
                    level: float(q) for level, q in zip(data.inputs, strengths[i], strict=True)
                },
                regularisation=choose_regularisation(ring, interval),
                deformation={axis: models[i] for axis, models in shapes.items()},
            )
        )
    return FictitiousCalibration(
        sources=tuple(sources),
        deviations=data,
        joint=joint,
        strength_condition=strength_condition(strengths),
        deformation_fits=fits,
        deformation_errors=errors,
    )
