"""Calibration chain: sensor placement, fits of Tables 1-3, a stable inverse."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
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
    JointSensors,
    Placement,
    Rule,
    choose_heat_pair,
    rank_joint_sensors,
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
from thermojoint.artefacts.arrays import Array
from thermojoint.artefacts.display import Described
from thermojoint.artefacts.errors import ConvergenceError, InputError, ThermojointError
from thermojoint.artefacts.response import probes_of
from thermojoint.models import blocks
from thermojoint.models.assembly import assemble
from thermojoint.models.filters.inverse import unstable_zeros
from thermojoint.models.parameters import (
    DeformationModel,
    FictitiousSource,
    LinearModel,
    Model,
    Span,
)
from thermojoint.models.sensors import HEAT_SENSORS, named_sensors, readings

if TYPE_CHECKING:
    import xarray as xr

#: Largest factor on A that `stabilised` tries.
MOST_RAISED = 64.0
#: Number of sources with automatic placement, as in the paper; fewer with fewer inputs.
SOURCES = 2
#: Sets of sensors at the joint that are tried before one sensor fewer is used.
MOST_SETS = 12
#: Samples of a response that are used: a longer one is thinned evenly.
MOST_SAMPLES = 1500
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
    compromise : str
        Why there are fewer sources than asked for; empty if there are as many.
    """

    model: Model
    linear: LinearCalibration
    fictitious: FictitiousCalibration
    averaging: Averaging
    placement: Placement | None
    compromise: str = ""

    def _facts(self) -> dict[str, str]:
        return {"model": repr(self.model)}

    @property
    def sensors_text(self) -> str:
        """The chosen sensors and the compromise, as lines."""
        placed = "" if self.placement is None else str(self.placement)
        return "\n".join(part for part in (placed, self.compromise) if part)


@threadpool_limits.wrap(limits=1)
def calibrate_responses(
    reference: xr.Dataset,
    others: Mapping[float, xr.Dataset],
    distances: Sequence[Sequence[float]] | None = None,
    *,
    rule: Rule = RULE,
) -> Calibrated:
    """Return the calibrated model of a structure from its responses to steps.

    All axes with motion are calibrated (`calibrate.responses.moving_axes`). Named sensors T1, T2
    ... Tn have n sources; without names there are `SOURCES` (one, with one further input). If no
    such model has a stable inverse, there is a source fewer, and `Calibrated.compromise` says why.

    Parameters
    ----------
    reference : xarray.Dataset
        Response to the reference step.
    others : mapping
        Heat input to the response to it; at least as many as sources.
    distances : sequence of sequences, optional
        r_ij, m, from fictitious source i to sensor T_j, if the responses name their sensors.
        Default: the sources lie at the contact elements nearest to the sensors.
    rule : Rule
        Of the choice of a and b among candidates.

    Raises
    ------
    InputError
        The responses are inconsistent, sensors are missing and there are no candidates to choose
        from, or no choice of them gives a stable estimator.
    """
    known = probes_of(reference)
    sensors = named_sensors(known)[len(HEAT_SENSORS) :]
    check_responses(reference, others, len(sensors))
    if distances is not None and not sensors:
        raise InputError(
            "distances: they belong to sensors that are named; name the probes a, b, T1 and T2"
        )
    near_source, at_joint = ([], list(sensors)) if sensors else candidates_in(reference)
    needed = (*HEAT_SENSORS, *sensors) if sensors else (*near_source, *at_joint)
    check_probes(reference, others, needed)
    axes = moving_axes(reference, others)
    every = math.ceil(reference.sizes["time"] / MOST_SAMPLES)
    times = reference["time"].to_numpy()
    # Without a sample at the step, the first is one interval after it, also after thinning.
    first = 0 if times[0] < 0.5 * (times[1] - times[0]) else every - 1
    base, *runs = (
        response.sel(axis=axes).isel(time=slice(first, None, every))
        for response in (reference, *others.values())
    )
    rest = dict(zip(others, runs, strict=True))
    if sensors:
        apart = (
            sources_for(base, sensors)[1]
            if distances is None
            else np.array(checked_distances(distances, len(sensors)))
        )
    displacements = calibrate_displacements(base)
    if not sensors:
        shapes = {axis: shape for axis, (shape, _) in displacements.items()}
        heat = choose_heat_pair(base, rest, shapes, near_source, rule)
        base_of_heat = with_roles(base, {"a": heat.a, "b": heat.b})
    by_source = calibrate_heat(base if sensors else base_of_heat, displacements)
    refused = ""
    most = len(sensors) or min(SOURCES, len(rest))
    for chosen in _joint_sensors(base, rest, at_joint, most):
        try:
            if sensors:
                part = [sensors.index(name) for name in chosen.probes]
                of = _Sensors(chosen.probes, apart[np.ix_(part, part)], None)
                own, named = base, rest
            else:
                placement = Placement(heat, chosen, *sources_for(base, chosen.probes))
                of = _Sensors(tuple(placement.roles)[2:], placement.distances, placement)
                own = with_roles(base, placement.roles)
                named = {q: with_roles(run, placement.roles) for q, run in rest.items()}
            calibrated = _calibrate(own, named, by_source, of)
        except ThermojointError as error:
            # The responses are valid and a and b are chosen: any failure is due to these sensors.
            refused = str(error)
            continue
        had = len(chosen.probes)
        fewer = f"{had} of {most} fictitious sources: {refused}" if had < most else ""
        return replace(calibrated, compromise=fewer)
    raise InputError(
        f"placement: no sensors at the joint give a stable estimator ({refused or 'none given'}); "
        "give other [[candidates]] there"
    )


@dataclass(frozen=True)
class _Sensors:
    """Roles of the sensors at the joint, r_ij (m), and how they were placed."""

    roles: tuple[str, ...]
    distances: Array
    placement: Placement | None


def _joint_sensors(
    base: xr.Dataset, rest: Mapping[float, xr.Dataset], names: list[str], most: int
) -> Iterator[JointSensors]:
    """Yield sets of sensors to be tried: of `most` of `names`, then of fewer."""
    if len(names) == most:
        yield JointSensors(tuple(names), math.nan, math.nan)
        most -= 1
    for count in range(most, 0, -1):
        yield from islice(rank_joint_sensors(base, rest, names, count), MOST_SETS)


def _calibrate(
    base: xr.Dataset,
    rest: Mapping[float, xr.Dataset],
    by_source: LinearCalibration,
    sensors: _Sensors,
) -> Calibrated:
    """Calibrate with given sensors; `by_source` is Table 1 without those at the joint."""
    distances = sensors.distances.tolist()
    linear = with_direct_models(by_source, base, sensors.roles)
    fictitious = calibrate_fictitious(base, rest, distances, sensors.roles)
    roles = [*HEAT_SENSORS, *sensors.roles]
    position = base["probe_position"].sel(probe=roles).to_numpy()
    model = Model(
        linear=linear.model,
        sources=fictitious.sources,
        distances=tuple(map(tuple, distances)),
        sensors={
            role: (float(x), float(y), float(z))
            for role, (x, y, z) in zip(roles, position, strict=True)
        },
        reference_power_W=reference_power(base),
        span=span_of(linear.model, base, rest),
    )
    model = stabilised(model, base["time"].to_numpy())
    model = replace(model, leak=1.0 / model.span.duration_s)
    model = replace(model, sources=_driven_models(model, base, rest, fictitious))
    data = fictitious.deviations
    averaging = fit_by_averaging(data.t, data.temperatures, data.inputs, make_geometry(distances))
    return Calibrated(model, linear, fictitious, averaging, sensors.placement)


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
    interval, length = float(np.diff(times).min()), float(times[-1] - times[0])
    factor = 1.0
    while factor <= MOST_RAISED:
        printed = (source.regularisation for source in model.sources)
        raised = [replace(f, A=factor * f.A, B=factor * f.B) for f in printed]
        if unstable_zeros(model.rings, raised, interval, length, "inverse of the sources") == 0:
            sources = zip(model.sources, raised, strict=True)
            return replace(
                model, sources=tuple(replace(source, regularisation=f) for source, f in sources)
            )
        factor *= 2.0
    raise ConvergenceError(
        f"inverse of the sources: unstable even with A raised {MOST_RAISED:g} times; place the "
        "sensors nearer to their own sources"
    )


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
