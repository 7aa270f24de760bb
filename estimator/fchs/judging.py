"""Validation of estimators against the displacement of a response.

All estimators are judged by the same samples of the same sensors: FCHS and its linear part alone,
no compensation, regressions, observers. `estimator.fchs.block_errors` then attributes the error of
FCHS to its blocks.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from estimator.baselines.kind import regressions
from estimator.fchs.block_errors import assembled_for, block_errors
from estimator.fchs.stream import Signals, run
from estimator.interface import follow
from estimator.kind import OpenedEstimator
from estimator.noise import joint_noise, with_added
from estimator.registry import kind_of
from estimator.rows import Row, figures_of
from estimator.superposition import superposed
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.errors import unknown_name
from thermojoint.artefacts.response import axes_of, columns_of
from thermojoint.artefacts.units import MEGA
from thermojoint.models.baselines import Baselines
from thermojoint.models.parameters import Model
from thermojoint.models.sensors import HEAT_SENSORS, ROLES, readings, rises, roles_in

if TYPE_CHECKING:
    import xarray as xr

Value = TypeVar("Value")

#: Order of the estimators in all tables.
ESTIMATORS = (
    "none",
    "linear",
    "linear-steady",
    "mlr",
    "ridge",
    "arx",
    "kalman-linear",
    "fchs",
    "fchs-steady",
    "joint-aware",
)


@dataclass(frozen=True)
class Beside:
    """Estimators to be compared with a model, and the time from which samples count."""

    #: Regressions.
    baselines: Baselines | None = None
    #: The same kind of model, calibrated until the machine is steady, with the same sensors.
    steady: Model | None = None
    #: Observers with their initial states. They read the probes with the names of their sensors.
    observers: Sequence[tuple[OpenedEstimator, Array]] = ()
    #: Samples count from this time after the first one, s.
    settled_s: float = 0.0

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the estimators, all of which have the same."""
        beside = (self.baselines, *(observer for observer, _ in self.observers))
        return next((tuple(each.axes) for each in beside if each is not None), ())


#: The model alone, from the first sample.
ALONE = Beside()


@dataclass(frozen=True)
class Judged:
    """Errors of the estimators for one response."""

    #: For each estimator ("none", "linear": δ_L alone, the baselines, "fchs": δ, observers) and
    #: axis: estimator, axis, max_abs_error_um, rms_error_um, peak_total_um, peak_nonlinear_um; for
    #: observers also band_cover, mean_band_um and interval_score_um.
    rows: list[Row]
    #: estimator, max_abs_error_um: largest length of the error vector.
    vectors: list[Row]
    #: Estimator to estimated minus actual displacement, m, shape (k, axes).
    errors: dict[str, Array]
    #: The whole run of FCHS, axes in the order of the model; None without a model.
    estimate: Signals | None


@dataclass(frozen=True)
class Validated:
    """Errors of the estimators for several responses.

    Attributes
    ----------
    rows, vectors : list of dict
        As in `Judged`, with the name of the case first.
    as_printed : list of dict
        `rows` of the paper's scheme, whose deformation models are calibrated to steps.
    blocks : list of dict
        See `estimator.fchs.block_errors`; empty without a reference response.
    estimates : dict
        Case to the whole run of FCHS.
    errors : dict
        Case to estimator to estimated minus actual displacement, m, shape (k, axes).
    times : dict
        Case to the times of its samples, s, shape (k,).
    """

    rows: list[Row]
    vectors: list[Row]
    as_printed: list[Row]
    blocks: list[Row]
    estimates: dict[str, Signals]
    errors: dict[str, dict[str, Array]]
    times: dict[str, Array]

    def figures(self) -> dict[str, list[Row]]:
        """All errors, as content of a JSON file."""
        return {
            "rows": self.rows,
            "vectors": self.vectors,
            "as_printed": self.as_printed,
            "blocks": self.blocks,
        }


def joined(parts: Sequence[Validated]) -> Validated:
    """Return several validations as one.

    A case may be in several parts, with different estimators in each; duplicates count once.
    """
    whole = Validated([], [], [], [], {}, {}, {})
    for part in parts:
        new = set(part.errors) - set(whole.errors)
        whole.as_printed.extend(row for row in part.as_printed if row["case"] in new)
        whole.blocks.extend(row for row in part.blocks if row["case"] in new)
        whole.estimates.update(part.estimates)
        whole.times.update(part.times)
        for case, errors in part.errors.items():
            every = whole.errors.get(case, {}) | errors
            whole.errors[case] = {name: every[name] for name in ESTIMATORS if name in every}
    cases = list(whole.errors)

    def place(row: Row) -> tuple[int, int]:
        return cases.index(str(row["case"])), ESTIMATORS.index(str(row["estimator"]))

    for field in ("rows", "vectors"):
        by_key = {
            (row["case"], row["estimator"], row.get("axis")): row
            for part in parts
            for row in getattr(part, field)
        }
        getattr(whole, field).extend(sorted(by_key.values(), key=place))
    return whole


def validate(
    response: xr.Dataset,
    model: Model | None,
    *,
    reference: xr.Dataset | None = None,
    roles: Mapping[str, str] | None = None,
    noise: Mapping[str, np.ndarray] | None = None,
    beside: Beside = ALONE,
) -> Judged:
    """Run the estimators on the temperatures of a response, and compare with its displacement.

    Parameters
    ----------
    response, model, roles, noise
        As in `thermojoint.models.sensors.readings`; without a model the others are judged alone.
    reference : xarray.Dataset, optional
        Response to the reference step. With it the actual δ_NL is the displacement minus the
        superposed reference; without it, minus the estimated δ_L.
    beside : Beside
        Estimators to be compared with the model.
    """
    times = response["time"].to_numpy()
    axes = beside.axes if model is None else tuple(model.linear.deformation)
    actual = columns_of(response, "displacement", axes)
    estimated = {"none": np.zeros_like(actual)}
    linear = np.full_like(actual, np.nan)
    estimate = None
    if model is not None:
        estimate = _followed(response, model, roles, noise)
        linear = estimate.linear
        estimated |= {"linear": estimate.linear, "fchs": estimate.total}
    if beside.steady is not None:
        order = [list(beside.steady.linear.deformation).index(axis) for axis in axes]
        steady = _followed(response, beside.steady, roles, noise)
        estimated["linear-steady"] = steady.linear[:, order]
        estimated["fchs-steady"] = steady.total[:, order]
    if reference is not None:
        order = [axes_of(response).index(axis) for axis in axes]
        linear = superposed(reference, response, "displacement")[:, order]
    counted = times >= times[0] + beside.settled_s
    peaks = {
        "peak_total_um": np.abs(actual[counted]).max(axis=0) * MEGA,
        "peak_nonlinear_um": np.abs((actual - linear)[counted]).max(axis=0) * MEGA,
    }
    if beside.baselines is not None:
        given = (_of(ROLES, roles), _of(ROLES, noise))
        samples = np.column_stack((times, rises(response, *given))).tolist()
        interval = float(np.diff(times).min())
        estimated |= _regressed(beside.baselines, interval, samples, axes)
    bands = {}
    for observer, state in beside.observers:
        estimated[observer.kind], bands[observer.kind] = _observed(
            response, observer, axes, noise or {}, state
        )
    errors = {name: estimated[name] - actual for name in ESTIMATORS if name in estimated}
    rows: list[Row] = []
    for name, error in errors.items():
        band = bands[name][counted] if name in bands else None
        figures = figures_of(error[counted], band)
        rows += [
            {"estimator": name, "axis": axis}
            | {key: float(values[k]) for key, values in (peaks | figures).items()}
            for k, axis in enumerate(axes)
        ]
    vectors: list[Row] = [
        {
            "estimator": name,
            "max_abs_error_um": float(np.linalg.norm(error[counted], axis=1).max() * MEGA),
        }
        for name, error in errors.items()
    ]
    return Judged(rows, vectors, errors, estimate)


def _followed(
    response: xr.Dataset,
    model: Model,
    roles: Mapping[str, str] | None,
    noise: Mapping[str, Array] | None,
) -> Signals:
    """Return the whole run of a model, which may have fewer sensors than there are roles."""
    sensors = tuple(model.linear.direct)
    known = (*HEAT_SENSORS, *sensors)
    seen = readings(response, sensors, _of(known, roles), _of(known, noise))
    assembly = assembled_for(model, seen.times)
    return run(assembly, seen.times, seen.delta_T, seen.temperatures)[0]


def _of(roles: Collection[str], given: Mapping[str, Value] | None) -> dict[str, Value]:
    """Return the given values of some roles."""
    return {role: value for role, value in (given or {}).items() if role in roles}


def _regressed(
    baselines: Baselines, interval: float, samples: list[list[float]], axes: Sequence[str]
) -> dict[str, Array]:
    """Return the displacement (k, axes), m, of every regression."""
    for axis in axes:
        if axis not in baselines.axes:
            raise unknown_name("axis", axis, baselines.axes, "baselines")
    displacements: dict[str, Array] = {}
    for regression in regressions(baselines, interval):
        order = [regression.axes.index(axis) for axis in axes]
        run_of = follow(regression, samples, regression.initial_state())
        displacements[regression.kind] = np.array([each.displacement[order] for _, each in run_of])
    return displacements


def _observed(
    response: xr.Dataset,
    observer: OpenedEstimator,
    axes: Sequence[str],
    noise: Mapping[str, Array],
    state: Array,
) -> tuple[Array, Array]:
    """Return the displacement and the half-width of its band, (k, axes), m, of an observer."""
    for axis in axes:
        if axis not in observer.axes:
            raise unknown_name("axis", axis, observer.axes, observer.kind)
    order = [observer.axes.index(axis) for axis in axes]
    kind = kind_of(observer)
    read = kind.sensors(observer.model, response)
    seen = with_added(response, {name: noise[name] for name in read if name in noise})
    moved, band = kind.run(observer, kind.response(observer.model, seen), state)
    return moved[:, order], band[:, order]


@threadpool_limits.wrap(limits=1)
def validate_model(
    model: Model | None,
    reference: xr.Dataset | None,
    responses: Mapping[str, xr.Dataset],
    noisy: Collection[str] = (),
    beside: Beside = ALONE,
) -> Validated:
    """Validate a model by responses, from temperatures alone.

    Parameters
    ----------
    model : Model, optional
        The model; without one the estimators beside it are judged alone.
    reference : xarray.Dataset, optional
        Response to the reference step, for the actual nonlinear part.
    responses : mapping
        Name to response.
    noisy : collection of str
        Names of responses to be validated again with `joint_noise`, as "NAME-noise".
    beside : Beside
        Estimators to be compared with the model.
    """
    validated = Validated([], [], [], [], {}, {}, {})
    for name, response in responses.items():
        roles = None if model is None else roles_in(response, model)
        again = {f"{name}-noise": joint_noise(response)} if name in noisy else {}
        for case, noise in ({name: None} | again).items():
            if model is not None and noise is not None:
                noise = {role: noise[role] for role in model.linear.direct if role in noise}
            seen = partial(validate, response, reference=reference, roles=roles, noise=noise)
            judged = seen(model, beside=beside)
            validated.rows.extend({"case": case, **row} for row in judged.rows)
            validated.vectors.extend({"case": case, **row} for row in judged.vectors)
            validated.errors[case] = judged.errors
            validated.times[case] = response["time"].to_numpy()
            if model is None or judged.estimate is None:
                continue
            validated.estimates[case] = judged.estimate
            paper = seen(as_printed(model), beside=Beside(settled_s=beside.settled_s)).rows
            own = [row for row in paper if row["estimator"] == "fchs"]
            validated.as_printed.extend({"case": case, **row} for row in own)
            if reference is not None:
                validated.blocks.extend(
                    block_errors(case, response, model, reference, roles=roles, noise=noise)
                )
    return validated


def as_printed(model: Model) -> Model:
    """Return the paper's scheme: Eq. 18 calibrated to steps, strengths that do not decay."""
    return replace(
        model, sources=tuple(replace(source, driven={}) for source in model.sources), leak=0.0
    )
