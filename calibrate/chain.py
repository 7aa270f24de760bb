"""Calibration chain: sensor placement, fits of Tables 1-3, a stable inverse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from calibrate.driven_deformation import fit_driven_deformation, uncertain_signals
from calibrate.fictitious import FictitiousCalibration, calibrate_fictitious
from calibrate.linear import (
    LinearCalibration,
    calibrate_displacements,
    calibrate_heat,
    with_direct_models,
)
from calibrate.placement.fchs import (
    RULE,
    Placement,
    choose_heat_pair,
    rank_joint_pairs,
    sources_for,
    with_roles,
)
from calibrate.responses import (
    candidates_in,
    check_probes,
    check_responses,
    checked_distances,
    moving_axes,
    reference_power,
)
from calibrate.source_thermal import Averaging, fit_by_averaging, make_geometry
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import ConvergenceError, InputError, ThermojointError
from thermojoint.artefacts.response import axes_of, probes_of
from thermojoint.models import blocks
from thermojoint.models.assembly import assemble
from thermojoint.models.filters.inverse import unstable_zeros
from thermojoint.models.parameters import (
    DeformationModel,
    FictitiousSource,
    LinearModel,
    Model,
    Regularisation,
    RingModel,
    Span,
)
from thermojoint.models.sensors import JOINT_SENSORS, ROLES, readings

if TYPE_CHECKING:
    import xarray as xr

#: Largest factor on A that `stabilised` tries.
MOST_RAISED = 64.0
#: Joint pairs tried by the placement before it gives up.
MOST_PAIRS = 40
#: Seed of the temperature errors that must cause no displacement.
SEED = 0


@dataclass(frozen=True, repr=False)
class Calibrated(Described):
    """A calibrated model and the intermediate results.

    Attributes
    ----------
    model : Model
    linear : LinearCalibration
        Table 1.
    fictitious : FictitiousCalibration
        Tables 2 and 3.
    averaging : Averaging
        The loop of Figure 4 on the same data as Table 2, for comparison only.
    placement : Placement or None
        None if the responses named their sensors.
    """

    model: Model
    linear: LinearCalibration
    fictitious: FictitiousCalibration
    averaging: Averaging
    placement: Placement | None

    def _facts(self) -> dict[str, str]:
        return {"model": repr(self.model)}


@threadpool_limits.wrap(limits=1)
def calibrate_responses(
    reference: xr.Dataset,
    others: Mapping[float, xr.Dataset],
    distances: Sequence[Sequence[float]] | None = None,
) -> Calibrated:
    """Return the calibrated model of a structure from its responses to steps.

    All axes with motion are calibrated (`calibrate.responses.moving_axes`).

    Parameters
    ----------
    reference : xarray.Dataset
        Response to the reference step.
    others : mapping
        Heat input to the response to it.
    distances : sequence of sequences, optional
        r_ij, m, from fictitious source i to sensor T_j, if the responses name their sensors.
        Default: the sources lie at the contact elements nearest to the sensors.

    Raises
    ------
    InputError
        The responses are inconsistent, sensors are missing and there are no candidates to choose
        from, or no choice of them gives a stable estimator.
    ConvergenceError
        The sensors named in the responses give no stable estimator.
    """
    check_responses(reference, others)
    named = set(probes_of(reference)) >= set(ROLES)
    if distances is not None and not named:
        raise InputError(
            "distances: they belong to sensors that are named; name the probes a, b, T1 and T2"
        )
    near_source, at_joint = ([], []) if named else candidates_in(reference)
    check_probes(others, ROLES if named else (*near_source, *at_joint))
    axes = moving_axes(reference, others)
    base = reference.sel(axis=axes)
    rest = {level: response.sel(axis=axes) for level, response in others.items()}
    if not named:
        return _place_and_calibrate(base, rest, near_source, at_joint)
    if distances is None:
        table = sources_for(base, JOINT_SENSORS)[1].tolist()
    else:
        table = checked_distances(distances)
    return _calibrate(base, rest, table, calibrate_heat(base, calibrate_displacements(base)), None)


def _place_and_calibrate(
    base: xr.Dataset, rest: Mapping[float, xr.Dataset], near_source: list[str], at_joint: list[str]
) -> Calibrated:
    axes = axes_of(base)
    displacements = calibrate_displacements(base)
    shapes = {axis: shape for axis, (shape, _) in displacements.items()}
    heat = choose_heat_pair(base, rest, shapes, near_source)
    by_source = calibrate_heat(with_roles(base, {"a": heat.a, "b": heat.b}), displacements)
    refused = ""
    for pair in islice(rank_joint_pairs(base, rest, axes, at_joint), MOST_PAIRS):
        placement = Placement(heat, pair, *sources_for(base, (pair.T1, pair.T2)))
        own = with_roles(base, placement.roles)
        named = {level: with_roles(response, placement.roles) for level, response in rest.items()}
        try:
            return _calibrate(own, named, placement.distances.tolist(), by_source, placement)
        except ThermojointError as error:
            # The responses are valid and a and b are chosen: any failure here is due to this pair.
            refused = str(error)
    if not refused:
        raise InputError(
            f"placement: no two candidates at the joint lie {RULE.apart:g} m apart; give more "
            "[[candidates]] there"
        )
    raise InputError(
        f"placement: none of the best {MOST_PAIRS} pairs at the joint gives a stable estimator "
        f"({refused}); give other [[candidates]]"
    )


def _calibrate(
    base: xr.Dataset,
    rest: Mapping[float, xr.Dataset],
    distances: Sequence[Sequence[float]],
    by_source: LinearCalibration,
    placement: Placement | None,
) -> Calibrated:
    """Calibrate with given sensors; `by_source` is Table 1 without T1 and T2."""
    linear = with_direct_models(by_source, base)
    fictitious = calibrate_fictitious(base, rest, distances)
    position = base["probe_position"].sel(probe=list(ROLES)).to_numpy()
    model = Model(
        linear=linear.model,
        sources=fictitious.sources,
        distances=tuple(tuple(map(float, row)) for row in distances),
        sensors={
            role: (float(x), float(y), float(z))
            for role, (x, y, z) in zip(ROLES, position, strict=True)
        },
        reference_power_W=reference_power(base),
        span=span_of(linear.model, base, rest),
    )
    model = stabilised(model, base["time"].to_numpy())
    model = replace(model, leak=1.0 / model.span.duration_s)
    model = replace(model, sources=_driven_models(model, base, rest, fictitious))
    data = fictitious.deviations
    averaging = fit_by_averaging(data.t, data.temperatures, data.inputs, make_geometry(distances))
    return Calibrated(model, linear, fictitious, averaging, placement)


def span_of(linear: LinearModel, base: xr.Dataset, rest: Mapping[float, xr.Dataset]) -> Span:
    """Return the range of the calibration responses, rest included."""
    runs = [base, *rest.values()]
    levels = [float(run["heat_input"][-1]) for run in runs]
    seen = [readings(run, tuple(linear.direct)) for run in runs]
    values = np.concatenate(
        [np.column_stack((readings.delta_T, readings.temperatures)) for readings in seen]
    )
    names = ("delta_T", *linear.direct)
    return Span(
        duration_s=float(base["time"][-1]),
        heat=(min(0.0, *levels), max(0.0, *levels)),
        temperatures={
            name: (min(0.0, float(column.min())), max(0.0, float(column.max())))
            for name, column in zip(names, values.T, strict=True)
        },
    )


def stabilised(model: Model, times: np.ndarray) -> Model:
    """Increase A of all sources (Eq. 7) together until the matrix of the sources is invertible.

    The rule for A considers each source alone. In combination, a source may have more effect on the
    other's sensor than on its own; a larger A, and with it B, gives the own sensor more weight.

    Raises
    ------
    ConvergenceError
        The inverse is unstable even with `MOST_RAISED` times the A of the rule.
    """
    rings = [
        [RingModel(source.K, source.a, source.alpha, r, source.r0) for r in row]
        for source, row in zip(model.sources, model.distances, strict=True)
    ]
    interval, length = float(np.diff(times).min()), float(times[-1] - times[0])
    factor = 1.0
    while factor <= MOST_RAISED:
        raised = [_raised(source.regularisation, factor) for source in model.sources]
        if unstable_zeros(rings, raised, interval, length, "inverse of the sources") == 0:
            sources = zip(model.sources, raised, strict=True)
            return replace(
                model, sources=tuple(replace(source, regularisation=f) for source, f in sources)
            )
        factor *= 2.0
    raise ConvergenceError(
        f"inverse of the sources: unstable even with A raised {MOST_RAISED:g} times; place the "
        "sensors nearer to their own sources"
    )


def _raised(f: Regularisation, factor: float) -> Regularisation:
    return Regularisation(factor * f.A, factor * f.B, f.gamma)


def _driven_models(
    model: Model,
    base: xr.Dataset,
    rest: Mapping[float, xr.Dataset],
    fictitious: FictitiousCalibration,
) -> tuple[FictitiousSource, ...]:
    """Calibrate Eq. 18 to the strengths that the estimator finds in the calibration responses.

    Additional runs consist of temperature errors only and must cause no displacement.
    """
    times = base["time"].to_numpy()
    assembly = assemble(model, float(np.diff(times).min()), float(times[-1] - times[0]))
    levels = [float(level) for level in fictitious.deviations.inputs]
    after = times > 0.0
    runs = []
    for level in levels:
        seen = readings(rest[level], tuple(model.linear.direct))
        heat = blocks.heat_part(assembly, times, seen.delta_T)
        runs.append(blocks.deviations(assembly, times, heat, seen.temperatures))
    still = uncertain_signals(times, RULE.deviation_uncertainty, assembly.n_sources, SEED)
    strengths = np.stack(
        [blocks.source_part(assembly, times, run)[after] for run in (*runs, *still)]
    ).transpose(2, 0, 1)
    shapes: dict[str, tuple[DeformationModel, ...]] = {}
    for axis, target in fictitious.deviations.displacements.items():
        nothing = np.zeros((len(still), int(after.sum())))
        wanted = np.concatenate([target[:, after], nothing])
        shapes[axis] = fit_driven_deformation(times[after], wanted, strengths)[0]
    return tuple(
        replace(source, driven={axis: models[i] for axis, models in shapes.items()})
        for i, source in enumerate(model.sources)
    )
