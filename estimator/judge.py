"""The estimator against a response: it sees the temperatures, the displacement is the judge.

Two sorts of figure come out. `validate` gives the errors of the whole estimator and of its linear
part alone. `block_errors` puts true signals in place of estimated ones, block by block, so that the
difference between two rows is the error of what was replaced.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from artefacts.arrays import Array
from artefacts.errors import InputError, unknown_name
from artefacts.response import axes_of, columns_of, probes_of
from artefacts.steps import step_level
from estimator.baselines.starting import regressions
from estimator.fchs.stream import Signals, run
from estimator.interface import follow
from estimator.noise import joint_noise
from models import blocks
from models.assembly import Assembly, assemble
from models.baselines import Baselines
from models.parameters import Model
from models.sensors import readings, rises, roles_in

if TYPE_CHECKING:
    import xarray as xr

_MICRO = 1e6


@dataclass(frozen=True)
class Judged:
    """The estimators against one response.

    Attributes
    ----------
    rows : list of dict
        For each estimator ("none", "linear": δ_L alone, the baselines, "fchs": δ) and axis: case,
        estimator, axis, max_abs_error_um, rms_error_um, peak_total_um, peak_nonlinear_um.
    errors : dict
        Estimator to estimated less actual displacement, m, shape (k, axes).
    estimate : Signals
        The whole run of FCHS, axes in the order of the model.
    """

    rows: list[dict[str, str | float]]
    errors: dict[str, Array]
    estimate: Signals


@dataclass(frozen=True)
class Validated:
    """The estimator against responses.

    Attributes
    ----------
    rows : list of dict
        See `validate`.
    vectors : list of dict
        case, estimator, max_abs_error_um: largest length of the error in all axes together.
    as_printed : list of dict
        `rows` of the paper's own scheme, whose deformation models are calibrated to steps.
    blocks : list of dict
        See `block_errors`; empty without a reference response.
    estimates : dict
        Case to the whole run of FCHS.
    errors : dict
        Case to estimator to estimated less actual displacement, m, shape (k, axes).
    """

    rows: list[dict[str, str | float]]
    vectors: list[dict[str, str | float]]
    as_printed: list[dict[str, str | float]]
    blocks: list[dict[str, str | float]]
    estimates: dict[str, Signals]
    errors: dict[str, dict[str, Array]]

    def figures(self) -> dict[str, list[dict[str, str | float]]]:
        """All errors, ready for a JSON file."""
        return {
            "rows": self.rows,
            "vectors": self.vectors,
            "as_printed": self.as_printed,
            "blocks": self.blocks,
        }


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
    baselines: Baselines | None = None,
) -> Judged:
    """Run the estimators on the temperatures of `response` and judge it by the displacement.

    Parameters
    ----------
    case : str
        Name for the rows.
    response, model, roles, noise
        As in `readings`.
    reference : xarray.Dataset, optional
        Response to the reference step. With it the actual δ_NL is the displacement less the
        superposed reference; without it, less the estimated δ_L.
    baselines : Baselines, optional
        Regressions to judge beside the model.
    """
    seen = readings(response, tuple(model.linear.direct), roles, noise)
    assembly = _assembly(model, seen.times)
    estimate, _ = run(assembly, seen.times, seen.delta_T, seen.temperatures)
    actual = columns_of(response, "displacement", assembly.axes)
    linear = estimate.linear
    if reference is not None:
        order = [axes_of(response).index(axis) for axis in assembly.axes]
        linear = superposed(reference, response, "displacement")[:, order]
    claims = {"none": np.zeros_like(actual), "linear": estimate.linear}
    if baselines is not None:
        for axis in assembly.axes:
            if axis not in baselines.axes:
                raise unknown_name("axis", axis, baselines.axes, "baselines")
        told = np.column_stack((seen.times, rises(response, roles, noise))).tolist()
        for one in regressions(baselines, assembly.dt_s):
            order = [one.axes.index(axis) for axis in assembly.axes]
            run_of = follow(one, told, one.initial_state())
            claims[one.kind] = np.array([each.displacement[order] for _, each in run_of])
    errors = {name: claim - actual for name, claim in (claims | {"fchs": estimate.total}).items()}
    rows: list[dict[str, str | float]] = [
        {
            "case": case,
            "estimator": name,
            "axis": axis,
            "max_abs_error_um": float(np.abs(error[:, k]).max() * _MICRO),
            "rms_error_um": float(np.sqrt(np.mean((error[:, k] * _MICRO) ** 2))),
            "peak_total_um": float(np.abs(actual[:, k]).max() * _MICRO),
            "peak_nonlinear_um": float(np.abs(actual - linear)[:, k].max() * _MICRO),
        }
        for name, error in errors.items()
        for k, axis in enumerate(assembly.axes)
    ]
    return Judged(rows, errors, estimate)


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
    seen = readings(response, tuple(model.linear.direct), roles, noise)
    assembly = _assembly(model, seen.times)
    times, heat = seen.times, held_heat(response)
    actual = columns_of(response, "displacement", assembly.axes)
    order = [axes_of(response).index(axis) for axis in assembly.axes]
    linear = superposed(reference, response, "displacement")[:, order]
    known = probes_of(response)
    probes = [known.index((roles or {}).get(role, role)) for role in model.linear.direct]
    on_linear = superposed(reference, response, "temperature")[:, probes]

    estimated_heat = blocks.heat_part(assembly, times, seen.delta_T)
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
            deviation = blocks.deviations(assembly, times, q, seen.temperatures)
        part_linear = blocks.linear_part(assembly, times, q)
        part_nonlinear = blocks.nonlinear_part(assembly, times, deviation)
        for k, axis in enumerate(assembly.axes):
            errors = {
                "linear_error_um": part_linear - linear,
                "nonlinear_error_um": part_nonlinear - (actual - linear),
                "total_error_um": part_linear + part_nonlinear - actual,
            }
            worst = {name: float(np.abs(e[:, k]).max() * _MICRO) for name, e in errors.items()}
            rows.append({"case": case, "driven_by": driven_by, "axis": axis} | worst)
    return rows


def _assembly(model: Model, times: np.ndarray) -> Assembly:
    """Return the estimator for samples at `times`, by their shortest interval."""
    return assemble(model, float(np.diff(times).min()), float(times[-1] - times[0]))


@threadpool_limits.wrap(limits=1)
def validate_model(
    model: Model,
    reference: xr.Dataset | None,
    responses: Mapping[str, xr.Dataset],
    noisy: Collection[str] = (),
    baselines: Baselines | None = None,
) -> Validated:
    """Judge a model by responses, from temperatures alone.

    Parameters
    ----------
    model : Model
        What is judged.
    reference : xarray.Dataset, optional
        Response to the reference step, to tell the actual nonlinear part.
    responses : mapping
        Name to response.
    noisy : collection of str
        Names of responses to judge once more with `joint_noise`, as "NAME-noise".
    baselines : Baselines, optional
        Regressions to judge beside the model.
    """
    printed = as_printed(model)
    found = Validated([], [], [], [], {}, {})
    for name, response in responses.items():
        roles = roles_in(response, model)
        again = {f"{name}-noise": joint_noise(response)} if name in noisy else {}
        for case, noise in ({name: None} | again).items():
            judged = validate(
                case,
                response,
                model,
                reference=reference,
                roles=roles,
                noise=noise,
                baselines=baselines,
            )
            found.rows.extend(judged.rows)
            found.vectors.extend(_vector_errors(case, judged.errors))
            found.estimates[case] = judged.estimate
            found.errors[case] = judged.errors
            paper = validate(case, response, printed, reference=reference, roles=roles, noise=noise)
            found.as_printed.extend(row for row in paper.rows if row["estimator"] == "fchs")
            if reference is not None:
                found.blocks.extend(
                    block_errors(case, response, model, reference, roles=roles, noise=noise)
                )
    return found


def as_printed(model: Model) -> Model:
    """Return the paper's own scheme: Eq. 18 calibrated to steps, strengths that do not fade."""
    return replace(model, sources=tuple(replace(one, driven={}) for one in model.sources), leak=0.0)


def _vector_errors(case: str, errors: Mapping[str, Array]) -> list[dict[str, str | float]]:
    return [
        {
            "case": case,
            "estimator": name,
            "max_abs_error_um": float(np.linalg.norm(error, axis=1).max() * _MICRO),
        }
        for name, error in errors.items()
    ]
